"""`multilight insert`: put an object into a capture of many views, and harmonize them all alike."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(kw_only=True)
class Insert:
    """Put an object into a capture of many views, and harmonize all of them alike.

    CAPTURE is a nerfstudio folder (transforms.json), a COLMAP folder (images and sparse/0), or a folder of pictures,
    whose poses are then found. Written are composites/, harmonized/, scene.ply (Gaussians), and orbit.mp4.
    """

    capture: tyro.conf.Positional[Path]
    asset: str
    """Object: a GLB, glTF or OBJ file, or an asset of the library as `pack/name`."""
    out: Path
    """Folder to write."""
    pose: Path | None = None
    """Where it goes: 4x4 matrix (JSON, or 16 numbers), or JSON with position, yaw, scale. Default: on the largest
    plane that faces up, where there is room near the scene's centre."""
    yaw: float = 0.0
    """Turn about the upright axis, in degrees."""
    scale: float | None = None
    """The capture's units of length in a metre (default: the object takes a fifth of the pictures' width, or
    less where there is less room)."""
    gaussians: Path | None = None
    """3DGS PLY of the capture, in the cameras' own world: depth is taken from it."""
    depth_model: Path | None = None
    """ONNX model for captures without depth (Depth Anything V2's layout), held to their sparse points."""
    weights: Path | None = None
    """Weights of the 2D stage (default: the ready-made ones)."""
    weights_3d: Path | None = None
    """Weights of the 3D stage (without: what the views say is averaged)."""
    max_side: int = 512
    """Longest side in pixels to work at; larger pictures are made smaller."""
    every: int = 1
    """Take each n-th picture."""
    side: int = 256
    """Cells a side of the map of Gaussians, a power of two: 256 makes 65,536 of them."""
    frames: Annotated[int, tyro.conf.arg(metavar="N")] = 72
    """Frames of the orbit, at 24 a second; 0: no video."""
    seed: int = 0
    """Seed of the search for the plane."""
    device: str = "auto"
    """Device of the networks: auto, cpu, or cuda."""

    def run(self) -> int:
        """Insert, harmonize, write, and return the exit code."""
        from multilight.model.captures.run import Sources, insert_into_files

        sources = Sources(
            self.capture, self.asset, self.gaussians, self.depth_model, self.weights, self.weights_3d, self.device
        )
        from multilight.model.captures.placing import Wish

        wish = Wish(pose=self.pose, yaw=self.yaw, scale=self.scale, seed=self.seed)
        insert_into_files(
            sources, wish, self.out, max_side=self.max_side, every=self.every, side=self.side, frames=self.frames
        )
        print(f"inserted: {self.out}", file=sys.stdout)
        return 0
