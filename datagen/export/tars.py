"""Uncompressed tars whose bytes depend on their content alone, split into shards of bounded size."""

import io
import tarfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

BLOCK, RECORD = 512, 10240  # bytes; a tar pads each file to blocks, and its end to records


@dataclass
class TarShards:
    """Writes groups of files into `<folder>/<prefix>-00000.tar`, `-00001.tar`, ...; a group stays in one shard.

    A shard takes at most `most_bytes` (one group, where a single group is larger) and at most `most_groups`. `shards`
    lists name and group count of each. Names, order and content decide the bytes: no time, no owner.
    """

    folder: Path
    prefix: str
    most_bytes: int
    most_groups: int | None = None
    digits: int = 5
    shards: list[tuple[str, int]] = field(default_factory=list)
    _tar: tarfile.TarFile | None = None
    _bytes: int = 0

    def add(self, files: Mapping[str, bytes]) -> None:
        """Add a group of files, in the order of the mapping."""
        size = sum(BLOCK + _padded(len(content), BLOCK) for content in files.values())
        if self._tar is None or self._full(size):
            self._open_next()
        assert self._tar is not None
        for name, content in files.items():
            entry = tarfile.TarInfo(name)  # mode 0644, time 0, owner 0
            entry.size = len(content)
            self._tar.addfile(entry, io.BytesIO(content))
        self._bytes += size
        name, groups = self.shards[-1]
        self.shards[-1] = (name, groups + 1)

    def close(self) -> None:
        """Finish the shard that is open."""
        if self._tar is not None:
            self._tar.close()
            self._tar = None

    def _full(self, size: int) -> bool:
        after = _padded(self._bytes + size + 2 * BLOCK, RECORD)
        return after > self.most_bytes or self.shards[-1][1] == self.most_groups

    def _open_next(self) -> None:
        self.close()
        name = f"{self.prefix}-{len(self.shards):0{self.digits}d}.tar"
        self.shards.append((name, 0))
        self._tar = tarfile.open(self.folder / name, "w", format=tarfile.USTAR_FORMAT)  # noqa: SIM115  (closed by close)
        self._bytes = 0


def _padded(size: int, unit: int) -> int:
    return -(-size // unit) * unit
