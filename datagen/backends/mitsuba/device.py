"""NumPy arrays as Dr.Jit arrays, so that the code compiled for one scene serves the next."""

from typing import Any, TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

Array = TypeVar("Array", mi.Float, mi.UInt32)
ALIGNMENT = 64
CLAMPED = {"filter_mode": dr.FilterMode.Linear, "wrap_mode": dr.WrapMode.Clamp}
"""How most textures are looked up."""


def on_device(kind: type[Array], array: NDArray[np.generic]) -> Array:
    """Put an array on the device, flat.

    Dr.Jit uses NumPy's memory where it is, and compiles other code for memory that is not aligned.
    """
    flat = np.ascontiguousarray(array).ravel()
    copied = aligned(flat.size, flat.dtype)
    copied[:] = flat
    return kind(copied)


def aligned(size: int, kind: np.dtype[Any]) -> NDArray[Any]:
    """Allocate memory that Dr.Jit can use where it is."""
    buffer = np.empty(size * kind.itemsize + ALIGNMENT, np.uint8)
    start = -buffer.ctypes.data % ALIGNMENT
    return buffer[start : start + size * kind.itemsize].view(kind)


def opaque(value: float) -> mi.Float:
    """Put a number on the device as data: a literal would become part of the compiled code."""
    return dr.opaque(mi.Float, float(value))


class Table:
    """Rows of named columns on the device: `columns` maps a name to its first number's place in a row, and their count.

    All numbers are of one kind. They are read four at once, so no column may lie across a multiple of four.
    """

    def __init__(self, kind: type[Array], rows: NDArray[np.void]) -> None:
        assert rows.dtype.fields is not None
        self.columns = {name: (field[1] // 4, field[0].itemsize // 4) for name, field in rows.dtype.fields.items()}
        self._kind, self._four = kind, mi.Vector4f if kind is mi.Float else mi.Vector4u
        self._width = rows.dtype.itemsize // 4
        self._array = on_device(kind, rows.view(np.float32 if kind is mi.Float else np.uint32))

    def number(self, column: str, row: mi.UInt32, active: mi.Bool) -> mi.Float | mi.UInt32:
        """Read one number of a row."""
        return dr.gather(self._kind, self._array, row * self._width + self.columns[column][0], active)

    def four(self, group: int, row: mi.UInt32, active: mi.Bool) -> mi.Vector4f | mi.Vector4u:
        """Read a group of four numbers of a row."""
        return dr.gather(self._four, self._array, row * (self._width // 4) + group, active)


class Row:
    """One row a lane of tables that belong together, read as far as asked for: a number, or a list where it is several.

    row["opacity"], row["base_color"]
    """

    def __init__(self, tables: tuple[Table, ...], row: mi.UInt32, active: mi.Bool) -> None:
        self._tables, self._row, self._active = tables, row, active
        self._read: dict[tuple[Table, int], mi.Vector4f | mi.Vector4u] = {}

    def __getitem__(self, column: str) -> Any:
        table = next(table for table in self._tables if column in table.columns)
        place, count = table.columns[column]
        group, first = divmod(place, 4)
        if (table, group) not in self._read:
            self._read[table, group] = table.four(group, self._row, self._active)
        numbers = [self._read[table, group][first + i] for i in range(count)]
        return numbers[0] if count == 1 else numbers
