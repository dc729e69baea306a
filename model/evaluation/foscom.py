"""Evaluation sets of others that a user has on disk, as cases: FOSCom, and what such sets have in common."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from multilight.datagen.errors import UserError
from multilight.model.evaluation.baselines import poisson_blend
from multilight.model.evaluation.cases import Case, Group, LazyGroup
from multilight.model.inference.depth import DepthModel, guessed_depth
from multilight.model.inference.pictures import read_mask, read_picture, resized
from multilight.scenes.arrays import Float32
from multilight.scenes.files.confined import OutsideError, inside
from multilight.scenes.files.limits import read_json, read_text

DIFFERS = 4.0 / 255.0
"""Difference in any channel, as displayed, from which on a composite shows the object where a set has no masks."""


def foscom_groups(root: Path, depth_model: DepthModel | None) -> list[LazyGroup]:
    """List the samples of FOSCom (B. Zhang et al., ControlCom, 2023): real composites without a truth.

    As it is published: `background/`, `foreground/`, `foreground_mask/`, and `bbox/` (text: x1 y1 x2 y2) or
    `mask_bbox/`, with the same names in each; the foreground is scaled to fill its box. Or as MV-CoLight prepares it:
    `scene_*/transforms.json` with `image_path` and `bg_path`, and `mask_path` where there is one.
    """
    scenes = prepared_scenes(root)
    if scenes:
        return [partial(_prepared_foscom, root, scene, depth_model) for scene in scenes]
    names = sorted((root / "background").glob("*.*"))
    if not names:
        raise UserError(f"{root} is not FOSCom: it holds neither background/ nor scene_*/transforms.json")
    return [partial(_published_foscom, root, path, depth_model) for path in names]


def prepared_scenes(root: Path) -> list[Path]:
    """List the scenes of a set as MV-CoLight prepares it."""
    return sorted(path.parent for path in root.glob("scene_*/transforms.json"))


def prepared_paths(root: Path, scene: Path, *wanted: str) -> dict[str, Path]:
    """Read the paths of a prepared scene, relative to the set's root; raises `UserError` where one is missing."""
    file = scene / "transforms.json"
    try:
        content: dict[str, Any] = read_json(file)
        return {
            key: inside(root, content[key], beside=root)
            for key in (*wanted, "mask_path")
            if key in wanted or key in content
        }
    except OutsideError as error:
        raise UserError(f"{file}: {error}; paths are relative to {root}") from None
    except (ValueError, KeyError, TypeError) as error:
        raise UserError(f"{file} cannot be read: it lacks {error}; it must name {', '.join(wanted)}") from None


def difference_mask(composite: Float32, background: Float32) -> Float32:
    """Return where two pictures (H, W, 3) differ, holes filled, as (H, W) float32 of 0 and 1."""
    differs = np.abs(composite - background).max(axis=-1) > DIFFERS
    return ndimage.binary_fill_holes(ndimage.binary_closing(differs, iterations=2)).astype(np.float32)


def filled(picture: Float32, mask: Float32) -> Float32:
    """Hide what a picture (H, W, 3) shows inside a mask (H, W): the smoothest surface that meets its outline."""
    return poisson_blend(np.zeros_like(picture), picture, mask)


def depth_of(picture: Float32, depth_model: DepthModel | None) -> Float32:
    """Estimate a picture's depth as networks see it, or guess level ground where there is no model."""
    return guessed_depth(*picture.shape[:2]) if depth_model is None else depth_model.estimate(picture)


def same_size(name: str, **pictures: Float32) -> None:
    """Raise `UserError` where pictures of a sample are not equal in height and width."""
    sizes = {key: picture.shape[:2] for key, picture in pictures.items()}
    if len(set(sizes.values())) > 1:
        raise UserError(f"{name}: sizes differ (height, width): {sizes}")


def prepared_pictures(root: Path, scene: Path, other: str) -> tuple[Float32, Float32, Float32]:
    """Read a prepared scene's composite, its `other` picture, and the mask, or where the two differ."""
    paths = prepared_paths(root, scene, "image_path", other)
    composite, picture = read_picture(paths["image_path"]), read_picture(paths[other])
    same_size(scene.name, composite=composite, **{other: picture})
    mask = read_mask(paths["mask_path"]) if "mask_path" in paths else difference_mask(composite, picture)
    return composite, picture, mask


def _prepared_foscom(root: Path, scene: Path, depth_model: DepthModel | None) -> Group:
    composite, background, mask = prepared_pictures(root, scene, "bg_path")
    case = Case(scene.name, composite, background, depth_of(composite, depth_model), mask)
    return Group((case,), ("FOSCom",))


def _published_foscom(root: Path, path: Path, depth_model: DepthModel | None) -> Group:
    background = read_picture(path)
    foreground = read_picture(_named(root / "foreground", path.stem))
    own_mask = read_mask(_named(root / "foreground_mask", path.stem))
    same_size(path.stem, foreground=foreground, foreground_mask=own_mask)
    left, top, right, bottom = _box(root, path.stem, background.shape[:2])
    mask = np.zeros(background.shape[:2], np.float32)
    mask[top:bottom, left:right] = resized(own_mask, (bottom - top, right - left))
    pasted = np.zeros_like(background)
    pasted[top:bottom, left:right] = resized(foreground, (bottom - top, right - left))
    composite = mask[..., None] * pasted + (1.0 - mask[..., None]) * background
    case = Case(path.stem, composite, background, depth_of(composite, depth_model), mask)
    return Group((case,), ("FOSCom",))


def _named(folder: Path, stem: str) -> Path:
    found = sorted(folder.glob(f"{stem}.*"))
    if not found:
        raise UserError(f"{folder} holds no file for {stem}")
    return found[0]


def _box(root: Path, stem: str, size: tuple[int, ...]) -> tuple[int, int, int, int]:
    """Return the box (left, top, right, bottom) in pixels where the object goes, cut to the picture."""
    text = root / "bbox" / f"{stem}.txt"
    if text.is_file():
        try:
            left, top, right, bottom = (int(word) for word in read_text(text).split()[:4])
        except ValueError:
            raise UserError(f"{text} must begin with four whole numbers: x1 y1 x2 y2") from None
    else:
        rows, columns = np.nonzero(read_mask(_named(root / "mask_bbox", stem)) > 0.5)
        left, top, right, bottom = columns.min(), rows.min(), columns.max() + 1, rows.max() + 1
    left, top, right, bottom = max(left, 0), max(top, 0), min(right, size[1]), min(bottom, size[0])
    if right <= left or bottom <= top:
        raise UserError(f"{root}: the box of {stem} is empty or beyond the picture: {(left, top, right, bottom)}")
    return int(left), int(top), int(right), int(bottom)
