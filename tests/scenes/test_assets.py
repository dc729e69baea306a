import base64
import csv
import hashlib
import io
import multiprocessing
import shutil
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import trimesh
from PIL import Image

from multilight.scenes.assets import fetch
from multilight.scenes.assets.cache import tell_thrown_away
from multilight.scenes.assets.check import check_assets
from multilight.scenes.assets.environments import (
    BPY_MAPS,
    PMNDRS_MAPS,
    decode_pmndrs,
    read_environment,
    without_negatives,
)
from multilight.scenes.assets.fetch import SOURCES, fetch_pack
from multilight.scenes.assets.formats.cleaning import RawPart, clean_mesh
from multilight.scenes.assets.formats.mtl import MtlEntry, material_of
from multilight.scenes.assets.library import AssetError, AssetLibrary
from multilight.scenes.assets.packs import sweethome3d
from multilight.scenes.assets.packs.surfaces import TABLE as TEXTURE_TABLE
from multilight.scenes.assets.packs.sweethome3d import SweetHome3dPack
from multilight.scenes.spec import Material

CUP = "sweethome3d/cup-flowers"


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> AssetLibrary:
    return AssetLibrary(tmp_path_factory.mktemp("cache"), packs=("builtin",))


def png(size: int = 4, *, mode: str = "RGB") -> bytes:
    buffer = io.BytesIO()
    Image.new(mode, (size, size), (200, 100, 50, 128)[: len(mode)]).save(buffer, "PNG")
    return buffer.getvalue()


def size_of(path: Path) -> tuple[int, int]:
    with Image.open(path) as image:
        return image.size


def box_obj(x: float, y: float, z: float, *, material: str = "glaze") -> str:
    """A Y-up box with quads and texture coordinates; its +Z side points to the viewer."""
    corners = [(i * x, j * y, k * z) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    quads = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    lines = ["mtllib cup.mtl", *(f"v {a} {b} {c}" for a, b, c in corners)]
    lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1", f"usemtl {material}"]
    lines += ["f " + " ".join(f"{v}/{i + 1}" for i, v in enumerate(quad)) for quad in quads]
    return "\n".join(lines) + "\n"


def make_furniture(cache: Path, *, files: dict[str, bytes], **properties: str) -> AssetLibrary:
    """Install a pack of one model, `Scopia#cup`, made of the given files."""
    folder = cache / "packs" / "sweethome3d"
    folder.mkdir(parents=True, exist_ok=True)
    entry = {
        "id": "Scopia#cup",
        "name": "Cup",
        "model": "/m/cup.obj",
        "width": "12",
        "depth": "8",
        "height": "6",
        "creator": "S. Copia",
    }
    table = "".join(f"{key}#1={value}\n" for key, value in (entry | properties).items())
    with zipfile.ZipFile(folder / "Scopia.sh3f", "w") as archive:
        archive.writestr("PluginFurnitureCatalog.properties", table)
        for name, data in files.items():
            archive.writestr(name, data)
    (folder / "pack.json").write_text('{"folder": "."}')
    sweethome3d._properties.cache_clear()
    return AssetLibrary(cache, packs=("sweethome3d",))


MTL = b"newmtl glaze\nKd 0.5 0.5 0.5\nNs 10\nd 1\nmap_Kd art/Skin.PNG\n"


def test_listing_is_sorted_and_quick(library: AssetLibrary) -> None:
    library.list("object")
    again = AssetLibrary(library.cache, packs=("builtin",))
    start = time.perf_counter()
    objects = again.list("object")
    assert time.perf_counter() - start < 0.5
    assert [info.id for info in objects] == sorted(info.id for info in objects)
    assert len(objects) > 70
    assert len(again.list("table")) > 12
    assert len(again.list("texture")) > 20
    assert {info.category for info in again.list("environment")} == {"indoor", "outdoor", "studio", "night", "sky"}
    assert any(info.emissive_part for info in objects)


def test_sizes_are_those_of_the_meshes(library: AssetLibrary) -> None:
    for info in library.list("table"):
        low, high = library.mesh(info.id).bounds()
        assert info.size is not None
        assert np.allclose(high - low, info.size, atol=1e-4), info.id


def test_converted_meshes_are_read_back_the_same(library: AssetLibrary) -> None:
    first = library.mesh("builtin/mug-02")
    assert library.mesh("builtin/mug-02") is first
    assert _hash_of(library.cache, "builtin/mug-02") == first.sha256()
    assert list((library.cache / "meshes" / "builtin").glob("*.npz"))


def test_a_damaged_converted_mesh_is_made_again(library: AssetLibrary, capsys: pytest.CaptureFixture[str]) -> None:
    before = set((library.cache / "meshes").rglob("*.npz"))
    wanted = library.mesh("builtin/die-01").sha256()
    (path,) = set((library.cache / "meshes").rglob("*.npz")) - before
    path.write_bytes(path.read_bytes()[:100])
    assert _hash_of(library.cache, "builtin/die-01") == wanted
    tell_thrown_away()
    assert str(path) in capsys.readouterr().err


def _hash_of(cache: Path, asset: str) -> str:
    return AssetLibrary(cache, packs=("builtin",)).mesh(asset).sha256()


def test_several_processes_share_a_cache(tmp_path: Path) -> None:
    with multiprocessing.get_context("spawn").Pool(4) as pool:
        hashes = pool.starmap(_hash_of, [(tmp_path, "builtin/vase-01")] * 8)
    assert len(set(hashes)) == 1
    assert not list(tmp_path.rglob("*.tmp*"))
    assert len(list(tmp_path.rglob("*.npz"))) == 1


def test_textures_are_made_once_with_their_normal_maps(library: AssetLibrary) -> None:
    info = library.info("builtin/metal-brushed")
    path = library.texture_path(info.id)
    seen = path.stat().st_mtime_ns
    assert size_of(path) == (1024, 1024)
    assert info.normal_map is not None
    assert library.texture_path(info.normal_map).is_file()
    assert library.texture_path(info.id).stat().st_mtime_ns == seen
    assert library.list("texture")[0].size is not None


@pytest.mark.parametrize(
    ("asset", "words"),
    [
        ("builtin/no-such", "assets list"),
        ("sweethome3d/cup-flowers", "assets fetch sweethome3d"),
        ("builtin/wood-oak", "not a model"),
    ],
)
def test_unknown_assets_name_the_remedy(library: AssetLibrary, asset: str, words: str) -> None:
    with pytest.raises(AssetError, match=words):
        library.mesh(asset)


def test_unknown_pack_and_texture(tmp_path: Path, library: AssetLibrary) -> None:
    with pytest.raises(AssetError, match="no pack 'nothing'"):
        AssetLibrary(tmp_path, packs=("nothing",))
    with pytest.raises(AssetError, match="assets fetch hdri-pmndrs"):
        AssetLibrary(tmp_path, packs=("hdri-pmndrs",))
    with pytest.raises(AssetError, match="no texture"):
        library.texture_path("builtin/wood-unknown")


def test_unwritable_cache_is_named(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(AssetError, match="MULTILIGHT_CACHE"):
        AssetLibrary(blocked, packs=("builtin",)).list("object")


def test_bpy_maps_are_found_without_importing_bpy(library: AssetLibrary) -> None:
    infos = [info for info in library.list("environment") if info.category != "sky"]
    assert len(infos) == len(BPY_MAPS)
    image = read_environment(library.environment_path(infos[0].id))
    assert image.shape == (512, 1024, 3)
    assert image.min() >= 0
    assert image.max() > 100


def test_same_place_in_two_packs_shares_its_name() -> None:
    assert BPY_MAPS["sunrise"].place == PMNDRS_MAPS["sunrise"].place
    assert BPY_MAPS["studio"].place == PMNDRS_MAPS["studio"].place
    assert len({m.place for m in (BPY_MAPS | PMNDRS_MAPS).values()}) >= len(PMNDRS_MAPS)


def test_negative_pixels_take_the_median_of_their_neighbours() -> None:
    image = np.ones((8, 16, 3), np.float32)
    image[3, 0] = (-5, 2, 2)
    image[0, 5] = 900
    clean = without_negatives(image)
    assert np.allclose(clean[3, 0], 1)
    assert clean[0, 5, 0] == 900
    assert np.array_equal(without_negatives(clean), clean)


def test_furniture_is_scaled_turned_and_stood_up(tmp_path: Path) -> None:
    files = {"m/cup.obj": box_obj(3, 1, 2).encode(), "m/cup.mtl": MTL, "m/art/skin.png": png()}
    library = make_furniture(tmp_path, files=files)
    info = library.info(CUP)
    assert (info.size, info.category, info.licence, info.creator) == (
        (0.12, 0.08, 0.06),
        "cup",
        "CC-BY-3.0",
        "S. Copia",
    )
    mesh = library.mesh(CUP)
    assert np.allclose(mesh.bounds(), [[-0.06, -0.04, 0], [0.06, 0.04, 0.06]], atol=1e-6)
    (part,) = mesh.parts
    solid = trimesh.Trimesh(part.vertices.round(6), part.faces, process=True)
    assert solid.is_watertight
    assert solid.volume == pytest.approx(0.12 * 0.08 * 0.06, rel=1e-4)
    assert part.material.base_color_texture is not None
    picture = library.texture_path(part.material.base_color_texture.image)
    assert size_of(picture) == (4, 4)
    assert check_assets(library) == []


def test_model_rotation_comes_before_the_size(tmp_path: Path) -> None:
    files = {"m/cup.obj": box_obj(3, 1, 2).encode(), "m/cup.mtl": MTL, "m/art/skin.png": png()}
    plain = make_furniture(tmp_path / "a", files=files).mesh(CUP)
    turned = make_furniture(tmp_path / "b", files=files, modelRotation="0 0 1 0 1 0 -1 0 0").mesh(CUP)
    assert np.allclose(plain.bounds(), turned.bounds(), atol=1e-6)
    assert plain.sha256() != turned.sha256()


def test_missing_texture_and_broken_model_are_named(tmp_path: Path) -> None:
    files = {"m/cup.obj": box_obj(1, 1, 1).encode(), "m/cup.mtl": MTL}
    with pytest.raises(AssetError, match=r"Skin\.PNG"):
        make_furniture(tmp_path / "a", files=files).mesh(CUP)
    with pytest.raises(AssetError, match=r"Scopia\.sh3f:/m/cup\.obj"):
        make_furniture(tmp_path / "b", files={"m/cup.obj": b"nothing here"}).mesh(CUP)
    with pytest.raises(AssetError, match=r"Scopia\.sh3f:/m/cup\.obj"):
        make_furniture(tmp_path / "c", files={}).mesh(CUP)


def test_curated_tables_are_consistent() -> None:
    with sweethome3d.TABLE.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len({row["id"] for row in rows}) == len({row["model"] for row in rows}) == len(rows)
    assert {row["role"] for row in rows} == {"object", "table"}
    with TEXTURE_TABLE.open(encoding="utf-8", newline="") as file:
        packs = {row["pack"] for row in csv.DictReader(file)}
    assert packs == {name for name, source in SOURCES.items() if source.manager == "pip"}


def entry(name: str, *, opacity: float = 1.0, diffuse: tuple[float, float, float] = (0.6, 0.6, 0.6)) -> MtlEntry:
    return MtlEntry(name, diffuse, None, opacity, None, False)


def test_materials_follow_names_and_opacity() -> None:
    assert material_of(entry("Chrome_01"), category="pan", closed=True).metallic == 1
    assert material_of(entry("Chrome", diffuse=(0.1, 0.1, 0.1)), category="pan", closed=True).metallic == 0
    assert material_of(entry("porcelain"), category="cup", closed=True).coat > 0
    assert material_of(entry("oak"), category="table", closed=True).metallic == 0
    assert material_of(entry("x", opacity=0.2), category="glass", closed=True).transmission == 1
    assert material_of(entry("black_rough", opacity=0.85), category="electronics", closed=True).opacity == 1
    thin = material_of(entry("x", opacity=0.2), category="glass", closed=False)
    assert (thin.transmission, thin.opacity) == (0, 0.2)
    assert material_of(entry("k", diffuse=(0, 0, 0)), category="x", closed=True).base_color == (0.02, 0.02, 0.02)


def raw(vertices: np.ndarray, faces: np.ndarray) -> RawPart:
    return RawPart(Material(), np.asarray(vertices, float), np.asarray(faces, np.int64), None, None)


def test_cleaning_turns_inside_out_pieces_and_drops_bad_faces() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.1)
    faces = np.concatenate([ball.faces[:, ::-1], ball.faces[:5], [[0, 0, 1]]])
    (part,) = clean_mesh([raw(ball.vertices, faces)]).parts
    assert len(part.faces) == len(ball.faces)
    outward = np.einsum("vi,vi->v", part.normals, part.vertices - [0, 0, 0.1])
    assert outward.min() > 0.09


def test_cleaning_keeps_creases_and_smooths_curves() -> None:
    (cube,) = clean_mesh([raw(*_box())]).parts
    assert len(cube.vertices) == 24
    assert np.allclose(np.abs(cube.normals).max(axis=1), 1)
    ball = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    (smooth,) = clean_mesh([raw(ball.vertices, ball.faces)]).parts
    assert len(smooth.vertices) == len(ball.vertices)


def _box() -> tuple[np.ndarray, np.ndarray]:
    box = trimesh.creation.box((1, 1, 1))
    return np.asarray(box.vertices), np.asarray(box.faces)


def test_cleaning_refuses_what_cannot_be_saved() -> None:
    vertices, faces = _box()
    with pytest.raises(ValueError, match="not finite"):
        clean_mesh([raw(np.where(vertices > 0, np.nan, vertices), faces)])
    with pytest.raises(ValueError, match="degenerate"):
        clean_mesh([raw(vertices * 0, faces)])
    with pytest.raises(ValueError, match="no faces"):
        clean_mesh([raw(vertices, faces[:0])])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a textured GLB (Y-up, centimetres) and a broken one."""
    folder = tmp_path / "My Things"
    folder.mkdir()
    box = trimesh.creation.box((10, 30, 20))
    image = Image.new("RGB", (4, 4), (10, 200, 30))
    material = trimesh.visual.material.PBRMaterial(
        name="skin", baseColorTexture=image, roughnessFactor=0.3, metallicFactor=0.0, baseColorFactor=(255, 128, 0, 255)
    )
    box.visual = trimesh.visual.TextureVisuals(uv=box.vertices[:, :2] / 30, material=material)
    box.export(folder / "box.glb")
    (folder / "broken.glb").write_bytes(b"glTF but not really")
    (folder / "assets.csv").write_text(
        "file,id,category,licence,metres_per_unit,up_axis\nbox.glb,tall box,box,MIT,0.01,Y\nbroken.glb,,,,,\n"
    )
    return folder


def test_folder_of_models(folder: Path, tmp_path: Path) -> None:
    library = AssetLibrary(tmp_path / "cache", packs=("builtin",), folders=(folder,))
    info = library.info("My Things/tall-box")
    assert (info.category, info.licence) == ("box", "MIT")
    assert np.allclose(info.size or 0, (0.1, 0.2, 0.3))
    (part,) = library.mesh(info.id).parts
    assert part.material.roughness == pytest.approx(0.3)
    assert part.material.base_color[1] == pytest.approx(128 / 255, abs=0.01)
    assert part.material.base_color_texture is not None
    with Image.open(library.texture_path(part.material.base_color_texture.image)) as image:
        assert image.getpixel((0, 0)) == (10, 200, 30)
    problems = check_assets(library, "My Things")
    assert [asset for asset, _ in problems] == ["My Things/broken"]
    assert "broken.glb" in problems[0][1]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("file,colour\nbox.glb,red\n", "line 2: has unknown columns"),
        ("file,metres_per_unit\nbox.glb,-1\n", "line 2: metres_per_unit '-1'"),
        ("file,up_axis\nbox.glb,W\n", "up_axis 'W' must be Y or Z"),
        ("file\n../box.glb\n", "must lie inside the folder"),
        ("id\nbox\n", "line 2: has unknown|line 2: names no file"),
    ],
)
def test_bad_tables_are_refused(folder: Path, tmp_path: Path, text: str, words: str) -> None:
    (folder / "assets.csv").write_text(text)
    with pytest.raises(AssetError, match=words):
        AssetLibrary(tmp_path / "cache", packs=("builtin",), folders=(folder,)).list("object")


def test_folder_without_a_table_and_wrong_units(folder: Path, tmp_path: Path) -> None:
    (folder / "assets.csv").unlink()
    trimesh.creation.box((900, 900, 900)).export(folder / "huge.obj")
    library = AssetLibrary(tmp_path / "cache", packs=("builtin",), folders=(folder,))
    assert {i.id for r in ("object", "surrounding") for i in library.list(r) if i.pack == "My Things"} == {
        "My Things/box",
        "My Things/broken",
        "My Things/huge",
    }
    with pytest.raises(AssetError, match="metres_per_unit"):
        library.mesh("My Things/huge")


def exr_bytes(tmp_path: Path) -> bytes:
    image = np.full((8, 16, 3), 2.0, np.float16)
    image[2, 3] = -1
    path = tmp_path / "map.exr"
    with OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, {"RGB": image}) as file:
        file.write(str(path))
    return path.read_bytes()


def test_maps_come_out_of_the_script_without_running_it(tmp_path: Path) -> None:
    data = exr_bytes(tmp_path)
    script = f"throw 1; export default 'data:application/exr;base64,{base64.b64encode(data).decode()}'"
    assert decode_pmndrs(script) == data
    with pytest.raises(AssetError, match="no base64"):
        decode_pmndrs("export default 1")


def fake_wheel(path: Path, *, skip: int = 0) -> None:
    with TEXTURE_TABLE.open(encoding="utf-8", newline="") as file:
        members = [row["member"] for row in csv.DictReader(file) if row["pack"] == "textures-miniworld"]
    with zipfile.ZipFile(path, "w") as wheel:
        for member in members[skip:]:
            wheel.writestr(member, png(16))


def use_wheel(monkeypatch: pytest.MonkeyPatch, wheel: Path, *, sha256: str | None = None) -> None:
    digest = sha256 or hashlib.sha256(wheel.read_bytes()).hexdigest()
    source = fetch.Source("textures", "pip", "miniworld", "2.1.0", digest, "Apache-2.0")
    monkeypatch.setitem(fetch.SOURCES, "textures-miniworld", source)
    monkeypatch.setattr(fetch, "_pip", lambda source, scratch: shutil.copy(wheel, scratch / wheel.name))


def test_fetching_textures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wheel = tmp_path / "miniworld-2.1.0-py3-none-any.whl"
    fake_wheel(wheel)
    use_wheel(monkeypatch, wheel)
    cache = tmp_path / "cache"
    assert fetch_pack("textures-miniworld", cache) == cache / "packs" / "textures-miniworld"
    record = fetch.pack_record("textures-miniworld", cache)
    assert record["version"] == "2.1.0"
    assert record["sha256"] == hashlib.sha256(wheel.read_bytes()).hexdigest()
    library = AssetLibrary(cache)
    assert any(info.pack == "textures-miniworld" for info in library.list("texture"))
    assert check_assets(library, "textures-miniworld") == []
    wheel.unlink()
    fetch_pack("textures-miniworld", cache)  # nothing left to do


def test_a_changed_or_incomplete_archive_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wheel = tmp_path / "miniworld-2.1.0-py3-none-any.whl"
    fake_wheel(wheel, skip=1)
    use_wheel(monkeypatch, wheel, sha256="0" * 64)
    with pytest.raises(AssetError, match="expected 0000"):
        fetch_pack("textures-miniworld", tmp_path / "cache")
    use_wheel(monkeypatch, wheel)
    with pytest.raises(AssetError, match="cannot be unpacked"):
        fetch_pack("textures-miniworld", tmp_path / "cache")
    assert list((tmp_path / "cache" / "packs").iterdir()) == []


def test_failing_clients_are_reported(tmp_path: Path) -> None:
    with pytest.raises(AssetError, match="no pack 'nothing'"):
        fetch_pack("nothing", tmp_path)
    with pytest.raises(AssetError, match="needs the program 'no-such-client'"):
        fetch.run_client(["no-such-client"], tmp_path, what="downloading")
    with pytest.raises(AssetError, match="downloading failed: ERROR: offline"):
        fetch.run_client(
            [sys.executable, "-c", "import sys; sys.exit('ERROR: offline\\nbye')"], tmp_path, what="downloading"
        )


def test_a_missing_package_manager_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(fetch, "_installed_furniture", lambda: None)
    for name, program in (("sweethome3d", "apt-get"), ("hdri-pmndrs", "npm")):
        with pytest.raises(AssetError, match=f"needs the program '{program}'"):
            fetch_pack(name, tmp_path / "cache")


def test_installed_furniture_is_used_in_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = make_furniture(tmp_path / "system", files={"m/cup.obj": box_obj(1, 1, 1).encode(), "m/cup.mtl": b""})
    assert source.info(CUP)
    monkeypatch.setattr(fetch, "_installed_furniture", lambda: tmp_path / "system" / "packs" / "sweethome3d")
    fetch_pack("sweethome3d", tmp_path / "cache")
    assert AssetLibrary(tmp_path / "cache").info(CUP).name == "Cup"


def test_texture_ids_cannot_leave_the_pack(tmp_path: Path) -> None:
    pack = SweetHome3dPack(tmp_path, tmp_path)
    for name in ("texture/Scopia/../../secret", "texture/Other/a.png", "x.png"):
        with pytest.raises(AssetError, match="no texture"):
            pack.texture(name)


@pytest.mark.slow
def test_every_builtin_asset_passes_the_check() -> None:
    assert check_assets(AssetLibrary(packs=("builtin",)), "builtin") == []


def test_rubbish_texture_coordinates_are_dropped(tmp_path: Path) -> None:
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 3.4e9 0.5\nvt 0.25 0.5\nvt nan 0\n"
    text += "f 1/1 3/2 2/2\nf 1/2 2/2 4/3\nf 1/2 4/2 3/2\nf 2/2 3/2 4/2\n"
    (tmp_path / "shape.obj").write_text(text)
    library = AssetLibrary(tmp_path / "cache", packs=("builtin",), folders=(tmp_path,))
    uv = np.concatenate([part.uv for part in library.mesh(f"{tmp_path.name}/shape").parts])
    assert np.isfinite(uv).all()
    assert np.abs(uv).max() <= 1000
