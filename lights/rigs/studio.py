"""Rigs of a photographic studio: key, fill, rim and background lights, softboxes, strip lights, a snoot."""

from collections.abc import Callable

import numpy as np

from multilight.lights.photometry.irradiance import LightMeter
from multilight.lights.rigs.balance import LightRole, balance
from multilight.lights.rigs.daylight import environment
from multilight.lights.rigs.design import LARGEST_BULB, SMALLEST_PANEL, RigDesign
from multilight.lights.rigs.lamps import LampKind, LampPlan, draw_tint, gelled, hang, one_lumen, white_tint
from multilight.lights.rigs.tabletop import glow_of, key_tint
from multilight.lights.spec import LightRig, SpotLight
from multilight.scenes.frozen import triple
from multilight.scenes.poses import direction_from
from multilight.scenes.random_streams import Rng, log_uniform

KEY_LUX = (500.0, 3000.0)
"""Illuminance that the key aims at [lx]: continuous studio heads; flashes give more in less time."""
FLASH = 5400.0
"""Colour temperature of a flash [K]."""
STRIP = 5.0
"""Ratio of a strip light's sides."""

Recipe = Callable[[Rng, LightMeter, RigDesign], LightRole | None]


def studio_rig(rng: Rng, meter: LightMeter, design: RigDesign, *, lights: tuple[int, int]) -> LightRig:
    """Draw a studio rig of `lights` (fewest, most) lights: the key as designed, then what sets it off."""
    kind: LampKind = "area" if design.angular_size >= SMALLEST_PANEL else "spot"
    if design.key in ("point", "spot") and design.angular_size < LARGEST_BULB:
        kind = design.key
    shaping = "gobo" if design.shaping == "gobo" and kind == "spot" else "plain"
    # Studio heads are whiter than household lamps: half-way, in logarithm, to a flash's colour.
    head = design.model_copy(update={"colour_temperature": (design.colour_temperature * FLASH) ** 0.5})
    tint = key_tint(rng, head)
    plan = LampPlan("key", kind, design.azimuth, design.elevation, design.angular_size, tint, shaping)
    key = hang(rng, meter, plan)
    others: list[LightRole] = [glow] if (glow := glow_of(rng, meter)) else []
    room = min(max(design.lights, lights[0], 1 + len(others)), lights[1]) - 1 - len(others)
    classic: list[Recipe] = [_background, _rim, _fill]
    further: list[Recipe] = [_hair, _kicker, _snoot, _ambient]
    order = [classic[i] for i in rng.permutation(3)] + [further[i] for i in rng.permutation(4)]
    for recipe in order:
        # A lamp that finds no place leaves its own to the next.
        role = recipe(rng, meter, design) if room > 0 else None
        if role is not None:
            others.append(role)
            room -= 1
    lux = log_uniform(rng, *KEY_LUX)
    return LightRig(lights=tuple(balance(key, others, meter, key_to_fill=design.key_to_fill, lux=lux)))


def _softbox(
    rng: Rng,
    meter: LightMeter,
    name: str,
    angles: tuple[float, float],
    size: float,
    *,
    aspect: float = 1.0,
    gels: float = 0.1,
) -> LightRole:
    """Hang a softbox or strip light at an azimuth and elevation [degrees], `size` in rad."""
    tint = draw_tint(rng, gels=gels, median=5200.0)
    azimuth, elevation = (float(angle) for angle in np.radians(angles))
    plan = LampPlan(name, "area", azimuth, elevation, size, tint, aspect=aspect)
    return LightRole(hang(rng, meter, plan), log_uniform(rng, 0.5, 1.5))


def _fill(rng: Rng, meter: LightMeter, design: RigDesign) -> LightRole:
    """Open the shadows from the other side of the cameras, large and soft."""
    side = -np.sign(design.azimuth) * rng.uniform(20.0, 75.0)
    return _softbox(rng, meter, "fill", (side, rng.uniform(20, 50)), rng.uniform(0.5, 0.95))


def _rim(rng: Rng, meter: LightMeter, design: RigDesign) -> LightRole:
    """Draw an edge of light from behind with a strip."""
    side = -np.sign(design.azimuth) * rng.uniform(125.0, 170.0)
    size = log_uniform(rng, 0.08, 0.3)
    return _softbox(rng, meter, "rim", (side, rng.uniform(15, 40)), size, aspect=STRIP, gels=0.3)


def _kicker(rng: Rng, meter: LightMeter, design: RigDesign) -> LightRole:
    """Graze the key's own side from low behind."""
    side = np.sign(design.azimuth) * rng.uniform(105.0, 160.0)
    size = log_uniform(rng, 0.06, 0.25)
    return _softbox(rng, meter, "kicker", (side, rng.uniform(12, 30)), size, aspect=STRIP, gels=0.3)


def _hair(rng: Rng, meter: LightMeter, _: RigDesign) -> LightRole:
    """Light the tops from above and behind."""
    side = rng.uniform(150.0, 210.0)
    return _softbox(rng, meter, "hair", (side, rng.uniform(58, 80)), log_uniform(rng, 0.08, 0.4))


def _snoot(rng: Rng, meter: LightMeter, _: RigDesign) -> LightRole | None:
    """Pick out one spot with a narrow hard beam."""
    tint = draw_tint(rng, gels=0.3, median=4800.0)
    azimuth = float(rng.choice([-1.0, 1.0]) * np.radians(rng.uniform(40.0, 150.0)))
    plan = LampPlan("snoot", "spot", azimuth, float(np.radians(rng.uniform(30, 65))), 0.01, tint)
    spot = hang(rng, meter, plan)
    if not isinstance(spot, SpotLight):
        return None
    narrow = spot.model_copy(update={"half_angle": spot.half_angle / 2, "blend": 0.2})
    return LightRole(narrow, log_uniform(rng, 0.5, 1.5))


def _ambient(rng: Rng, meter: LightMeter, _: RigDesign) -> LightRole:
    """Let the room's walls give a little light back: a studio's map, or even grey."""
    categories = frozenset({"studio"}) if rng.random() < 0.5 else frozenset[str]()
    tint = white_tint(rng.uniform(4000.0, 6500.0))
    return LightRole(environment(rng, meter, tint, name="ambient", categories=categories), 0.5)


def _background(rng: Rng, meter: LightMeter, _: RigDesign) -> LightRole | None:
    """Throw a pool of light, often coloured, on what hangs behind; None where nothing does."""
    behind = direction_from(meter.camera + np.pi, float(np.radians(rng.uniform(4.0, 14.0))))
    distance = meter.fixed_rays.first_hit(meter.aim[None], behind[None])[1]
    if not 0.3 < distance[0] < 8.0:
        return None
    target = meter.aim + distance[0] * behind
    across = np.cross(behind, [0.0, 0.0, 1.0])
    for _attempt in range(12):
        aside = rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.4) * across
        position = target - rng.uniform(0.5, 0.9) * distance[0] * behind + aside + [0.0, 0.0, rng.uniform(0.2, 1.2)]
        if meter.fixed_rays.sees(position, target[None], slack=0.05)[0]:
            break
    else:
        return None
    tint = draw_tint(rng, gels=0.0, median=5000.0)
    tint = gelled(rng, tint, rng.uniform(0.3, 1.0)) if rng.random() < 0.45 else tint
    towards = target - position
    reach = float(np.linalg.norm(towards))
    half, blend = float(np.clip(np.arctan(rng.uniform(0.4, 1.0) / reach), 0.2, 1.1)), float(rng.uniform(0.5, 1.0))
    spot = SpotLight(
        name="background",
        colour_temperature=tint.temperature,
        gel=tint.gel,
        position=triple(position),
        direction=triple(towards),
        intensity=tint.rgb,
        half_angle=half,
        blend=blend,
        radius=0.04,
    )
    light = one_lumen(spot)
    # It counts where it falls: about square on the backdrop.
    return LightRole(light, log_uniform(rng, 0.2, 1.0), light.grey / reach**2)
