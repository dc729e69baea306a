"""What a rig should be like, drawn so that a whole dataset covers every kind, direction and ratio evenly."""

from typing import Annotated, Literal, TypeVar

import numpy as np
from pydantic import Field

from multilight.scenes.arrays import Float64
from multilight.scenes.frozen import Frozen
from multilight.scenes.random_streams import Streams, pick_at

KeyKind = Literal["area", "point", "spot", "sun", "environment"]
Shaping = Literal["plain", "gobo", "profile"]
T = TypeVar("T")

COUNTS = dict(enumerate((0.06, 0.13, 0.2, 0.2, 0.16, 0.12, 0.08, 0.05), 1))
"""Probabilities of rigs with 1 to 8 lights."""
SIZES = (0.001, 1.0)
"""Angular diameters of the key [rad], hard to soft; the sun's is 0.0093."""
RATIOS = (0.7, 12.0)
"""Key-to-fill ratios: the key's illuminance against that of all other lights together, flat to dramatic."""
MIRED = (115.0, 430.0)
"""Colour temperatures in reciprocal megakelvin: 8700 K to 2300 K, even steps of which look even."""
FRONTAL = 0.12
"""Fraction of keys within `SIDE` of the cameras' azimuth: flat light, which hides shadows, is kept rare."""
SIDE = 50.0
"""Azimuth [degrees] from the cameras beyond which light comes from the side."""
GELLED = 0.16
"""Fraction of keys behind a gel, a pale one mostly: what floods a whole scene in one colour teaches little."""
ELEVATIONS = (12.0, 78.0)
"""Elevations of the key [degrees]: from a low sun or table lamp to a ceiling's, all but overhead."""
SHAPINGS: dict[Shaping, float] = {"gobo": 0.3, "profile": 0.3, "plain": 0.4}
ENVIRONMENTS = 0.75
"""Fraction of rigs with an environment beside lamps."""
SMALLEST_PANEL, LARGEST_BULB, LARGEST_SUN = 0.04, 0.25, 0.06
"""Angular diameters [rad] that kinds of keys come in: softboxes are large, bulbs and spots small, suns smaller."""
_AXES = 11


class RigDesign(Frozen):
    """What was drawn for a rig before anything was placed; what could be kept of it `lights.rigs.measure` reads back.

    `azimuth` [rad] is the key's from the cameras' mean, counter-clockwise, in (-pi, pi]; `elevation` [rad] above the
    horizon; `angular_size` [rad] its diameter as seen from the scene's centre; `key_to_fill` its illuminance there
    against that of all others; `gel_saturation` 0 is no gel; `mood` in [0, 1) chooses among a scene kind's presets.
    """

    lights: Annotated[int, Field(ge=1, le=8)]
    key: KeyKind
    azimuth: float
    elevation: float
    key_to_fill: float
    angular_size: float
    colour_temperature: float
    gel_saturation: Annotated[float, Field(ge=0, le=1)]
    shaping: Shaping
    environment: bool
    mood: Annotated[float, Field(ge=0, lt=1)]


def rig_design(streams: Streams) -> RigDesign:
    """Draw the design of a scene's rig; the same streams give the same design, in any order.

    The first attempts of a dataset's scenes are the points of one scrambled Sobol sequence (A. B. Owen, Scrambling
    Sobol' and Niederreiter-Xing points, 1998), so that any run of scenes covers all axes, and pairs of them, evenly;
    later attempts, which replace single scenes, are independent draws.
    """
    u = _point(streams)
    size = float(SIZES[0] * (SIZES[1] / SIZES[0]) ** u[5])
    # The power keeps candle-light rarer than daylight: half of the keys are above 5100 K.
    warmth = 1e6 / float(MIRED[0] + u[6] ** 2 * (MIRED[1] - MIRED[0]))
    return RigDesign(
        lights=pick_at(float(u[0]), COUNTS),
        key=_key(float(u[1]), size),
        azimuth=_azimuth(float(u[2])),
        elevation=float(np.radians(ELEVATIONS[0] + (ELEVATIONS[1] - ELEVATIONS[0]) * u[3])),
        key_to_fill=float(RATIOS[0] * (RATIOS[1] / RATIOS[0]) ** u[4]),
        angular_size=size,
        colour_temperature=round(warmth),
        gel_saturation=0.0 if u[7] >= GELLED else float(0.2 + 0.8 * (u[7] / GELLED) ** 2.5),
        shaping=pick_at(float(u[8]), SHAPINGS),
        environment=bool(u[9] < ENVIRONMENTS),
        mood=float(u[10]),
    )


def _point(streams: Streams) -> Float64:
    """Return the scene's point in the unit cube, (_AXES,)."""
    if streams.attempt > 0:
        return streams("rig_design").random(_AXES)
    from scipy.stats import qmc  # takes half a second to import

    dataset = np.random.Generator(np.random.PCG64(np.random.SeedSequence([streams.seed, _AXES])))
    sequence = qmc.Sobol(_AXES, scramble=True, rng=dataset)
    if streams.scene > 0:
        sequence.fast_forward(streams.scene)
    return np.asarray(sequence.random(1)[0])


def _key(u: float, size: float) -> KeyKind:
    """Choose the key's kind among those that come in the size."""
    weights: dict[KeyKind, float] = {
        "area": 3.0 if size >= SMALLEST_PANEL else 0.0,
        "point": 1.0 if size <= LARGEST_BULB else 0.0,
        "spot": 1.6 if size <= LARGEST_BULB else 0.0,
        "sun": 1.0 if size <= LARGEST_SUN else 0.0,
        "environment": 0.6,
    }
    return pick_at(u, weights)


def _azimuth(u: float) -> float:
    """Spread azimuths over both sides, few of them frontal."""
    side, t = (1.0, 2 * u) if u < 0.5 else (-1.0, 2 * u - 1)
    degrees = t / FRONTAL * SIDE if t < FRONTAL else SIDE + (t - FRONTAL) / (1 - FRONTAL) * (180.0 - SIDE)
    return float(side * np.radians(degrees))
