"""Environment maps: bpy's own and those of the npm package `@pmndrs/assets`, cleaned into the cache."""

import base64
import hashlib
import importlib.util
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from multilight.scenes.arrays import Float32
from multilight.scenes.assets.cache import write_once
from multilight.scenes.assets.info import AssetError, AssetInfo
from multilight.scenes.assets.packs.pack import Pack
from multilight.scenes.files.exr import read_exr
from multilight.scenes.files.limits import check_pixels

LARGEST_HALF = 65504.0


@dataclass(frozen=True)
class _Map:
    """Where a map was taken, and what it is good for."""

    category: str
    place: str


# Places carry Poly Haven's names where known; both studio maps show the same room.
BPY_MAPS = {
    "city": _Map("outdoor", "portland_landing_pad"),
    "courtyard": _Map("outdoor", "courtyard"),
    "forest": _Map("outdoor", "ninomaru_teien"),
    "interior": _Map("indoor", "hotel_room"),
    "night": _Map("night", "moonless_golf"),
    "studio": _Map("studio", "studio_small"),
    "sunrise": _Map("outdoor", "spruit_sunrise"),
    "sunset": _Map("outdoor", "venice_sunset"),
}
# Not "park": all that is left of its sun is one pixel of 11,800 in blue.
PMNDRS_MAPS = {
    "apartment": _Map("indoor", "lebombo"),
    "bridge": _Map("indoor", "adams_place_bridge"),
    "city": _Map("outdoor", "potsdamer_platz"),
    "dawn": _Map("outdoor", "kiara_dawn"),
    "esplanade": _Map("indoor", "royal_esplanade"),
    "forest": _Map("outdoor", "forest_slope"),
    "hall": _Map("indoor", "dancing_hall"),
    "lab": _Map("indoor", "lab"),
    "lobby": _Map("indoor", "st_fagans_interior"),
    "night": _Map("night", "dikhololo_night"),
    "sky": _Map("outdoor", "sky"),
    "studio": _Map("studio", "studio_small"),
    "sunrise": _Map("outdoor", "spruit_sunrise"),
    "sunset": _Map("outdoor", "piazza_san_marco"),
    "venice": _Map("outdoor", "venice_dawn"),
    "warehouse": _Map("indoor", "empty_warehouse"),
    "workshop": _Map("indoor", "workshop"),
}


def _infos(pack: str, maps: dict[str, _Map], names: list[str], prefix: str) -> list[AssetInfo]:
    return [
        AssetInfo(
            id=f"{pack}/{prefix}{name}",
            pack=pack,
            role="environment",
            name=name,
            category=maps[name].category,
            licence="CC0-1.0",
            creator="Poly Haven",
            place=maps[name].place,
        )
        for name in names
    ]


def read_environment(path: Path) -> Float32:
    """Read an equirectangular EXR as (H, W, 3) float32; of luminance alone it is grey.

    Raises `AssetError` where it is broken, not finite, black, or not twice as wide as high.
    """
    try:
        channels = read_exr(path)
        names = "YYY" if "Y" in channels and "R" not in channels else "RGB"
        image = np.stack([channels[c] for c in names], axis=-1).astype(np.float32)
    except (OSError, ValueError, KeyError) as error:
        raise AssetError(f"{path} is not a readable RGB EXR file: {error}") from error
    check_map(image, str(path))
    return image


def read_hdr(data: bytes, name: str) -> Float32:
    """Decode a Radiance picture (.hdr, RGBE), (H, W, 3) float32; raises `AssetError` with `name` where it is broken.

    Source: G. Ward, "Real Pixels", Graphics Gems II, 1991; run lengths as in Radiance's color.c.
    """
    try:
        start = data.index(b"\n\n") + 2
        size = re.fullmatch(rb"-Y (\d+) \+X (\d+)", data[start : data.index(b"\n", start)])
        if not data.startswith(b"#?") or size is None:
            raise ValueError("its header is none that is read")
        height, width = (int(v) for v in size.groups())
        check_pixels(width, height)
        rows, place = np.empty((height, 4, width), np.uint8), data.index(b"\n", start) + 1
        for row in rows:
            if data[place : place + 2] != b"\x02\x02" or width > 0x7FFF or width < 8:
                row[:] = np.frombuffer(data, np.uint8, 4 * width, place).reshape(width, 4).T
                place += 4 * width
            else:
                place = _runs(data, place + 4, row.reshape(-1), width)
    except (ValueError, IndexError) as error:
        raise AssetError(f"{name} is not a readable HDR picture ({error}); save it as EXR") from error
    scale = np.ldexp(1.0, rows[:, 3].astype(np.int32) - 136)[..., None] * (rows[:, 3] > 0)[..., None]
    return np.asarray((rows[:, :3].transpose(0, 2, 1) + 0.5) * scale, np.float32)


def _runs(data: bytes, place: int, row: NDArray[np.uint8], width: int) -> int:
    """Decode the run lengths of a line's four channels into `row`; returns the place behind them."""
    filled = 0
    while filled < 4 * width:
        count = data[place]
        if count > 128:  # so many of one value
            count -= 128
            row[filled : filled + count] = data[place + 1]
            place += 2
        else:
            row[filled : filled + count] = np.frombuffer(data, np.uint8, count, place + 1)
            place += 1 + count
        filled += max(count, 1)
    return place


def check_map(image: Float32, name: str) -> None:
    """Raise `AssetError` where (H, W, 3) is no map of a sky: not finite, black, or not twice as wide as high."""
    if not np.isfinite(image).all():
        raise AssetError(f"{name} holds NaN or infinity; repair it, or leave it out")
    if not image.max() > 0:
        raise AssetError(f"{name} is black; leave it out")
    if image.shape[1] != 2 * image.shape[0]:
        raise AssetError(
            f"{name} is {image.shape[1]} x {image.shape[0]} pixels; a latitude-longitude map is twice as wide as high"
        )


def keep_map(image: Float32, name: str, folder: Path) -> str:
    """Write a sky (H, W, 3) into `folder` under a name made of what it holds, which is returned.

    Raises `AssetError` with `name` where it cannot serve.
    """
    check_map(image, name)
    kept = f"sky-{hashlib.sha256(f'{image.shape}'.encode() + image.tobytes()).hexdigest()[:32]}"
    write_once(folder / f"{kept}.exr", lambda path: _write_half(image, path))
    return kept


def without_negatives(image: Float32) -> Float32:
    """Replace what down-sampling with negative lobes left below zero by the median of its valid neighbours.

    image (H, W, 3); wraps around in azimuth. A pixel counts as one: a negative channel takes its others along.
    """
    bad = (image < 0).any(axis=-1)
    if not bad.any():
        return image
    masked = np.where(bad[..., None], np.nan, image)
    result = image.copy()
    for y, x in np.argwhere(bad):
        rows = slice(max(0, y - 2), y + 3)
        near = masked[rows].take(range(x - 2, x + 3), axis=1, mode="wrap").reshape(-1, 3)
        near = near[np.isfinite(near).all(axis=1)]
        result[y, x] = np.median(near, axis=0) if len(near) else np.maximum(image[y, x], 0)
    return result


def clean_copy(source: Path, target: Path) -> Path:
    """Write a non-negative half-float copy of an environment map, once."""

    return write_once(target, lambda path: _write_half(read_environment(source), path))


def _write_half(image: Float32, path: Path) -> None:
    half = np.clip(without_negatives(image), 0, LARGEST_HALF).astype(np.float16)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"RGB": half}) as file:
        file.write(str(path))


def _bpy_folder() -> Path | None:
    """Find bpy's own environment maps without importing bpy."""
    spec = importlib.util.find_spec("bpy")
    if spec is None or spec.origin is None:
        return None
    return next(iter(sorted(Path(spec.origin).parent.glob("*/datafiles/studiolights/world"))), None)


def bpy_environments() -> list[AssetInfo]:
    """List bpy's own maps; none where bpy is not installed."""
    folder = _bpy_folder()
    names = [name for name in BPY_MAPS if folder is not None and (folder / f"{name}.exr").is_file()]
    return _infos("builtin", BPY_MAPS, names, "hdri-")


def bpy_environment_path(name: str, cache: Path) -> Path:
    """Return a cleaned copy of bpy's map `hdri-<name>`."""
    folder = _bpy_folder()
    if folder is None:
        raise AssetError(f"environment 'builtin/{name}' comes with bpy, which is not installed")
    source = folder / f"{name.removeprefix('hdri-')}.exr"
    return clean_copy(source, cache / "environments" / "builtin" / f"{name}.exr")


def decode_pmndrs(script: str) -> bytes:
    """Take the EXR file out of a module of `@pmndrs/assets` (a base64 data URL); nothing in it is run."""
    match = re.search(r"data:application/exr;base64,([A-Za-z0-9+/]+=*)", script)
    if match is None:
        raise AssetError("the module holds no base64 EXR data")
    return base64.b64decode(match[1])


class PmndrsPack(Pack):
    """The fetched maps of `@pmndrs/assets`; `folder` holds one cleaned EXR file a map."""

    def __init__(self, name: str, folder: Path) -> None:
        self.name, self._folder = name, folder

    def infos(self) -> list[AssetInfo]:
        """List the maps that are there."""
        return _infos(self.name, PMNDRS_MAPS, [n for n in PMNDRS_MAPS if self._file(n).is_file()], "")

    def _file(self, name: str) -> Path:
        return self._folder / f"{name}.exr"

    def environment(self, name: str) -> Path:
        """Return a map's file."""
        if not self._file(name).is_file():
            raise AssetError(f"{self._file(name)} is missing; run `multilight assets fetch {self.name}`")
        return self._file(name)
