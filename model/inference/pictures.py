"""Pictures, masks and depths read from files that people have, with messages that say what is wrong with them."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps, UnidentifiedImageError

from multilight.datagen.errors import UserError, reason_of
from multilight.datagen.files.outputs import check_file, written
from multilight.scenes.arrays import Float32, UInt8
from multilight.scenes.files.exr import read_exr
from multilight.scenes.files.limits import open_picture, read_npy

INFINITE = 1e9
"""Depths from here on are infinite, in any unit: Blender writes 1e10 where a ray meets nothing."""


def opened(path: Path) -> Image.Image:
    """Open and decode a picture, as its pixels lie in the file; raises `UserError` naming it where that fails."""
    try:
        with open_picture(path) as image:
            image.load()
    except FileNotFoundError:
        raise UserError(f"{path} does not exist") from None
    except UnidentifiedImageError:
        raise UserError(f"{path} is not a picture that can be read; use PNG, JPEG, TIFF or WebP") from None
    except (OSError, SyntaxError, ValueError) as error:
        raise UserError(f"{path} cannot be read: {reason_of(error)}") from None
    return image


def read_picture(path: Path) -> Float32:
    """Read a display-encoded picture, rotated upright as its camera noted: (H, W, 3) float32 in [0, 1]."""
    return np.asarray(ImageOps.exif_transpose(opened(path)).convert("RGB"), np.float32) / 255.0


def read_mask(path: Path) -> Float32:
    """Read a mask: (H, W) float32 in [0, 1], 1 on the object; raises `UserError` where it marks nothing."""
    mask = np.asarray(ImageOps.exif_transpose(opened(path)).convert("L"), np.float32) / 255.0
    if mask.max() < 0.5:
        raise UserError(f"mask {path} marks nothing: the object must be white (255), all else black (0)")
    return mask


def read_depth(path: Path) -> Float32:
    """Read the depth along the optical axis, in any unit: (H, W) float32, 0 where unknown or infinitely far.

    `.npy` of floats, OpenEXR, or a picture of one channel (8 or 16 bits, or float TIFF).
    """
    if path.suffix.lower() in (".npy", ".exr"):
        try:
            depth = read_npy(path) if path.suffix.lower() == ".npy" else _depth_channel(read_exr(path))
        except FileNotFoundError:
            raise UserError(f"depth {path} does not exist") from None
        except (OSError, ValueError) as error:
            raise UserError(f"depth {path} cannot be read: {reason_of(error)}") from None
    else:
        depth = np.asarray(opened(path))
    depth = np.squeeze(np.asarray(depth, np.float32))
    if depth.ndim != 2 or not depth.size:
        raise UserError(f"depth {path} has shape {depth.shape}; it must be one number a pixel (H, W)")
    if np.isnan(depth).any():
        raise UserError(f"depth {path} holds NaN on {np.isnan(depth).sum()} pixels; write 0 where it is unknown")
    depth = np.where(np.isinf(depth) | (depth >= INFINITE), np.float32(0.0), depth)
    if depth.min() < 0 or depth.max() <= 0:
        raise UserError(f"depth {path} runs from {depth.min():g} to {depth.max():g}; it must be positive, 0 if unknown")
    return depth


def _depth_channel(channels: dict[str, NDArray[Any]]) -> NDArray[Any]:
    """Return the depth among an OpenEXR file's channels: the only one, `Z`, Blender's `Depth`, or a grey picture's."""
    named = [name for name in channels if name == "Z" or "depth" in name.lower().split(".")]
    if len(channels) == 1 or len(named) == 1:
        return channels[named[0] if named else next(iter(channels))]
    if not named and {"R", "G", "B"} <= set(channels):
        red, green, blue = (channels[name] for name in "RGB")
        if np.array_equal(red, green) and np.array_equal(red, blue):
            return red
    raise ValueError(f"its channels are {', '.join(channels)}; write the depth alone, or as Z")


def check_picture(path: Path) -> None:
    """See that a picture can be written, making its folder; raises `UserError` in one line where that cannot be."""
    if Image.registered_extensions().get(path.suffix.lower()) not in Image.SAVE:
        raise UserError(f"{path}: no picture is written that ends in {path.suffix or 'nothing'!r}; use .png or .jpg")
    check_file(path)


def write_picture(path: Path, picture: Float32) -> None:
    """Write a display-encoded picture (H, W, 3) in [0, 1] with 8 bits, in the format that the name ends in."""
    with written(path) as work:
        Image.fromarray(to_bytes(picture)).save(work, quality=95)


def to_bytes(picture: NDArray[np.floating]) -> UInt8:
    """Round values in [0, 1] to 8 bits."""
    return np.rint(np.clip(picture, 0.0, 1.0) * 255.0).astype(np.uint8)


def resized(picture: Float32, size: tuple[int, int]) -> Float32:
    """Resize (H, W) or (H, W, C) to (height, width) with a triangle filter that is as wide as the reduction asks."""
    planes = picture[..., None] if picture.ndim == 2 else picture
    shape = (size[1], size[0])
    every = [Image.fromarray(p).resize(shape, Image.Resampling.BILINEAR) for p in np.moveaxis(planes, -1, 0)]
    return np.stack([np.asarray(image, np.float32) for image in every], axis=-1).reshape(*size, *picture.shape[2:])
