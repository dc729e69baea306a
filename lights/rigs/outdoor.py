"""Rigs under the sky: sun and sky, overcast, golden hour, a photographed place, or night with practical lamps."""

import numpy as np

from multilight.lights.photometry.irradiance import StillLife
from multilight.lights.rigs.balance import Share, balance
from multilight.lights.rigs.daylight import environment, moon, open_direction, overcast, sun_and_sky, turned
from multilight.lights.rigs.design import RigDesign
from multilight.lights.rigs.lamps import LampKind, Post, draw_tint, hang, log_uniform
from multilight.lights.rigs.tabletop import glow_share, key_tint
from multilight.lights.spec import Light, LightRig

MOODS = (("sun", 0.36), ("golden", 0.2), ("overcast", 0.12), ("place", 0.16), ("night", 0.16))
"""What the weather and the hour are, with the shares of scenes."""
PLACE_LUX, NIGHT_LUX = (1000.0, 30_000.0), (8.0, 120.0)
"""Illuminance in a photographed place by day, whose own level is not known, and under practical lamps [lx]."""


def outdoor_rig(rng: np.random.Generator, place: StillLife, design: RigDesign, *, lights: tuple[int, int]) -> LightRig:
    """Draw an outdoor rig of `lights` (fewest, most) lights; sun and sky keep their true strengths.

    One light alone by day is the sky: open shade. Beside sun or sky stand reflectors and flashes.
    """
    steps = np.cumsum([share for _, share in MOODS])
    mood = MOODS[min(int(np.searchsorted(steps, design.mood, side="right")), len(MOODS) - 1)][0]
    count = min(max(design.lights, lights[0]), lights[1])
    glow = glow_share(rng, place)
    if glow is not None and mood in ("sun", "place"):
        mood = "night"  # in full daylight what glows would hardly show
    if mood == "night":
        return _night(rng, place, design, max(count, 2), glow)
    daylight = _place(rng, place, design) if mood == "place" else _daylight(rng, place, design, mood, count)
    level = place.dome_irradiance(daylight[0])
    rig = list(daylight)
    if glow is not None:
        rig.append(glow.light)
    for share in _helpers(rng, place, count - len(rig)):
        rig.append(share.light.scaled(level * share.strength / max(place.dome_irradiance(share.light), 1e-9)))
    return LightRig(lights=tuple(rig))


def _daylight(rng: np.random.Generator, place: StillLife, design: RigDesign, mood: str, count: int) -> list[Light]:
    """Return sun and sky in their true strengths, or the sky alone."""
    low, high = (6.0, 17.0) if mood == "golden" else (12.0, 62.0)
    height = float(np.radians(low + (high - low) * (np.degrees(design.elevation) - 12.0) / 66.0))
    found = open_direction(rng, place, place.camera + design.azimuth, height)
    if mood == "overcast" or found is None:
        return [overcast(float(rng.uniform(0.0, 2 * np.pi)))]
    # What blocks the way may turn the sun, but not raise it: the hour is the mood's.
    haze = 2.0 if mood == "golden" else float(rng.choice([2.0, 3.0, 6.0], p=[0.4, 0.4, 0.2]))
    sun, sky = sun_and_sky(found[0], height, haze)
    return [sun, sky] if count > 1 else [sky]


def _place(rng: np.random.Generator, place: StillLife, design: RigDesign) -> list[Light]:
    """Return the map of a real place by day, its brightest side where the design has the key."""
    tint = draw_tint(rng, gels=0.0, middle=6500.0)
    light = environment(rng, place, tint, name="environment", categories=frozenset({"outdoor"}))
    light = turned(light, place, place.camera + design.azimuth)
    lux = log_uniform(rng, *PLACE_LUX)
    return balance(light, (), place, key_to_fill=1.0, lux=lux)


def _helpers(rng: np.random.Generator, place: StillLife, room: int) -> list[Share]:
    """Stand up to `room` reflectors and flashes about the subject, each a part of the daylight."""
    wanted = (
        ("reflector", "area", (40.0, 110.0), (15.0, 40.0), (0.5, 1.0), (0.08, 0.35)),
        ("flash", "spot", (60.0, 170.0), (20.0, 55.0), (0.004, 0.06), (0.15, 0.8)),
        ("rim", "area", (130.0, 180.0), (15.0, 45.0), (0.1, 0.5), (0.15, 0.6)),
        ("diffuser", "area", (0.0, 180.0), (55.0, 80.0), (0.4, 1.0), (0.1, 0.5)),
        ("accent", "spot", (20.0, 150.0), (15.0, 60.0), (0.004, 0.1), (0.1, 0.5)),
        ("kicker", "area", (80.0, 150.0), (12.0, 30.0), (0.1, 0.4), (0.1, 0.4)),
    )
    shares = []
    for i in rng.permutation(len(wanted))[: max(0, room)]:
        name, kind, azimuth, elevation, size, strength = wanted[int(i)]
        lamp: LampKind = "area" if kind == "area" else "spot"
        turn = float(rng.choice([-1.0, 1.0]) * np.radians(rng.uniform(*azimuth)))
        tint = draw_tint(rng, gels=0.0 if name in ("reflector", "diffuser") else 0.3, middle=5400.0)
        post = Post(name, lamp, turn, float(np.radians(rng.uniform(*elevation))), log_uniform(rng, *size), tint)
        shares.append(Share(hang(rng, place, post), log_uniform(rng, *strength)))
    return shares


def _night(rng: np.random.Generator, place: StillLife, design: RigDesign, count: int, glow: Share | None) -> LightRig:
    """Light the subject with lanterns and street lamps under a night sky, maybe with the moon."""
    kind: LampKind = "spot" if design.key == "spot" else "point"
    size = min(design.angular_size, 0.2)
    shaping = "profile" if kind == "point" and design.shaping != "plain" else "plain"
    elevation = max(design.elevation, 0.3)
    key = hang(rng, place, Post("lamp", kind, design.azimuth, elevation, size, key_tint(rng, design), shaping))
    tint = draw_tint(rng, gels=0.0, middle=9000.0)
    sky = environment(rng, place, tint, name="environment", categories=frozenset({"night"}))
    others = ([glow] if glow else []) + [Share(sky, log_uniform(rng, 0.3, 1.0))]
    room = count - 1 - len(others)
    if room > 0 and rng.random() < 0.5:
        found = open_direction(
            rng, place, place.camera + float(rng.uniform(-np.pi, np.pi)), float(rng.uniform(0.4, 1.1))
        )
        if found is not None:
            others.append(Share(moon(*found), log_uniform(rng, 0.4, 1.0)))
            room -= 1
    for name in ("lantern", "street_lamp", "window", "sign", "headlight", "torch")[: max(0, room)]:
        warm = draw_tint(rng, gels=0.5 if name == "sign" else 0.15, middle=4500.0 if name == "headlight" else 2600.0)
        lamp: LampKind = "area" if name in ("window", "sign") else "spot" if name in ("headlight", "torch") else "point"
        size = log_uniform(rng, 0.1, 0.5) if lamp == "area" else log_uniform(rng, 0.01, 0.1)
        height = float(np.radians(rng.uniform(12.0, 55.0)))
        post = Post(name, lamp, float(rng.uniform(-np.pi, np.pi)), height, size, warm, "profile")
        others.append(Share(hang(rng, place, post), log_uniform(rng, 0.5, 1.5)))
    lux = log_uniform(rng, *NIGHT_LUX)
    return LightRig(lights=tuple(balance(key, others, place, key_to_fill=design.key_to_fill, lux=lux)))
