"""Still lifes: objects chosen, arranged on a surface, clothed in materials, and shown to cameras.

What the kinds of scene share. Each kind builds a `Setting`, all that is there before the objects come.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field, PositiveInt, model_validator
from trimesh import Trimesh
from trimesh.collision import CollisionManager

from multilight.scenes.arrays import Float64
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.cameras.paths import CameraSettings, TrajectoryShares, choose_trajectory
from multilight.scenes.cameras.pinhole import matrix4
from multilight.scenes.cameras.trajectory import Subject, TrajectoryError, sample_trajectory
from multilight.scenes.errors import MultilightError
from multilight.scenes.frozen import Frozen, UnitFloat
from multilight.scenes.geometry.rays import SceneRays, body_triangles, surface_points
from multilight.scenes.materials import body_materials
from multilight.scenes.spec import Body, Camera, Role, SceneKind, SceneSpec
from multilight.scenes.still_life.beside import put_beside
from multilight.scenes.still_life.placement import PlacementError, Standing, arrange
from multilight.scenes.still_life.plinths import Raised, raise_some
from multilight.scenes.still_life.selection import choose_objects
from multilight.scenes.still_life.setting import Setting, about_z, make_body
from multilight.scenes.streams import Streams

if TYPE_CHECKING:
    from multilight.scenes.still_life.piles import Pile

ATTEMPTS = 12
PILED = 4
"""Attempts with a pile, where one is wanted, before the scene does without: it takes much of a small table."""
EMISSIVE_SHARE = 0.4
"""Share of the scenes in which an object glows; in five of six of these it is an insertable one: a third of all."""

Choice = tuple[list[Standing], list[int], int | None]
"""Objects, the indices of the insertable ones, and the index of the one that glows."""


class SceneSamplingError(MultilightError):
    """No attempt at a scene succeeded: names the seed, the index and the last reason."""


class StillLifeSettings(Frozen):
    """What every scene of a dataset has in common."""

    width: PositiveInt = 256
    """Image width [pixels]."""
    height: PositiveInt = 256
    """Image height [pixels]."""
    views: PositiveInt = 16
    """Number of cameras."""
    objects: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(le=8)]] = (3, 8)
    """Fewest and most objects of the still life, 1 to 8."""
    insertable: Annotated[int, Field(ge=1, le=8)] = 3
    """Objects whose removal is rendered, 1 to 8."""
    piles: UnitFloat = 0.0
    """Share of the scenes with a pile: fruit in a bowl, books or crockery in a stack, toys in a heap."""
    cameras: CameraSettings = CameraSettings(trajectories=TrajectoryShares(orbit=0, handheld=0, random=0))
    """Trajectories and lenses; unless told, from distant to close."""

    @model_validator(mode="after")
    def _enough_objects(self) -> "StillLifeSettings":
        low, high = self.objects
        if not self.insertable <= low <= high:
            raise ValueError(f"objects {self.objects} must ascend and start at insertable = {self.insertable}")
        return self


@dataclass(frozen=True)
class Plan:
    """What is wanted of a still life in one attempt."""

    attempt: int
    objects: int
    insertable: int
    glows: bool
    piled: bool = False


Chooser = Callable[[np.random.Generator, AssetLibrary, Plan, Setting], Choice]


def choose_for_table(rng: np.random.Generator, library: AssetLibrary, plan: Plan, setting: Setting) -> Choice:
    """Draw objects of table size."""
    area = setting.surface.area
    return choose_objects(rng, library, count=plan.objects, insertable=plan.insertable, area=area, glows=plan.glows)


def sample_still_life(
    streams: Streams,
    library: AssetLibrary,
    build: Callable[[int], Setting],
    *,
    kind: SceneKind,
    index: int,
    settings: StillLifeSettings,
    choose: Chooser = choose_for_table,
) -> SceneSpec:
    """Draw a scene in the setting that `build` makes for each attempt.

    Raises `SceneSamplingError` where no attempt succeeds.
    """
    # What must not depend on whether an attempt fails is drawn once, so that rejection shifts no share.
    basics = streams("basics")
    glows = bool(basics.random() < EMISSIVE_SHARE)
    count = int(basics.integers(settings.objects[0], settings.objects[1] + 1))
    turn = float(basics.uniform(0.0, 2 * np.pi))
    trajectory = choose_trajectory(basics, settings.cameras)
    piled = bool(streams("piles").random() < settings.piles)
    reason: Exception | None = None
    for attempt in range(ATTEMPTS):
        try:
            setting = build(attempt)
            plan = Plan(
                attempt,
                max(settings.insertable, min(count, setting.most)),
                settings.insertable,
                glows,
                piled and attempt < PILED,
            )
            objects, subject = _arranged(streams, library, setting, plan, choose)
            cameras = sample_trajectory(
                streams(f"trajectory/{attempt}"),
                subject,
                width=settings.width,
                height=settings.height,
                views=settings.views,
                kind=trajectory,
                settings=settings.cameras,
            )
        except (PlacementError, TrajectoryError) as error:
            reason = error
            continue
        return _turned(kind, index, (*setting.bodies, *objects), cameras, turn)
    raise SceneSamplingError(
        f"seed {streams.seed}, scene {index}: no attempt of {ATTEMPTS} succeeded; the last: {reason}"
    )


def _arranged(
    streams: Streams, library: AssetLibrary, setting: Setting, plan: Plan, choose: Chooser
) -> tuple[list[Body], Subject]:
    """Choose, arrange and clothe the objects, and say what the cameras should look at."""
    attempt = plan.attempt
    items, chosen, glowing = choose(streams(f"objects/{attempt}"), library, plan, setting)
    rng = streams(f"placement/{attempt}")
    lifted = raise_some(rng, library, items, setting.raised)
    stage = setting.stage(rng)
    # Large things first: small ones find room between them.
    bulk = [np.prod(np.ptp(item.standing.footprint, axis=0)) * rng.uniform(0.6, 1.6) for item in lifted]
    order = [int(i) for i in np.argsort(bulk)[::-1]]
    pile = _pile(streams(f"pile/{attempt}"), library) if plan.piled else None
    group = arrange(rng, [*([pile.standing()] if pile else []), *(lifted[i].standing for i in order)], stage)
    poses = dict(zip(order, group.poses[1 if pile else 0 :], strict=True))
    bodies = _plinths(streams(f"plinths/{attempt}"), library, lifted, poses, stage.height)
    taken = {body.name for body in (*setting.bodies, *bodies)}
    beside = put_beside(streams(f"beside/{attempt}"), setting.beside, group, stage)
    materials = streams(f"materials/{attempt}")
    everything = [*items, *setting.beside]
    places = [*(poses[i] for i in range(len(items))), *beside]
    for i, (item, name) in enumerate(zip(everything, _names(everything, taken), strict=True)):
        clothes = body_materials(materials, library, item.info, item.mesh, glows=i == glowing)
        role: Role = "object" if i < len(items) else "surrounding"
        body = make_body(name, role, item.info, item.mesh, clothes, places[i])
        bodies.append(body.model_copy(update={"insertable": i in chosen}))
    if pile is not None:
        bodies += pile.bodies(materials, library, group.poses[0], taken={b.name for b in (*setting.bodies, *bodies)})
    for body in setting.bodies:
        if body.name in setting.solids:
            group.solids.add_object(body.name, Trimesh(*body_triangles(body, library), process=False).convex_hull)
    return bodies, _subject(streams(f"probes/{attempt}"), library, setting, bodies, group.solids)


def _pile(rng: np.random.Generator, library: AssetLibrary) -> "Pile":
    from multilight.scenes.still_life.piles import sample_pile  # brings the physics, which few scenes need

    return sample_pile(rng, library)


def _plinths(
    rng: np.random.Generator, library: AssetLibrary, items: list[Raised], poses: dict[int, Float64], height: float
) -> list[Body]:
    """Put the plinths where their objects came to stand."""
    bodies: list[Body] = []
    for i, item in enumerate(items):
        if item.plinth is not None:
            pose = poses[i] @ np.linalg.inv(item.standing_from_body)
            pose[2, 3] = height
            mesh = library.mesh(item.plinth.id)
            name = f"plinth_{len(bodies) + 1}"
            bodies.append(make_body(name, "support", item.plinth, mesh, (item.material(rng, library),), pose))
    return bodies


def _subject(
    rng: np.random.Generator,
    library: AssetLibrary,
    setting: Setting,
    added: list[Body],
    solids: CollisionManager,
) -> Subject:
    """Collect what the trajectory must show and avoid."""
    bodies = [*setting.bodies, *added]
    points = {i: surface_points(b, library, rng, 64) for i, b in enumerate(bodies) if b.role == "object"}
    outline = setting.surface.centres
    pose = setting.world_from_surface
    table = np.column_stack([outline, np.full(len(outline), setting.surface.height)]) @ pose[:3, :3].T + pose[:3, 3]
    around = [body for body in setting.bodies if body.name not in setting.solids]
    walls = [vertices[faces] for vertices, faces in (body_triangles(body, library) for body in around)]
    return Subject(
        watched={i: found for i, found in points.items() if bodies[i].insertable},
        group=np.concatenate(list(points.values())),
        table=table[:: max(1, len(table) // 500)],
        rays=SceneRays(bodies, library),
        solids=solids,
        walls=np.concatenate(walls),
        front=setting.front,
        opening=setting.opening,
    )


def _names(items: Sequence[Standing], taken: set[str]) -> list[str]:
    """Name objects after their category: `mug`, `mug_2`; never as a body that is there already."""
    names: list[str] = []
    for item in items:
        plain = re.sub(r"[^a-z0-9]+", "_", item.info.category.lower()).strip("_")[:30]
        plain = plain if plain[:1].isalpha() else f"object_{plain}".rstrip("_")
        name, number = plain, 2
        while name in taken or name in names:
            name, number = f"{plain}_{number}", number + 1
        names.append(name)
    return names


def _turned(kind: SceneKind, index: int, bodies: Sequence[Body], cameras: Sequence[Camera], angle: float) -> SceneSpec:
    """Turn everything about +Z, so that no world axis is special in a dataset."""
    turn = about_z(angle)
    return SceneSpec(
        kind=kind,
        index=index,
        bodies=tuple(
            body.model_copy(update={"world_from_body": matrix4(turn @ np.array(body.world_from_body))})
            for body in bodies
        ),
        cameras=tuple(c.model_copy(update={"c2w": matrix4(turn @ c.pose())}) for c in cameras),
    )
