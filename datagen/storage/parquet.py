"""How much a Parquet file holds by its own footer, so that nothing is given memory before that is known.

The footer is a struct of Thrift's compact protocol, https://github.com/apache/parquet-format.
"""

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
        footer = _Reader(content, start).struct()
        columns = [chunk[3] for group in footer[4] for chunk in group[1]]
        rows, values, size = footer[3], sum(column[5] for column in columns), sum(column[6] for column in columns)
        enough = 0 <= rows <= MOST_ROWS and 0 <= values <= MOST_VALUES and 0 <= size <= MOST_BYTES
    except (IndexError, KeyError, TypeError, RecursionError):
        raise ValueError("its footer is damaged") from None
    if not enough:
        raise ValueError(f"it states {rows} rows, {values} values and {size} bytes, which is more than is read")


class _Reader:
    """Reads Thrift's compact protocol from `content` at `place`; structs come as dicts by the numbers of fields."""

    def __init__(self, content: bytes, place: int) -> None:
        if not 4 <= place < len(content):
            raise ValueError("its footer is damaged")
        self._content, self._place = content, place

    def struct(self, depth: int = 0) -> dict[int, Any]:
        if depth > DEPTH:
            raise IndexError
        found: dict[int, Any] = {}
        field = 0
        while head := self._byte():
            field = field + (head >> 4) if head >> 4 else self._signed()
            found[field] = head & 15 == 1 if head & 15 in (1, 2) else self._value(head & 15, depth)
        return found

    def _value(self, kind: int, depth: int) -> Any:
        match kind:
            case 1 | 2 | 3:  # truth values in lists, and bytes
                return self._byte()
            case 4 | 5 | 6:
                return self._signed()
            case 7:
                return self._skipped(8)
            case 8:
                return self._skipped(self._number())
            case 9 | 10:
                head = self._byte()
                count = head >> 4 if head >> 4 < 15 else self._number()
                if count > len(self._content):
                    raise IndexError
                return [self._value(head & 15, depth + 1) for _ in range(count)]
            case 12:
                return self.struct(depth + 1)
        raise IndexError  # maps are not used in footers

    def _byte(self) -> int:
        self._place += 1
        return self._content[self._place - 1]

    def _number(self) -> int:
        total = 0
        for shift in range(0, 70, 7):
            part = self._byte()
            total |= (part & 127) << shift
            if part < 128:
                return total
        raise IndexError

    def _signed(self) -> int:
        number = self._number()
        return (number >> 1) ^ -(number & 1)

    def _skipped(self, length: int) -> None:
        self._place += length
