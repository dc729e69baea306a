"""Nothing of a removed object stays in its background: as bright as what is behind it, mirrored, behind glass, blurred.

Each scene has a red ball and a red board on a blue ground that has their luminance, and their mean over the channels.
What was stored is held to a render with many samples, in small blocks.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest
from scipy.ndimage import binary_erosion

from multilight.datagen.backends.choose import open_backend
from multilight.datagen.backends.machine.mitsuba_variant import choose_variant
from multilight.datagen.backends.protocol import Backend, RenderJob, RenderSettings
from multilight.datagen.production.stopwatch import Stopwatch
from multilight.datagen.production.view import SceneSetup, render_view, shown_in
from multilight.datagen.storage.layers import LayerStack
from multilight.lights.spec import EnvironmentLight, LightRig, PointLight
from multilight.scenes.arrays import Float32
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.cameras.pinhole import matrix4, pixel_rays
from multilight.scenes.spec import Body, Material, Rectangle, SceneSpec, Sphere
from tests.datagen.backends.contract_scenes import body, oblique_camera, placed

pytestmark = pytest.mark.slow

RED, BLUE = (0.75, 0.08, 0.1), (0.1, 0.222, 0.608)
CENTRE, RADIUS = np.array((-0.4, -0.35, 0.25)), 0.25
BOARD_AT, BOARD_SIZE = np.array((0.5, -0.1, 0.01)), np.array((0.9, 0.7))
BALL = body("ball", Sphere(radius=RADIUS), placed(*CENTRE), RED, insertable=True)
BOARD = body("board", Rectangle(width=BOARD_SIZE[0], height=BOARD_SIZE[1]), placed(*BOARD_AT), RED, insertable=True)
FLOOR = body("ground", Rectangle(width=4.0, height=3.0), np.eye(4), BLUE, role="support")
WALL_Y = 0.8
UPRIGHT = np.array([[1, 0, 0, 0], [0, 0, -1, WALL_Y], [0, 1, 0, 0.6], [0, 0, 0, 1.0]])  # +Z of the plate towards -Y
SMOOTH = {"roughness": 0.0, "metallic": 1.0}


def plate(name: str, pose: np.ndarray, material: Material) -> Body:
    geometry = Rectangle(width=3.0, height=1.2)
    return Body(name=name, geometry=geometry, materials=(material,), world_from_body=matrix4(pose), role="surrounding",
                category="test", insertable=False)  # fmt: skip


MIRROR = plate("mirror", UPRIGHT, Material(base_color=(0.9, 0.9, 0.9), **SMOOTH))
IN_FRONT = UPRIGHT + np.array([[0, 0, 0, 0], [0, 0, 0, -1.7 - WALL_Y], [0, 0, 0, 0], [0, 0, 0, 0]])
PANE = plate("pane", IN_FRONT, Material(base_color=(1.0, 1.0, 1.0), roughness=0.0, transmission=1.0, ior=1.01))
LAMP = PointLight(name="lamp", position=(0.4, -0.8, 1.6), intensity=(0.8, 0.8, 0.8))
SKY = EnvironmentLight(name="sky", radiance=(0.3, 0.3, 0.3))
FAINT = PointLight(name="faint", position=(-1.2, -1.2, 0.7), intensity=(2e-4, 2e-4, 2e-4))
RIG = LightRig(lights=(LAMP, SKY, FAINT))


def scene(*more: Body, aperture: float = 0.0) -> SceneSpec:
    camera = oblique_camera()
    if aperture:
        camera = camera.model_copy(update={"aperture_radius": aperture, "focus_distance": 1.0})
    return SceneSpec(kind="spheres", index=0, bodies=(BALL, BOARD, FLOOR, *more), cameras=(camera,))


SCENES = {"open": scene(), "mirror": scene(MIRROR), "glass": scene(PANE), "blurred": scene(aperture=0.05)}


@dataclass
class Subject:
    """A renderer, and what it has rendered before."""

    backend: Backend
    kept: dict[tuple[str, str, int], LayerStack] = field(default_factory=dict)

    def stack(self, place: str, variant: str, spp: int) -> LayerStack:
        key = place, variant, spp
        if key not in self.kept:
            settings = RenderSettings(spp=spp, max_bounces=4, threads=2)
            self.kept[key] = self.backend.render(RenderJob(SCENES[place], RIG, settings, 0, variant))
        return self.kept[key]


@pytest.fixture(scope="module", params=["mitsuba", "cycles"])
def subject(request: pytest.FixtureRequest) -> Iterator[Subject]:
    if request.param == "mitsuba" and choose_variant().variant is None:
        pytest.skip(f"Mitsuba cannot run here: {choose_variant().why}")
    with open_backend(request.param, AssetLibrary()) as backend:
        yield Subject(backend)


Rays = tuple[np.ndarray, np.ndarray]


def mirrored(rays: Rays) -> tuple[Rays, np.ndarray]:
    """The rays that the mirror throws back, and where it does."""
    origins, directions = rays
    at = origins + ((WALL_Y - origins[..., 1]) / directions[..., 1])[..., None] * directions
    there = (np.abs(at[..., 0]) < 1.4) & (at[..., 2] > 0.02) & (at[..., 2] < 1.15) & (directions[..., 1] > 0)
    return (at, directions * (1, -1, 1)), there


def meets_ball(rays: Rays, radius: float = RADIUS) -> np.ndarray:
    away, directions = CENTRE - rays[0], rays[1] / np.linalg.norm(rays[1], axis=-1, keepdims=True)
    along = np.sum(directions * away, axis=-1)
    return (along > 0) & (along**2 > np.sum(away**2, axis=-1) - radius**2)


def meets_board(rays: Rays) -> np.ndarray:
    distance = (BOARD_AT[2] - rays[0][..., 2]) / rays[1][..., 2]
    away = np.abs((rays[0] + distance[..., None] * rays[1] - BOARD_AT)[..., :2])
    return (distance > 0) & (away < BOARD_SIZE / 2).all(axis=-1)


def meets(name: str, rays: Rays) -> np.ndarray:
    """Whether rays meet the ball, or the board and not the ball before it."""
    return meets_ball(rays) if name == "ball" else meets_board(rays) & ~meets_ball(rays)


def seen(name: str, *, mirror: bool) -> np.ndarray:
    """The pixels whose centres show the ball or the board, straight or in the mirror, (H, W)."""
    straight = pixel_rays(oblique_camera())
    direct = meets(name, straight)
    if not mirror:
        return direct
    back, there = mirrored(straight)
    return direct | (there & ~meets_ball(straight) & ~meets_board(straight) & meets(name, back))


@pytest.mark.parametrize("name", ["ball", "board"])
def test_a_mirror_shows_the_object_too(subject: Subject, name: str) -> None:
    variants = ("all", f"without_{name}", f"foreground_{name}")
    all_, without, foreground = (subject.stack("mirror", variant, 16) for variant in variants)
    in_mirror = binary_erosion(seen(name, mirror=True) & ~seen(name, mirror=False))
    assert in_mirror.sum() >= 6
    shown = shown_in(all_, without, foreground)
    assert shown[in_mirror].all()
    assert shown.mean() < 0.6, "the diffuse ground shows nothing"
    assert foreground.coverage is not None
    assert not foreground.coverage[in_mirror].any()


@pytest.mark.parametrize("place", list(SCENES))
@pytest.mark.parametrize("spp", [4, 16])
def test_backgrounds_hold_none_of_the_object(subject: Subject, place: str, spp: int) -> None:
    spec = SCENES[place]
    settings = RenderSettings(spp=spp, max_bounces=4, threads=2)
    setup = SceneSetup(subject.backend, spec, RIG, settings, denoise=True, keep_raw=False)
    made = render_view(setup, 0, Stopwatch()).data
    everything = subject.stack(place, "all", 256).radiance
    for name in spec.insertable:
        where = seen(name, mirror=place == "mirror") | (made.coverage[name] > 0)
        truth = subject.stack(place, f"without_{name}", 256).radiance
        stored = made.variants[f"without_{name}"]
        for light, *(own, true, present) in zip(RIG.names, stored, truth, everything, strict=True):
            left = list(shares_left(own, true, present, where))
            assert left, (name, light)
            assert max(left) < 0.35, (name, light)


def shares_left(stored: Float32, true: Float32, present: Float32, where: np.ndarray, side: int = 6) -> Iterator[float]:
    """Yield how much of the object's contrast is left, in each block that it differs in from what lies behind it."""
    for top in range(0, where.shape[0], side):
        for left in range(0, where.shape[1], side):
            at = np.s_[top : top + side, left : left + side]
            mask = where[at]
            if mask.sum() < side * side // 2:
                continue
            off, contrast = ((p[at][mask] - true[at][mask]).mean(axis=0) for p in (stored, present))
            if np.abs(contrast).max() > 0.2 * true[at][mask].mean():
                yield float(off @ contrast / (contrast @ contrast))
