"""Room scenes: a furnished room, things lying about in it, and cameras inside."""

from typing import Annotated

import numpy as np
from pydantic import Field, PositiveInt, model_validator

from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.cameras.paths import CameraSettings, TrajectoryShares, choose_trajectory
from multilight.scenes.cameras.pinhole import matrix4
from multilight.scenes.cameras.trajectory import TrajectoryError
from multilight.scenes.frozen import Frozen, UnitFloat
from multilight.scenes.geometry.rays import SceneRays, extreme_points, surface_points
from multilight.scenes.kinds.rooms.clutter import EMISSIVE_SHARE, Objects, insert, litter
from multilight.scenes.kinds.rooms.finish import sample_palette
from multilight.scenes.kinds.rooms.groups import place_openings
from multilight.scenes.kinds.rooms.layouts import FURNISH, SPANS, RoomType
from multilight.scenes.kinds.rooms.plan import Plan, pose_at
from multilight.scenes.kinds.rooms.shell import sample_shell, shell_bodies
from multilight.scenes.kinds.rooms.views import Room, sample_views
from multilight.scenes.spec import Body, Camera, SceneSpec
from multilight.scenes.still_life.placement import PlacementError
from multilight.scenes.still_life.sample import SceneSamplingError
from multilight.scenes.streams import Streams

ATTEMPTS = 16


class RoomShares(Frozen):
    """How often each type of room comes, relative to the others."""

    living: UnitFloat = 0.35
    """Living rooms."""
    kitchen: UnitFloat = 0.25
    """Kitchens to eat in."""
    bedroom: UnitFloat = 0.2
    """Bedrooms."""
    study: UnitFloat = 0.2
    """Studies."""

    @model_validator(mode="after")
    def _some_share(self) -> "RoomShares":
        if not self.living + self.kitchen + self.bedroom + self.study > 0:
            raise ValueError("at least one type of room needs a share above 0")
        return self


class RoomSettings(Frozen):
    """What every room scene of a dataset has in common."""

    width: PositiveInt = 256
    """Image width [pixels]."""
    height: PositiveInt = 256
    """Image height [pixels]."""
    views: PositiveInt = 16
    """Number of cameras."""
    insertable: Annotated[int, Field(ge=1, le=8)] = 3
    """Objects whose removal is rendered, 1 to 8."""
    rooms: RoomShares = RoomShares()
    """Types of room."""
    cameras: CameraSettings = CameraSettings(trajectories=TrajectoryShares(orbit=0, handheld=0), lens_mm=(24.0, 50.0))
    """Trajectories and lenses; unless told, walks from distant to close and single standpoints."""


def sample_room(streams: Streams, library: AssetLibrary, *, index: int, settings: RoomSettings) -> SceneSpec:
    """Draw a furnished room; the same streams, assets and settings give the same scene anywhere.

    Nothing lies in anything else, everything stands or hangs, doors can be opened, and every insertable object is in
    frame and visible in most views. Raises `SceneSamplingError` where no attempt succeeds.
    """
    # What must not depend on whether an attempt fails is drawn once, so that rejection shifts no share.
    basics = streams("basics")
    shares = settings.rooms.model_dump()
    weights = np.array(list(shares.values()))
    kind: RoomType = list(FURNISH)[int(basics.choice(len(weights), p=weights / weights.sum()))]
    glows = bool(basics.random() < EMISSIVE_SHARE)
    turn = float(basics.uniform(0.0, 2 * np.pi))
    path = choose_trajectory(basics, settings.cameras)
    reason: Exception | None = None
    for attempt in range(ATTEMPTS):
        try:
            plan, names = _furnished(streams, library, kind, attempt, settings.insertable, glows)
            cameras = sample_views(
                streams(f"views/{attempt}"),
                _room(streams(f"probes/{attempt}"), library, plan, names),
                size=(settings.width, settings.height),
                views=settings.views,
                kind=path,
                settings=settings.cameras,
            )
        except (PlacementError, TrajectoryError) as error:
            reason = error
            continue
        chosen = set(names)
        bodies = [body.model_copy(update={"insertable": body.name in chosen}) for body in plan.bodies]
        return _turned(index, bodies, cameras, turn)
    raise SceneSamplingError(
        f"seed {streams.seed}, scene {index}: no attempt of {ATTEMPTS} succeeded; the last: {reason}"
    )


def _furnished(
    streams: Streams, library: AssetLibrary, kind: RoomType, attempt: int, count: int, glows: bool
) -> tuple[Plan, list[str]]:
    """Build and furnish a room; also returns the names of what is inserted."""
    rng = streams(f"shell/{attempt}")
    palette = sample_palette(rng, library)
    shell = sample_shell(rng, library, span=SPANS[kind])
    plan = Plan(library, shell, palette, shell_bodies(rng, library, shell, palette, kind))
    place_openings(rng, plan)
    plan.keep_doors_free()
    FURNISH[kind](streams(f"furniture/{attempt}"), plan)
    objects = Objects(plan)
    names = insert(streams(f"objects/{attempt}"), objects, kind, count, glows)
    litter(streams(f"clutter/{attempt}"), objects, kind)
    return plan, names


def _room(probes: np.random.Generator, library: AssetLibrary, plan: Plan, names: list[str]) -> Room:
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


def _turned(index: int, bodies: list[Body], cameras: tuple[Camera, ...], angle: float) -> SceneSpec:
    """Turn everything about +Z, so that no world axis is special in a dataset."""
    turn = pose_at((0.0, 0.0), 0.0, angle)
    poses = [matrix4(turn @ np.array(body.world_from_body)) for body in bodies]
    return SceneSpec(
        kind="room",
        index=index,
        bodies=tuple(b.model_copy(update={"world_from_body": pose}) for b, pose in zip(bodies, poses, strict=True)),
        cameras=tuple(camera.model_copy(update={"c2w": matrix4(turn @ camera.pose())}) for camera in cameras),
    )
