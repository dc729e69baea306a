"""The Mitsuba room: its integrator against the built-in one, energy, removed objects, and compiled kernels."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multilight.datagen.backends.machine.mitsuba_variant import choose_variant
from multilight.datagen.backends.protocol import RenderJob, RenderSettings
from multilight.datagen.storage.layers import LayerStack
from multilight.lights.spec import EmissiveLight, EnvironmentLight, Light, LightRig, PointLight, SunLight
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.cameras.pinhole import camera_from_fov, look_at, matrix4
from multilight.scenes.spec import Body, Camera, Material, Rectangle, SceneSpec, Sphere, Texture
from tests.datagen.backends.calibration_scenes import LIGHTS, SURFACES, calibration_job
from tests.datagen.backends.contract_scenes import (
    BALLS,
    GROUND,
    RIG,
    SIZE,
    SKY,
    job,
    oblique_camera,
    overhead_camera,
    placed,
)

if choose_variant().variant is None:
    pytest.skip(f"Mitsuba cannot run here: {choose_variant().why}", allow_module_level=True)

import drjit as dr
import mitsuba as mi

from multilight.datagen.backends.mitsuba import MitsubaBackend, bsdf, integrator
from multilight.datagen.backends.mitsuba.adaptive import first_blocks
from multilight.datagen.backends.mitsuba.arrays import SceneArrays, Textures, scene_arrays
from multilight.datagen.backends.mitsuba.backend import _Batch
from multilight.datagen.backends.mitsuba.bsdf import Tables
from multilight.datagen.backends.mitsuba.cameras import Lens
from multilight.datagen.backends.mitsuba.integrator import Planes, World, trace
from multilight.datagen.backends.mitsuba.lights import Lights
from multilight.datagen.backends.mitsuba.surfaces import Surfaces, accelerate

WHITE = (1.0, 1.0, 1.0)


@pytest.fixture(scope="module")
def library() -> AssetLibrary:
    return AssetLibrary(packs=("builtin",))


@pytest.fixture(scope="module")
def backend(library: AssetLibrary) -> Iterator[MitsubaBackend]:
    with MitsubaBackend(library) as opened:
        yield opened


# --- against Mitsuba's own path integrator ---


@dataclass
class Sequential:
    """Mitsuba's own sampler behind our calls: the built-in integrator draws in the same order."""

    sampler: mi.Sampler

    def next_1d(self, dimension: int, vertex: int = 0) -> mi.Float:
        return self.sampler.next_1d()

    def next_2d(self, dimension: int, vertex: int = 0) -> mi.Point2f:
        return self.sampler.next_2d()


COLOURS = {"ground": (0.6, 0.5, 0.4), "block": (0.7, 0.2, 0.1), "bulb": (0.1, 0.2, 0.3)}
SOLIDS: dict[str, tuple[tuple[float, float, float], float]] = {
    "block": ((-0.2, 0, 0.2), 0.4),
    "bulb": ((0.5, -0.2, 0.2), 0.2),
}
OWN_LIGHTS: tuple[Light, ...] = (
    PointLight(name="point", position=(-1.0, -1.0, 1.5), intensity=(2.0, 1.0, 0.5)),
    SunLight(name="sun", direction=(0.3, 0.4, -1.0), irradiance=(1.0, 0.9, 0.8), angle=0.0),
    EnvironmentLight(name="sky", radiance=(0.3, 0.4, 0.5)),
    EmissiveLight(name="glow", body="bulb", radiance=(3.0, 2.0, 1.0)),
)


def _block(centre: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Six flat sides of a turned cube: corners and triangles.

    No normal has a zero in it, whose sign would be for rounding to decide, and with it the frame.
    """
    turn = Rotation.from_euler("xyz", [0.3, 0.5, 0.7]).as_matrix()
    corners: list[np.ndarray] = []
    faces: list[list[int]] = []
    for axis in range(3):
        for side in (-1, 1):
            u, v = (np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3])
            n = side * np.eye(3)[axis]
            u = u * side
            start = len(corners)
            corners += [centre + size / 2 * turn @ (n + a * u + b * v) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
            faces += [[start, start + 1, start + 2], [start, start + 2, start + 3]]
    return np.array(corners, np.float32), np.array(faces, np.uint32)


def _mesh(name: str, vertices: np.ndarray, faces: np.ndarray, **more: Any) -> mi.Mesh:
    mesh = mi.Mesh(name, len(vertices), len(faces), has_vertex_texcoords=True, props=_props(**more))
    parameters = mi.traverse(mesh)
    parameters["vertex_texcoords"] = mi.Float(_aligned_uv(vertices, faces).ravel())
    parameters["vertex_positions"] = mi.Float(vertices.ravel())
    parameters["faces"] = mi.UInt32(faces.ravel())
    parameters.update()
    return mesh


def _aligned_uv(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Texture coordinates that run along the axes of `Frame3f`, from which the built-in integrator takes its own."""
    uv = np.zeros((len(vertices), 2), np.float32)
    for triangle in faces:
        a, b, c = vertices[triangle]
        n = np.cross(b - a, c - a)
        frame = mi.Frame3f(mi.Normal3f(n / np.linalg.norm(n)))
        uv[triangle] = vertices[triangle] @ np.concatenate([np.array(frame.s), np.array(frame.t)], axis=1)
    return uv


def _props(**objects: object) -> mi.Properties:
    props = mi.Properties()
    for key, value in objects.items():
        props[key] = mi.load_dict(value)
    return props


def _ours(lights: tuple[Light, ...], library: AssetLibrary) -> World:
    """The ground and, in the places of two balls, two turned cubes, as our integrator takes them."""
    rectangles = [
        Body(name="ground", role="support", category="test", geometry=Rectangle(width=4.0, height=4.0),
             materials=(Material(base_color=COLOURS["ground"], roughness=1.0, ior=1.0),),
             world_from_body=matrix4(np.eye(4))),
    ]  # fmt: skip
    for name, (centre, size) in SOLIDS.items():
        rectangles.append(
            Body(name=name, role="object", category="test", geometry=Sphere(radius=size / 2),
                 materials=(Material(base_color=COLOURS[name], roughness=1.0, ior=1.0),),
                 world_from_body=matrix4(np.block([[np.eye(3), np.array(centre)[:, None]], [np.zeros(3), 1.0]])))
        )  # fmt: skip
    camera = camera_from_fov(look_at((0, -3, 1), (0, 0, 0)), width=16, height=16, fov=0.5)
    scene = SceneSpec(kind="custom", index=0, bodies=tuple(rectangles), cameras=(camera,))
    arrays = scene_arrays(scene, LightRig(lights=lights), library, Textures(library))
    arrays = _with_blocks(arrays)
    surfaces = Surfaces(arrays)
    bits = np.zeros(4, np.uint32)
    rig = Lights(LightRig(lights=lights), arrays, bits, surfaces, library)
    whole = accelerate(arrays, arrays.of_bodies(arrays.spans))
    assert whole is not None
    return World(whole, None, surfaces, rig, Tables(), mi.UInt32(bits))


def _with_blocks(arrays: SceneArrays) -> SceneArrays:
    """Put flat cubes where the balls are: without smooth normals both renderers have the same frames."""
    vertices = [arrays.vertices[:4]]
    faces = [arrays.faces[:2]]
    spans = {"ground": (0, 2)}
    for row, (name, (centre, size)) in enumerate(SOLIDS.items(), start=1):
        corners, triangles = _block(np.array(centre), size)
        normals = np.repeat([[0, 0, 1.0]], len(corners), axis=0)
        for triangle in triangles:
            a, b, c = corners[triangle]
            normals[triangle] = np.cross(b - a, c - a) / np.linalg.norm(np.cross(b - a, c - a))
        start, first = sum(len(v) for v in vertices), sum(len(f) for f in faces)
        vertices.append(np.concatenate([corners, normals, np.zeros((len(corners), 2))], axis=1).astype(np.float32))
        faces.append(np.concatenate([triangles + start, np.full((len(triangles), 1), row)], axis=1).astype(np.uint32))
        spans[name] = (first, len(triangles))
    return replace(arrays, vertices=np.concatenate(vertices), faces=np.concatenate(faces), spans=spans)


def _builtin(chosen: set[str]) -> mi.Scene:
    def diffuse(name: str) -> dict[str, object]:
        return {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(COLOURS[name])}}

    def rgb(*values: float) -> dict[str, object]:
        return {"type": "rgb", "value": list(values)}

    half = 2.0
    ground = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]], np.float32)
    solids = {name: _block(np.array(centre), size) for name, (centre, size) in SOLIDS.items()}
    axes = mi.ScalarTransform4f(np.array([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]]))
    bitmap = mi.Bitmap(np.broadcast_to(np.array([0.3, 0.4, 0.5], np.float32), (9, 8, 3)).copy())
    glow: dict[str, Any] = {"emitter": {"type": "area", "radiance": rgb(3.0, 2.0, 1.0)}} if "glow" in chosen else {}
    lights = {
        "point": {"type": "point", "position": [-1.0, -1.0, 1.5], "intensity": rgb(2.0, 1.0, 0.5)},
        "sun": {"type": "directional", "direction": [0.3, 0.4, -1.0], "irradiance": rgb(1.0, 0.9, 0.8)},
        "sky": {"type": "envmap", "bitmap": bitmap, "to_world": axes},
    }
    return mi.load_dict({
        "type": "scene",
        **{name: light for name, light in lights.items() if name in chosen},
        "ground": _mesh("ground", ground, np.array([[0, 1, 2], [0, 2, 3]], np.uint32), bsdf=diffuse("ground")),
        "block": _mesh("block", *solids["block"], bsdf=diffuse("block")),
        "bulb": _mesh("bulb", *solids["bulb"], bsdf=diffuse("bulb"), **glow),
    })  # fmt: skip


COUNT = 1 << 15
PLUGINS = {"PointLight": "point", "DirectionalEmitter": "sun", "EnvironmentMapEmitter": "sky", "AreaLight": "glow"}


def _rays() -> mi.Ray3f:
    points = np.random.default_rng(0).random((2, COUNT)).astype(np.float32) * 0.6 - 0.3
    d = dr.normalize(mi.Vector3f(mi.Float(points[0]), 1.0, mi.Float(points[1]) - 0.3))
    return mi.Ray3f(mi.Point3f(0.2, -2.4, 1.0), d)


def _sampler() -> mi.Sampler:
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(3, COUNT)
    return sampler


WEIGHT = integrator._weight


def _direct_one(world: World, planes: Planes, path: Any, hit: Any, c: Any, frame: mi.Frame3f, on: mi.Bool) -> None:
    """Sample one of the lights, each with the same chance."""
    result, count = path.result, world.lights.count
    u = path.sampler.next_2d(integrator.LIGHT, path.depth)
    scaled = u.x * count
    chosen = dr.minimum(mi.UInt32(scaled), count - 1)
    u = mi.Point2f(scaled - mi.Float(chosen), u.y)
    found = world.lights.sample(chosen, hit.p, u, on)
    delta = world.lights.row(chosen, on)["delta"] != 0
    value, pdf = bsdf.evaluate(c, frame.to_local(found.d))
    weight = dr.select(delta, 1, WEIGHT(found.pdf / count, pdf)) * count
    light_in = path.throughput * value * found.weight * weight
    usable, passed, met = integrator._arriving(world, hit, found, light_in, on)
    result.met |= dr.select(usable, met, 0)
    planes.add(chosen, light_in * passed, usable)


# Glowing bodies shine on both sides: points on the far side, within a ray's tolerance of an edge, count with us.
@pytest.mark.parametrize(
    ("chosen", "share"), [({"point", "sun", "sky"}, 1e-3), ({"point", "sun", "sky", "glow"}, 0.02)]
)
def test_layers_sum_to_the_builtin_path_integrator_path_by_path(
    library: AssetLibrary, chosen: set[str], share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    builtin = _builtin(chosen)
    order = [PLUGINS[str(e).split("[")[0]] for e in builtin.emitters()]
    lights = {light.name: light for light in OWN_LIGHTS}
    world = _ours(tuple(lights[name] for name in order), library)
    sampler: Any = Sequential(_sampler())
    monkeypatch.setattr(integrator, "_direct", _direct_one)
    monkeypatch.setattr(integrator, "_weight", lambda met, sampled: WEIGHT(met, sampled / len(order)))
    planes, _ = trace(world, _rays(), sampler, max_bounces=5)
    path = mi.load_dict({"type": "path", "max_depth": 7, "rr_depth": 3})
    expected = np.array(path.sample(builtin, _sampler(), mi.RayDifferential3f(_rays()))[0])
    total = np.array(planes.values).reshape(-1, 3, COUNT)[: len(order)].sum(axis=0)
    assert expected.mean() > 0.1
    off = np.abs(total - expected).max(axis=0) / expected.mean()
    assert np.mean(off > 1e-4) < share
    assert total.mean() == pytest.approx(expected.mean(), rel=3e-4)


# --- each layer is the picture of its light alone ---


def test_each_layer_is_the_render_of_its_light_alone(backend: MitsubaBackend) -> None:
    """A Z-test over 8 x 8 blocks, with the variance that eight independent renders of each show."""
    names = ("environment", "sun", "bulb", "rectangle")
    lights = tuple(LIGHTS[name] for name in names)
    together = _repeated(backend, lights)
    for number, light in enumerate(lights):
        mine, alone = together[:, number], _repeated(backend, (light,))[:, 0]
        deviation = np.sqrt((mine.var(axis=0, ddof=1) + alone.var(axis=0, ddof=1)) / len(alone))
        z = (mine.mean(axis=0) - alone.mean(axis=0)) / (deviation + 3e-5 * alone.mean())
        # Student's t with 7 to 14 degrees of freedom has a variance of 7 / 5 to 7 / 6.
        assert np.mean(np.clip(z, -4, 4) ** 2) < 1.7, light.name
        assert abs(np.mean(z)) < 0.3, light.name


def _repeated(backend: MitsubaBackend, lights: tuple[Light, ...]) -> np.ndarray:
    """Render the plastic ball eight times with other random numbers, as blocks of 8 x 8 pixels."""
    job = calibration_job(SURFACES["plastic"], lights, 16)
    scenes = [job.scene.model_copy(update={"index": number}) for number in range(8)]
    return np.array([_blocks(backend.render(replace(job, scene=scene)).radiance) for scene in scenes])


def _blocks(picture: np.ndarray) -> np.ndarray:
    *lead, height, width, _ = picture.shape
    return picture.reshape(*lead, height // 8, 8, width // 8, 8, 3).mean(axis=(-4, -2)).astype(np.float64)


# --- energy ---


FURNACE = {
    "diffuse": ({"roughness": 1.0, "ior": 1.0}, 0.005),
    "metal": ({"roughness": 0.2, "metallic": 1.0}, 0.005),
    "rough_metal": ({"roughness": 0.9, "metallic": 1.0}, 0.005),
    "plastic": ({"roughness": 0.3}, 0.005),
    "rough_plastic": ({"roughness": 0.9}, 0.005),
    "coated": ({"roughness": 0.5, "coat": 1.0, "coat_roughness": 0.3}, 0.005),
    "glass": ({"roughness": 0.0, "transmission": 1.0}, 0.01),
    # Smooth normals on a polyhedron: what refracts to the wrong side of a triangle is lost (Cycles: 6 %).
    "frosted": ({"roughness": 0.5, "transmission": 1.0}, 0.06),
}


@pytest.mark.parametrize("name", FURNACE)
def test_furnace(backend: MitsubaBackend, name: str) -> None:
    """A white ball in uniform light of radiance 1 cannot be seen."""
    fields, tolerance = FURNACE[name]
    body = Body(name="ball", role="object", category="test", geometry=Sphere(radius=1.0),
                materials=(Material(base_color=WHITE, **fields),), world_from_body=matrix4(np.eye(4)))  # fmt: skip
    camera = camera_from_fov(look_at((0, -4, 0), (0, 0, 0)), width=32, height=32, fov=math.radians(20))
    scene = SceneSpec(kind="custom", index=0, bodies=(body,), cameras=(camera,))
    rig = LightRig(lights=(EnvironmentLight(name="sky"),))
    stack = backend.render(RenderJob(scene, rig, RenderSettings(spp=64, max_bounces=32), 0))
    assert stack.geometry.instance_id.all()
    np.testing.assert_allclose(stack.radiance[0].mean(axis=(0, 1)), 1.0, atol=tolerance)


# --- closed forms: pictures on surfaces, see-through ones, sheets ---


BLACK = Material(base_color=(0.0, 0.0, 0.0), roughness=1.0, ior=1.0)


def _seen(
    backend: MitsubaBackend,
    bodies: tuple[Body, ...],
    light: Light,
    camera: Camera,
    *,
    variant: str = "all",
    spp: int = 16,
    threads: int = 2,
) -> LayerStack:
    scene = SceneSpec(kind="custom", index=2, bodies=bodies, cameras=(camera,))
    settings = RenderSettings(spp=spp, max_bounces=2, threads=threads)
    return backend.render(RenderJob(scene, LightRig(lights=(light,)), settings, 0, variant))


def _plate(material: Material, *, height: float = 0.0, size: float = 1.6, insertable: bool = False) -> Body:
    return Body(name="plate", role="object", category="test", geometry=Rectangle(width=size, height=size),
                materials=(material,), world_from_body=matrix4(placed(0, 0, height)),
                insertable=insertable)  # fmt: skip


def test_a_glowing_picture_is_the_picture_that_the_albedo_shows(backend: MitsubaBackend) -> None:
    picture = Texture(image="builtin/wood-ash", repeat=(1.3, 0.7))
    material = Material(base_color=WHITE, base_color_texture=picture, roughness=1.0, ior=1.0)
    light = EmissiveLight(name="glow", body="plate", radiance=(1.0, 2.0, 3.0), texture=picture)
    camera = camera_from_fov(look_at((0.2, -0.5, 1.5), (0, 0, 0)), width=SIZE, height=SIZE, fov=math.radians(30))
    stack = _seen(backend, (_plate(material),), light, camera)
    assert stack.guide_albedo.std() > 0.05
    assert np.abs(stack.radiance[0] / np.array(light.radiance) - stack.guide_albedo).mean() < 2e-3


def test_a_bumpy_plate_is_lit_as_its_normals_say(backend: MitsubaBackend) -> None:
    bumps = Texture(image="builtin/weave-basket-normal", repeat=(0.15, 0.1))
    plate = _plate(Material(base_color=(0.5,) * 3, roughness=1.0, ior=1.0, normal_texture=bumps))
    light = SunLight(name="sun", direction=(0.7, 0.4, -1.0), irradiance=(1.0, 2.0, 3.0), angle=0.0)
    camera = camera_from_fov(look_at((0.0, 0.0, 1.5), (0, 0, 0), up=(0, 1, 0)), width=SIZE, height=SIZE, fov=0.5)
    stack = _seen(backend, (plate,), light, camera)
    towards = -np.array(light.direction) / np.linalg.norm(light.direction)
    expected = 0.5 / math.pi * np.maximum(stack.guide_normal @ towards, 0)[..., None] * np.array(light.irradiance)
    relief = expected.std(axis=(0, 1))
    assert relief.min() > 1e-3
    assert (np.abs(stack.radiance[0] - expected).mean(axis=(0, 1)) < 0.05 * relief).all()


def test_a_see_through_plate_passes_what_its_opacity_leaves(backend: MitsubaBackend) -> None:
    """A quarter of the light stays in a plate of a quarter's opacity, and it covers a quarter of what it hides."""
    pane = _plate(BLACK.model_copy(update={"opacity": 0.25}), height=1.0, size=4.0, insertable=True)
    sun = SunLight(name="sun", direction=(0.0, 0.0, -1.0), irradiance=(1.0, 2.0, 3.0), angle=0.0)
    bare = _seen(backend, (GROUND,), sun, overhead_camera()).radiance[0].mean(axis=(0, 1))
    everything, foreground = (
        _seen(backend, (GROUND, pane), sun, overhead_camera(), variant=variant, spp=64)
        for variant in ("all", "foreground_plate")
    )
    np.testing.assert_allclose(everything.radiance[0].mean(axis=(0, 1)), bare * 0.75**2, rtol=0.02)
    assert foreground.coverage.mean() == pytest.approx(0.25, rel=0.03)
    assert (everything.geometry.instance_id == 1).all()
    assert not everything.geometry.environment.any()


def test_a_sheet_glows_on_both_sides(backend: MitsubaBackend) -> None:
    light = EmissiveLight(name="glow", body="plate", radiance=(1.0, 2.0, 3.0))
    for height in (1.0, -1.0):
        camera = camera_from_fov(look_at((0, 0, height), (0, 0, 0), up=(0, 1, 0)), width=16, height=16, fov=0.5)
        stack = _seen(backend, (_plate(BLACK),), light, camera, spp=1)
        np.testing.assert_allclose(stack.radiance[0], np.broadcast_to(light.radiance, (16, 16, 3)), rtol=1e-5)


def test_threads_change_nothing(backend: MitsubaBackend, library: AssetLibrary) -> None:
    with MitsubaBackend(library) as other:
        one, two = (
            _seen(opened, (GROUND, *BALLS), SKY, oblique_camera(), variant="without_near", spp=2, threads=threads)
            for opened, threads in ((backend, 2), (other, 1))
        )
    np.testing.assert_array_equal(one.radiance, two.radiance)


# --- removed objects ---


def test_removing_a_glowing_object_leaves_other_light_alone(backend: MitsubaBackend) -> None:
    """Unlike a renderer that chooses among the lights, ours gives far pixels exactly what they had."""
    scene = job().scene
    bodies = tuple(b.model_copy(update={"insertable": b.name == "bulb"}) for b in scene.bodies)
    settings = RenderSettings(spp=16, max_bounces=1, threads=2)
    everything, without = (
        backend.render(RenderJob(scene.model_copy(update={"bodies": bodies}), RIG, settings, 0, variant))
        for variant in ("all", "without_bulb")
    )
    glow = RIG.names.index("glow")
    assert everything.radiance[glow].max() > 1
    assert not without.radiance[glow].any()
    far = np.arange(everything.radiance.shape[2]) < 12
    others = [n for n in range(len(RIG.names)) if n != glow]
    changed = (everything.radiance[others] != without.radiance[others]).any(axis=(0, 3))
    # Only paths that ran into the bulb itself.
    assert changed.mean() > 0
    assert changed[:, far].mean() < 0.05


def test_only_paths_that_met_a_glowing_object_are_traced_again(backend: MitsubaBackend) -> None:
    """That a body hides half of its own glow from a point is no reason to trace that point without it."""
    scene = job().scene
    bodies = tuple(b.model_copy(update={"insertable": b.name == "bulb"}) for b in scene.bodies)
    scene = scene.model_copy(update={"bodies": bodies})
    lights = tuple(light for light in RIG.lights if light.name == "glow")
    settings = RenderSettings(spp=4, max_bounces=1, threads=2)
    backend.render(RenderJob(scene, LightRig(lights=lights), settings, 0))
    camera = scene.cameras[0]
    assert backend.synced is not None
    batch = _Batch(backend.synced, Lens(camera), settings, 0, first_blocks(camera.width * camera.height, 4))
    _, result = batch._trace(None, dr.arange(mi.UInt32, camera.width * camera.height * 4))
    lit = np.array(result.first) > 0
    assert 0 < np.mean(np.array(result.met)[lit] != 0) < 0.25


def test_composite_with_one_lighting_is_the_target_at_edges(backend: MitsubaBackend) -> None:
    """Where no shadow, reflection or glow of the object falls, over the rim of the object too, there is no halo."""
    lights = (EnvironmentLight(name="sky", radiance=(0.5, 1.0, 2.0)),)
    body = Body(name="ball", role="object", category="test", geometry=Sphere(radius=0.8), insertable=True,
                materials=(Material(base_color=(0.9, 0.1, 0.1)),), world_from_body=matrix4(np.eye(4)))  # fmt: skip
    wall = Body(name="wall", role="support", category="test", geometry=Rectangle(width=1, height=1),
                materials=(Material(),), world_from_body=matrix4(look_at((0, 60, 0), (0, 61, 0))))  # fmt: skip
    camera = camera_from_fov(look_at((0, -4, 0), (0, 0, 0)), width=48, height=48, fov=math.radians(40))
    scene = SceneSpec(kind="custom", index=0, bodies=(body, wall), cameras=(camera,))
    made = {
        variant: backend.render(RenderJob(scene, LightRig(lights=lights), RenderSettings(spp=32), 0, variant))
        for variant in ("all", "without_ball", "foreground_ball")
    }
    assert made["foreground_ball"].coverage is not None
    coverage = made["foreground_ball"].coverage[..., None]
    edge = (coverage[..., 0] > 0) & (coverage[..., 0] < 1)
    assert edge.sum() > 50
    composite = made["foreground_ball"].radiance[0] + (1 - coverage) * made["without_ball"].radiance[0]
    np.testing.assert_allclose(composite[edge], made["all"].radiance[0][edge], rtol=2e-3, atol=2e-3)


# --- compiled once ---


def test_another_scene_under_other_lights_compiles_nothing(backend: MitsubaBackend) -> None:
    first = calibration_job(SURFACES["plastic"], (LIGHTS["sun"], LIGHTS["bulb"]), 4)
    backend.render(first)
    moved = LIGHTS["bulb"].model_copy(update={"position": (0.3, -0.7, 1.1)})
    lights = (LIGHTS["rectangle"], moved, LIGHTS["spot"], LIGHTS["disk"], LIGHTS["sun"])
    other = calibration_job(SURFACES["textured"], lights, 4)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        backend.render(other)
        kernels = dr.kernel_history((dr.KernelType.JIT,))
    assert kernels
    assert all(kernel["cache_hit"] for kernel in kernels)
