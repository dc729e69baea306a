"""The documents as a site: every warning is an error, dead links among them; nothing comes from elsewhere."""

import re
from pathlib import Path
from typing import Any

import pytest

from tests import ROOT
from tests.browsing import barriers, needs_npm
from tests.datagen.servers import http_server

mkdocs = pytest.importorskip("mkdocs.commands.build")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory, spheres_dataset: Path) -> Path:
    """The site, as `make docs` builds it, with another dataset."""
    from mkdocs.config import load_config

    out = tmp_path_factory.mktemp("site")
    extra = {"generator": False, "scenes": str(spheres_dataset)}
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("NO_MKDOCS_2_WARNING", "1")
        mkdocs.build(load_config(str(ROOT / "mkdocs.yml"), site_dir=str(out), extra=extra))
    return out


def test_the_site_is_built_without_warnings(site: Path) -> None:
    pages = {path.relative_to(site).as_posix(): path.read_text() for path in site.rglob("*.html")}
    assert {"index.html", "tutorial.html", "ARCHITECTURE.html", "examples/relight_it.html"} <= set(pages)
    fetched = r"<(?:script|img|iframe|source)[^>]*\bsrc=\"?(?:https?:)?//|<link[^>]*stylesheet[^>]*https?://"
    assert not [name for name, page in pages.items() if re.search(fetched, page)]
    assert 'id="multilight.make"' in pages["reference/python.html"]
    assert 'href="mixer/index.html"' in pages["index.html"]
    assert 'href="../mixer/index.html"' in pages["reference/python.html"]
    assert (site / "mixer/data/scenes/000001/views/00/all.gz").is_file()


IN_THE_DARK = ["index.html", "tutorial.html", "measurements.html", "reference/python.html"]
"""Pages with all kinds of code, tables and links, whose colours alone are others in the dark."""


@needs_npm
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_no_page_bars_anyone(browser: Any, site: Path, scheme: str) -> None:
    page = browser.new_page(color_scheme=scheme, reduced_motion="reduce")
    names = {file.relative_to(site).as_posix() for file in site.rglob("*.html")}
    names -= {"mixer/index.html"}  # tests/datagen/test_view.py
    found = {}
    with http_server(site) as (address, _):
        for name in IN_THE_DARK if scheme == "dark" else sorted(names):
            page.goto(f"{address}/{name}")
            found[name] = barriers(page)
    page.close()
    assert not {name: told for name, told in found.items() if told}
