"""A scene under one lighting as a capture: what a photographer would bring home, with depth and points besides."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from multilight.datagen.errors import UserError
from multilight.datagen.export.captures.points import ScenePoints, scene_points
from multilight.datagen.export.images import depth_mm, png, to_byte
from multilight.datagen.report import Report
from multilight.datagen.storage.copies import making
from multilight.datagen.storage.manifest import Settings
from multilight.datagen.storage.open_dataset import DatasetSource
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.tuples import compose
from multilight.lights.display.tonemap import to_display
from multilight.lights.spec import LightingCondition
from multilight.scenes.arrays import Float32, UInt8
from multilight.scenes.random_streams import Streams


@dataclass(frozen=True)
class Capture:
    """One lighting of a scene: tone-mapped pictures (H, W, 3) uint8 sRGB, a view each, with z_depth and environment
    of each view, and points."""

    record: SceneRecord
    depths: tuple[Float32, ...]
    environments: tuple[Float32, ...]
    points: ScenePoints
    condition: LightingCondition
    images: tuple[UInt8, ...]


Write = Callable[[Capture, Path], None]


def export_captures(
    source: DatasetSource,
    out: Path,
    write: Write,
    *,
    kind: Literal["nerfstudio", "colmap"],
    conditions: int | None,
    points: int,
    report: Report,
) -> int:
    """Write `out/scene_000000/<condition>/` for every scene and lighting with `write`, and return how many are there.

    `conditions` takes the first of each scene's. Folders that are there already, and undamaged, are kept.
    """
    if conditions is not None and conditions < 1:
        raise UserError(f"--conditions {conditions} must be 1 or more")
    if points < 1:
        raise UserError(f"--points {points} must be 1 or more")
    written = 0
    settings: Settings = {"points": points}
    if conditions is not None:
        settings["conditions"] = conditions
    with making(out, kind, source, settings) as copy:
        for done, record in enumerate(source.scenes()):
            if (conditions or 0) > len(record.conditions):
                most = len(record.conditions)
                raise UserError(f"--conditions {conditions} must be 1 to {most}, as many as scene {record.index} has")
            chosen = record.conditions[:conditions]
            scene = f"scene_{record.index:06d}"
            with source.passing_over(record.index):
                missing = [lit for lit in chosen if not copy.keeps(f"{scene}/{lit.name}", record.index)]
                for capture in _captures(source, record, missing, points):
                    with copy.filling_part(f"{scene}/{capture.condition.name}", record.index) as folder:
                        write(capture, folder)
                written += len(chosen)
            report(done + 1, len(source.indices))
        copy.finish()
    return written


def write_pictures(capture: Capture, folder: Path, *, mask_name: str) -> None:
    """Write `images/00.png`, `depths/00.png` (16-bit mm) and `masks/<mask_name>`, black where only sky is seen.

    `mask_name` holds `{}` for the view's two digits.
    """
    for name in ("images", "depths", "masks"):
        (folder / name).mkdir()
    views = zip(capture.images, capture.depths, capture.environments, strict=True)
    for number, (image, depth, sky) in enumerate(views):
        (folder / "images" / f"{number:02d}.png").write_bytes(png(image))
        (folder / "depths" / f"{number:02d}.png").write_bytes(png(depth_mm(depth)))
        mask = to_byte(sky < 0.5)
        (folder / "masks" / mask_name.format(f"{number:02d}")).write_bytes(png(mask))


def _captures(
    source: DatasetSource, record: SceneRecord, conditions: Sequence[LightingCondition], count: int
) -> Sequence[Capture]:
    """Read each view once and keep its pictures under each condition only: layers of all views would fill memory."""
    if not conditions:
        return ()
    geometry, pictures = [], []
    for view in source.views(record):
        geometry.append(view.geometry)
        pictures.append([to_display(compose.target(view, condition)) for condition in conditions])
    depths = tuple(buffers.z_depth for buffers in geometry)
    rng = Streams(record.seed, record.index, record.attempt)("export/points")
    normals = [buffers.normal_world for buffers in geometry]
    points = scene_points(record.scene.cameras, depths, normals, count=count, rng=rng)
    environments = tuple(buffers.environment for buffers in geometry)
    return [
        Capture(record, depths, environments, points, condition, tuple(lit))
        for condition, lit in zip(conditions, zip(*pictures, strict=True), strict=True)
    ]
