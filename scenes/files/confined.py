"""Names that come from data: every one that becomes a path goes through here, and stays inside its folder."""

from pathlib import Path
from urllib.parse import unquote

from multilight.scenes.errors import MultilightError

LONGEST = 1000
"""Characters of the longest name that is taken."""


class OutsideError(MultilightError, ValueError):
    """A name from data leads out of its folder, or is no plain name; the message names it and the reason."""


def plain_name(name: str) -> str:
    """Return a relative name such as `views/03.exr` as it is.

    Raises `OutsideError` where it could mean another place anywhere: absolute, with `..`, backslashes, a drive or
    address in front, control characters, or empty parts; the same behind percent-encodings, however often.
    """
    if not isinstance(name, str) or len(name) > LONGEST:
        raise OutsideError(f"{str(name)[:60]!r}… is no name of a file")
    shown = name
    while True:
        if reason := _reason(shown):
            raise OutsideError(f"the name {name!r} {reason}")
        decoded = unquote(shown)
        if decoded == shown:
            return name
        shown = decoded


def inside(folder: Path, name: str, *, beside: Path | None = None) -> Path:
    """Join a name that comes from data to a folder; links count as what they lead to.

    With `beside`, the name is relative to that folder, and `.` and `..` may lead from there to anywhere in `folder`.
    Raises `OutsideError` naming the name, and the folder where it leads out of that.
    """
    if beside is None:
        return held(folder, folder / plain_name(name))
    plain_name("/".join(part for part in str(name).split("/") if part not in (".", "..")))
    return held(folder, beside / name)


def held(folder: Path, path: Path) -> Path:
    """Return a path as it is; raises `OutsideError` where it, or a link on its way, leads out of `folder`."""
    try:
        within = path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError):  # a link that leads to itself
        within = False
    if not within:
        raise OutsideError(f"{str(path)!r} leads out of the folder {folder}")
    return path


def _reason(name: str) -> str:
    """Say why a name is not plain; nothing where it is."""
    if any(ord(character) < 32 or ord(character) == 127 for character in name):
        return "holds control characters"
    if "\\" in name:
        return "holds a backslash"
    if name.startswith("/"):
        return "is absolute"
    if ":" in name:
        return "names a drive or an address"
    parts = name.split("/")
    if ".." in parts or "" in parts or "." in parts:
        return "has '..', '.' or empty parts"
    return ""
