"""Still lifes: objects chosen, arranged on a surface, given materials, and shown to cameras.

What the kinds of scene share. Each kind builds a `Setting`, all that is there before the objects come.
"""

from collections.abc import Callable
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator
from trimesh import Trimesh
from trimesh.collision import CollisionManager

from multilight.scenes.arrays import Float64
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.cameras.paths import CameraSettings, TrajectoryShares
from multilight.scenes.cameras.trajectory import Subject, sample_trajectory
from multilight.scenes.frozen import UnitFloat
from multilight.scenes.geometry.rays import SceneRays, body_triangles, surface_points
from multilight.scenes.materials import body_materials
from multilight.scenes.names import free_name
from multilight.scenes.poses import apply_pose, rotated_scene
from multilight.scenes.random_streams import Rng, Streams
from multilight.scenes.spec import Body, Role, SceneKind, SceneSpec
from multilight.scenes.still_life.attempts import SceneSettings, first_success
from multilight.scenes.still_life.large_pieces import place_large_pieces
from multilight.scenes.still_life.placement import arrange
from multilight.scenes.still_life.plinths import Raised, raise_some
from multilight.scenes.still_life.selection import Choice, Wanted, choose_objects
from multilight.scenes.still_life.setting import Setting, make_body

ATTEMPTS = 12
PILED = 4
"""Attempts with a pile, where one is wanted, before the scene does without: it takes much of a small table."""
GLOWING = 0.4
"""Probability that an object glows; in five of six such scenes it is an insertable one: a third of all."""


class StillLifeSettings(SceneSettings):
    """What every scene of a dataset has in common."""

    objects: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(le=8)]] = (3, 8)
    """Fewest and most objects of the still life, 1 to 8."""
    piles: UnitFloat = 0.0
    """Probability of a pile: fruit in a bowl, books or crockery in a stack, toys in a heap."""
    cameras: CameraSettings = CameraSettings(trajectories=TrajectoryShares(orbit=0, handheld=0, random=0))
    """Trajectories and lenses; unless told, from distant to close."""

    @model_validator(mode="after")
    def _enough_objects(self) -> "StillLifeSettings":
        low, high = self.objects
        if not self.insertable <= low <= high:
            raise ValueError(f"objects {self.objects} must ascend and start at insertable = {self.insertable}")
        return self


Chooser = Callable[[Rng, AssetLibrary, Wanted, Setting], Choice]


def sample_still_life(
    streams: Streams,
    library: AssetLibrary,
    build: Callable[[int], Setting],
    *,
    kind: SceneKind,
    index: int,
    settings: StillLifeSettings,
    choose: Chooser = choose_objects,
) -> SceneSpec:
    """Draw a scene in the setting that `build` makes for each attempt.

    Raises `SceneSamplingError` where no attempt succeeds.
    """
    basics = streams("basics")
    glows = bool(basics.random() < GLOWING)
    count = int(basics.integers(settings.objects[0], settings.objects[1] + 1))
    angle = float(basics.uniform(0.0, 2 * np.pi))
    trajectory = settings.cameras.trajectories.draw(basics)
    piled = bool(streams("piles").random() < settings.piles)

    def draw(attempt: int) -> SceneSpec:
        setting = build(attempt)
        objects = max(settings.insertable, min(count, setting.most))
        wanted = Wanted(attempt, objects, settings.insertable, glows, piled and attempt < PILED)
        added, subject = _arranged(streams, library, setting, wanted, choose)
        cameras = sample_trajectory(
            streams(f"trajectory/{attempt}"),
            subject,
            width=settings.width,
            height=settings.height,
            views=settings.views,
            kind=trajectory,
            settings=settings.cameras,
        )
        return rotated_scene(kind, index, (*setting.bodies, *added), cameras, angle)

    return first_success(streams, ATTEMPTS, draw)


def _arranged(
    streams: Streams, library: AssetLibrary, setting: Setting, wanted: Wanted, choose: Chooser
) -> tuple[list[Body], Subject]:
    """Choose and arrange the objects, draw their materials, and say what the cameras should look at."""
    attempt = wanted.attempt
    items, chosen, glowing = choose(streams(f"objects/{attempt}"), library, wanted, setting)
    rng = streams(f"placement/{attempt}")
    lifted = raise_some(rng, library, items, setting.raised)
    stage = setting.stage(rng)
    # Large things first: small ones find room between them.
    bulk = [np.prod(np.ptp(item.standing.footprint, axis=0)) * rng.uniform(0.6, 1.6) for item in lifted]
    order = [int(i) for i in np.argsort(bulk)[::-1]]
    pile = None
    if wanted.piled:
        from multilight.scenes.still_life.piles import sample_pile  # brings the physics, which few scenes need

        pile = sample_pile(streams(f"pile/{attempt}"), library)
    group = arrange(rng, [*([pile.standing()] if pile else []), *(lifted[i].standing for i in order)], stage)
    poses = dict(zip(order, group.poses[1 if pile else 0 :], strict=True))
    bodies = _plinths(streams(f"plinths/{attempt}"), library, lifted, poses, stage.height)
    large = place_large_pieces(streams(f"beside/{attempt}"), setting.large_pieces, group, stage)
    taken = {body.name for body in (*setting.bodies, *bodies)}
    materials = streams(f"materials/{attempt}")
    places = [*(poses[i] for i in range(len(items))), *large]
    for i, (item, pose) in enumerate(zip((*items, *setting.large_pieces), places, strict=True)):
        made = body_materials(materials, library, item.info, item.mesh, glows=i == glowing)
        name = free_name(item.info.category, taken, otherwise="object")
        role: Role = "object" if i < len(items) else "surrounding"
        body = make_body(name, role, item.info, item.mesh, made, pose)
        bodies.append(body.model_copy(update={"insertable": i in chosen}))
        taken.add(body.name)
    if pile is not None:
        bodies += pile.bodies(materials, library, group.poses[0], taken=taken)
    for body in setting.bodies:
        if body.name in setting.solids:
            group.solids.add_object(body.name, Trimesh(*body_triangles(body, library), process=False).convex_hull)
    return bodies, _subject(streams(f"probes/{attempt}"), library, setting, bodies, group.solids)


def _plinths(
    rng: Rng, library: AssetLibrary, items: list[Raised], poses: dict[int, Float64], height: float
) -> list[Body]:
    """Put the plinths where their objects came to stand."""
    bodies: list[Body] = []
    for i, item in enumerate(items):
        if item.plinth is not None:
            pose = poses[i] @ np.linalg.inv(item.standing.standing_from_body)
            pose[2, 3] = height
            mesh = library.mesh(item.plinth.id)
            name = f"plinth_{len(bodies) + 1}"
            bodies.append(make_body(name, "support", item.plinth, mesh, (item.material(rng, library),), pose))
    return bodies


def _subject(rng: Rng, library: AssetLibrary, setting: Setting, added: list[Body], solids: CollisionManager) -> Subject:
    """Collect what the trajectory must show and avoid."""
    bodies = [*setting.bodies, *added]
    points = {i: surface_points(b, library, rng, 64) for i, b in enumerate(bodies) if b.role == "object"}
    outline = setting.surface.centres
    level = np.column_stack([outline, np.full(len(outline), setting.surface.height)])
    table = apply_pose(setting.world_from_surface, level)
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
