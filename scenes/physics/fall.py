"""Rigid bodies that fall onto what stands still, by MuJoCo: where and how they come to rest.

What stands still is seen from above, as a height field; what falls is made of the convex hulls of its pieces. That
is close to the truth, not exact: `scenes.physics.settle` corrects what comes out against the meshes themselves.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation
from trimesh import Trimesh
from trimesh.ray.ray_pyembree import RayMeshIntersector

from multilight.scenes.arrays import Float64
from multilight.scenes.geometry.solids import Placed, Solid
from multilight.scenes.meshes import stacked, triangle_crosses
from multilight.scenes.poses import apply_pose, pose_of
from multilight.scenes.random_streams import Rng

CELL = 0.004
"""Grid [m] of the height field."""
STEP = 0.002
"""Time step [s]."""
BETWEEN, LONGEST = 0.25, 2.0
"""Seconds from one release to the next, and of waiting for rest after the last."""
MOST_PIECES = 12
DENSITY = 500.0
"""Of everything [kg/m³]: where things come to rest hardly depends on it."""
STILL = (0.004, 0.06)
"""Speeds [m/s], [rad/s] below which a body counts as at rest."""


@dataclass(frozen=True)
class Region:
    """The square of the world in which things may come to rest: centre (x, y) and half its side [m]."""

    centre: tuple[float, float]
    half: float


def fall(rng: Rng, movers: Sequence[Solid], fixed: Sequence[Placed], region: Region, *, spread: float) -> list[Float64]:
    """Release bodies one after the other, in random rotations, within `spread` [m] of the region's centre.

    Returns each body's pose (4, 4) when all are at rest or time is up; some may have rolled out of the region.
    """
    heights, low = height_field(fixed, region)
    model = _model(movers, heights, low, region)
    data = mujoco.MjData(model)
    placed: list[int] = []
    for number, mover in enumerate(movers):
        reach = _radius(mover)
        angle, away = rng.uniform(0.0, 2 * np.pi), spread * np.sqrt(rng.random())
        spot = np.array(region.centre) + away * np.array([np.cos(angle), np.sin(angle)])
        top = _top_near(spot, reach, heights, low, region)
        states = [(data.qpos[7 * i : 7 * i + 3], _radius(movers[i])) for i in placed]
        tops = [at[2] + wide for at, wide in states if np.linalg.norm(at[:2] - spot) < wide + reach]
        data.qpos[7 * number : 7 * number + 3] = [*spot, max([top, *tops]) + reach + 0.005]
        data.qpos[7 * number + 3 : 7 * number + 7] = np.roll(Rotation.random(random_state=rng).as_quat(), 1)
        data.qvel[6 * number : 6 * number + 6] = 0.0
        model.body_gravcomp[number + 1] = 0.0
        placed.append(number)
        mujoco.mj_step(model, data, round(BETWEEN / STEP))
    _wait(model, data)
    return [_pose(data.qpos[7 * i : 7 * i + 7]) for i in range(len(movers))]


def _radius(mover: Solid) -> float:
    return float(np.linalg.norm(np.maximum(np.abs(mover.low), np.abs(mover.high))))


def _wait(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Step until nothing has moved for a tenth of a second, or time is up."""
    calm = 0
    for _ in range(round(LONGEST / (10 * STEP))):
        mujoco.mj_step(model, data, 10)
        speed = data.qvel.reshape(-1, 6)
        still = np.abs(speed[:, :3]).max() < STILL[0] and np.abs(speed[:, 3:]).max() < STILL[1]
        calm = calm + 1 if still else 0
        if calm >= 5:
            return


def height_field(fixed: Sequence[Placed], region: Region) -> tuple[Float64, float]:
    """Return what lies on top at the nodes of a grid [m] (rows along y, columns along x), and the lowest value.

    Where there is nothing, 0.3 m below the lowest surface.
    """
    count = 2 * int(np.ceil(region.half / CELL)) + 1
    line = np.linspace(-region.half, region.half, count)
    x, y = np.meshgrid(region.centre[0] + line, region.centre[1] + line)
    pieces = stacked((apply_pose(p.pose, p.solid.vertices), p.solid.faces) for p in fixed)
    scene = Trimesh(*pieces, process=False)
    top = float(scene.bounds[1, 2]) + 0.1
    origins = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, top)])
    face = RayMeshIntersector(scene).intersects_first(origins, np.tile([0.0, 0.0, -1.0], (x.size, 1)))
    a, normal = scene.triangles[face, 0], triangle_crosses(scene.triangles[face])
    slope = np.where(np.abs(normal[:, 2]) > 1e-15, normal[:, 2], 1.0)
    z = a[:, 2] - ((origins - a)[:, :2] * normal[:, :2]).sum(axis=1) / slope
    corners = scene.triangles[face, :, 2]
    z = np.clip(z, corners.min(axis=1), corners.max(axis=1))
    found = z[face >= 0]
    heights = np.where(face >= 0, z, (found.min() if len(found) else 0.0) - 0.3).reshape(x.shape)
    return heights, float(heights.min())


def _top_near(spot: Float64, reach: float, heights: Float64, low: float, region: Region) -> float:
    """Return the highest point of the height field within `reach` [m] of a spot (2,)."""
    line = np.linspace(-region.half, region.half, len(heights))
    columns, rows = (np.abs(line + region.centre[i] - spot[i]) <= reach for i in (0, 1))
    return float(heights[rows[:, None] & columns].max(initial=low))


def _model(movers: Sequence[Solid], heights: Float64, low: float, region: Region) -> mujoco.MjModel:
    """Build the model: the height field, and each mover parked far away until it is released."""
    spec = mujoco.MjSpec()
    spec.option.timestep = STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    contact = {"solref": [0.004, 1.0], "solimp": [0.98, 0.999, 0.0005, 0.5, 2.0], "friction": [0.6, 0.01, 0.006]}
    ground = {"pos": [*region.centre, low], "condim": 6, **contact}
    span = float(heights.max()) - low
    if span < 1e-6:  # what is flat is cheaper as a plane
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[region.half, region.half, 0.1], **ground)
    else:
        data = ((heights - low) / span).ravel().tolist()
        size = [region.half, region.half, span, 0.05]
        spec.add_hfield(name="ground", nrow=len(heights), ncol=len(heights), size=size, userdata=data)
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname="ground", **ground)
    for number, mover in enumerate(movers):
        body = spec.worldbody.add_body(pos=[100.0 + 5.0 * number, 0.0, 0.0], gravcomp=1.0)
        body.add_freejoint()
        for piece, points in enumerate(convex_pieces(mover)):
            name = f"{number}_{piece}"
            spec.add_mesh(name=name, uservert=points.ravel().tolist(), maxhullvert=100)
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, density=DENSITY, condim=6, **contact)
    return spec.compile()


def convex_pieces(mover: Solid) -> list[Float64]:
    """Return the corners of the convex hulls of a mesh's largest pieces, small or flat ones joined to the whole.

    Pieces inside others are left out. A mesh of more than `MOST_PIECES` becomes one hull.
    """
    hulls: list[tuple[float, Float64]] = []
    for points in mover.pieces():
        try:
            hull = ConvexHull(points)
        except (QhullError, ValueError):
            continue
        hulls.append((float(hull.volume), points[hull.vertices]))
    hulls.sort(key=lambda entry: -entry[0])
    outer: list[Float64] = []
    for volume, points in hulls:
        inside = any((points >= o.min(axis=0)).all() and (points <= o.max(axis=0)).all() for o in outer)
        if volume > 1e-9 and not (inside and volume < 0.3 * hulls[0][0]):
            outer.append(points)
    return outer if 0 < len(outer) <= MOST_PIECES else [mover.vertices]


def _pose(state: Float64) -> Float64:
    """Return the pose (4, 4) of MuJoCo's position and quaternion (w first)."""
    return pose_of(Rotation.from_quat(np.roll(state[3:], -1)).as_matrix(), state[:3])
