"""OBJ files and their MTL files, brought to the words that importers know.

Exporters write key words in any case, several libraries in a line, byte-order marks, `Tr` for 1 - `d`, and an `illum`
that means nothing.
"""

import re
from pathlib import Path
from typing import BinaryIO

from PIL import UnidentifiedImageError

from multilight.scenes.assets.formats.imported import Note
from multilight.scenes.assets.info import AssetError
from multilight.scenes.files.confined import inside
from multilight.scenes.files.limits import MOST_JSON, open_picture, read_bytes

_KNOWN = (
    "Kd Ks Ke Ns Ni d Tf illum Pr Pm Ps Pc Pcr aniso anisor map_Kd map_Ks map_Ke map_Ns map_d map_Pr map_Pm map_Ps "
    "map_Bump norm"
)
_WORDS = {word.lower(): word for word in _KNOWN.split()} | {"bump": "map_Bump", "map_norm": "norm", "map_tr": "map_d"}
_UNSAID = {"newmtl", "ka", "tr", "map_ka", "sharpness"}
"""Key words that say nothing of a surface, or are another's."""
_REFRACTS = ("6", "7")
"""Models of illumination in which light is refracted."""
_MARK = b"\xef\xbb\xbf"
_OPTIONS = re.compile(r"^(?:-(?:blendu|blendv|boost|cc|clamp|imfchan|texres|type|bm)\s+\S+\s+|-mm\s+\S+\s+\S+\s+|"
                      r"-[ost]\s+[-+.\deE]+\s+(?:[-+.\deE]+\s+){0,2})+")  # fmt: skip
"""What may stand before the name of a picture in an MTL file."""
_DRIVE = re.compile("^[A-Za-z]:/")
"""Names on the machine that a file was made on: looked for near by."""


def check_obj(path: Path, folder: Path, files: set[Path], notes: list[Note]) -> str:
    """Refuse pictures of an OBJ file's materials that cannot be opened, or lie elsewhere; name what is not there.

    Adds to `files` what it refers to in `folder`; returns the key words of its materials.
    """
    words, there, known = set[str](), set[bytes](), False
    for named, library in libraries(path, folder):
        files |= {named, library}
        if library.name != named.name:
            what, instead = "it is not there", f"{library.name} is taken"
            notes.append(Note(place=named.name, feature=what, instead=instead, remedy="name it in the OBJ file"))
        elif not library.exists():
            what = "its materials are plain and matte"
            notes.append(Note(place=named.name, feature="it is missing", instead=what, remedy="put it beside it"))
            continue
        known = True
        text = read_bytes(library, MOST_JSON).removeprefix(_MARK)
        there |= _said("newmtl", text)
        said = {word.decode("ascii", "replace") for word in re.findall(rb"^[ \t]*(\w+)", text, re.MULTILINE)}
        words |= {_WORDS.get(word.lower(), word) for word in said}
        for word in sorted(word for word in said if word.lower() not in _WORDS.keys() | _UNSAID):
            notes.append(Note(place=library.name, feature=word, instead="it is left out", remedy="none"))
        for word, _, name in _pictures(text):
            if word.lower() in _WORDS and not _DRIVE.match(name):
                picture = inside(folder, name, beside=path.parent)
                files.add(picture)
                if picture.exists():
                    check_picture(path, picture, picture.name)
    for missing in sorted(_said("usemtl", read_bytes(path)) - there) if known else ():
        name = missing.decode("utf-8", "replace")
        note = Note(place=f"material {name!r}", feature="no MTL file has it", instead="it is plain", remedy="add it")
        notes.append(note)
    return " ".join(sorted(words))


def libraries(path: Path, folder: Path) -> list[tuple[Path, Path]]:
    """Return the MTL files that an OBJ file names, and those that are taken: of other case, or of the OBJ's name."""
    named: list[Path] = []
    own = path.with_suffix(".mtl")
    for line in sorted(_said("mtllib", read_bytes(path).removeprefix(_MARK))):
        name = line.decode("utf-8", "surrogateescape").replace("\\", "/")
        whole = [inside(folder, name, beside=path.parent)] if not _DRIVE.match(name) else [own]
        parts = [inside(folder, part, beside=path.parent) for part in name.split()] if len(name.split()) > 1 else []
        several = not other_case(whole[0]).exists() and any(other_case(part).exists() for part in parts)
        named += parts if several else whole
    if not named and own.exists():
        named = [own]
    return [(n, own if not other_case(n).exists() and own.exists() else other_case(n)) for n in named]


def staged(path: Path, folder: Path, stage: Path) -> Path:
    """Return an OBJ file as importers want it, written into `stage` where it has materials or a byte-order mark."""
    text = read_bytes(path)
    found = [library for _, library in libraries(path, folder) if library.exists()]
    if not found and not text.startswith(_MARK):
        return path
    stage.mkdir()
    head = b""
    for number, library in enumerate(found):
        (stage / f"{number}.mtl").write_text(_plain(library, path.parent), "utf-8", "surrogateescape")
        head += b"mtllib %d.mtl\n" % number
    lines = re.sub(rb"^[ \t]*mtllib[ \t].*$", b"", text.removeprefix(_MARK), flags=re.MULTILINE | re.IGNORECASE)
    (stage / path.name).write_bytes(head + lines)
    return stage / path.name


def _plain(library: Path, beside: Path) -> str:
    """Return an MTL file in key words as they are known, without what is guessed of `illum`, with absolute pictures."""
    text = read_bytes(library, MOST_JSON).removeprefix(_MARK)
    pictures = {(word, options + name): (options, name) for word, options, name in _pictures(text)}
    made = []
    for block in re.split(r"(?m)^(?=[ \t]*newmtl\s)", text.decode("utf-8", "surrogateescape")):
        pairs = [(line.split(None, 1) + [""])[:2] for line in block.splitlines() if line.strip()]
        said = {key.lower(): value.strip() for key, value in pairs}
        glass = said.get("illum") in _REFRACTS
        for key, value in pairs:
            value = value.strip()
            if key.lower() == "newmtl":
                made.append(f"newmtl {value}")
            elif key.lower() == "tr" and "d" not in said:
                made.append(f"d {1 - float(value.split()[-1]):g}")
            elif key.lower() in _WORDS and (glass or key.lower() not in ("illum", "tf")):
                options, name = pictures.get((key, value), ("", value))
                known = (key, value) in pictures and not _DRIVE.match(name)
                made.append(f"{_WORDS[key.lower()]} {options}{beside / name if known else name}")
        if said.get("newmtl") is not None and not said.keys() & {"pm", "map_pm"}:
            made.append("Pm 0")
        if glass and not said.keys() & {"tf", "d", "tr"}:
            made.append("Tf 1 1 1")
    return "\n".join([*made, ""])


def _said(key: str, text: bytes) -> set[bytes]:
    return set(re.findall(rf"^[ \t]*{key}[ \t]+(.*\S)".encode(), text, re.MULTILINE | re.IGNORECASE))


def _pictures(text: bytes) -> list[tuple[str, str, str]]:
    """Return key word, options and name of each picture in an MTL file; those of other systems have backslashes."""
    found = re.findall(rb"^[ \t]*((?:map_|norm|bump|disp|refl)\w*)[ \t]+(.*\S)", text, re.MULTILINE | re.IGNORECASE)
    pictures = []
    for word, line in found:
        value = line.decode("utf-8", "surrogateescape")
        options = match[0] if (match := _OPTIONS.match(value)) else ""
        pictures.append((word.decode("ascii"), options, value[len(options) :].replace("\\", "/")))
    return sorted(set(pictures))


def other_case(file: Path) -> Path:
    """Return a file as it is, or the one beside it whose name differs in case alone."""
    if file.exists() or not file.parent.is_dir():
        return file
    same = (other for other in sorted(file.parent.iterdir()) if other.name.casefold() == file.name.casefold())
    return next(same, file)


def check_picture(path: Path, picture: Path | BinaryIO, name: str) -> None:
    """Raise `AssetError` where a picture of the model at `path` cannot be opened."""
    try:
        open_picture(picture).close()
    except (OSError, ValueError) as error:
        reason = "it is no picture, or cut short" if isinstance(error, UnidentifiedImageError) else error
        raise AssetError(f"{path}: its texture {name!r} cannot be read ({reason}); save it as PNG") from error
