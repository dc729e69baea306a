"""Tuples (composite, background, depth, target) a core-second at equal quality, three ways, side by side in one run.

(a) Mitsuba, light by light; (b) Cycles, light by light with light groups; (c) Cycles, each lighting condition
rendered anew with everything and without each object, and denoised, as other pipelines do (a mask then cuts the
object out). Same scene, size and views. Each way takes the fewest samples whose denoised targets lie, on the average
over the conditions, `--quality` dB from its own renderer's converged picture (8-bit, tone-mapped; itself denoised).
Seconds are those of all cores together. (c) is timed on a few conditions and counted for all.

    python benchmarks/tuples.py --seed 3
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import tyro

from datagen.backends import Backend, RendererName, RenderJob, RenderSettings, open_backend
from datagen.config import DatasetConfig
from datagen.denoise import denoise_all
from datagen.layers import Float32, LayerStack
from datagen.produce import sample_scene
from datagen.stopwatch import Stopwatch
from datagen.store import ViewData
from datagen.views import Shoot, render_view
from lights.conditions import sample_conditions
from lights.relight import mix
from lights.rigs import scaled
from lights.spec import LightingCondition, LightRig
from lights.tonemap import meter_ev, to_display
from scenes.assets.library import AssetLibrary
from scenes.spec import SceneSpec
from scenes.streams import Streams

LADDER = (16, 32, 64, 128, 256, 512, 1024)


@dataclass
class Options:
    """What to measure."""

    size: int = 256
    seed: int = 3
    view: int = 6
    conditions: int = 12
    quality: float = 40.0
    reference_spp: int = 4096
    timed_conditions: int = 1
    """Of (c), how many are rendered and timed."""


@dataclass
class Case:
    """What all ways have in common."""

    scene: SceneSpec
    rig: LightRig
    conditions: tuple[LightingCondition, ...]
    options: Options
    converged: dict[str, Float32] = field(default_factory=dict)

    def settings(self, spp: int) -> RenderSettings:
        """Return how to render, on all cores."""
        return RenderSettings(spp=spp)

    def job(self, spp: int, rig: LightRig | None = None, variant: str = "all") -> RenderJob:
        """Return one render of the view."""
        return RenderJob(self.scene, rig or self.rig, self.settings(spp), self.options.view, variant)

    def decibels(self, picture: Float32, condition: LightingCondition, renderer: str) -> float:
        """Return how near a picture is to the converged one of its renderer, both as they would be shown."""
        truth = mix(self.converged[renderer], self.rig.names, condition)
        exposure = meter_ev(truth)
        shown, wanted = (to_display(p, exposure).astype(np.float64) for p in (picture, truth))
        return float(10 * np.log10(255**2 / max(np.mean((shown - wanted) ** 2), 1e-9)))


def relit(rig: LightRig, condition: LightingCondition) -> LightRig:
    """Build the rig that a renderer would be given for one condition (gains' mean: the cost does not depend on hue)."""
    lights = [
        scaled(light, float(np.mean(condition.gains[light.name])))
        for light in rig.lights
        if np.any(condition.gains.get(light.name, 0))
    ]
    return LightRig(lights=tuple(lights))


def grey_gains(condition: LightingCondition) -> LightingCondition:
    """Return the condition that `relit` renders, without its exposure."""
    gains = {name: (float(np.mean(gain)),) * 3 for name, gain in condition.gains.items()}
    return condition.model_copy(update={"gains": gains, "exposure_ev": 0.0})


def render_converged(backend: Backend, case: Case) -> Float32:
    """Render the layers of variant `all` with many samples; what noise is left is denoised."""
    return denoise_all(backend.render(case.job(case.options.reference_spp)))


def light_by_light(backend: Backend, case: Case, spp: int, view: int) -> tuple[float, ViewData]:
    """Render and denoise a view with all its variants, and mix every tuple; returns core-seconds and the view."""
    shoot = Shoot(backend, case.scene, case.rig, case.settings(spp), denoise=True, keep_raw=False)
    start = time.process_time()
    data = render_view(shoot, view, Stopwatch()).data
    make_tuples(case, data)
    return time.process_time() - start, data


def make_tuples(case: Case, data: ViewData) -> None:
    """Mix every tuple: each variant under each condition once, then each object over each background."""

    def lit(variant: str) -> list[Float32]:
        return [mix(data.variants[variant], data.lights, condition) for condition in case.conditions]

    lit("all")
    for name in case.scene.insertable:
        clear = 1 - data.coverage[name][..., None]
        objects = lit(f"foreground_{name}")
        for background in lit(f"without_{name}"):
            behind = clear * background
            for thing in objects:
                np.add(thing, behind)


def one_by_one(backend: Backend, case: Case, spp: int, condition: LightingCondition) -> tuple[float, Float32]:
    """Render one condition with everything and without each object, denoised; returns core-seconds and the target."""
    rig = relit(case.rig, condition)
    pictures = []
    backend.render(case.job(spp, rig))  # loads the scene
    start = time.process_time()
    for variant in ("all", *(f"without_{name}" for name in case.scene.insertable)):
        stack = backend.render(case.job(spp, rig, variant))
        whole = LayerStack(
            ("all",),
            stack.combined[None],
            stack.combined,
            guide_albedo=stack.guide_albedo,
            guide_normal=stack.guide_normal,
        )
        pictures.append(denoise_all(whole)[0])
    return time.process_time() - start, pictures[0]


def climb(title: str, case: Case, attempt: Callable[[int], tuple[float, float]]) -> float:
    """Go up the ladder of samples until the quality is reached; returns tuples a core-second there."""
    tuples = len(case.scene.insertable) * len(case.conditions) ** 2
    for spp in LADDER:
        seconds, decibels = attempt(spp)
        print(
            f"{title:36}{spp:5} spp {decibels:6.1f} dB {seconds:9.2f} core-s {tuples / seconds:9.2f} tuples/s",
            flush=True,
        )
        if decibels >= case.options.quality:
            break
    else:
        print(f"{title:36} does not reach {case.options.quality} dB with {LADDER[-1]} samples; its last figure counts")
    return tuples / seconds


def measure_layers(title: str, renderer: RendererName, case: Case, library: AssetLibrary) -> float:
    """Measure (a) or (b)."""
    with open_backend(renderer, library) as backend:
        case.converged[renderer] = render_converged(backend, case)

        def attempt(spp: int) -> tuple[float, float]:
            # Another view first: what is done once a scene (loading, compiling) is shared by all its views.
            light_by_light(backend, case, spp, 0)
            seconds, data = light_by_light(backend, case, spp, case.options.view)
            quality = [case.decibels(mix(data.variants["all"], data.lights, c), c, renderer) for c in case.conditions]
            return seconds, float(np.mean(quality))

        return climb(title, case, attempt)


def measure_conditions(title: str, case: Case, library: AssetLibrary) -> float:
    """Measure (c)."""
    chosen = case.conditions[: case.options.timed_conditions]
    with open_backend("cycles", library) as backend:

        def attempt(spp: int) -> tuple[float, float]:
            made = [one_by_one(backend, case, spp, condition) for condition in chosen]
            quality = [
                case.decibels(picture, grey_gains(condition), "cycles")
                for condition, (_, picture) in zip(chosen, made, strict=True)
            ]
            seconds = float(np.mean([seconds for seconds, _ in made])) * len(case.conditions)
            return seconds, float(np.mean(quality))

        return climb(title, case, attempt)


def main(options: Options) -> None:
    """Print tuples a core-second for the three ways, and their ratios."""
    config = DatasetConfig(seed=options.seed, width=options.size, height=options.size)
    library, streams = AssetLibrary(), Streams(options.seed, 0)
    scene, rig = sample_scene(config, library, streams)
    case = Case(scene, rig, sample_conditions(streams("conditions"), rig, options.conditions), options)
    print(f"{options.size}x{options.size}, {len(rig.lights)} lights, {len(scene.insertable)} objects, "
          f"{options.conditions} conditions, at least {options.quality} dB")  # fmt: skip
    a = measure_layers("(a) Mitsuba, light by light", "mitsuba", case, library)
    b = measure_layers("(b) Cycles, light groups", "cycles", case, library)
    c = measure_conditions("(c) Cycles, one render a condition", case, library)
    print(f"ratios: (a)/(b) {a / b:.1f}, (b)/(c) {b / c:.1f}, (a)/(c) {a / c:.1f}")


if __name__ == "__main__":
    main(tyro.cli(Options))
