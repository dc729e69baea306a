"""Read the pictures that a user wants harmonized; imports no torch."""

import sys
from pathlib import Path

import numpy as np

from multilight.datagen.errors import UserError
from multilight.model.inference.depth import DepthModel, depth_from_metres, guessed_depth
from multilight.model.inference.files import Files
from multilight.model.inference.pictures import read_depth, read_mask, read_picture
from multilight.scenes.arrays import Float32

ALIGNED = 0.1
"""Mean difference of composite and background beyond the object, as displayed, from which on they look misaligned."""


def read_files(files: Files) -> tuple[Float32, Float32, Float32, Float32]:
    """Return composite and background (H, W, 3), display-encoded, depth and mask (H, W), all in [0, 1].

    Raises `UserError` naming the file and what is wrong.
    """
    if files.depth and files.depth_model:
        raise UserError("give either --depth or --depth-model, not both")
    composite, background = read_picture(files.composite), read_picture(files.background)
    mask = read_mask(files.mask)
    _same_size(files.composite, composite, [(files.background, background), (files.mask, mask)])
    if files.depth:
        measured = read_depth(files.depth)
        _same_size(files.composite, composite, [(files.depth, measured)])
        depth = depth_from_metres(measured)
    elif files.depth_model:
        depth = DepthModel.load(files.depth_model).estimate(composite)
    else:
        print("no depth is given: level ground is assumed; --depth or --depth-model make it better", file=sys.stderr)
        depth = guessed_depth(*mask.shape)
    beyond = mask < 0.5 / 255.0
    if beyond.any() and np.abs(composite - background)[beyond].mean() > ALIGNED:
        print(
            f"composite and background differ beyond the mask by {np.abs(composite - background)[beyond].mean():.2f} "
            "of full scale: are they aligned, and is the mask the object's?",
            file=sys.stderr,
        )
    return composite, background, depth, mask


def _same_size(path: Path, picture: Float32, others: list[tuple[Path, Float32]]) -> None:
    for other_path, other in others:
        if other.shape[:2] != picture.shape[:2]:
            (h, w), (oh, ow) = picture.shape[:2], other.shape[:2]
            raise UserError(f"{other_path} is {ow} x {oh} pixels, {path} is {w} x {h}: make them of equal size")
