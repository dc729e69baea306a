"""Rigs and conditions: every light reaches the table, powers are in balance, shadows fall into view."""

import math

import numpy as np
import pytest

from lights.conditions import EXPOSURE, random_condition, sample_conditions
from lights.irradiance import StillLife, map_directions
from lights.rigs import ALL_KINDS, SPHERES_KINDS, sample_rig, scaled
from lights.spec import (
    AreaLight,
    EmissiveLight,
    EnvironmentLight,
    LightingCondition,
    LightRig,
    PointLight,
    SpotLight,
    SunLight,
)
from scenes.assets.library import AssetLibrary
from scenes.cameras import look_at, matrix4
from scenes.spec import SceneSpec
from scenes.spheres import sample_spheres
from scenes.streams import Streams
from scenes.tabletop import TabletopSettings, emissive_candidate, sample_tabletop

COUNT = 14


@pytest.fixture(scope="module")
def library() -> AssetLibrary:
    return AssetLibrary(packs=("builtin",))


@pytest.fixture(scope="module")
def lit(library: AssetLibrary) -> list[tuple[SceneSpec, LightRig]]:
    settings = TabletopSettings(width=64, height=64, views=4, objects=(3, 5))
    result = []
    for i in range(COUNT):
        scene = sample_tabletop(Streams(11, i), library, index=i, settings=settings)
        result.append((scene, sample_rig(Streams(11, i), scene, library)))
    return result


@pytest.fixture(scope="module")
def spheres(library: AssetLibrary) -> StillLife:
    scene = sample_spheres(Streams(0, 0), index=0, width=64, height=64, views=4)
    return StillLife.of(scene, library)


def test_every_light_reaches_the_table_in_balance(lit: list[tuple[SceneSpec, LightRig]], library: AssetLibrary) -> None:
    for scene, rig in lit:
        place = StillLife.of(scene, library)
        light = np.array([place.table_irradiance(light) for light in rig.lights])
        assert 2 <= len(light) <= 6
        assert (light > 0).all()
        assert (light >= np.median(light) / 8).all()
        assert (light <= np.median(light) * 8).all()
        # 20 lx is a dim room, 20,000 lx a hazy day.
        assert 20 < light.max() * 179 < 20_000


def test_lamps_have_a_free_line_of_sight_and_hang_above_the_table(
    lit: list[tuple[SceneSpec, LightRig]], library: AssetLibrary
) -> None:
    for scene, rig in lit:
        place = StillLife.of(scene, library)
        for light in rig.lights:
            if isinstance(light, PointLight | SpotLight | AreaLight):
                where = light.world_from_light if isinstance(light, AreaLight) else None
                position = np.array(light.position) if where is None else np.array(where)[:3, 3]  # type: ignore[union-attr]
                assert position[2] > place.foot[2]
                assert place.seen_share(position) >= 0.6
                assert 0.3 < np.linalg.norm(position - place.foot) < 3.0
                aimed = place.foot - position
                if where is not None:
                    assert -np.array(where)[:3, 2] @ aimed / np.linalg.norm(aimed) > 0.7
            if isinstance(light, SunLight):
                assert place.open_share(-np.array([light.direction]))[0] >= 0.6


def test_the_key_is_not_frontal(lit: list[tuple[SceneSpec, LightRig]], library: AssetLibrary) -> None:
    for scene, rig in lit:
        place = StillLife.of(scene, library)
        key = rig.lights[0]
        assert key.name == "key"
        position = np.array(key.world_from_light)[:3, 3] if isinstance(key, AreaLight) else np.array(key.position)  # type: ignore[union-attr]
        way = position - place.aim
        turn = np.angle(np.exp(1j * (math.atan2(way[1], way[0]) - place.camera)))
        assert abs(turn) > math.radians(59) or way[2] > 3 * np.hypot(way[0], way[1])


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
    assert kinds >= {"environment", "area", "spot", "point", "emissive"}
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


def test_uniform_sky_gives_pi_times_its_radiance(spheres: StillLife) -> None:
    sky = EnvironmentLight(name="sky", radiance=(2.0, 2.0, 2.0))
    assert spheres.table_irradiance(sky) == pytest.approx(2 * math.pi, rel=2e-3)


def test_small_maps_cover_the_sphere() -> None:
    directions, solid_angle = map_directions(0.3)
    assert solid_angle.sum() * directions.shape[1] == pytest.approx(4 * math.pi)
    centre = (directions[:, 31] + directions[:, 32]).sum(axis=0)
    assert math.atan2(centre[1], centre[0]) == pytest.approx(0.3)
    assert directions[0, 0, 2] > 0.99
    assert directions[16, 40] @ [-math.sin(0.3), math.cos(0.3), 0] < 0, "azimuth runs to the left"


def test_point_and_sun_follow_the_cosine_law(spheres: StillLife) -> None:
    x, y, z = (float(v) for v in spheres.foot)
    above = PointLight(name="a", position=(x, y, z + 2.0), intensity=(8.0, 8.0, 8.0))
    aside = PointLight(name="b", position=(x + 2.0, y, z + 2.0), intensity=(8.0, 8.0, 8.0))
    assert spheres.table_irradiance(above) == pytest.approx(2.0)
    assert spheres.table_irradiance(aside) == pytest.approx(1.0 / math.sqrt(2))
    sun = SunLight(name="s", direction=(0.0, math.sqrt(3), -1.0), irradiance=(4.0, 4.0, 4.0))
    assert spheres.table_irradiance(sun) == pytest.approx(2.0)


def test_area_lamp_against_closed_form(spheres: StillLife) -> None:
    # A Lambertian disk of radius r, parallel and centred at height h: E = pi L r² / (r² + h²).
    position = spheres.foot + np.array([0.0, 0.0, 0.8])
    pose = matrix4(look_at(position, spheres.foot, up=(1.0, 0.0, 0.0)))
    disk = AreaLight(name="d", shape="disk", width=0.6, height=0.6, world_from_light=pose, radiance=(5.0, 5.0, 5.0))
    expected = math.pi * 5.0 * 0.09 / (0.09 + 0.64)
    assert spheres.table_irradiance(disk) == pytest.approx(expected, rel=0.03)
    assert spheres.table_irradiance(scaled(disk, 3.0)) == pytest.approx(3 * spheres.table_irradiance(disk))


def test_conditions(lit: list[tuple[SceneSpec, LightRig]]) -> None:
    for i, (_, rig) in enumerate(lit):
        conditions = sample_conditions(np.random.default_rng(i), rig)
        assert len(conditions) == 12
        assert len({c.name for c in conditions}) == 12
        assert len({c.model_copy(update={"name": "x"}).canonical_json() for c in conditions}) == 12
        everything = conditions[0]
        assert everything.name == "all"
        assert everything.gains == dict.fromkeys(rig.names, (1.0, 1.0, 1.0))
        assert everything.exposure_ev == 0.0
        for name in rig.names:
            alone = next(c for c in conditions if c.name == f"{name}_only")
            assert set(alone.gains) == {name}
        for condition in conditions:
            assert set(condition.gains) <= set(rig.names)
            assert abs(condition.exposure_ev) <= EXPOSURE
            assert LightingCondition.from_json(condition.canonical_json()) == condition


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
