"""Objects With Lighting (B. Ummenhofer et al., 2024), read where a user has it, as cases."""

from functools import partial
from pathlib import Path

import numpy as np

from multilight.datagen.errors import UserError
from multilight.model.evaluation.baselines import with_colours_of
from multilight.model.evaluation.cases import Case, Group, LazyGroup
from multilight.model.evaluation.foscom import depth_of, filled, prepared_pictures, prepared_scenes, same_size
from multilight.model.evaluation.run import GAMMA
from multilight.model.inference.depth import DepthModel
from multilight.model.inference.pictures import read_mask, read_picture
from multilight.scenes.arrays import Float32, Float64, Mask
from multilight.scenes.files.limits import read_text


def camera_centre(path: Path) -> Float64:
    """Read where a camera stands, (3,): of a file of eight rows of three numbers, K, R, t, and width, height, channels.

    A point X is seen at K (R X + t).
    """
    rows = _numbers(path)
    if rows.shape != (8, 3):
        raise UserError(f"{path} holds {rows.shape} numbers; a camera has 8 rows of 3: K, R, t, width height channels")
    return -rows[3:6].T @ rows[6]


def read_exposure(path: Path) -> float:
    """Read an exposure [EV]: a single number."""
    value = _numbers(path)
    if value.size != 1:
        raise UserError(f"{path} must hold a single number")
    return float(value.item())


def owl_groups(root: Path, depth_model: DepthModel | None) -> list[LazyGroup]:
    """List the set's true pictures as cases, with the exposure to be fitted.

    The set has no picture of a true object in another light, so the composite is made as for iHarmony4 (W. Cong et
    al., 2020): the object of the true picture takes on the colours (mean and spread in CIELAB) that it has in the input
    picture seen from the nearest direction, whose environment is another, at the true picture's exposure. The light's
    direction stays. The background is the true picture with the object filled in smoothly. Scores are those of the
    pixels that the set calls valid.

    As MV-CoLight prepares it (`scene_*/transforms.json` with `image_path` and `gt_path`), the composite is given.
    Raises `UserError` where `root` holds neither.
    """
    scenes = prepared_scenes(root)
    if scenes:
        return [partial(_prepared, root, scene, depth_model) for scene in scenes]
    folder = root / "dataset" if (root / "dataset").is_dir() else root
    pictures = sorted(folder.glob("*/test/gt_image_*.png"))
    if not pictures:
        raise UserError(f"{root} is not Objects With Lighting: it holds no OBJECT/test/gt_image_*.png")
    return [partial(_published, path, depth_model) for path in pictures]


def _published(path: Path, depth_model: DepthModel | None) -> Group:
    name = f"{path.parent.parent.name} {path.stem[-4:]}"
    truth = read_picture(path)
    mask = read_mask(path.with_name(path.name.replace("image", "mask")))
    same_size(name, truth=truth, mask=mask)
    composite, inside = np.array(truth), mask > 0.5
    composite[inside] = with_colours_of(truth, inside, _input_colours(path))[inside]
    return _group(name, composite, truth, mask, depth_model, valid=mask >= 1.0)


def _input_colours(path: Path) -> Float32:
    """Return the object's pixels (N, 3) in the nearest input picture, exposed as the true picture is."""
    number, folder = path.stem[-4:], path.parent
    eye = camera_centre(folder / f"gt_camera_{number}.txt")
    inputs = {file: camera_centre(file) for file in sorted((folder / "inputs").glob("camera_*.txt"))}
    if not inputs:
        raise UserError(f"{folder / 'inputs'} holds no camera_*.txt")
    centre = _numbers(folder / "inputs" / "object_bounding_box.txt").reshape(3, 2).mean(axis=1)
    nearest = max(inputs, key=lambda file: _cosine(inputs[file] - centre, eye - centre))
    shown = nearest.stem.removeprefix("camera")
    picture = read_picture(nearest.with_name(f"image{shown}.png"))
    pixels = picture[read_mask(nearest.with_name(f"mask{shown}.png")) > 0.5]
    stops = read_exposure(folder / f"gt_exposure_{number}.txt") - read_exposure(folder / "inputs" / "exposure.txt")
    return np.clip(pixels**GAMMA * 2.0**stops, 0.0, 1.0).astype(np.float32) ** np.float32(1.0 / GAMMA)


def _prepared(root: Path, scene: Path, depth_model: DepthModel | None) -> Group:
    composite, truth, mask = prepared_pictures(root, scene, "gt_path")
    return _group(scene.name, composite, truth, mask, depth_model)


def _group(
    name: str, composite: Float32, truth: Float32, mask: Float32, model: DepthModel | None, valid: Mask | None = None
) -> Group:
    background, depth = filled(truth, mask), depth_of(composite, model)
    case = Case(name, composite, background, depth, mask, target=truth, valid=valid, fit_exposure=True)
    return Group((case,), ("OWL",))


def _cosine(a: Float64, b: Float64) -> float:
    return float(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)))


def _numbers(path: Path) -> Float64:
    try:
        return np.loadtxt(read_text(path).splitlines(), dtype=np.float64)
    except FileNotFoundError:
        raise UserError(f"{path} does not exist") from None
    except (OSError, ValueError) as error:
        raise UserError(f"{path} cannot be read: {error}") from None
