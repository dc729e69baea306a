"""Rigs of a photographic studio: key, fill, rim and background lights, softboxes, strip lights, a snoot."""

from collections.abc import Callable

import numpy as np

from multilight.lights.photometry.directions import direction_from
from multilight.lights.photometry.irradiance import StillLife
from multilight.lights.photometry.radiometry import intensity_from_lumens, spot_solid_angle
from multilight.lights.rigs.balance import Share, balance
from multilight.lights.rigs.daylight import environment
from multilight.lights.rigs.design import RigDesign
from multilight.lights.rigs.lamps import LampKind, Post, draw_tint, gelled, hang, log_uniform, vector, white_tint
from multilight.lights.rigs.tabletop import glow_share, key_tint
from multilight.lights.spec import LightRig, SpotLight

KEY_LUX = (500.0, 3000.0)
"""Illuminance that the key aims at [lx]: continuous studio heads; flashes give more in less time."""
STRIP = 5.0
"""Ratio of a strip light's sides."""

Maker = Callable[[np.random.Generator, StillLife, RigDesign], Share | None]


def studio_rig(rng: np.random.Generator, place: StillLife, design: RigDesign, *, lights: tuple[int, int]) -> LightRig:
    """Draw a studio rig of `lights` (fewest, most) lights: the key as designed, then what sets it off."""
    kind: LampKind = "area" if design.angular_size >= 0.04 else "spot"
    if design.key in ("point", "spot") and design.angular_size < 0.25:
        kind = design.key
    shaping = "gobo" if design.shaping == "gobo" and kind == "spot" else "plain"
    # Studio heads are whiter than household lamps: half-way, in stops, to a flash's colour.
    head = design.model_copy(update={"colour_temperature": (design.colour_temperature * 5400.0) ** 0.5})
    key = hang(
        rng,
        place,
        Post("key", kind, design.azimuth, design.elevation, design.angular_size, key_tint(rng, head), shaping),
    )
    others: list[Share] = [glow] if (glow := glow_share(rng, place)) else []
    room = min(max(design.lights, lights[0], 1 + len(others)), lights[1]) - 1 - len(others)
    classic: list[Maker] = [_background, _rim, _fill]
    further: list[Maker] = [_hair, _kicker, _snoot, _ambient]
    order = [classic[i] for i in rng.permutation(3)] + [further[i] for i in rng.permutation(4)]
    for maker in order:
        # A lamp that finds no place leaves its own to the next.
        share = maker(rng, place, design) if room > 0 else None
        if share is not None:
            others.append(share)
            room -= 1
    lux = log_uniform(rng, *KEY_LUX)
    return LightRig(lights=tuple(balance(key, others, place, key_to_fill=design.key_to_fill, lux=lux)))


def _softbox(
    rng: np.random.Generator,
    place: StillLife,
    name: str,
    *,
    azimuth: float,
    elevation: float,
    size: float,
    aspect: float = 1.0,
    gels: float = 0.1,
) -> Share:
    """Hang a softbox or strip light; angles in degrees, `size` in rad."""
    tint = draw_tint(rng, gels=gels, middle=5200.0)
    post = Post(
        name, "area", float(np.radians(azimuth)), float(np.radians(elevation)), size, tint, "plain", aspect
    )  # fmt: skip
    return Share(hang(rng, place, post), log_uniform(rng, 0.5, 1.5))


def _fill(rng: np.random.Generator, place: StillLife, design: RigDesign) -> Share:
    """Open the shadows from the other side of the cameras, large and soft."""
    side = -np.sign(design.azimuth) * rng.uniform(20.0, 75.0)
    return _softbox(rng, place, "fill", azimuth=side, elevation=rng.uniform(20, 50), size=rng.uniform(0.5, 0.95))


def _rim(rng: np.random.Generator, place: StillLife, design: RigDesign) -> Share:
    """Draw an edge of light from behind with a strip."""
    side = -np.sign(design.azimuth) * rng.uniform(125.0, 170.0)
    size = log_uniform(rng, 0.08, 0.3)
    return _softbox(rng, place, "rim", azimuth=side, elevation=rng.uniform(15, 40), size=size, aspect=STRIP, gels=0.3)


def _kicker(rng: np.random.Generator, place: StillLife, design: RigDesign) -> Share:
    """Graze the key's own side from low behind."""
    side = np.sign(design.azimuth) * rng.uniform(105.0, 160.0)
    size = log_uniform(rng, 0.06, 0.25)
    return _softbox(
        rng, place, "kicker", azimuth=side, elevation=rng.uniform(12, 30), size=size, aspect=STRIP, gels=0.3
    )


def _hair(rng: np.random.Generator, place: StillLife, _: RigDesign) -> Share:
    """Light the tops from above and behind."""
    side = rng.uniform(150.0, 210.0)
    return _softbox(rng, place, "hair", azimuth=side, elevation=rng.uniform(58, 80), size=log_uniform(rng, 0.08, 0.4))


def _snoot(rng: np.random.Generator, place: StillLife, _: RigDesign) -> Share | None:
    """Pick out one spot with a narrow hard beam."""
    tint = draw_tint(rng, gels=0.3, middle=4800.0)
    azimuth = float(rng.choice([-1.0, 1.0]) * np.radians(rng.uniform(40.0, 150.0)))
    post = Post("snoot", "spot", azimuth, float(np.radians(rng.uniform(30, 65))), 0.01, tint)
    spot = hang(rng, place, post)
    if not isinstance(spot, SpotLight):
        return None
    return Share(spot.model_copy(update={"half_angle": spot.half_angle / 2, "blend": 0.2}), log_uniform(rng, 0.5, 1.5))


def _ambient(rng: np.random.Generator, place: StillLife, _: RigDesign) -> Share:
    """Let the room's walls give a little light back: a studio's map, or even grey."""
    categories = frozenset({"studio"}) if rng.random() < 0.5 else frozenset[str]()
    tint = white_tint(rng.uniform(4000.0, 6500.0))
    return Share(environment(rng, place, tint, name="ambient", categories=categories), 0.5)


def _background(rng: np.random.Generator, place: StillLife, _: RigDesign) -> Share | None:
    """Throw a pool of light, often coloured, on what hangs behind; None where nothing does."""
    behind = direction_from(place.camera + np.pi, float(np.radians(rng.uniform(4.0, 14.0))))
    distance = place.fixed_rays.first_hit(place.aim[None], behind[None])[1]
    if not 0.3 < distance[0] < 8.0:
        return None
    target = place.aim + distance[0] * behind
    across = np.cross(behind, [0.0, 0.0, 1.0])
    for _attempt in range(12):
        aside = rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.4) * across
        position = target - rng.uniform(0.5, 0.9) * distance[0] * behind + aside + [0.0, 0.0, rng.uniform(0.2, 1.2)]
        if place.fixed_rays.sees(position, target[None], slack=0.05)[0]:
            break
    else:
        return None
    tint = draw_tint(rng, gels=0.0, middle=5000.0)
    tint = gelled(rng, tint, rng.uniform(0.3, 1.0)) if rng.random() < 0.45 else tint
    way = target - position
    reach = float(np.linalg.norm(way))
    half, blend = float(np.clip(np.arctan(rng.uniform(0.4, 1.0) / reach), 0.2, 1.1)), float(rng.uniform(0.5, 1.0))
    light = SpotLight(
        name="background",
        colour_temperature=tint.temperature,
        gel=tint.gel,
        position=vector(position),
        direction=vector(way),
        intensity=intensity_from_lumens(1.0, tint.rgb, spot_solid_angle(half, blend)),
        half_angle=half,
        blend=blend,
        radius=0.04,
    )
    # It counts where it falls: about square on the backdrop.
    return Share(light, log_uniform(rng, 0.2, 1.0), light.grey / reach**2)
