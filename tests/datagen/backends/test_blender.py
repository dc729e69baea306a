"""Cycles against closed forms: every light's radiometry, the camera, the buffers, the variants."""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from multilight.datagen.backends.blender import BlenderBackend
from multilight.datagen.backends.protocol import BackendError, RenderJob, RenderSettings
from multilight.datagen.storage.layers import GeometryBuffers, LayerStack
from multilight.lights.spec import (
    AreaLight,
    EmissiveLight,
    EnvironmentLight,
    Light,
    LightRig,
    PointLight,
    SpotLight,
    SunLight,
)
from multilight.scenes.arrays import Float32
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.cameras.pinhole import matrix4
from multilight.scenes.frozen import Matrix4
from multilight.scenes.meshes import Mesh, MeshPart
from multilight.scenes.spec import Body, Camera, Material, MeshAsset, Rectangle, SceneSpec, Sphere, Texture
from tests.datagen.backends.calibration_scenes import LIGHTS, SURFACES, calibration_job

# An IOR of 1 switches the Principled BSDF's specular lobe off: what is left is exactly Lambertian.
WHITE = Material(base_color=(1, 1, 1), ior=1.0)
GREY = Material(base_color=(0.5, 0.5, 0.5), ior=1.0)
ENV = EnvironmentLight(name="env")


class FakeLibrary:
    """Two textures, an environment map with one bright spot and a two-part mesh, made in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        # Left half opaque red, right half see-through green.
        pixels = np.zeros((4, 64, 4), np.uint8)
        pixels[:, :32], pixels[:, 32:] = (188, 0, 0, 255), (0, 188, 0, 0)
        Image.fromarray(pixels).save(folder / "halves.png")
        (folder / "broken.png").write_bytes(b"not a picture")
        sky = np.zeros((32, 64, 3), np.float32)
        sky[15:17, 47:49] = (100.0, 50.0, 25.0)  # u = 3/4: phi = -pi/2 at rotation 0, on the horizon
        OpenEXR.File({"compression": OpenEXR.NO_COMPRESSION}, {"RGB": sky}).write(str(folder / "spot.exr"))

    def texture_path(self, image: str) -> Path:
        return self.folder / f"{image}.png"

    def environment_path(self, environment: str) -> Path:
        return self.folder / f"{environment}.exr"

    def mesh(self, asset: str) -> Mesh:
        """Two upright unit squares side by side, facing -Y, their normals tilted up in the second."""
        parts = []
        for x, normal in ((-1.0, (0, -1, 0)), (0.0, (0, -math.sqrt(0.5), math.sqrt(0.5)))):
            corners = np.array([[x, 0, 0], [x + 1, 0, 0], [x + 1, 0, 1], [x, 0, 1]], np.float32)
            faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
            normals = np.tile(np.array(normal, np.float32), (4, 1))
            uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
            parts.append(MeshPart("square", corners, faces, normals, uv, Material()))
        return Mesh(tuple(parts))


@pytest.fixture(scope="module")
def blender(tmp_path_factory: pytest.TempPathFactory) -> Iterator[BlenderBackend]:
    with BlenderBackend(FakeLibrary(tmp_path_factory.mktemp("assets"))) as backend:  # type: ignore[arg-type]
        yield backend


def at(x: float, y: float, z: float) -> Matrix4:
    return ((1, 0, 0, x), (0, 1, 0, y), (0, 0, 1, z), (0, 0, 0, 1))


def look(eye: tuple[float, float, float], target: tuple[float, float, float] = (0, 0, 0)) -> Matrix4:
    """Return the pose at `eye` that looks along -Z to `target`."""
    back = np.subtract(eye, target) / np.linalg.norm(np.subtract(eye, target))
    right = np.cross((0, 0, 1), back)
    right /= np.linalg.norm(right)
    rows = np.column_stack([right, np.cross(back, right), back, eye])
    return matrix4([*rows, (0, 0, 0, 1)])


def camera(pose: Matrix4, size: int = 16, focal: float = 16) -> Camera:
    return Camera(width=size, height=size, fx=focal, fy=focal, cx=size / 2, cy=size / 2, c2w=pose)


def body(name: str, geometry: object, *materials: Material, pose: Matrix4, insertable: bool = False) -> Body:
    return Body(
        name=name,
        role="object",
        category="test",
        geometry=geometry,
        materials=materials,
        world_from_body=pose,
        insertable=insertable,
    )


def floor(material: Material = WHITE, size: float = 4) -> Body:
    return body("floor", Rectangle(width=size, height=size), material, pose=at(0, 0, 0))


def scene(bodies: tuple[Body, ...], *cameras: Camera) -> SceneSpec:
    return SceneSpec(kind="spheres", index=0, bodies=bodies, cameras=cameras)


def render(
    backend: BlenderBackend, spec: SceneSpec, lights: tuple[Light, ...], *, spp: int = 16, variant: str = "all"
) -> LayerStack:
    settings = RenderSettings(spp=spp, threads=2)
    return backend.render(RenderJob(spec, LightRig(lights=lights), settings, 0, variant))


def geometry_of(stack: LayerStack) -> GeometryBuffers:
    assert stack.geometry is not None
    return stack.geometry


def centre(layer: Float32) -> Float32:
    middle = layer.shape[0] // 2
    return layer[middle - 1 : middle + 1, middle - 1 : middle + 1].mean(axis=(0, 1))


# Looks straight down, far enough that the centre pixels see a point.
DOWN = camera(at(0, 0, 5), focal=400)
SPOT = {"position": (0, 0, 2), "direction": (0, 0, -1), "half_angle": 0.5}
SMALL = {"world_from_light": at(0, 0, 2), "width": 0.1, "height": 0.05}
ON_A_WHITE_FLOOR = [
    (SunLight(name="a", direction=(0, 0, -2), irradiance=(1, 2, 3)), (1 / math.pi, 2 / math.pi, 3 / math.pi)),
    (SunLight(name="a", direction=(1, 0, -1), irradiance=(1, 1, 1)), math.cos(math.pi / 4) / math.pi),
    (SunLight(name="a", direction=(0, 0, 1), irradiance=(1, 1, 1)), 0),
    (PointLight(name="a", position=(0, 0, 2), intensity=(1, 2, 3)), np.array([1, 2, 3]) / 4 / math.pi),
    (PointLight(name="a", position=(1, 0, 1), intensity=(8, 8, 8)), 8 * math.sqrt(0.5) / 2 / math.pi),
    (PointLight(name="a", position=(0, 0, 2), intensity=(1, 1, 1), radius=0.05), 1 / 4 / math.pi),
    (SpotLight(name="a", intensity=(1, 2, 3), **SPOT), np.array([1, 2, 3]) / 4 / math.pi),
    (SpotLight(name="a", intensity=(1, 1, 1), radius=0.05, **SPOT), 1 / 4 / math.pi),
    (SpotLight(name="a", intensity=(1, 1, 1), **SPOT | {"position": (1.2, 0, 2)}), 0),
    (AreaLight(name="a", radiance=(9, 6, 3), **SMALL), np.array([9, 6, 3]) * 0.005 / 4 / math.pi),
    (AreaLight(name="a", shape="disk", radiance=(8, 8, 8), **SMALL), 8 * 0.005 / 16),
    (
        AreaLight(name="a", radiance=(8, 8, 8), width=0.1, height=0.1, world_from_light=look((1, 0, 1))),
        8 * 0.01 * math.sqrt(0.5) / 2 / math.pi,
    ),
    (EnvironmentLight(name="a", radiance=(1, 2, 3)), (1, 2, 3)),
]


@pytest.mark.parametrize(("light", "expected"), ON_A_WHITE_FLOOR, ids=lambda value: getattr(value, "kind", ""))
def test_a_light_on_a_white_floor(blender: BlenderBackend, light: Light, expected: float | np.ndarray) -> None:
    stack = render(blender, scene((floor(),), DOWN), (light,), spp=64)
    np.testing.assert_allclose(centre(stack.radiance[0]), np.broadcast_to(expected, 3), rtol=0.005, atol=1e-6)


def test_lights_are_one_sided_and_unseen_by_the_camera(blender: BlenderBackend) -> None:
    facing_up = ((1, 0, 0, 0), (0, -1, 0, 0), (0, 0, -1, 2), (0, 0, 0, 1))
    area = AreaLight(name="area", radiance=(9, 9, 9), width=1, height=1, world_from_light=facing_up)
    point = PointLight(name="point", position=(0, 0, 3), intensity=(1, 1, 1), radius=0.5)
    stack = render(blender, scene((floor(GREY),), DOWN), (area, point))
    assert centre(stack.radiance[0]).max() == 0
    # The camera looks straight through the point's sphere at the floor it lights.
    np.testing.assert_allclose(centre(stack.radiance[1]), 0.5 / 9 / math.pi, rtol=0.03)


def test_a_spot_falls_off_by_smoothstep(blender: BlenderBackend) -> None:
    """Smoothstep from the cone's edge over the share `blend` of what lies between its cosine and one."""
    blend, half = 0.6, 0.5
    light = SpotLight(
        name="a", position=(0, 0, 2), direction=(0, 0, -1), intensity=(1, 1, 1), half_angle=half, blend=blend
    )
    view = camera(at(0, 0, 5), size=64, focal=64 * 5 / 3)
    layer = render(blender, scene((floor(),), view), (light,), spp=64).radiance[0, 31:33, :, 0].mean(axis=0)
    x = (np.arange(64) + 0.5 - 32) * 3 / 64
    cosine = 2 / np.hypot(x, 2)
    t = np.clip((cosine - math.cos(half)) / ((1 - math.cos(half)) * blend), 0, 1)
    expected = t * t * (3 - 2 * t) * cosine**3 / 4 / math.pi
    np.testing.assert_allclose(layer, expected, atol=2e-4)


@pytest.mark.parametrize("rotation", [0.0, math.pi / 2])
def test_the_environment_turns_as_its_formula_says(blender: BlenderBackend, rotation: float) -> None:
    light = EnvironmentLight(name="env", map="spot", radiance=(1, 1, 2), rotation=rotation)
    ball = body("ball", Sphere(radius=1), WHITE, pose=at(0, 0, 0))
    view = camera(at(0, 0, 5), size=32, focal=60)
    stack = render(blender, scene((ball,), view), (light,), spp=64)
    weight = stack.radiance[0].sum(axis=-1, keepdims=True)
    brightest = (geometry_of(stack).normal_world * weight).sum(axis=(0, 1))[:2]
    phi = -math.pi / 2 + rotation
    np.testing.assert_allclose(brightest / np.linalg.norm(brightest), [math.cos(phi), math.sin(phi)], atol=0.02)
    # The map's colour times the light's.
    np.testing.assert_allclose(weight_ratio(stack.radiance[0]), [1, 0.5, 0.5], rtol=1e-3)


def test_the_environment_is_seen_where_the_formula_puts_it(blender: BlenderBackend) -> None:
    ball = body("ball", Sphere(radius=0.01), WHITE, pose=at(0, 9, 0))
    seen = render(
        blender,
        scene((ball,), camera(look((0, 0, 0), (0.001, -1, 0)), focal=40)),
        (EnvironmentLight(name="env", map="spot"),),
    )
    np.testing.assert_allclose(centre(seen.radiance[0]), (100, 50, 25), rtol=0.01)
    assert geometry_of(seen).environment.min() == 1


DAY = EnvironmentLight(name="day", radiance=(1, 2, 3))
DUSK = EnvironmentLight(name="dusk", map="spot", radiance=(9, 9, 9))
SUN = SunLight(name="sun", direction=(0.3, 0.2, -1), irradiance=(2, 2, 2))


def test_several_environments_each_have_their_layer(blender: BlenderBackend) -> None:
    """Blender holds one world at a time: the second must come out as if it were alone, in every variant."""
    ball = body("ball", Sphere(radius=0.5), GREY, pose=at(0, 0, 0.5), insertable=True)
    # The horizon shows above the floor, and the map's bright spot, in the direction -Y, behind the ball.
    spec = scene((floor(GREY), ball), camera(look((0.2, 4, 0.9), (0, 0, 0.5)), size=48, focal=40))
    for variant in ("all", "without_ball", "foreground_ball"):
        together = render(blender, spec, (SUN, DAY, DUSK), variant=variant)
        alone = [render(blender, spec, (light,), variant=variant).radiance[0] for light in (SUN, DAY, DUSK)]
        for name, ours, theirs in zip(together.lights, together.radiance, alone, strict=True):
            assert theirs.mean() > 0, name
            np.testing.assert_allclose(ours.mean(axis=(0, 1)), theirs.mean(axis=(0, 1)), rtol=0.03, err_msg=name)
        # The second environment has a render of its own, so it is the same to the last bit.
        np.testing.assert_array_equal(together.radiance[2], alone[2])
        np.testing.assert_allclose(together.radiance.sum(axis=0), together.combined, rtol=1e-4, atol=1e-5)
    swapped = render(blender, spec, (DUSK, SUN, DAY))
    np.testing.assert_array_equal(swapped.radiance[2], render(blender, spec, (DAY,)).radiance[0])


def test_emission_follows_its_texture(blender: BlenderBackend) -> None:
    card = body("card", Rectangle(width=4, height=4), Material(base_color=(0, 0, 0), ior=1.0), pose=at(0, 0, 0))
    glow = EmissiveLight(name="glow", body="card", radiance=(2, 4, 8), texture=Texture(image="halves", repeat=(0.5, 1)))
    stack = render(blender, scene((card,), camera(at(0, 0, 5), size=64, focal=64)), (glow,))
    # The left half of a repeat is red, its right half green, both of 188/255.
    level = ((188 / 255 + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(stack.radiance[0, 32, 40], (2 * level, 0, 0), rtol=1e-3)
    np.testing.assert_allclose(stack.radiance[0, 32, 56], (0, 4 * level, 0), rtol=1e-3)


def test_a_gobo_reads_the_right_way_round(blender: BlenderBackend) -> None:
    """Seen from the lamp, the picture on the wall is the picture: red, on its left, comes out left."""
    wall = body(
        "wall", Rectangle(width=9, height=9), WHITE, pose=((1, 0, 0, 0), (0, 0, -1, 0), (0, 1, 0, 0), (0, 0, 0, 1))
    )
    lamp = SpotLight(
        name="a", position=(0, -2, 0), direction=(0, 1, 0), intensity=(1, 1, 1), half_angle=0.4, blend=0, gobo="halves"
    )
    view = camera(look((0, -2, 0), (0, 0, 0)), size=32, focal=16 / math.tan(0.4))
    layer = render(blender, scene((wall,), view), (lamp,)).radiance[0]
    red, green = layer[16, 8], layer[16, 24]
    assert red[0] > 0.03
    assert red[1] < 0.01 * red[0]
    assert green[1] > 0.03
    assert green[0] < 0.01 * green[1]
    upright = render(blender, scene((wall,), view), (lamp.model_copy(update={"roll": math.pi / 2}),)).radiance[0]
    assert upright[24, 16, 0] > 0.03, "a quarter turn counter-clockwise takes left to the bottom"
    assert upright[8, 16, 1] > 0.03


def weight_ratio(layer: Float32) -> Float32:
    total = layer.sum(axis=(0, 1))
    return np.asarray(total / total[0])


def test_furnace(blender: BlenderBackend) -> None:
    """A white Lambertian body in a uniform world of radiance 1 cannot be told from it.

    The Principled BSDF's glossy lobe over white keeps its energy to within some percent, least at the outline.
    """
    for material, low in ((WHITE, 0.999), (Material(base_color=(1, 1, 1), roughness=0.5), 0.92)):
        ball = body("ball", Sphere(radius=1), material, pose=at(0, 0, 0))
        stack = render(blender, scene((ball,), camera(at(0, 0, 5))), (ENV,))
        assert low < stack.combined.min()
        assert stack.combined.max() < 1.001 + 1 - low


@pytest.fixture(scope="module")
def ball_view() -> Camera:
    """Unequal focal lengths and a principal point off the middle, rolled and oblique."""
    return Camera(width=60, height=44, fx=70, fy=55, cx=25.5, cy=28, c2w=look((3, -2, 1.5), (0.1, 0.1, 0)))


def test_geometry_of_a_sphere_in_closed_form(blender: BlenderBackend, ball_view: Camera) -> None:
    material = Material(base_color=(0.2, 0.4, 0.6), roughness=0.3, metallic=0.7)
    ball = body("ball", Sphere(radius=0.8), material, pose=at(0.1, 0.2, 0.3))
    far = body("far", Sphere(radius=0.1), WHITE, pose=at(0, 0, -50))
    geometry = geometry_of(render(blender, scene((far, ball), ball_view), (ENV,)))
    v, u = np.mgrid[0:44, 0:60] + 0.5
    local = np.stack([(u - 25.5) / 70, -(v - 28) / 55, -np.ones_like(u)], axis=-1)
    pose = ball_view.pose()
    rays = local @ pose[:3, :3].T
    away = pose[:3, 3] - np.array([0.1, 0.2, 0.3])
    a, b, c = (rays**2).sum(-1), rays @ away, away @ away - 0.64
    hit = b * b > a * c
    depth = np.where(hit, (-b - np.sqrt(np.maximum(b * b - a * c, 0))) / a, 0)
    normal = (away + depth[..., None] * rays) / 0.8
    # Pixels whose centre falls within a triangle's breadth of the outline may go either way.
    sure = np.abs(b * b - a * c) > 0.02
    assert hit[sure].sum() > 500
    np.testing.assert_array_equal(geometry.instance_id[sure], np.where(hit, 2, 0)[sure])
    np.testing.assert_allclose(geometry.z_depth[sure], depth[sure], rtol=1e-3)
    inside = sure & hit
    np.testing.assert_allclose(geometry.normal_world[inside], normal[inside], atol=2e-3)
    np.testing.assert_allclose(geometry.albedo[inside], np.broadcast_to((0.2, 0.4, 0.6), (*inside.shape, 3))[inside])
    np.testing.assert_allclose(geometry.roughness[inside], 0.3, rtol=1e-6)
    np.testing.assert_allclose(geometry.metallic[inside], 0.7, rtol=1e-6)
    assert (geometry.z_depth[~hit & sure] == 0).all()
    assert (geometry.normal_world[~hit & sure] == 0).all()
    np.testing.assert_allclose(1 - geometry.environment.mean(), hit.mean(), atol=0.01)


def test_z_depth_is_planar_and_back_faces_turn_to_the_camera(blender: BlenderBackend) -> None:
    flat = body("flat", Rectangle(width=9, height=9), WHITE, pose=at(0, 0, 0))
    from_below = ((1, 0, 0, 0), (0, -1, 0, 0), (0, 0, -1, -2), (0, 0, 0, 1))
    geometry = geometry_of(render(blender, scene((flat,), camera(from_below)), (ENV,)))
    np.testing.assert_allclose(geometry.z_depth, 2, rtol=1e-6)
    np.testing.assert_allclose(geometry.normal_world, np.broadcast_to((0, 0, -1), (16, 16, 3)), atol=1e-6)


def test_textures_repeat_and_cut_out(blender: BlenderBackend) -> None:
    material = Material(
        base_color=(0.5, 1, 1),
        base_color_texture=Texture(image="halves", repeat=(0.5, 1)),
        opacity_from_alpha=True,
        ior=1.0,
    )
    card = body("card", Rectangle(width=4, height=4), material, pose=at(0, 0, 1))
    view = camera(at(0, 0, 5), size=64, focal=64)
    stack = render(blender, scene((card, floor(GREY, 40)), view), (ENV,))
    # One repeat is 2 m, 32 pixels: red, then green that is cut out.
    ids = geometry_of(stack).instance_id[32]
    assert ids[32 + 8] == ids[8] == 1
    assert ids[32 + 24] == ids[24] == 2
    red = ((188 / 255 + 0.055) / 1.055) ** 2.4 / 2
    np.testing.assert_allclose(geometry_of(stack).albedo[32, 40], (red, 0, 0), rtol=1e-3)
    np.testing.assert_allclose(geometry_of(stack).albedo[32, 56], (0.5, 0.5, 0.5), rtol=1e-5)


def test_meshes_keep_their_parts_and_shading_normals(blender: BlenderBackend) -> None:
    squares = MeshAsset(asset="test/squares", mesh_sha256="0" * 64, parts=2)
    thing = body("thing", squares, GREY, WHITE, pose=at(0, 0, 0))
    view = camera(look((0, -3, 0.5), (0, 0, 0.5)), size=32, focal=32)
    glow = EmissiveLight(name="glow", body="thing", part=1, radiance=(2, 1, 0.5))
    stack = render(blender, scene((thing,), view), (ENV, glow))
    geometry = geometry_of(stack)
    np.testing.assert_allclose(geometry.albedo[16, 12], (0.5, 0.5, 0.5))
    np.testing.assert_allclose(geometry.albedo[16, 20], (1, 1, 1))
    np.testing.assert_allclose(geometry.normal_world[16, 12], (0, -1, 0), atol=1e-3)
    half = math.sqrt(0.5)
    np.testing.assert_allclose(geometry.normal_world[16, 20], (0, -half, half), atol=1e-3)
    assert geometry.instance_id[16, 12] == geometry.instance_id[16, 20] == 1
    # Only the part of the light glows, in its own layer, at its own radiance.
    np.testing.assert_allclose(stack.radiance[1, 16, 20], (2, 1, 0.5), rtol=1e-5)
    assert stack.radiance[1, 16, 12].max() == 0


def test_library_assets_stand_where_they_should(tmp_path: Path) -> None:
    library = AssetLibrary(tmp_path, packs=("builtin",))
    asset = library.list("object")[0].id
    mesh = library.mesh(asset)
    geometry = MeshAsset(asset=asset, mesh_sha256=mesh.sha256(), parts=len(mesh.parts))
    (left, _, _), (right, _, top) = mesh.bounds()
    thing = body("thing", geometry, *(part.material for part in mesh.parts), pose=at(1, 0, 0))
    # So far away that perspective hardly matters; 2000 pixels a metre.
    view = camera(look((1, -1000, 0), (1, 0, 0)), 1000, 2e6)
    environment = EnvironmentLight(name="env", map=library.list("environment")[0].id)
    with BlenderBackend(library) as backend:
        stack = render(backend, scene((thing,), view), (environment,), spp=1)
    rows, columns = np.nonzero(geometry_of(stack).instance_id)
    assert (columns.min() - 500) / 2000 == pytest.approx(left, abs=0.002)
    assert (columns.max() + 1 - 500) / 2000 == pytest.approx(right, abs=0.002)
    assert (500 - rows.min()) / 2000 == pytest.approx(top, abs=0.002)
    assert rows.max() in (498, 499, 500)
    assert np.isfinite(stack.radiance).all()
    assert stack.radiance[0][rows, columns].mean() > 0.01


BALL = body("ball", Sphere(radius=0.3), GREY, pose=at(0, 0, 0.3), insertable=True)
METAL = body("metal", Sphere(radius=0.25), Material(metallic=1), pose=at(0.6, 0, 0.25), insertable=True)
GLASS = body("glass", Sphere(radius=0.2), Material(transmission=1, roughness=0), pose=at(0, -0.6, 0.2), insertable=True)
LAMP = body("lamp", Sphere(radius=0.15), WHITE, pose=at(-0.6, 0, 0.15), insertable=True)
TABLE = scene((floor(GREY), BALL, METAL, GLASS, LAMP), camera(look((0.5, -2.5, 1.2), (0, 0, 0.2)), 64, 90))
RIG = (
    EnvironmentLight(name="env", radiance=(0.3, 0.4, 0.5)),
    SunLight(name="sun", direction=(1, 1, -2), irradiance=(2, 2, 2)),
    AreaLight(name="area", width=0.5, height=0.5, world_from_light=look((1, -1, 1.5)), radiance=(4, 4, 4)),
    EmissiveLight(name="glow", body="lamp", radiance=(4, 2, 1)),
)


@pytest.fixture(scope="module")
def everything(blender: BlenderBackend) -> LayerStack:
    return render(blender, TABLE, RIG)


def test_layers_sum_to_the_combined_picture(everything: LayerStack) -> None:
    np.testing.assert_allclose(everything.radiance.sum(axis=0), everything.combined, rtol=1e-4, atol=1e-5)
    assert everything.lights == ("env", "sun", "area", "glow")
    assert everything.radiance.dtype == everything.combined.dtype == np.float32
    assert everything.radiance.mean(axis=(1, 2, 3)).min() > 0.01


def test_twice_the_power_is_twice_the_layer(blender: BlenderBackend, everything: LayerStack) -> None:
    sun = RIG[1].model_copy(update={"irradiance": (4, 4, 4)})
    alone, double = (render(blender, TABLE, (light,)).radiance[0] for light in (RIG[1], sun))
    np.testing.assert_allclose(double, 2 * alone, rtol=1e-4, atol=1e-6)
    # Beside others it is sampled more often then: the same expectation from other samples.
    among = render(blender, TABLE, (RIG[0], sun, *RIG[2:])).radiance
    for i, factor in enumerate((1, 2, 1, 1)):
        ours, theirs = np.clip(among[i], 0, factor), np.clip(factor * everything.radiance[i], 0, factor)
        assert ours.mean() == pytest.approx(theirs.mean(), rel=0.05)


def test_the_same_job_gives_the_same_picture(blender: BlenderBackend, everything: LayerStack) -> None:
    np.testing.assert_array_equal(render(blender, TABLE, RIG).radiance, everything.radiance)


def test_an_emissive_body_lights_its_neighbours_in_its_own_layer(
    blender: BlenderBackend, everything: LayerStack
) -> None:
    lamp = geometry_of(everything).instance_id == 5
    # The lamp's own light, and a little that comes back from the table.
    assert np.median(everything.radiance[3][lamp][:, 0]) == pytest.approx(4, rel=0.1)
    floor_pixels = geometry_of(everything).instance_id == 1
    assert everything.radiance[3][floor_pixels].mean() > 0.01
    without = render(blender, TABLE, RIG, variant="without_lamp")
    assert without.radiance[3].max() == 0


def test_removal_takes_the_shadow_away_and_leaves_the_rest(blender: BlenderBackend, everything: LayerStack) -> None:
    without = render(blender, TABLE, RIG, variant="without_metal")
    assert without.geometry is None
    # The picture agrees with one of a scene that never held the object; only its noise is another.
    rest = scene(tuple(b for b in TABLE.bodies if b.name != "metal"), *TABLE.cameras)
    never = render(blender, rest, RIG)
    for layer, truth in zip(without.radiance, never.radiance, strict=True):
        assert np.clip(layer, 0, 1).mean() == pytest.approx(np.clip(truth, 0, 1).mean(), rel=0.05)
    # The sun comes from the left front, so the shadow falls behind the object: lighter without it.
    gained = without.radiance[1] - everything.radiance[1]
    outside = ~np.isin(geometry_of(everything).instance_id, (3,))
    assert gained[outside].max() > 0.15
    # Common random numbers: what the object does not touch comes out the same to the last bit.
    same = (without.radiance == everything.radiance).all(axis=(0, 3))
    assert same.mean() > 0.3


@pytest.mark.parametrize("name", ["ball", "metal", "glass", "lamp"])
def test_foreground_is_the_objects_part_of_the_picture(
    blender: BlenderBackend, everything: LayerStack, name: str
) -> None:
    front = render(blender, TABLE, RIG, variant=f"foreground_{name}")
    assert front.coverage is not None
    inside = front.coverage == 1
    assert inside.sum() > 20
    np.testing.assert_allclose(front.radiance[:, inside], everything.radiance[:, inside], rtol=1e-5, atol=1e-6)
    assert (front.radiance[:, front.coverage == 0] == 0).all()
    # On the outline it is a part of the picture: never more than all of it.
    assert (front.radiance <= everything.radiance * 1.0001 + 1e-6).all()
    ids = geometry_of(everything).instance_id == TABLE.instance_id(name)
    assert abs(front.coverage.sum() - ids.sum()) < 0.1 * ids.sum()


def test_foreground_out_of_sight_is_empty(blender: BlenderBackend) -> None:
    away = scene((floor(GREY), BALL), camera(look((0, -3, 1), (0, -9, 1))))
    front = render(blender, away, (ENV,), variant="foreground_ball")
    beside = scene((floor(GREY), BALL), camera(look((0, -3, 1), (9, 3, 1)), focal=40))
    for stack in (front, render(blender, beside, (ENV,), variant="foreground_ball")):
        assert stack.coverage is not None
        assert stack.coverage.max() == stack.combined.max() == stack.radiance.max() == 0


def test_two_backends_may_take_turns(blender: BlenderBackend, everything: LayerStack, tmp_path: Path) -> None:
    with BlenderBackend(FakeLibrary(tmp_path)) as other:  # type: ignore[arg-type]
        render(other, scene((floor(),), DOWN), (ENV,))
        np.testing.assert_array_equal(render(blender, TABLE, RIG).radiance, everything.radiance)
    np.testing.assert_array_equal(render(blender, TABLE, RIG).radiance, everything.radiance)


def test_what_cannot_be_rendered_is_named(blender: BlenderBackend) -> None:
    with pytest.raises(BackendError, match="without_floor"):
        render(blender, TABLE, RIG, variant="without_floor")
    with pytest.raises(BackendError, match="part 1 of body 'lamp'"):
        render(blender, TABLE, (EmissiveLight(name="glow", body="lamp", part=1, radiance=(1, 1, 1)),))
    for image, complaint in (("absent", "cannot open"), ("broken", "cannot")):
        material = Material(base_color_texture=Texture(image=image))
        with pytest.raises(BackendError, match=f"{complaint}.*{image}.png"):
            render(blender, scene((floor(material),), DOWN), (ENV,))
    job = RenderJob(TABLE, LightRig(lights=RIG), RenderSettings(), 1)
    with pytest.raises(BackendError, match="view 1"):
        blender.render(job)


def test_nothing_is_printed_and_nothing_left_behind(blender: BlenderBackend, capfd: pytest.CaptureFixture[str]) -> None:
    render(blender, scene((floor(),), DOWN), (ENV,))
    assert capfd.readouterr() == ("", "")
    open_files = len(list(Path("/proc/self/fd").iterdir()))
    render(blender, scene((floor(),), DOWN), (ENV,))
    assert len(list(Path("/proc/self/fd").iterdir())) == open_files


def test_all_variants_share_random_numbers_from_the_first_render_on(tmp_path: Path) -> None:
    """With an environment beside lamps, the first change of visibility once changed every later random choice."""
    lights = tuple(LIGHTS[name] for name in ("environment", "sun", "point", "rectangle"))
    job = calibration_job(SURFACES["plastic"], lights, 4)
    with BlenderBackend(AssetLibrary(cache=tmp_path, packs=("builtin",))) as fresh:
        first = fresh.render(job)
        without = fresh.render(replace(job, variant="without_ball"))
        again = fresh.render(job)
    np.testing.assert_array_equal(first.radiance, again.radiance)
    assert np.mean((first.radiance != without.radiance).any(axis=(0, 3))) < 0.6
