"""OpenEXR files that others made, measured before they are decoded."""

from pathlib import Path
from typing import Any

import OpenEXR
from numpy.typing import NDArray

from multilight.scenes.files.limits import LimitError, check_file, check_pixels

MOST_CHANNELS = 64
"""Channels of a file, over all its parts."""


def read_exr(path: Path) -> dict[str, NDArray[Any]]:
    """Return a file's channels (H, W) by name; where parts share names, those of the first.

    Raises `OSError` where it cannot be opened, `ValueError` where it is damaged or holds too much.
    """
    check_file(path)
    told: set[str] = set()
    try:
        with OpenEXR.File(str(path), header_only=True) as file:
            for part in file.parts:
                (left, top), (right, bottom) = part.header["dataWindow"]
                check_pixels(int(right) - int(left) + 1, int(bottom) - int(top) + 1)
                if len(file.parts) * len(part.header["channels"]) > MOST_CHANNELS:
                    raise LimitError(f"it has more than {MOST_CHANNELS} channels; write those alone that are needed")
                told |= {channel.name for channel in part.header["channels"]}
        with OpenEXR.File(str(path), separate_channels=True) as file:
            found = {name: channel.pixels for part in reversed(file.parts) for name, channel in part.channels.items()}
    except LimitError:
        raise
    except Exception as error:  # the binding raises bare RuntimeError and others for damaged files
        raise ValueError(f"it is no OpenEXR file that can be decoded ({error})") from None
    if lost := told - set(found):  # of parts that it cannot decode the binding only warns, and leaves them out
        raise ValueError(f"it is truncated or damaged: {', '.join(sorted(lost))} cannot be decoded")
    return found
