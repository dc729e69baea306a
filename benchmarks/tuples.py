"""Seconds per (composite, background, depth, target) tuple: light by light against one render a condition.

Both ways render the same sampled scene with Cycles at the same size and samples, in one run, alternating views.
With C conditions a view and object give C x C tuples. Rendering every condition anew costs C full renders of the
scene with everything and C without the object (a mask then cuts the object out); light by light costs one of each,
and one of the object alone.

    python benchmarks/tuples.py --size 256 --spp 16 --views 3 --conditions 12
"""

import time
from dataclasses import dataclass

import numpy as np
import tyro

from datagen.backends import Backend, RenderJob, RenderSettings, open_backend
from datagen.compose import composite, target
from datagen.config import DatasetConfig
from datagen.denoise import denoise_all, denoise_foreground, denoise_without
from datagen.produce import sample_scene
from datagen.store import ViewData
from lights.conditions import sample_conditions
from lights.rigs import scaled
from lights.spec import LightingCondition, LightRig
from scenes.assets.library import AssetLibrary
from scenes.spec import SceneSpec
from scenes.streams import Streams


@dataclass
class Options:
    """What to measure."""

    size: int = 256
    spp: int = 16
    views: int = 3
    conditions: int = 12
    seed: int = 0


def relit(rig: LightRig, condition: LightingCondition) -> LightRig:
    """Build the rig that a renderer would be given for one condition (gains' mean: the cost does not depend on hue)."""
    lights = [
        scaled(light, float(np.mean(condition.gains[light.name])))
        for light in rig.lights
        if light.name in condition.gains
    ]
    return LightRig(lights=tuple(lights))


def one_by_one(backend: Backend, scene: SceneSpec, rigs: list[LightRig], settings: RenderSettings, view: int) -> float:
    """Render every condition anew, for one object, each denoised; returns seconds."""
    start = time.perf_counter()
    name = scene.insertable[0]
    for rig in rigs:
        stacks = [
            backend.render(RenderJob(scene, rig, settings, view, variant)) for variant in ("all", f"without_{name}")
        ]
        for stack in stacks:
            whole = type(stack)(
                ("all",),
                stack.combined[None],
                stack.combined,
                guide_albedo=stack.guide_albedo,
                guide_normal=stack.guide_normal,
            )
            denoise_all(whole)
    return time.perf_counter() - start


def light_by_light(
    backend: Backend,
    scene: SceneSpec,
    rig: LightRig,
    settings: RenderSettings,
    view: int,
    conditions: tuple[LightingCondition, ...],
) -> float:
    """Render the layers once and mix every tuple, for one object; returns seconds."""
    start = time.perf_counter()
    name = scene.insertable[0]
    everything, without, foreground = (
        backend.render(RenderJob(scene, rig, settings, view, variant))
        for variant in ("all", f"without_{name}", f"foreground_{name}")
    )
    assert everything.geometry is not None
    assert foreground.coverage is not None
    clean = denoise_all(everything)
    data = ViewData(
        rig.names,
        {
            "all": clean,
            f"without_{name}": denoise_without(without, everything, clean),
            f"foreground_{name}": denoise_foreground(foreground, clean),
        },
        {name: foreground.coverage},
        everything.geometry,
        everything.combined,
    )
    for base in conditions:
        target(data, base)
        for insert in conditions:
            composite(data, name, insert=insert, base=base)
    return time.perf_counter() - start


def main(options: Options) -> None:
    """Print seconds a tuple for both ways, and their ratio."""
    config = DatasetConfig(seed=options.seed, width=options.size, height=options.size, spp=options.spp)
    library, streams = AssetLibrary(), Streams(options.seed, 0)
    scene, rig = sample_scene(config, library, streams)
    conditions = sample_conditions(streams("conditions"), rig, options.conditions)
    settings = RenderSettings(spp=options.spp)
    rigs = [relit(rig, condition) for condition in conditions]
    ours, theirs = [], []
    with open_backend("cycles", library) as backend:
        backend.render(RenderJob(scene, rig, RenderSettings(spp=1), 0))
        for view in np.linspace(0, len(scene.cameras) - 1, options.views).astype(int):
            ours.append(light_by_light(backend, scene, rig, settings, int(view), conditions))
            theirs.append(one_by_one(backend, scene, rigs, settings, int(view)))
    tuples = options.conditions**2
    print(
        f"{options.size}x{options.size}, {options.spp} spp, {len(rig.lights)} lights, {tuples} tuples a view and object"
    )
    for title, seconds in (("light by light", ours), ("one render a condition", theirs)):
        median = np.median(seconds)
        print(f"{title + ':':26}{median / tuples:9.5f} s a tuple ({median:.2f} s a view and object)")
    print(f"ratio, view by view:      {np.median(np.array(theirs) / np.array(ours)):9.1f}")


if __name__ == "__main__":
    main(tyro.cli(Options))
