"""Light distributions of luminaires: IES LM-63 files, and a few plausible luminaires written as such files.

An IES file gives candelas over vertical angles (0 is the luminaire's axis, straight down as it hangs) and
horizontal ones; `PointLight.profile` keeps their mean about the axis. Format: ANSI/IES LM-63-2002 (and -1995, -1991,
-1986, which differ in header lines only), type C photometry.
"""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from multilight.scenes.arrays import Float64
from multilight.scenes.errors import MultilightError

SAMPLES = 181
"""Angles of a profile: one a degree, 0 to 180."""


class IesError(MultilightError, ValueError):
    """An IES file cannot be used: names the file, what is wrong, and what is read."""


@dataclass(frozen=True)
class Luminaire:
    """A distribution about an axis: `profile` over `SAMPLES` even angles from 0 to pi, its greatest value 1.

    `candela` is the intensity that 1 stands for and `lumens` the flux of the whole, both as the file has them;
    another flux F wants the intensity `candela * F / lumens`.
    """

    candela: float
    lumens: float
    profile: tuple[float, ...]


def read_ies(path: Path) -> Luminaire:
    """Read a photometric file; raises `IesError` naming the file, `OSError` where it cannot be opened."""
    return parse_ies(path.read_text(encoding="latin-1"), source=str(path))


def parse_ies(text: str, *, source: str = "IES text") -> Luminaire:
    """Parse the text of an IES LM-63 file: TILT=NONE, type C, averaged over the horizontal angles.

    The candela multiplier and both ballast factors are applied. Raises `IesError` with `source` and the fault.
    """
    tilt = re.search(r"^[ \t]*TILT[ \t]*=(.*)$", text, flags=re.MULTILINE)
    if tilt is None:
        raise IesError(f"{source}: no line TILT=; this is not an IES LM-63 file")
    if tilt[1].strip().upper() != "NONE":
        raise IesError(f"{source}: TILT={tilt[1].strip()}: only TILT=NONE is read; export the file without tilt")
    numbers = _numbers(text[tilt.end() :], source)
    vertical, horizontal, candela = _tables(numbers, source)
    return _luminaire(vertical, _mean_about_axis(horizontal, candela), source)


def _numbers(text: str, source: str) -> Float64:
    """Turn what follows TILT= into numbers, separated by blanks, commas or line ends."""
    words = text.replace(",", " ").split()
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError as error:
        raise IesError(f"{source}: {error} after TILT=NONE; repair the file") from None
    if len(numbers) < 13:
        raise IesError(f"{source}: only {len(numbers)} numbers after TILT=NONE, at least 13 are needed; it is cut off")
    if not np.isfinite(numbers).all():
        raise IesError(f"{source}: a value after TILT=NONE is not finite; repair the file")
    return numbers


def _tables(numbers: Float64, source: str) -> tuple[Float64, Float64, Float64]:
    """Return vertical angles (V,), horizontal angles (H,) [degrees] and candelas (H, V)."""
    multiplier, count_v, count_h, kind = (float(numbers[i]) for i in (2, 3, 4, 5))
    if kind != 1:
        raise IesError(f"{source}: photometric type {kind:g} is not read; export the file as type C (1)")
    if count_v < 2 or count_h < 1 or count_v % 1 or count_h % 1:
        raise IesError(
            f"{source}: {count_v:g} vertical and {count_h:g} horizontal angles; need 2 or more and 1 or more"
        )
    v, h = int(count_v), int(count_h)
    body = numbers[13:]
    if len(body) < v + h + v * h:
        raise IesError(f"{source}: {len(body)} angles and candelas, {v + h + v * h} are needed; the file is cut off")
    vertical, horizontal = body[:v], body[v : v + h]
    candela = body[v + h : v + h + v * h].reshape(h, v) * multiplier * numbers[10] * numbers[11]
    for what, angles, top in (("vertical", vertical, 180.0), ("horizontal", horizontal, 360.0)):
        if (np.diff(angles) <= 0).any() or angles[0] < 0.0 or angles[-1] > top:
            raise IesError(f"{source}: {what} angles must ascend within 0 and {top:g}, got {angles.tolist()[:6]}...")
    if (candela < 0).any() or not candela.max() > 0:
        raise IesError(f"{source}: candelas must be 0 or more and not all 0; lowest {candela.min():g}")
    return vertical, horizontal, candela


def _mean_about_axis(horizontal: Float64, candela: Float64) -> Float64:
    """Average candelas (H, V) over the horizontal angles: the range given is one period or a symmetric part of it."""
    if len(horizontal) == 1:
        return candela[0]
    span = np.diff(horizontal)
    between = (candela[1:] + candela[:-1]) / 2
    return np.asarray(span @ between / span.sum())


def _luminaire(vertical: Float64, candela: Float64, source: str) -> Luminaire:
    """Resample to even angles; the luminaire is dark beyond the angles given."""
    degrees = np.linspace(0.0, 180.0, SAMPLES)
    even = np.interp(degrees, vertical, candela, left=0.0, right=0.0)
    peak = float(even.max())
    if not peak > 0.0:
        raise IesError(f"{source}: all light lies between whole degrees; a beam this narrow is not read")
    profile = tuple(round(float(value), 5) for value in even / peak)
    return Luminaire(peak, profile_flux(profile) * peak, profile)


def profile_flux(profile: tuple[float, ...]) -> float:
    """Return the flux of a point light with this profile and a peak intensity of 1: lm for cd, W for W/sr.

    The integral of a piecewise linear intensity over the sphere, in closed form.
    """
    values = np.array(profile)
    angle = np.linspace(0.0, math.pi, len(values))
    slope = np.diff(values) / np.diff(angle)
    # The antiderivative of (a + b t) sin t is -(a + b t) cos t + b sin t.
    high = -values[1:] * np.cos(angle[1:]) + slope * np.sin(angle[1:])
    low = -values[:-1] * np.cos(angle[:-1]) + slope * np.sin(angle[:-1])
    return float(2.0 * math.pi * (high - low).sum())


# --- luminaires by formula: (vertical angle, horizontal angle) [degrees] → relative candelas ---


def _beam(angle: Float64, width: float, spill: float) -> Float64:
    """A reflector's beam of full width at half maximum `width`, with a share of spill up to a cut-off at 75."""
    core = np.exp(-math.log(2.0) * (2.0 * angle / width) ** 2)
    return (1.0 - spill) * core + spill * np.cos(np.radians(np.minimum(angle * 1.2, 90.0))) ** 2


def _batwing(angle: Float64) -> Float64:
    wing = np.exp(-(((angle - 42.0) / 16.0) ** 2))
    return (0.45 + 0.75 * wing) * np.clip((88.0 - angle) / 22.0, 0.0, 1.0)


def _washer(angle: Float64, turn: Float64) -> Float64:
    towards = 0.5 + 0.5 * np.cos(np.radians(turn))
    return (0.15 + 0.85 * towards) * np.exp(-(((angle - 30.0 * towards) / 24.0) ** 2)) * (angle < 85.0)


def _bulb(angle: Float64) -> Float64:
    """A globe whose cap hides the light towards its socket."""
    return np.clip((168.0 - angle) / 38.0, 0.0, 1.0) * (0.9 + 0.1 * np.sin(np.radians(angle)))


LUMINAIRES: dict[str, tuple[float, Callable[[Float64, Float64], Float64]]] = {
    "downlight_narrow": (900.0, lambda v, _: _beam(v, 15.0, 0.03)),
    "downlight_medium": (1100.0, lambda v, _: _beam(v, 36.0, 0.05)),
    "downlight_wide": (1400.0, lambda v, _: _beam(v, 70.0, 0.12)),
    "batwing": (3200.0, lambda v, _: _batwing(v)),
    "uplight": (1800.0, lambda v, _: _beam(180.0 - v, 95.0, 0.1)),
    "up_and_down": (1000.0, lambda v, _: _beam(v, 40.0, 0.02) + 0.8 * _beam(180.0 - v, 50.0, 0.02)),
    "wall_washer": (1500.0, _washer),
    "pendant_shade": (1200.0, lambda v, _: np.clip((62.0 - v) / 14.0, 0.0, 1.0) + 0.12 * (v > 150.0)),
    "bare_bulb": (800.0, lambda v, _: _bulb(v)),
}
"""Plausible luminaires: flux [lm] and distribution; after common catalogue shapes, not measured."""


def luminaire_ies(name: str) -> str:
    """Write a built-in luminaire as IES LM-63-2002 text; raises `ValueError` for a name not in `LUMINAIRES`."""
    if name not in LUMINAIRES:
        raise ValueError(f"no luminaire {name!r}; there are {', '.join(sorted(LUMINAIRES))}")
    lumens, shape = LUMINAIRES[name]
    vertical = np.arange(0.0, 180.1, 2.5)
    horizontal = np.arange(0.0, 180.1, 15.0) if name == "wall_washer" else np.array([0.0])
    candela = np.array([shape(vertical, np.full_like(vertical, turn)) for turn in horizontal])
    mean = np.interp(np.linspace(0, 180, SAMPLES), vertical, _mean_about_axis(horizontal, candela))
    candela *= lumens / profile_flux(tuple(mean))
    rows = [" ".join(f"{value:.3f}" for value in row) for row in (vertical, horizontal, *candela)]
    return "\n".join(
        [
            "IESNA:LM-63-2002",
            f"[TEST] {name}",
            "[MANUFAC] DTC-MultiLight builder",
            "TILT=NONE",
            f"1 {lumens:g} 1 {len(vertical)} {len(horizontal)} 1 2 0 0 0",
            "1 1 10",
            *rows,
            "",
        ]
    )


def luminaire(name: str) -> Luminaire:
    """Return a built-in luminaire, read back from its IES text; raises `ValueError` for an unknown name."""
    return parse_ies(luminaire_ies(name), source=name)
