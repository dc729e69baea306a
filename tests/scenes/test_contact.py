"""Exact contact: depths against closed forms, and what carries a scene."""

import time

import numpy as np
import pytest
from trimesh import Trimesh
from trimesh.creation import box, cylinder, icosphere

from multilight.scenes.arrays import Float64
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.geometry.contact import check_contacts
from multilight.scenes.geometry.overlap import boxes_meet, depth, gap, surfaces_cross, touching, way_out
from multilight.scenes.geometry.solids import Placed, Solid
from multilight.scenes.kinds.tabletop import sample_tabletop
from multilight.scenes.meshes import Mesh
from multilight.scenes.poses import matrix4
from multilight.scenes.random_streams import Streams
from multilight.scenes.spec import Body, Geometry, Material, MeshAsset, Rectangle, Role, Sphere
from multilight.scenes.still_life.sample import StillLifeSettings


def solid(mesh: Trimesh) -> Solid:
    return Solid(np.asarray(mesh.vertices), np.asarray(mesh.faces))


def placed(item: Solid, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Placed:
    pose = np.eye(4)
    pose[:3, 3] = [x, y, z]
    return Placed(item, pose)


def turned(item: Solid, axis: int, angle: float, *offset: float) -> Placed:
    """Turn a solid about a world axis, then shift it."""
    first, second = (i for i in range(3) if i != axis)
    pose = np.eye(4)
    pose[first, first] = pose[second, second] = np.cos(angle)
    pose[first, second], pose[second, first] = -np.sin(angle), np.sin(angle)
    pose[:3, 3] = offset or 0.0
    return Placed(item, pose)


BALL = solid(icosphere(subdivisions=5, radius=0.05))
BOOK = solid(box((0.2, 0.3, 0.03)))
TOP = solid(box((1.2, 0.8, 0.04)))
BAR, CROSSBAR = solid(box((0.3, 0.02, 0.02))), solid(box((0.02, 0.3, 0.02)))


@pytest.mark.parametrize("overlap", [0.0005, 0.001, 0.002, 0.01])
def test_depth_of_spheres_and_boxes(overlap: float) -> None:
    # A sphere of 20,480 triangles lies up to 2e-5 m inside the true one.
    assert depth(placed(BALL), placed(BALL, 0.1 - overlap)) == pytest.approx(overlap, abs=1.5e-4)
    assert depth(placed(TOP), placed(BOOK, 0.1, 0.1, 0.035 - overlap)) == pytest.approx(overlap, abs=1.1e-4)
    assert depth(placed(TOP), placed(BALL, 0.1, 0.1, 0.07 - overlap)) == pytest.approx(overlap, abs=1.5e-4)


@pytest.mark.parametrize("overlap", [0.002, 0.004])
def test_depth_where_only_edges_cross(overlap: float) -> None:
    # Two bars stand on edge, crosswise: a point d below a right-angled ridge is d / sqrt(2) from its faces.
    ridge = 0.02 * np.sqrt(0.5)
    lower = turned(BAR, 0, np.pi / 4)
    upper = turned(CROSSBAR, 1, np.pi / 4, 0, 0, 2 * ridge - overlap)
    assert depth(lower, upper) == pytest.approx(overlap / np.sqrt(2), abs=1.1e-4)


def test_depth_does_not_depend_on_order_or_pose() -> None:
    tilted = turned(BOOK, 0, 0.3, 0.05, 0.0, 0.05)
    found = depth(placed(TOP), tilted)
    assert found == pytest.approx(depth(tilted, placed(TOP)), abs=1e-4)
    move = turned(BALL, 2, 1.1, 3.0, -2.0, 0.5).pose
    assert depth(Placed(TOP, move), Placed(BOOK, move @ tilted.pose)) == pytest.approx(found, abs=1.1e-4)


def test_one_inside_another_is_deep_though_no_surface_crosses() -> None:
    cube = solid(box((1, 1, 1)))
    # The point of the small sphere's surface that is farthest from all six faces lies on a diagonal.
    assert depth(placed(cube), placed(BALL)) == pytest.approx(0.5 - 0.05 / np.sqrt(3), abs=1e-3)
    assert depth(placed(cube), placed(BALL, 0.56)) == 0


def test_what_lies_in_a_bowl_does_not_lie_in_its_wall() -> None:
    outer, inner = icosphere(4, radius=0.1), icosphere(4, radius=0.095)
    shell = Trimesh(
        np.concatenate([outer.vertices, inner.vertices]), np.concatenate([outer.faces, inner.faces[:, ::-1] + 2562])
    )
    hollow = solid(shell)
    assert depth(placed(hollow), placed(BALL)) == 0
    assert depth(placed(hollow), placed(BALL, 0, 0, -0.046)) == pytest.approx(0.001, abs=3e-4)


def test_a_sheet_has_no_inside() -> None:
    cap = icosphere(4, radius=0.1)
    bowl = solid(Trimesh(cap.vertices, cap.faces[cap.triangles_center[:, 2] < 0]))
    assert not bowl.is_closed
    assert depth(placed(bowl), placed(BALL)) == 0
    assert depth(placed(bowl), placed(BALL, 0, 0, -0.052)) == pytest.approx(0.002, abs=3e-4)


def test_sheets_that_cross_are_as_deep_as_one_pokes_through() -> None:
    tube = trimesh_tube()
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    sheet = Solid(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    assert depth(placed(sheet), placed(tube, 0, 0, 0.048)) == pytest.approx(0.002, abs=1e-6)
    assert depth(placed(sheet), placed(tube, 0, 0, 0.0502)) == 0


def trimesh_tube() -> Solid:
    """Make an open tube, 10 cm high."""
    whole = cylinder(0.02, 0.1)
    sides = np.ptp(whole.triangles[:, :, 2], axis=1) > 0.05
    return Solid(np.asarray(whole.vertices), np.asarray(whole.faces)[sides])


def test_the_way_out_parts_what_overlaps() -> None:
    ball = placed(BALL, 0.1, 0.1, 0.065)
    shift = way_out(ball, placed(TOP))
    assert shift == pytest.approx([0, 0, 0.005], abs=5e-4)
    assert depth(ball.moved(shift), placed(TOP)) < 5e-4


def test_contact_is_where_things_touch() -> None:
    points = touching(placed(TOP), placed(BOOK, 0.1, 0.1, 0.0355))
    assert points.min(axis=0)[:2] == pytest.approx([0.0, -0.05], abs=1e-6)
    assert points.max(axis=0)[:2] == pytest.approx([0.2, 0.25], abs=1e-6)
    assert not len(touching(placed(TOP), placed(BOOK, 0.1, 0.1, 0.0365)))
    assert gap(placed(TOP), placed(BOOK, 0.1, 0.1, 0.0365)) == pytest.approx(0.0015, abs=1e-6)


def test_what_stands_askew_beside_a_wall_is_not_near_it() -> None:
    wall = turned(TOP, 1, np.pi / 2)
    askew = [turned(TOP, 2, 0.7).pose @ part.pose for part in (wall, placed(BALL, 0.08, 0.1, 0.1))]
    beside, ball = Placed(TOP, askew[0]), Placed(BALL, askew[1])
    assert (beside.box[0] <= ball.box[1]).all()
    assert (ball.box[0] <= beside.box[1]).all()
    assert not boxes_meet(beside, ball)
    assert boxes_meet(beside, ball, reach=0.011)


def test_surfaces_that_cross_in_one_triangle_are_found_among_thousands() -> None:
    fine = solid(icosphere(subdivisions=6, radius=0.05))
    for gap_between, cross in ((1e-5, False), (-1e-4, True)):
        other = turned(fine, 2, 0.4, 0.06, 0.08, 0.02)
        away = other.pose[:3, 3] / np.linalg.norm(other.pose[:3, 3])
        assert (
            surfaces_cross(placed(fine), Placed(fine, turned(fine, 2, 0.4, *((0.1 + gap_between) * away)).pose))
            == cross
        )


class Boxes:
    """A library of boxes: the asset's name says the size in millimetres."""

    def mesh(self, asset: str) -> Mesh:
        from multilight.scenes.meshes import MeshPart

        shape = box([float(v) / 1000 for v in asset.split("x")])
        vertices = np.asarray(shape.vertices, np.float32)
        return Mesh((MeshPart("box", vertices, shape.faces.astype(np.int32), vertices, vertices[:, :2], Material()),))


def body(name: str, geometry: Geometry, at: tuple[float, float, float], role: Role = "object") -> Body:
    pose: Float64 = np.eye(4)
    pose[:3, 3] = at
    return Body(
        name=name, role=role, category=name, geometry=geometry, materials=(Material(),), world_from_body=matrix4(pose)
    )


def brick(name: str, size: str, at: tuple[float, float, float]) -> Body:
    return body(name, MeshAsset(asset=size, mesh_sha256="", parts=1), at)


FLOOR = body("floor", Rectangle(width=5, height=5), (0, 0, 0), "surrounding")


def report(*bodies: Body) -> tuple[list[str], tuple[str, ...], dict[str, str]]:
    found = check_contacts([FLOOR, *bodies], Boxes())  # type: ignore[arg-type]
    return [f"{o.first} {o.second}" for o in found.overlaps], found.unsupported, dict(found.supports)


def test_standing_floating_and_sunken() -> None:
    assert report(brick("a", "100x100x100", (0, 0, 0.0505))) == ([], (), {"a": "stands"})
    assert report(brick("a", "100x100x100", (0, 0, 0.0515))) == ([], ("a",), {})
    assert report(brick("a", "100x100x100", (0, 0, 0.048)))[0] == ["floor a"]
    assert report(brick("a", "100x100x100", (0, 0, 0.0493)))[0] == []


def test_the_centre_of_mass_must_lie_over_the_support() -> None:
    leg = brick("leg", "100x100x100", (0, 0, 0.05))
    assert report(leg, brick("plank", "300x50x20", (0.04, 0, 0.11)))[1] == ()
    assert report(leg, brick("plank", "300x50x20", (0.06, 0, 0.11)))[1] == ("plank",)


def test_bridges_are_held_by_both_ends_and_floating_pairs_by_nothing() -> None:
    legs = [brick("one", "100x100x100", (-0.2, 0, 0.05)), brick("two", "100x100x100", (0.2, 0, 0.05))]
    assert report(*legs, brick("plank", "500x50x20", (0, 0, 0.11)))[2]["plank"] == "stands"
    aloft = [brick("low", "100x100x100", (0, 0, 0.5)), brick("high", "100x100x100", (0, 0, 0.6))]
    assert report(*aloft)[1] == ("low", "high")


def test_pictures_hang_on_walls_but_what_touches_a_wall_does_not_stand() -> None:
    pose = np.eye(4)
    pose[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    pose[:3, 3] = [0, 1, 1]
    wall = body("wall", Rectangle(width=5, height=2), (0, 0, 0), "surrounding")
    wall = wall.model_copy(update={"world_from_body": matrix4(pose)})
    assert report(wall, brick("picture", "400x20x300", (0, 0.9895, 1.5)))[2] == {"picture": "hangs"}
    assert report(wall, brick("picture", "400x20x300", (0, 0.98, 1.5)))[1] == ("picture",)
    assert report(wall, brick("picture", "400x20x300", (0, 1.02, 1.5)))[0] == ["wall picture"]


def test_a_ball_stands_on_a_point() -> None:
    ball = body("ball", Sphere(radius=0.04), (0.3, 0.2, 0.04))
    assert report(ball) == ([], (), {"ball": "stands"})


@pytest.mark.slow
def test_tabletops_overlap_nowhere() -> None:
    library = AssetLibrary(packs=("builtin",))
    seconds = []
    for index in range(4):
        scene = sample_tabletop(Streams(11, index), library, index=index, settings=StillLifeSettings(views=2))
        begin = time.process_time()
        found = check_contacts(scene.bodies, library)
        seconds.append(time.process_time() - begin)
        objects = {b.name for b in scene.bodies if b.role == "object"}
        assert not [o for o in found.overlaps if o.first in objects or o.second in objects]
    assert min(seconds) < 3
