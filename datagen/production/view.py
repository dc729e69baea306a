"""Render one view: every variant, light by light, denoised, with what the layers held before."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from multilight.datagen.backends.protocol import LARGE, Backend, RenderJob, RenderSettings
from multilight.datagen.files.shelf import Shelf
from multilight.datagen.production.denoise import denoise_all, denoise_foreground, denoise_without, foreground_layers
from multilight.datagen.production.stopwatch import Stopwatch
from multilight.datagen.storage.halves import Halves, Planes, in_planes
from multilight.datagen.storage.layers import LayerStack
from multilight.datagen.storage.object_variants import ALL, Variant
from multilight.datagen.storage.records import LayerEnergy, Residuals
from multilight.datagen.storage.store import ViewData
from multilight.datagen.verification.residuals import noise_variance, residual
from multilight.lights.spec import LightRig
from multilight.scenes.arrays import Float32, Mask
from multilight.scenes.spec import SceneSpec

Stacks = dict[str, LayerStack]
"""One stack an insertable object."""


@dataclass(frozen=True)
class SceneSetup:
    """What all views of a scene share.

    `denoise`: clean each layer; `keep_raw`: keep what was rendered as well; `scratch`: a folder where what is rendered
    of large pictures waits to be denoised.
    """

    backend: Backend
    scene: SceneSpec
    rig: LightRig
    settings: RenderSettings
    denoise: bool
    keep_raw: bool
    scratch: Path | None = None


@dataclass(frozen=True)
class RenderedView:
    """A view to be stored; how far its raw layers are from the renderer's own picture, what they held, and how far the
    denoised ones are from them (by variant; empty where nothing is denoised)."""

    data: ViewData
    additivity: float
    energy: dict[str, dict[str, LayerEnergy]]
    residuals: dict[str, Residuals]


def render_view(setup: SceneSetup, view: int, watch: Stopwatch) -> RenderedView:
    """Render and denoise all variants of a view."""

    def render(variant: str) -> LayerStack:
        with watch.stage("render"):
            job = RenderJob(setup.scene, setup.rig, setup.settings, view, variant, setup.scratch)
            return _put(setup.backend.render(job), shelf)

    names, camera = setup.scene.insertable, setup.scene.cameras[view]
    shelf = Shelf(setup.scratch) if camera.width * camera.height > LARGE else None
    everything = render(ALL)
    assert everything.geometry is not None
    foregrounds = _within_pixels({name: render(Variant.foreground(name)) for name in names}, shelf)
    without = {name: render(Variant.without(name)) for name in names}
    raw: Mapping[str, Float32] = {}
    if setup.keep_raw or not setup.denoise:
        raw = _kept(_as_rendered(everything, without, foregrounds), shelf)
    variants, residuals = raw, dict[str, Residuals]()
    if setup.denoise:
        with watch.stage("denoise"):
            threads = max(1, setup.settings.threads)
            clean = _denoised(everything, without, foregrounds, residuals, shelf, threads=threads)
            variants = _kept(clean, shelf)
    coverage = {name: stack.coverage for name, stack in foregrounds.items() if stack.coverage is not None}
    free = np.clip(1.0 - sum(coverage.values()), 0.0, 1.0)
    geometry = replace(everything.geometry, environment=np.minimum(everything.geometry.environment, free))
    kept = raw if setup.denoise else {}
    data = ViewData(setup.rig.names, variants, coverage, geometry, everything.combined, kept)
    whole = [(ALL, everything), *((Variant.without(name), stack) for name, stack in without.items())]
    energy: dict[str, dict[str, LayerEnergy]] = {}
    for variant, stack in whole:
        energy[variant] = layer_energies(stack)
        if shelf is not None:
            shelf.rest()
    return RenderedView(data, additivity_residual(everything), energy, residuals)


def _kept(layers: Iterable[tuple[str, Float32]], shelf: Shelf | None) -> Mapping[str, Float32]:
    """Keep layers by variant; those of a large picture, which are made one after the other, as they will be stored."""
    if shelf is None:
        return dict(layers)
    found: dict[str, Sequence[Planes]] = {}
    for name, values in layers:
        found[name] = [list(shelf.keep(np.stack(in_planes(layer)))) for layer in values]
        shelf.rest()
    return Halves(found, shelf.rest)


def _put(stack: LayerStack, shelf: Shelf | None) -> LayerStack:
    """Put the pictures of a stack on the shelf, if there is one."""
    if shelf is None:
        return stack
    albedo, normal = stack.guide_albedo, stack.guide_normal
    kept = replace(
        stack,
        radiance=shelf.keep(stack.radiance),
        combined=shelf.keep(stack.combined),
        guide_albedo=None if albedo is None else shelf.keep(albedo),
        guide_normal=None if normal is None else shelf.keep(normal),
    )
    shelf.rest()
    return kept


def _as_rendered(everything: LayerStack, without: Stacks, foregrounds: Stacks) -> Iterator[tuple[str, Float32]]:
    yield ALL, everything.radiance
    for name, stack in without.items():
        yield Variant.without(name), stack.radiance
        yield Variant.foreground(name), foreground_layers(foregrounds[name], everything.radiance)


def _denoised(
    everything: LayerStack,
    without: Stacks,
    foregrounds: Stacks,
    residuals: dict[str, Residuals],
    shelf: Shelf | None,
    *,
    threads: int,
) -> Iterator[tuple[str, Float32]]:
    """Yield variants and their denoised layers; note how far these are from what was rendered."""
    rest = None if shelf is None else shelf.rest
    clean = denoise_all(everything, threads=threads, rest=rest)
    if shelf is not None:
        clean = shelf.keep(clean)
    anywhere = np.ones(clean.shape[1:3], bool)
    left = (residual(layer, raw, anywhere)[0] for layer, raw in zip(clean, everything.radiance, strict=True))
    residuals[ALL] = Residuals(outside=_largest(everything.lights, left))
    yield ALL, clean
    for name, stack in without.items():
        shown = shown_in(everything, stack, foregrounds[name])
        removed = denoise_without(stack, everything, clean, shown, threads=threads, rest=rest)
        residuals[Variant.without(name)] = Residuals(
            inside=_largest(stack.lights, removed.inside),
            outside=_largest(stack.lights, removed.outside),
            denoised_anew=removed.anew,
        )
        yield Variant.without(name), removed.layers
        del removed  # before more is made
        yield Variant.foreground(name), denoise_foreground(foregrounds[name], clean, threads=threads, rest=rest)


def _largest(lights: Sequence[str], found: Iterable[float]) -> dict[str, float]:
    """Keep what differs at all, to four digits."""
    return {light: float(f"{value:.4g}") for light, value in zip(lights, found, strict=True) if value > 0}


def shown_in(everything: LayerStack, without: LayerStack, foreground: LayerStack) -> Mask:
    """Tell where a removed object was to be seen at all: straight, in a mirror or through glass, (H, W).

    Mitsuba counts the samples that show it. Cycles' guides see through glass and mirrors themselves, so that where they
    differ in any bit something else is seen there.
    """
    assert foreground.coverage is not None
    shown = foreground.coverage > 0
    if without.shown is not None:
        shown |= without.shown > 0
    for guide, other in (
        (everything.guide_albedo, without.guide_albedo),
        (everything.guide_normal, without.guide_normal),
    ):
        if guide is not None and other is not None:
            shown |= (guide != other).any(axis=-1)
    return shown


def _within_pixels(foregrounds: Stacks, shelf: Shelf | None) -> Stacks:
    """Scale objects down where together they cover more than the pixel.

    Each is rendered on its own, so where see-through things overlap the estimates need not add up.
    """
    total = np.maximum(sum(stack.coverage for stack in foregrounds.values() if stack.coverage is not None), 1.0)
    if not (total > 1.0).any():
        return foregrounds
    within = {}
    for name, stack in foregrounds.items():
        assert stack.coverage is not None
        stack = replace(stack, coverage=stack.coverage / total, radiance=stack.radiance / total[..., None])
        within[name] = _put(stack, shelf)
    return within


def additivity_residual(stack: LayerStack) -> float:
    """Return the largest |sum of layers - combined| / (combined + its mean) of a raw render."""
    total = stack.radiance.sum(axis=0, dtype=np.float64)
    scale = stack.combined + max(float(stack.combined.mean()), 1e-12)
    return float((np.abs(total - stack.combined) / scale).max())


def layer_energies(stack: LayerStack) -> dict[str, LayerEnergy]:
    """Return what each light's layer holds, to six digits."""

    def rounded(value: np.floating) -> float:
        return float(f"{value:.6g}")

    return {
        light: LayerEnergy(
            mean=rounded(layer.mean(dtype=np.float64)), noise=rounded(np.sqrt(noise_variance(layer).mean()))
        )
        for light, layer in zip(stack.lights, stack.radiance, strict=True)
    }
