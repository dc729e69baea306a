"""Materials: classes keep to their ranges, maps are derived for assets that have only colour, glows are physical."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from multilight.scenes.assets.builtin.textures.screens import SCREENS, make_screen
from multilight.scenes.assets.derived_maps import MEAN_ROUGHNESS, band, derived_map, roughness_map, slopes_to_normals
from multilight.scenes.assets.formats.mtl import BY_CATEGORY, class_of
from multilight.scenes.assets.formats.mtl import FINISHES as WORDS
from multilight.scenes.assets.info import AssetError
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.materials import (
    FINISHES,
    GLOW,
    METALS,
    body_materials,
    sample_material,
    textured,
    with_derived_maps,
)
from multilight.scenes.materials.emission import EMISSIONS, emission_of, part_area, sample_glow
from multilight.scenes.spec import Material, MeshAsset, Texture
from multilight.scenes.still_life.placement import PlacementError
from multilight.scenes.still_life.receivers import (
    LOOSE,
    PROBABILITIES,
    ReceiverKind,
    choose_receiver,
    receiver_material,
    with_receiver,
)
from multilight.scenes.still_life.setting import Setting, flat_surface

MIRRORS: tuple[ReceiverKind, ...] = ("mirror top", "mirror plate", "chrome tray", "standing mirror")


@pytest.fixture(scope="module")
def library() -> AssetLibrary:
    return AssetLibrary(packs=("builtin",))


@pytest.mark.parametrize("finish", FINISHES)
def test_draws_keep_to_the_ranges_of_their_class(finish: str) -> None:
    ranges, rng = FINISHES[finish], np.random.default_rng(1)
    drawn = [sample_material(rng, finish) for _ in range(40)]
    for material in drawn:
        assert ranges.roughness[0] <= material.roughness <= ranges.roughness[1]
        assert ranges.ior[0] <= material.ior <= ranges.ior[1]
        assert (material.metallic, material.transmission) == (ranges.metallic, ranges.transmission)
        if ranges.metallic:
            assert material.base_color in METALS.values()
        elif not ranges.transmission:
            # Lagarde and de Rousiers 2014: the albedo of non-metals, with room for one channel of a pure hue.
            assert min(material.base_color) >= 0.005
            assert max(material.base_color) <= 0.95
    assert len({material.roughness for material in drawn}) > 30


def test_asked_classes_are_there_and_an_unknown_one_is_refused() -> None:
    asked = {
        "wood",
        "ceramic",
        "plastic",
        "polished",
        "brushed",
        "glass",
        "fabric",
        "leather",
        "paper",
        "skin",
        "stone",
    }
    assert asked | {"rubber", "paint", "mirror", "tinted glass"} <= set(FINISHES)
    with pytest.raises(ValueError, match="no class of surface 'velcro'; there are ceramic"):
        sample_material(np.random.default_rng(0), "velcro")


def test_words_name_classes() -> None:
    assert {finish.kind for finish in (*WORDS, *BY_CATEGORY.values())} <= set(FINISHES)
    assert class_of("handle oak", "mug") == "wood"
    assert class_of("body", "mug") == "ceramic"
    assert class_of("body", "thing") is None


def test_derived_maps_follow_fine_detail_only() -> None:
    v, u = np.mgrid[0:256, 0:256] / 256
    broad = 0.4 + 0.3 * np.sin(2 * np.pi * u)
    fine = 0.1 * np.sin(2 * np.pi * 24 * v)
    picture = np.repeat(np.round((broad + fine)[..., None] * 255), 3, axis=2).astype(np.uint8)
    detail = band(picture)
    assert np.corrcoef(detail.ravel(), fine.ravel())[0, 1] > 0.95
    assert abs(np.corrcoef(detail.ravel(), broad.ravel())[0, 1]) < 0.1
    rough = roughness_map(detail) / 255
    assert rough.mean() == pytest.approx(MEAN_ROUGHNESS, abs=0.01)
    assert rough.min() >= 0.49
    normals = slopes_to_normals(detail) / 255.0 * 2 - 1
    assert np.abs(normals[..., 0]).max() < 0.05, "nothing changes along a row but the broad shading"
    assert 0.05 < np.sqrt((normals[..., 1] ** 2).mean()) < 0.12
    plain = np.full((64, 64, 3), 128, np.uint8)
    assert np.ptp(roughness_map(band(plain))) == 0
    assert np.ptp(slopes_to_normals(band(plain))) <= 128


def test_derived_maps_are_files_and_a_broken_picture_is_named(tmp_path: Path) -> None:
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (32, 32, 3), np.uint8)).save(tmp_path / "skin.png")
    path = derived_map(tmp_path / "skin.png", "normal", tmp_path / "cache")
    with Image.open(path) as normals:
        assert normals.size == (32, 32)
    assert derived_map(tmp_path / "skin.png", "normal", tmp_path / "cache") == path
    (tmp_path / "broken.png").write_bytes(b"no picture")
    with pytest.raises(AssetError, match=r"broken\.png is not a readable picture"):
        derived_map(tmp_path / "broken.png", "roughness", tmp_path / "cache")


def test_library_hands_out_derived_maps(library: AssetLibrary) -> None:
    for image in ("builtin/wood-oak#roughness", "builtin/wood-oak-roughness"):
        with Image.open(library.texture_path(image)) as rough:
            assert (rough.mode, rough.size) == ("L", (1024, 1024))


def test_albedo_only_materials_get_maps() -> None:
    bare = Material(base_color_texture=Texture(image="pack/skin.png", repeat=(2.0, 2.0)), roughness=0.3)
    made = with_derived_maps(bare, relief=True)
    assert made.roughness_texture == Texture(image="pack/skin.png#roughness", repeat=(2.0, 2.0))
    assert made.normal_texture == Texture(image="pack/skin.png#normal", repeat=(2.0, 2.0))
    assert made.roughness * MEAN_ROUGHNESS == pytest.approx(0.3)
    assert with_derived_maps(bare, relief=False).normal_texture is None
    assert with_derived_maps(Material(), relief=True) == Material()


def test_library_textures_bring_all_maps(library: AssetLibrary) -> None:
    info = library.info("builtin/gravel-grey")
    made = textured(np.random.default_rng(0), info, "rough stone", metres_per_uv=2.0)
    assert made.roughness_texture is not None
    assert made.normal_texture is not None
    assert made.roughness_texture.repeat == (2.0 / 0.8, 2.0 / 0.8)


def test_only_what_shall_glow_is_marked(library: AssetLibrary) -> None:
    lamps = [info for info in library.list("object") if info.emissive_part is not None]
    assert {info.category for info in lamps} >= {"bulb", "candle", "neon", "phone", "tablet", "monitor", "sign", "lamp"}
    for info in lamps:
        mesh = library.mesh(info.id)
        off = body_materials(np.random.default_rng(0), library, info, mesh)
        on = body_materials(np.random.default_rng(0), library, info, mesh, glows=True)
        assert GLOW not in [material.name for material in off]
        assert [part.name for part, m in zip(mesh.parts, on, strict=True) if m.name == GLOW] == [info.emissive_part]


def test_glows_are_physical(library: AssetLibrary) -> None:
    rng = np.random.default_rng(0)
    for info in library.list("object"):
        if info.emissive_part is None:
            continue
        mesh, emission = library.mesh(info.id), emission_of(info)
        part = [p.name for p in mesh.parts].index(info.emissive_part)
        for _ in range(5):
            glow = sample_glow(rng, library, info, part)
            given = glow.nits if emission.quantity == "nits" else glow.nits * np.pi * part_area(mesh, part)
            assert emission.low * 0.999 <= given <= emission.high * 1.001
            assert (glow.texture is not None) == emission.display
            if glow.texture is not None:
                assert library.info(glow.texture.image).category == emission.shows
    assert EMISSIONS["phone"].low == 200
    assert EMISSIONS["candle"].high < 20


def test_displays_are_filled_upright_by_their_picture(library: AssetLibrary) -> None:
    for name in ("phone-01", "tablet-01", "monitor-01", "sign-01"):
        screen = library.mesh(f"builtin/{name}").parts[0]
        assert screen.name == "screen"
        assert np.array_equal(np.unique(screen.uv), [0.0, 1.0])
        top, bottom = (screen.vertices[screen.uv[:, 1] == v, 2].mean() for v in (1.0, 0.0))
        assert top >= bottom - 1e-6, name


@pytest.mark.parametrize("name", SCREENS)
def test_screens_are_pictures_and_repeatable(name: str) -> None:
    pixels = np.asarray(make_screen(name))
    assert pixels.shape == (SCREENS[name].size[1], SCREENS[name].size[0], 3)
    assert pixels.std() > 15
    assert np.array_equal(pixels, np.asarray(make_screen(name)))


def test_receivers_come_as_often_as_stated() -> None:
    assert sum(PROBABILITIES.values()) == pytest.approx(1.0)
    assert sum(PROBABILITIES[kind] for kind in MIRRORS) == pytest.approx(0.15)
    rng = np.random.default_rng(0)
    drawn = [choose_receiver(rng) for _ in range(2000)]
    assert np.mean([kind in MIRRORS for kind in drawn]) == pytest.approx(0.15, abs=0.03)
    assert {choose_receiver(rng, loose=True) for _ in range(500)} <= LOOSE | {"none"}
    for kind in MIRRORS:
        made = receiver_material(rng, kind)
        assert made.metallic == 1
        assert made.roughness <= 0.12
    assert receiver_material(rng, "glass plate").transmission == 1


def test_a_plate_is_one_that_fits(library: AssetLibrary) -> None:
    """There are slabs with sides of 0.54 to 0.69 m; a surface of 0.65 m has room for some."""
    small, drawn = Setting((), (), flat_surface(0.65, 0.65), np.eye(4), 0.0, 1.0), set()
    for seed in range(20):
        setting = with_receiver(np.random.default_rng(seed), library, small, "stone plate")
        geometry = setting.bodies[0].geometry
        assert isinstance(geometry, MeshAsset)
        drawn.add(geometry.asset)
    assert len(drawn) > 1
    with pytest.raises(PlacementError, match="does not fit the surface"):
        with_receiver(np.random.default_rng(0), library, replace(small, surface=flat_surface(0.4, 0.4)), "stone plate")
