"""LuxRemix' layout: per-light HDR layers of each view, mixes, geometry and masks, a folder a scene.

The layout is public (docs/FORMAT.md of facebookresearch/luxremix-dataset). Ours differs in what it must: views are
perspective pictures, not panoramas; previews carry our tone curve; there is no `transind`, which we do not render; and
every light but the environment has a layer. The HDR files hold radiance as rendered, so
mix = background + the sum over lights of (power * color of the mix / power * color of pass 0000) * layer.
"""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from multilight.datagen.export.files import write_json
from multilight.datagen.export.images import jpeg, png, to_byte
from multilight.datagen.export.luxremix.meta import Passes, draw_passes, metadata
from multilight.datagen.export.tars import TarShards
from multilight.datagen.report import Report
from multilight.datagen.storage.copies import making
from multilight.datagen.storage.halves import in_half
from multilight.datagen.storage.object_variants import ALL
from multilight.datagen.storage.open_dataset import DatasetSource
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.store import ViewData, write_exr
from multilight.lights.display.tonemap import to_display
from multilight.lights.relight import mix
from multilight.lights.spec import EmissiveLight
from multilight.scenes.arrays import Float32, UInt8
from multilight.scenes.cameras.pinhole import ray_distance_from_z_depth
from multilight.scenes.colour import srgb_encode

SCENES_A_TAR = 10
SHINES = {False: 0.5, True: 0.05}
"""Fraction of a glowing surface's radiance above which a pixel counts as its source; less where a picture dims it."""

Files = dict[str, bytes]


@dataclass
class LuxremixOutcome:
    """What was written: scenes and layers; `unlit` scenes have no light besides their environment, so no layers."""

    scenes: int = 0
    layers: int = 0
    unlit: list[int] = field(default_factory=list)


def export_luxremix(source: DatasetSource, out: Path, *, tar: bool, report: Report) -> LuxremixOutcome:
    """Write every scene as a folder `000123`, kept where it is there, or all into new tars of ten scenes."""
    with making(out, "luxremix", source, {"tar": tar}) as copy:
        if tar and copy.holds(record.index for record in source.scenes() if draw_passes(record).lights):
            return _each(source, lambda record, passes: None, report)
        if tar:
            shards = partial(TarShards, most_bytes=1 << 62, most_groups=SCENES_A_TAR, digits=4)
            with copy.filling() as (folder, scenes), shards(folder) as tars:

                def pack(record: SceneRecord, passes: Passes) -> None:
                    tars.add("training" if record.split == "train" else "test", _packed(source, record, passes))
                    scenes.append(record.index)

                return _each(source, pack, report)

        def write(record: SceneRecord, passes: Passes) -> None:
            name = f"{record.index:06d}"
            if not copy.keeps(name, record.index):
                with copy.filling_part(name, record.index) as folder:
                    write_scene(source, record, passes, folder)

        outcome = _each(source, write, report)
        copy.finish()
        return outcome


def _each(source: DatasetSource, write: Callable[[SceneRecord, Passes], None], report: Report) -> LuxremixOutcome:
    """Have every scene with layers written, and count."""
    outcome = LuxremixOutcome()
    for done, record in enumerate(source.scenes()):
        passes = draw_passes(record)
        if not passes.lights:
            outcome.unlit.append(record.index)
        else:
            with source.passing_over(record.index):
                write(record, passes)
                outcome.scenes += 1
                outcome.layers += len(passes.lights) * len(record.views)
        report(done + 1, len(source.indices))
    return outcome


def _packed(source: DatasetSource, record: SceneRecord, passes: Passes) -> Files:
    with tempfile.TemporaryDirectory(prefix="multilight-") as temporary:
        write_scene(source, record, passes, Path(temporary))
        paths = sorted(Path(temporary).iterdir())
        return {f"{record.index:06d}/{path.name}": path.read_bytes() for path in paths}


def write_scene(source: DatasetSource, record: SceneRecord, passes: Passes, folder: Path) -> None:
    """Write all files of a scene; views are numbered from 0001."""
    near_far = []
    for number, view in enumerate(source.views(record), 1):
        seen = view.geometry.z_depth[view.geometry.z_depth > 0]
        near_far.append((float(seen.min(initial=np.inf)), float(seen.max(initial=0.0))) if seen.size else (0.0, 0.0))
        _write_light(folder, number, view, passes)
        _write_geometry(folder, number, view, record, passes)
    for name, content in metadata(record, passes, near_far).items():
        write_json(folder / f"{name:04d}.meta.json", content)


def _write_light(folder: Path, number: int, view: ViewData, passes: Passes) -> None:
    """Write the mixes (passes 0 to 3), the environment (1000) and each light alone (1001 on)."""
    layers = view.variants[ALL]

    def write(name: int, kind: str, picture: Float32, channels: dict[str, NDArray[np.floating]]) -> None:
        stem = f"{name:04d}.{number:04d}"
        write_exr(folder / f"{stem}.rgb_{kind}.exr", channels)
        (folder / f"{stem}.rgb_ldr_{kind}.png").write_bytes(png(to_display(picture, passes.exposure_ev)))

    for name, condition in enumerate(passes.mixes):
        picture = mix(layers, view.lights, condition)
        write(name, "mix", picture, _rgba(picture))
    background = mix(layers, view.lights, passes.background)
    write(1000, "bg", background, _rgba(background))
    for name, light in enumerate(passes.lights, 1001):
        layer = layers[view.lights.index(light.name)]
        write(name, "olat", layer, dict(zip("RGB", np.moveaxis(layer, -1, 0), strict=True)))


def _write_geometry(folder: Path, number: int, view: ViewData, record: SceneRecord, passes: Passes) -> None:
    buffers = view.geometry
    stem = f"0000.{number:04d}"
    distance = ray_distance_from_z_depth(record.scene.cameras[number - 1], buffers.z_depth)
    write_exr(folder / f"{stem}.depth.exr", {"Y": distance.astype(np.float32)})
    fixtures, sources = light_masks(view, record, passes)
    pictures = {
        "normal": to_byte(buffers.normal_world * 0.5 + 0.5),
        "window": to_byte(buffers.environment),
        "lgt_obj": fixtures,
        "lgt_src": sources,
    }
    for kind, pixels in pictures.items():
        (folder / f"{stem}.{kind}.png").write_bytes(png(pixels))
    (folder / f"{stem}.diffcol.jpg").write_bytes(jpeg(to_byte(srgb_encode(buffers.albedo)), quality=98))


def light_masks(view: ViewData, record: SceneRecord, passes: Passes) -> tuple[UInt8, UInt8]:
    """Paint the bodies that glow, and the parts of them that shine, in their light's colour, (H, W, 3) uint8 each."""
    ids = view.geometry.instance_id
    fixtures, sources = np.zeros((2, *ids.shape, 3), np.uint8)
    for light in passes.lights:
        if isinstance(light, EmissiveLight):
            body = ids == record.scene.instance_id(light.body)
            layer = view.variants[ALL][view.lights.index(light.name)]
            limit = SHINES[light.texture is not None] * max(light.radiance)
            fixtures[body] = passes.colours[light.name]
            sources[body & (layer.max(axis=-1) > limit)] = passes.colours[light.name]
    return fixtures, sources


def _rgba(picture: Float32) -> dict[str, NDArray[np.floating]]:
    planes = np.moveaxis(in_half(picture), -1, 0)
    return dict(zip("RGB", planes, strict=True)) | {"A": np.ones_like(planes[0])}
