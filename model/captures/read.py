"""Find out what a capture is, and read it."""

from pathlib import Path

from multilight.datagen.errors import UserError
from multilight.model.captures.capture import Capture
from multilight.model.captures.nerfstudio import read_nerfstudio


def read_capture(path: Path, *, max_side: int = 512, every: int = 1) -> Capture:
    """Read a nerfstudio or COLMAP folder; of one that holds pictures only, find the poses.

    Raises `UserError` naming what is missing.
    """
    if not path.exists():
        raise UserError(f"capture {path} does not exist")
    file = path / "transforms.json" if path.is_dir() else path
    if file.is_file():
        if file.suffix != ".json":
            raise UserError(f"{file} is not a capture; give its folder, or its transforms.json")
        return read_nerfstudio(file, max_side=max_side, every=every)
    from multilight.model.captures import colmap  # pycolmap is an extra

    model = colmap.colmap_model(path)
    if model is not None:
        return colmap.read_colmap(path, model, max_side=max_side, every=every)
    if not any(file.suffix.lower() in colmap.SUFFIXES for file in colmap.pictures_of(path).iterdir()):
        raise UserError(f"{path} is no capture: there is neither a transforms.json, nor sparse/0, nor a picture in it")
    return colmap.capture_from_images(path, max_side=max_side, every=every)
