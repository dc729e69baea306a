"""What LuxRemix' `XXXX.meta.json` say: which lights shine how in each pass, cameras, environment."""

import colorsys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from multilight.datagen.storage.records import SceneRecord
from multilight.lights.relight import gain_matrix
from multilight.lights.sample_conditions import random_condition
from multilight.lights.spec import (
    AreaLight,
    EmissiveLight,
    EnvironmentLight,
    Light,
    LightingCondition,
    PointLight,
    Quantity,
    SpotLight,
    SunLight,
)
from multilight.scenes.arrays import Float64
from multilight.scenes.random_streams import Streams
from multilight.scenes.spec import Camera

MIXES, BACKGROUND = 4, 1000
SUN_DISTANCE = 1000.0  # metres at which a sun is said to stand
UNITS: dict[Quantity, str] = {"irradiance": "W/m2", "intensity": "W/sr", "radiance": "W/(m2 sr)"}
TYPES = {"ceil": "Ceiling", "pendant": "Ceiling", "floor": "Floor", "lamp": "Desk", "candle": "Desk"}
"""LuxRemix' words for what glows, by what its category begins with or holds; first match."""


@dataclass(frozen=True)
class Passes:
    """The passes of a scene: mixes 0000 to 0003, the background 1000, and the lights of 1001 on.

    `colours` are the lights' colours in the masks, `exposure_ev` that of the previews.
    """

    mixes: tuple[LightingCondition, ...]
    background: LightingCondition
    lights: tuple[Light, ...]
    colours: dict[str, tuple[int, int, int]]
    exposure_ev: float


def draw_passes(record: SceneRecord) -> Passes:
    """Draw three mixes beside the reference, in which all but the environment changes."""
    lights = tuple(light for light in record.rig.lights if light.kind != "environment")
    background = LightingCondition.unchanged(
        (light.name for light in record.rig.lights if light.kind == "environment"), "background"
    )
    rng = Streams(record.seed, record.index, record.attempt)("export/luxremix")
    mixes = [LightingCondition.unchanged(record.rig.names, "mix_0")]
    for number in range(1, MIXES):
        drawn = random_condition(rng, record.rig, f"mix_{number}")
        mixes.append(LightingCondition(name=drawn.name, gains=drawn.gains | background.gains))
    hues = [colorsys.hsv_to_rgb(i / max(len(lights), 1), 1.0, 1.0) for i in range(len(lights))]
    colours = {
        light.name: (round(255 * r), round(255 * g), round(255 * b))
        for light, (r, g, b) in zip(lights, hues, strict=True)
    }
    return Passes(tuple(mixes), background, lights, colours, record.conditions[0].exposure_ev)


def metadata(record: SceneRecord, passes: Passes, near_far: Sequence[tuple[float, float]]) -> dict[int, dict[str, Any]]:
    """Make the content of every pass' `meta.json`; `near_far` is the range of depth [m] of each view."""
    cameras = record.scene.cameras
    centre = np.mean([camera.pose()[:2, 3] for camera in cameras], axis=0).tolist()
    poses = [_pose(camera, depths) for camera, depths in zip(cameras, near_far, strict=True)]
    shared = {
        "scene_mod": {"added_ifg_lights": [], "added_led_signs": [], "room_id": 0, "room_center": centre},
        "camera_pose": poses,
        "blender_cfg": {
            "resolution": [cameras[0].width, cameras[0].height],
            "cam_type": "PERSP",
            "fov": poses[0]["fov"],
            "denoise": "OPENIMAGEDENOISE" if record.denoised else "NONE",
            "exposure_ev": passes.exposure_ev,
        },
        "envmap": _environment(record),
    }
    reference = passes.mixes[0]
    states = {number: (condition, None) for number, condition in enumerate(passes.mixes)}
    states |= {BACKGROUND: (reference, None)}
    alone = {BACKGROUND + i: (reference, light.name) for i, light in enumerate(passes.lights, 1)}
    return {
        number: {"lighting": _lighting(record, passes, condition, active), **shared}
        for number, (condition, active) in (states | alone).items()
    }


def _lighting(
    record: SceneRecord, passes: Passes, condition: LightingCondition, active: str | None
) -> list[dict[str, Any]]:
    names = [light.name for light in passes.lights]
    known = condition.model_copy(update={"gains": {n: g for n, g in condition.gains.items() if n in names}})
    found = []
    for light, gain in zip(passes.lights, gain_matrix(names, known), strict=True):
        quantity = np.array(light.amount) * gain
        power = float(quantity.max())
        found.append({
            "id": light.name,
            "power": power,
            "unit": UNITS[light.quantity],
            "color": [float(c) for c in quantity / power] if power > 0 else [1.0, 1.0, 1.0],
            "type": _type(record, light),
            "colorful": light.gel is not None,
            "position": [float(x) for x in _position(record, light)],
            "mask_color": list(passes.colours[light.name]),
            "update": light.name == active,
        })  # fmt: skip
    return found


def _position(record: SceneRecord, light: Light) -> Float64:
    match light:
        case SunLight():
            towards = -np.array(light.direction)
            return np.asarray(SUN_DISTANCE * towards / np.linalg.norm(towards))
        case PointLight() | SpotLight() | AreaLight():
            return np.array(light.position)
        case EmissiveLight():
            return np.array(record.scene.body(light.body).world_from_body)[:3, 3]
        case EnvironmentLight():
            return np.zeros(3)


def _type(record: SceneRecord, light: Light) -> str:
    if not isinstance(light, EmissiveLight):
        return light.kind.capitalize()
    category = record.scene.body(light.body).category
    return next((word for part, word in TYPES.items() if part in category), "LED_Sign_Plane")


def _pose(camera: Camera, near_far: tuple[float, float]) -> dict[str, Any]:
    """Say where a camera stands, its rotation (OpenGL axes to world, w x y z), and `fov` [degrees], horizontal."""
    x, y, z, w = Rotation.from_matrix(camera.pose()[:3, :3]).as_quat()
    fov = 2.0 * np.degrees(np.arctan(camera.width / (2.0 * camera.fx)))
    return {
        "position": [float(p) for p in camera.pose()[:3, 3]],
        "rotation": [float(q) for q in (w, x, y, z)],
        "fov": float(fov),
        "smpl_dist": list(near_far),
    }


def _environment(record: SceneRecord) -> dict[str, Any]:
    for light in record.rig.lights:
        if isinstance(light, EnvironmentLight):
            strength = max(light.radiance)
            colour = [channel / strength for channel in light.radiance] if strength > 0 else [1.0, 1.0, 1.0]
            named = {"id": light.map or "uniform", "env_rot": light.rotation, "env_strength": strength}
            return named | {"env_color": colour, "env_flip": False}
    return {"id": "", "env_rot": 0.0, "env_strength": 0.0, "env_color": [1.0, 1.0, 1.0], "env_flip": False}
