"""Files of users' kinds (tests/scenes/cases): each comes in as its maker made it, or is named.

Every row is a kind of file that people had, and what is right for it.
"""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from multilight.scenes.assets.cache import tell_thrown_away
from multilight.scenes.assets.check import check_assets
from multilight.scenes.assets.environments import read_environment
from multilight.scenes.assets.formats.import_file import Intake
from multilight.scenes.assets.formats.imported import ARRAYS, RECORD
from multilight.scenes.assets.info import AssetError
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.meshes import MeshPart, triangle_areas
from multilight.scenes.spec import Texture

CASES = Path(__file__).with_name("cases")


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache into which all cases have been read, a few processes for all."""
    made = tmp_path_factory.mktemp("cache")
    files = sorted(p for name in ("bg", "models", "more", "objs", "usd", "blend") for p in (CASES / name).iterdir())
    Intake(made).convert((p, p.parent) for p in files if p.suffix not in (".png", ".mtl", ".bin", ".exr"))
    return made


class Read:
    """What was read of a case: its parts, lights, size and account."""

    def __init__(self, name: str, cache: Path) -> None:
        self._file = CASES / name
        background = self._file.parent.name in ("bg", "usd", "blend")
        folder = self._file if self._file.is_dir() else self._file.parent
        folders = () if background else (folder,)
        self.library = AssetLibrary(cache, packs=(), folders=folders, background=self._file if background else None)
        self.pack = "background" if background else folder.name
        if background:
            assert self.library.background is not None
            names = [piece.name for piece in self.library.background.pieces]
        else:
            entries = self.library._packs[self.pack]._entries  # type: ignore[attr-defined]
            names = [name for name, entry in entries.items() if self._file in (entry.file, *entry.file.parents)]
        self.meshes = {name: self.library.mesh(f"{self.pack}/{name}") for name in names}
        self.parts = [part for mesh in self.meshes.values() for part in mesh.parts]
        self.notes = "\n".join(str(note) for name in names for note in self.library._packs[self.pack].notes(name))
        self.lights = {} if not background else {light.name: light for light in self.library.background.lights}

    @property
    def size(self) -> list[float]:
        """The size of the one mesh [m]."""
        ((low, high),) = (mesh.bounds() for mesh in self.meshes.values())
        return [round(float(v), 4) for v in high - low]

    def pixels(self, texture: Texture | None) -> np.ndarray:
        """Return a texture's pixels."""
        assert texture is not None
        with Image.open(self.library.texture_path(texture.image)) as picture:
            return np.asarray(picture)


def tiled(part: MeshPart, texture: Texture | None) -> list[float]:
    """Return how often a texture repeats over a part in each direction."""
    assert texture is not None
    return [round(float(v), 4) for v in np.ptp(part.uv, axis=0) * texture.repeat]


def only(read: Read) -> MeshPart:
    (part,) = read.parts
    return part


def is_textured(read: Read) -> bool:
    """The one part shows the 64-pixel picture of the cases."""
    return read.pixels(only(read).material.base_color_texture).shape[:2] == (64, 64)


def material(**wanted: Any) -> Callable[[Read], bool]:
    """The one part's material has these values."""

    def check(read: Read) -> bool:
        made = only(read).material
        return all(getattr(made, name) == pytest.approx(value, abs=1e-5) for name, value in wanted.items())

    return check


def shows_ramp(read: Read) -> bool:
    pixels = read.pixels(only(read).material.base_color_texture)[..., 0]
    return bool(pixels.min() < 10 < 245 < pixels.max() and len(np.unique(pixels)) > 20)


def shows_checker(read: Read) -> bool:
    pixels = read.pixels(only(read).material.base_color_texture).reshape(-1, 3).astype(int)
    red, blue = (pixels[:, 0] > pixels[:, 2] + 50).mean(), (pixels[:, 2] > pixels[:, 0] + 50).mean()
    return bool(0.4 < red < 0.6 and 0.4 < blue < 0.6)


def mean_roughness(read: Read) -> float:
    made = only(read).material
    return made.roughness * (float(read.pixels(made.roughness_texture).mean()) / 255 if made.roughness_texture else 1.0)


def covers(read: Read, x: float, z: float) -> bool:
    """Tell whether the part has a triangle over a point of the file, which is Y-up, seen along its Y."""
    part = only(read)
    corners = part.triangles().astype(float)[:, :, :2] * (1, -1)
    flat = corners - corners.reshape(-1, 2).min(axis=0)
    a, b, c = (flat[:, i] - (x, z) for i in range(3))
    sides = [p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0] for p, q in ((a, b), (b, c), (c, a))]
    return bool((np.all(np.array(sides) > 1e-9, axis=0) | np.all(np.array(sides) < -1e-9, axis=0)).any())


RIGHT: dict[str, Callable[[Read], Any]] = {
    "bg/c01_texture_transform12.glb": lambda r: tiled(only(r), only(r).material.base_color_texture) == [12, 12],
    "bg/c03_quantized.glb": lambda r: r.size == [3, 3, 0],
    "bg/c05_png16.glb": shows_ramp,
    "bg/c08_light_zero_scale.glb": lambda r: r.lights["p"].amount == pytest.approx((100,) * 3),
    "bg/c15_multi_primitive.glb": lambda r: [p.name for p in r.parts] == ["bg-tex", "bg-b", "bg-c"],
    "bg/c17_glass.glb": lambda r: [(p.material.transmission, p.material.ior) for p in r.parts] == [(0, 1.5), (1, 1.45)],
    "bg/c23_same_name_emission.glb": lambda r: [r.lights[n].amount[0] for n in ("bg_l1", "bg_l2")] == [1000, 10],
    "bg/c33_mask_cutoff.glb": lambda r: only(r).material.alpha_cutoff == 0.2 and only(r).material.opacity_from_alpha,
    "blend/d04_procedural_checker.blend": shows_checker,
    "blend/d06_mapping_scale12.blend": lambda r: tiled(only(r), only(r).material.base_color_texture) == [12, 12],
    "blend/d23_glass.blend": lambda r: [p.material.transmission for p in r.parts if p.material.ior == 1.45] == [1],
    "blend/d24_diffuse_bsdf_not_principled.blend": lambda r: [
        (p.material.base_color, p.material.metallic) for p in r.parts if p.material.roughness == 1
    ] == [((0.8, 0.02, 0.02), 0)],
    "models/a01_texture_transform.glb": lambda r: tiled(only(r), only(r).material.base_color_texture) == [4, 4],
    "models/a03_vcol_float_nomat.glb": material(base_color=(1, 0.0497066, 0.0497066)),
    "models/a05_texcoord1.glb": lambda r: is_textured(r) and np.allclose(only(r).uv, [0.5, 0.5], atol=0.5),
    "models/a07_quant_normalized.glb": lambda r: r.size == [0.1, 0.1, 0.1],
    "models/a09_sparse.glb": lambda r: r.size == [0.1, 0.1, 0.1],
    "models/a16_blend_factor_and_texture.glb": lambda r: is_textured(r) and material(opacity=0.3)(r),
    "models/a17_transmission_ior.glb": material(transmission=1, ior=1.33, base_color=(0.8,) * 3),
    "models/a18_clearcoat.glb": material(coat=1, coat_roughness=0.02),
    "models/a23_normal_scale0.glb": material(normal_texture=None),
    "models/a24_clamp.glb": lambda r: only(r).material.base_color_texture.wrap == "clamp",
    "models/a25_png16_gray.glb": shows_ramp,
    "models/a38 spaced ünicode.gltf": is_textured,
    "models/a40_instancing.glb": lambda r: len(r.parts) == 3 and r.size == [0.7, 0.1, 0.1],
    "more/e00_skin_ignores_node_scale.glb": lambda r: r.size == [0.1, 0.1, 0.1],
    "more/e07_rough16.glb": lambda r: mean_roughness(r) == pytest.approx(0.5, abs=0.01),
    "more/e13_black_plastic.glb": material(base_color=(0.0055,) * 3, metallic=0),
    "objs/b00_base.obj": lambda r: is_textured(r) and material(base_color=(0.8,) * 3, metallic=0)(r),
    "objs/b01_missing_mtl.obj": lambda r: material(base_color=(0.8,) * 3, metallic=0)(r) and "nope.mtl" in r.notes,
    "objs/b04_map_options.obj": lambda r: tiled(only(r), only(r).material.base_color_texture) == [2, 2],
    "objs/b13_concave_U.obj": lambda r: covers(r, 0.05, 0.01) and not covers(r, 0.05, 0.06),
    "objs/b14_vertex_colours.obj": lambda r: only(r).material.base_color[0] > 100 * only(r).material.base_color[1] > 0,
    "objs/b19_bump_pbr.obj": lambda r: material(roughness=0.2, metallic=1)(r) and only(r).material.normal_texture,
    "objs/b21_case_mismatch.obj": is_textured,
    "usd/u05_uvmap_name.usda": is_textured,
    "usd/u07_transform2d_offset.usda": lambda r: (only(r).uv.min(), only(r).uv.max()) == (0.5, 1.0),
    "usd/u09_cone_capsule_plane.usda": lambda r: {n: m.bounds()[1, 2] for n, m in r.meshes.items()}
    == pytest.approx({"bg_floor": 0, "bg_cap": 0.6, "bg_cone": 0.4}),
    "usd/u10_plane_prim_floor.usda": lambda r: r.size == [3, 3, 0],
    "usd/u13_light_dome.usda": lambda r: r.lights["l"].kind == "environment" and r.lights["l"].amount == (1000,) * 3,
    "usd/u13_light_mesh_lightapi.usda": lambda r: r.lights["bg_l"].amount == (1000,) * 3,
    "usd/u13_light_rect_tex.usda": lambda r: r.lights["l"].kind == "area" and "tex.png" in r.notes,
    "usd/u14_materialx_only.usda": material(base_color=(0.9, 0.1, 0.1)),
    "usd/u15_concave.usda": lambda r: len(only(r).faces) == 6
    and only(r).triangles()[:, :, 1].mean(axis=1).max() < 1.5  # centred: none lies over the notch
    and triangle_areas(only(r).triangles()).sum() == pytest.approx(7.0),
    "usd/u20_dome_lum_exr.usda": lambda r: np.ptp(
        read_environment(r.library.environment_path(f"background/{r.lights['d'].map}")), axis=-1
    ).max() == 0,
    "folders/gso/mug": is_textured,
}  # fmt: skip
REFUSED = {
    "blend/d10_linked_missing.blend": r"d10_linked_missing\.blend links the library '//lib/lib2\.blend'.* put it there",
    "models/a33_ktx2_required.glb": r"a33_ktx2_required\.glb: it needs KHR_texture_basisu.* export it without",
    "models/a34_draco.glb": r"a34_draco\.glb: its Draco compression .* export it without",
    "models/a36_missing_image.gltf": r"a36_missing_image\.gltf: .*'not_there\.png' is missing; put it beside",
    "models/a39_broken_png.glb": r"a39_broken_png\.glb: its texture .* cannot be read .* save it as PNG",
    "usd/u20_dome_nan_exr.usda": r"u20_dome_nan_exr\.usda: .*nan\.exr holds NaN",
    "usd/u20_dome_square_exr.usda": r"u20_dome_square_exr\.usda: .*square\.exr is 64 x 64 pixels; .* twice as wide",
}


@pytest.mark.parametrize("name", RIGHT)
def test_a_file_comes_in_as_it_was_made(name: str, cache: Path) -> None:
    assert RIGHT[name](Read(name, cache))


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_read_is_named(name: str, cache: Path) -> None:
    with pytest.raises(AssetError, match=REFUSED[name]) as refused:
        Read(name, cache)
    assert "\n" not in str(refused.value)
    assert str(cache) not in str(refused.value)


def test_every_case_has_its_row() -> None:
    kinds = (".glb", ".gltf", ".obj", ".usda", ".blend")
    files = {str(p.relative_to(CASES)) for p in CASES.glob("[!f]*/*") if p.suffix in kinds}
    assert files == {name for name in RIGHT | REFUSED if not name.startswith("folders")}


def test_names_of_any_script_and_skies_are_assets(cache: Path) -> None:
    words = AssetLibrary(cache, packs=(), folders=(CASES / "folders" / "cjk",))
    assert {info.id for info in words.list("object")} == {"cjk/机", "cjk/椅子"}
    skies = AssetLibrary(cache, packs=(), folders=(CASES / "folders" / "hdri",))
    assert {info.id: info.place for info in skies.list("environment")} == {"hdri/flat": "flat", "hdri/ok": "ok"}
    assert all(read_environment(skies.environment_path(i.id)).shape[2] == 3 for i in skies.list("environment"))
    assert not check_assets(skies)


def test_a_copy_elsewhere_is_the_same(cache: Path, tmp_path: Path) -> None:
    """Names, order, bytes: of a fresh cache, of another folder, all at once or one by one."""
    shutil.copytree(CASES / "bg", tmp_path / "elsewhere")
    first, second = (
        AssetLibrary(place, packs=(), background=folder / "c15_multi_primitive.glb")
        for place, folder in ((cache, CASES / "bg"), (tmp_path / "cache", tmp_path / "elsewhere"))
    )
    names = [{info.id: first.mesh(info.id).sha256() for info in first.list("surrounding")} for first in (first, second)]
    assert names[0] == names[1] != {}
    assert sorted(p.name for p in (tmp_path / "cache").rglob("*.png"))
    moved = Intake(tmp_path / "cache")
    assert moved.key(tmp_path / "elsewhere" / "c17_glass.glb", tmp_path) == Intake(cache).key(
        CASES / "bg" / "c17_glass.glb", CASES
    )


def test_a_damaged_record_is_made_anew(cache: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = Path(shutil.copy(CASES / "models" / "a09_sparse.glb", tmp_path / "cube.glb"))
    intake = Intake(tmp_path / "cache")
    whole = intake.read(file, tmp_path)
    for name in (RECORD, ARRAYS):
        (path,) = (tmp_path / "cache").rglob(name)
        path.write_bytes(path.read_bytes()[:50])
        again = Intake(tmp_path / "cache").read(file, tmp_path)
        assert [(n.name, len(n.parts[0].faces)) for n in again.nodes] == [(n.name, 12) for n in whole.nodes]
        tell_thrown_away()
        assert "a damaged file thrown away" in capsys.readouterr().err


def test_what_ends_the_converter_is_named_and_the_rest_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of three files the second makes the process end."""
    for name, case in (("a", "more/e07_rough16"), ("b", "more/e13_black_plastic"), ("c", "models/a09_sparse")):
        shutil.copy(CASES / f"{case}.glb", tmp_path / f"{name}.glb")
    crash = "import os\nfrom multilight.scenes.assets.formats import precheck\nread = precheck.check_model\n"
    crash += "precheck.check_model = lambda p, f: os.abort() if p.name == 'b.glb' else read(p, f)\n"
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "sitecustomize.py").write_text(crash)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "here"))
    library = AssetLibrary(tmp_path / "cache", packs=(), folders=(tmp_path,))
    assert len(library.list("object")) == 3
    problems = dict(check_assets(library))
    assert [asset.rpartition("/")[2] for asset in problems] == ["b"]
    assert "b.glb cannot be read: it ends Blender (SIGABRT)" in next(iter(problems.values()))


def test_an_mtl_of_other_case_is_taken(tmp_path: Path) -> None:
    for name in ("b00_base.obj", "tex.png"):
        shutil.copy(CASES / "objs" / name, tmp_path)
    shutil.copy(CASES / "objs" / "b00_base.mtl", tmp_path / "B00_Base.MTL")
    found = Intake(tmp_path / "cache").read(tmp_path / "b00_base.obj", tmp_path)
    assert found.nodes[0].parts[0].material.base_color_texture is not None
    assert [note.instead for note in found.notes] == ["B00_Base.MTL is taken"]


Change = Callable[[dict[str, Any], dict[str, Any]], Any]
with Image.open(CASES / "objs" / "tex.png") as tiles:
    TILES = np.asarray(tiles.convert("RGB"), np.float64)
PICTURES: dict[str, Image.Image] = {
    "cmyk.jpg": Image.new("CMYK", (8, 8), (0, 255, 255, 0)),
    "palette.png": Image.new("RGB", (8, 8), (200, 30, 40)).quantize(4),
    "clear.png": Image.new("LA", (8, 8), (128, 100)),
}


def with_picture(name: str, **more: Any) -> Change:
    def change(header: dict[str, Any], material: dict[str, Any]) -> None:
        header["images"][0] = {"uri": name}
        material.update(more)

    return change


def extended(name: str, **values: Any) -> Change:
    def change(header: dict[str, Any], material: dict[str, Any]) -> None:
        material["extensions"] = {name: values}
        header["extensionsUsed"] = [name]

    return change


VARIED: dict[str, tuple[Change, Callable[[Read], Any]]] = {
    "cmyk": (
        with_picture("cmyk.jpg"),
        lambda r: r.pixels(only(r).material.base_color_texture)[0, 0].tolist() == [255, 0, 0],
    ),
    "palette": (
        with_picture("palette.png"),
        lambda r: r.pixels(only(r).material.base_color_texture)[0, 0].tolist() == [200, 30, 40],
    ),
    "grey with alpha": (
        with_picture("clear.png", alphaMode="BLEND"),
        lambda r: r.pixels(only(r).material.base_color_texture)[0, 0].tolist() == [128, 128, 128, 100],
    ),
    "a hole": (
        with_picture("clear.png", alphaMode="MASK", alphaCutoff=0.5),
        lambda r: material(alpha_cutoff=0.5, opacity_from_alpha=True)(r),
    ),
    "alpha that is not asked for": (with_picture("clear.png"), material(opacity=1, opacity_from_alpha=False)),
    "occlusion in the same picture": (
        lambda _, m: m.update(occlusionTexture={"index": 0}),
        lambda r: r.pixels(only(r).material.base_color_texture).mean() == pytest.approx(TILES.mean(), abs=0.5),
    ),
    "unlit": (extended("KHR_materials_unlit"), lambda r: "unlit" in r.notes and is_textured(r)),
    "sheen": (extended("KHR_materials_sheen", sheenColorFactor=[1, 0, 0]), lambda r: "sheen" in r.notes),
    "no reflection": (extended("KHR_materials_specular", specularFactor=0.0), material(ior=1.0)),
    "an unknown extension": (extended("EXT_anything", a=1), lambda r: "EXT_anything" in r.notes),
    "specular and glossiness": (
        lambda h, m: (m.pop("pbrMetallicRoughness"),
                      extended("KHR_materials_pbrSpecularGlossiness", diffuseFactor=[0.5, 0.1, 0.1, 1],
                               glossinessFactor=0.7, specularFactor=[0.04] * 3)(h, m)),
        material(base_color=(0.5, 0.1, 0.1), roughness=0.3),
    ),
    "mirrored": (
        lambda h, _: h.update(samplers=[{"wrapS": 33648, "wrapT": 33648}], textures=[{"source": 0, "sampler": 0}]),
        lambda r: only(r).material.base_color_texture.wrap == "mirror",
    ),
    "clamped one way, repeated the other": (
        lambda h, _: h.update(samplers=[{"wrapS": 33071, "wrapT": 10497}], textures=[{"source": 0, "sampler": 0}]),
        lambda r: "baked" in r.notes and r.pixels(only(r).material.base_color_texture).max() > 100,
    ),
    "glowing": (lambda _, m: m.update(emissiveFactor=[1, 0.5, 0]), material(emission=(200, 100, 0))),
}  # fmt: skip


@pytest.fixture(scope="module")
def varied(cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of files that differ from one of the cases in one thing each."""
    folder = tmp_path_factory.mktemp("varied")
    header = json.loads((CASES / "models" / "a38 spaced ünicode.gltf").read_text())
    for name in ("tex größe 1.png", "buf fer.bin"):
        shutil.copy(CASES / "models" / name, folder)
    for name, picture in PICTURES.items():
        picture.save(folder / name)
    for name, (change, _) in VARIED.items():
        made = json.loads(json.dumps(header))
        change(made, made["materials"][0])
        (folder / f"{name}.gltf").write_text(json.dumps(made))
    Intake(cache).convert((path, folder) for path in sorted(folder.glob("*.gltf")))
    return folder


@pytest.mark.parametrize("name", VARIED)
def test_what_else_glTF_says_is_carried_or_named(name: str, varied: Path, cache: Path) -> None:  # noqa: N802
    read = Read(str(varied / f"{name}.gltf"), cache)
    assert VARIED[name][1](read)


def test_a_room_is_the_same_in_every_format_that_blender_writes(cache: Path) -> None:
    """Surfaces, glow and lamps of a room, as Blender saved and exported it; glTF has no panels and skies."""
    told = []
    for kind in ("blend", "glb", "usdc"):
        library = AssetLibrary(cache, packs=(), background=CASES / "fromblender" / f"room.{kind}")
        assert library.background is not None
        lights = {}
        for found in library.background.lights:
            unit = 179.0 if found.unit in ("cd", "lx", "nit") else 1.0
            lights[found.kind] = pytest.approx([value / unit for value in found.amount], rel=5e-3)
        parts = [p for piece in library.background.pieces for p in library.mesh(f"background/{piece.name}").parts]
        surfaces = {
            part.name: pytest.approx(
                [*part.material.base_color, part.material.roughness, part.material.metallic], abs=1e-5
            )
            for part in parts
        }
        told.append((surfaces, lights, sorted(piece.size for piece in library.background.pieces)))
    (surfaces, lights, sizes), glb, usd = told
    assert len(surfaces) == 4
    assert {"sun", "point", "spot", "emissive"} <= glb[1].keys()
    for other in (glb, usd):
        assert {name: value.expected for name, value in other[0].items()} == surfaces
        assert {kind: value.expected for kind, value in other[1].items()} == {kind: lights[kind] for kind in other[1]}
        assert np.allclose(other[2], sizes, atol=1e-4)
