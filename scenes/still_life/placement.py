"""Standing objects on a table: resting poses, stability, and a clustered still life without interpenetration."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation
from trimesh import Trimesh
from trimesh.collision import CollisionManager

from multilight.scenes.arrays import Float64
from multilight.scenes.assets.info import AssetInfo
from multilight.scenes.errors import MultilightError
from multilight.scenes.geometry.solids import solid_of
from multilight.scenes.geometry.support_surfaces import SupportSurface, convex_hull, convex_polygon, stands
from multilight.scenes.meshes import Mesh, once_a_mesh
from multilight.scenes.poses import about_z, pose_of
from multilight.scenes.random_streams import Rng

CONTACT = 6e-4
"""Vertices this close [m] to the lowest one carry the object: less than what counts as contact (`geometry.contact`)."""
GAP, EDGE = 0.004, 0.015
"""Smallest distance [m] between the convex hulls of two objects, and of a footprint to the edge of a free surface."""
# How things lie [m, rad].
TIPPING, TIPS = np.radians(6.0), 16  # how far something may tip to find its rest, on how many faces it tries
FACET = 0.08  # fraction of a block's hull that a face must have to lie on
CANDIDATES = 48  # poses of an object, of which the cheapest free one is taken
NEAREST, FURTHEST = 0.01, 0.12  # from the object beside which one is put: a group that one looks at together
HOVER = 0.0003  # air below objects at most: no two surfaces coincide, and none is seen to float
AVERTED, SLACK = 0.25, 0.8  # objects that look anywhere [probability]; the others' deviation from the cameras
BLOCKS = frozenset({"block", "blocks", "box", "boxes", "carton", "cube", "dice", "die"})
"""Categories whose members may lie on any face that carries them."""


class PlacementError(MultilightError):
    """The objects drawn do not fit the table."""


@dataclass(frozen=True)
class Standing:
    """An object in a resting pose: lowest point at z = 0, upright axis through the origin.

    `hull` is its convex hull in that pose [m]; `rotation` (3, 3) takes the asset's frame there, followed by a lift [m]
    along +Z; `footprint` (N, 2) is the counter-clockwise outline seen from above.
    """

    info: AssetInfo
    mesh: Mesh
    hull: Trimesh
    rotation: Float64
    lift: float
    footprint: Float64

    @property
    def standing_from_body(self) -> Float64:
        """The pose (4, 4) that takes the asset's frame to this one."""
        return pose_of(self.rotation, (0.0, 0.0, self.lift))

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


@once_a_mesh
def resting_poses(mesh: Mesh, info: AssetInfo) -> list[Standing]:
    """Return the poses in which an asset rests: as it comes, and for blocks on each face that carries it.

    What stands unevenly as it comes (a shoe, a bag) tips over by a few degrees on to the face of its hull that
    carries it.
    """
    hull, centre = convex_hull(mesh), solid_of(mesh).centre_of_mass
    rotations = [np.eye(3)]
    if info.category in BLOCKS:
        normals = hull.facets_normal[hull.facets_area > FACET * hull.area]
        rotations += [_facing_down(normal) for normal in normals if normal[2] > -0.99]
    standing = [pose for rotation in rotations if (pose := _standing(info, mesh, hull, centre, rotation)) is not None]
    if standing:
        return standing
    normals = np.asarray(hull.face_normals)
    flattest = normals[np.argsort(normals[:, 2])[:TIPS]]
    tilted = flattest[flattest[:, 2] < -np.cos(TIPPING)]  # faces that all but lie on the ground already
    tipped = (_standing(info, mesh, hull, centre, _facing_down(normal)) for normal in tilted)
    return [pose for pose in tipped if pose is not None][:1]


def _facing_down(normal: Float64) -> Float64:
    """Return the rotation (3, 3) that makes a face of that normal (3,) look down."""
    return np.asarray(Rotation.align_vectors([[0, 0, -1]], [normal])[0].as_matrix())


def _standing(info: AssetInfo, mesh: Mesh, hull: Trimesh, centre: Float64, rotation: Float64) -> Standing | None:
    """Put a hull down in a pose; None where its centre of mass lies outside the points that carry it."""
    vertices = mesh.vertices().astype(np.float64) @ rotation.T
    lowest = float(vertices[:, 2].min())
    footprint = convex_polygon(np.asarray(hull.vertices) @ rotation.T[:, :2])
    if footprint is None or not stands(vertices, (rotation @ centre,), contact=CONTACT):
        return None
    posed = hull.copy()
    posed.apply_transform(pose_of(rotation, (0.0, 0.0, -lowest)))
    return Standing(info, mesh, posed, rotation, -lowest, footprint)


def arrange(rng: Rng, objects: Sequence[Standing], stage: Stage) -> Arrangement:
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
            pose = about_z(_facing(rng, stage.front))
            footprint = item.footprint @ pose[:2, :2].T
            spot = _spot(rng, group.footprints, footprint, stage.focus)
            cost = _cost(rng, item, spot, stage)
            pose[:3, 3] = [*spot, stage.height]
            if (best is None or cost < best[0]) and stage.supports(footprint + spot) and _clear(probe, pose, group):
                best = (cost, pose, footprint + spot)
        if best is None:
            raise PlacementError(f"no free place for {item.info.id} among {index} objects")
        _, pose, footprint = best
        group.solids.add_object(str(index), item.hull, pose)
        group.footprints.append(footprint)
        hover = rng.uniform(0.0, HOVER)
        group.poses.append(pose @ pose_of(item.rotation, (0.0, 0.0, item.lift + hover)))
    return group


def _facing(rng: Rng, front: Float64) -> float:
    """Draw a yaw [rad]: most have their front (-Y, as assets come) roughly to the cameras."""
    if rng.random() < AVERTED:
        return float(rng.uniform(0.0, 2 * np.pi))
    return float(np.arctan2(front[1], front[0]) + np.pi / 2 + rng.normal(0.0, SLACK))


def _spot(rng: Rng, footprints: list[Float64], footprint: Float64, focus: Float64) -> Float64:
    """Draw a place close beside one of the objects that stand already (the first: near the focus)."""
    if not footprints:
        return focus + rng.normal(0.0, 0.02, 2)
    anchor = footprints[int(rng.integers(len(footprints)))]
    angle = rng.uniform(0.0, 2 * np.pi)
    away = np.array([np.cos(angle), np.sin(angle)])
    # Two convex outlines whose shadows on the line along `away` do not overlap are at least `gap` apart.
    gap = NEAREST + (FURTHEST - NEAREST) * rng.beta(1.0, 2.5)
    reach = float((anchor @ away).max() - (footprint @ away).min()) + gap
    across = np.array([-away[1], away[0]])
    slide = float(anchor.mean(axis=0) @ across) + rng.normal(0.0, 0.02)
    return away * reach + across * slide


def _cost(rng: Rng, item: Standing, spot: Float64, stage: Stage) -> float:
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
