"""Names from data that lead elsewhere: nothing outside of the folder is read or written, and one line says so."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from multilight.datagen.cli import main
from multilight.datagen.errors import StoreError, UserError
from multilight.datagen.storage.open_dataset import open_dataset
from multilight.scenes.assets.info import AssetError
from multilight.scenes.assets.packs.folder import FolderPack
from multilight.scenes.files.confined import OutsideError, held, inside, plain_name
from tests.datagen.chain import rewrite_json
from tests.datagen.servers import http_server, in_memory, s3_server

HOSTILE = {
    "absolute": "/etc/hostname",
    "parent": "../../victim",
    "parent inside": "views/../../../victim",
    "backslash": "..\\..\\victim",
    "drive": "C:/victim",
    "address": "http://elsewhere/victim",
    "chained": "views/00.exr::file:///etc/hostname",
    "encoded dots": "%2e%2e/%2e%2e/victim",
    "encoded slashes": "..%2f..%2fvictim",
    "encoded twice": "%252e%252e/victim",
    "encoded backslash": "..%5c..%5cvictim",
    "NUL": "views/00.exr\0",
    "encoded NUL": "views/00.exr%00",
    "newline": "views/00.exr\n",
    "empty": "",
    "empty part": "views//00.exr",
    "dot": "views/./00.exr",
    "long": "a" * 5000,
}


@pytest.mark.parametrize("name", HOSTILE.values(), ids=HOSTILE)
def test_hostile_names_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(OutsideError):
        plain_name(name)
    with pytest.raises(OutsideError):
        inside(tmp_path, name)


@pytest.mark.parametrize("name", ["views/00.exr", "a b/ü.png", "100%.png", "50%25.png", "..a/b..", "index.parquet"])
def test_plain_names_pass(tmp_path: Path, name: str) -> None:
    assert inside(tmp_path, name) == tmp_path / name


def test_links_count_as_what_they_lead_to(tmp_path: Path) -> None:
    root = tmp_path / "set"
    root.mkdir()
    (root / "out").symlink_to(tmp_path)
    (root / "loop").symlink_to(root / "loop")
    (root / "real").mkdir()
    (root / "in").symlink_to(root / "real")
    for name in ("out", "out/x", "out/set/../x"):
        with pytest.raises(OutsideError):
            inside(root, name)
    assert inside(root, "in/x") == root / "in" / "x"
    with pytest.raises(OutsideError):
        held(root, root / "loop" / "x")


def test_beside_a_file_parents_may_be_named_within_the_folder(tmp_path: Path) -> None:
    (tmp_path / "models").mkdir()
    found = inside(tmp_path, "../textures/./wood.png", beside=tmp_path / "models")
    assert found.resolve() == (tmp_path / "textures" / "wood.png").resolve()
    for name in ("../../x", "/x", "..", "%2e%2e/%2e%2e/x", ""):
        with pytest.raises(OutsideError):
            inside(tmp_path, name, beside=tmp_path / "models")


@pytest.fixture(params=["folder", "memory", "http", "s3"])
def hostile(request: pytest.FixtureRequest, spheres_copy: Path, hostile_name: str) -> Iterator[tuple[Path, str]]:
    """A dataset at an address of each kind, whose first record names the file in `hostile_name` as its first view."""
    path = spheres_copy / "scenes" / "000000" / "scene.json"
    rewrite_json(path, lambda record: record["views"][0].update(file=hostile_name))
    match request.param:
        case "folder":
            yield spheres_copy, str(spheres_copy)
        case "memory":
            with in_memory(spheres_copy, "hostile") as found:
                yield spheres_copy, found
        case "http":
            with http_server(spheres_copy) as (found, _):
                yield spheres_copy, found
        case _:
            with s3_server(spheres_copy) as found:
                yield spheres_copy, found


@pytest.fixture(params=["absolute", "parent", "encoded dots", "backslash", "NUL"])
def hostile_name(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    return str(tmp_path / "victim") if request.param == "absolute" else HOSTILE[request.param]


def test_no_record_leads_out_of_a_dataset(
    hostile: tuple[Path, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root, address = hostile
    victim = tmp_path / "victim"
    victim.write_bytes(b"precious")
    before = {path for path in tmp_path.rglob("*") if root not in path.parents}
    assert main(["verify", address]) == 1
    assert "views.0.file" in capsys.readouterr().out.replace("\n", "")
    assert main(["sheet", address, "--out", str(tmp_path / "sheet.png")]) == 1
    source = open_dataset(address)
    with pytest.raises(StoreError, match=r"views\.0\.file"):
        source.scene(0)
    assert victim.read_bytes() == b"precious"
    assert {path for path in tmp_path.rglob("*") if root not in path.parents} == before


@pytest.mark.parametrize("name", HOSTILE.values(), ids=HOSTILE)
@pytest.mark.parametrize("place", ["folder", "memory"])
def test_a_source_hands_out_no_file_elsewhere(spheres_dataset: Path, tmp_path: Path, name: str, place: str) -> None:
    with in_memory(spheres_dataset, "names") as remote:
        address = str(spheres_dataset) if place == "folder" else remote
        source = open_dataset(address)
        with pytest.raises(StoreError, match="it is not read"), source.local(name):
            pass
    assert not list(tmp_path.rglob("*"))


@pytest.mark.parametrize("what", ["views/00.exr", "scene.json", "views", "."])
def test_links_out_of_a_dataset_are_not_followed(spheres_copy: Path, tmp_path: Path, what: str) -> None:
    scene = spheres_copy / "scenes" / "000000"
    moved = tmp_path / "elsewhere"
    shutil.move(scene / what if what != "." else scene, moved)
    (scene / what if what != "." else scene).symlink_to(moved)
    source = open_dataset(spheres_copy)
    with pytest.raises(StoreError, match="leads out of the folder"):
        source.view(source.scene(0), 0)


@pytest.mark.parametrize("what", [".lock", "work", "logs", "scenes", "dataset.json", "scenes/000001"])
def test_nothing_is_made_through_a_link(
    spheres_copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], what: str
) -> None:
    elsewhere = tmp_path / "elsewhere"
    path = spheres_copy / what
    if path.exists():
        shutil.move(path, elsewhere)
    elif what != ".lock":
        elsewhere.mkdir()
    else:
        elsewhere.write_text("precious")
    path.unlink(missing_ok=True)
    path.symlink_to(elsewhere)
    before = elsewhere.read_bytes() if elsewhere.is_file() else sorted(elsewhere.rglob("*"))
    assert main(["dataset", "--out", str(spheres_copy), "--scenes", "3"]) == 1
    assert "remove the link" in capsys.readouterr().err
    assert before == (elsewhere.read_bytes() if elsewhere.is_file() else sorted(elsewhere.rglob("*")))


def textured_obj(folder: Path, texture: str) -> Path:
    """Write a box whose material names a texture."""
    folder.mkdir(parents=True, exist_ok=True)
    mesh = trimesh.creation.box((0.2, 0.2, 0.2))
    lines = ["mtllib box.mtl", *(f"v {x} {y} {z}" for x, y, z in mesh.vertices), "vt 0 0", "vt 1 0", "vt 0 1"]
    lines += ["usemtl paint", *(f"f {a + 1}/1 {b + 1}/2 {c + 1}/3" for a, b, c in mesh.faces)]
    (folder / "box.obj").write_text("\n".join(lines))
    (folder / "box.mtl").write_text(f"newmtl paint\nKd 1 1 1\nmap_Kd {texture}\n")
    return folder / "box.obj"


def test_textures_may_lie_anywhere_in_the_packs_folder(tmp_path: Path) -> None:
    textured_obj(tmp_path / "pack" / "models", "..\\textures\\red.png")
    (tmp_path / "pack" / "textures").mkdir()
    Image.new("RGB", (4, 4), "red").save(tmp_path / "pack" / "textures" / "red.png")
    mesh = FolderPack(tmp_path / "pack", tmp_path / "cache").mesh("box")
    assert mesh.parts[0].material.base_color_texture is not None


@pytest.mark.parametrize("texture", ["../secret.png", "{}/secret.png", "link/secret.png", "..\\secret.png"])
def test_textures_outside_of_the_packs_folder_are_refused(tmp_path: Path, texture: str) -> None:
    Image.new("RGB", (4, 4), "red").save(tmp_path / "secret.png")
    textured_obj(tmp_path / "pack", texture.format(tmp_path))
    (tmp_path / "pack" / "link").symlink_to(tmp_path)
    with pytest.raises(AssetError, match=r"box\.obj: .*; put the file into the folder"):
        FolderPack(tmp_path / "pack", tmp_path / "cache").mesh("box")


@pytest.mark.parametrize(
    "uri", ["../secret.bin", "%2e%2e/secret.bin", "/etc/hostname", "link/secret.bin", "http://a.b/c.bin"]
)
def test_gltf_buffers_outside_of_the_folder_are_refused(tmp_path: Path, uri: str) -> None:
    folder = tmp_path / "pack"
    folder.mkdir()
    for name, content in trimesh.creation.box((0.2, 0.2, 0.2)).export(file_type="gltf").items():
        (folder / name.replace("model", "box")).write_bytes(content)
    header = json.loads((folder / "box.gltf").read_text())
    (tmp_path / "secret.bin").write_bytes((folder / header["buffers"][0]["uri"]).read_bytes())
    (folder / "link").symlink_to(tmp_path)
    header["buffers"][0]["uri"] = uri
    (folder / "box.gltf").write_text(json.dumps(header))
    with pytest.raises(AssetError, match="put the file into the folder"):
        FolderPack(folder, tmp_path / "cache").mesh("box")


def test_a_table_names_no_model_elsewhere(tmp_path: Path) -> None:
    folder = tmp_path / "pack"
    folder.mkdir()
    trimesh.creation.box((0.2, 0.2, 0.2)).export(tmp_path / "box.glb")
    (folder / "link.glb").symlink_to(tmp_path / "box.glb")
    (folder / "assets.csv").write_text("file\nlink.glb\n")
    with pytest.raises(AssetError, match="leads out of the folder"):
        FolderPack(folder, tmp_path / "cache").mesh("link")
    for file in ("../box.glb", str(tmp_path / "box.glb"), "..\\box.glb", "%2e%2e/box.glb"):
        (folder / "assets.csv").write_text(f"file\n{file}\n")
        with pytest.raises(AssetError, match=r"assets\.csv, line 2: .* must lie inside the folder"):
            FolderPack(folder, tmp_path / "cache").infos()


LAYER = """#usda 1.0
(
    upAxis = "Z"
    metersPerUnit = 1
{more}
)
def Mesh "cube" {{
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
}}
{body}
"""
REFERENCES = {
    "sublayer": ("    subLayers = [@{}@]", ""),
    "reference": ("", 'def Xform "more" (references = @{}@</cube>) {{}}'),
    "payload": ("", 'def Xform "more" (payload = @{}@</cube>) {{}}'),
    "variant": (
        "",
        'def Xform "more" (\n variants = {{ string a = "x" }}\n prepend variantSets = "a"\n)\n'
        '{{\n variantSet "a" = {{\n "x" (references = @{}@</cube>) {{\n}}\n}}\n}}',
    ),
}


@pytest.mark.parametrize("kind", REFERENCES)
@pytest.mark.parametrize("name", ["../outside.usda", "{}/outside.usda", "./link/outside.usda"])
def test_a_stage_is_composed_of_no_layer_elsewhere(tmp_path: Path, kind: str, name: str) -> None:
    pytest.importorskip("pxr")
    from multilight.scenes.assets.formats.usd.read import open_stage

    folder = tmp_path / "pack"
    folder.mkdir()
    (folder / "link").symlink_to(tmp_path)
    more, body = (text.format(name.format(tmp_path)) for text in REFERENCES[kind])
    (tmp_path / "outside.usda").write_text(LAYER.format(more="", body=""))
    (folder / "middle.usda").write_text(LAYER.format(more=more, body=body))
    (folder / "stage.usda").write_text(LAYER.format(more="    subLayers = [@./middle.usda@]", body=""))
    with pytest.raises(AssetError, match="a layer outside of its folder"):
        open_stage(folder / "stage.usda")


def test_a_stage_shows_no_picture_elsewhere(tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    from pxr import Sdf

    from multilight.scenes.assets.formats.usd.lights import read_map
    from multilight.scenes.assets.formats.usd.materials import open_picture

    (tmp_path / "pack").mkdir()
    stage = tmp_path / "pack" / "stage.usda"
    Image.new("RGB", (4, 4), "red").save(tmp_path / "secret.png")
    (tmp_path / "secret.exr").write_bytes(b"secret")
    picture, sky = (Sdf.AssetPath(f"../secret.{kind}", str(tmp_path / f"secret.{kind}")) for kind in ("png", "exr"))
    with pytest.raises(AssetError, match="put it beside the stage"):
        open_picture(stage, picture, "/prim")
    with pytest.raises(AssetError, match="put it beside the stage"):
        read_map(stage, sky, "/prim")


@pytest.mark.parametrize("key", ["file_path", "depth_file_path", "ply_file_path"])
@pytest.mark.parametrize("name", ["../secret.png", "{}/secret.png", "images/../../secret.png"])
def test_a_capture_reads_nothing_elsewhere(
    capture_folders: dict[str, Path], tmp_path: Path, key: str, name: str
) -> None:
    from multilight.model.captures.nerfstudio import read_nerfstudio

    folder = Path(shutil.copytree(capture_folders["nerfstudio"], tmp_path / "capture"))
    Image.fromarray(np.zeros((48, 64, 3), np.uint8)).save(tmp_path / "secret.png")
    content = json.loads((folder / "transforms.json").read_text())
    (content if key == "ply_file_path" else content["frames"][0])[key] = name.format(tmp_path)
    (folder / "transforms.json").write_text(json.dumps(content))
    with pytest.raises(UserError, match=r"leads out of the folder|is absolute"):
        read_nerfstudio(folder / "transforms.json", max_side=64)


@pytest.mark.parametrize("name", ["../secret.png", "{}/secret.png", "..\\secret.png"])
def test_a_colmap_model_reads_nothing_elsewhere(capture_folders: dict[str, Path], tmp_path: Path, name: str) -> None:
    from multilight.model.captures.colmap import colmap_model, pycolmap, read_colmap

    folder = Path(shutil.copytree(capture_folders["colmap"], tmp_path / "capture"))
    model = colmap_model(folder)
    assert model is not None
    found = pycolmap.Reconstruction(model)
    next(iter(found.images.values())).name = name.format(tmp_path)
    found.write(model)
    with pytest.raises(UserError, match=r"leads out of the folder|is absolute|backslash|has '\.\.'"):
        read_colmap(folder, model, max_side=64)


@pytest.mark.parametrize("name", ["../secret.png", "{}/secret.png"])
def test_a_foreign_evaluation_set_reads_nothing_elsewhere(tmp_path: Path, name: str) -> None:
    from multilight.model.evaluation.foscom import prepared_paths

    scene = tmp_path / "set" / "scene_0"
    scene.mkdir(parents=True)
    (scene / "transforms.json").write_text(json.dumps({"image_path": name.format(tmp_path)}))
    with pytest.raises(UserError, match=r"leads out of the folder|is absolute"):
        prepared_paths(tmp_path / "set", scene, "image_path")
