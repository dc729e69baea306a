"""What is there before the objects of a still life come, and small things that all kinds of setting share."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from multilight.scenes.arrays import Float64
from multilight.scenes.assets.info import AssetInfo
from multilight.scenes.geometry.support_surfaces import SupportSurface
from multilight.scenes.materials import GLOW
from multilight.scenes.meshes import Mesh
from multilight.scenes.poses import matrix4
from multilight.scenes.random_streams import Rng
from multilight.scenes.spec import Body, Material, MeshAsset, Role, SceneSpec
from multilight.scenes.still_life.placement import Stage, Standing

FOCUS_CLEARANCE = 0.34
"""Distance [m] from the edges of a surface beyond which a still life may be centred anywhere: half of its width."""


@dataclass(frozen=True)
class Setting:
    """All that is there before the objects come; world frame, metres.

    They stand on `surface`, given in a frame that `world_from_surface` (4, 4) takes to the world. Cameras stand within
    `opening` [rad] of azimuth `front` [rad], and keep clear of the convex hulls of the bodies named in `solids` and of
    the triangles of all others. `most` bounds the number of objects; a fraction `raised` of them gets a plinth, and
    the `large_pieces` are put behind and beside them.
    """

    bodies: tuple[Body, ...]
    solids: tuple[str, ...]
    surface: SupportSurface
    world_from_surface: Float64
    front: float
    opening: float
    most: int = 8
    raised: float = 0.0
    large_pieces: tuple[Standing, ...] = ()

    def stage(self, rng: Rng) -> Stage:
        """Choose the focus of the still life: well inside the surface, rather towards the cameras."""
        pose = self.world_from_surface
        front = np.array([np.cos(self.front), np.sin(self.front)])
        clear = self.surface.clearance[self.surface.free]
        inner = self.surface.centres[clear >= 0.9 * min(FOCUS_CLEARANCE, float(clear.max()))]
        world = inner @ pose[:2, :2].T + pose[:2, 3]
        forward = world @ front
        near = world[forward >= np.quantile(forward, 0.5)]
        return Stage(self.surface, pose, near[int(rng.integers(len(near)))], front)


def make_body(name: str, role: Role, info: AssetInfo, mesh: Mesh, materials: Sequence[Material], pose: Float64) -> Body:
    """Make a body of a library asset."""
    return Body(
        name=name,
        role=role,
        category=info.category,
        geometry=MeshAsset(asset=info.id, mesh_sha256=mesh.sha256(), parts=len(mesh.parts)),
        materials=tuple(materials),
        world_from_body=matrix4(pose),
    )


def flat_surface(width: float, depth: float, *, cell: float = 0.02) -> SupportSurface:
    """Return a free rectangle of `width` x `depth` [m] about the origin of its frame, at height 0."""
    shape = (round(depth / cell), round(width / cell))
    origin = np.array([-width / 2, -depth / 2])
    return SupportSurface(height=0.0, origin=origin, cell=cell, free=np.ones(shape, bool), part=0)


def without_box(surface: SupportSurface, low: Float64, high: Float64) -> SupportSurface:
    """Return a surface without the cells between two corners (2,) [m] of its own frame."""
    free = surface.free.copy()
    first = np.clip(np.floor((low - surface.origin) / surface.cell).astype(int), 0, None)
    last = np.clip(np.ceil((high - surface.origin) / surface.cell).astype(int), 0, None)
    free[first[1] : last[1], first[0] : last[0]] = False
    return replace(surface, free=free)


def emissive_candidate(scene: SceneSpec) -> tuple[str, int] | None:
    """Return the name of the body, and the part of it, that is meant to shine; None where nothing is.

    The rule: its material is named `scenes.materials.GLOW`.
    """
    for body in scene.bodies:
        for part, material in enumerate(body.materials):
            if material.name == GLOW:
                return body.name, part
    return None
