"""Scenes that could not be made, set aside so that no run tries them for ever: `set_aside/000017.log`.

The first line says why, what follows is the log of the last try. The file goes when the scene is made.
"""

from pathlib import Path

from multilight.datagen.production.worker import log_path
from multilight.scenes.files.atomic import write_whole

FOLDER = "set_aside"


def aside_name(index: int) -> str:
    """Return the name, from the dataset's root, of the file that says that a scene is set aside."""
    return f"{FOLDER}/{index:06d}.log"


def aside_path(root: Path, index: int) -> Path:
    """Return where it is said that a scene is set aside."""
    return root / aside_name(index)


def set_aside(root: Path, index: int, reason: str) -> None:
    """Let later runs know that a scene could not be made, and why."""
    log, path = log_path(root, index), aside_path(root, index)
    path.parent.mkdir(exist_ok=True)
    with write_whole(path) as work:
        said = log.read_text(encoding="utf-8", errors="replace") if log.exists() else ""
        work.write_text(" ".join(reason.split()) + "\n" + said, encoding="utf-8")
    log.unlink(missing_ok=True)


def why_aside(root: Path, index: int) -> str | None:
    """Return why a scene was set aside; None where it was not."""
    try:
        return aside_path(root, index).read_text(encoding="utf-8", errors="replace").partition("\n")[0]
    except OSError:
        return None


def take_up(root: Path, index: int) -> None:
    """Forget that a scene was set aside."""
    aside_path(root, index).unlink(missing_ok=True)
