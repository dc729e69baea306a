"""Render one view: every variant, light by light, denoised, with what the layers held before."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from multilight.datagen.backends.protocol import Backend, RenderJob, RenderSettings
from multilight.datagen.production.denoise import denoise_all, denoise_foreground, denoise_without, foreground_layers
from multilight.datagen.production.stopwatch import Stopwatch
from multilight.datagen.storage.layers import LayerStack
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
    """What all views of a scene share. `denoise`: clean each layer; `keep_raw`: keep what was rendered as well."""

    backend: Backend
    scene: SceneSpec
    rig: LightRig
    settings: RenderSettings
    denoise: bool
    keep_raw: bool


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
            return setup.backend.render(RenderJob(setup.scene, setup.rig, setup.settings, view, variant))

    names = setup.scene.insertable
    everything = render("all")
    assert everything.geometry is not None
    foregrounds = _within_pixels({name: render(f"foreground_{name}") for name in names})
    without = {name: render(f"without_{name}") for name in names}
    raw = _as_rendered(everything, without, foregrounds)
    variants, residuals = raw, dict[str, Residuals]()
    if setup.denoise:
        with watch.stage("denoise"):
            variants, residuals = _denoised(everything, without, foregrounds, threads=max(1, setup.settings.threads))
    coverage = {name: stack.coverage for name, stack in foregrounds.items() if stack.coverage is not None}
    free = np.clip(1.0 - sum(coverage.values()), 0.0, 1.0)
    geometry = replace(everything.geometry, environment=np.minimum(everything.geometry.environment, free))
    kept = raw if setup.denoise and setup.keep_raw else {}
    data = ViewData(setup.rig.names, variants, coverage, geometry, everything.combined, kept)
    whole = {"all": everything} | {f"without_{name}": stack for name, stack in without.items()}
    energy = {variant: layer_energies(stack) for variant, stack in whole.items()}
    return RenderedView(data, additivity_residual(everything), energy, residuals)


def _as_rendered(everything: LayerStack, without: Stacks, foregrounds: Stacks) -> dict[str, Float32]:
    variants = {"all": everything.radiance}
    for name, stack in without.items():
        variants[f"without_{name}"] = stack.radiance
        variants[f"foreground_{name}"] = foreground_layers(foregrounds[name], everything.radiance)
    return variants


def _denoised(
    everything: LayerStack, without: Stacks, foregrounds: Stacks, *, threads: int
) -> tuple[dict[str, Float32], dict[str, Residuals]]:
    clean = denoise_all(everything, threads=threads)
    anywhere = np.ones(clean.shape[1:3], bool)
    left = (residual(layer, raw, anywhere)[0] for layer, raw in zip(clean, everything.radiance, strict=True))
    variants, residuals = {"all": clean}, {"all": Residuals(outside=_largest(everything.lights, left))}
    for name, stack in without.items():
        removed = denoise_without(
            stack, everything, clean, shown_in(everything, stack, foregrounds[name]), threads=threads
        )
        variants[f"without_{name}"] = removed.layers
        variants[f"foreground_{name}"] = denoise_foreground(foregrounds[name], clean, threads=threads)
        residuals[f"without_{name}"] = Residuals(
            inside=_largest(stack.lights, removed.inside),
            outside=_largest(stack.lights, removed.outside),
            denoised_anew=removed.anew,
        )
    return variants, residuals


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


def _within_pixels(foregrounds: Stacks) -> Stacks:
    """Scale objects down where together they cover more than the pixel.

    Each is rendered on its own, so where see-through things overlap the estimates need not add up.
    """
    total = np.maximum(sum(stack.coverage for stack in foregrounds.values() if stack.coverage is not None), 1.0)
    return {
        name: replace(stack, coverage=stack.coverage / total, radiance=stack.radiance / total[..., None])
        for name, stack in foregrounds.items()
        if stack.coverage is not None
    }


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
