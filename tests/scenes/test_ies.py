"""IES files: averaged about the axis, resampled, scaled; what is broken is named."""

import math

import numpy as np
import pytest

from multilight.scenes.assets.formats.ies import SAMPLES, parse_ies, profile_flux
from multilight.scenes.assets.info import AssetError

IES = """IESNA:LM-63-1995
[TEST] a made-up lamp
TILT=NONE
1 1000 2.0 4 3 1 2 0 0 0
0.5 1.0 20
0 30 60, 90
0 90 180
100 80 20 0
100 60 20 0
100 40 20 0
"""


def test_ies_is_averaged_scaled_and_resampled() -> None:
    lamp = parse_ies(IES)
    # Multiplier 2 times ballast factor 0.5; the mean over 0..180 by trapezoids is 60 at 30 degrees.
    assert lamp.candela == pytest.approx(100.0)
    assert len(lamp.profile) == SAMPLES
    assert lamp.profile[30] == pytest.approx(0.6)
    assert lamp.profile[15] == pytest.approx(0.8)
    assert lamp.profile[75] == pytest.approx(0.1)
    assert not any(lamp.profile[90:])
    angle = np.linspace(0, math.pi, 100_001)
    curve = np.interp(angle, np.linspace(0, math.pi, len(lamp.profile)), lamp.profile)
    expected = 2 * math.pi * float((curve * np.sin(angle)).mean() * math.pi) * 100
    assert lamp.lumens == pytest.approx(expected, rel=1e-4)


def test_flux_of_an_even_profile_is_a_sphere() -> None:
    assert profile_flux((1.0,) * 7) == pytest.approx(4 * math.pi)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("TILT=NONE", "", "no line TILT="),
        ("TILT=NONE", "TILT=INCLUDE", "TILT=INCLUDE: only TILT=NONE"),
        ("1 1000 2.0 4 3 1", "1 1000 2.0 4 3 2", "photometric type 2"),
        ("100 40 20 0\n", "", "15 angles and candelas, 19 are needed"),
        ("100 80", "100 eighty", "eighty"),
        ("100 80", "100 nan", "not finite"),
        ("100 80", "100 -80", "lowest -80"),
        ("0 30 60, 90", "0 60 30, 90", "vertical angles must ascend"),
        ("1 1000 2.0 4 3 1", "1 1000 2.0 1 3 1", "1 vertical"),
        ("1 1000 2.0", "1 1000 0.0", "not all 0"),
    ],
)
def test_broken_ies_is_named(old: str, new: str, words: str) -> None:
    assert old in IES
    with pytest.raises(AssetError, match=f"lamp.ies: .*{words}"):
        parse_ies(IES.replace(old, new, 1), source="lamp.ies")
