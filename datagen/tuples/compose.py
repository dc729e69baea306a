"""Tuples from layers: background, composite, target and effect under any lighting."""

from multilight.datagen.errors import UserError
from multilight.datagen.storage.object_variants import ALL, Variant
from multilight.datagen.storage.store import ViewData
from multilight.lights.relight import mix
from multilight.lights.spec import LightingCondition
from multilight.scenes.arrays import Float32


def target(view: ViewData, lit: LightingCondition) -> Float32:
    """Return the true picture with every object, (H, W, 3) linear radiance."""
    return mix(view.variants[ALL], view.lights, lit)


def background(view: ViewData, removed: str, lit: LightingCondition) -> Float32:
    """Return the picture without object `removed`: no shadow, reflection or glow of it, (H, W, 3)."""
    return mix(_variant(view, Variant.without(removed)), view.lights, lit)


def composite(view: ViewData, inserted: str, *, insert: LightingCondition, base: LightingCondition) -> Float32:
    """Paste the object as lit by `insert` over the background as lit by `base`, (H, W, 3).

    The object's own radiance is premultiplied by its coverage, so edges carry no halo:
    foreground(insert) + (1 - coverage) * background(base)  (Porter and Duff 1984, "over").
    """
    foreground = mix(_variant(view, Variant.foreground(inserted)), view.lights, insert)
    uncovered = (1.0 - view.coverage[inserted])[..., None]
    return foreground + uncovered * background(view, inserted, base)


def effect(view: ViewData, removed: str, lit: LightingCondition) -> Float32:
    """Return target - background: what the object adds to and takes from the light (signed), (H, W, 3)."""
    return target(view, lit) - background(view, removed, lit)


def _variant(view: ViewData, variant: Variant) -> Float32:
    try:
        return view.variants[variant]
    except KeyError:
        raise UserError(f"object {variant.object!r} is not insertable; choose one of {list(view.coverage)}") from None
