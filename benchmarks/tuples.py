"""Tuples (composite, background, depth, target) a core-second at equal quality, by three methods, side by side.

(a) Mitsuba, light by light; (b) Cycles, light by light with light groups; (c) Cycles, each lighting condition
rendered anew with everything and without each object, with Cycles' own denoiser and without light groups, as other
pipelines do (a mask then cuts the object out). Same scene, size and view.

Quality is the PSNR of the target as shown (8 bits, tone-mapped) against a converged render of the same renderer,
averaged over the conditions. The converged render is not denoised, so that no method's denoiser is favoured. Each
method gets the fewest samples (8, 12, 16, 24 …, or half a step less) that reach `--quality`, or where a method does not
reach it with `--most-spp`, what all of them reach: that is said. Seconds are user and system time of all cores. Loading
and compiling are shared by a scene's views and told apart. (c) is linear in conditions: `--timed-conditions` of them
are rendered, each in all its variants, and counted for all.

Cycles' own adaptive sampling is off: at the few thresholds tried, (c) took longer to 40 dB with it on a tabletop, and
did not get there in a studio.

Choose scenes whose references converge with `--reference-spp`: with glass and enclosed lamps what noise is left in the
reference, not the methods, decides how many decibels are reached.

    python -m benchmarks.tuples --cases tabletop:7 studio:1
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import bpy
import numpy as np
import tyro

from multilight.datagen.backends.blender.backend import BlenderBackend, hidden
from multilight.datagen.backends.blender.film import beauty_filter, render_passes
from multilight.datagen.backends.blender.scene import place_camera
from multilight.datagen.backends.choose import open_backend
from multilight.datagen.backends.protocol import Backend, RenderJob, RenderSettings
from multilight.datagen.config.dataset import DatasetConfig
from multilight.datagen.production.denoise import denoise_all
from multilight.datagen.production.scene import sample_scene
from multilight.datagen.production.stopwatch import Stopwatch
from multilight.datagen.production.view import SceneSetup, render_view
from multilight.datagen.storage.object_variants import ALL, Variant
from multilight.datagen.storage.store import ViewData
from multilight.lights.display.tonemap import meter_ev, to_display
from multilight.lights.relight import mix
from multilight.lights.sample_conditions import sample_conditions
from multilight.lights.spec import LightingCondition, LightRig
from multilight.scenes.arrays import Float32
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.random_streams import Streams
from multilight.scenes.spec import SceneSpec

LEAST_SPP = 8


@dataclass
class Options:
    """What to measure."""

    cases: tuple[str, ...] = ("tabletop:7", "studio:1")
    """Kinds of scene and seeds."""
    size: int = 96
    view: int = 6
    conditions: int = 12
    quality: float = 40.0
    most_spp: int = 768
    reference_spp: int = 4096
    timed_conditions: int = 2


@dataclass
class Case:
    """What all methods have in common."""

    scene: SceneSpec
    rig: LightRig
    conditions: tuple[LightingCondition, ...]
    options: Options
    converged: dict[str, Float32] = field(default_factory=dict)

    def job(self, spp: int, variant: str = ALL) -> RenderJob:
        """Return one render of the view, on all cores."""
        return RenderJob(self.scene, self.rig, RenderSettings(spp=spp), self.options.view, variant)

    def converge(self, backend: Backend) -> None:
        """Render the layers of variant `all` with many samples and other random numbers."""
        bodies = tuple(body.model_copy(update={"insertable": False}) for body in self.scene.bodies)
        plain = self.scene.model_copy(update={"bodies": bodies})
        settings = RenderSettings(spp=self.options.reference_spp)
        self.converged[backend.name] = backend.render(RenderJob(plain, self.rig, settings, self.options.view)).radiance

    def decibels(self, picture: Float32, condition: LightingCondition, renderer: str) -> float:
        """Return how near a picture is to the converged one of its renderer, both as they would be shown."""
        truth = mix(self.converged[renderer], self.rig.names, condition)
        exposure = meter_ev(truth)
        shown, wanted = (to_display(p, exposure).astype(np.float64) for p in (picture, truth))
        return float(10 * np.log10(255**2 / max(np.mean((shown - wanted) ** 2), 1e-9)))


@dataclass
class Method:
    """One method: its quality by samples a pixel, and how its cost at some samples is measured."""

    title: str
    ladder: dict[int, float]
    cost: Callable[[int], float]


def relit(rig: LightRig, condition: LightingCondition) -> LightRig:
    """Build the rig that a renderer would be given for one condition (gains' mean: the cost does not depend on hue)."""
    lights = [
        light.scaled(float(np.mean(condition.gains[light.name])))
        for light in rig.lights
        if np.any(condition.gains.get(light.name, 0))
    ]
    return LightRig(lights=tuple(lights))


def grey_gains(condition: LightingCondition) -> LightingCondition:
    """Return the condition that `relit` renders, without its exposure."""
    gains = {name: (float(np.mean(gain)),) * 3 for name, gain in condition.gains.items()}
    return condition.model_copy(update={"gains": gains, "exposure_ev": 0.0})


class OneByOne:
    """Renders whole pictures: no light groups, Cycles' denoiser with guides that it has cleaned first (its default)."""

    def __init__(self, backend: Any) -> None:
        assert isinstance(backend, BlenderBackend)
        self._backend = backend
        self._loaded: tuple[LightingCondition, int] | None = None
        self._synced: Any = None

    def load(self, case: Case, condition: LightingCondition, spp: int) -> None:
        """Put the scene into Blender, with the condition's lights."""
        if self._loaded == (condition, spp) and self._backend.synced is self._synced:
            return
        job = RenderJob(case.scene, relit(case.rig, condition), RenderSettings(spp=spp), case.options.view)
        self._synced = self._backend.sync(job, keep=False)  # what follows is not what its next job may find
        scene = bpy.context.scene
        groups = scene.view_layers[0].lightgroups
        for group in list(groups):
            groups.remove(group)
        scene.cycles.use_denoising, scene.cycles.denoiser = True, "OPENIMAGEDENOISE"
        scene.cycles.denoising_input_passes, scene.cycles.denoising_prefilter = "RGB_ALBEDO_NORMAL", "ACCURATE"
        place_camera(case.scene.cameras[case.options.view])
        scene.cycles.seed = 1
        beauty_filter(1)
        render_passes()
        beauty_filter(spp)
        self._loaded = (condition, spp)

    def render(self, case: Case, condition: LightingCondition, spp: int, without: str | None) -> Float32:
        """Render everything, or all but one object: (H, W, 3)."""
        self.load(case, condition, spp)
        if without is None:
            return np.ascontiguousarray(render_passes()["Combined"][..., :3])
        with hidden(self._synced, without):
            return np.ascontiguousarray(render_passes()["Combined"][..., :3])


def climb(title: str, options: Options, quality: Callable[[int], float]) -> dict[int, float]:
    """Raise the samples until the quality is reached, then try half the last step; returns the quality by samples."""
    ladder: dict[int, float] = {}

    def reached(spp: int) -> bool:
        ladder[spp] = quality(spp)
        print(f"  {title:36}{spp:5} spp {ladder[spp]:6.1f} dB", flush=True)
        return ladder[spp] >= options.quality

    for below, spp in pairwise((0, *steps(options.most_spp))):
        if reached(spp):
            if below:
                reached((below + spp) // 2)
            break
    return ladder


def steps(most: int) -> list[int]:
    """Return powers of two and one and a half times these: 8, 12, 16, 24 … up to `most`."""
    powers = [LEAST_SPP << i for i in range((most // LEAST_SPP).bit_length())]
    return sorted(spp for power in powers for spp in (power, power * 3 // 2) if spp <= most)


def make_tuples(case: Case, data: ViewData) -> None:
    """Mix every tuple: each variant under each condition once, then each object over each background."""

    def lit(variant: str) -> list[Float32]:
        return [mix(data.variants[variant], data.lights, condition) for condition in case.conditions]

    lit(ALL)
    for name in case.scene.insertable:
        clear = 1 - data.coverage[name][..., None]
        objects = lit(Variant.foreground(name))
        for background in lit(Variant.without(name)):
            behind = clear * background
            for thing in objects:
                np.add(thing, behind)


def light_by_light(title: str, backend: Backend, case: Case) -> Method:
    """Measure (a) or (b)."""

    def quality(spp: int) -> float:
        layers = denoise_all(backend.render(case.job(spp)))
        return float(np.mean([case.decibels(mix(layers, case.rig.names, c), c, backend.name) for c in case.conditions]))

    def whole_view(spp: int, view: int) -> float:
        setup = SceneSetup(backend, case.scene, case.rig, RenderSettings(spp=spp), denoise=True, keep_raw=False)
        start, watch = time.process_time(), Stopwatch()
        make_tuples(case, render_view(setup, view, watch).data)
        seconds = time.process_time() - start
        spent = watch.seconds()
        fractions = ", ".join(f"{stage} {value / sum(spent.values()):.0%}" for stage, value in spent.items())
        print(f"  {title:36}{spp:5} spp {seconds:6.1f} core-s for view {view} ({fractions} of the time)", flush=True)
        return seconds

    def cost(spp: int) -> float:
        # Another view first: what is done once a scene (loading, compiling) is shared by all its views.
        whole_view(spp, other)
        return whole_view(spp, case.options.view)

    other = (case.options.view + 1) % len(case.scene.cameras)
    first, second = (whole_view(LEAST_SPP, view) for view in (other, case.options.view))
    once = max(first - second, 0)
    print(f"  {title:36}once a scene {once:.1f} core-s: loading, and compiling what no run before had")
    case.converge(backend)
    return Method(title, climb(title, case.options, quality), cost)


def condition_by_condition(title: str, backend: OneByOne, case: Case) -> Method:
    """Measure (c); needs Cycles' converged layers."""
    count = min(case.options.timed_conditions, len(case.conditions))
    chosen = [case.conditions[i] for i in np.linspace(0, len(case.conditions) - 1, count).astype(int)]

    def quality(spp: int) -> float:
        pictures = [backend.render(case, condition, spp, None) for condition in chosen]
        pairs = zip(pictures, map(grey_gains, chosen), strict=True)
        return float(np.mean([case.decibels(picture, condition, "cycles") for picture, condition in pairs]))

    def cost(spp: int) -> float:
        seconds = 0.0
        for condition in chosen:
            backend.load(case, condition, spp)
            start = time.process_time()
            for name in (None, *case.scene.insertable):
                backend.render(case, condition, spp, name)
            seconds += time.process_time() - start
        total = seconds * len(case.conditions) / count
        print(f"  {title:36}{spp:5} spp {seconds:6.1f} core-s for {count} conditions, so {total:.1f} for all")
        return total

    return Method(title, climb(title, case.options, quality), cost)


def measure(case: Case, library: AssetLibrary) -> None:
    """Print tuples a core-second of one case, by three methods, and their ratios."""
    options = case.options
    with open_backend("mitsuba", library) as mitsuba, open_backend("cycles", library) as cycles:
        methods = [
            light_by_light("(a) Mitsuba, light by light", mitsuba, case),
            light_by_light("(b) Cycles, light groups", cycles, case),
            condition_by_condition("(c) Cycles, one render a condition", OneByOne(cycles), case),
        ]
        quality = min(options.quality, *(max(method.ladder.values()) for method in methods))
        if quality < options.quality:
            print(f"  not all reach {options.quality} dB with {options.most_spp} samples: compared at {quality:.1f} dB")
        tuples = len(case.scene.insertable) * len(case.conditions) ** 2
        rates = []
        for method in methods:
            spp = min(spp for spp, decibels in method.ladder.items() if decibels >= quality)
            rates.append(tuples / method.cost(spp))
            reached = f"{spp:5} spp {method.ladder[spp]:6.1f} dB"
            print(f"  {method.title:36}{reached} {rates[-1]:9.2f} tuples a core-s", flush=True)
        a, b, c = rates
        print(f"  ratios: (a)/(b) {a / b:.1f}, (b)/(c) {b / c:.1f}, (a)/(c) {a / c:.1f}", flush=True)


def main(options: Options) -> None:
    """Measure every case."""
    library = AssetLibrary()
    for named in options.cases:
        kind, _, seed = named.partition(":")
        config = DatasetConfig(seed=int(seed), kind=kind, width=options.size, height=options.size)
        streams = Streams(config.seed, 0)
        scene, rig = sample_scene(config, library, streams)
        case = Case(scene, rig, sample_conditions(streams("conditions"), rig, options.conditions), options)
        print(f"{named}: {options.size}x{options.size}, {len(rig.lights)} lights, {len(scene.insertable)} objects, "
              f"{len(case.conditions)} conditions, at least {options.quality} dB", flush=True)  # fmt: skip
        measure(case, library)


if __name__ == "__main__":
    main(tyro.cli(Options))
