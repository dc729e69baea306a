"""Captures in COLMAP's layout, and poses found from pictures alone; both through pycolmap."""

import tempfile
from pathlib import Path

import numpy as np
import pycolmap

from multilight.datagen.errors import UserError
from multilight.model.captures.capture import Capture, Shot, load_shots
from multilight.model.captures.lenses import Lens
from multilight.scenes.cameras.pinhole import opencv_from_opengl
from multilight.scenes.files.confined import OutsideError, inside

SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff")
MODELS = ("sparse/0", "sparse", "colmap/sparse/0", ".")
"""Where a COLMAP model may lie in a capture's folder."""
MISFIT = 8.0
"""Median error [pixels] of the reprojected points from which on cameras cannot be right."""
SEED = 0
FAINT = 0.002
"""Contrast of the faintest features; COLMAP's own 0.0067 leaves few on small, smooth pictures."""
DEMANDS: tuple[dict[str, float], ...] = (
    {},
    {"init_min_num_inliers": 40, "init_min_tri_angle": 8.0, "abs_pose_min_num_inliers": 15},
    {
        "init_min_num_inliers": 30, "init_min_tri_angle": 4.0, "abs_pose_min_num_inliers": 12,
        "abs_pose_min_inlier_ratio": 0.15,
    },
)  # fmt: skip
"""What the mapper demands of a first pair and of each further picture: COLMAP's defaults, then ever less, until all
pictures are placed. Small pictures have few features."""


def colmap_model(folder: Path) -> Path | None:
    """Return the folder of a capture's COLMAP model, if it has one."""
    for name in MODELS:
        for suffix in ("bin", "txt"):
            if (folder / name / f"images.{suffix}").is_file():
                return folder / name
    return None


def read_colmap(folder: Path, model: Path, *, max_side: int, every: int = 1) -> Capture:
    """Read a COLMAP model with its pictures in `images/`, and depth, where there is any.

    Depth: `stereo/depth_maps/NAME.geometric.bin` (COLMAP's own), or `depths/NAME.png`, 16 bits in thousandths of the
    unit of length. `every` takes each n-th picture by name. Raises `UserError` naming what is missing or wrong.
    """
    try:
        found = pycolmap.Reconstruction(model)
    except (ValueError, RuntimeError, OSError, IndexError) as error:
        raise UserError(f"COLMAP model {model} cannot be read: {str(error).splitlines()[0]}") from None
    return _capture(folder, pictures_of(folder), found, max_side=max_side, every=every)


def capture_from_images(folder: Path, *, max_side: int, every: int = 1) -> Capture:
    """Find the poses of a folder of pictures, taken with one camera, and return them as a capture without depth."""
    pictures = pictures_of(folder)
    return _capture(folder, pictures, find_poses(pictures), max_side=max_side, every=every)


def pictures_of(folder: Path) -> Path:
    """Return the folder that holds a capture's pictures."""
    return folder / "images" if (folder / "images").is_dir() else folder


def find_poses(pictures: Path) -> pycolmap.Reconstruction:
    """Find camera poses, lens and sparse points of a folder of pictures, in a frame and unit of their own.

    SIFT, all pairs matched, incremental mapping; one lens for all. Raises `UserError` where fewer than half of the
    pictures, or fewer than two, could be placed.
    """
    names = sorted(path.name for path in pictures.iterdir() if path.suffix.lower() in SUFFIXES)
    if len(names) < 2:
        raise UserError(f"{pictures} holds {len(names)} pictures; poses need two or more that overlap")
    pycolmap.set_random_seed(SEED)
    pycolmap.logging.minloglevel = pycolmap.logging.Level.FATAL
    best: pycolmap.Reconstruction | None = None
    with tempfile.TemporaryDirectory() as work:
        database = Path(work) / "database.db"
        features = pycolmap.FeatureExtractionOptions()
        features.sift.peak_threshold = FAINT
        pycolmap.extract_features(
            database, pictures, names, camera_mode=pycolmap.CameraMode.SINGLE, extraction_options=features
        )
        pycolmap.match_exhaustive(database)
        for demands in DEMANDS:
            options = pycolmap.IncrementalPipelineOptions(min_model_size=2, multiple_models=False, random_seed=SEED)
            for name, value in demands.items():
                setattr(options.mapper, name, value)
            made = pycolmap.incremental_mapping(database, pictures, Path(work), options)
            best = max([best, *made.values()], key=_placed)
            if _placed(best) == len(names):
                break
    if best is None or _placed(best) < max(2, len(names) / 2):
        raise UserError(
            f"{pictures}: only {_placed(best)} of {len(names)} pictures could be placed; take more that overlap "
            "by two thirds, of a scene with texture, or give poses (transforms.json, or a COLMAP model)"
        )
    return best


def _placed(found: pycolmap.Reconstruction | None) -> int:
    return 0 if found is None else int(found.num_reg_images())


def _capture(folder: Path, pictures: Path, found: pycolmap.Reconstruction, *, max_side: int, every: int) -> Capture:
    numbers = sorted(found.points3D)
    place = {number: i for i, number in enumerate(numbers)}
    points = np.array([found.points3D[number].xyz for number in numbers]).reshape(-1, 3)
    images = sorted((image for image in found.images.values() if image.has_pose), key=lambda image: image.name)
    shots, seen = [], []
    for image in images[::every]:
        camera = found.cameras[image.camera_id]
        _check(folder, image, camera, found)
        lens = Lens(camera.model.name, camera.width, camera.height, tuple(float(p) for p in camera.params))
        pose = np.eye(4)
        pose[:3] = image.cam_from_world().inverse().matrix()
        try:
            picture = inside(pictures, image.name)
            depth, unit = _depth(folder, image.name)
        except OutsideError as error:
            raise UserError(f"{folder}: {error}") from None
        shots.append(Shot(image.name, picture, lens, opencv_from_opengl(pose), depth, unit))
        seen.append(np.unique([place[p.point3D_id] for p in image.points2D if p.has_point3D()]).astype(np.int64))
    return load_shots(folder, shots, max_side=max_side, points=points, seen=tuple(seen))


def _check(folder: Path, image: pycolmap.Image, camera: pycolmap.Camera, found: pycolmap.Reconstruction) -> None:
    """Raise `UserError` where a picture's points do not project to where they were seen."""
    tracked = [p for p in image.points2D if p.has_point3D()]
    if not tracked:
        return
    local = image.cam_from_world() * np.array([found.points3D[p.point3D_id].xyz for p in tracked])
    pixels = camera.img_from_cam(local)
    errors = np.linalg.norm(pixels - np.array([p.xy for p in tracked]), axis=1)
    error = float(np.median(np.nan_to_num(errors, nan=np.inf)))
    if error > MISFIT:
        raise UserError(
            f"{folder}: the points that {image.name} sees project {error:.0f} pixels away from where it saw them: "
            "its camera is wrong"
        )


def _depth(folder: Path, name: str) -> tuple[Path | None, float]:
    dense = folder / "stereo" / "depth_maps"
    for file, unit in (
        (dense / f"{name}.geometric.bin", 1.0),
        (dense / f"{name}.photometric.bin", 1.0),
        (folder / "depths" / f"{name}.png", 0.001),
        ((folder / "depths" / name).with_suffix(".png"), 0.001),
    ):
        if file.is_file():
            return file, unit
    return None, 1.0
