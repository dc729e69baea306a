"""Heaps and stacks: nothing lies in anything, everything is carried, and the same seed gives the same bytes."""

import os
import subprocess
import sys

import numpy as np
import pytest
from trimesh.creation import box, cylinder, icosphere

from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.geometry.contact import check_contacts, support_of
from multilight.scenes.geometry.overlap import depth, touching
from multilight.scenes.geometry.solids import Placed, Solid
from multilight.scenes.kinds.tabletop import sample_tabletop
from multilight.scenes.physics.fall import Region, convex_pieces, height_field
from multilight.scenes.physics.settle import lowered, settle, stack
from multilight.scenes.poses import matrix4
from multilight.scenes.random_streams import Streams
from multilight.scenes.spec import Body, Material, Rectangle
from multilight.scenes.still_life.piles import KINDS, Pile, PileKind, sample_pile
from multilight.scenes.still_life.placement import PlacementError
from multilight.scenes.still_life.sample import StillLifeSettings
from tests.scenes.test_contact import BALL, placed, solid

GROUND = placed(solid(box((2, 2, 0.1))), 0, 0, -0.05)
REGION = Region((0.0, 0.0), 0.3)
CUBE = solid(box((0.04, 0.04, 0.04)))


@pytest.fixture(scope="module")
def library() -> AssetLibrary:
    return AssetLibrary(packs=("builtin",))


def test_a_cube_comes_to_lie_on_a_face() -> None:
    settled = settle(np.random.default_rng(1), [CUBE], [GROUND], REGION, spread=0.01)
    (pose,) = settled.poses
    assert pose is not None
    assert settled.dropped == {}
    assert pose[2, 3] == pytest.approx(0.02, abs=1e-3)
    up = np.abs(pose[2, :3])
    assert up.max() == pytest.approx(1, abs=1e-3)


def test_a_heap_is_sound_and_the_same_again() -> None:
    movers = [CUBE, solid(cylinder(0.02, 0.05)), solid(icosphere(3, 0.02)), CUBE, CUBE, CUBE]
    heaps = [settle(np.random.default_rng(4), movers, [GROUND], REGION, spread=0.015) for _ in range(2)]
    assert [None if p is None else p.tobytes() for p in heaps[0].poses] == [
        None if p is None else p.tobytes() for p in heaps[1].poses
    ]
    assert set(heaps[0].dropped) == {i for i, pose in enumerate(heaps[0].poses) if pose is None}
    standing = [Placed(m, p) for m, p in zip(movers, heaps[0].poses, strict=True) if p is not None]
    assert len(standing) >= 4
    everything = [GROUND, *standing]
    for i, item in enumerate(standing):
        others = [other for other in everything if other is not item]
        assert max(depth(item, other) for other in others) <= 1e-3, i
        contacts = [(other, points) for other in others if len(points := touching(item, other))]
        assert support_of(item, contacts) is not None, i


def test_what_rolls_away_is_dropped_and_said() -> None:
    slope = box((1.0, 1.0, 0.1))
    slope.apply_transform([[0.9, 0, 0.4359, 0], [0, 1, 0, 0], [-0.4359, 0, 0.9, 0], [0, 0, 0, 1]])
    settled = settle(np.random.default_rng(0), [BALL], [placed(solid(slope))], REGION, spread=0.01)
    assert settled.poses == (None,)
    assert settled.dropped[0]


def test_lowering_ends_in_contact_and_never_below() -> None:
    down = lowered(placed(CUBE, 0, 0, 0.3), [GROUND])
    assert 0 < down.pose[2, 3] - 0.02 <= 2e-4
    assert depth(down, GROUND) == 0


def test_a_stack_ends_where_it_would_topple() -> None:
    poses = [np.eye(4) for _ in range(3)]
    poses[1][0, 3], poses[2][0, 3] = 0.015, 0.045
    settled = stack([CUBE] * 3, poses, [GROUND])
    assert [pose is None for pose in settled.poses] == [False, False, True]
    assert settled.poses[1] is not None
    assert settled.poses[1][2, 3] == pytest.approx(0.06, abs=5e-4)


def test_the_height_field_sees_what_is_on_top() -> None:
    heights, low = height_field([GROUND, placed(CUBE, 0.1, 0, 0.02)], Region((0.1, 0.0), 0.1))
    middle = len(heights) // 2
    assert heights[middle, middle] == pytest.approx(0.04, abs=1e-6)
    assert heights[0, 0] == pytest.approx(0, abs=1e-6)
    assert low == pytest.approx(0, abs=1e-6)


def test_convex_pieces_cover_each_piece() -> None:
    apart = box((0.1, 0.1, 0.1)) + box((0.02, 0.02, 0.2)).apply_translation((0.3, 0, 0))
    assert sorted(len(points) for points in convex_pieces(solid(apart))) == [8, 8]


def bodies_of(pile: Pile, library: AssetLibrary) -> list[Body]:
    floor = Body(
        name="floor",
        role="surrounding",
        category="floor",
        geometry=Rectangle(width=3, height=3),
        materials=(Material(),),
        world_from_body=matrix4(np.eye(4)),
    )
    return [floor, *pile.bodies(np.random.default_rng(0), library, np.eye(4), taken=("pile_book",))]


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_piles_are_sound(library: AssetLibrary, kind: PileKind) -> None:
    pile = sample_pile(np.random.default_rng(1), library, kind=kind)
    assert len(pile.members) >= 3
    bodies = bodies_of(pile, library)
    found = check_contacts(bodies, library)
    assert (found.overlaps, found.unsupported) == ((), ())
    standing = pile.standing()
    assert standing.hull.bounds[0, 2] == pytest.approx(0, abs=1.5e-3)
    assert np.ptp(standing.footprint, axis=0).max() < 0.6
    # What carries nothing can go without anything coming to hang in the air.
    assert kind == "toys" or 0 not in pile.loose
    rest = [body for i, body in enumerate(bodies) if i - 1 not in pile.loose]
    left = check_contacts(rest, library)
    assert (left.overlaps, left.unsupported) == ((), ())


def test_fruit_lies_in_its_bowl(library: AssetLibrary) -> None:
    pile = sample_pile(np.random.default_rng(3), library, kind="fruit_bowl")
    bowl, *fruit = pile.members
    assert bowl.info.category == "bowl"
    assert {m.info.category for m in fruit} == {"fruit"}
    assert all(m.pile_from_body[2, 3] > 0.004 for m in fruit)


def test_without_bowls_there_is_no_fruit_bowl(library: AssetLibrary, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(AssetLibrary, "list", lambda self, role: ())
    with pytest.raises(PlacementError, match="assets fetch"):
        sample_pile(np.random.default_rng(3), library, kind="fruit_bowl")


def _poses(threads: int) -> str:
    code = (
        "import numpy as np\n"
        "from multilight.scenes.assets.library import AssetLibrary\n"
        "from multilight.scenes.still_life.piles import sample_pile\n"
        "pile = sample_pile(np.random.default_rng(7), AssetLibrary(packs=('builtin',)), kind='fruit_bowl')\n"
        "print(b''.join(m.pile_from_body.tobytes() for m in pile.members).hex())"
    )
    keys = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "IGL_NUM_THREADS")
    environment = os.environ | dict.fromkeys(keys, str(threads))
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment
    ).stdout


@pytest.mark.slow
def test_threads_change_no_byte() -> None:
    assert _poses(1) == _poses(3) != ""


def test_solids_know_their_mass() -> None:
    lopsided = box((0.1, 0.1, 0.1)) + box((0.1, 0.1, 0.1)).apply_translation((0.3, 0, 0))
    assert Solid(np.asarray(lopsided.vertices), np.asarray(lopsided.faces)).centre_of_mass == pytest.approx(
        [0.15, 0, 0], abs=1e-9
    )


@pytest.mark.slow
def test_a_pile_stands_among_the_objects_of_a_tabletop(library: AssetLibrary) -> None:
    settings = StillLifeSettings(views=2, width=64, height=64, objects=(3, 4), insertable=2, piles=1.0)
    scene = sample_tabletop(Streams(2, 0), library, index=0, settings=settings)
    piled = [body.name for body in scene.bodies if body.name.startswith("pile_")]
    assert len(piled) >= 3
    assert not set(piled) & set(scene.insertable)
    found = check_contacts(scene.bodies, library)
    assert not [o for o in found.overlaps if {o.first, o.second} & set(piled)]
    assert not set(found.unsupported) & set(piled)
