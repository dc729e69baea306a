"""Standing objects on a table: resting poses, stability, and a clustered still life without interpenetration."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation
from trimesh import Trimesh
from trimesh.collision import CollisionManager

from multilight.scenes.arrays import Float64
from multilight.scenes.assets.info import AssetInfo
from multilight.scenes.errors import MultilightError
from multilight.scenes.geometry.solids import Solid
from multilight.scenes.geometry.support_surfaces import SupportSurface, convex_polygon, inside_convex, stacked_faces
from multilight.scenes.meshes import Mesh

CONTACT = 6e-4
"""Vertices this close [m] to the lowest one carry the object: less than what counts as contact (`geometry.contact`)."""
TIPPING, TIPS = np.radians(6.0), 16
"""How far [rad] something may tip to find its rest, and on how many faces it tries."""
GAP = 0.004
"""Smallest distance [m] between the convex hulls of two objects."""
EDGE = 0.015
"""Smallest distance [m] of a footprint to the edge of the table's free surface."""
CANDIDATES = 48
BLOCKS = frozenset({"block", "blocks", "box", "boxes", "carton", "cube", "dice", "die"})
"""Categories whose members may lie on any face that carries them."""


class PlacementError(MultilightError):
    """The objects drawn do not fit the table."""


@dataclass(frozen=True)
class Standing:
    """An object in a resting pose: lowest point at z = 0, upright axis through the origin.

    `hull` is its convex hull in that pose [m]; `turn` (3, 3) takes the asset's frame there, followed by a lift [m]
    along +Z; `footprint` (N, 2) is the counter-clockwise outline seen from above.
    """

    info: AssetInfo
    mesh: Mesh
    hull: Trimesh
    turn: Float64
    lift: float
    footprint: Float64

    @property
    def height(self) -> float:
        """Height in this pose [m]."""
        return float(self.hull.bounds[1, 2])


@dataclass
class Arrangement:
    """A still life, finished or in the making: `world_from_body` (4, 4) of each object, and its solids.

    `solids` holds the convex hulls where they stand in the world, `footprints` their outlines seen from above.
    """

    solids: CollisionManager = field(default_factory=CollisionManager)
    footprints: list[Float64] = field(default_factory=list)
    poses: list[Float64] = field(default_factory=list)


@dataclass(frozen=True)
class Stage:
    """Where the still life goes, in the world: the surface, its pose, the focus point and the camera's side.

    world_from_table (4, 4); `focus` (2,) metres; `front` (2,) unit vector from the table towards the cameras.
    """

    surface: SupportSurface
    world_from_table: Float64
    focus: Float64
    front: Float64

    @property
    def height(self) -> float:
        """Height of the surface in the world [m]."""
        return float(self.surface.height + self.world_from_table[2, 3])

    def supports(self, polygon: Float64) -> bool:
        """Tell whether a polygon in the world (N, 2) [m] stands wholly on the surface."""
        local = (polygon - self.world_from_table[:2, 3]) @ self.world_from_table[:2, :2]
        return self.surface.supports(local, EDGE)


def resting_poses(info: AssetInfo, mesh: Mesh) -> list[Standing]:
    """Return the poses in which an asset rests: as it comes, and for blocks on each face that carries it.

    What stands unevenly as it comes (a shoe, a bag) tips over by a few degrees on to the face of its hull that
    carries it.
    """
    vertices, faces = mesh.vertices().astype(np.float64), stacked_faces(mesh)
    hull = Trimesh(vertices, faces, process=False).convex_hull
    centre = Solid(vertices, faces).centre_of_mass
    turns = [np.eye(3)]
    if info.category in BLOCKS:
        normals = hull.facets_normal[hull.facets_area > 0.08 * hull.area]
        turns += [
            Rotation.align_vectors([[0, 0, -1]], [normal])[0].as_matrix() for normal in normals if normal[2] > -0.99
        ]
    standing = [pose for turn in turns if (pose := _standing(info, mesh, hull, centre, turn)) is not None]
    if standing:
        return standing
    tipped = (_standing(info, mesh, hull, centre, turn) for turn in _tipping(hull))
    return [pose for pose in tipped if pose is not None][:1]


def _tipping(hull: Trimesh) -> Iterator[Float64]:
    """Yield the turns (3, 3) that put a face on the ground which all but lies there already, the flattest first."""
    normals = np.asarray(hull.face_normals)
    for face in np.argsort(normals[:, 2])[:TIPS]:
        if normals[face, 2] < -np.cos(TIPPING):
            yield Rotation.align_vectors([[0, 0, -1]], [normals[face]])[0].as_matrix()


def _standing(info: AssetInfo, mesh: Mesh, hull: Trimesh, centre: Float64, turn: Float64) -> Standing | None:
    """Put a hull down in a pose; None where its centre of mass lies outside the points that carry it."""
    vertices = mesh.vertices().astype(np.float64) @ turn.T
    lowest = float(vertices[:, 2].min())
    carried = convex_polygon(vertices[vertices[:, 2] <= lowest + CONTACT, :2])
    footprint = convex_polygon(np.asarray(hull.vertices) @ turn.T[:, :2])
    if carried is None or footprint is None or not inside_convex(carried, (turn @ centre)[:2]):
        return None
    posed = hull.copy()
    posed.apply_transform(_pose(turn, np.array([0.0, 0.0, -lowest])))
    return Standing(info, mesh, posed, turn, -lowest, footprint)


def _pose(turn: Float64, offset: Float64) -> Float64:
    """Build a 4x4 matrix."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, offset
    return pose


def _yaw(angle: float) -> Float64:
    """Turn about +Z, (3, 3)."""
    return np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])


def arrange(rng: np.random.Generator, objects: Sequence[Standing], stage: Stage) -> Arrangement:
    """Group objects closely about the focus, in the order given.

    Every object stands wholly on the surface, at least `GAP` from all others, most 1 to 12 cm from a neighbour.
    Tall ones tend to the back, low ones to the front. Raises `PlacementError` where one finds no place.
    """
    group = Arrangement()
    for index, item in enumerate(objects):
        best: tuple[float, Float64, Float64] | None = None
        probe = CollisionManager()
        probe.add_object("probe", item.hull)
        for _ in range(CANDIDATES):
            turn = _yaw(_facing(rng, stage.front))
            footprint = item.footprint @ turn[:2, :2].T
            spot = _spot(rng, group.footprints, footprint, stage.focus)
            cost = _cost(rng, item, spot, stage)
            pose = _pose(turn, np.array([*spot, stage.height]))
            if (best is None or cost < best[0]) and stage.supports(footprint + spot) and _clear(probe, pose, group):
                best = (cost, pose, footprint + spot)
        if best is None:
            raise PlacementError(f"no free place for {item.info.id} among {index} objects")
        _, pose, footprint = best
        group.solids.add_object(str(index), item.hull, pose)
        group.footprints.append(footprint)
        hover = rng.uniform(0.0, 0.0003)
        group.poses.append(pose @ _pose(item.turn, np.array([0.0, 0.0, item.lift + hover])))
    return group


def _facing(rng: np.random.Generator, front: Float64) -> float:
    """Draw a yaw [rad]: three in four turn their front (-Y, as assets come) roughly to the cameras."""
    if rng.random() < 0.25:
        return float(rng.uniform(0.0, 2 * np.pi))
    return float(np.arctan2(front[1], front[0]) + np.pi / 2 + rng.normal(0.0, 0.8))


def _spot(rng: np.random.Generator, footprints: list[Float64], footprint: Float64, focus: Float64) -> Float64:
    """Draw a place 1 to 12 cm beside one of the objects that stand already (the first: near the focus)."""
    if not footprints:
        return focus + rng.normal(0.0, 0.02, 2)
    anchor = footprints[int(rng.integers(len(footprints)))]
    angle = rng.uniform(0.0, 2 * np.pi)
    way = np.array([np.cos(angle), np.sin(angle)])
    # Two convex outlines whose extents along `way` do not overlap are at least `gap` apart.
    gap = 0.01 + 0.11 * rng.beta(1.0, 2.5)
    reach = float((anchor @ way).max() - (footprint @ way).min()) + gap
    across = np.array([-way[1], way[0]])
    slide = float(anchor.mean(axis=0) @ across) + rng.normal(0.0, 0.02)
    return way * reach + across * slide


def _cost(rng: np.random.Generator, item: Standing, spot: Float64, stage: Stage) -> float:
    """Rate a place: near the focus, tall things behind, low ones in front, with some chance."""
    offset = spot - stage.focus
    forward = float(offset @ stage.front)
    tallness = np.clip((item.height - 0.12) / 0.12, -1.0, 1.5)
    return float(np.linalg.norm(offset) + 0.7 * tallness * forward + rng.uniform(0.0, 0.08))


def _clear(probe: CollisionManager, pose: Float64, group: Arrangement) -> bool:
    """Tell whether an object in that pose keeps its distance from all that stand already."""
    if not group.footprints:
        return True
    probe.set_transform("probe", pose)
    return bool(group.solids.min_distance_other(probe) >= GAP)
