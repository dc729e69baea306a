"""Bytes, writing and reading time of one stored view under each of OpenEXR's compressions, on one thread.

python benchmarks/compression.py out/dataset/scenes/000001/views/07.exr
"""

import io
import time
from pathlib import Path

import numpy as np
import OpenEXR
import tyro

METHODS = ("NO", "ZIPS", "ZIP", "PIZ", "ZSTD", "HTJ2K32", "DWAA")


def main(view: tyro.conf.Positional[Path]) -> None:
    """Print a row a compression; the lossy DWAA leaves out the geometry, which it would spoil."""
    source = OpenEXR.File(str(view), separate_channels=True)
    parts = [(part.name(), {name: c.pixels for name, c in part.channels.items()}) for part in source.parts]
    for method in METHODS:
        header = {"compression": getattr(OpenEXR, f"{method}_COMPRESSION"), "type": OpenEXR.scanlineimage}
        kept = [OpenEXR.Part(dict(header), c, name) for name, c in parts if method != "DWAA" or name != "geometry"]
        stream, start = io.BytesIO(), time.perf_counter()
        OpenEXR.File(kept, num_threads=1).write(stream)
        written, read = time.perf_counter() - start, []
        for _ in range(5):
            stream.seek(0)
            start = time.perf_counter()
            OpenEXR.File(stream, separate_channels=True, num_threads=1)
            read.append(time.perf_counter() - start)
        size = len(stream.getvalue()) / 1e6
        print(f"{method:8}{size:7.2f} MB, write {written * 1e3:4.0f} ms, read {np.median(read) * 1e3:4.0f} ms")


if __name__ == "__main__":
    tyro.cli(main)
