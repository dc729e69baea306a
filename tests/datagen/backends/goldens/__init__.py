"""Statistical goldens: what each backend rendered when it was last judged right, as mean and variance.

    python -m tests.datagen.backends.goldens mitsuba cycles

renders them anew (after a change that is meant to change pictures): `REPEATS` renders of each scene that differ in
their random numbers only. `<backend>-<scene>.npz` holds mean (L, 64, 64, 3) and variance (L, 64, 64), that of one
render's pixel averaged over the channels, both float16, both over `scale` (L,), the layer's mean radiance.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from multilight.datagen.backends.protocol import Backend, RenderJob, RenderSettings
from multilight.lights.spec import LightRig
from multilight.scenes.arrays import Float32
from multilight.scenes.cameras.pinhole import camera_from_fov, look_at
from multilight.scenes.spec import SceneSpec
from tests.datagen.backends.calibration_scenes import LIGHTS, SURFACES, calibration_scene

FOLDER = Path(__file__).parent
SIZE, SPP, REPEATS = 64, 32, 24
CASES = {
    "plastic": ("plastic", ("environment", "sun", "spot", "rectangle", "emissive")),
    "coated": ("coated", ("uniform", "bulb", "disk")),
    "bumped": ("bumped", ("point", "rectangle")),
}
"""By name: a ball's surface, and the lights."""


@dataclass(frozen=True)
class Golden:
    """Mean (L, H, W, 3) and variance (L, H, W) of one render of `SPP` samples."""

    mean: Float32
    variance: Float32


def golden_job(case: str, number: int) -> RenderJob:
    """Build the job of a case; `number` stands for other random numbers, and for nothing else."""
    surface, lights = CASES[case]
    scene = calibration_scene(SURFACES[surface])
    camera = camera_from_fov(look_at((0.3, -2.6, 1.2), (0.1, 0.0, 0.3)), width=SIZE, height=SIZE, fov=math.radians(38))
    scene = SceneSpec(kind="custom", index=number, bodies=scene.bodies, cameras=(camera,))
    rig = LightRig(lights=tuple(LIGHTS[name] for name in lights))
    return RenderJob(scene, rig, RenderSettings(spp=SPP, max_bounces=6, threads=2), 0)


def measure(backend: Backend, case: str) -> Golden:
    """Render a case again and again."""
    renders = [backend.render(golden_job(case, number)).radiance for number in range(1, REPEATS + 1)]
    stacked = np.stack(renders).astype(np.float64)
    variance = stacked.var(axis=0, ddof=1).mean(axis=-1)
    return Golden(stacked.mean(axis=0).astype(np.float32), variance.astype(np.float32))


def save(name: str, golden: Golden) -> None:
    """Write a golden, in half precision relative to each layer's mean."""
    scale = golden.mean.mean(axis=(1, 2, 3))
    np.savez_compressed(
        FOLDER / f"{name}.npz",
        scale=scale,
        mean=(golden.mean / scale[:, None, None, None]).astype(np.float16),
        variance=(golden.variance / np.square(scale)[:, None, None]).astype(np.float16),
    )


def load(name: str) -> Golden:
    """Read a golden."""
    with np.load(FOLDER / f"{name}.npz") as file:
        scale = file["scale"]
        mean = file["mean"].astype(np.float32) * scale[:, None, None, None]
        return Golden(mean, file["variance"].astype(np.float32) * np.square(scale)[:, None, None])
