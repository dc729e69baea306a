"""Room scenes: a furnished room, things lying about in it, and cameras inside."""

import numpy as np

from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.cameras.paths import CameraSettings, TrajectoryShares
from multilight.scenes.frozen import UnitFloat
from multilight.scenes.geometry.rays import SceneRays, extreme_points, surface_points
from multilight.scenes.kinds.rooms.clutter import GLOWING, Objects, insert, litter
from multilight.scenes.kinds.rooms.finish import sample_palette
from multilight.scenes.kinds.rooms.groups import place_openings
from multilight.scenes.kinds.rooms.layouts import FURNISH, SPANS, RoomType
from multilight.scenes.kinds.rooms.plan import Plan
from multilight.scenes.kinds.rooms.shell import sample_shell, shell_bodies
from multilight.scenes.kinds.rooms.views import Room, sample_views
from multilight.scenes.poses import rotated_scene
from multilight.scenes.random_streams import Rng, Streams, Weights
from multilight.scenes.spec import SceneSpec
from multilight.scenes.still_life.attempts import SceneSettings, first_success

ATTEMPTS = 16


class RoomWeights(Weights[RoomType]):
    """How often each type of room comes, relative to the others."""

    living: UnitFloat = 0.35
    """Living rooms."""
    kitchen: UnitFloat = 0.25
    """Kitchens to eat in."""
    bedroom: UnitFloat = 0.2
    """Bedrooms."""
    study: UnitFloat = 0.2
    """Studies."""


class RoomSettings(SceneSettings):
    """What every room scene of a dataset has in common."""

    rooms: RoomWeights = RoomWeights()
    """Types of room."""
    cameras: CameraSettings = CameraSettings(trajectories=TrajectoryShares(orbit=0, handheld=0), lens_mm=(24.0, 50.0))
    """Trajectories and lenses; unless told, walks from distant to close and single standpoints."""


def sample_room(streams: Streams, library: AssetLibrary, *, index: int, settings: RoomSettings) -> SceneSpec:
    """Draw a furnished room; the same streams, assets and settings give the same scene anywhere.

    Nothing lies in anything else, everything stands or hangs, doors can be opened, and every insertable object is in
    frame and visible in most views. Raises `SceneSamplingError` where no attempt succeeds.
    """
    basics = streams("basics")
    kind = settings.rooms.draw(basics)
    glows = bool(basics.random() < GLOWING)
    angle = float(basics.uniform(0.0, 2 * np.pi))
    path = settings.cameras.trajectories.draw(basics)

    def draw(attempt: int) -> SceneSpec:
        plan, names = _furnished(streams, library, kind, attempt, settings.insertable, glows)
        cameras = sample_views(
            streams(f"views/{attempt}"),
            _room(streams(f"probes/{attempt}"), library, plan, names),
            size=(settings.width, settings.height),
            views=settings.views,
            kind=path,
            settings=settings.cameras,
        )
        bodies = [body.model_copy(update={"insertable": body.name in names}) for body in plan.bodies]
        return rotated_scene("room", index, bodies, cameras, angle)

    return first_success(streams, ATTEMPTS, draw)


def _furnished(
    streams: Streams, library: AssetLibrary, kind: RoomType, attempt: int, count: int, glows: bool
) -> tuple[Plan, list[str]]:
    """Build and furnish a room; also returns the names of what is inserted."""
    rng = streams(f"shell/{attempt}")
    palette = sample_palette(rng, library)
    shell = sample_shell(rng, library, span=SPANS[kind])
    bodies = shell_bodies(rng, library, shell, palette, kind)
    plan = Plan(streams(f"furniture/{attempt}"), library, shell, palette, bodies)
    place_openings(plan)
    plan.keep_doors_free()
    FURNISH[kind](plan)
    objects = Objects(plan)
    names = insert(streams(f"objects/{attempt}"), objects, kind, count, glows)
    litter(streams(f"clutter/{attempt}"), objects, kind)
    return plan, names


def _room(probes: Rng, library: AssetLibrary, plan: Plan, names: list[str]) -> Room:
    """Collect what cameras must show and avoid."""
    watched = {
        index: np.concatenate([surface_points(body, library, probes, 48), extreme_points(body, library)])
        for index, body in enumerate(plan.bodies)
        if body.name in names
    }
    placed = list(plan.placed.values())
    return Room(
        watched=watched,
        rays=SceneRays(plan.bodies, library),
        low=np.array([p.low for p in placed]),
        high=np.array([p.high for p in placed]),
        half=np.array([plan.shell.width, plan.shell.depth]) / 2,
        height=plan.shell.height,
    )
