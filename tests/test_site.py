"""The documents as a site: every warning is an error, dead links among them; nothing comes from elsewhere."""

import re
from pathlib import Path

import pytest

from tests import ROOT

mkdocs = pytest.importorskip("mkdocs.commands.build")


def test_the_site_is_built_without_warnings(
    tmp_path: Path, spheres_dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mkdocs.config import load_config

    monkeypatch.setenv("NO_MKDOCS_2_WARNING", "1")
    extra = {"generator": False, "scenes": str(spheres_dataset)}
    mkdocs.build(load_config(str(ROOT / "mkdocs.yml"), site_dir=str(tmp_path), extra=extra))
    pages = {path.relative_to(tmp_path).as_posix(): path.read_text() for path in tmp_path.rglob("*.html")}
    assert {"index.html", "tutorial.html", "ARCHITECTURE.html", "examples/relight_it.html"} <= set(pages)
    fetched = r"<(?:script|img|iframe|source)[^>]*\bsrc=\"?(?:https?:)?//|<link[^>]*stylesheet[^>]*https?://"
    assert not [name for name, page in pages.items() if re.search(fetched, page)]
    assert 'id="multilight.make"' in pages["reference/python.html"]
    assert 'href="mixer/index.html"' in pages["index.html"]
    assert 'href="../mixer/index.html"' in pages["reference/python.html"]
    assert (tmp_path / "mixer/data/scenes/000001/views/00/all.gz").is_file()
