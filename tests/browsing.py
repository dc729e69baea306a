"""Pages in a real browser: headless Chromium, fingers on its screen, and what looks for barriers."""

import contextlib
import shutil
from collections.abc import Iterator
from typing import Any

import pytest

from tests import ROOT

AXE = ROOT / "web" / "node_modules" / "axe-core" / "axe.min.js"
BROWSERS = ("chromium", "google-chrome")
needs_npm = pytest.mark.skipif(not AXE.exists(), reason="web/node_modules is missing: make web")


@contextlib.contextmanager
def launched() -> Iterator[Any]:
    """Start a browser; skips the test where there is none. Without a graphics card it draws WebGL by software."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="pip install playwright: the browser's driver")
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        pytest.skip(f"there is none of {', '.join(BROWSERS)}; as root: apt-get install chromium")
    with sync_api.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=found)
        yield browser
        browser.close()


def barriers(page: Any) -> list[str]:
    """Name what of a page axe-core finds to bar somebody."""
    code = f"{AXE.read_text()}\naxe.run().then(found => found.violations.map(each => each.id + each.nodes[0].html))"
    return list(page.evaluate(code))


def swipe(page: Any, start: tuple[float, float], end: tuple[float, float], steps: int = 8) -> None:
    """Move a finger over the screen."""
    screen = page.context.new_cdp_session(page)
    for step in range(steps + 1):
        at = [a + (b - a) * step / steps for a, b in zip(start, end, strict=True)]
        kind = "touchMove" if step else "touchStart"
        screen.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [dict(zip("xy", at, strict=True))]})
    screen.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
