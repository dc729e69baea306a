"""DTC-MultiLight's 3D layouts: a scene's Gaussians and their colours, folded onto square maps.

scene_00000/projs.npy                       int32 (N, 4): view, flat pixel, map row, map column
            0_1_ev2/img.png, bg0.png, mask0.png, gs.npy, transforms.json
scene_00084/composite.png, gt.png, gs.npy, projs.npy
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from multilight.datagen.export.dtc.scene import Geometry
from multilight.datagen.export.files import repeat, write_json, write_png
from multilight.scenes.arrays import UInt8
from multilight.scenes.gaussians.from_views import SceneGaussians, gaussians_from_views

REMOVED = 127
"""What a background's map shows on the removed object's own Gaussians."""


def make_gaussians(geometry: Geometry, object_ids: Sequence[int], side: int) -> SceneGaussians:
    """Make side * side Gaussians from the stored pixels, so that each one's source is a stored pixel."""
    return gaussians_from_views(
        geometry.picked, geometry.z_depths, geometry.instance_ids, object_ids, side=side, normals=geometry.normals
    )


class ColorMaps:
    """Maps of colours, filled view by view: the colour of each Gaussian is that of its source pixel."""

    def __init__(self, scene: SceneGaussians) -> None:
        self.scene = scene
        self._maps: dict[str, UInt8] = {}

    def fill(self, name: str, view: int, picture: UInt8) -> None:
        """Colour map `name` where Gaussians come from this view, of which `picture` (S, S, 3) is the stored one."""
        colors = self._maps.setdefault(name, np.zeros((len(self.scene.cells), 3), np.uint8))
        here = self.scene.sources[:, 0] == view
        colors[here] = picture.reshape(-1, 3)[self.scene.sources[here, 1]]

    def __getitem__(self, name: str) -> UInt8:
        """Return the map `name` as a picture (side, side, 3)."""
        return np.asarray(self.scene.to_map(self._maps[name]), np.uint8)


def _write_shapes(scene: Path, first: Path, gaussians: SceneGaussians) -> None:
    """Write `projs.npy` of a scene, and `gs.npy` into its first folder.

    The latter is (side, side, 11) float32 = place, opacity, scales [m], quaternion wxyz.
    """
    first.mkdir(parents=True, exist_ok=True)
    np.save(scene / "projs.npy", np.concatenate([gaussians.sources, gaussians.cells], axis=1).astype(np.int32))
    g = gaussians.gaussians
    columns = np.concatenate([g.means, g.opacities[:, None], g.scales, g.quats], axis=1)
    np.save(first / "gs.npy", gaussians.to_map(columns))


def write_training_maps(scene: Path, name: str, folders: Sequence[str], maps: ColorMaps, *, objects: int) -> None:
    """Write a training scene; `maps` holds `<folder>/img` and `<folder>/bg<j>`, `name` is the scene's final name."""
    owned = [maps.scene.to_map(maps.scene.objects == j) for j in range(objects)]
    first = scene / folders[0]
    _write_shapes(scene, first, maps.scene)
    for j, own in enumerate(owned):
        write_png(first / f"mask{j}.png", np.where(own, 255, 0).astype(np.uint8))
    for folder in folders:
        for file in ("gs.npy", *(f"mask{j}.png" for j in range(objects))):
            if folder != folders[0]:
                repeat(first / file, scene / folder / file)
        write_png(scene / folder / "img.png", maps[f"{folder}/img"])
        for j, own in enumerate(owned):
            background = np.where(own[..., None], np.uint8(REMOVED), maps[f"{folder}/bg{j}"])
            write_png(scene / folder / f"bg{j}.png", background)
        paths = {
            "rgb_path": f"{name}/{folder}/img.png",
            "rgb_bg_path": [f"{name}/{folder}/bg{j}.png" for j in range(objects)],
            "rgb_mask_path": [f"{name}/{folder}/mask{j}.png" for j in range(objects)],
            "gs_path": f"{name}/{folder}/gs.npy",
        }
        write_json(scene / folder / "transforms.json", paths)


def write_evaluation_maps(scene: Path, maps: ColorMaps) -> None:
    """Write an evaluation scene; `maps` holds `composite` and `gt`."""
    _write_shapes(scene, scene, maps.scene)
    for name in ("composite", "gt"):
        write_png(scene / f"{name}.png", maps[name])
