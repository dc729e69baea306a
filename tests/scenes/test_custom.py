"""Scenes set in a file of one's own: GLB, USD and .blend, read back from independent writers."""

import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdShade

from multilight.datagen.cli import main
from multilight.datagen.config.dataset import DatasetConfig, load_config
from multilight.datagen.errors import UserError
from multilight.datagen.production.library import open_library
from multilight.datagen.production.scene import sample_scene
from multilight.lights.rigs.custom import custom_lights
from multilight.lights.spec import AreaLight, EmissiveLight, EnvironmentLight, Light, PointLight, SpotLight, SunLight
from multilight.scenes.assets.formats.ies import ies_text, profile_flux
from multilight.scenes.assets.formats.import_file import Intake
from multilight.scenes.assets.library import AssetError, AssetLibrary
from multilight.scenes.colour import LUMINOUS_EFFICACY
from multilight.scenes.geometry.contact import check_contacts
from multilight.scenes.kinds.custom import background_bodies, find_places, sample_custom
from multilight.scenes.poses import matrix4
from multilight.scenes.random_streams import Streams
from multilight.scenes.spec import Camera, SceneSpec
from multilight.scenes.still_life.sample import StillLifeSettings
from tests.scenes.custom_scenes import DEPTH, HEIGHT, LENGTH, TABLE, blender, room, write_glb

NIT = 1 / LUMINOUS_EFFICACY


def library_of(file: Path, cache: Path | None = None) -> AssetLibrary:
    return AssetLibrary(cache, packs=("builtin",), background=file)


def plain_scene(library: AssetLibrary) -> SceneSpec:
    """The background alone, as the file has it."""
    camera = Camera(width=8, height=8, fx=8, fy=8, cx=4, cy=4, c2w=matrix4(np.eye(4)))
    return SceneSpec(kind="custom", index=0, bodies=background_bodies(library), cameras=(camera,))


def lights_of(file: Path, cache: Path) -> dict[str, Light]:
    library = library_of(file, cache)
    return {light.name: light for light in custom_lights(plain_scene(library), library)}


def extent(library: AssetLibrary, body: str) -> np.ndarray:
    found = plain_scene(library).body(body)
    vertices = library.mesh(found.geometry.asset).vertices().astype(float)
    moved = vertices + np.array(found.world_from_body)[:3, 3]
    return np.array([moved.min(axis=0), moved.max(axis=0)])


@pytest.fixture(scope="module")
def glb(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_glb(tmp_path_factory.mktemp("glb") / "room.glb", room())


@pytest.fixture(scope="module")
def library(glb: Path) -> AssetLibrary:
    return library_of(glb)


def test_a_glb_stands_in_metres_with_z_up(library: AssetLibrary) -> None:
    assert extent(library, "bg_floor") == pytest.approx(
        np.array([[-LENGTH / 2, -DEPTH / 2, 0], [LENGTH / 2, DEPTH / 2, 0]]), abs=1e-5
    )
    assert extent(library, "bg_ceiling")[:, 2] == pytest.approx([HEIGHT, HEIGHT], abs=1e-5)
    assert extent(library, "bg_table")[1] == pytest.approx([0.6 + 0.7, 0.5 + 0.4, TABLE[2]], abs=1e-5)


def test_packed_maps_are_split(library: AssetLibrary) -> None:
    (material,) = plain_scene(library).body("bg_table").materials
    assert (material.roughness, material.metallic) == pytest.approx((153 / 255, 0.0), abs=1e-5)
    assert material.roughness_texture is None, "it is the same everywhere"
    assert material.base_color_texture is not None
    with Image.open(library.texture_path(material.base_color_texture.image)) as picture:
        assert tuple(np.asarray(picture)[0, 0]) == (150, 110, 70)


def test_punctual_lights_have_their_closed_form(glb: Path, tmp_path: Path) -> None:
    lights = lights_of(glb, tmp_path)
    bulb, spot, sun, lamp = (lights[name] for name in ("bulb", "spot", "sun", "bg_lamp"))
    assert isinstance(bulb, PointLight)
    assert bulb.intensity == pytest.approx((1.0, 0.5, 0.25))
    assert bulb.position == pytest.approx((0.5, 1.0, 2.3))
    assert isinstance(spot, SpotLight)
    assert spot.intensity == pytest.approx((2.0, 2.0, 2.0))
    assert spot.direction == pytest.approx((0, 0, -1), abs=1e-6)
    assert spot.half_angle == pytest.approx(0.6)
    edge, inner = math.cos(0.6), math.cos(0.3)
    assert spot.blend == pytest.approx((inner - edge) / (1 - edge))
    assert isinstance(sun, SunLight)
    assert sun.irradiance == pytest.approx((10.0, 10.0, 10.0))
    assert sun.direction == pytest.approx((0, 0, -1), abs=1e-6)
    assert isinstance(lamp, EmissiveLight)
    assert lamp.body == "bg_lamp"
    assert lamp.radiance == pytest.approx((200 * NIT, 100 * NIT, 50 * NIT), rel=1e-2)


def test_lights_turn_with_the_scene(library: AssetLibrary) -> None:
    scene = plain_scene(library)
    turn = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    bodies = tuple(
        b.model_copy(update={"world_from_body": matrix4(turn @ np.array(b.world_from_body))}) for b in scene.bodies
    )
    moved = custom_lights(scene.model_copy(update={"bodies": bodies}), library)
    bulb = next(light for light in moved if light.name == "bulb")
    assert isinstance(bulb, PointLight)
    assert bulb.position == pytest.approx((-1.0, 0.5, 2.3))


def test_surfaces_are_found_by_level_and_area(library: AssetLibrary) -> None:
    places = {round(place.surface.height, 2): place for place in find_places(background_bodies(library), library)}
    assert set(places) == {0.0, 0.75, 0.8}
    assert places[0.75].surface.area == pytest.approx(TABLE[0] * TABLE[1], rel=0.05)
    # The floor is free but for the cupboard's and the legs' feet.
    assert places[0.0].surface.area == pytest.approx(LENGTH * DEPTH - 0.45 * 1.2, rel=0.03)
    assert not places[0.0].surface.supports(np.array([[-2.3, -0.5], [-2.2, -0.5], [-2.2, -0.3]]))
    # The cupboard stands against the west side, which is open in this room; the table is open all round.
    assert places[0.75].opening == pytest.approx(np.pi)


def test_objects_stand_in_the_room_and_cameras_see_them(library: AssetLibrary) -> None:
    for index in range(3):
        settings = StillLifeSettings(width=64, height=64, views=3, objects=(3, 4), insertable=2)
        scene = sample_custom(Streams(5, index), library, index=index, settings=settings)
        assert scene.kind == "custom"
        assert len(scene.insertable) == 2
        found = check_contacts(scene.bodies, library)
        objects = {body.name for body in scene.bodies if body.role == "object"}
        assert not [o for o in found.overlaps if {o.first, o.second} & objects], found.overlaps
        turn = np.array(scene.body("bg_floor").world_from_body)
        for camera in scene.cameras:
            x, y, z = np.linalg.inv(turn)[:3] @ [*camera.pose()[:3, 3], 1]
            assert abs(y) < DEPTH / 2
            assert 0 < z < HEIGHT
            assert abs(x) < 20


def test_a_scene_is_the_same_again_in_another_cache(glb: Path, library: AssetLibrary, tmp_path: Path) -> None:
    settings = StillLifeSettings(width=64, height=64, views=2)
    scene = sample_custom(Streams(5, 1), library, index=1, settings=settings)
    again = sample_custom(Streams(5, 1), library_of(glb, tmp_path), index=1, settings=settings)
    assert scene.sha256() == again.sha256()


def test_the_rig_holds_the_files_lights(glb: Path) -> None:
    config = DatasetConfig(kind="custom", background=glb, views=2, width=64, height=64)
    scene, rig = sample_scene(config, open_library(config), Streams(3, 0))
    assert {"bulb", "spot", "sun", "bg_lamp"} <= set(rig.names)
    assert scene.kind == "custom"


def refused(file: Path, cache: Path) -> str:
    """Return the one line with which a file is refused."""

    def serve() -> None:
        library = library_of(file, cache)
        find_places(background_bodies(library), library)

    with pytest.raises(AssetError) as caught:
        serve()
    message = str(caught.value)
    assert str(file) in message
    assert "\n" not in message
    return message


def test_what_cannot_serve_is_refused_in_one_line(tmp_path: Path) -> None:
    assert "does not exist" in refused(tmp_path / "nothing.glb", tmp_path)
    text = tmp_path / "scene.txt"
    text.write_text("v 0 0 0")
    assert "not one of .glb" in refused(text, tmp_path)
    whole = write_glb(tmp_path / "whole.glb", room())
    (tmp_path / "broken.glb").write_bytes(b"glTF" + b"\0" * 30)
    (tmp_path / "cut.glb").write_bytes(whole.read_bytes()[:2000])
    write_glb(tmp_path / "huge.glb", room(scale=1000))
    write_glb(tmp_path / "tiny.glb", room(scale=0.001))
    write_glb(tmp_path / "basis.glb", room(), extensionsRequired=["KHR_texture_basisu"])
    write_glb(tmp_path / "away.glb", room(), images=[{"uri": "../../etc/passwd"}])
    said = {
        "broken": "export it again", "cut": "export it again", "huge": "5000 m large", "tiny": "in metres",
        "basis": "without compression", "away": "put the file into the folder",
    }  # fmt: skip
    Intake(tmp_path).convert((tmp_path / f"{name}.glb", tmp_path) for name in said)  # in one process
    for name, why in said.items():
        assert why in refused(tmp_path / f"{name}.glb", tmp_path)


def test_a_missing_texture_is_named(tmp_path: Path) -> None:
    files = room().export(file_type="gltf")
    for name, data in files.items():
        (tmp_path / ("room.gltf" if name.endswith(".gltf") else name)).write_bytes(data)
    file = tmp_path / "room.gltf"
    header = json.loads(file.read_text())
    header["images"][0] = {"uri": "oak.png"}
    file.write_text(json.dumps(header))
    assert "the picture 'oak.png' is missing" in refused(file, tmp_path / "cache")


def test_no_mesh_and_no_surface_are_said(tmp_path: Path) -> None:
    lamp = room(table=False)
    lamp.delete_geometry(["Floor", "Ceiling"])
    assert "no usable surface" in refused(write_glb(tmp_path / "walls.glb", lamp), tmp_path)
    stage = Usd.Stage.CreateNew(str(tmp_path / "empty.usda"))
    UsdGeom.Xform.Define(stage, "/world")
    stage.Save()
    assert "holds no triangles" in refused(tmp_path / "empty.usda", tmp_path)


def test_custom_and_background_go_together(glb: Path, capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    with pytest.raises(UserError, match="--background"):
        load_config(None, {"kind": "custom"})
    with pytest.raises(UserError, match="--kind custom"):
        load_config(None, {"background": glb})
    command = ["dataset", "--out", str(tmp_path / "out"), "--kind", "custom", "--background", str(tmp_path / "no.glb")]
    assert main(command) == 1
    assert "no.glb does not exist" in capfd.readouterr().err


def usd_room(path: Path, *, up: str = "Z", unit: float = 0.01) -> Any:
    """Write a floor, a table of 1.4 x 0.8 x 0.75 m and a textured picture with pxr, in centimetres."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, unit)
    world = UsdGeom.Xform.Define(stage, "/world")
    if up == "Y":
        world.AddRotateXOp().Set(-90.0)
    floor = UsdGeom.Mesh.Define(stage, "/world/floor")
    floor.CreatePointsAttr([Gf.Vec3f(*p) for p in ((-250, -200, 0), (250, -200, 0), (250, 200, 0), (-250, 200, 0))])
    floor.CreateFaceVertexCountsAttr([4])
    floor.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    UsdGeom.PrimvarsAPI(floor).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "vertex").Set(
        [Gf.Vec2f(*v) for v in ((0, 0), (1, 0), (1, 1), (0, 1))]
    )
    table = UsdGeom.Cube.Define(stage, "/world/table")
    table.CreateSizeAttr(1.0)
    table.AddTranslateOp().Set((60, 50, 37.5))
    table.AddScaleOp().Set(Gf.Vec3f(140, 80, 75))
    hidden = UsdGeom.Cube.Define(stage, "/world/hidden")
    hidden.CreateSizeAttr(9000.0)
    hidden.MakeInvisible()
    material = UsdShade.Material.Define(stage, "/looks/oak")
    shader = UsdShade.Shader.Define(stage, "/looks/oak/surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.3)
    shader.CreateInput("ior", Sdf.ValueTypeNames.Float).Set(1.4)
    picture = UsdShade.Shader.Define(stage, "/looks/oak/picture")
    picture.CreateIdAttr("UsdUVTexture")
    picture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set("./oak.png")
    shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(
        picture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
    )
    material.CreateSurfaceOutput().ConnectToSource(shader.CreateOutput("surface", Sdf.ValueTypeNames.Token))
    UsdShade.MaterialBindingAPI.Apply(floor.GetPrim()).Bind(material)
    Image.new("RGB", (4, 4), (10, 200, 30)).save(path.parent / "oak.png")
    return stage


@pytest.mark.parametrize("up", ["Z", "Y"])
def test_usd_is_read_in_metres_with_z_up(tmp_path: Path, up: str) -> None:
    usd_room(tmp_path / "room.usda", up=up).Save()
    library = library_of(tmp_path / "room.usda", tmp_path / "cache")
    assert {body.name for body in background_bodies(library)} == {"bg_floor", "bg_table"}
    assert extent(library, "bg_table") == pytest.approx(np.array([[-0.1, 0.1, 0], [1.3, 0.9, 0.75]]), abs=1e-5)
    assert extent(library, "bg_floor")[1] == pytest.approx([2.5, 2.0, 0.0], abs=1e-5)
    (material,) = plain_scene(library).body("bg_floor").materials
    assert (material.roughness, material.ior) == pytest.approx((0.3, 1.4))
    assert material.base_color_texture is not None
    with Image.open(library.texture_path(material.base_color_texture.image)) as picture:
        assert np.asarray(picture)[0, 0].tolist() == [10, 200, 30]
    assert {round(p.surface.height, 2) for p in find_places(background_bodies(library), library)} == {0.0, 0.75}


def test_usd_lights_have_their_closed_form(tmp_path: Path) -> None:
    stage = usd_room(tmp_path / "room.usda")
    ball = UsdLux.SphereLight.Define(stage, "/world/ball")
    ball.CreateRadiusAttr(10.0)
    ball.CreateIntensityAttr(1000.0)
    ball.CreateExposureAttr(1.0)
    ball.CreateColorAttr(Gf.Vec3f(1, 0.5, 0.25))
    ball.AddTranslateOp().Set((0, 0, 230))
    steady = UsdLux.SphereLight.Define(stage, "/world/steady")
    steady.CreateRadiusAttr(7.0)
    steady.CreateIntensityAttr(400.0)
    steady.CreateNormalizeAttr(True)
    cone = UsdLux.SphereLight.Define(stage, "/world/cone")
    cone.CreateIntensityAttr(1000.0)
    UsdLux.ShapingAPI.Apply(cone.GetPrim()).CreateShapingConeAngleAttr(30.0)
    for name, normalized in (("lantern", False), ("globe", True)):
        shaded = UsdLux.SphereLight.Define(stage, f"/world/{name}")
        shaded.CreateRadiusAttr(7.0)
        shaded.CreateIntensityAttr(400.0)
        shaded.CreateNormalizeAttr(True)
        shaded.AddRotateXOp().Set(90.0)
        shaping = UsdLux.ShapingAPI.Apply(shaded.GetPrim())
        shaping.CreateShapingIesFileAttr("./lamp.ies")
        shaping.CreateShapingIesNormalizeAttr(normalized)
    (tmp_path / "lamp.ies").write_text(ies_text([0, 90, 180], [0], [[3.0, 3.0, 0.0]]))
    panel = UsdLux.RectLight.Define(stage, "/world/panel")
    panel.CreateWidthAttr(100.0)
    panel.CreateHeightAttr(50.0)
    panel.CreateIntensityAttr(1790.0)
    even = UsdLux.RectLight.Define(stage, "/world/even")
    even.CreateWidthAttr(200.0)
    even.CreateHeightAttr(50.0)
    even.CreateIntensityAttr(1790.0)
    even.CreateNormalizeAttr(True)
    sun = UsdLux.DistantLight.Define(stage, "/world/sun")
    sun.CreateIntensityAttr(50000.0)
    sun.CreateAngleAttr(2.0)
    sky = UsdLux.DomeLight.Define(stage, "/world/sky")
    sky.AddRotateXOp().Set(90.0)
    sky.CreateIntensityAttr(179.0)
    sky.CreateTextureFileAttr("./sky.png")
    picture = Image.new("RGB", (8, 4), (255, 255, 255))
    picture.putpixel((0, 0), (0, 0, 0))  # of one colour it would be no map
    picture.save(tmp_path / "sky.png")
    tube = UsdLux.CylinderLight.Define(stage, "/world/tube")
    tube.CreateLengthAttr(100.0)
    tube.CreateRadiusAttr(2.0)
    tube.CreateIntensityAttr(1790.0)
    tube.CreateNormalizeAttr(True)
    stage.Save()
    found = lights_of(tmp_path / "room.usda", tmp_path / "cache")
    assert isinstance(found["bg_tube"], EmissiveLight)
    assert found["bg_tube"].radiance == pytest.approx((10.0 / (2 * math.pi * 0.02 * 1.0),) * 3)
    assert isinstance(found["ball"], PointLight)
    assert found["ball"].intensity == pytest.approx(np.array([1, 0.5, 0.25]) * 2000 * NIT * math.pi * 0.1**2)
    assert found["ball"].radius == pytest.approx(0.1)
    assert found["ball"].position == pytest.approx((0, 0, 2.3))
    assert isinstance(found["steady"], PointLight)
    # Flux pi * L * A = pi * intensity, over 4 pi sr, whatever the radius.
    assert found["steady"].intensity == pytest.approx((100 * NIT,) * 3)
    lantern, globe = found["lantern"], found["globe"]
    assert isinstance(lantern, PointLight)
    assert isinstance(globe, PointLight)
    assert lantern.intensity == pytest.approx((300 * NIT,) * 3), "candelas multiply the luminance"
    assert lantern.direction == pytest.approx((0, 1, 0))
    assert lantern.profile == globe.profile
    assert lantern.profile is not None
    assert (lantern.profile[60], lantern.profile[135]) == (1.0, 0.5)
    assert profile_flux(lantern.profile) * np.array(globe.intensity) == pytest.approx(4 * math.pi * 100 * NIT)
    assert isinstance(found["cone"], SpotLight)
    assert found["cone"].half_angle == pytest.approx(math.radians(30))
    assert found["cone"].direction == pytest.approx((0, 0, -1))
    assert isinstance(found["panel"], AreaLight)
    assert (found["panel"].width, found["panel"].height) == pytest.approx((1.0, 0.5))
    assert found["panel"].radiance == pytest.approx((10.0,) * 3)
    assert isinstance(found["even"], AreaLight)
    assert found["even"].radiance == pytest.approx((10.0 / (2.0 * 0.5),) * 3)
    assert isinstance(found["sun"], SunLight)
    assert found["sun"].irradiance == pytest.approx((50000 * NIT * math.pi * math.sin(math.radians(1)) ** 2,) * 3)
    assert found["sun"].angle == pytest.approx(math.radians(2))
    assert isinstance(found["sky"], EnvironmentLight)
    assert found["sky"].radiance == pytest.approx((1.0,) * 3)
    # Turned upright, the dome's middle (+Z of the dome) looks along -Y.
    assert found["sky"].rotation == pytest.approx(3 * math.pi / 2)
    assert found["sky"].map is not None
    assert library_of(tmp_path / "room.usda", tmp_path / "cache").environment_path(found["sky"].map).is_file()


def test_usd_that_cannot_serve_is_refused_in_one_line(tmp_path: Path) -> None:
    bad = tmp_path / "bad.usda"
    bad.write_text("#usda 1.0\nthis is no scene")
    assert "export it again" in refused(bad, tmp_path / "cache")
    stage = usd_room(tmp_path / "room.usda")
    (tmp_path / "oak.png").unlink()
    stage.Save()
    assert "'./oak.png', which is missing" in refused(tmp_path / "room.usda", tmp_path / "cache")


@pytest.mark.slow
def test_scripts_in_a_blend_file_never_run(tmp_path: Path) -> None:
    file, mark = tmp_path / "room.blend", tmp_path / "mark"
    blender(file, mark, "write")
    for path in tmp_path.glob("mark*"):
        path.unlink()
    # The scripts do run where they are allowed to: without that the test would show nothing.
    blender(file, mark, "open")
    assert {path.name for path in tmp_path.glob("mark*")} == {"mark.text", "mark.driver"}
    for path in tmp_path.glob("mark*"):
        path.unlink()
    library = library_of(file, tmp_path / "cache")
    assert {body.name for body in background_bodies(library)} == {"bg_floor", "bg_wall", "bg_table", "bg_lamp"}
    assert not list(tmp_path.glob("mark*"))
    assert extent(library, "bg_table") == pytest.approx(np.array([[-0.1, 0.1, 0], [1.3, 0.9, 0.75]]), abs=1e-4)
    _check_blend_lights(lights_of(file, tmp_path / "cache"))


def _check_blend_lights(lights: dict[str, Light]) -> None:
    """Hold the lights against Blender's own definitions of its watts."""
    assert isinstance(lights["bulb"], PointLight)
    assert lights["bulb"].intensity == pytest.approx(np.array([1, 0.5, 0.25]) * 20 / (4 * math.pi))
    assert lights["bulb"].radius == pytest.approx(0.05)
    assert lights["bulb"].position == pytest.approx((1, -1, 2))
    assert isinstance(lights["spot"], SpotLight)
    assert lights["spot"].intensity == pytest.approx((40 / (4 * math.pi),) * 3)
    assert (lights["spot"].half_angle, lights["spot"].blend) == pytest.approx((0.5, 0.3))
    assert isinstance(lights["panel"], AreaLight)
    assert lights["panel"].radiance == pytest.approx((60 / (math.pi * 0.4),) * 3)
    assert isinstance(lights["sun"], SunLight)
    assert lights["sun"].irradiance == pytest.approx((1.5,) * 3)
    assert lights["sun"].angle == pytest.approx(0.02)
    assert isinstance(lights["world"], EnvironmentLight)
    assert lights["world"].radiance == pytest.approx((0.05, 0.06, 0.1))
    assert isinstance(lights["bg_lamp"], EmissiveLight)
    assert lights["bg_lamp"].radiance == pytest.approx((12.0, 6.0, 3.0), rel=1e-3)


USES_A_PICTURE = """
import sys
from multilight.datagen.backends import blender
import bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
image = bpy.data.images.load(sys.argv[2])
image.use_fake_user = True
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1])
"""


@pytest.mark.slow
def test_a_blend_file_uses_nothing_outside_of_its_folder(tmp_path: Path) -> None:
    Image.new("RGB", (4, 4), "red").save(tmp_path / "secret.png")
    file = tmp_path / "set" / "room.blend"
    file.parent.mkdir()
    subprocess.run([sys.executable, "-c", USES_A_PICTURE, str(file), str(tmp_path / "secret.png")], check=True)
    with pytest.raises(AssetError, match="it uses a file outside"):
        background_bodies(library_of(file, tmp_path / "cache"))


@pytest.mark.slow
def test_a_broken_blend_file_is_refused_in_one_line(tmp_path: Path) -> None:
    file = tmp_path / "bad.blend"
    file.write_bytes(b"BLENDER-v405 and no more")
    with pytest.raises(AssetError, match="cannot be read") as caught:
        background_bodies(library_of(file, tmp_path / "cache"))
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)
