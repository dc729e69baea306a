"""Relighting, tone curves, radiometry and colour against published values and their own inverses."""

import math
import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from multilight.lights.display.tonemap import HIGHLIGHT_LIMIT, MIDDLE_GREY, meter_ev, to_display, tone_curve
from multilight.lights.photometry import luminaires, radiometry
from multilight.lights.photometry.colour import (
    GELS,
    gel_rgb,
    random_gel,
    temperature_of,
    temperature_to_rgb,
    temperature_to_xy,
)
from multilight.lights.photometry.directions import spot_frame
from multilight.lights.relight import gain_matrix, mix
from multilight.lights.rigs.lamps import Lamp, one_lumen
from multilight.lights.spec import AreaLight, LightingCondition, PointLight, SpotLight
from multilight.scenes.assets.builtin import skies as sky
from multilight.scenes.assets.formats.ies import profile_flux
from multilight.scenes.colour import LUMINANCE_WEIGHTS, luminance, srgb_decode, srgb_encode
from multilight.scenes.frozen import Rgb
from multilight.scenes.poses import matrix4

LIGHTS = ("key", "fill", "sky")
gain = st.floats(0.0, 8.0, width=32)
rgb = st.tuples(gain, gain, gain)
positive = st.floats(1e-3, 1e4)


def condition(gains: dict[str, tuple[float, float, float]], ev: float = 0.0) -> LightingCondition:
    return LightingCondition(name="test", gains=gains, exposure_ev=ev)


def layers(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).gamma(0.5, 2.0, (3, 4, 5, 3)).astype(np.float32)


# --- the one weighted sum ---


def test_mix_matches_the_sum_written_out() -> None:
    radiance = layers()
    got = mix(radiance, LIGHTS, condition({"sky": (1, 2, 3), "key": (0.5, 0, 0.25)}, ev=1.5))
    want = np.zeros(radiance.shape[1:])
    for c in range(3):
        want[..., c] = 2**1.5 * (radiance[2, ..., c] * (1, 2, 3)[c] + radiance[0, ..., c] * (0.5, 0, 0.25)[c])
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, want, rtol=1e-6)


@given(a=rgb, b=rgb, ev=st.floats(-4, 4))
def test_mix_is_linear_in_the_gains(a: Rgb, b: Rgb, ev: float) -> None:
    radiance = layers()
    both = (a[0] + b[0], a[1] + b[1], a[2] + b[2])
    summed = mix(radiance, LIGHTS, condition({"key": a}, ev)) + mix(radiance, LIGHTS, condition({"key": b}, ev))
    np.testing.assert_allclose(mix(radiance, LIGHTS, condition({"key": both}, ev)), summed, rtol=1e-5, atol=1e-5)


def test_one_ev_doubles_exactly() -> None:
    radiance = layers()
    once = mix(radiance, LIGHTS, condition({"fill": (1, 1, 1)}))
    np.testing.assert_array_equal(mix(radiance, LIGHTS, condition({"fill": (1, 1, 1)}, ev=1)), 2 * once)
    np.testing.assert_array_equal(once, radiance[1])


def test_absent_light_is_off_and_not_read() -> None:
    radiance = layers()
    radiance[0] = np.nan
    assert np.isfinite(mix(radiance, LIGHTS, condition({"fill": (1, 1, 1), "key": (0, 0, 0)}))).all()
    np.testing.assert_array_equal(mix(radiance, LIGHTS, condition({})), 0)


def test_mix_reads_half_floats_without_overflow() -> None:
    radiance = np.full((1, 1, 1, 3), 40000, np.float16)
    np.testing.assert_array_equal(mix(radiance, ["a"], condition({"a": (4, 4, 4)})), 160000)


def test_unknown_light_is_named_with_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"'lamp'.*'key', 'fill', 'sky'"):
        gain_matrix(LIGHTS, condition({"lamp": (1, 1, 1)}))


def test_mix_refuses_the_wrong_number_of_layers() -> None:
    with pytest.raises(ValueError, match=r"\(3, 4, 5, 3\).*2 light"):
        mix(layers(), ["a", "b"], condition({}))


# --- transfer curve, metering, tone curve ---


@pytest.mark.parametrize(
    ("encoded", "linear"),
    # IEC 61966-2-1, 8-bit codes to linear.
    [(0, 0.0), (10, 0.0030352698), (11, 0.0033465358), (127, 0.2122307574), (188, 0.5028864580), (255, 1.0)],
)
def test_srgb_reference_values(encoded: int, linear: float) -> None:
    assert srgb_decode(encoded / 255) == pytest.approx(linear, rel=1e-6)
    assert srgb_encode(linear) == pytest.approx(encoded / 255, rel=1e-6)


@given(st.floats(0, 1))
def test_srgb_round_trip(x: float) -> None:
    assert srgb_decode(srgb_encode(x)) == pytest.approx(x, abs=1e-7)


def test_luminance_of_white_is_one_and_keeps_the_type() -> None:
    assert luminance(np.ones(3)) == pytest.approx(1.0)
    assert luminance(np.ones((2, 2, 3), np.float32)).dtype == np.float32


@given(st.floats(1e-5, 1e5))
def test_even_picture_meters_to_middle_grey(level: float) -> None:
    picture = np.full((8, 8, 3), level)
    assert level * 2 ** meter_ev(picture) == pytest.approx(MIDDLE_GREY, rel=1e-6)


@given(level=st.floats(1e-3, 1e3), ev=st.floats(-8, 8))
def test_metering_follows_exposure(level: float, ev: float) -> None:
    picture = np.random.default_rng(1).gamma(1.0, level, (16, 16, 3)) + 1e-3 * level
    assert meter_ev(picture * 2**ev) == pytest.approx(meter_ev(picture) - ev, abs=1e-6)


def test_metering_is_robust() -> None:
    picture = np.full((40, 40, 3), 0.5)
    plain = meter_ev(picture)
    lamp, corner, broken = picture.copy(), picture.copy(), picture.copy()
    lamp[:4, :4] = 1e6
    corner[:, :20] = 1e-9
    broken[0, 0] = np.nan
    broken[0, 1] = np.inf
    for changed in (lamp, corner, broken):
        assert meter_ev(changed) == pytest.approx(plain, abs=0.3)
    assert meter_ev(np.zeros((4, 4, 3))) == 0.0
    assert meter_ev(np.full((4, 4, 3), np.nan)) == 0.0


def test_metering_holds_highlights_by_two_stops_at_most() -> None:
    picture = np.full((40, 40, 3), 0.1)
    picture[:4] = 1.2
    exposed = picture * 2 ** meter_ev(picture)
    assert luminance(exposed).max() == pytest.approx(HIGHLIGHT_LIMIT)
    picture[:4] = 10.0
    assert meter_ev(picture) > math.log2(MIDDLE_GREY / 0.1) - 2.7


@pytest.mark.parametrize(
    ("colour", "expected"),
    # Worked by hand from the formula.
    [
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ((0.01, 0.5, 0.6), (0.01, 0.5, 0.6)),
        # p = 2, p_n = 1 - 0.16 / 1.8 on every channel: grey stays grey
        ((2.0, 2.0, 2.0), (0.911111, 0.911111, 0.911111)),
        # p = 1, p_n = 0.8, kept = 1 / (0.15 * 0.2 + 1)
        ((1.0, 0.0, 0.0), (0.8, 0.8 - 0.8 / 1.03, 0.8 - 0.8 / 1.03)),
    ],
)
def test_tone_curve_reference_values(colour: Rgb, expected: Rgb) -> None:
    np.testing.assert_allclose(tone_curve(np.array(colour)), expected, atol=2e-6)


@given(colour=hnp.arrays(np.float64, 3, elements=st.floats(0, 1e4)), factor=st.floats(1.0, 4.0))
def test_tone_curve_stays_in_range_grows_and_keeps_the_order_of_channels(colour: np.ndarray, factor: float) -> None:
    low, high = tone_curve(colour), tone_curve(colour * factor)
    assert low.min() >= 0
    assert high.max() <= 1 + 1e-6
    assert high.max() >= low.max() - 1e-5
    assert (np.diff(low[np.argsort(colour)]) >= -1e-5).all()


def test_saturated_highlight_fades_to_white_in_its_own_hue() -> None:
    blue = to_display(np.array([[0.02, 0.1, 1.0]]) * 2.0 ** np.arange(12)[:, None])
    assert (blue[:, 2] >= blue[:, 1]).all()
    assert (blue[:, 1] >= blue[:, 0]).all()
    assert blue[-1].min() > 230


def test_display_of_broken_values() -> None:
    picture = np.array([[np.nan] * 3, [np.inf] * 3, [-np.inf] * 3, [-1.0] * 3, [3e38] * 3])
    np.testing.assert_array_equal(to_display(picture, 20.0)[:, 0], [0, 255, 0, 0, 255])


# --- radiometry ---


def test_reference_conversions() -> None:
    # An isotropic lamp of 4 pi lm gives 1 cd, and 1 cd gives 1 lux at 1 m.
    intensity = radiometry.watts_from_photometric(4 * math.pi) / (4 * math.pi)
    assert radiometry.photometric_from_watts(intensity) == pytest.approx(1.0)
    assert radiometry.watts_from_photometric(179.0) == 1.0
    # A Lambertian square metre of radiance 1 emits pi watts.
    assert radiometry.area_radiance_from_flux(math.pi, 1.0) == pytest.approx(1.0)
    # A hemisphere is half a sphere.
    assert radiometry.spot_solid_angle(math.pi / 2) == pytest.approx(2 * math.pi)
    assert radiometry.spot_solid_angle(math.pi) == pytest.approx(4 * math.pi)


@given(positive)
def test_photometric_quantities_are_read_back(x: float) -> None:
    assert radiometry.photometric_from_watts(radiometry.watts_from_photometric(x)) == pytest.approx(x)


@given(value=positive, colour=st.tuples(*[st.floats(0.01, 5.0)] * 3))
def test_coloured_quantity_has_the_asked_luminance(value: float, colour: Rgb) -> None:
    scaled = radiometry.rgb_from_scalar(value, colour)
    assert float(luminance(np.array(scaled))) == pytest.approx(value)
    assert scaled[0] / scaled[2] == pytest.approx(colour[0] / colour[2])


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: radiometry.area_radiance_from_flux(-1.0, 1.0), "flux -1.0"),
        (lambda: radiometry.area_radiance_from_flux(math.nan, 1.0), "flux nan"),
        (lambda: radiometry.area_radiance_from_flux(1.0, 0.0), "area 0.0"),
        (lambda: radiometry.spot_solid_angle(4.0), "half angle 4.0"),
        (lambda: radiometry.rgb_from_scalar(1.0, (0.0, 0.0, 0.0)), "one above 0"),
    ],
)
def test_impossible_quantities_are_named(call: Callable[[], object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        call()


# --- colour ---


@pytest.mark.parametrize(
    ("kelvin", "xy", "tolerance"),
    [
        # CIE standard illuminant A is a blackbody at 2855.54 K under the present c2.
        (2855.54, (0.44757, 0.40745), 5e-5),
        (2000.0, (0.5267, 0.4133), 2e-4),  # Wyszecki and Stiles, 1982, table 1(3.3.4)
        # D50, D65, D75 under the present c2: 5003, 6504 and 7504 K (CIE 015:2018).
        (5003.0, (0.34567, 0.35850), 2e-4),
        (6504.0, (0.31272, 0.32903), 2e-4),
        (7504.0, (0.29902, 0.31485), 2e-4),
    ],
)
def test_chromaticity_reference_values(kelvin: float, xy: tuple[float, float], tolerance: float) -> None:
    assert temperature_to_xy(kelvin) == pytest.approx(xy, abs=tolerance)


def test_daylight_at_6504_kelvin_is_white() -> None:
    assert temperature_to_rgb(6504) == pytest.approx((1, 1, 1), abs=2e-3)


@given(st.floats(1000, 25000))
def test_temperature_colours_have_unit_luminance_and_no_negative_channel(kelvin: float) -> None:
    colour = temperature_to_rgb(kelvin)
    assert min(colour) >= 0
    assert np.dot(LUMINANCE_WEIGHTS, colour) == pytest.approx(1.0)


def test_hotter_is_bluer_without_a_jump() -> None:
    kelvins = np.geomspace(1000, 25000, 400)
    xy = np.array([temperature_to_xy(k) for k in kelvins])
    colours = np.array([temperature_to_rgb(k) for k in kelvins])
    assert (np.diff(xy[:, 0]) < 0).all()
    assert (np.diff(colours[:, 0]) < 1e-6).all()
    assert (np.diff(colours[:, 2]) >= 0).all()
    assert np.abs(np.diff(xy, axis=0)).max() < 0.006


@pytest.mark.parametrize("kelvin", [999.0, 25001.0, math.nan, -5.0])
def test_temperature_outside_the_range_is_refused(kelvin: float) -> None:
    with pytest.raises(ValueError, match=r"outside 1000\.\.25000 K"):
        temperature_to_rgb(kelvin)


def test_gels_are_saturated_and_of_unit_luminance() -> None:
    assert len(GELS) >= 12
    colours = {name: np.array(gel_rgb(name)) for name in GELS}
    for colour in colours.values():
        assert luminance(colour) == pytest.approx(1.0)
        assert colour.min() > 0
    strong = [name for name, colour in colours.items() if colour.max() > 3 * colour.min()]
    assert len(strong) >= 12
    assert colours["primary_red"].argmax() == 0
    assert colours["primary_green"].argmax() == 1
    assert colours["deep_blue"].argmax() == 2


def test_random_gel_follows_its_generator() -> None:
    drawn = [random_gel(np.random.default_rng(seed)) for seed in range(60)]
    assert drawn == [random_gel(np.random.default_rng(seed)) for seed in range(60)]
    assert len(set(drawn)) > 8
    with pytest.raises(ValueError, match=r"no gel 'puce'.*magenta"):
        gel_rgb("puce")


def test_importing_lights_leaves_colour_science_alone() -> None:
    code = (
        "import sys, multilight.lights.photometry.colour, multilight.lights.photometry.radiometry\n"
        "import multilight.lights.relight; sys.exit('colour' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


# --- what lamps are sold by ---


def test_lamps_of_one_lumen() -> None:
    warm = temperature_to_rgb(2700)

    def photometric(light: Lamp) -> float:
        return 179.0 * one_lumen(light.scaled(7.0)).grey

    assert photometric(PointLight(name="a", position=(0, 0, 1), intensity=warm)) == pytest.approx(1 / (4 * math.pi))
    # 1 lm from 0.25 m²: exitance 4 lm/m², luminance 4 / pi.
    flat = AreaLight(name="a", width=0.5, height=0.5, world_from_light=matrix4(np.eye(4)), radiance=warm)
    assert photometric(flat) == pytest.approx(4 / math.pi)
    half = SpotLight(name="a", position=(0, 0, 1), direction=(0, 0, -1), intensity=warm, half_angle=1.0, blend=0.0)
    assert photometric(half) == pytest.approx(1 / (2 * math.pi * (1 - math.cos(1.0))))


@settings(deadline=None)
@given(half=st.floats(0.1, 1.4), blend=st.floats(0.0, 1.0))
def test_spot_solid_angle_is_the_integral_over_the_cone(half: float, blend: float) -> None:
    cosine = (np.arange(200_000) + 0.5) / 200_000 * (1 - math.cos(half)) + math.cos(half)
    t = np.clip((cosine - math.cos(half)) / max((1 - math.cos(half)) * blend, 1e-12), 0, 1)
    integral = 2 * math.pi * (1 - math.cos(half)) * float((t * t * (3 - 2 * t)).mean())
    assert radiometry.spot_solid_angle(half, blend) == pytest.approx(integral, rel=1e-3)


# --- luminaires ---


@pytest.mark.parametrize("name", luminaires.LUMINAIRES)
def test_built_in_luminaires_keep_their_flux(name: str) -> None:
    lamp = luminaires.luminaire(name)
    assert lamp.lumens == pytest.approx(luminaires.LUMINAIRES[name][0], rel=0.02)
    assert max(lamp.profile) == 1.0
    assert min(lamp.profile) >= 0.0
    below = profile_flux((*lamp.profile[:91], *[0.0] * 90)) * lamp.candela / lamp.lumens
    assert (below < 0.1) == (name == "uplight")
    assert PointLight(name="a", position=(0, 0, 1), intensity=(1, 1, 1), profile=lamp.profile).profile == lamp.profile


def test_beams_are_as_wide_as_they_are_called() -> None:
    def full_width(name: str) -> int:
        return 2 * int(np.argmax(np.array(luminaires.luminaire(name).profile) < 0.5))

    assert full_width("downlight_narrow") == pytest.approx(15, abs=2)
    assert full_width("downlight_medium") == pytest.approx(36, abs=3)
    assert full_width("downlight_wide") == pytest.approx(70, abs=6)
    assert np.argmax(luminaires.luminaire("batwing").profile) in range(36, 48)
    with pytest.raises(ValueError, match=r"no luminaire 'torch'.*batwing"):
        luminaires.luminaire("torch")


# --- frames ---


@given(direction=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda d: math.hypot(*d) > 1e-3), roll=st.floats(-7, 7))
def test_spot_frame_is_a_rotation_that_looks_along_its_direction(direction: Rgb, roll: float) -> None:
    frame = spot_frame(direction, roll)
    np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-9)
    assert np.linalg.det(frame) == pytest.approx(1.0)
    np.testing.assert_allclose(-frame[:, 2], np.array(direction) / math.hypot(*direction), atol=1e-9)
    if math.hypot(direction[0], direction[1]) > 1e-2:
        unrolled = spot_frame(direction)
        assert unrolled[2, 0] == pytest.approx(0.0, abs=1e-9), "right is level"
        assert unrolled[2, 1] > 0, "up is up"
        np.testing.assert_allclose(frame[:, 0], math.cos(roll) * unrolled[:, 0] + math.sin(roll) * unrolled[:, 1])


def test_spot_frame_of_plain_directions() -> None:
    north = spot_frame((0, 2, 0))
    np.testing.assert_allclose(north, np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]), atol=1e-12)
    down = spot_frame((0, 0, -1))
    np.testing.assert_allclose(down, np.eye(3), atol=1e-12)
    # Seen along +Y, a point to the right and above lies at positive x and y, before the light at negative z.
    np.testing.assert_allclose(np.array([0.3, 1.0, 0.2]) @ north, (0.3, 0.2, -1.0), atol=1e-12)
    with pytest.raises(ValueError, match="no length"):
        spot_frame((0, 0, 0))


# --- colour temperatures read back ---


@pytest.mark.parametrize("kelvin", [1900, 2856, 4000, 5003, 6504, 12000])
def test_temperature_is_read_back(kelvin: float) -> None:
    red, green, blue = temperature_to_rgb(kelvin)
    found, saturation = temperature_of((7 * red, 7 * green, 7 * blue))
    assert found == pytest.approx(kelvin, rel=2e-3)
    assert saturation < 1e-3


def test_gels_are_more_saturated_than_whites() -> None:
    strong = ("primary_red", "primary_green", "deep_blue", "magenta", "purple")
    assert min(temperature_of(gel_rgb(name))[1] for name in strong) > 0.08
    pale, full = temperature_of(gel_rgb("magenta", 0.2))[1], temperature_of(gel_rgb("magenta"))[1]
    assert pale < full


# --- sky and sun ---


def test_preetham_zenith_worked_by_hand() -> None:
    # T = 3, sun 30 degrees from the zenith: chi = (4/9 - 1/40) (pi - pi/3) = 0.878483, tan 1.205933.
    assert sky.zenith_luminance(math.pi / 6, 3.0) == pytest.approx(7.1649 * 1.205933 + 1.7727, rel=1e-5)
    # At the zenith the Perez ratio is one: the formula's own luminance comes out.
    up = sky.clear_sky(np.array([0.0, 0.0, 1.0]), elevation=math.pi / 3, turbidity=3.0)
    assert luminance(up) == pytest.approx(sky.zenith_luminance(math.pi / 6, 3.0), rel=1e-3)
    assert up[2] > up[0], "a clear zenith is blue"


@pytest.mark.parametrize("degrees", [10, 25, 40, 60])
def test_sun_agrees_with_the_ies_clear_sky(degrees: float) -> None:
    # IES Lighting Handbook: 127.5 exp(-0.21 m) klx on a surface that faces the sun, clear sky, m = 1 / sin(altitude).
    height = math.radians(degrees)
    expected = 127.5 * math.exp(-0.21 / math.sin(height))
    assert luminance(np.array(sky.sun_illuminance(elevation=height, turbidity=2.0))) == pytest.approx(
        expected, rel=0.12
    )


def test_rayleigh_depth_is_the_published_one() -> None:
    # A. Bucholtz, Rayleigh-scattering calculations for the terrestrial atmosphere, 1995: 0.0973 at 550 nm; the
    # matching functions' fit peaks near 555 nm and gives unit luminance there.
    assert abs(0.008735 * 0.55**-4.08 / 0.0973 - 1) < 0.04
    nm = np.arange(380.0, 781.0)
    matching = sky.colour_matching(nm)
    assert nm[matching[:, 1].argmax()] == pytest.approx(555, abs=4)
    # Equal-energy light has x = y = 1/3.
    np.testing.assert_allclose(matching.sum(axis=0) / matching.sum(), 1 / 3, atol=2e-3)


@pytest.mark.parametrize(("name", "low", "high"), [("sky-60-2", 13, 17), ("sky-25-3", 9, 14), ("sky-overcast", 11, 14)])
def test_skies_have_the_illuminance_of_the_day(name: str, low: float, high: float) -> None:
    image = sky.sky_map(name)
    assert image.shape == (sky.ROWS, 2 * sky.ROWS, 3)
    assert image.min() >= 0
    latitude = math.pi / 2 - math.pi * (np.arange(sky.ROWS) + 0.5) / sky.ROWS
    weight = np.maximum(np.sin(latitude), 0) * np.cos(latitude) * (math.pi / sky.ROWS) ** 2
    assert low < float((luminance(image.astype(float)) * weight[:, None]).sum()) < high
    half = sky.ROWS // 2
    if name != sky.OVERCAST:
        row = luminance(image)[: half - 8]
        assert abs(int(row.max(axis=0).argmax()) - sky.ROWS) <= 2, "the sun stands in the centre column"
    assert luminance(image)[half + 20 :].std() < 1e-3, "the ground is even"


def test_low_suns_are_red_and_weak() -> None:
    suns = [np.array(sky.sun_illuminance(elevation=math.radians(e), turbidity=3.0)) for e in (3, 8, 25, 60)]
    assert (np.diff([luminance(sun) for sun in suns]) > 0).all()
    assert (np.diff([sun[2] / sun[0] for sun in suns]) > 0).all()
    assert 85 < luminance(suns[-1]) < 105


def test_sky_names() -> None:
    assert sky.sky_parameters("sky-25-3") == (pytest.approx(math.radians(25)), 3.0)
    assert sky.sky_name(math.radians(22), 3.4) == "sky-25-3"
    assert {sky.sky_name(math.radians(e), t) for e in range(1, 90) for t in (2, 3, 6)} == set(sky.SKIES) - {
        sky.OVERCAST
    }
