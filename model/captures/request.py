"""What is to be put into which capture; imports no torch."""

from dataclasses import dataclass, field
from pathlib import Path

from tyro.conf import Positional


@dataclass(frozen=True)
class Wish:
    """Where the object goes."""

    pose: Path | None = None
    """4x4 matrix (JSON, or 16 numbers), or JSON with position, yaw, scale. Default: on the largest plane that faces
    up, where there is room near the scene's centre."""
    yaw: float = 0.0
    """Rotation about the upright axis, in degrees."""
    scale: float | None = None
    """The capture's units of length in a metre (default: the object takes a fifth of the pictures' width, or
    less where there is less room)."""
    seed: int = 0
    """Seed of the search for the plane."""


@dataclass(frozen=True, kw_only=True)
class Insertion:
    """The capture, the object and its place, where depth comes from, the networks' weights, and the result's size."""

    capture: Positional[Path]
    """Folder of the capture."""
    asset: str
    """Object: a GLB, glTF or OBJ file, or an asset of the library as `pack/name`."""
    out: Path
    """Folder to write."""
    place: Wish = field(default_factory=Wish)
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
    frames: int = 72
    """Frames of the orbit, at 24 a second; 0: no video."""
    device: str = "auto"
    """Device of the networks: auto, cpu, or cuda."""
