"""Other exporters' habits, in files made here: each comes in as it was made, or is named."""

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdShade, UsdUtils

from multilight.scenes.assets.environments import read_environment
from multilight.scenes.assets.formats.import_file import Intake
from multilight.scenes.assets.formats.imported import Imported
from multilight.scenes.assets.formats.usd.lights import upright
from multilight.scenes.assets.info import AssetError
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.assets.packs import guesses
from multilight.scenes.spec import Material
from tests.scenes.custom_scenes import write_glb_of

Kinds = Sdf.ValueTypeNames
SHEET = "v 0 0 0\nv .1 0 0\nv .1 .1 0\nv 0 .1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
FACES = "usemtl m\nf 1/1 2/2 3/3 4/4\n"


def materials(found: Imported) -> list[Material]:
    return [part.material for node in found.nodes for part in node.parts]


def has(**wanted: Any) -> Callable[[Imported], bool]:
    """Its first material has these values."""

    def check(found: Imported) -> bool:
        made = materials(found)[0]
        return all(getattr(made, name) == pytest.approx(value, abs=1e-4) for name, value in wanted.items())

    return check


def faces(found: Imported) -> int:
    return sum(len(part.faces) for node in found.nodes for part in node.parts)


def colours(found: Imported) -> list[tuple[float, ...]]:
    return sorted(tuple(round(v, 2) for v in made.base_color) for made in materials(found))


def glow(found: Imported) -> tuple[float, ...]:
    (emission,) = found.nodes[0].emissions
    assert emission is not None
    return emission.amount


def notes(found: Imported) -> str:
    return "\n".join(map(str, found.notes))


def size(found: Imported) -> list[float]:
    points = np.concatenate([part.vertices for node in found.nodes for part in node.parts])
    return [round(float(v), 4) for v in np.ptp(points, axis=0)]


RED, GREEN = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
OBJ: dict[str, tuple[str, str, Callable[[Imported], Any]]] = {
    "negative indices": (SHEET + "f -4/-4 -3/-3 -2/-2 -1/-1\n", "", lambda f: faces(f) == 2),
    "a line goes on": (SHEET + "f 1/1 2/2 \\\n 3/3 4/4\n", "", lambda f: faces(f) == 2),
    "marks and CRLF": ("\ufeffmtllib {}\r\n" + (SHEET + FACES).replace("\n", "\r\n"), "\ufeffnewmtl m\r\nKd 1 0 0\r\n",
                       has(base_color=RED)),
    "a material that no MTL has": ("mtllib {}\n" + SHEET + FACES, "newmtl other\nKd 1 0 0\n",
                                   lambda f: has(base_color=(0.8,) * 3)(f) and "'m': no MTL file has it" in notes(f)),
    "two libraries in a line": ("mtllib {} b.mtl\n" + SHEET + "usemtl m\nf 1 2 3\nusemtl b\nf 1 3 4\n",
                                "newmtl m\nKd 1 0 0\n", lambda f: colours(f) == [GREEN, RED]),
    "transparency": ("mtllib {}\n" + SHEET + FACES, "newmtl m\nKd 1 0 0\nTr 0.7\nillum 4\n",
                     has(opacity=0.3, metallic=0, transmission=0)),
    "opaque as Maya says it": ("mtllib {}\n" + SHEET + FACES, "newmtl m\nillum 4\nKd 1 0 0\nKa 1 1 1\nTf 1 1 1\nNi 1\n",
                               has(transmission=0, metallic=0, opacity=1)),
    "refraction": ("mtllib {}\n" + SHEET + FACES, "newmtl m\nillum 7\nKd 1 1 1\nNi 1.33\n",
                   has(transmission=1, ior=1.33)),
    "a mask, key words in capitals": ("mtllib {}\n" + SHEET + FACES, "newmtl m\nKD 1 0 0\nMAP_D my mask.png\nDISP x\n",
                                      lambda f: has(opacity_from_alpha=True)(f) and "DISP" in notes(f)),
    "glow": ("mtllib {}\n" + SHEET + FACES, "newmtl m\nKd 0 0 0\nKe 5 5 5\n",
             lambda f: glow(f) == (1000.0,) * 3),
    "lines and smoothing": ("s 1\ng a b\n" + SHEET + "s off\nf 1/1 2/2 3/3 4/4\nl 1 2\np 1\n", "",
                            lambda f: faces(f) == 2),
}  # fmt: skip


def ply(order: str) -> bytes:
    head = "ply\nformat binary_{}_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    head += "property uchar red\nproperty uchar green\nproperty uchar blue\nelement face 1\n"
    head += "property list uchar int vertex_indices\nend_header\n"
    mark = ">" if order == "big" else "<"
    corners = (struct.pack(mark + "3f3B", x, y, 0, 188, 0, 0) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1)))
    return head.format(order).encode() + b"".join(corners) + struct.pack(mark + "B4i", 4, 0, 1, 2, 3)


TRIANGLE = struct.pack("<12fH", 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0)
SOLID = (
    "solid {}\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 {}\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n"
)
PLAIN: dict[str, tuple[bytes, Callable[[Imported], Any]]] = {
    "big.ply": (ply("big"), lambda f: faces(f) == 2 and colours(f) == [(0.5, 0, 0)]),
    "little.ply": (ply("little"), lambda f: faces(f) == 2 and colours(f) == [(0.5, 0, 0)]),
    "two solids.stl": ((SOLID.format("a", 0) + SOLID.format("b", 1)).encode(), lambda f: faces(f) == 2),
    "solid.stl": (b"solid of some CAD".ljust(80) + struct.pack("<I", 1) + TRIANGLE, lambda f: faces(f) == 1),
}

CREDITS = {"author": "A. Maker", "license": "CC-BY-4.0 (http://creativecommons.org/licenses/by/4.0/)", "title": "Mug"}
KTX: dict[str, Any] = {
    "textures": [{"extensions": {"KHR_texture_basisu": {"source": 0}}}],
    "extensionsUsed": ["KHR_texture_basisu"],
}
GLTF: dict[str, tuple[dict[str, Any], dict[str, Any], Callable[[Imported], Any]]] = {
    "credits": ({"asset": {"version": "2.0", "extras": CREDITS}}, {}, lambda f: f.credits == CREDITS),
    "copyright": ({"asset": {"version": "2.0", "copyright": "CC0, by X"}}, {},
                  lambda f: guesses.credited(f.credits) == ("CC0-1.0", "CC0, by X")),
    "clear vertices": ({}, {"alphaMode": "BLEND"}, has(opacity_from_alpha=True)),
    "opaque vertices": ({}, {}, has(opacity_from_alpha=False, base_color=RED)),
    "anisotropy": ({"extensionsUsed": ["KHR_materials_anisotropy"]},
                   {"extensions": {"KHR_materials_anisotropy": {"anisotropyStrength": 0.8}}},
                   lambda f: "anisotropy" in notes(f)),
}  # fmt: skip
REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "ktx2": (KTX, "its texture 0 needs KHR_texture_basisu, which is not read; save it as PNG"),
    "meshopt": ({"extensionsUsed": ["EXT_meshopt_compression"], "extensionsRequired": ["EXT_meshopt_compression"]},
                "it needs EXT_meshopt_compression"),
}  # fmt: skip


class Stage:
    """A stage with a sheet of 0.1 by 0.2 on a material `m` that is begun."""

    def __init__(self, file: Path, shader: str = "UsdPreviewSurface", up: str = "Y", metres: float = 1.0) -> None:
        self.made = Usd.Stage.CreateNew(str(file))
        UsdGeom.SetStageUpAxis(self.made, up)
        UsdGeom.SetStageMetersPerUnit(self.made, metres)
        self.made.SetDefaultPrim(UsdGeom.Xform.Define(self.made, "/w").GetPrim())
        self.sheet = UsdGeom.Mesh.Define(self.made, "/w/g/a")
        self.sheet.CreatePointsAttr([Gf.Vec3f(x, y, 0) * 0.1 for x, y in ((0, 0), (1, 0), (1, 2), (0, 2))])
        self.sheet.CreateFaceVertexCountsAttr([4])
        self.sheet.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
        self.coordinates("st", 1)
        self.material = UsdShade.Material.Define(self.made, "/m")
        self.shader = self.node("s", shader)
        output = self.material.CreateSurfaceOutput("" if shader == "UsdPreviewSurface" else "mtlx")
        output.ConnectToSource(self.shader.CreateOutput("surface", Kinds.Token))
        # On what is above: bindings are inherited.
        UsdShade.MaterialBindingAPI.Apply(self.made.GetPrimAtPath("/w/g")).Bind(self.material)

    def coordinates(self, name: str, times: float) -> None:
        made = UsdGeom.PrimvarsAPI(self.sheet).CreatePrimvar(name, Kinds.TexCoord2fArray, "vertex")
        made.Set([Gf.Vec2f(x, y) * times for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))])

    def node(self, name: str, kind: str, under: str = "/m") -> Any:
        made = UsdShade.Shader.Define(self.made, f"{under}/{name}")
        made.CreateIdAttr(kind)
        return made

    def fed(self, owner: Any, name: str, source: Any, kind: Any = Kinds.Color3f) -> Any:
        """Feed an input by a node's first output, or another's input."""
        output = source if hasattr(source, "GetBaseName") else source.CreateOutput("rgb", kind)
        owner.CreateInput(name, kind).ConnectToSource(output)
        return source

    def picture(self, under: str = "/m", kind: str = "UsdUVTexture") -> Any:
        node = self.node("t", kind, under)
        node.CreateInput("file", Kinds.Asset).Set("my mask.png")
        return node


def interface(s: Stage) -> None:
    colour = s.material.CreateInput("colour", Kinds.Color3f)
    colour.Set(GREEN)
    s.fed(s.shader, "diffuseColor", colour)


def other_layer(s: Stage) -> None:
    s.coordinates("uv2", 3)
    name = s.material.CreateInput("frame:stPrimvarName", Kinds.Token)
    name.Set("uv2")
    reader = s.node("r", "UsdPrimvarReader_float2")
    s.fed(reader, "varname", name, Kinds.Token)
    s.fed(s.fed(s.shader, "diffuseColor", s.picture()), "st", reader, Kinds.Float2)


def vertex_colours(s: Stage) -> None:
    s.sheet.CreateDisplayColorPrimvar("constant").Set([GREEN])
    reader = s.fed(s.shader, "diffuseColor", s.node("r", "UsdPrimvarReader_float3"))
    reader.CreateInput("varname", Kinds.Token).Set("displayColor")


def moving(s: Stage) -> None:
    points = s.sheet.GetPointsAttr()
    values = points.Get()
    points.Clear()
    points.Set(values, 1)
    scale = s.sheet.AddScaleOp()
    for time in (1, 2):
        scale.Set(Gf.Vec3f(2 * time), time)


def graph(s: Stage) -> None:
    inner = UsdShade.NodeGraph.Define(s.made, "/m/g")
    out = inner.CreateOutput("o", Kinds.Color3f)
    out.ConnectToSource(s.picture("/m/g", "ND_image_color3").CreateOutput("out", Kinds.Color3f))
    s.fed(s.shader, "base_color", out)
    s.shader.CreateInput("sheen", Kinds.Float).Set(0.5)


def unread(s: Stage) -> None:
    s.fed(s.shader, "base_color", s.node("n", "ND_multiply_color3"))


def instances(s: Stage) -> None:
    for number in range(2):
        copy = UsdGeom.Xform.Define(s.made, f"/w/copy{number}")
        copy.GetPrim().GetReferences().AddInternalReference("/w/g")
        copy.GetPrim().SetInstanceable(True)
        copy.AddTranslateOp().Set((0.3 * (number + 1), 0, 0))


def repeated(s: Stage) -> None:
    instancer = UsdGeom.PointInstancer.Define(s.made, "/w/i")
    instancer.CreatePrototypesRel().AddTarget("/w/g/a")
    instancer.CreateProtoIndicesAttr([0, 0])
    instancer.CreatePositionsAttr([(1, 0, 0), (2, 0, 0)])


def variant(s: Stage) -> None:
    chosen = s.made.GetDefaultPrim().GetVariantSets().AddVariantSet("look")
    for name, times in (("large", 5), ("small", 1)):
        chosen.AddVariant(name)
        chosen.SetVariantSelection(name)
        with chosen.GetVariantEditContext():
            UsdGeom.Xformable(s.made.GetPrimAtPath("/w/g")).AddScaleOp().Set(Gf.Vec3f(times))


def left(s: Stage) -> None:
    s.sheet.CreateSubdivisionSchemeAttr("catmullClark")
    UsdLux.GeometryLight.Define(s.made, "/w/light")
    UsdGeom.BasisCurves.Define(s.made, "/w/curve")


STANDARD, OPEN = "ND_standard_surface_surfaceshader", "ND_open_pbr_surface_surfaceshader"
USD: dict[str, tuple[dict[str, Any], Callable[[Stage], None], Callable[[Imported], Any]]] = {
    "centimetres": ({"metres": 0.01, "up": "Z"}, interface, lambda f: size(f) == [0.001, 0.002, 0]),
    "interface": ({}, interface, lambda f: size(f) == [0.1, 0, 0.2] and colours(f) == [GREEN]),
    "layer by an interface": ({}, other_layer, lambda f: f.nodes[0].parts[0].uv.max() == 3),
    "vertex colours": ({}, vertex_colours, lambda f: colours(f) == [GREEN]),
    "moving": ({}, moving, lambda f: size(f) == [0.2, 0, 0.4]),
    "graph": ({"shader": STANDARD}, graph,
              lambda f: materials(f)[0].base_color_texture is not None and "sheen" in notes(f)),
    "unread": ({"shader": OPEN}, unread, lambda f: "its base_color comes of a ND_multiply_color3" in notes(f)),
    "instances": ({}, instances, lambda f: len(f.nodes) == 3 and size(f)[0] == 0.7),
    "point instancer": ({}, repeated, lambda f: len(f.nodes) == 3 and size(f)[0] == 2.1),
    "variant": ({}, variant, lambda f: size(f) == [0.1, 0, 0.2]),
    "left out": ({}, left, lambda f: all(w in notes(f) for w in ("subdivision", "GeometryLight", "BasisCurves"))),
}  # fmt: skip


@pytest.fixture(scope="module")
def read(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Imported]:
    """Make all files, let one process read them, and return what reads them by name."""
    folder, cache = tmp_path_factory.mktemp("files"), tmp_path_factory.mktemp("cache")
    mask = np.zeros((8, 8), np.uint8)
    mask[:4] = 255
    Image.fromarray(mask).save(folder / "my mask.png")
    (folder / "b.mtl").write_text("newmtl b\nKd 0 1 0\n")
    for name, (text, mtl, _) in OBJ.items():
        (folder / f"{name}.obj").write_bytes(text.replace("{}", f"{name}.mtl").encode())
        if mtl:
            (folder / f"{name}.mtl").write_bytes(mtl.encode())
    for name, (data, _) in PLAIN.items():
        (folder / name).write_bytes(data)
    made = {name: (header, material) for name, (header, material, _) in GLTF.items()}
    made |= {name: (header, {}) for name, (header, _) in REFUSED.items()}
    for name, (header, material) in made.items():
        write_glb_of(folder / f"{name}.glb", header, material)
    for name, (options, change, _) in USD.items():
        stage = Stage(folder / f"{name}.usda", **options)
        change(stage)
        stage.made.Save()
    stage.made.GetPrimAtPath("/w").GetReferences().AddReference("./not there.usda")
    stage.made.GetRootLayer().Export(str(folder / "missing.usda"))
    UsdUtils.CreateNewUsdzPackage(str(folder / "layer by an interface.usda"), str(folder / "packed.usdz"))
    intake = Intake(cache)
    intake.convert((p, folder) for p in sorted(folder.iterdir()) if p.suffix not in (".png", ".mtl"))
    return lambda name: intake.read(folder / name, folder)


CASES = {f"{name}.obj": right for name, (_, _, right) in OBJ.items()} | {n: right for n, (_, right) in PLAIN.items()}
CASES |= {f"{name}.glb": right for name, (_, _, right) in GLTF.items()}
CASES |= {f"{name}.usda": right for name, (_, _, right) in USD.items()}
CASES["packed.usdz"] = lambda f: materials(f)[0].base_color_texture is not None


@pytest.mark.parametrize("name", CASES)
def test_it_comes_in_as_it_was_made_or_is_named(name: str, read: Callable[[str], Imported]) -> None:
    found = read(name)
    assert CASES[name](found), (materials(found), notes(found))


def test_what_is_not_read_is_refused_by_name(read: Callable[[str], Imported]) -> None:
    for name, (_, said) in REFUSED.items():
        with pytest.raises(AssetError, match=said):
            read(f"{name}.glb")
    with pytest.raises(AssetError, match=r"missing\.usda cannot be composed: Could not open asset 'not there\.usda'"):
        read("missing.usda")


def test_a_tilted_dome_shines_from_where_it_is_turned(tmp_path: Path) -> None:
    stage = Stage(tmp_path / "sky.usda", up="Z")
    picture = np.full((32, 64, 3), 40, np.uint8)
    picture[:8], picture[:, 28:36] = (0, 0, 255), (255, 0, 0)
    Image.fromarray(picture).save(tmp_path / "sky.png")
    UsdLux.DomeLight.Define(stage.made, "/w/d").CreateTextureFileAttr("sky.png")  # its pole is +Y, its centre +Z
    stage.sheet.AddScaleOp().Set(Gf.Vec3f(20))
    stage.made.Save()
    library = AssetLibrary(tmp_path / "cache", packs=("builtin",), background=tmp_path / "sky.usda")
    assert library.background is not None
    (light,) = library.background.lights
    image = read_environment(library.environment_path(f"background/{light.map}"))
    assert light.rotation == 0
    assert image[0].mean(axis=0) == pytest.approx((1, 0, 0), abs=0.02)
    assert image[16, 16] == pytest.approx((0, 0, 1), abs=0.02)
    assert np.allclose(upright(image, np.eye(3)), image, atol=1e-3)
