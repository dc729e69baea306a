"""Piles: fruit in a bowl, books and crockery in stacks, toys in a heap, each settled on a plane of its own.

A pile is built on the plane z = 0 about the origin, so that whoever places things can treat it as one.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import numpy as np
from trimesh import Trimesh
from trimesh.creation import box

from multilight.scenes.arrays import Float64
from multilight.scenes.assets.info import AssetInfo
from multilight.scenes.assets.library import AssetError, AssetLibrary
from multilight.scenes.geometry.overlap import boxes_meet, gap
from multilight.scenes.geometry.solids import Placed, Solid, solid_of
from multilight.scenes.geometry.support_surfaces import as_trimesh, convex_polygon
from multilight.scenes.materials import body_materials
from multilight.scenes.meshes import Mesh
from multilight.scenes.names import free_name
from multilight.scenes.physics.fall import Region
from multilight.scenes.physics.settle import settle, stack
from multilight.scenes.poses import apply_pose, pose_at, translation
from multilight.scenes.random_streams import Rng, pick
from multilight.scenes.spec import Body, Material
from multilight.scenes.still_life.placement import PlacementError, Standing
from multilight.scenes.still_life.setting import make_body

PileKind = Literal["fruit_bowl", "books", "plates", "bowls", "cups", "toys"]
KINDS: tuple[PileKind, ...] = get_args(PileKind)

_FRUIT = frozenset({"fruit"})
_TOYS = frozenset({"block", "die", "pawn", "ring", "toy"})
_NESTED: dict[PileKind, frozenset[str]] = {
    "plates": frozenset({"plate"}),
    "bowls": frozenset({"bowl"}),
    "cups": frozenset({"cup", "tumbler"}),
}
WIDEST, FEWEST, TALLEST = 0.4, 3, 0.45
"""How far across piles are [m], about; things that make one; sum of the heights [m] of nested crockery, before it goes
into each other."""
# Fractions, and distances [m].
_NESTS = 0.7  # things stack well that rise by less of their height each
_FILL = 0.75  # of a bowl's space, up to its rim, that its contents take
_HOLLOW = 0.55  # of the box about a bowl that is space: half of an ellipsoid is 0.52
_POURED = 0.5 * 1.7  # of the box about a fruit: a ball fills half of it, loose balls take 1.7 times their own
_MOST_FRUIT = 9
_ON_TOP = 1e-3  # bodies closer than this touch


@dataclass(frozen=True)
class Member:
    """One thing of a pile: `pile_from_body` (4, 4), metres."""

    info: AssetInfo
    mesh: Mesh
    pile_from_body: Float64


@dataclass(frozen=True)
class Pile:
    """Things at rest on z = 0 about the origin; the first member lies lowest. `dropped`: ids that found no rest."""

    kind: PileKind
    members: tuple[Member, ...]
    dropped: tuple[str, ...]

    @cached_property
    def loose(self) -> tuple[int, ...]:
        """Numbers of the members that carry no other: only those can be taken away."""
        placed = [Placed(solid_of(m.mesh), m.pile_from_body) for m in self.members]
        return tuple(
            number
            for number, item in enumerate(placed)
            if not any(
                other.centre_of_mass[2] > item.centre_of_mass[2]
                and boxes_meet(item, other, _ON_TOP)
                and gap(item, other) < _ON_TOP
                for other in placed
            )
        )

    def bodies(
        self, rng: Rng, library: AssetLibrary, world_from_pile: Float64, *, taken: Collection[str]
    ) -> list[Body]:
        """Make bodies of the members, the pile standing at `world_from_pile` (4, 4), under names that are not `taken`.

        They come in the order of the members; none is marked insertable (`loose` says which may be).
        """
        drawn: dict[str, tuple[Material, ...]] = {}
        result: list[Body] = []
        for member in self.members:
            info, mesh, pose = member.info, member.mesh, world_from_pile @ member.pile_from_body
            known = drawn.get(info.id) if self.kind in _NESTED else None  # crockery is of one set
            drawn[info.id] = known or body_materials(rng, library, info, mesh)
            names = {*taken, *(body.name for body in result)}
            name = free_name(info.category, names, prefix="pile_", otherwise="object")
            result.append(make_body(name, "object", info, mesh, drawn[info.id], pose))
        return result

    def standing(self) -> Standing:
        """Return the pile as one thing to place; its pose in the world times a member's in the pile is the member's."""
        points = [apply_pose(m.pile_from_body, m.mesh.vertices().astype(np.float64)) for m in self.members]
        hull = Trimesh(np.concatenate(points), process=False).convex_hull
        footprint = convex_polygon(np.asarray(hull.vertices)[:, :2])
        assert footprint is not None
        first = self.members[0]
        return Standing(first.info, first.mesh, hull, np.eye(3), 0.0, footprint)


def sample_pile(rng: Rng, library: AssetLibrary, *, kind: PileKind | None = None) -> Pile:
    """Draw and settle a pile of the given kind (None: of any) that is at most about `WIDEST` across.

    Every member is carried and none lies deeper than a millimetre in another. Raises `PlacementError` where too
    few suitable assets are installed or too few come to rest.
    """
    drawn = pick(rng, KINDS)
    kind = kind or drawn
    match kind:
        case "fruit_bowl":
            pile = _fruit_bowl(rng, library)
        case "toys":
            pile = _heap(rng, library)
        case "books":
            pile = _books(rng, library)
        case "plates" | "bowls" | "cups":
            pile = _crockery(rng, library, kind)
    if len(pile.members) < FEWEST:
        raise PlacementError(f"only {len(pile.members)} things of a pile of {kind} came to rest, need {FEWEST}")
    return pile


def _plane() -> Placed:
    """Return the plane on which piles are built, as a slab."""
    slab = box((3.0, 3.0, 0.1))
    return Placed(Solid(np.asarray(slab.vertices), np.asarray(slab.faces)), translation((0.0, 0.0, -0.05)))


def _suitable(
    library: AssetLibrary, categories: frozenset[str], longest: tuple[float, float]
) -> list[tuple[AssetInfo, Mesh]]:
    """Load the assets of some categories whose longest side lies in a range [m]."""
    found = []
    for info in library.list("object"):
        if info.category in categories and info.size and longest[0] <= max(info.size) <= longest[1]:
            try:
                found.append((info, library.mesh(info.id)))
            except AssetError:
                continue
    return found


def _pick(rng: Rng, found: Sequence[tuple[AssetInfo, Mesh]], what: str) -> tuple[AssetInfo, Mesh]:
    if not found:
        raise PlacementError(f"no {what} installed for a pile; run `multilight assets fetch`")
    return pick(rng, found)


def _fruit_bowl(rng: Rng, library: AssetLibrary) -> Pile:
    """Fill a bowl with fruit up to a little over its rim."""
    bowls = [b for b in _suitable(library, frozenset({"bowl"}), (0.15, WIDEST)) if _is_hollow(b[1])]
    info, mesh = _pick(rng, bowls, "bowl")
    low, high = mesh.bounds().astype(float)
    space = _HOLLOW * float(np.prod(high - low)) * _FILL
    chosen: list[tuple[AssetInfo, Mesh]] = []
    fruit = _suitable(library, _FRUIT, (0.02, 0.45 * float((high - low)[:2].min())))
    while len(chosen) < _MOST_FRUIT:
        item = _pick(rng, fruit, "fruit that fits the bowl")
        space -= _POURED * float(np.prod(np.ptp(item[1].bounds(), axis=0)))
        if space < 0 and len(chosen) >= 2:
            break
        chosen.append(item)
    radius = float((high - low)[:2].min()) / 2
    region = Region((0.0, 0.0), 1.1 * radius)
    bowl = Placed(solid_of(mesh), np.eye(4))
    settled = settle(rng, [solid_of(m) for _, m in chosen], [_plane(), bowl], region, spread=0.35 * radius)

    # What came to rest beside the bowl is dropped; what is in it does not rest on that.
    def inside(pose: Float64 | None) -> bool:
        return pose is not None and bool(np.hypot(pose[0, 3], pose[1, 3]) < radius and pose[2, 3] > 0.004)

    poses = [np.eye(4), *(pose if inside(pose) else None for pose in settled.poses)]
    return _pile("fruit_bowl", [(info, mesh), *chosen], poses)


def _is_hollow(mesh: Mesh) -> bool:
    """Tell whether a vessel is open: seen from above its centre lies low."""
    solid = as_trimesh(mesh)
    height = float(solid.bounds[1, 2])
    (face,) = solid.ray.intersects_first([[0.0003, 0.0002, height + 0.1]], [[0.0, 0.0, -1.0]])
    return bool(face >= 0 and solid.triangles[face, :, 2].max() < 0.5 * height)


def _heap(rng: Rng, library: AssetLibrary) -> Pile:
    """Pour small toys on one spot; the heap's centre stands over the origin."""
    toys = _suitable(library, _TOYS, (0.025, 0.11))
    chosen = [_pick(rng, toys, "toys") for _ in range(int(rng.integers(8, 14)))]
    region = Region((0.0, 0.0), WIDEST / 2)
    settled = settle(rng, [solid_of(m) for _, m in chosen], [_plane()], region, spread=0.05 * WIDEST)
    found = [pose[:2, 3] for pose in settled.poses if pose is not None]
    shift = translation((*-np.mean(found, axis=0), 0.0)) if found else np.eye(4)
    return _pile("toys", chosen, [None if pose is None else shift @ pose for pose in settled.poses])


def _books(rng: Rng, library: AssetLibrary) -> Pile:
    """Lay books on each other, the largest lowest, roughly in line."""
    found = _suitable(library, frozenset({"book"}), (0.1, WIDEST))
    chosen = [_pick(rng, found, "books") for _ in range(int(rng.integers(3, 7)))]
    chosen.sort(key=lambda entry: -float(np.prod(np.ptp(entry[1].bounds(), axis=0)[:2])))
    poses = [_rotated(rng, spread=0.12, shift=0.008) for _ in chosen]
    return _pile("books", chosen, stack([solid_of(mesh) for _, mesh in chosen], poses, [_plane()]).poses)


def _crockery(rng: Rng, library: AssetLibrary, kind: PileKind) -> Pile:
    """Put one sort of plate, bowl or cup into itself."""
    found = _suitable(library, _NESTED[kind], (0.06, WIDEST))
    found = [item for item in found if kind == "plates" or _is_hollow(item[1])]
    count = int(rng.integers(3, 7))
    for number in rng.permutation(len(found)):
        mesh = found[int(number)][1]
        low, high = mesh.bounds().astype(float)
        x, y, height = high - low
        # What is not round lies in one direction; a shift would keep steep walls apart.
        spread, shift = (np.pi if abs(x - y) < 0.01 * x else 0.03), 0.0006 if kind == "plates" else 0.0
        poses = [_rotated(rng, spread=spread, shift=shift) for _ in range(count)]
        poses = poses[: max(FEWEST, int(TALLEST / height))]
        count = len(poses)
        pile = _pile(kind, [found[int(number)]] * count, stack([solid_of(mesh)] * count, poses, [_plane()]).poses)
        if len(pile.members) >= FEWEST and pile.members[1].pile_from_body[2, 3] < _NESTS * height:
            return pile
    raise PlacementError(f"no {kind} installed that go into one another; run `multilight assets fetch`")


def _rotated(rng: Rng, *, spread: float, shift: float) -> Float64:
    """Draw a pose (4, 4): rotated by about `spread` [rad], every second one by half a circle more, and shifted [m]."""
    angle = rng.normal(0.0, spread) + (np.pi if rng.random() < 0.5 else 0.0)
    return pose_at(rng.normal(0.0, shift, 2), 0.0, angle)


def _pile(kind: PileKind, chosen: Sequence[tuple[AssetInfo, Mesh]], poses: Sequence[Float64 | None]) -> Pile:
    pairs = list(zip(chosen, poses, strict=True))
    members = tuple(Member(info, mesh, pose) for (info, mesh), pose in pairs if pose is not None)
    return Pile(kind, members, tuple(info.id for (info, _), pose in pairs if pose is None))
