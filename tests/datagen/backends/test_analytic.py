"""The closed-form renderer against slow, plain references, and the sphere scenes made for it."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from multilight.datagen.backends.analytic import AnalyticBackend
from multilight.datagen.backends.analytic.lighting import spot_falloff
from multilight.datagen.backends.analytic.shapes import Ball, Plate, column
from multilight.datagen.backends.protocol import BackendError, RenderJob, RenderSettings
from multilight.datagen.storage.layers import LayerStack
from multilight.lights.spec import AreaLight, EmissiveLight, EnvironmentLight, Light, LightRig, PointLight, SunLight
from multilight.scenes.cameras.pinhole import camera_from_fov, look_at, matrix4, project
from multilight.scenes.kinds.spheres import INSERTABLE, sample_spheres
from multilight.scenes.random_streams import Streams
from multilight.scenes.spec import Body, Material, MeshAsset, Rectangle, SceneSpec, Sphere, Texture

PLAIN = Material(base_color=(1.0, 0.5, 0.25), roughness=0.7, ior=1.0)


def body(
    name: str,
    shape: Sphere | Rectangle | MeshAsset,
    position: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    material: Material = PLAIN,
    insertable: bool = False,
    pose: np.ndarray | None = None,
) -> Body:
    matrix = np.eye(4) if pose is None else np.array(pose)
    matrix[:3, 3] = position
    return Body(
        name=name,
        role="object",
        category="test",
        geometry=shape,
        materials=(material,),
        world_from_body=matrix4(matrix),
        insertable=insertable,
    )


def scene(*bodies: Body, size: int = 24, eye: tuple[float, float, float] = (0.0, -3.0, 0.0)) -> SceneSpec:
    camera = camera_from_fov(look_at(eye, (0, 0, 0)), width=size, height=size, fov=0.8)
    return SceneSpec(kind="spheres", index=0, bodies=bodies, cameras=(camera,))


def render(spec: SceneSpec, *lights: Light, variant: str = "all", spp: int = 1) -> LayerStack:
    job = RenderJob(spec, LightRig(lights=lights), RenderSettings(spp=spp), 0, variant)
    with AnalyticBackend() as backend:
        return backend.render(job)


def cosine_directions(normal: np.ndarray, count: int = 200_000) -> np.ndarray:
    """Directions (3, N) spread with density cos(theta) / pi about a normal."""
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(count, 3))
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True) + normal
    return (directions / np.linalg.norm(directions, axis=1, keepdims=True)).T


# --- form factors against counting rays ---

NORMALS = {"facing": (0.0, 0.0, 1.0), "tilted": (0.0, 0.8, 0.6), "grazing": (1.0, 0.0, 0.05), "cut": (0.9, 0.0, -0.2)}


@pytest.mark.parametrize("normal", NORMALS.values(), ids=NORMALS)
@pytest.mark.parametrize(
    "shape",
    [
        Ball("b", 1, PLAIN, column((0.3, 0.1, 1.0)), 0.7),
        Ball("b", 1, PLAIN, column((0.0, 0.0, 5.0)), 0.7),
        Plate("p", 1, PLAIN, column((0.2, 0.1, 0.8)), np.eye(3), 1.0, 0.4),
        Plate("p", 1, PLAIN, column((0.5, 0.0, 0.0)), np.eye(3)[[1, 2, 0]], 2.0, 0.7),
    ],
    ids=["near_ball", "far_ball", "plate_above", "wall"],
)
def test_form_factor_equals_the_share_of_rays_that_hit(shape: Ball | Plate, normal: tuple[float, float, float]) -> None:
    unit = np.array(normal) / np.linalg.norm(normal)
    hits = np.isfinite(shape.hit(np.zeros((3, 1)), cosine_directions(unit)))
    factor = shape.form_factor(np.zeros((3, 1)), column(unit))
    assert factor[0] == pytest.approx(hits.mean(), abs=4 * math.sqrt(0.25 / hits.size))


@given(distance=st.floats(1.01, 50), cosine=st.floats(0, 1))
def test_sphere_above_the_horizon_has_the_textbook_form_factor(distance: float, cosine: float) -> None:
    ball = Ball("b", 1, PLAIN, column((0.0, 0.0, distance)), 1.0)
    normal = column((math.sqrt(1 - cosine**2), 0.0, cosine))
    factor = ball.form_factor(np.zeros((3, 1)), normal)[0]
    textbook = cosine / distance**2
    if cosine * distance >= 1:
        assert factor == pytest.approx(textbook, abs=1e-9)
    else:
        assert factor >= textbook - 1e-9, "the part above the horizon outweighs the negative part below"


def test_huge_plate_fills_half_the_sky_of_an_upright_wall_and_none_of_its_own() -> None:
    ground = Plate("g", 1, PLAIN, column((0.0, 0.0, 0.0)), np.eye(3), 1e4, 1e4)
    points = np.array([[0.0, 0.0, 1.0]] * 4).T
    normals = np.array([(1.0, 0, 0), (0, 0, -1.0), (0, 0, 1.0), (0.6, 0, 0.8)]).T
    np.testing.assert_allclose(ground.form_factor(points, normals), [0.5, 1.0, 0.0, 0.1], atol=1e-3)


# --- pictures ---


def test_white_furnace() -> None:
    """A convex white body under uniform light of radiance 1 cannot be told from its surroundings."""
    white = Material(base_color=(1.0, 1.0, 1.0))
    stack = render(scene(body("ball", Sphere(radius=1.0), material=white)), EnvironmentLight(name="sky"), spp=4)
    np.testing.assert_allclose(stack.radiance[0], 1.0, rtol=1e-6)


def test_sphere_depth_in_closed_form() -> None:
    stack = render(scene(body("ball", Sphere(radius=1.0)), size=25), EnvironmentLight(name="sky"))
    assert stack.geometry.z_depth[12, 12] == pytest.approx(2.0)
    assert stack.geometry.z_depth[0, 0] == 0
    np.testing.assert_allclose(stack.geometry.normal_world[12, 12], (0, -1, 0), atol=1e-6)
    assert stack.geometry.roughness[12, 12] == pytest.approx(0.7)
    # A sphere of radius 1 at distance 3 has the solid-angle radius asin(1/3): in pixels, f tan(asin(1/3)).
    focal = 12.5 / math.tan(0.4)
    area = math.pi * (focal * math.tan(math.asin(1 / 3))) ** 2
    assert (stack.geometry.instance_id == 1).sum() == pytest.approx(area, rel=0.03)


def test_sun_on_a_sphere_is_lamberts_law() -> None:
    stack = render(
        scene(body("ball", Sphere(radius=1.0)), size=25),
        SunLight(name="sun", direction=(0, 2, 0), irradiance=(math.pi, 1.0, 1.0)),
    )
    assert stack.radiance[0, 12, 12] == pytest.approx((1.0, 0.5 / math.pi, 0.25 / math.pi))
    mine = stack.geometry.instance_id == 1
    cosine = -stack.geometry.normal_world[mine][:, 1]
    np.testing.assert_allclose(stack.radiance[0, mine, 0], np.maximum(cosine, 0), atol=1e-6)


def test_shadow_of_a_sphere_under_a_point_is_the_tangent_cone() -> None:
    """From height 2, a ball of radius 0.5 at height 1 shadows a disc of radius 2 tan(asin(0.5))."""
    ground = body("ground", Rectangle(width=8.0, height=8.0))
    ball = body("ball", Sphere(radius=0.5), (0.0, 0.0, 1.0), insertable=True)
    camera = camera_from_fov(look_at((0, 0, 6), (0, 0, 0), up=(0, 1, 0)), width=96, height=96, fov=0.8)
    spec = SceneSpec(kind="spheres", index=0, bodies=(ground, ball), cameras=(camera,))
    lamp = PointLight(name="lamp", position=(0, 0, 2), intensity=(1, 1, 1))
    lit, without = render(spec, lamp), render(spec, lamp, variant="without_ball")
    dark = (lit.radiance[0, ..., 0] == 0) & (lit.geometry.instance_id == 1)
    covered = lit.geometry.instance_id == 2
    radius = 2 * math.tan(math.asin(0.5))
    pixels = math.pi * (radius * camera.fx / 6) ** 2
    assert (dark | covered).sum() == pytest.approx(pixels, rel=0.03)
    assert (without.radiance > 0).all()
    outside = ~(dark | covered)
    np.testing.assert_array_equal(lit.radiance[:, outside], without.radiance[:, outside])


def test_glow_and_its_hiding_place() -> None:
    """A glowing ball lights the plate by cos(theta) (R / d)^2, and a screen over its centre hides it."""
    ground = body("ground", Rectangle(width=4.0, height=4.0))
    bulb = body("bulb", Sphere(radius=0.2), (0.0, 0.0, 1.0))
    glow = EmissiveLight(name="glow", body="bulb", radiance=(8.0, 8.0, 8.0))
    spec = scene(ground, bulb, eye=(0.0, -1.0, 3.0), size=25)
    stack = render(spec, glow)
    (x, y), _ = (np.squeeze(part) for part in project(spec.cameras[0], [(0.0, 0.0, 1.2)]))
    np.testing.assert_allclose(stack.radiance[0, int(y), int(x)], 8.0)
    _, plate = stack.radiance[0], stack.geometry.instance_id == 1
    assert stack.radiance[0][plate][:, 0].max() <= 8.0 * 0.2**2 + 1e-6
    assert stack.radiance[0][plate][:, 0].max() == pytest.approx(8.0 * 0.2**2, rel=0.1)
    screened = render(scene(ground, bulb, body("screen", Rectangle(width=1.0, height=1.0), (0, 0, 0.5)),
                            eye=(0.0, -1.0, 3.0), size=25), glow)  # fmt: skip
    assert (screened.radiance[0][screened.geometry.instance_id == 1] == 0).any()


def test_rectangle_in_any_pose_shows_both_sides() -> None:
    turned = look_at((1.0, -2.0, 0.5), (0, 0, 0))
    for flip in (1, -1):
        pose = turned @ np.diag([1.0, flip, flip, 1.0])
        spec = scene(body("card", Rectangle(width=1.0, height=0.5), pose=pose))
        stack = render(spec, SunLight(name="sun", direction=(-1.0, 2.0, -0.5), irradiance=(math.pi,) * 3))
        mine = stack.geometry.instance_id == 1
        assert mine.sum() > 20
        np.testing.assert_allclose(
            stack.geometry.normal_world[mine], np.broadcast_to(turned[:3, 2], (mine.sum(), 3)), atol=1e-6
        )
        np.testing.assert_allclose(stack.radiance[0][mine][:, 0], 1.0, rtol=1e-5)


def test_scaled_pose_scales_the_sphere() -> None:
    spec = scene(body("ball", Sphere(radius=0.5), pose=np.diag([2.0, 2.0, 2.0, 1.0])), size=25)
    assert render(spec, EnvironmentLight(name="sky")).geometry.z_depth[12, 12] == pytest.approx(2.0)


def test_grid_is_the_ceiling_of_the_square_root() -> None:
    spec = scene(body("ball", Sphere(radius=1.0)))
    sky = EnvironmentLight(name="sky")
    for spp, side in ((1, 1), (2, 2), (4, 2), (5, 3)):
        steps = render(spec, sky, spp=spp).geometry.environment * side**2
        np.testing.assert_allclose(steps, np.rint(steps), atol=1e-5)
        assert len(np.unique(np.rint(steps))) > side


@settings(max_examples=20)
@given(edge=st.floats(0.05, 1.4), blend=st.floats(0, 1), angle=st.floats(0, 1.5))
def test_spot_falloff_is_one_on_the_axis_and_zero_outside(edge: float, blend: float, angle: float) -> None:
    falloff = spot_falloff(np.cos(np.array([0.0, angle, edge + 0.01])), edge, blend)
    assert falloff[0] == 1.0
    assert 0 <= falloff[1] <= 1
    assert falloff[2] == 0.0


# --- what it cannot draw ---

TEXTURED = Material(base_color_texture=Texture(image="builtin/wood"))


@pytest.mark.parametrize(
    ("bodies", "light", "words"),
    [
        ([body("cup", MeshAsset(asset="a/b", mesh_sha256="0", parts=1))], None, "'cup' is a mesh"),
        ([body("cup", Sphere(radius=1), material=TEXTURED)], None, "'cup'.*base_color_texture"),
        ([body("cup", Sphere(radius=1), material=Material(metallic=1.0))], None, "'cup'.*metallic"),
        ([body("cup", Sphere(radius=1), material=Material(transmission=0.5))], None, "'cup'.*transmission"),
        ([body("cup", Sphere(radius=1), material=Material(opacity=0.5))], None, "'cup'.*opacity"),
        ([body("cup", Sphere(radius=1), pose=np.diag([1, 2, 1, 1.0]))], None, "'cup'.*unevenly"),
        ([body("cup", Sphere(radius=4))], None, "inside body 'cup'"),
        (
            [body("cup", Sphere(radius=1))],
            AreaLight(name="panel", width=1, height=1, world_from_light=matrix4(np.eye(4)), radiance=(1, 1, 1)),
            "'panel'.*'area'.*cycles",
        ),
        ([body("cup", Sphere(radius=1))], EnvironmentLight(name="sky", map="bpy/city"), "'sky'.*'bpy/city'"),
        (
            [body("card", Rectangle(width=1, height=1))],
            EmissiveLight(name="glow", body="card", radiance=(1, 1, 1)),
            "'card'.*only spheres glow",
        ),
        (
            [body("cup", Sphere(radius=1))],
            EmissiveLight(name="glow", body="ghost", radiance=(1, 1, 1)),
            "'glow'.*'ghost'",
        ),
    ],
)
def test_what_has_no_closed_form_is_refused_by_name(bodies: list[Body], light: Light | None, words: str) -> None:
    with pytest.raises(BackendError, match=words):
        render(scene(*bodies), light or EnvironmentLight(name="sky"))


# --- the sphere scenes ---


@pytest.mark.parametrize("index", range(6))
def test_spheres_rest_on_the_ground_apart_and_in_frame(index: int) -> None:
    spec = sample_spheres(Streams(7, index), index=index, width=96, height=64, views=5)
    balls = [item for item in spec.bodies if isinstance(item.geometry, Sphere)]
    assert 4 <= len(balls) <= 7
    assert spec.insertable == tuple(ball.name for ball in balls[:INSERTABLE])
    centres = np.array([np.array(ball.world_from_body)[:3, 3] for ball in balls])
    radii = np.array([ball.geometry.radius for ball in balls])
    np.testing.assert_allclose(centres[:, 2], radii)
    gaps = np.linalg.norm(centres[:, None] - centres[None], axis=-1) - radii[:, None] - radii[None]
    assert gaps[~np.eye(len(balls), dtype=bool)].min() > 0
    around = np.random.default_rng(0).normal(size=(200, 3))
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    for camera in spec.cameras:
        pixels, z_depth = project(camera, (centres[:, None] + radii[:, None, None] * around).reshape(-1, 3))
        assert z_depth.min() > 0
        assert pixels.min() >= 0
        assert (pixels <= (96, 64)).all()
    distances = [np.linalg.norm(camera.pose()[:3, 3] - centres.mean(axis=0)) for camera in spec.cameras]
    assert distances[0] > 1.5 * distances[-1]


def test_insertable_spheres_are_seen_in_every_view() -> None:
    for index in range(4):
        spec = sample_spheres(Streams(0, index), index=index, width=48, height=48, views=4)
        rig = LightRig(lights=(EnvironmentLight(name="sky"),))
        with AnalyticBackend() as backend:
            for view in range(4):
                ids = backend.render(RenderJob(spec, rig, RenderSettings(spp=1), view)).geometry.instance_id
                for name in spec.insertable:
                    assert (ids == spec.instance_id(name)).sum() > 3, (index, view, name)


def test_scene_depends_on_nothing_but_its_key() -> None:
    def sample(seed: int, index: int) -> str:
        return sample_spheres(Streams(seed, index), index=index, width=32, height=32, views=3).sha256()

    first = sample(0, 4)
    sample(0, 5)
    assert sample(0, 4) == first
    assert len({sample(0, 4), sample(1, 4), sample(0, 5)}) == 3
