"""Rigs about a still life on a table: a key of any kind from any side, and what fills its shadows."""

from dataclasses import replace
from typing import Literal

import numpy as np

from multilight.lights.photometry.colour import temperature_to_rgb
from multilight.lights.photometry.irradiance import LightMeter
from multilight.lights.photometry.radiometry import rgb_from_scalar, watts_from_photometric
from multilight.lights.rigs.balance import LightRole, balance
from multilight.lights.rigs.daylight import environment, plain_sun, rotated_to, sun_and_sky
from multilight.lights.rigs.design import LARGEST_BULB, RigDesign
from multilight.lights.rigs.lamps import LampKind, LampPlan, Tint, draw_tint, gelled, hang, white_tint
from multilight.lights.spec import EmissiveLight, EnvironmentLight, Light, LightRig, PointLight, SpotLight, SunLight
from multilight.scenes.appearance import is_mirror
from multilight.scenes.materials.emission import sample_glow
from multilight.scenes.random_streams import Rng, log_uniform, pick, weighted_pick
from multilight.scenes.spec import MeshAsset
from multilight.scenes.still_life.setting import emissive_candidate

LightKind = Literal["environment", "sun", "point", "spot", "area", "emissive"]

KEY_LUX = (150.0, 1500.0)
"""Illuminance that the key aims at [lx]: from a well-lit living room to a photographer's table."""
MAPS = frozenset({"indoor", "outdoor", "studio", "night"})
"""Categories of environment maps; skies come with their sun."""
_KIND_WEIGHTS: dict[LampKind, float] = {"point": 0.2, "spot": 0.3, "area": 0.5}
_SIZES: dict[LampKind, tuple[float, float]] = {"point": (0.003, 0.12), "spot": (0.002, 0.12), "area": (0.06, 0.9)}


_FILLS = (
    ("fill", (10.0, 80.0), (20.0, 50.0), (0.6, 1.5)),
    ("rim", (135.0, 180.0), (20.0, 50.0), (0.5, 1.5)),
    ("top", (0.0, 180.0), (62.0, 84.0), (0.5, 1.5)),
    ("kicker", (70.0, 140.0), (15.0, 35.0), (0.4, 1.2)),
    ("accent", (40.0, 160.0), (25.0, 65.0), (0.4, 1.2)),
    ("back", (120.0, 180.0), (35.0, 70.0), (0.4, 1.2)),
    ("low", (30.0, 150.0), (10.0, 20.0), (0.4, 1.0)),
)
"""Lamps beside the key, and where they may hang: azimuth from the cameras' side and elevation [degrees], and weight."""


def tabletop_rig(
    rng: Rng, meter: LightMeter, design: RigDesign, *, kinds: tuple[LightKind, ...], lights: tuple[int, int]
) -> LightRig:
    """Draw a rig of `lights` (fewest, most) lights of the given kinds for a still life on a table.

    The object that is meant to glow glows. On open ground there is always an environment: it is the horizon, and
    without it the picture ends in black. Every lamp has a free line of sight. Raises `ValueError` where `kinds` holds
    no lamp (point, spot, area).
    """
    lamp_kinds: list[LampKind] = [kind for kind in _KIND_WEIGHTS if kind in kinds]
    if not lamp_kinds:
        raise ValueError(f"a rig needs a lamp to be its key: kinds {kinds} hold none of point, spot, area")
    hard = meter.scene.kind == "spheres"
    enclosed = any(body.category in ("wall", "backdrop") for body in meter.scene.bodies)
    key = _key(rng, meter, design, kinds, uniform=hard)
    others: list[LightRole] = [glow] if "emissive" in kinds and (glow := glow_of(rng, meter)) else []
    count = max(min(design.lights, lights[1]), lights[0])
    # What a mirror shows between the walls would be a black void.
    bare = not enclosed or any(is_mirror(body) for body in meter.scene.bodies)
    may_have_sky = "environment" in kinds and not isinstance(key, EnvironmentLight)
    needs_sky = may_have_sky and bare
    count = min(max(count, 1 + len(others) + needs_sky), lights[1])
    room = count - 1 - len(others)
    if room > 0 and may_have_sky and (needs_sky or design.environment):
        key, sky = _with_environment(rng, meter, key, enclosed=enclosed, uniform=hard)
        others.append(LightRole(sky, log_uniform(rng, 0.7, 2.5)))
        room -= 1
    others += _fills(rng, meter, key, room, kinds, enclosed=enclosed)
    if hard:
        key, others = _hardened(key), [replace(role, light=_hardened(role.light)) for role in others]
    lux = log_uniform(rng, *KEY_LUX)
    return LightRig(lights=tuple(balance(key, others, meter, key_to_fill=design.key_to_fill, lux=lux)))


def key_tint(rng: Rng, design: RigDesign) -> Tint:
    """Return the colour that a design gives its key."""
    tint = white_tint(design.colour_temperature)
    return gelled(rng, tint, design.gel_saturation) if design.gel_saturation > 0 else tint


def glow_of(rng: Rng, meter: LightMeter) -> LightRole | None:
    """Let the part that is meant to shine glow as such things do (`materials.emission`), a display with its picture."""
    found = emissive_candidate(meter.scene)
    if found is None:
        return None
    name, part = found
    body = meter.scene.body(name)
    assert isinstance(body.geometry, MeshAsset)
    scale = float(np.cbrt(np.linalg.det(np.array(body.world_from_body)[:3, :3])))
    glow = sample_glow(rng, meter.library, meter.library.info(body.geometry.asset), part, scale=scale)
    tint = white_tint(glow.kelvin)
    if glow.coloured:
        tint = gelled(rng, tint, float(rng.uniform(0.5, 0.95)))
    radiance = rgb_from_scalar(watts_from_photometric(glow.nits), tint.rgb)
    light = EmissiveLight(name="glow", colour_temperature=tint.temperature, gel=tint.gel, body=name, part=part,
                          radiance=radiance, texture=glow.texture)  # fmt: skip
    return LightRole(light, unit=meter.table_irradiance(light), fixed=True)


def _key(rng: Rng, meter: LightMeter, design: RigDesign, kinds: tuple[LightKind, ...], *, uniform: bool) -> Light:
    """Place the key as designed; what the scene or the kinds do not allow becomes a lamp."""
    azimuth = meter.camera + design.azimuth
    if design.key == "environment" and "environment" in kinds:
        wanted = frozenset[str]() if uniform else MAPS
        light = environment(rng, meter, key_tint(rng, design), name="environment", categories=wanted)
        return rotated_to(light, meter, azimuth)
    if design.key == "sun" and "sun" in kinds:
        sun = plain_sun(rng, meter, azimuth, design.elevation)
        if sun is not None:
            rgb = temperature_to_rgb(design.colour_temperature) if design.gel_saturation > 0 else sun.irradiance
            return sun.model_copy(update={"irradiance": rgb, "angle": min(max(design.angular_size, 0.001), 0.3)})
    lamp_kinds = [kind for kind in _KIND_WEIGHTS if kind in kinds]
    kind = design.key if design.key in lamp_kinds else pick(rng, lamp_kinds)
    size = design.angular_size if kind == "area" or design.angular_size < LARGEST_BULB else 0.1
    plan = LampPlan("key", kind, design.azimuth, design.elevation, size, key_tint(rng, design), design.shaping)
    return hang(rng, meter, plan)


def _with_environment(
    rng: Rng, meter: LightMeter, key: Light, *, enclosed: bool, uniform: bool
) -> tuple[Light, EnvironmentLight]:
    """Add an environment beside the key; a sun on open ground may bring its own sky."""
    tint = draw_tint(rng, gels=0.0, median=6000.0)
    if isinstance(key, SunLight) and not enclosed and not uniform and rng.random() < 0.6:
        x, y, z = -np.array(key.direction)
        sun, sky = sun_and_sky(float(np.arctan2(y, x)), float(np.arcsin(z)), rng.choice([2.0, 3.0]))
        return sun.model_copy(update={"angle": key.angle}), sky
    wanted = frozenset[str]() if uniform else MAPS
    return key, environment(rng, meter, tint, name="environment", categories=wanted)


def _fills(
    rng: Rng, meter: LightMeter, key: Light, room: int, kinds: tuple[LightKind, ...], *, enclosed: bool
) -> list[LightRole]:
    """Draw the lights beside key, glow and environment: lamps, now and then a sun or one environment more."""
    roles: list[LightRole] = []
    hard = meter.scene.kind == "spheres"
    if room > 0 and "sun" in kinds and not isinstance(key, SunLight) and rng.random() < 0.25:
        wanted = meter.camera + rng.choice([-1.0, 1.0]) * np.radians(rng.uniform(40.0, 170.0))
        sun = plain_sun(rng, meter, float(wanted), float(np.radians(rng.uniform(15.0, 65.0))))
        roles += [] if sun is None else [LightRole(sun, log_uniform(rng, 0.7, 2.5))]
    if room > len(roles) + 1 and enclosed and not hard and "environment" in kinds and rng.random() < 0.15:
        tint = draw_tint(rng, gels=0.5, median=6000.0)
        roles.append(LightRole(environment(rng, meter, tint, name="ambient", categories=MAPS), 0.7))
    odds = {kind: weight for kind, weight in _KIND_WEIGHTS.items() if kind in kinds}
    for i in rng.permutation(len(_FILLS))[: max(0, room - len(roles))]:
        name, azimuth, elevation, strength = _FILLS[int(i)]
        kind = weighted_pick(rng, odds)
        plan = LampPlan(
            name,
            kind,
            float(rng.choice([-1.0, 1.0]) * np.radians(rng.uniform(*azimuth))),
            float(np.radians(rng.uniform(*elevation))),
            log_uniform(rng, *_SIZES[kind]),
            draw_tint(rng, gels=0.14),
            "gobo" if rng.random() < 0.15 else "profile" if rng.random() < 0.4 else "plain",
        )
        roles.append(LightRole(hang(rng, meter, plan), log_uniform(rng, *strength)))
    return roles


def _hardened(light: Light) -> Light:
    """Strip a light to what the closed-form renderer draws: points without size, distribution or gobo."""
    match light:
        case PointLight():
            return light.model_copy(update={"radius": 0.0, "profile": None})
        case SpotLight():
            return light.model_copy(update={"radius": 0.0, "gobo": None})
        case _:
            return light
