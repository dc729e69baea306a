"""Errors that a user can act on: the command line prints them as one line, without a traceback."""

import contextlib
import errno
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from multilight.scenes.errors import MultilightError

FULL = 1 << 20  # bytes; native code reports a full disk in its own ways, so free space is looked at as well
_STATED = tuple(os.strerror(code) for code in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG))


class UserError(MultilightError):
    """Something the user can mend; the message names the value or file, the allowed range and the remedy."""


class StoreError(UserError):
    """A file of a dataset is missing, truncated, damaged or of another version."""


class RunStoppedError(UserError):
    """Something that would fail every further scene: the run ends at once."""


class DiskFullError(RunStoppedError):
    """The output has no space left; what is finished is kept."""


def reason_of(error: Exception) -> str:
    """Say in a few words why a file or folder could not be used, without its name."""
    if isinstance(error, FileExistsError):
        return "it is a file, not a folder"
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


@contextlib.contextmanager
def full_disk_told(folder: Path) -> Iterator[None]:
    """Turn whatever a full disk under `folder`, a quota or a limit of size makes fail into `DiskFullError`."""
    try:
        yield
    except UserError:
        raise
    except Exception as error:
        stated = next((words for words in _STATED if words in str(error)), "")
        if stated or shutil.disk_usage(folder).free < FULL:
            what = (stated or _STATED[0]).lower()
            raise DiskFullError(
                f"{folder}: {what}; free some and run the same command again, what is finished is kept"
            ) from error
        raise
