"""The parts of a scene's bodies: their triangles, and which of them glow; the same for every renderer and export."""

from multilight.datagen.backends.protocol import BackendError
from multilight.lights.spec import EmissiveLight, LightRig
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.meshes import MeshPart, rectangle_part, sphere_part
from multilight.scenes.spec import Body, MeshAsset, Rectangle, SceneSpec, Sphere


def body_parts(body: Body, library: AssetLibrary) -> tuple[MeshPart, ...]:
    """Return a body's triangles in its own frame [m], a part for each of its materials.

    Raises `BackendError` where its asset is not the one that the scene was made with.
    """
    match body.geometry:
        case Sphere() as shape:
            return (sphere_part(shape, body.materials[0]),)
        case Rectangle() as shape:
            return (rectangle_part(shape, body.materials[0]),)
        case MeshAsset() as shape:
            mesh = library.mesh(shape.asset)
            if (mesh.sha256(), len(mesh.parts)) != (shape.mesh_sha256, shape.parts):
                raise BackendError(
                    f"asset {shape.asset!r} of body {body.name!r} has changed since the scene was made; install the "
                    "packs it was made with, or make the scene again"
                )
            return mesh.parts


def glowing_parts(scene: SceneSpec, rig: LightRig) -> dict[tuple[str, int], EmissiveLight]:
    """Return the light of each part that glows, by its body's name and its number.

    Raises `BackendError` where a light names no part of the scene, or one that another light has.
    """
    free = {body.name: list(range(len(body.materials))) for body in scene.bodies}
    glows: dict[tuple[str, int], EmissiveLight] = {}
    for light in rig.lights:
        if not isinstance(light, EmissiveLight):
            continue
        if light.part not in free.get(light.body, ()):
            raise BackendError(
                f"light {light.name!r}: part {light.part} of body {light.body!r} is not free to glow; "
                f"bodies and their free parts are {free}"
            )
        free[light.body].remove(light.part)
        glows[light.body, light.part] = light
    return glows
