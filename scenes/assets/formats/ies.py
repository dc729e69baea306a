"""Light distributions of luminaires: IES LM-63 files.

An IES file gives candelas over vertical angles (0 is the luminaire's axis, straight down as it hangs) and
horizontal ones; `PointLight.profile` keeps their mean about the axis. Format: ANSI/IES LM-63-2002 (and -1995, -1991,
-1986, which differ in header lines only), type C photometry.
"""

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from multilight.scenes.arrays import Float64
from multilight.scenes.assets.info import AssetError

SAMPLES = 181
"""Angles of a profile: one a degree, 0 to 180."""


@dataclass(frozen=True)
class Luminaire:
    """A distribution about an axis: `profile` over `SAMPLES` even angles from 0 to pi, its greatest value 1.

    `candela` is the intensity that 1 stands for and `lumens` the flux of the whole, both as the file has them;
    another flux F wants the intensity `candela * F / lumens`.
    """

    candela: float
    lumens: float
    profile: tuple[float, ...]


def parse_ies(text: str, *, source: str = "IES text") -> Luminaire:
    """Parse the text of an IES LM-63 file: TILT=NONE, type C, averaged over the horizontal angles.

    The candela multiplier and both ballast factors are applied. Raises `AssetError` with `source` and the fault.
    """
    tilt = re.search(r"^[ \t]*TILT[ \t]*=(.*)$", text, flags=re.MULTILINE)
    if tilt is None:
        raise AssetError(f"{source}: no line TILT=; this is not an IES LM-63 file")
    if tilt[1].strip().upper() != "NONE":
        raise AssetError(f"{source}: TILT={tilt[1].strip()}: only TILT=NONE is read; export the file without tilt")
    numbers = _numbers(text[tilt.end() :], source)
    vertical, horizontal, candela = _tables(numbers, source)
    return _luminaire(vertical, mean_about_axis(horizontal, candela), source)


def _numbers(text: str, source: str) -> Float64:
    """Read what follows TILT= as numbers, separated by blanks, commas or line ends."""
    words = text.replace(",", " ").split()
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError as error:
        raise AssetError(f"{source}: {error} after TILT=NONE; repair the file") from None
    if len(numbers) < 13:
        raise AssetError(
            f"{source}: only {len(numbers)} numbers after TILT=NONE, at least 13 are needed; it is cut off"
        )
    if not np.isfinite(numbers).all():
        raise AssetError(f"{source}: a value after TILT=NONE is not finite; repair the file")
    return numbers


def _tables(numbers: Float64, source: str) -> tuple[Float64, Float64, Float64]:
    """Return vertical angles (V,), horizontal angles (H,) [degrees] and candelas (H, V)."""
    multiplier, count_v, count_h, kind = (float(numbers[i]) for i in (2, 3, 4, 5))
    if kind != 1:
        raise AssetError(f"{source}: photometric type {kind:g} is not read; export the file as type C (1)")
    if count_v < 2 or count_h < 1 or count_v % 1 or count_h % 1:
        raise AssetError(
            f"{source}: {count_v:g} vertical and {count_h:g} horizontal angles; need 2 or more and 1 or more"
        )
    v, h = int(count_v), int(count_h)
    body = numbers[13:]
    if len(body) < v + h + v * h:
        raise AssetError(f"{source}: {len(body)} angles and candelas, {v + h + v * h} are needed; the file is cut off")
    vertical, horizontal = body[:v], body[v : v + h]
    candela = body[v + h : v + h + v * h].reshape(h, v) * multiplier * numbers[10] * numbers[11]
    for what, angles, top in (("vertical", vertical, 180.0), ("horizontal", horizontal, 360.0)):
        if (np.diff(angles) <= 0).any() or angles[0] < 0.0 or angles[-1] > top:
            raise AssetError(f"{source}: {what} angles must ascend within 0 and {top:g}, got {angles.tolist()[:6]}...")
    if (candela < 0).any() or not candela.max() > 0:
        raise AssetError(f"{source}: candelas must be 0 or more and not all 0; lowest {candela.min():g}")
    return vertical, horizontal, candela


def mean_about_axis(horizontal: Float64, candela: Float64) -> Float64:
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
        raise AssetError(f"{source}: all light lies between whole degrees; a beam this narrow is not read")
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


def ies_text(
    vertical: Iterable[float], horizontal: Iterable[float], candela: Iterable[Iterable[float]], *, form: str = ".6g"
) -> str:
    """Write IES LM-63-2002 text, type C: angles (V,) and (H,) [degrees], candelas (H, V); numbers as `form` says."""
    angles = list(vertical), list(horizontal)
    rows = [" ".join(f"{value:{form}}" for value in row) for row in (*angles, *candela)]
    header = f"1 -1 1 {len(angles[0])} {len(angles[1])} 1 2 0 0 0"
    return "\n".join(["IESNA:LM-63-2002", "[MANUFAC] DTC-MultiLight builder", "TILT=NONE", header, "1 1 0", *rows, ""])
