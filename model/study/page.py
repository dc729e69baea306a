"""The page of a blind comparison: pairs of pictures, in an order and on sides that tell nothing of who made them.

Which picture is whose stands in a key beside the page, not in it, so that it can be given to anybody.
"""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from multilight.datagen.errors import UserError
from multilight.datagen.files.outputs import check_file, written
from multilight.datagen.pages.render import data_uri, render_page
from multilight.datagen.storage.store import write_text
from multilight.scenes.files.limits import open_picture, read_bytes
from multilight.scenes.frozen import Frozen

KINDS = {".png": "png", ".jpg": "jpeg", ".jpeg": "jpeg", ".webp": "webp"}
MOST_BYTES = 1 << 27
"""Bytes of all pictures of a page: beyond, browsers fail to open it."""


class Key(Frozen):
    """Whose pictures a page shows: `pairs` are their names, `swapped` tells where the second method's comes first."""

    study: str
    methods: tuple[str, str]
    pairs: tuple[str, ...]
    swapped: tuple[bool, ...]


@dataclass(frozen=True)
class StudyRequest:
    """What to compare: two folders with pictures of equal names, and perhaps a third that is shown above them."""

    first: Path
    second: Path
    context: Path | None
    question: str
    most: int
    seed: int


def write_study(request: StudyRequest, out: Path) -> Key:
    """Write the page and, beside it, its key (`.key.json`); raises `UserError` naming what is missing or too large."""
    folders = [folder for folder in (request.first, request.second, request.context) if folder is not None]
    for folder in folders:
        if not folder.is_dir():
            raise UserError(f"{folder} is no folder; name one with a picture (png, jpg, webp) for each pair")
    if request.first.resolve() == request.second.resolve():
        raise UserError(f"{request.first} is named twice; name the folders of two methods")
    if out.suffix != ".html":
        raise UserError(f"--out {out}: the suffix must be .html")
    check_file(out)
    named = [{p.name for p in folder.iterdir() if p.suffix.lower() in KINDS} for folder in folders]
    common = sorted(set.intersection(*named))
    if not common:
        raise UserError(f"no picture has the same name in {' and '.join(map(str, folders))}")
    rng = np.random.default_rng(request.seed)
    names = [common[place] for place in rng.permutation(len(common))[: request.most]]
    swapped = tuple(bool(value) for value in rng.random(len(names)) < 0.5)
    pairs, digest, size = [], hashlib.sha256(), 0
    for name, swap in zip(names, swapped, strict=True):
        contents = [_picture(folder / name) for folder in folders]
        if len({shape for _, shape in contents}) > 1:
            raise UserError(f"{name}: sizes are {', '.join(f'{w} x {h}' for _, (w, h) in contents)}; make them equal")
        size += sum(len(content) for content, _ in contents)
        if size > MOST_BYTES:
            raise UserError(f"the pictures take more than {MOST_BYTES >> 20} MiB: smaller ones, or a lower --most")
        for content, _ in contents:
            digest.update(hashlib.sha256(content).digest())
        shown = [data_uri(content, KINDS[Path(name).suffix.lower()]) for content, _ in contents]
        pairs.append({"pictures": shown[1::-1] if swap else shown[:2], "context": shown[2] if shown[2:] else None})
    methods = (_method(request.first), _method(request.second))
    if methods[0] == methods[1]:
        methods = (str(request.first), str(request.second))
    key = Key(study=digest.hexdigest()[:16], methods=methods, pairs=tuple(names), swapped=swapped)
    page = render_page(
        Path(__file__).with_name("page.html.jinja"), title=request.question, study={"study": key.study, "pairs": pairs}
    )
    with written(out) as work:
        work.write_text(page, encoding="utf-8")
    write_text(key_file(out), json.dumps(key.model_dump(mode="json"), indent=1))
    return key


def key_file(page: Path) -> Path:
    """Return where a page's key lies."""
    return page.with_suffix(".key.json")


def _method(folder: Path) -> str:
    return folder.resolve().name


def _picture(path: Path) -> tuple[bytes, tuple[int, int]]:
    """Return a picture's file as it is, which a browser shows, and its size; raises for one that cannot be decoded."""
    with open_picture(path) as image:
        return read_bytes(path), image.size
