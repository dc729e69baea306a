"""USD stages: held against USD's own validators, closed forms read with plain `pxr`, Blender, and the way back."""

import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdLux, UsdShade

from multilight.datagen.cli import main
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.store import read_scene, scene_dir
from multilight.datagen.usd.read import StageScene, read_stage
from multilight.datagen.usd.stage import STAGE, write_stage
from multilight.datagen.usd.write import stage_faults
from multilight.lights.display.tonemap import to_display
from multilight.lights.spec import AreaLight, LightRig, PointLight, SpotLight
from multilight.scenes.assets.formats.ies import parse_ies
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.cameras.pinhole import project
from multilight.scenes.meshes import Mesh
from multilight.scenes.spec import MeshAsset
from tests.datagen.export import usd_scenes

EFFICACY = 179.0
NUMBERS = 1e-5
LIGHTS = "/world/lights"


@pytest.fixture(scope="module")
def library() -> AssetLibrary:
    return AssetLibrary(packs=("builtin",))


@pytest.fixture(scope="module")
def record(library: AssetLibrary) -> SceneRecord:
    return usd_scenes.record_of(usd_scenes.scene(library), usd_scenes.rig())


@pytest.fixture(scope="module")
def written(record: SceneRecord, library: AssetLibrary, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_stage(record, library, tmp_path_factory.mktemp("stage"))


@pytest.fixture
def stage(written: Path) -> Any:
    """The stage, to look at or to change in memory."""
    opened = Usd.Stage.Open(str(written))
    opened.SetEditTarget(opened.GetSessionLayer())
    return opened


def luminance(stage: Any, light: str) -> np.ndarray:
    """Colour times intensity as the stage says it."""
    lamp = UsdLux.LightAPI(stage.GetPrimAtPath(f"{LIGHTS}/{light}"))
    return np.array(lamp.GetColorAttr().Get()) * lamp.GetIntensityAttr().Get()


def matrix(stage: Any, path: str) -> np.ndarray:
    """World from prim, columns as mathematics has them."""
    return np.array(UsdGeom.XformCache().GetLocalToWorldTransform(stage.GetPrimAtPath(path))).T


def edited(written: Path, folder: Path, change: Any) -> Path:
    """Save a changed copy of the stage, its textures in place."""
    opened = Usd.Stage.Open(str(written))
    variants = opened.GetPrimAtPath("/world").GetVariantSet("lighting")
    with variants.GetVariantEditContext():
        change(opened)
    path = folder / STAGE
    opened.GetRootLayer().Export(str(path))
    shutil.copytree(written.parent / "textures", folder / "textures", dirs_exist_ok=True)
    opened.GetRootLayer().Reload(force=True)
    return path


def read(path: Path) -> StageScene:
    return read_stage(path, AssetLibrary(packs=("builtin",)))


def assert_close(found: Any, wanted: Any, where: str = "") -> None:
    """Compare two dumped specifications number by number, independently of the reader's own comparison."""
    if isinstance(wanted, dict):
        assert found.keys() == wanted.keys(), where
        for key in wanted:
            assert_close(found[key], wanted[key], f"{where}.{key}")
    elif isinstance(wanted, list | tuple):
        assert len(found) == len(wanted), where
        if where.endswith(".direction"):
            found, wanted = np.array(found) / np.linalg.norm(found), np.array(wanted) / np.linalg.norm(wanted)
        for number, (a, b) in enumerate(zip(found, wanted, strict=True)):
            assert_close(a, b, f"{where}[{number}]")
    elif isinstance(wanted, float):
        assert found == pytest.approx(wanted, rel=NUMBERS, abs=NUMBERS), where
    else:
        assert found == wanted, where


def test_usd_validators_pass_and_can_fail(written: Path, tmp_path: Path) -> None:
    assert stage_faults(written) == []

    def unbind(opened: Any) -> None:
        opened.GetPrimAtPath("/world/bodies/ball").RemoveAPI(UsdShade.MaterialBindingAPI)

    opened = Usd.Stage.Open(str(written))
    unbind(opened)
    opened.GetRootLayer().Export(str(tmp_path / STAGE))
    opened.GetRootLayer().Reload(force=True)
    faults = stage_faults(tmp_path / STAGE)
    assert any("MaterialBindingAPI" in fault and "/world/bodies/ball" in fault for fault in faults)


def test_the_stage_is_in_metres_with_z_up_and_names_its_makers(stage: Any) -> None:
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z
    (asset,) = stage.GetRootLayer().customLayerData["multilight"]["credits"].values()
    assert (asset["creator"], asset["licence"]) == ("somebody", "CC0")
    assert stage.GetPrimAtPath("/world/bodies/bulb").GetAssetInfo()["licence"] == "CC0"


def test_lights_carry_their_closed_forms(stage: Any, record: SceneRecord) -> None:
    rig = {light.name: light for light in record.rig.lights}
    sun: Any = rig["sun"]
    # Normalized, a distant light's intensity is the illuminance on a surface that faces it.
    assert stage.GetPrimAtPath(f"{LIGHTS}/sun").GetAttribute("inputs:normalize").Get()
    assert luminance(stage, "sun") / EFFICACY == pytest.approx(np.array(sun.irradiance), rel=NUMBERS)
    way = matrix(stage, f"{LIGHTS}/sun")[:3] @ [0, 0, -1, 0]
    assert way == pytest.approx(np.array(sun.direction) / np.linalg.norm(sun.direction))
    for name in ("point", "lamp", "spot"):
        light: Any = rig[name]
        prim = stage.GetPrimAtPath(f"{LIGHTS}/{name}")
        radius = prim.GetAttribute("inputs:radius").Get()
        level = luminance(stage, name)
        if prim.GetAttribute("inputs:normalize").Get():
            level = level / (4 * math.pi * radius**2)
        # A sphere of even luminance shows a disc of its radius to every side.
        assert level * math.pi * radius**2 / EFFICACY == pytest.approx(np.array(light.intensity), rel=NUMBERS)
        assert matrix(stage, f"{LIGHTS}/{name}")[:3, 3] == pytest.approx(light.position)
    for name in ("panel", "disk"):
        area: Any = rig[name]
        assert luminance(stage, name) / EFFICACY == pytest.approx(np.array(area.radiance), rel=NUMBERS)
    stretch = np.linalg.norm(matrix(stage, f"{LIGHTS}/disk")[:3, :2], axis=0)
    radius = stage.GetPrimAtPath(f"{LIGHTS}/disk").GetAttribute("inputs:radius").Get()
    assert 2 * radius * stretch == pytest.approx([0.3, 0.2])


def test_shaped_lights(stage: Any, record: SceneRecord) -> None:
    shaping = UsdLux.ShapingAPI(stage.GetPrimAtPath(f"{LIGHTS}/spot"))
    assert shaping.GetShapingConeAngleAttr().Get() == pytest.approx(math.degrees(0.4))
    assert shaping.GetShapingConeSoftnessAttr().Get() == pytest.approx(0.3)
    file = UsdLux.ShapingAPI(stage.GetPrimAtPath(f"{LIGHTS}/lamp")).GetShapingIesFileAttr().Get()
    (lamp,) = (light for light in record.rig.lights if light.name == "lamp")
    assert isinstance(lamp, PointLight)
    assert lamp.profile is not None
    found = parse_ies(Path(file.resolvedPath).read_text())
    assert found.candela == pytest.approx(1.0)
    assert found.profile == pytest.approx(lamp.profile, abs=NUMBERS)


def test_what_glows_has_its_luminance(stage: Any) -> None:
    (part,) = stage.GetPrimAtPath(f"{LIGHTS}/bulb_glow").GetRelationship("multilight:part").GetTargets()
    material = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath(part)).ComputeBoundMaterial()[0]
    colour = material.ComputeSurfaceSource()[0].GetInput("emissiveColor").Get()
    assert np.array(colour) / EFFICACY == pytest.approx([3.0, 2.0, 1.0], rel=NUMBERS)


def test_pictures_have_their_colour_spaces_and_lie_beside_the_stage(stage: Any, written: Path) -> None:
    spaces = {}
    for prim in stage.Traverse():
        if prim.IsA(UsdShade.Shader) and UsdShade.Shader(prim).GetIdAttr().Get() == "UsdUVTexture":
            node = UsdShade.Shader(prim)
            file = node.GetInput("file").Get()
            assert file.path.startswith("./textures/")
            assert Path(file.resolvedPath).parent == written.parent / "textures"
            spaces[prim.GetName()] = node.GetInput("sourceColorSpace").Get()
    assert spaces == {"diffuseColor_texture": "sRGB", "roughness_texture": "raw", "normal_texture": "raw"}


@pytest.mark.parametrize("number", [0, 1])
def test_cameras_project_as_the_specification_does(stage: Any, record: SceneRecord, number: int) -> None:
    camera = record.scene.cameras[number]
    made = UsdGeom.Camera(stage.GetPrimAtPath(f"/world/cameras/view_{number:02d}"))
    frustum = made.GetCamera(Usd.TimeCode.Default()).frustum
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (20, 3))
    wanted, depth = project(camera, points)
    assert (depth > 0).all()
    # Gf's perspective follows OpenGL: rows, from -1 to 1, up.
    clip = frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()
    ndc = np.array([clip.Transform(Gf.Vec3d(*p.tolist())) for p in points])
    pixels = np.stack([(ndc[:, 0] + 1) / 2 * camera.width, (1 - ndc[:, 1]) / 2 * camera.height], axis=1)
    assert pixels == pytest.approx(wanted, abs=1e-3)
    stop, focal = made.GetFStopAttr().Get(), made.GetFocalLengthAttr().Get()
    assert (focal / 10 / (2 * stop) if stop else 0.0) == pytest.approx(camera.aperture_radius)
    assert made.GetFocusDistanceAttr().Get() == pytest.approx(camera.focus_distance)
    # Luminance times the camera's own exposure is the radiance that datasets hold.
    assert made.ComputeLinearExposureScale() == pytest.approx(1 / EFFICACY)


def test_each_lighting_is_a_variant(stage: Any, record: SceneRecord) -> None:
    variants = stage.GetPrimAtPath("/world").GetVariantSet("lighting")
    assert set(variants.GetVariantNames()) == {"rig", "all", "dim"}
    assert variants.GetVariantSelection() == "rig"
    names = [light.name for light in record.rig.lights if light.kind != "emissive"]
    plain = {name: luminance(stage, name) for name in names}
    for condition in record.conditions:
        variants.SetVariantSelection(condition.name)
        for name in names:
            gain = np.array(condition.gains.get(name, (0, 0, 0))) * 2.0**condition.exposure_ev
            assert luminance(stage, name) == pytest.approx(plain[name] * gain, rel=NUMBERS)


def test_the_way_back_is_exact(written: Path, record: SceneRecord) -> None:
    found = read(written)
    assert found.as_written
    assert found.scene.sha256() == record.scene_sha256
    assert found.rig.sha256() == record.rig_sha256


def test_the_way_back_needs_no_metadata(written: Path, record: SceneRecord, tmp_path: Path) -> None:
    """All numbers come from meshes, materials, lights and cameras."""

    def strip(opened: Any) -> None:
        layer = opened.GetRootLayer()
        said = layer.customLayerData
        said["multilight"] = {k: said["multilight"][k] for k in ("schema", "kind", "index", "emissiveColor")}
        layer.customLayerData = said

    found = read(edited(written, tmp_path, strip))
    assert not found.as_written
    assert_close(found.scene.model_dump(), record.scene.model_dump())
    assert_close(found.rig.model_dump(), record.rig.model_dump())


def test_what_was_edited_counts(written: Path, record: SceneRecord, tmp_path: Path) -> None:
    def edit(opened: Any) -> None:
        spot = UsdLux.LightAPI(opened.GetPrimAtPath(f"{LIGHTS}/spot"))
        spot.GetIntensityAttr().Set(spot.GetIntensityAttr().Get() * 2)
        opened.SetEditTarget(opened.GetRootLayer())
        UsdGeom.Xformable(opened.GetPrimAtPath("/world/bodies/ball")).AddTranslateOp().Set((0, 0, 0.5))

    found = read(edited(written, tmp_path, edit))
    assert not found.as_written
    spot, before = (r.lights[r.names.index("spot")] for r in (found.rig, record.rig))
    assert isinstance(spot, SpotLight)
    assert isinstance(before, SpotLight)
    assert spot.intensity == pytest.approx(np.array(before.intensity) * 2)
    lifted, low = (np.array(s.body("ball").world_from_body) for s in (found.scene, record.scene))
    assert lifted[2, 3] == pytest.approx(low[2, 3] + 0.5)
    others = [b.model_dump() for b in found.scene.bodies if b.name != "ball"]
    assert_close(others, [b.model_dump() for b in record.scene.bodies if b.name != "ball"])


def test_changed_triangles_come_from_the_stage(written: Path, record: SceneRecord, tmp_path: Path) -> None:
    def stretch(opened: Any) -> None:
        opened.SetEditTarget(opened.GetRootLayer())
        points = UsdGeom.Mesh(opened.GetPrimAtPath("/world/bodies/bulb")).GetPointsAttr()
        points.Set([Gf.Vec3f(x, y, 2 * z) for x, y, z in points.Get()])

    path = edited(written, tmp_path, stretch)
    library = AssetLibrary(packs=("builtin",), background=path)
    found = read_stage(path, library)
    body, before = found.scene.body("bulb"), record.scene.body("bulb")
    assert isinstance(body.geometry, MeshAsset)
    assert isinstance(before.geometry, MeshAsset)
    assert body.insertable
    assert body.geometry.asset == "background/bg_bulb"
    heights = [
        np.array(b.world_from_body)[2, 2] * np.ptp(library.mesh(b.geometry.asset).bounds()[:, 2])
        for b in (body, before)
    ]
    assert heights[0] == pytest.approx(2 * heights[1], rel=1e-4)
    assert_close(found.rig.model_dump(), record.rig.model_dump())


def test_a_background_reader_sees_the_same(written: Path, tmp_path: Path) -> None:
    """`--kind custom --background STAGE` knows nothing of the project's own words for lights."""
    library = AssetLibrary(packs=("builtin",), background=written)
    assert library.background is not None
    lights = {light.name: light for light in library.background.lights}
    assert np.array(lights["bg_bulb"].amount) / EFFICACY == pytest.approx([3.0, 2.0, 1.0], rel=NUMBERS)
    mesh = library.mesh("background/bg_floor")
    assert isinstance(mesh, Mesh)
    assert mesh.parts[0].material.base_color == pytest.approx((0.9, 0.7, 0.5))
    assert mesh.parts[0].material.roughness == pytest.approx(0.8)


def test_a_foreign_stage_is_refused_in_one_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    Usd.Stage.CreateNew(str(tmp_path / "other.usda")).Save()
    assert main(["import", "usd", str(tmp_path / "other.usda"), "--out", str(tmp_path / "out")]) == 1
    said = capfd.readouterr().err
    assert "was not written by `multilight export usd`" in said
    assert "--kind custom --background" in said


def test_exported_and_imported_a_dataset_is_the_same_to_the_last_byte(spheres_dataset: Path, tmp_path: Path) -> None:
    assert main(["export", "usd", str(spheres_dataset), "--out", str(tmp_path / "usd"), "--scene", "1"]) == 0
    path = tmp_path / "usd" / "scene_000001" / STAGE
    arguments = ["--out", str(tmp_path / "back"), "--renderer", "analytic", "--spp", "4"]
    assert main(["import", "usd", str(path), *arguments]) == 0
    before, after = read_scene(scene_dir(spheres_dataset, 1)), read_scene(scene_dir(tmp_path / "back", 0))
    assert (after.scene, after.rig) == (before.scene, before.rig)
    assert [view.file_sha256 for view in after.views] == [view.file_sha256 for view in before.views]


@pytest.mark.slow
def test_blender_renders_the_stage_as_the_original(library: AssetLibrary, tmp_path: Path) -> None:
    """Without what neither UsdPreviewSurface nor Blender's reader knows: clear surfaces, gobos, luminaires."""
    from multilight.datagen.backends.blender import BlenderBackend
    from multilight.datagen.backends.protocol import RenderJob, RenderSettings

    spec = usd_scenes.scene(library)
    spec = spec.model_copy(update={"bodies": tuple(b for b in spec.bodies if b.name not in ("pane", "veil"))})
    plain = {"gobo": None, "profile": None}
    lit = LightRig(
        lights=tuple(
            light.model_copy(update={k: v for k, v in plain.items() if hasattr(light, k)})
            for light in usd_scenes.rig().lights
        )
    )
    assert any(isinstance(light, AreaLight) for light in lit.lights)
    path = write_stage(usd_scenes.record_of(spec, lit), library, tmp_path)
    with BlenderBackend(library) as backend:
        ours = backend.render(RenderJob(spec, lit, RenderSettings(spp=256, threads=2), 0)).combined
    theirs = usd_scenes.blender_render(path, "view_00", size=64, spp=256) / EFFICACY
    assert theirs.mean((0, 1)) == pytest.approx(ours.mean((0, 1)), rel=0.02)
    shown = [to_display(picture).astype(float) for picture in (theirs, ours)]
    assert 10 * np.log10(255**2 / np.mean((shown[0] - shown[1]) ** 2)) > 30
