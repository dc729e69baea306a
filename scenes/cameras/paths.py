"""The shapes of camera trajectories, before anything is known of what might block the view.

A path says for each view where the camera stands as seen from its aim: azimuth, elevation and roll [rad], focal
length [mm, for a 36 mm sensor], and the radius [m] of the sphere about the aim that the picture's shorter side just
holds. The distance follows from the last two, so that a long lens stands further off and objects keep their size.
"""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from multilight.scenes.arrays import Float64
from multilight.scenes.cameras.pinhole import camera_from_lens, half_angle, look_at
from multilight.scenes.frozen import Settings, UnitFloat
from multilight.scenes.numbers import smoothstep
from multilight.scenes.poses import direction_from
from multilight.scenes.random_streams import Rng, Weights, log_uniform
from multilight.scenes.spec import Camera

TrajectoryKind = Literal["approach", "orbit", "handheld", "random"]
"""From distant to close; round the subject; a hand that holds still as best it can; anywhere at all."""

LOWEST, HIGHEST = 0.262, 0.873
"""Elevation of the cameras [rad], 15 to 50 degrees: below, an object's front hides what it stands on; above, its top
all else. `random` goes `STEEPER` further up, 10 degrees."""
STEEPER = 0.17
ELEVATION = (20.0, 45.0)
"""Elevation [degrees] about which an orbit and a hand stay: that of someone who stands or sits at a table."""
DISTANT_ELEVATION, CLOSE_ELEVATION = (20.0, 42.0), (16.0, 48.0)
"""Elevation [degrees] where an approach begins and where it ends; from close by one bends down, or over."""
SWEEP = (50.0, 120.0)
"""Azimuth [degrees] that an approach covers: enough to see an object's side, not its back."""
ORBIT, ARC = (0.6, 1.0), (0.7, 1.0)
"""Fraction of the full circle, and of the open side where walls forbid that, that an orbit covers."""
ONE_VIEW = 0.6
"""Place on its path, from 0 to 1, of a trajectory's only view: it shows the whole from nearby."""

# Unrest, as deviations: of angles [rad], of the framed radius (relative), of the aim (over the framed radius).
SHAKE_ANGLE, SHAKE_ROLL, SHAKE_FRAMED, SHAKE_AIM = 0.012, 0.01, 0.015, 0.02
"""Of an approach, from view to view: a hand that walks, too little to be seen in one picture."""
RISE, BREATH = np.radians(4.0), 0.03
"""Of an orbit's elevation and framed radius: nobody keeps a circle."""
HAND_AZIMUTH, HAND_ELEVATION, HAND_ROLL, HAND = np.radians(6.0), np.radians(2.5), np.radians(1.2), 0.04
"""Of a hand at one standpoint, the last of framed radius and aim: larger sideways, as one shifts one's weight."""
HAND_SLACK, HAND_DRIFT = np.radians(16.0), 0.15
"""Azimuth that a hand's standpoint leaves free at the sides of the opening; how far it moves in or out (relative)."""
LEVEL, LOOSE_AIM = np.radians(2.0), 0.06
"""Of `random`: roll, cut off at twice that, and the aim's greatest distance; wider than by hand, to cover all."""
ORBIT_FRAMED, HAND_FRAMED = (1.0, 1.5), (1.05, 1.6)
"""Radius that an orbit and a hand frame, over that of the objects, as far as the table goes: a hand needs a margin."""
ORBIT_TOWARDS, HAND_TOWARDS, RANDOM_TOWARDS = (0.7, 1.0), (0.6, 1.0), (0.3, 1.0)
"""Where they aim, from 0 at the table's centre to 1 at that of the objects: mostly at the objects."""
WAVES = ((0.9, (0.3, 0.8)), (0.8, (0.8, 1.6)), (0.5, (1.6, 2.8)))
"""Amplitude of the waves that make up a smooth curve, and their cycles over the path: the quicker, the smaller."""

Lens = Annotated[float, Field(ge=12, le=200, json_schema_extra={"unit": "mm"})]
FNumber = Annotated[float, Field(ge=0.95, le=64)]


class TrajectoryShares(Weights[TrajectoryKind]):
    """How often each kind of trajectory comes, relative to the others."""

    approach: UnitFloat = 0.4
    """From distant to close on an arc."""
    orbit: UnitFloat = 0.25
    """Round the subject at one distance, as far as walls allow."""
    handheld: UnitFloat = 0.2
    """One standpoint, with the smooth wobble of a hand."""
    random: UnitFloat = 0.15
    """Each view from anywhere, with any lens."""


class CameraSettings(Settings):
    """What the cameras of a dataset have in common."""

    trajectories: TrajectoryShares = TrajectoryShares()
    """Kinds of trajectory."""
    lens_mm: tuple[Lens, Lens] = (24.0, 85.0)
    """Shortest and longest focal length, full-frame equivalent."""
    min_visible_share: UnitFloat = 0.7
    """Fraction of the views in which each insertable object is whole in frame and not hidden."""
    depth_of_field: UnitFloat = 0.0
    """Fraction of the scenes whose lens has an aperture; the others are pinholes."""
    f_number: tuple[FNumber, FNumber] = (1.8, 8.0)
    """Widest and narrowest aperture, as focal length over its diameter."""

    @model_validator(mode="after")
    def _ranges_ascend(self) -> "CameraSettings":
        for name in ("lens_mm", "f_number"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"{name} must ascend, got {low} to {high}")
        return self


DEFAULT_CAMERAS = CameraSettings()


@dataclass(frozen=True)
class Framing:
    """What a path is fitted to: radius [m] framed when close and when distant, and where cameras may stand.

    Cameras stand within `opening` [rad] of azimuth `front` [rad]. `narrow` in (0, 1] shortens sweeps and long
    lenses, so that a tight room still finds a path.
    """

    close: float
    distant: float
    front: float
    opening: float
    narrow: float = 1.0


@dataclass(frozen=True)
class Path:
    """One row a view: see the module's description; `towards` is 0 where the aim is the table's centre, 1 where it
    is the objects'; `sway` (N, 3) moves the aim, in units of `framed`.
    """

    azimuth: Float64
    elevation: Float64
    roll: Float64
    focal: Float64
    framed: Float64
    towards: Float64
    sway: Float64


def draw_path(rng: Rng, kind: TrajectoryKind, framing: Framing, *, views: int, lens_mm: tuple[float, float]) -> Path:
    """Draw a path of a kind."""
    low, high = lens_mm
    lens = (low, low * (high / low) ** framing.narrow)
    drawn = {"approach": _approach, "orbit": _orbit, "handheld": _handheld, "random": _random}[kind]
    return drawn(rng, framing, views, lens)


def camera_on(path: Path, view: int, aims: tuple[Float64, Float64], size: tuple[int, int]) -> Camera:
    """Place the camera of a view; `aims` are the centres (3,) of the table and of the objects, `size` in pixels."""
    framed, focal = float(path.framed[view]), float(path.focal[view])
    aim = aims[0] + path.towards[view] * (aims[1] - aims[0]) + framed * path.sway[view]
    azimuth, elevation = path.azimuth[view], path.elevation[view]
    lean = float(np.tan(path.roll[view]))
    up = (-np.sin(azimuth) * lean, np.cos(azimuth) * lean, 1.0)
    pose = look_at(aim + framed / np.sin(half_angle(focal, size)) * direction_from(azimuth, elevation), aim, up=up)
    return camera_from_lens(pose, width=size[0], height=size[1], focal_length_mm=focal)


def _midpoint(rng: Rng, framing: Framing, sweep: float) -> float:
    """Draw the azimuth [rad] of the midpoint of a sweep that keeps to the open side."""
    slack = max(0.0, framing.opening - sweep / 2)
    return framing.front + float(rng.uniform(-slack, slack))


def _framed(rng: Rng, framing: Framing, least: float, most: float) -> float:
    """Draw the radius [m] that is framed: `least` to `most` times the close one, at most the distant one."""
    return float(framing.close * rng.uniform(least, max(least, min(most, framing.distant / framing.close))))


def _steps(views: int) -> Float64:
    """Return the places of the views along the path, 0 to 1."""
    return np.linspace(0.0, 1.0, views) if views > 1 else np.array([ONE_VIEW])


def _approach(rng: Rng, framing: Framing, views: int, lens: tuple[float, float]) -> Path:
    """Draw an arc from distant to close, from a wider to a longer lens, with the slight unrest of a hand."""
    least, most = np.radians(SWEEP[0]), min(np.radians(SWEEP[1]), 2.0 * framing.opening)
    sweep = max(least, framing.narrow * rng.uniform(least, most))
    midpoint, side = _midpoint(rng, framing, sweep), float(rng.choice([-1.0, 1.0]))
    t = _steps(views)
    # Azimuth runs evenly; the approach starts gently and ends gently.
    ease = 0.5 * t + 0.5 * smoothstep(t)
    usual = float(np.sqrt(lens[0] * lens[1]))
    ends = np.log([rng.uniform(lens[0], usual), rng.uniform(0.9 * usual, lens[1])]).clip(*np.log(lens))
    elevation = np.radians([rng.uniform(*DISTANT_ELEVATION), rng.uniform(*CLOSE_ELEVATION)])
    shake = rng.normal(0.0, 1.0, (views, 7))
    return Path(
        azimuth=midpoint + side * sweep * (t - 0.5) + SHAKE_ANGLE * shake[:, 0],
        elevation=np.clip(elevation[0] + ease * np.diff(elevation) + SHAKE_ANGLE * shake[:, 1], LOWEST, HIGHEST),
        roll=SHAKE_ROLL * shake[:, 6],
        focal=np.exp(ends[0] + ease * np.diff(ends)),
        framed=framing.distant * (framing.close / framing.distant) ** ease * (1.0 + SHAKE_FRAMED * shake[:, 2]),
        towards=ease,
        sway=SHAKE_AIM * shake[:, 3:6],
    )


def _orbit(rng: Rng, framing: Framing, views: int, lens: tuple[float, float]) -> Path:
    """Draw a path round the subject at one distance, rising and sinking a little; all round where nothing forbids."""
    if framing.opening > 0.99 * np.pi:
        # The last view of a full circle is not the first again.
        sweep = framing.narrow * 2.0 * np.pi * (views - 1) / views * rng.uniform(*ORBIT)
    else:
        sweep = framing.narrow * 2.0 * framing.opening * rng.uniform(*ARC)
    midpoint, side = _midpoint(rng, framing, sweep), float(rng.choice([-1.0, 1.0]))
    t = _steps(views)
    height = np.radians(rng.uniform(*ELEVATION)) + RISE * _wander(rng, t)
    framed = _framed(rng, framing, *ORBIT_FRAMED)
    return Path(
        azimuth=midpoint + side * sweep * (t - 0.5),
        elevation=np.clip(height, LOWEST, HIGHEST),
        roll=np.zeros(views),
        focal=np.full(views, log_uniform(rng, *lens)),
        framed=framed * (1.0 + BREATH * _wander(rng, t)),
        towards=np.full(views, rng.uniform(*ORBIT_TOWARDS)),
        sway=np.zeros((views, 3)),
    )


def _handheld(rng: Rng, framing: Framing, views: int, lens: tuple[float, float]) -> Path:
    """Draw one standpoint and the wobble about it, smooth from view to view; the hand moves slowly in or out."""
    t = _steps(views)
    wobble = float(rng.uniform(0.5, 1.0))
    midpoint = _midpoint(rng, framing, HAND_SLACK)
    height = np.radians(rng.uniform(*ELEVATION)) + wobble * HAND_ELEVATION * _wander(rng, t)
    framed = _framed(rng, framing, *HAND_FRAMED)
    drift = np.exp(rng.uniform(-HAND_DRIFT, HAND_DRIFT) * (t - 0.5))
    return Path(
        azimuth=midpoint + wobble * HAND_AZIMUTH * _wander(rng, t),
        elevation=np.clip(height, LOWEST, HIGHEST),
        roll=wobble * HAND_ROLL * _wander(rng, t),
        focal=np.full(views, log_uniform(rng, *lens)),
        framed=framed * drift * (1.0 + wobble * HAND * _wander(rng, t)),
        towards=np.full(views, rng.uniform(*HAND_TOWARDS)),
        sway=wobble * HAND * np.stack([_wander(rng, t) for _ in range(3)], axis=-1),
    )


def _random(rng: Rng, framing: Framing, views: int, lens: tuple[float, float]) -> Path:
    """Draw each view on its own: any side, height, lens and distance."""
    spread = framing.distant / framing.close
    return Path(
        azimuth=framing.front + framing.opening * rng.uniform(-1.0, 1.0, views),
        elevation=rng.uniform(LOWEST, HIGHEST + STEEPER, views),
        roll=LEVEL * rng.normal(0.0, 1.0, views).clip(-2.0, 2.0),
        focal=lens[0] * (lens[1] / lens[0]) ** rng.uniform(0.0, 1.0, views),
        framed=framing.close * spread ** rng.uniform(0.0, 1.0, views),
        towards=rng.uniform(*RANDOM_TOWARDS, views),
        sway=LOOSE_AIM * rng.uniform(-1.0, 1.0, (views, 3)),
    )


def _wander(rng: Rng, t: Float64) -> Float64:
    """Return a smooth random curve over `t`, (N,), of unit deviation in the long run: slow sine waves."""
    curve = np.zeros_like(t)
    for amplitude, cycles in WAVES:
        curve += amplitude * np.sin(2 * np.pi * (rng.uniform(*cycles) * t + rng.random()))
    return curve / np.sqrt(sum(amplitude**2 for amplitude, _ in WAVES) / 2)
