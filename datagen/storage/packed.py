"""The packed view: what training reads of a view, as half floats that are mapped, not decoded.

All pictures are cut into tiles of 16x16 pixels. Those of variant `all` stand in full; of the other variants only tiles
that are neither those of `all` nor empty are kept, each once; the rest are numbers in a table. Values are the stored
ones, bit for bit.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from multilight.datagen.errors import StoreError
from multilight.datagen.storage.halves import HALF_MAX
from multilight.datagen.storage.object_variants import ALL, Variant, variants_of
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.store import ViewData
from multilight.lights.relight import gain_matrix
from multilight.scenes.arrays import Float32, Float64

TILE = 16
FORMAT = "multilight packed view 2"
SAME = -1
"""In a table: the tile is that of `all` in the same layer and place."""

ARRAYS: dict[str, tuple[tuple[str, ...], tuple[str | int | None, ...]]] = {
    "all": (("float16", "float32"), ("lights", "tiles", 3, TILE, TILE)),
    "tiles": (("float16", "float32"), (None, 3, TILE, TILE)),
    "without": (("int32",), ("objects", "lights", "tiles")),
    "foreground": (("int32",), ("objects", "lights", "tiles")),
    "alpha": (("float16",), (None, TILE, TILE)),
    "coverage": (("int32",), ("objects", "tiles")),
    "z_depth": (("float32",), (None, None)),
    "K": (("float64",), (3, 3)),
    "c2w": (("float64",), (4, 4)),
    "conditions": (("float32",), (None, "lights", 3)),
}
"""The arrays of a file, their types and shapes: lengths, what they are the number of, or None for any."""
KIND_OF = {"F16": np.float16, "F32": np.float32, "F64": np.float64, "I32": np.int32}
"""NumPy's names of the types, by the format's own."""


@dataclass(frozen=True)
class PackedView:
    """One view with L lights, O insertable objects and C stored lighting conditions.

    all (L, T, 3, 16, 16) float16 (float32 where radiance exceeds half), the T tiles numbered row by row, the last of a
    row or column filled up with zeros; tiles (N, 3, 16, 16), the first of them zero; without, foreground
    (O, L, T) int32 are numbers of tiles or `SAME`; alpha (M, 16, 16) float16 are tiles of coverage, the first of them
    zero; coverage (O, T) int32 their numbers; z_depth (H, W) float32 metres, 0 where nothing; K (3, 3) float64 in
    pixels; c2w (4, 4) float64, OpenGL axes; conditions (C, L, 3) float32 linear gains, metered exposure included.
    """

    lights: tuple[str, ...]
    objects: tuple[str, ...]
    all: NDArray[np.floating] = field(repr=False)
    tiles: NDArray[np.floating] = field(repr=False)
    without: NDArray[np.int32] = field(repr=False)
    foreground: NDArray[np.int32] = field(repr=False)
    alpha: NDArray[np.float16] = field(repr=False)
    coverage: NDArray[np.int32] = field(repr=False)
    z_depth: Float32 = field(repr=False)
    K: Float64 = field(repr=False)
    c2w: Float64 = field(repr=False)
    conditions: Float32 = field(repr=False)

    def variant(self, name: str) -> NDArray[np.floating]:
        """Put one variant together again: (L, H, W, 3) as stored; raises `KeyError` where there is none."""
        if name == ALL:
            return _joined(self.all, self.z_depth.shape).transpose(0, 2, 3, 1)
        if name not in variants_of(self.objects):
            raise KeyError(name)
        chosen = Variant(name)
        table = self.without if chosen.action == "without" else self.foreground
        numbers = table[self.objects.index(chosen.object)]
        whole = self.all.copy()
        kept = numbers != SAME
        whole[kept] = self.tiles[numbers[kept]]
        return _joined(whole, self.z_depth.shape).transpose(0, 2, 3, 1)

    def object_coverage(self, name: str) -> NDArray[np.float16]:
        """Put one object's coverage together again: (H, W) float16 in [0, 1]."""
        numbers = self.coverage[self.objects.index(name)]
        return _joined(self.alpha[numbers][None, :, None], self.z_depth.shape)[0, 0]


def pack_view(view: ViewData, record: SceneRecord, number: int) -> PackedView:
    """Pack view `number` of a scene."""
    objects, camera = tuple(sorted(view.coverage)), record.views[number]
    peak = max(float(layers.max(initial=0.0)) for layers in view.variants.values())
    kind = np.float16 if peak <= HALF_MAX else np.float32
    whole = _split(view.variants[ALL].astype(kind))
    pool, alpha = _Pool((3, TILE, TILE), kind), _Pool((1, TILE, TILE), np.float16)
    tables: dict[str, NDArray[np.int32]] = {}
    for action, of in (("without", Variant.without), ("foreground", Variant.foreground)):
        variants = (_split(view.variants[of(name)].astype(kind)) for name in objects)
        tables[action] = np.stack([pool.numbers(tiles, whole) for tiles in variants])
    cover = (_split(view.coverage[name][None, ..., None].astype(np.float16)) for name in objects)
    coverage = np.stack([alpha.numbers(tiles)[0] for tiles in cover])
    return PackedView(
        lights=view.lights,
        objects=objects,
        all=whole,
        tiles=pool.tiles(),
        **tables,
        alpha=alpha.tiles()[:, 0],
        coverage=coverage,
        z_depth=view.geometry.z_depth,
        K=np.array(camera.K, np.float64),
        c2w=np.array(camera.c2w, np.float64),
        conditions=np.stack([gain_matrix(view.lights, condition) for condition in record.conditions]),
    )


def write_packed(path: Path, view: PackedView) -> None:
    """Write a packed view as one safetensors file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    # One entry, since safetensors writes several in any order.
    named = {"format": FORMAT, "lights": view.lights, "objects": view.objects}
    arrays = {name: np.ascontiguousarray(getattr(view, name)) for name in ARRAYS}
    path.write_bytes(save(arrays, metadata={"multilight": json.dumps(named)}))


def read_packed(path: Path) -> PackedView:
    """Read a packed view; raises `StoreError` naming the file where it is missing, truncated, foreign or damaged."""
    try:
        with safe_open(path, "numpy") as stored:  # checks the header against the file
            named = json.loads((stored.metadata() or {}).get("multilight", "{}"))
        arrays = _mapped(path)
        if named.get("format") != FORMAT:
            raise StoreError(f"{path} is not a {FORMAT!r}: its format is {named.get('format')!r}")
        view = PackedView(tuple(named["lights"]), tuple(named["objects"]), **arrays)
    except FileNotFoundError:
        raise StoreError(f"{path} is missing") from None
    except (SafetensorError, OSError) as error:
        raise StoreError(f"{path} cannot be read (truncated or damaged): {error}") from None
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise StoreError(f"{path} is damaged: {error}") from None
    if fault := _fault(view) or value_fault(view):
        raise StoreError(f"{path} is damaged: {fault}")
    return view


def value_fault(view: PackedView) -> str:
    """Name what holds values that no view has, or nothing: NaN, infinite or negative radiance, depth or coverage."""
    for name in ("all", "tiles", "alpha", "z_depth", "conditions"):
        if not _sound(getattr(view, name)):
            return f"{name} holds NaN, infinite or negative values"
    if view.alpha.max(initial=0) > 1:
        return "alpha holds values above 1"
    return "" if np.isfinite(view.K).all() and np.isfinite(view.c2w).all() else "its camera is not finite"


def _sound(values: NDArray[np.floating]) -> bool:
    """Say whether all are finite and not negative; by their bits, in a fiftieth of the time."""
    bits, infinite = (np.uint16, 0x7C00) if values.itemsize == 2 else (np.uint32, 0x7F800000)
    if values.view(bits).max(initial=0) < infinite:  # the sign is the highest bit, and of -0 too
        return True
    return bool(np.isfinite(values).all() and values.min(initial=0) >= 0)


def _mapped(path: Path) -> dict[str, NDArray[Any]]:
    """Map the arrays of a sound safetensors file: of a page, nothing is read or copied until it is looked at."""
    content = np.memmap(path, np.uint8, "c")  # writable, since torch wants that; nothing reaches the file
    length = int(content[:8].view("<u8")[0])
    header = json.loads(content[8 : 8 + length].tobytes())
    data = content[8 + length :].view(np.ndarray)
    return {
        name: data[slice(*about["data_offsets"])].view(KIND_OF[about["dtype"]]).reshape(about["shape"])
        for name, about in header.items()
        if name != "__metadata__"
    }


class _Pool:
    """Tiles of one shape, each kept once; the first is zero."""

    def __init__(self, shape: tuple[int, ...], kind: type[np.floating]) -> None:
        self._tiles = [np.zeros(shape, kind)]
        self._known = {self._tiles[0].tobytes(): 0}

    def numbers(self, layers: NDArray[np.floating], known: NDArray[np.floating] | None = None) -> NDArray[np.int32]:
        """Return numbers (L, T) of tiles (L, T, C, 16, 16), adding those that are new; `SAME` where `known` has it."""
        result = np.full(layers.shape[:2], SAME, np.int32)
        differs = np.ones(result.shape, bool)
        if known is not None:  # bits, not values: 0 and -0 are equal
            bits = np.uint16 if layers.itemsize == 2 else np.uint32
            differs = (layers.view(bits) != known.view(bits)).any(axis=(2, 3, 4))
        for place in zip(*np.nonzero(differs), strict=True):
            number = self._known.setdefault(layers[place].tobytes(), len(self._tiles))
            if number == len(self._tiles):
                self._tiles.append(layers[place])
            result[place] = number
        return result

    def tiles(self) -> NDArray[np.floating]:
        """Return all tiles, (N, C, 16, 16)."""
        return np.stack(self._tiles)


def _split(layers: NDArray[np.floating]) -> NDArray[np.floating]:
    """Cut (L, H, W, C), filled up with zeros to whole tiles, into (L, T, C, 16, 16)."""
    count, height, width, channels = layers.shape
    rows, columns = -(-height // TILE), -(-width // TILE)
    full = np.zeros((count, channels, rows * TILE, columns * TILE), layers.dtype)
    full[..., :height, :width] = layers.transpose(0, 3, 1, 2)
    cut = full.reshape(count, channels, rows, TILE, columns, TILE).transpose(0, 2, 4, 1, 3, 5)
    return np.array(cut, order="C").reshape(count, rows * columns, channels, TILE, TILE)


def _joined(tiles: NDArray[np.floating], shape: tuple[int, ...]) -> NDArray[np.floating]:
    """Undo `_split`: (L, T, C, 16, 16) to (L, C, H, W)."""
    height, width = shape
    rows, columns, channels = -(-height // TILE), -(-width // TILE), tiles.shape[2]
    grid = tiles.reshape(-1, rows, columns, channels, TILE, TILE).transpose(0, 3, 1, 4, 2, 5)
    return grid.reshape(-1, channels, rows * TILE, columns * TILE)[..., :height, :width]


def _fault(view: PackedView) -> str:
    """Name what contradicts itself, or nothing."""
    if view.z_depth.ndim != 2:  # which tells how many tiles there are
        return f"z_depth has shape {view.z_depth.shape}"
    rows, columns = (-(-length // TILE) for length in view.z_depth.shape)
    numbers = {"lights": len(view.lights), "objects": len(view.objects), "tiles": rows * columns}
    for name, (kinds, lengths) in ARRAYS.items():
        shape, kind = getattr(view, name).shape, str(getattr(view, name).dtype)
        wanted = [numbers[length] if isinstance(length, str) else length for length in lengths]
        if len(shape) != len(wanted) or any(w not in (None, s) for s, w in zip(shape, wanted, strict=True)):
            return f"{name} has shape {shape}"
        if kind not in kinds:
            return f"{name} is of type {kind}"
    for table, pool in (("without", view.tiles), ("foreground", view.tiles), ("coverage", view.alpha)):
        used = getattr(view, table)
        if used.size and not (used.min() >= SAME and used.max() < len(pool)):
            return f"{table} names tiles that are not there"
    return ""
