"""What is to be put into which capture; imports no torch."""

from dataclasses import dataclass, field
from pathlib import Path

from tyro.conf import Positional

from multilight.datagen.errors import UserError

MOST_FRAMES = 10_000
MOST_SIDE = 2048
"""Cells a side of the largest map: four million Gaussians."""


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
    weights: Path = Path("slim")
    """Weights of the 2D stage: a file, or ready-made ones by name."""
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

    def check(self) -> None:
        """Raise `UserError` for whatever can be known to be wrong before torch is loaded and the work starts."""
        from multilight.datagen.files.outputs import check_folder
        from multilight.model.configs.checks import check_file, check_range
        from multilight.model.configs.ready_made import check_device, weights_config
        from multilight.model.configs.stage2d import NetworkConfig
        from multilight.model.configs.stage3d import SceneNetworkConfig

        check_range("--frames", self.frames, 0, MOST_FRAMES)
        check_range("--every", self.every, 1, 10**6)
        check_range("--max-side", self.max_side, 16, 8192)
        check_range("--seed", self.place.seed, 0, 2**32 - 1)
        if not 0 < self.side <= MOST_SIDE or self.side & (self.side - 1):
            raise UserError(f"--side {self.side} must be a power of two of at most {MOST_SIDE}: 128, 256, 512, say")
        if self.place.scale is not None and self.place.scale <= 0:
            raise UserError(f"--scale {self.place.scale} must be above 0")
        if self.gaussians is not None and self.depth_model is not None:
            raise UserError("give either --gaussians or --depth-model, not both")
        check_device(self.device)
        weights_config(self.weights, NetworkConfig)
        if self.weights_3d is not None:
            weights_config(self.weights_3d, SceneNetworkConfig)
        for name in ("gaussians", "depth_model"):
            check_file(f"--{name.replace('_', '-')}", getattr(self, name))
        check_file("--pose", self.place.pose)
        if not self.capture.exists():
            raise UserError(f"capture {self.capture} does not exist")
        from multilight.model.captures.assets import check_asset  # trimesh takes a while

        check_asset(self.asset)
        check_folder(self.out)
