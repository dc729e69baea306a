"""A room being furnished: what stands where, with nothing in anything else.

Bodies keep apart by their boxes in the room's frame, grown by a small gap: rooms are laid out along their walls, so
boxes waste little, and bodies whose boxes are apart cannot touch. Where boxes must meet (a chair under a table),
the convex hull of the one is held against the triangles of the other.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from trimesh.collision import CollisionManager

from multilight.scenes.arrays import Float64
from multilight.scenes.assets.info import AssetInfo, AssetRole
from multilight.scenes.assets.library import AssetError, AssetLibrary
from multilight.scenes.geometry.support_surfaces import as_trimesh, convex_hull, convex_polygon
from multilight.scenes.kinds.rooms.finish import Palette, furniture_materials
from multilight.scenes.kinds.rooms.footing import footing_of, hangs, shelves_of
from multilight.scenes.kinds.rooms.shell import DOOR_ZONE, SKIRTING, Shell, Wall
from multilight.scenes.meshes import Mesh
from multilight.scenes.names import free_name
from multilight.scenes.poses import apply_pose, pose_at
from multilight.scenes.random_streams import Rng
from multilight.scenes.spec import Body, Material, Role
from multilight.scenes.still_life.setting import make_body

GAP = 0.006
"""Smallest distance [m] between the boxes of two bodies."""
GROWN = (1.02, 1.02, 1.005)
"""Factors by which a convex hull is grown before it is held against another body: a hair's breadth more in height."""
BACK = 0.02
"""Distance [m] of furniture to the wall: room for the skirting board."""
LIFT = 0.0002
"""Air [m] below what stands, so that no two surfaces coincide."""
HUNG = 0.0004
"""Distance [m] of what hangs on a wall or from the ceiling: touching, but not in it."""

ON_WALLS = frozenset(
    {"picture", "mirror", "shelf", "wall_clock", "wall_tv", "wall_unit_a", "wall_unit_b", "hood", "curtains"}
)
UNDER_CEILINGS = frozenset({"pendant", "ceilinglamp", "ceiling_lamp"})


@dataclass(frozen=True)
class Piece:
    """A model that may come into the room, with its lowest and highest corner (3,) [m] in its own frame."""

    info: AssetInfo
    mesh: Mesh
    low: Float64
    high: Float64

    @property
    def size(self) -> Float64:
        """Width, depth and height (3,) [m]."""
        return self.high - self.low


@dataclass(frozen=True)
class PlacedPiece:
    """A piece where it stands: its body's name, pose (4, 4), and box (lowest and highest corner, (3,) each) [m]."""

    name: str
    piece: Piece
    pose: Float64
    low: Float64
    high: Float64


def _holds(piece: Piece) -> bool:
    """Tell whether a piece stands, or hangs where its kind hangs."""
    if piece.info.category in UNDER_CEILINGS:
        return True
    return hangs(piece.mesh) if piece.info.category in ON_WALLS else footing_of(piece.mesh) is not None


class Plan:
    """Bodies placed so far, what must stay free, and the generator that furniture is drawn with."""

    def __init__(self, rng: Rng, library: AssetLibrary, shell: Shell, palette: Palette, bodies: list[Body]) -> None:
        self.rng, self.library, self.shell, self.palette, self.bodies = rng, library, shell, palette, bodies
        self.placed: dict[str, PlacedPiece] = {}
        self._low, self._high = np.empty((0, 3)), np.empty((0, 3))
        self._zones: list[tuple[Float64, Float64]] = []
        self._pieces: dict[str, Piece | None] = {}
        self._probes: dict[str, CollisionManager] = {}
        self._solids: dict[str, CollisionManager] = {}

    def piece(self, info: AssetInfo) -> Piece | None:
        """Load a model; None where it is broken."""
        if info.id not in self._pieces:
            try:
                mesh = self.library.mesh(info.id)
                low, high = mesh.bounds().astype(np.float64)
                self._pieces[info.id] = Piece(info, mesh, low, high)
            except AssetError:
                self._pieces[info.id] = None
        return self._pieces[info.id]

    def choose(self, *categories: str, largest: tuple[float, float, float] = (9.0, 9.0, 9.0)) -> Piece | None:
        """Draw a model of the categories that is at most so large (x, y, z) [m]; None where there is none.

        What does not hang must stand as it comes, and what hangs must hang.
        """
        roles: tuple[AssetRole, ...] = ("surrounding", "table")
        infos = [info for role in roles for info in self.library.list(role) if info.category in categories]
        fitting = [info for info in infos if info.size and all(a <= b for a, b in zip(info.size, largest, strict=True))]
        while fitting:
            info = fitting.pop(int(self.rng.integers(len(fitting))))
            piece = self.piece(info)
            if piece is not None and _holds(piece):
                return piece
        return None

    def keep_free(self, low: Float64, high: Float64) -> None:
        """Let nothing come into a box."""
        self._zones.append((low, high))

    def keep_doors_free(self) -> None:
        """Keep the floor before each door free."""
        for opening in self.shell.openings:
            if opening.is_door:
                sides = (opening.along - (opening.width / 2 + 0.1), opening.along + (opening.width / 2 + 0.1))
                ends = np.array([opening.wall.point(side, out) for side in sides for out in (0.0, DOOR_ZONE)])
                self.keep_free(np.append(ends.min(axis=0), 0.0), np.append(ends.max(axis=0), 2.1))

    def mark(self) -> tuple[int, int]:
        """Remember how far the room is furnished."""
        return len(self.placed), len(self._zones)

    def back_to(self, mark: tuple[int, int]) -> None:
        """Take everything out that was placed after a mark."""
        pieces, zones = mark
        for name in list(self.placed)[pieces:]:
            del self.placed[name], self.bodies[-1]
            self._solids.pop(name, None)
        del self._zones[zones:]
        self._low, self._high = self._low[:pieces], self._high[:pieces]

    def box(self, piece: Piece, pose: Float64) -> tuple[Float64, Float64]:
        """Return the box of a piece in a pose."""
        points = apply_pose(pose, piece.mesh.vertices())
        return points.min(axis=0), points.max(axis=0)

    def is_free(
        self, low: Float64, high: Float64, *, apart_from: Sequence[str] = (), zones: bool = True, boards: bool = True
    ) -> bool:
        """Tell whether a box lies in the room and clear of all bodies but those named; low ones off skirting boards."""
        half = np.array([self.shell.width / 2, self.shell.depth / 2])
        if low[2] < SKIRTING[0] and boards:
            half = half - SKIRTING[1]
        if (low[:2] < -half).any() or (high[:2] > half).any() or high[2] > self.shell.height or low[2] < -1e-6:
            return False
        if zones and any((low < b).all() and (high > a).all() for a, b in self._zones):
            return False
        return not [name for name in self.touched(low, high) if name not in apart_from]

    def touched(self, low: Float64, high: Float64) -> list[str]:
        """Name the bodies whose boxes come within `GAP` of a box; what lies below or above may touch."""
        gap = np.array([GAP, GAP, 0.0])
        meets = (self._low < high + gap).all(axis=1) & (self._high > low - gap).all(axis=1)
        return [name for name, near in zip(self.placed, meets, strict=True) if near]

    def add(
        self,
        piece: Piece,
        pose: Float64,
        *,
        role: Role = "surrounding",
        apart_from: Sequence[str] = (),
        lit: bool = False,
        zones: bool = True,
        boards: bool = True,
    ) -> PlacedPiece | None:
        """Put a piece where it is free, with the palette's materials; None where something is there already."""
        low, high = self.box(piece, pose)
        if not self.is_free(low, high, apart_from=apart_from, zones=zones, boards=boards):
            return None
        materials = furniture_materials(self.rng, self.palette, piece.info, piece.mesh, lit=lit)
        return self.put(piece, pose, materials, role=role)

    def stand(
        self,
        piece: Piece,
        place: Float64,
        angle: float,
        *,
        base: float = 0.0,
        role: Role = "surrounding",
        apart_from: Sequence[str] = (),
        lit: bool = False,
    ) -> PlacedPiece | None:
        """Stand a piece at (x, y), `base` [m] above the floor, its yaw `angle` [rad]; None where it is not free."""
        return self.add(piece, pose_at(place, base + LIFT, angle), role=role, apart_from=apart_from, lit=lit)

    def hang(self, piece: Piece, place: Float64) -> None:
        """Hang a lamp that is lit under the ceiling, at (x, y), where that is free."""
        self.add(piece, pose_at(place, self.shell.height - HUNG - float(piece.size[2]), 0.0), lit=True)

    def tuck(self, chair: Piece, table: PlacedPiece, poses: Iterable[Float64]) -> None:
        """Stand a chair at a table: in the first of some poses in which it is clear of the table and of all else."""
        for pose in poses:
            free = self.is_free(*self.box(chair, pose), apart_from=(table.name,))
            if free and self.clear_of(chair, pose, table):
                self.add(chair, pose, apart_from=(table.name,))
                return

    def put(self, piece: Piece, pose: Float64, materials: tuple[Material, ...], *, role: Role) -> PlacedPiece:
        """Add a body without asking."""
        low, high = self.box(piece, pose)
        name = free_name(piece.info.category, {body.name for body in self.bodies}, otherwise="object")
        self.bodies.append(make_body(name, role, piece.info, piece.mesh, materials, pose))
        self._low, self._high = np.vstack([self._low, low]), np.vstack([self._high, high])
        self.placed[name] = PlacedPiece(name, piece, pose, low, high)
        return self.placed[name]

    def against_wall(
        self,
        piece: Piece,
        wall: Wall,
        *,
        along: float | None = None,
        z: float = 0.0,
        role: Role = "surrounding",
        lit: bool = False,
        tries: int = 14,
    ) -> PlacedPiece | None:
        """Stand a piece with its back to a wall, `along` it or wherever there is room; hang it where z is not 0."""
        out = piece.size[1] / 2 + (HUNG if z > 0 else BACK)
        slack = wall.length / 2 - piece.size[0] / 2 - 0.01
        if slack < 0:
            return None
        for _ in range(1 if along is not None else tries):
            here = float(self.rng.uniform(-slack, slack)) if along is None else float(np.clip(along, -slack, slack))
            done = self.add(piece, pose_at(wall.point(here, out), z, wall.angle), role=role, lit=lit)
            if done is not None:
                return done
        return None

    def clear_of(self, piece: Piece, pose: Float64, other: PlacedPiece) -> bool:
        """Tell whether the convex hull of a piece, grown a little, keeps off the triangles of another body."""
        probe = self._probes.get(piece.info.id)
        if probe is None:
            hull = convex_hull(piece.mesh).copy()
            hull.apply_transform(np.diag([*GROWN, 1.0]))
            probe = self._probes[piece.info.id] = CollisionManager()
            probe.add_object("piece", hull)
        solid = self._solids.get(other.name)
        if solid is None:
            solid = self._solids[other.name] = CollisionManager()
            solid.add_object("body", as_trimesh(other.piece.mesh), other.pose)
        probe.set_transform("piece", pose)
        return not probe.in_collision_other(solid)

    def on_top(self, piece: Piece, stand: PlacedPiece, *, angle: float, lit: bool = False) -> PlacedPiece | None:
        """Stand a piece on the highest surface of another, where its foot has most room; None where it has none."""
        shelves = shelves_of(stand.piece.mesh)
        vertices = piece.mesh.vertices()
        foot = convex_polygon(vertices[vertices[:, 2] <= vertices[:, 2].min() + 0.01, :2].astype(np.float64))
        if not shelves or foot is None:
            return None
        surface = shelves[-1].surface
        local = angle - float(np.arctan2(stand.pose[1, 0], stand.pose[0, 0]))
        centre = surface.centres[int(np.argmax(surface.clearance[surface.free]))]
        upon = pose_at(centre, surface.height + 0.0003, local)
        if not surface.supports(foot @ upon[:2, :2].T + centre, 0.004):
            return None
        return self.add(piece, stand.pose @ upon, apart_from=(stand.name,), lit=lit)

    def walls_by_room(self) -> list[Wall]:
        """Return the walls, those without openings first, otherwise in a random order."""
        order = [self.shell.walls[int(i)] for i in self.rng.permutation(4)]
        return sorted(order, key=lambda wall: not self.shell.free(wall))
