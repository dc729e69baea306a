"""What a material looks like, by the numbers that decide it."""

from multilight.scenes.spec import Body, Material


def material_class(material: Material) -> str:
    """Name what a material looks like, by the parameter that decides it."""
    match material:
        case Material(metallic=metallic, roughness=roughness) if metallic > 0.5:
            return "mirror" if roughness < 0.1 else "metal"
        case Material(transmission=transmission) if transmission > 0.5:
            return "glass"
        case Material(coat=coat) if coat > 0.3:
            return "coated"
        case Material(roughness=roughness):
            return "glossy" if roughness < 0.3 else "satin" if roughness < 0.6 else "matte"


def is_mirror(body: Body) -> bool:
    """Tell whether a body of the setting, not an object, reflects like a mirror."""
    return body.role != "object" and any(m.metallic == 1 and m.roughness <= 0.12 for m in body.materials)
