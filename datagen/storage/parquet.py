"""How much a Parquet file holds by its own footer, so that nothing is given memory before that is known.

The footer is a struct of Thrift's compact protocol, https://github.com/apache/parquet-format.
"""

import io
from typing import Any

MOST_ROWS = 1_000_000
MOST_VALUES = 1 << 27
"""Values of all columns together; they may be packed so that a file of a kilobyte holds a billion."""
MOST_BYTES = 1 << 30
"""Bytes of all columns together, unpacked."""
DEPTH = 16


def check_parquet(content: bytes) -> None:
    """Raise `ValueError` where a Parquet file is cut short, or holds more rows, values or bytes than are read."""
    if len(content) < 12 or content[:4] != b"PAR1" or content[-4:] != b"PAR1":
        raise ValueError("it is no Parquet file, or cut short")
    start = len(content) - 8 - int.from_bytes(content[-8:-4], "little")
    try:
        footer = _struct(io.BytesIO(content[start:-8]))
        columns = [chunk[3] for group in footer[4] for chunk in group[1]]
        rows, values, size = footer[3], sum(column[5] for column in columns), sum(column[6] for column in columns)
        enough = 0 <= rows <= MOST_ROWS and 0 <= values <= MOST_VALUES and 0 <= size <= MOST_BYTES
    except (IndexError, KeyError, TypeError, OverflowError):
        raise ValueError("its footer is damaged") from None
    if not enough:
        raise ValueError(f"it states {rows} rows, {values} values and {size} bytes, which is more than is read")


def _struct(stream: io.BytesIO, depth: int = 0) -> dict[int, Any]:
    """Read a struct by the numbers of its fields."""
    if depth > DEPTH:
        raise IndexError
    found: dict[int, Any] = {}
    field = 0
    while head := stream.read(1)[0]:
        field = field + (head >> 4) if head >> 4 else _signed(stream)
        found[field] = head & 15 == 1 if head & 15 in (1, 2) else _value(stream, head & 15, depth)
    return found


def _value(stream: io.BytesIO, kind: int, depth: int) -> Any:
    match kind:
        case 1 | 2 | 3:  # truth values in lists, and bytes
            return stream.read(1)[0]
        case 4 | 5 | 6:
            return _signed(stream)
        case 7 | 8:
            return stream.read(8 if kind == 7 else _number(stream))
        case 9 | 10:
            head = stream.read(1)[0]
            count = head >> 4 if head >> 4 < 15 else _number(stream)
            if count > len(stream.getbuffer()):
                raise IndexError
            return [_value(stream, head & 15, depth + 1) for _ in range(count)]
        case 12:
            return _struct(stream, depth + 1)
    raise IndexError  # maps are not used in footers


def _number(stream: io.BytesIO) -> int:
    total = 0
    for shift in range(0, 70, 7):
        part = stream.read(1)[0]
        total |= (part & 127) << shift
        if part < 128:
            return total
    raise IndexError


def _signed(stream: io.BytesIO) -> int:
    number = _number(stream)
    return (number >> 1) ^ -(number & 1)
