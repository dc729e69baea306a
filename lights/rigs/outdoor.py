"""Rigs under the sky: sun and sky, overcast, golden hour, a photographed place, or night with practical lamps."""

import numpy as np

from multilight.lights.photometry.irradiance import LightMeter
from multilight.lights.rigs.balance import NOTHING, LightRole, balance
from multilight.lights.rigs.daylight import environment, moon, open_direction, overcast, rotated_to, sun_and_sky
from multilight.lights.rigs.design import ELEVATIONS, RigDesign
from multilight.lights.rigs.lamps import LampKind, LampPlan, draw_tint, hang
from multilight.lights.rigs.tabletop import glow_of, key_tint
from multilight.lights.spec import Light, LightRig
from multilight.scenes.random_streams import Rng, log_uniform, pick_at, weighted_pick

MOODS = {"sun": 0.36, "golden": 0.2, "overcast": 0.12, "place": 0.16, "night": 0.16}
"""What the weather and the hour are, with their probabilities."""
GOLDEN, DAY = (6.0, 17.0), (12.0, 62.0)
"""Elevations of the sun [degrees] in the golden hour, and by day in middle latitudes."""
PLACE_LUX, NIGHT_LUX = (1000.0, 30_000.0), (8.0, 120.0)
"""Illuminance in a photographed place by day, whose own level is not known, and under practical lamps [lx]."""


_Span = tuple[float, float]
_HELPERS: tuple[tuple[str, LampKind, _Span, _Span, _Span, _Span], ...] = (
    ("reflector", "area", (40.0, 110.0), (15.0, 40.0), (0.5, 1.0), (0.08, 0.35)),
    ("flash", "spot", (60.0, 170.0), (20.0, 55.0), (0.004, 0.06), (0.15, 0.8)),
    ("rim", "area", (130.0, 180.0), (15.0, 45.0), (0.1, 0.5), (0.15, 0.6)),
    ("diffuser", "area", (0.0, 180.0), (55.0, 80.0), (0.4, 1.0), (0.1, 0.5)),
    ("accent", "spot", (20.0, 150.0), (15.0, 60.0), (0.004, 0.1), (0.1, 0.5)),
    ("kicker", "area", (80.0, 150.0), (12.0, 30.0), (0.1, 0.4), (0.1, 0.4)),
)
"""Reflectors and flashes: name, kind, azimuth from the cameras to either side and elevation [degrees], angular diameter
[rad], and level against the daylight."""
_PRACTICALS: dict[str, tuple[LampKind, float, float]] = {
    "lantern": ("point", 2600.0, 0.15),
    "street_lamp": ("point", 2600.0, 0.15),
    "window": ("area", 2600.0, 0.15),
    "sign": ("area", 2600.0, 0.5),
    "headlight": ("spot", 4500.0, 0.15),
    "torch": ("spot", 2600.0, 0.15),
}
"""What shines by night: its kind, median colour temperature [K], and probability of a gel."""


def outdoor_rig(rng: Rng, meter: LightMeter, design: RigDesign, *, lights: tuple[int, int]) -> LightRig:
    """Draw an outdoor rig of `lights` (fewest, most) lights; sun and sky keep their true strengths.

    One light alone by day is the sky: open shade. Beside sun or sky stand reflectors and flashes.
    """
    mood = pick_at(design.mood, MOODS)
    count = min(max(design.lights, lights[0]), lights[1])
    glow = glow_of(rng, meter)
    if glow is not None and mood in ("sun", "place"):
        mood = "night"  # in full daylight what glows would hardly show
    if mood == "night":
        return _night(rng, meter, design, max(count, 2), glow)
    daylight = _place(rng, meter, design) if mood == "place" else _daylight(rng, meter, design, mood, count)
    level = meter.dome_irradiance(daylight[0])
    rig = list(daylight)
    if glow is not None:
        rig.append(glow.light)
    for role in _helpers(rng, meter, count - len(rig)):
        rig.append(role.light.scaled(level * role.strength / max(meter.dome_irradiance(role.light), NOTHING)))
    return LightRig(lights=tuple(rig))


def _daylight(rng: Rng, meter: LightMeter, design: RigDesign, mood: str, count: int) -> list[Light]:
    """Return sun and sky in their true strengths, or the sky alone."""
    low, high = GOLDEN if mood == "golden" else DAY
    height = float(np.radians(low + (high - low) * (np.degrees(design.elevation) - ELEVATIONS[0]) / np.ptp(ELEVATIONS)))
    found = open_direction(rng, meter, meter.camera + design.azimuth, height)
    if mood == "overcast" or found is None:
        return [overcast(float(rng.uniform(0.0, 2 * np.pi)))]
    # Where something stands before the sun it moves round, but does not rise: the hour is the mood's.
    haze = 2.0 if mood == "golden" else weighted_pick(rng, {2.0: 0.4, 3.0: 0.4, 6.0: 0.2})
    sun, sky = sun_and_sky(found[0], height, haze)
    return [sun, sky] if count > 1 else [sky]


def _place(rng: Rng, meter: LightMeter, design: RigDesign) -> list[Light]:
    """Return the map of a real place by day, its brightest side where the design has the key."""
    tint = draw_tint(rng, gels=0.0, median=6500.0)
    light = environment(rng, meter, tint, name="environment", categories=frozenset({"outdoor"}))
    light = rotated_to(light, meter, meter.camera + design.azimuth)
    lux = log_uniform(rng, *PLACE_LUX)
    return balance(light, (), meter, key_to_fill=1.0, lux=lux)


def _helpers(rng: Rng, meter: LightMeter, room: int) -> list[LightRole]:
    """Stand up to `room` reflectors and flashes about the subject, each a part of the daylight."""
    roles = []
    for i in rng.permutation(len(_HELPERS))[: max(0, room)]:
        name, kind, azimuth, elevation, size, strength = _HELPERS[int(i)]
        side = float(rng.choice([-1.0, 1.0]) * np.radians(rng.uniform(*azimuth)))
        tint = draw_tint(rng, gels=0.0 if name in ("reflector", "diffuser") else 0.3, median=5400.0)
        height = float(np.radians(rng.uniform(*elevation)))
        plan = LampPlan(name, kind, side, height, log_uniform(rng, *size), tint)
        roles.append(LightRole(hang(rng, meter, plan), log_uniform(rng, *strength)))
    return roles


def _night(rng: Rng, meter: LightMeter, design: RigDesign, count: int, glow: LightRole | None) -> LightRig:
    """Light the subject with lanterns and street lamps under a night sky, maybe with the moon."""
    kind: LampKind = "spot" if design.key == "spot" else "point"
    size = min(design.angular_size, 0.2)
    shaping = "profile" if kind == "point" and design.shaping != "plain" else "plain"
    elevation = max(design.elevation, 0.3)
    key = hang(rng, meter, LampPlan("lamp", kind, design.azimuth, elevation, size, key_tint(rng, design), shaping))
    tint = draw_tint(rng, gels=0.0, median=9000.0)
    sky = environment(rng, meter, tint, name="environment", categories=frozenset({"night"}))
    others = ([glow] if glow else []) + [LightRole(sky, log_uniform(rng, 0.3, 1.0))]
    room = count - 1 - len(others)
    if room > 0 and rng.random() < 0.5:
        azimuth = meter.camera + float(rng.uniform(-np.pi, np.pi))
        found = open_direction(rng, meter, azimuth, float(rng.uniform(0.4, 1.1)))
        if found is not None:
            others.append(LightRole(moon(*found), log_uniform(rng, 0.4, 1.0)))
            room -= 1
    for name, (lamp, median, gels) in list(_PRACTICALS.items())[: max(0, room)]:
        tint = draw_tint(rng, gels=gels, median=median)
        size = log_uniform(rng, 0.1, 0.5) if lamp == "area" else log_uniform(rng, 0.01, 0.1)
        height = float(np.radians(rng.uniform(12.0, 55.0)))
        plan = LampPlan(name, lamp, float(rng.uniform(-np.pi, np.pi)), height, size, tint, "profile")
        others.append(LightRole(hang(rng, meter, plan), log_uniform(rng, 0.5, 1.5)))
    lux = log_uniform(rng, *NIGHT_LUX)
    return LightRig(lights=tuple(balance(key, others, meter, key_to_fill=design.key_to_fill, lux=lux)))
