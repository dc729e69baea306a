"""Render one view: every variant, light by light, denoised, with what the layers held before."""

from dataclasses import dataclass, replace

import numpy as np

from datagen.backends import Backend, RenderJob, RenderSettings
from datagen.denoise import denoise_all, denoise_foreground, denoise_without, foreground_layers
from datagen.energy import noise_variance
from datagen.layers import Float32, LayerStack
from datagen.records import LayerEnergy
from datagen.stopwatch import Stopwatch
from datagen.store import ViewData
from lights.spec import LightRig
from scenes.spec import SceneSpec

Stacks = dict[str, LayerStack]
"""One stack an insertable object."""


@dataclass(frozen=True)
class Shoot:
    """What all views of a scene share. `denoise`: clean each layer; `keep_raw`: keep what was rendered as well."""

    backend: Backend
    scene: SceneSpec
    rig: LightRig
    settings: RenderSettings
    denoise: bool
    keep_raw: bool


@dataclass(frozen=True)
class RenderedView:
    """A view to be stored; how far its raw layers are from the renderer's own picture, and what they held."""

    data: ViewData
    additivity: float
    energy: dict[str, dict[str, LayerEnergy]]


def render_view(shoot: Shoot, view: int, watch: Stopwatch) -> RenderedView:
    """Render and denoise all variants of a view."""

    def render(variant: str) -> LayerStack:
        with watch.stage("render"):
            return shoot.backend.render(RenderJob(shoot.scene, shoot.rig, shoot.settings, view, variant))

    names = shoot.scene.insertable
    everything = render("all")
    assert everything.geometry is not None
    foregrounds = _within_pixels({name: render(f"foreground_{name}") for name in names})
    without = {name: render(f"without_{name}") for name in names}
    raw = _as_rendered(everything, without, foregrounds)
    variants = raw
    if shoot.denoise:
        with watch.stage("denoise"):
            variants = _denoised(everything, without, foregrounds, threads=max(1, shoot.settings.threads))
    coverage = {name: stack.coverage for name, stack in foregrounds.items() if stack.coverage is not None}
    free = np.clip(1.0 - sum(coverage.values()), 0.0, 1.0)
    geometry = replace(everything.geometry, environment=np.minimum(everything.geometry.environment, free))
    kept = raw if shoot.denoise and shoot.keep_raw else {}
    data = ViewData(shoot.rig.names, variants, coverage, geometry, everything.combined, kept)
    whole = {"all": everything} | {f"without_{name}": stack for name, stack in without.items()}
    energy = {variant: layer_energies(stack) for variant, stack in whole.items()}
    return RenderedView(data, additivity_residual(everything), energy)


def _as_rendered(everything: LayerStack, without: Stacks, foregrounds: Stacks) -> dict[str, Float32]:
    variants = {"all": everything.radiance}
    for name, stack in without.items():
        variants[f"without_{name}"] = stack.radiance
        variants[f"foreground_{name}"] = foreground_layers(foregrounds[name], everything.radiance)
    return variants


def _denoised(everything: LayerStack, without: Stacks, foregrounds: Stacks, *, threads: int) -> dict[str, Float32]:
    clean = denoise_all(everything, threads=threads)
    variants = {"all": clean}
    for name, stack in without.items():
        variants[f"without_{name}"] = denoise_without(stack, everything, clean, threads=threads)
        variants[f"foreground_{name}"] = denoise_foreground(foregrounds[name], clean, threads=threads)
    return variants


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
