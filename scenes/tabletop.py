"""Tabletop scenes: a table in a surrounding, a still life on it, and cameras that approach it."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PositiveInt, model_validator
from trimesh import Trimesh
from trimesh.collision import CollisionManager

from scenes.assets.info import AssetInfo
from scenes.assets.library import AssetLibrary
from scenes.cameras import matrix4
from scenes.frozen import Frozen
from scenes.materials import GLOW, body_materials, metres_per_uv, pick_texture, textured
from scenes.meshes import Mesh
from scenes.placement import PlacementError, Stage, Standing, arrange
from scenes.rays import SceneRays, body_triangles, surface_points
from scenes.selection import choose_objects, choose_table
from scenes.spec import Body, Camera, Material, MeshAsset, Role, SceneSpec
from scenes.streams import Streams
from scenes.support import SupportSurface
from scenes.surroundings import KINDS, SHARES, Surrounding, SurroundingKind, sample_surrounding
from scenes.trajectory import Subject, TrajectoryError, sample_trajectory

ATTEMPTS = 12
EMISSIVE_SHARE = 1 / 3
_TOPS = frozenset({"wood", "marble", "linen", "fabric", "laminate", "stone", "terrazzo"})
_BACKED = frozenset({"counter", "nightstand", "sideboard"})
"""Furniture that turns its back to the wall."""
_TOP_FINISH = {"marble": "stone", "terrazzo": "stone", "stone": "stone", "linen": "fabric", "fabric": "fabric"}

Float64 = NDArray[np.float64]


class SceneSamplingError(RuntimeError):
    """No attempt at a scene succeeded: names the seed, the index and the last reason."""


class TabletopSettings(Frozen):
    """What every tabletop scene of a dataset has in common."""

    width: PositiveInt = 256
    """Image width [pixels]."""
    height: PositiveInt = 256
    """Image height [pixels]."""
    views: PositiveInt = 16
    """Number of cameras, from distant to close."""
    objects: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(le=8)]] = (3, 8)
    """Fewest and most objects on the table, 1 to 8."""
    insertable: Annotated[int, Field(ge=1, le=8)] = 3
    """Objects whose removal is rendered, 1 to 8."""

    @model_validator(mode="after")
    def _enough_objects(self) -> "TabletopSettings":
        low, high = self.objects
        if not self.insertable <= low <= high:
            raise ValueError(f"objects {self.objects} must ascend and start at insertable = {self.insertable}")
        return self


@dataclass(frozen=True)
class _Plan:
    """What is wanted of a still life in one attempt."""

    attempt: int
    objects: int
    insertable: int
    glows: bool


@dataclass(frozen=True)
class _Set:
    """The table where it stands, and what is around it."""

    table: Body
    surface: SupportSurface
    surrounding: Surrounding

    def stage(self, rng: np.random.Generator) -> Stage:
        """Choose the focus of the still life: well inside the surface, rather towards the cameras."""
        pose = np.array(self.table.world_from_body)
        front = np.array([np.cos(self.surrounding.front), np.sin(self.surrounding.front)])
        room = self.surface.clearance[self.surface.free]
        inner = self.surface.centres[room >= 0.9 * min(0.34, float(room.max()))]
        world = inner @ pose[:2, :2].T + pose[:2, 3]
        forward = world @ front
        near = world[forward >= np.quantile(forward, 0.5)]
        return Stage(self.surface, pose, near[int(rng.integers(len(near)))], front)


def sample_tabletop(streams: Streams, library: AssetLibrary, *, index: int, settings: TabletopSettings) -> SceneSpec:
    """Draw a tabletop scene; the same streams, assets and settings give the same scene anywhere.

    Raises `SceneSamplingError` where no attempt succeeds.
    """
    # What must not depend on whether an attempt fails is drawn once, so that rejection shifts no share.
    basics = streams("basics")
    kind = KINDS[int(basics.choice(len(KINDS), p=SHARES))]
    glows = bool(basics.random() < EMISSIVE_SHARE)
    count = int(basics.integers(settings.objects[0], settings.objects[1] + 1))
    turn = float(basics.uniform(0.0, 2 * np.pi))
    reason: Exception | None = None
    for attempt in range(ATTEMPTS):
        try:
            scenery = _scenery(streams, library, kind, attempt)
            plan = _Plan(attempt, count, settings.insertable, glows)
            objects, subject = _still_life(streams, library, scenery, plan)
            cameras = sample_trajectory(
                streams(f"trajectory/{attempt}"),
                subject,
                width=settings.width,
                height=settings.height,
                views=settings.views,
            )
        except (PlacementError, TrajectoryError) as error:
            reason = error
            continue
        return _turned(index, (*scenery.surrounding.bodies, scenery.table, *objects), cameras, turn)
    raise SceneSamplingError(
        f"seed {streams.seed}, scene {index}: no attempt of {ATTEMPTS} succeeded; the last: {reason}"
    )


def _scenery(streams: Streams, library: AssetLibrary, kind: SurroundingKind, attempt: int) -> _Set:
    """Draw the table and what is around it."""
    rng = streams(f"table/{attempt}")
    info, mesh, surface = choose_table(rng, library)
    table = _table(rng, library, info, mesh, surface, aligned=kind != "ground")
    corners = body_triangles(table, library)[0]
    extent = np.stack([corners.min(axis=0), corners.max(axis=0)])
    around = sample_surrounding(streams(f"surrounding/{attempt}"), library, kind=kind, table=extent)
    return _Set(table, surface, around)


def emissive_candidate(scene: SceneSpec) -> tuple[str, int] | None:
    """Return the name of the body, and the part of it, that is meant to shine; None where nothing is.

    The rule: its material is named `scenes.materials.GLOW`.
    """
    for body in scene.bodies:
        for part, material in enumerate(body.materials):
            if material.name == GLOW:
                return body.name, part
    return None


def _table(
    rng: np.random.Generator,
    library: AssetLibrary,
    info: AssetInfo,
    mesh: Mesh,
    surface: SupportSurface,
    *,
    aligned: bool,
) -> Body:
    """Put the table down, parallel to the walls where there are any, and draw its materials."""
    materials = list(body_materials(rng, library, info, mesh))
    scale = metres_per_uv(mesh.parts[surface.part])
    texture = pick_texture(rng, library, _TOPS, laid=False)
    if texture is not None and scale is not None and rng.random() < 0.5:
        finish = _TOP_FINISH.get(texture.category, "wood")
        materials[surface.part] = textured(rng, texture, finish, metres_per_uv=scale)
    if aligned and info.category in _BACKED:
        angle = 0.0
    elif aligned:
        long_side = bool(np.ptp(mesh.bounds()[:, 0]) >= np.ptp(mesh.bounds()[:, 1]))
        quarter = 0 if long_side == bool(rng.random() < 0.85) else 1
        angle = np.pi / 2 * (quarter + 2 * int(rng.integers(2)))
    else:
        angle = float(rng.uniform(0.0, 2 * np.pi))
    return _body("table", "support", info, mesh, materials, _about_z(angle))


def _still_life(streams: Streams, library: AssetLibrary, scenery: _Set, plan: _Plan) -> tuple[list[Body], Subject]:
    """Choose, arrange and clothe the objects, and say what the cameras should look at."""
    attempt = plan.attempt
    items, chosen, glowing = choose_objects(
        streams(f"objects/{attempt}"),
        library,
        count=plan.objects,
        insertable=plan.insertable,
        area=scenery.surface.area,
        glows=plan.glows,
    )
    rng = streams(f"placement/{attempt}")
    stage = scenery.stage(rng)
    # Large things first: small ones find room between them.
    bulk = [np.prod(np.ptp(item.footprint, axis=0)) * rng.uniform(0.6, 1.6) for item in items]
    order = [int(i) for i in np.argsort(bulk)[::-1]]
    group = arrange(rng, [items[i] for i in order], stage)
    poses = dict(zip(order, group.poses, strict=True))
    materials = streams(f"materials/{attempt}")
    bodies = []
    for i, name in enumerate(_names(items, taken={"table"} | {body.name for body in scenery.surrounding.bodies})):
        item = items[i]
        clothes = body_materials(materials, library, item.info, item.mesh, glows=i == glowing)
        body = _body(name, "object", item.info, item.mesh, clothes, poses[i])
        bodies.append(body.model_copy(update={"insertable": i in chosen}))
    hull = Trimesh(*body_triangles(scenery.table, library), process=False).convex_hull
    group.solids.add_object("table", hull)
    return bodies, _subject(streams(f"probes/{attempt}"), library, scenery, bodies, group.solids)


def _subject(
    rng: np.random.Generator,
    library: AssetLibrary,
    scenery: _Set,
    objects: list[Body],
    solids: CollisionManager,
) -> Subject:
    """Collect what the trajectory must show and avoid."""
    bodies = [*scenery.surrounding.bodies, scenery.table, *objects]
    first = len(bodies) - len(objects)
    points = [surface_points(body, library, rng, 64) for body in objects]
    outline = scenery.surface.centres
    pose = np.array(scenery.table.world_from_body)
    table = np.column_stack([outline, np.full(len(outline), scenery.surface.height)]) @ pose[:3, :3].T + pose[:3, 3]
    walls = [vertices[faces] for vertices, faces in (body_triangles(b, library) for b in scenery.surrounding.bodies)]
    return Subject(
        watched={first + i: points[i] for i, body in enumerate(objects) if body.insertable},
        group=np.concatenate(points),
        table=table[:: max(1, len(table) // 500)],
        rays=SceneRays(bodies, library),
        solids=solids,
        walls=np.concatenate(walls),
        front=scenery.surrounding.front,
        opening=scenery.surrounding.opening,
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


def _body(name: str, role: Role, info: AssetInfo, mesh: Mesh, materials: Sequence[Material], pose: Float64) -> Body:
    """Make a body of a library asset."""
    return Body(
        name=name,
        role=role,
        category=info.category,
        geometry=MeshAsset(asset=info.id, mesh_sha256=mesh.sha256(), parts=len(mesh.parts)),
        materials=tuple(materials),
        world_from_body=matrix4(pose),
    )


def _about_z(angle: float) -> Float64:
    """Return the rotation (4, 4) about +Z by `angle` [rad]."""
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return turn


def _turned(index: int, bodies: Sequence[Body], cameras: Sequence[Camera], angle: float) -> SceneSpec:
    """Turn everything about +Z, so that no world axis is special in a dataset."""
    turn = _about_z(angle)
    return SceneSpec(
        kind="tabletop",
        index=index,
        bodies=tuple(
            body.model_copy(update={"world_from_body": matrix4(turn @ np.array(body.world_from_body))})
            for body in bodies
        ),
        cameras=tuple(c.model_copy(update={"c2w": matrix4(turn @ c.pose())}) for c in cameras),
    )
