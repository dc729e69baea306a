"""The light mixer's page in headless Chromium: frames a second, and how soon a view is there, for eight lights.

Every frame one light's power changes, and both sides of the divider are painted anew; a frame counts when its pixels
have been read back, so nothing is left in a queue. What the main thread takes is script, style, layout and reading
back, and with `--processor` all of the mixing. Where there is no graphics card, Chromium draws WebGL by software; what
draws is told. The scene is a tabletop.

    python -m benchmarks.mixer
"""

import shutil
import tempfile
import threading
from dataclasses import dataclass
from pathlib import Path

import tyro
from playwright.sync_api import CDPSession, sync_playwright

import multilight
from multilight.datagen.storage.open_dataset import open_dataset
from multilight.datagen.view.server import Server

FRAMES = """async (seconds) => {
  const slider = document.querySelector(".dials input[type=range]");
  const canvas = document.querySelector("canvas[data-pane]");
  const next = () => new Promise(requestAnimationFrame), times = [];
  for (const end = performance.now() + 1000 * seconds; performance.now() < end;) {
    slider.value = 2 * Math.sin(times.length / 10);
    slider.dispatchEvent(new Event("input"));
    await next();
    canvas.getContext("2d").getImageData(0, 0, 1, 1);
    times.push(performance.now());
  }
  return (1000 * (times.length - 1)) / (times.at(-1) - times[0]);
}"""
LOADED = """() => { const all = performance.getEntriesByType("resource");
  const files = all.filter(({ name }) => name.includes("/views/00/"));
  return Math.max(...files.map((file) => file.responseEnd)) - Math.min(...files.map((file) => file.startTime)); }"""
RENDERER = """() => { const gl = document.createElement("canvas").getContext("webgl2");
  return gl ? gl.getParameter(gl.getExtension("WEBGL_debug_renderer_info").UNMASKED_RENDERER_WEBGL) : "none"; }"""


@dataclass
class Options:
    """What to measure."""

    side: int = 512
    """Pixels a side of the pictures."""
    lights: int = 8
    """Lights of the scene."""
    seconds: float = 10.0
    """How long to look."""
    processor: bool = False
    """Mix by the processor, as where there is no WebGL2."""


def busy(session: CDPSession) -> float:
    """Return the seconds of a processor that the page's main thread has taken."""
    metrics = session.send("Performance.getMetrics")["metrics"]
    return float(next(metric["value"] for metric in metrics if metric["name"] == "TaskDuration"))


def measure(options: Options, folder: Path) -> str:
    """Make the scene, open the page, and say how many frames a second it paints."""
    side, lights = options.side, (options.lights, options.lights)
    multilight.make(
        folder, preset="tabletop", scenes=1, views=1, width=side, height=side, lights=lights, insertable=1, spp=4
    )
    with Server(open_dataset(folder), 0) as server, sync_playwright() as driver:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        chromium = shutil.which("chromium") or shutil.which("google-chrome")
        args = ["--disable-gpu", "--disable-software-rasterizer"] if options.processor else []
        browser = driver.chromium.launch(executable_path=chromium, args=args)
        page = browser.new_page(viewport={"width": 1440, "height": 900})
        page.goto(f"{server.address}#linked=1&object=")
        page.locator("body[data-shown]").wait_for()
        session = page.context.new_cdp_session(page)
        session.send("Performance.enable", {"timeDomain": "threadTicks"})
        before = busy(session)
        rate = page.evaluate(FRAMES, options.seconds)
        spent = 1000 * (busy(session) - before) / (rate * options.seconds)
        told = f"{page.locator('.light').count()} lights at {options.side} x {options.side}: {rate:.1f} frames a second"
        loaded = f"the view is there in {page.evaluate(LOADED):.0f} ms"
        found = f"{told}, {spent:.1f} ms of the main thread a frame; {loaded}; {page.evaluate(RENDERER)}"
        browser.close()
        server.shutdown()
    return found


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        print(measure(tyro.cli(Options, description=__doc__), Path(place) / "scene"))
