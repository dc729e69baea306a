"""Folders as sets are published, and what is told of them: roles, places, licences, sizes, accounts."""

import shutil
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import trimesh
from PIL import Image

from multilight.datagen.cli import main
from multilight.datagen.config.dataset import DatasetConfig
from multilight.datagen.production.library import check_library, located, same_background
from multilight.datagen.storage.records import DatasetRecord
from multilight.lights.rigs.sample import with_own_glow
from multilight.lights.spec import EmissiveLight, EnvironmentLight, LightRig
from multilight.scenes.assets.cache import file_digest
from multilight.scenes.assets.environments import read_hdr
from multilight.scenes.assets.info import AssetError
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.assets.packs import guesses
from multilight.scenes.materials.bodies import body_materials
from multilight.scenes.spec import Body, Camera, Material, SceneSpec, Sphere

CASES = Path(__file__).with_name("cases")
CUP = CASES / "more" / "e13_black_plastic.glb"


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> tuple[AssetLibrary, Path]:
    """A folder with a bit of every kind of set, and a cache."""
    base = tmp_path_factory.mktemp("published")
    folder = base / "sets"
    shutil.copytree(CASES / "folders" / "gso" / "mug", folder / "gso" / "Room_Essentials_Mug")
    (folder / "gso" / "Room_Essentials_Mug" / "metadata.pbtxt").write_text(
        'license: "Creative Commons Attribution 4.0"'
    )
    for place in ("dtc/Teapot_B0/3d-asset", "objaverse/glbs/000-001/0a1b2c", "chairs/chair"):
        (folder / place).parent.mkdir(parents=True)
        shutil.copy(CUP, folder / f"{place}.glb")
    shutil.copy(CASES / "objs" / "b14_vertex_colours.obj", folder / "chairs" / "chair.obj")
    (folder / "dtc" / "LICENSE.txt").write_text("Released under CC0")
    trimesh.creation.box((4, 2.5, 3)).export(folder / "frl_apartment.glb")
    trimesh.creation.box((0.9, 0.45, 0.5)).export(folder / "Coffee Table 01.glb")
    (base / "elsewhere").mkdir()
    shutil.copy(CUP, base / "elsewhere" / "vase.glb")
    (folder / "linked").symlink_to(base / "elsewhere")
    (base / "elsewhere" / "back").symlink_to(folder)
    for kind in formats():
        shutil.copy(CASES / "formats" / kind, folder)
    (folder / "WoodFloor041_1K").mkdir()
    shades = {"Color": (150, 100, 60), "NormalDX": (128, 100, 255), "Roughness": (90,) * 3, "Metalness": (0,) * 3}
    for kind, shade in shades.items():
        Image.new("RGB", (16, 16), shade).save(folder / "WoodFloor041_1K" / f"WoodFloor041_1K-JPG_{kind}.png")
    sky = np.ones((8, 16, 3), np.float32)
    for name in ("kloofendal_48d_partly_cloudy_2k", "old_hall_4k"):
        OpenEXR.File({}, {"RGB": sky}).write(str(folder / f"{name}.exr"))
    return AssetLibrary(base / "cache", packs=(), folders=(folder,)), folder


def formats() -> list[str]:
    return sorted(path.name for path in (CASES / "formats").iterdir())


def test_every_set_is_recognised(published: tuple[AssetLibrary, Path]) -> None:
    library, _ = published
    found = {
        info.id.partition("/")[2]: info for role in ("object", "table", "surrounding") for info in library.list(role)
    }
    assert {
        "gso-room-essentials-mug", "dtc-teapot-b0", "objaverse-glbs-000-001-0a1b2c", "chairs-chair",
        "chairs-chair-obj", "frl-apartment", "coffee-table-01", "linked-vase", "cube", "cube-ply", "cube-stl",
        "cube-usdz",
    } == set(found)  # fmt: skip
    told = {name: (info.role, info.category) for name, info in found.items()}
    assert told["gso-room-essentials-mug"] == ("object", "mug")
    assert told["coffee-table-01"] == ("table", "coffee_table")
    assert told["frl-apartment"] == ("surrounding", "room")
    assert found["gso-room-essentials-mug"].licence == "CC-BY-4.0"
    assert found["dtc-teapot-b0"].licence == "CC0-1.0"
    assert all(info.size is not None for info in found.values()), library.broken
    for name in ("cube", "cube-ply", "cube-stl", "cube-usdz"):
        assert found[name].size == pytest.approx((0.1, 0.1, 0.1), abs=1e-4)
    assert library.mesh("sets/cube").parts[0].material.base_color == pytest.approx((0.1, 0.5, 0.2))
    assert library.mesh("sets/cube-ply").parts[0].colors is not None


def test_skies_and_surfaces_are_assets(published: tuple[AssetLibrary, Path]) -> None:
    library, _ = published
    skies = {info.place: info.category for info in library.list("environment")}
    assert skies == {"kloofendal_48d_partly_cloudy": "outdoor", "old_hall": "indoor"}
    (surface,) = library.list("texture")
    assert (surface.category, surface.as_made) == ("wood", True)
    assert surface.normal_map is not None
    with Image.open(library.texture_path(surface.normal_map)) as normal:
        assert normal.getpixel((0, 0)) == (128, 155, 255), "+Y up"
    assert surface.roughness_map is not None
    with Image.open(library.texture_path(surface.roughness_map)) as rough:
        assert rough.getpixel((0, 0)) == 90


def test_scenes_leave_a_users_materials_alone(published: tuple[AssetLibrary, Path]) -> None:
    library, _ = published
    info, mesh = library.info("sets/cube"), library.mesh("sets/cube")
    assert body_materials(np.random.default_rng(0), library, info, mesh) == tuple(p.material for p in mesh.parts)


def test_an_account_is_printed(published: tuple[AssetLibrary, Path], capsys: pytest.CaptureFixture[str],
                               monkeypatch: pytest.MonkeyPatch) -> None:  # fmt: skip
    library, folder = published
    monkeypatch.setenv("MULTILIGHT_CACHE", str(library.cache))
    assert main(["assets", "check", str(folder / "chairs")]) == 0
    said = capsys.readouterr().out
    assert "chairs/chair: object, chair: 0.1 x 0.1 x 0.1 m, 12 faces, 1 materials, 0 textures" in said
    assert "odd: it is 0.1 m large, a chair is usually 0.4 to 1.6; set metres_per_unit" in said
    assert main(["assets", "check", str(CASES / "models" / "a36_missing_image.gltf")]) == 1
    assert "'not_there.png' is missing" in capsys.readouterr().out


def test_of_ones_own_alone_too_little_is_said_at_once(published: tuple[AssetLibrary, Path],
                                                      monkeypatch: pytest.MonkeyPatch) -> None:  # fmt: skip
    library, folder = published
    monkeypatch.setenv("MULTILIGHT_CACHE", str(library.cache))
    config = DatasetConfig(only_assets=True, splits={"train": 1.0, "val": 0.0, "test": 0.0})
    with pytest.raises(AssetError, match=r"split 'train' need \d (object|table)\(s\) or more, and .*sets has \d"):
        check_library(config, (folder,))
    only = AssetLibrary(library.cache, folders=(folder,), only_own=True)
    assert {info.pack for role in ("object", "table", "texture") for info in only.list(role)} <= {"sets", "builtin"}
    assert {info.pack for info in only.list("object")} == {"sets"}


def test_a_background_is_known_wherever_it_lies(tmp_path: Path) -> None:
    (tmp_path / "first").mkdir()
    file = shutil.copy(CASES / "bg" / "c01_texture_transform12.glb", tmp_path / "first" / "room.glb")
    config = DatasetConfig(kind="custom", background=Path(file))
    record = DatasetRecord(
        config=config, renderer="mitsuba", versions={}, background_sha256=file_digest(Path(file)) or ""
    )
    moved = Path(shutil.move(file, tmp_path / "room.glb"))
    assert same_background(record, moved)
    assert not same_background(record, CASES / "bg" / "c05_png16.glb")
    assert located(config, tmp_path / "dataset").background == moved


def test_what_glows_in_a_users_model_is_a_light() -> None:
    material = Material(emission=(179.0, 0.0, 0.0))
    eye = ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))
    body = Body(name="ball", role="object", category="ball", geometry=Sphere(radius=0.1), materials=(material,),
                world_from_body=eye)  # fmt: skip
    camera = Camera(width=16, height=16, fx=16, fy=16, cx=8, cy=8, c2w=eye)
    scene = SceneSpec(kind="spheres", index=0, bodies=(body,), cameras=(camera,))
    rig = with_own_glow(LightRig(lights=(EnvironmentLight(name="sky"),)), scene)
    glow = rig.lights[1]
    assert isinstance(glow, EmissiveLight)
    assert (glow.body, glow.part, glow.radiance) == ("ball", 0, (1.0, 0.0, 0.0))
    assert with_own_glow(rig, scene) == rig


def test_radiance_pictures_are_decoded() -> None:
    runs = b"".join(bytes([128 + 8, value]) for value in (128, 64, 0, 129))
    flat = bytes([128, 64, 0, 129]) * 8
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 8\n"
    image = read_hdr(head + b"\x02\x02\x00\x08" + runs + flat, "sky.hdr")
    assert image.shape == (2, 8, 3)
    assert np.allclose(image, [128.5 / 128, 64.5 / 128, 0.5 / 128])
    with pytest.raises(AssetError, match=r"sky\.hdr is not a readable HDR picture"):
        read_hdr(head + b"\x02\x02\x00\x08" + runs[:3], "sky.hdr")


HOSTILE = """
import os, socket, sys
from pathlib import Path
from multilight.datagen.backends.blender.convert import confine
confine(Path(sys.argv[1]))
Path(sys.argv[1], "own").write_text("x")
tried = {
    "write": lambda: Path(sys.argv[2], "secret").write_text("x"),
    "remove": lambda: os.remove(Path(sys.argv[2], "precious")),
    "program": lambda: 1 / (os.system(f"echo x > {sys.argv[2]}/secret 2>/dev/null") == 0),
    "network": lambda: socket.create_connection(("127.0.0.1", int(sys.argv[3])), 2),
    "memory": lambda: bytearray(1 << 36),
}
for name, attempt in tried.items():
    try:
        attempt()
        print(name, "was let through")
    except (OSError, MemoryError, ZeroDivisionError):
        pass
"""


def test_the_converter_reaches_nothing_but_its_own_folder(tmp_path: Path) -> None:
    for name in ("own", "other"):
        (tmp_path / name).mkdir()
    (tmp_path / "other" / "precious").write_text("x")
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = str(server.getsockname()[1])
        command = [sys.executable, "-c", HOSTILE, str(tmp_path / "own"), str(tmp_path / "other"), port]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == ""
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["other", "own", "own", "precious"]


def test_names_tell_what_pictures_hold() -> None:
    assert guesses.kind_of("rusty_metal_nor_gl_4k") == ("rusty_metal", "normal")
    assert guesses.kind_of("Bricks075A_2K-PNG_NormalDX") == ("Bricks075A", "normal-dx")
    assert guesses.kind_of("oak_diff_1k") == ("oak", "base")
    assert guesses.kind_of("holiday") is None
    assert guesses.category_of("old wooden_Chair_03") == "chair"
    assert guesses.place_of("moonless_golf_2k")[1] == "moonless_golf"
