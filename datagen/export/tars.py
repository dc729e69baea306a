"""Uncompressed tars whose bytes depend on their content alone, split into shards of bounded size."""

import io
import tarfile
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

BLOCK, RECORD = 512, 10240  # bytes; a tar pads each file to blocks, and its end to records


@dataclass
class TarShards(ExitStack):
    """Writes groups of files into `<folder>/<split>-00000.tar`, `-00001.tar`, ...; a group stays in one shard.

    A shard takes at most `most_bytes` (one group, where a single group is larger) and at most `most_groups`. `shards`
    lists name and group count of each, by split. Names, order and content decide the bytes: no time, no owner. To be
    used as a context manager, which finishes the shards that are open.
    """

    folder: Path
    most_bytes: int
    most_groups: int | None = None
    digits: int = 5
    shards: dict[str, list[tuple[str, int]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__init__()
        self._open: dict[str, tuple[tarfile.TarFile, int]] = {}

    def add(self, split: str, files: Mapping[str, bytes]) -> None:
        """Add a group of files, in the order of the mapping."""
        size = sum(BLOCK + _padded(len(content), BLOCK) for content in files.values())
        shards = self.shards.setdefault(split, [])
        tar, written = self._open.get(split, (None, 0))
        full = _padded(written + size + 2 * BLOCK, RECORD) > self.most_bytes
        if tar is None or full or shards[-1][1] == self.most_groups:
            if tar is not None:
                tar.close()
            shards.append((f"{split}-{len(shards):0{self.digits}d}.tar", 0))
            tar, written = tarfile.open(self.folder / shards[-1][0], "w", format=tarfile.USTAR_FORMAT), 0  # noqa: SIM115
            self.callback(tar.close)
        for name, content in files.items():
            entry = tarfile.TarInfo(name)  # mode 0644, time 0, owner 0
            entry.size = len(content)
            tar.addfile(entry, io.BytesIO(content))
        self._open[split] = tar, written + size
        shards[-1] = (shards[-1][0], shards[-1][1] + 1)


def _padded(size: int, unit: int) -> int:
    return -(-size // unit) * unit
