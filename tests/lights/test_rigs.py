"""Rigs and conditions: every light reaches the table, powers are in balance, shadows fall into view."""

import math

import numpy as np
import pytest

from multilight.lights.photometry.colour import temperature_of, temperature_to_rgb
from multilight.lights.photometry.irradiance import LightMeter, map_directions
from multilight.lights.rigs.balance import FAINTEST
from multilight.lights.rigs.daylight import overcast, sun_and_sky
from multilight.lights.rigs.design import RATIOS, SIZES, RigDesign, rig_design
from multilight.lights.rigs.measure import LightMeasure, measure_light
from multilight.lights.rigs.natural import natural_rig
from multilight.lights.rigs.sample import ALL_KINDS, SPHERES_KINDS, sample_rig
from multilight.lights.sample_conditions import EXPOSURE, random_condition, sample_conditions
from multilight.lights.spec import (
    AreaLight,
    EmissiveLight,
    EnvironmentLight,
    LightingCondition,
    LightRig,
    PointLight,
    SpotLight,
    SunLight,
)
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.cameras.pinhole import look_at
from multilight.scenes.colour import luminance
from multilight.scenes.frozen import triple
from multilight.scenes.kinds.spheres import sample_spheres
from multilight.scenes.kinds.tabletop import sample_tabletop
from multilight.scenes.poses import matrix4
from multilight.scenes.random_streams import Streams
from multilight.scenes.spec import SceneSpec
from multilight.scenes.still_life.sample import StillLifeSettings
from multilight.scenes.still_life.setting import emissive_candidate

COUNT = 14


@pytest.fixture(scope="module")
def library() -> AssetLibrary:
    return AssetLibrary(packs=("builtin",))


@pytest.fixture(scope="module")
def lit(library: AssetLibrary) -> list[tuple[SceneSpec, LightRig]]:
    settings = StillLifeSettings(width=64, height=64, views=4, objects=(3, 5))
    result = []
    for i in range(COUNT):
        scene = sample_tabletop(Streams(11, i), library, index=i, settings=settings)
        result.append((scene, sample_rig(Streams(11, i), scene, library)))
    return result


@pytest.fixture(scope="module")
def spheres(library: AssetLibrary) -> LightMeter:
    scene = sample_spheres(Streams(0, 0), index=0, width=64, height=64, views=4)
    return LightMeter.of(scene, library)


def test_every_light_reaches_the_table_in_balance(lit: list[tuple[SceneSpec, LightRig]], library: AssetLibrary) -> None:
    for scene, rig in lit:
        meter = LightMeter.of(scene, library)
        light = np.array([meter.dome_irradiance(light) for light in rig.lights])
        assert 1 <= len(light) <= 8
        assert (light >= light.max() * FAINTEST / 1.01).all() or "glow" in rig.names
        # 2 lx is a candle across the table, 20,000 lx a hazy day.
        assert 2 < light.max() * 179 < 20_000


def test_lamps_have_a_free_line_of_sight_and_hang_above_the_table(
    lit: list[tuple[SceneSpec, LightRig]], library: AssetLibrary
) -> None:
    for scene, rig in lit:
        meter = LightMeter.of(scene, library)
        for light in rig.lights:
            if isinstance(light, PointLight | SpotLight | AreaLight):
                where = light.world_from_light if isinstance(light, AreaLight) else None
                position = np.array(light.position) if where is None else np.array(where)[:3, 3]
                assert position[2] > meter.foot[2]
                assert meter.seen_fraction(position) >= 0.6
                assert 0.3 < np.linalg.norm(position - meter.foot) < 4.5
                aimed = meter.foot - position
                if where is not None:
                    assert -np.array(where)[:3, 2] @ aimed / np.linalg.norm(aimed) > 0.7
            if isinstance(light, SunLight):
                assert meter.open_fraction(-np.array([light.direction]))[0] >= 0.6


def test_the_ratio_of_key_to_fill_is_the_designed_one(
    lit: list[tuple[SceneSpec, LightRig]], library: AssetLibrary
) -> None:
    near = 0
    for i, (scene, rig) in enumerate(lit):
        meter, wanted = LightMeter.of(scene, library), rig_design(Streams(11, i)).key_to_fill
        fill = [meter.dome_irradiance(light) for light in rig.lights[1:] if not isinstance(light, EmissiveLight)]
        if fill:
            ratio = meter.dome_irradiance(rig.lights[0]) / sum(fill)
            assert ratio < wanted * 1.01, "weak lights are raised, never lowered"
            near += ratio > 0.9 * wanted
    assert near >= COUNT / 2


def test_the_key_comes_from_where_it_was_designed(lit: list[tuple[SceneSpec, LightRig]], library: AssetLibrary) -> None:
    off = []
    for i, (scene, rig) in enumerate(lit):
        design, key = rig_design(Streams(11, i)), measure_light(rig.lights[0], LightMeter.of(scene, library))
        if key.kind in ("point", "spot", "area"):
            off.append(abs(float(np.angle(np.exp(1j * (key.azimuth - design.azimuth))))))
    assert len(off) > 4
    assert np.median(off) < 0.25


def test_glow_is_on_the_object_that_is_meant_to_glow(lit: list[tuple[SceneSpec, LightRig]]) -> None:
    found = 0
    for scene, rig in lit:
        glowing = [(light.body, light.part) for light in rig.lights if isinstance(light, EmissiveLight)]
        wanted = emissive_candidate(scene)
        assert glowing == ([] if wanted is None else [wanted])
        found += len(glowing)
    assert found > 0


def test_rigs_vary_and_are_repeatable(lit: list[tuple[SceneSpec, LightRig]], library: AssetLibrary) -> None:
    kinds = {light.kind for _, rig in lit for light in rig.lights}
    assert kinds >= {"environment", "sun", "area", "spot", "point", "emissive"}
    scene, rig = lit[3]
    assert sample_rig(Streams(11, 3), scene, library) == rig
    assert sample_rig(Streams(12, 3), scene, library) != rig
    assert LightRig.from_json(rig.canonical_json()) == rig


def test_only_the_kinds_asked_for(lit: list[tuple[SceneSpec, LightRig]], library: AssetLibrary) -> None:
    rig = sample_rig(Streams(0, 0), lit[0][0], library, kinds=("area", "environment"), lights=(2, 2))
    assert sorted(light.kind for light in rig.lights) in (["area", "environment"], ["area", "area"])
    assert set(SPHERES_KINDS) < set(ALL_KINDS)
    with pytest.raises(ValueError, match="none of point, spot, area"):
        sample_rig(Streams(0, 0), lit[0][0], library, kinds=("environment",))


def test_spheres_get_uniform_environments_and_hard_lamps(library: AssetLibrary) -> None:
    for index in range(8):
        scene = sample_spheres(Streams(3, index), index=index, width=64, height=64, views=4)
        for light in sample_rig(Streams(3, index), scene, library, kinds=SPHERES_KINDS).lights:
            assert light.kind in SPHERES_KINDS
            assert not isinstance(light, EnvironmentLight) or light.map is None
            assert not isinstance(light, PointLight | SpotLight) or light.radius == 0.0
            assert getattr(light, "profile", None) is None
            assert getattr(light, "gobo", None) is None


def test_uniform_sky_gives_pi_times_its_radiance(spheres: LightMeter) -> None:
    sky = EnvironmentLight(name="sky", radiance=(2.0, 2.0, 2.0))
    assert spheres.table_irradiance(sky) == pytest.approx(2 * math.pi, rel=2e-3)


def test_small_maps_cover_the_sphere() -> None:
    directions, solid_angle = map_directions(0.3)
    assert solid_angle.sum() * directions.shape[1] == pytest.approx(4 * math.pi)
    centre = (directions[:, 31] + directions[:, 32]).sum(axis=0)
    assert math.atan2(centre[1], centre[0]) == pytest.approx(0.3)
    assert directions[0, 0, 2] > 0.99
    assert directions[16, 40] @ [-math.sin(0.3), math.cos(0.3), 0] < 0, "azimuth runs to the left"


def test_point_and_sun_follow_the_cosine_law(spheres: LightMeter) -> None:
    x, y, z = (float(v) for v in spheres.foot)
    above = PointLight(name="a", position=(x, y, z + 2.0), intensity=(8.0, 8.0, 8.0))
    aside = PointLight(name="b", position=(x + 2.0, y, z + 2.0), intensity=(8.0, 8.0, 8.0))
    assert spheres.table_irradiance(above) == pytest.approx(2.0)
    assert spheres.table_irradiance(aside) == pytest.approx(1.0 / math.sqrt(2))
    sun = SunLight(name="s", direction=(0.0, math.sqrt(3), -1.0), irradiance=(4.0, 4.0, 4.0))
    assert spheres.table_irradiance(sun) == pytest.approx(2.0)


def test_area_lamp_against_closed_form(spheres: LightMeter) -> None:
    # A Lambertian disk of radius r, parallel and centred at height h: E = pi L r² / (r² + h²).
    position = spheres.foot + np.array([0.0, 0.0, 0.8])
    pose = matrix4(look_at(position, spheres.foot, up=(1.0, 0.0, 0.0)))
    disk = AreaLight(name="d", shape="disk", width=0.6, height=0.6, world_from_light=pose, radiance=(5.0, 5.0, 5.0))
    expected = math.pi * 5.0 * 0.09 / (0.09 + 0.64)
    assert spheres.table_irradiance(disk) == pytest.approx(expected, rel=0.03)
    assert spheres.table_irradiance(disk.scaled(3.0)) == pytest.approx(3 * spheres.table_irradiance(disk))


def test_a_dome_meter_counts_light_from_the_side(spheres: LightMeter) -> None:
    level = SunLight(name="s", direction=(1.0, 0.0, -1e-9), irradiance=(4.0, 4.0, 4.0))
    above = level.model_copy(update={"direction": (0.0, 0.0, -1.0)})
    assert spheres.table_irradiance(level) == pytest.approx(0.0, abs=1e-6)
    assert spheres.dome_irradiance(level) == pytest.approx(2.0)
    assert spheres.dome_irradiance(above) == spheres.table_irradiance(above) == pytest.approx(4.0)
    # The upper half of a uniform sky L: 2 pi L times the mean of (1 + cos) / 2 over it, 3/4. The ground hides the rest.
    sky = EnvironmentLight(name="sky", radiance=(2.0, 2.0, 2.0))
    assert spheres.dome_irradiance(sky) == pytest.approx(3 * math.pi, rel=0.02)


def test_profiles_cones_and_gobos_count_in_the_irradiance(spheres: LightMeter) -> None:
    x, y, z = (float(v) for v in spheres.foot)
    lamp = {"name": "a", "position": (x, y, z + 2.0), "intensity": (8.0, 8.0, 8.0)}
    even = spheres.table_irradiance(PointLight(**lamp))
    half = PointLight(**lamp, profile=(0.5, 1.0, 0.0))
    assert spheres.table_irradiance(half) == pytest.approx(even / 2)
    assert spheres.table_irradiance(half.model_copy(update={"direction": (1.0, 0.0, 0.0)})) == pytest.approx(even)
    spot = SpotLight(**lamp, direction=(0.0, 0.0, -1.0), half_angle=0.5)
    assert spheres.table_irradiance(spot) == pytest.approx(even)
    assert spheres.table_irradiance(spot.model_copy(update={"direction": (0.0, 1.0, -1.0)})) == 0.0
    gobo = spot.model_copy(update={"gobo": "builtin/gobo-dots"})
    assert 0.1 * even < spheres.table_irradiance(gobo) < 0.6 * even


# --- designs ---


def designs(count: int, seed: int = 3) -> list[RigDesign]:
    return [rig_design(Streams(seed, i)) for i in range(count)]


def test_designs_depend_on_nothing_but_their_key() -> None:
    some = designs(6)
    assert [rig_design(Streams(3, i)) for i in reversed(range(6))] == some[::-1]
    assert rig_design(Streams(4, 0)) != some[0]
    again = rig_design(Streams(3, 0, attempt=1))
    assert again != some[0]
    assert again == rig_design(Streams(3, 0, attempt=1))
    assert RigDesign.from_json(some[0].canonical_json()) == some[0]


def test_designs_cover_every_axis_evenly() -> None:
    """Of 64 scenes every eighth of each axis gets its eight: plain random draws leave some with three or fewer."""
    drawn = designs(64)
    axes = {
        "azimuth": np.unwrap([d.azimuth for d in drawn]) % (2 * np.pi),
        "elevation": np.array([d.elevation for d in drawn]),
        "angular_size": np.log([d.angular_size for d in drawn]),
        "key_to_fill": np.log([d.key_to_fill for d in drawn]),
    }
    for name, values in axes.items():
        if name != "azimuth":
            counts, _ = np.histogram(values, 8, (values.min(), values.max()))
            assert counts.min() >= 6, (name, counts)
    sides = np.array([d.azimuth for d in drawn])
    assert (sides > 0).sum() == 32
    assert (np.abs(sides) < np.radians(50)).sum() in range(6, 10), "few keys are frontal"
    sizes = [d.angular_size for d in drawn]
    assert min(sizes) < 1.3 * SIZES[0]
    assert max(sizes) > 0.75 * SIZES[1]
    assert all(RATIOS[0] <= d.key_to_fill <= RATIOS[1] for d in drawn)
    assert {d.key for d in drawn} == {"area", "point", "spot", "sun", "environment"}
    assert {d.lights for d in drawn} == set(range(1, 9))
    assert 7 <= sum(d.gel_saturation > 0 for d in drawn) <= 14
    assert sum(d.gel_saturation > 0.6 for d in drawn) <= 4, "what floods a scene in one colour is rare"
    assert 4500 < np.median([d.colour_temperature for d in drawn]) < 5800
    # Pairs are covered too: every quarter of elevation meets every quarter of size.
    table, _, _ = np.histogram2d(axes["elevation"], axes["angular_size"], 4)
    assert table.min() >= 2


def test_soft_keys_are_large_and_hard_ones_small() -> None:
    for design in designs(128):
        if design.key in ("point", "spot"):
            assert design.angular_size <= 0.25
        if design.key == "area":
            assert design.angular_size >= 0.04


# --- what a rig is like, read back ---


def measured(spheres: LightMeter, light: object) -> LightMeasure:
    return measure_light(light, spheres)  # type: ignore[arg-type]


def test_measures_of_plain_lights(spheres: LightMeter) -> None:
    x, y, z = (float(v) for v in spheres.foot)
    azimuth = spheres.camera + 1.0
    position = (x + math.cos(azimuth), y + math.sin(azimuth), z + 1.0)
    point = measured(spheres, PointLight(name="p", position=position, intensity=(1.0, 1.0, 1.0), radius=0.1))
    assert (point.azimuth, point.elevation) == (pytest.approx(1.0), pytest.approx(math.pi / 4))
    assert point.angular_size == pytest.approx(2 * math.atan(0.1 / math.sqrt(2)))
    assert point.illuminance == pytest.approx(179 / 2 * math.sqrt(0.5))
    assert point.temperature == pytest.approx(6504, rel=0.01)
    assert point.saturation < 0.002
    sun = measured(spheres, SunLight(name="s", direction=(0, 0, -3), irradiance=(3, 1, 1), angle=0.01))
    assert (sun.elevation, sun.angular_size) == (pytest.approx(math.pi / 2), 0.01)
    assert sun.saturation > 0.02
    sky = measured(spheres, EnvironmentLight(name="e"))
    assert sky.elevation == pytest.approx(math.pi / 2, abs=0.01)
    assert sky.angular_size == pytest.approx(math.pi, rel=0.01), "an even sky is as soft as light gets"
    narrow = EnvironmentLight(name="e", map="builtin/sky-25-3", rotation=azimuth)
    assert 0.3 < measured(spheres, narrow).angular_size < sky.angular_size
    assert abs(measured(spheres, narrow).azimuth - 1.0) < 0.05


# --- other kinds of scenes ---


@pytest.mark.parametrize("kind", ["studio", "outdoor"])
def test_studio_and_outdoor_rigs(lit: list[tuple[SceneSpec, LightRig]], library: AssetLibrary, kind: str) -> None:
    names: set[str] = set()
    for i, (scene, _) in enumerate(lit):
        placed = scene.model_copy(update={"kind": kind})
        rig = sample_rig(Streams(11, i), placed, library)
        assert i > 0 or sample_rig(Streams(11, i), placed, library) == rig
        assert 1 <= len(rig.lights) <= 8
        assert ("glow" in rig.names) == (emissive_candidate(scene) is not None)
        names |= set(rig.names)
        meter = LightMeter.of(placed, library)
        lux = 179 * sum(meter.dome_irradiance(light) for light in rig.lights)
        assert 2 < lux < (150_000 if kind == "outdoor" else 12_000)
    wanted = {"key", "fill", "rim"} if kind == "studio" else {"sun", "sky", "environment", "lamp"}
    assert names >= wanted


def test_sun_and_sky_keep_their_true_strengths(spheres: LightMeter) -> None:
    sun, sky = sun_and_sky(0.4, math.radians(40), 2.0)
    assert 85_000 < 179 * luminance(np.array(sun.irradiance)) < 105_000
    assert 11_000 < 179 * spheres.table_irradiance(sky) < 17_000
    way = -np.array(sun.direction)
    assert math.atan2(way[1], way[0]) == pytest.approx(0.4)
    assert sky.rotation == pytest.approx(0.4), "the sky is brightest about its sun"
    cloudy = 179 * spheres.table_irradiance(overcast(0.0))
    assert 10_000 < cloudy < 14_000


@pytest.mark.parametrize("wild", [False, True])
def test_conditions(lit: list[tuple[SceneSpec, LightRig]], wild: bool) -> None:
    for i, (_, rig) in enumerate(lit):
        rig = rig if wild else natural_rig(rig)
        conditions = sample_conditions(np.random.default_rng(i), rig, wild=wild)
        assert len(conditions) == 12
        assert len({c.name for c in conditions}) == 12
        assert len({c.model_copy(update={"name": "x"}).canonical_json() for c in conditions}) == 12
        everything = conditions[0]
        assert everything.name == "all"
        assert everything.gains == dict.fromkeys(rig.names, (1.0, 1.0, 1.0))
        assert everything.exposure_ev == 0.0
        for light in rig.lights if len(rig.lights) > 1 else ():
            alone = [set(c.gains) for c in conditions if c.name == f"{light.name}_only"]
            assert alone == ([{light.name}] if wild or light.gel is None else [])
        for condition in conditions:
            assert set(condition.gains) <= set(rig.names)
            assert abs(condition.exposure_ev) <= EXPOSURE
            assert LightingCondition.from_json(condition.canonical_json()) == condition


def test_natural_rigs_are_white_and_as_bright(lit: list[tuple[SceneSpec, LightRig]]) -> None:
    assert any(light.gel for _, rig in lit for light in rig.lights if not isinstance(light, EmissiveLight))
    for _, rig in lit:
        for old, new in zip(rig.lights, natural_rig(rig).lights, strict=True):
            assert new.name == old.name
            assert new.grey == pytest.approx(old.grey)
            if isinstance(old, EmissiveLight):
                assert new == old
            elif old.colour_temperature is not None:
                kelvin, distance = temperature_of(new.amount)
                assert new.gel is None
                assert 2450 <= kelvin <= 8100
                assert distance < 0.003


def test_conditions_are_white_and_gels_rare_unless_wild() -> None:
    places = [(float(i), 0.0, 1.0) for i in range(3)]
    rig = LightRig(lights=tuple(
        PointLight(name=f"p{i}", position=place, intensity=temperature_to_rgb(t), colour_temperature=t)
        for i, (place, t) in enumerate(zip(places, (2600.0, 5000.0, 7500.0), strict=True))
    ))  # fmt: skip
    tinted = {False: 0, True: 0}
    for seed in range(200):
        for wild in tinted:
            for condition in sample_conditions(np.random.default_rng(seed), rig, wild=wild)[1:]:
                amounts = [np.multiply(light.amount, condition.gains[light.name]) for light in rig.lights
                           if light.name in condition.gains]  # fmt: skip
                colours = [temperature_of(triple(amount)) for amount in amounts]
                coloured = any(off > 0.008 or not 2400 <= kelvin <= 8300 for kelvin, off in colours)
                tinted[wild] += coloured
                assert wild or not (coloured and len(condition.gains) == 1)
    assert 0.02 < tinted[False] / 2200 < 1 / 12
    assert tinted[True] / 2200 > 0.2


def test_conditions_of_one_light_and_few_conditions() -> None:
    rig = LightRig(lights=(EnvironmentLight(name="sky"),))
    conditions = sample_conditions(np.random.default_rng(0), rig, 5)
    assert len({c.canonical_json() for c in conditions}) == 5
    assert [c.name for c in sample_conditions(np.random.default_rng(0), rig, 1)] == ["all"]


def test_random_conditions_are_repeatable_and_never_dark() -> None:
    rig = LightRig(lights=(EnvironmentLight(name="sky"), PointLight(name="p", position=(0, 0, 1), intensity=(1, 1, 1))))
    for seed in range(50):
        first, second = (random_condition(np.random.default_rng(seed), rig, "r") for _ in range(2))
        assert first == second
        assert first.gains
