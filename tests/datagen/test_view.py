"""The light mixer: its page in a real browser, against what `multilight mix` makes; its server; the page as files."""

import base64
import contextlib
import dataclasses
import http.client
import io
import json
import shlex
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from multilight.datagen.cli import main
from multilight.datagen.storage.object_variants import ALL
from multilight.datagen.storage.open_dataset import DatasetSource, open_dataset
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.store import ViewData, scene_folder
from multilight.datagen.tuples import compose, pictures
from multilight.datagen.tuples.condition_files import metered
from multilight.datagen.view.content import ViewFiles, scene_json, view_folder
from multilight.datagen.view.server import PAGE, SITE, Server
from multilight.lights.display.tonemap import to_display
from multilight.lights.photometry.colour import temperature_to_rgb
from multilight.lights.spec import LightingCondition
from multilight.scenes.colour import luminance
from tests import ROOT
from tests.browsing import barriers, needs_npm, swipe
from tests.datagen.servers import http_server

WEB = ROOT / "web"
NO_WEBGL = "HTMLCanvasElement.prototype.getContext = new Proxy(HTMLCanvasElement.prototype.getContext, {apply: \
(call, canvas, words) => words[0] === 'webgl2' ? null : Reflect.apply(call, canvas, words)})"
PAINTERS = pytest.mark.parametrize(("script", "painter"), [("", "gpu"), (NO_WEBGL, "cpu")], ids=["webgl", "processor"])


@dataclass
class Mixer:
    """An open page; whatever it complains of is remembered."""

    page: Any
    address: str
    complaints: list[str] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)

    def open(self, **state: object) -> None:
        """Show a state, and wait until it is painted."""
        words = "&".join(f"{key}={value}" for key, value in state.items())
        self.page.goto(f"{self.address}#{words}")
        self.painted()

    def painted(self) -> None:
        """Wait until what the address says is shown."""
        self.until("document.body.dataset.shown && document.body.dataset.shown === location.hash.slice(1)")

    def until(self, code: str) -> None:
        """Wait until an expression holds; the page's own policy lets nothing be evaluated in it."""
        end = time.monotonic() + 240
        while not self.page.evaluate(code):
            assert time.monotonic() < end, f"never came: {code}; {self.text('.alarm')}"
            time.sleep(0.02)

    def press(self, *keys: str) -> None:
        """Press keys, and wait until what they do is shown."""
        for key in keys:
            self.page.keyboard.press(key)
        self.painted()

    def picture(self, pane: str) -> np.ndarray:
        """Return what a pane shows, at the view's own size."""
        canvas = f"document.querySelector('canvas[data-pane={pane}]')"
        self.until(canvas)
        content = base64.b64decode(self.page.evaluate(f"{canvas}.toDataURL().split(',')[1]"))
        return np.asarray(Image.open(io.BytesIO(content)).convert("RGB")).astype(int)

    def text(self, selector: str) -> str:
        return " ".join(self.page.evaluate(f"document.querySelector('{selector}')?.textContent ?? ''").split())

    def state(self) -> dict[str, str]:
        code = "Object.fromEntries(new URLSearchParams(location.hash.slice(1)))"
        return dict(self.page.evaluate(code))


@contextlib.contextmanager
def serving(source: DatasetSource) -> Iterator[str]:
    with Server(source, 0) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server.address
        server.shutdown()


@pytest.fixture(scope="module")
def address(spheres_dataset: Path) -> Iterator[str]:
    with serving(open_dataset(spheres_dataset)) as address:
        yield address


@contextlib.contextmanager
def mixer(browser: Any, address: str, *, script: str = "", broken: bool = False, **options: Any) -> Iterator[Mixer]:
    """Open a page of its own, whose styles change at once; it may complain only where something is `broken`."""
    context = browser.new_context(reduced_motion="reduce", **options)
    if script:
        context.add_init_script(script)
    page = context.new_page()
    page.set_default_timeout(120_000)
    made = Mixer(page, address)
    page.on("console", lambda said: made.complaints.append(said.text) if complains(said) else None)
    page.on("pageerror", lambda error: made.complaints.append(str(error)))
    page.on("request", lambda request: made.asked.append(request.url))
    yield made
    context.close()
    assert broken or not made.complaints
    assert all(url.startswith((made.address, "data:", "blob:")) for url in made.asked), made.asked


def complains(said: Any) -> bool:
    """Whether a page says that something is wrong; a software driver's word on its own speed is nothing wrong."""
    return said.type in ("error", "warning") and "GPU stall due to ReadPixels" not in said.text


def random_state(rng: np.random.Generator, record: SceneRecord) -> tuple[dict[str, object], list[LightingCondition]]:
    """Draw a state of the page, and the lightings of scene and object that it means."""
    lightings, texts = [], []
    for name in ("base", "insert"):
        ev = round(float(rng.uniform(-3, 3)), 4) + record.conditions[0].exposure_ev
        gains, words = {}, []
        solo = rng.integers(len(record.rig.names)) if rng.random() < 0.2 else None
        for number, light in enumerate(record.rig.names):
            stops = round(float(rng.uniform(-4, 4)), 4)
            drawn = rng.uniform(0.05, 2, 3)
            tint = [1.0, 1.0, 1.0] if rng.random() < 0.3 else np.round(drawn / luminance(drawn), 4).tolist()
            on = bool(rng.random() < 0.75)
            words.append(f"{'s' if number == solo else ''}{int(on)}:{stops}:{'_'.join(map(str, tint))}")
            if number == solo if solo is not None else on:
                gains[light] = tuple(2**stops * channel for channel in tint)
        lightings.append(LightingCondition(name=name, gains=gains, exposure_ev=ev))
        texts.append(";".join([str(round(ev, 4)), *words]))
    names = record.scene.insertable
    state = {
        "scene": record.index,
        "view": int(rng.integers(len(record.views))),
        "object": names[int(rng.integers(len(names)))],
        "layout": "all",
        "scene_light": texts[0],
        "object_light": texts[1],
    }
    return state, lightings


def expected(view: ViewData, name: str, base: LightingCondition, insert: LightingCondition) -> dict[str, np.ndarray]:
    return {
        "background": to_display(compose.background(view, name, base)),
        "composite": to_display(compose.composite(view, name, insert=insert, base=base)),
        "target": to_display(compose.target(view, base)),
        "effect": pictures.effect_picture(compose.effect(view, name, base)),
    }


def worst_of(page: Mixer, source: DatasetSource, rng: np.random.Generator, count: int) -> int:
    """Return the largest difference in 1/255 between the page and `multilight mix` over random states."""
    worst = 0
    for _ in range(count):
        record = source.scene(int(rng.choice(source.indices)))
        state, (base, insert) = random_state(rng, record)
        page.open(**state)
        view = source.view(record, int(str(state["view"])))
        for pane, picture in expected(view, str(state["object"]), base, insert).items():
            worst = max(worst, int(np.abs(page.picture(pane) - picture).max()))
    return worst


@PAINTERS
def test_the_page_mixes_as_python_does(
    browser: Any, address: str, spheres_dataset: Path, script: str, painter: str
) -> None:
    source = open_dataset(spheres_dataset)
    with mixer(browser, address, script=script) as page:
        assert worst_of(page, source, np.random.default_rng(7), 20) <= 2
        assert page.page.evaluate("document.documentElement.dataset.painter") == painter


def test_maps_are_those_of_mix(browser: Any, address: str, sphere_view: tuple[SceneRecord, ViewData]) -> None:
    geometry = sphere_view[1].geometry
    with mixer(browser, address) as page:
        page.open(scene=0, view=0, object=sphere_view[0].scene.insertable[0], layout="all")
        for pane, picture in {
            "depth": pictures.depth_picture(geometry.z_depth),
            "normal": pictures.normal_picture(geometry.normal_world),
            "albedo": pictures.albedo_picture(geometry.albedo),
            "ids": pictures.ids_picture(geometry.instance_id),
        }.items():
            assert np.abs(page.picture(pane) - picture).max() <= 1, pane


def test_clicks_and_keys(browser: Any, address: str, sphere_view: tuple[SceneRecord, ViewData]) -> None:
    record, view = sphere_view
    first, second = record.rig.names[:2]
    with mixer(browser, address, viewport={"width": 1200, "height": 800}) as page:
        page.open(scene=0, view=0, object=record.scene.insertable[0], scene_light="all", edits="scene", curve="soft")
        page.press("ArrowRight")
        assert page.state()["view"] == "1"
        page.press("ArrowLeft", "1")
        off = LightingCondition(name="off", gains={name: (1.0,) * 3 for name in record.rig.names if name != first})
        off = off.model_copy(update={"exposure_ev": record.condition("all").exposure_ev})
        assert np.abs(page.picture("target") - to_display(compose.target(view, off))).max() <= 2
        page.page.get_by_role("button", name=f"Only {second.replace('_', ' ')}").click()
        page.press("o")
        assert page.state()["edits"] == "object"
        assert "s1" in page.state()["scene_light"]
        page.page.get_by_role("button", name=record.conditions[1].name.replace("_", " "), exact=True).click()
        page.press("l")
        assert page.state()["layout"] == "pair"
        assert page.state()["object_light"] == record.conditions[1].name

        page.page.get_by_text("Light the object as the scene").click()
        page.press("l", "l")
        assert (page.state()["linked"], page.state()["layout"]) == ("1", "divide")
        handle = page.page.get_by_role("slider", name="Divider")
        handle.focus()
        page.press("End", "ArrowLeft")
        assert page.state()["divider"] == "0.98"
        box = page.page.locator(".frame").bounding_box()
        page.page.mouse.move(box["x"] + 0.98 * box["width"], box["y"] + 20)
        page.page.mouse.down()
        page.page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 20, steps=3)
        page.page.mouse.up()
        page.press()
        assert float(page.state()["divider"]) == pytest.approx(0.25, abs=0.01)
        page.page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 20)
        page.page.mouse.down()
        page.page.mouse.move(box["x"] + 0.95 * box["width"], box["y"] + 25, steps=4)
        page.page.mouse.up()
        page.press()
        assert page.state()["view"] == str(len(record.views) - 1)


def test_a_click_reads_a_pixel(browser: Any, address: str, sphere_view: tuple[SceneRecord, ViewData]) -> None:
    record, view = sphere_view
    ids = view.geometry.instance_id
    rows, columns = np.nonzero(ids == ids.max())
    row, column = int(rows[len(rows) // 2]), int(columns[len(columns) // 2])
    with mixer(browser, address, viewport={"width": 1200, "height": 800}) as page:
        name = record.scene.insertable[0]
        page.open(scene=0, view=0, object=name, scene_light="all", layout="pair", left="target")
        box = page.page.locator(".frame").first.bounding_box()
        scale = box["width"] / ids.shape[1]
        page.page.mouse.click(box["x"] + (column + 0.5) * scale, box["y"] + (row + 0.5) * scale)
        page.press()
        said = page.text(".read")
        assert f"pixel{column}, {row}" in said
        radiance = compose.target(view, record.condition("all"))[row, column]
        told = [float(word) for word in said.split("target")[1].split(" (")[0].split()]
        assert told == pytest.approx(radiance.tolist(), rel=6e-3)
        assert float(said.split("depth")[1].split()[0]) == pytest.approx(view.geometry.z_depth[row, column], rel=1e-3)
        assert record.scene.bodies[int(ids.max()) - 1].name.replace("_", " ") in said
        before = page.state()
        page.page.locator(".frame").first.focus()
        page.press("Shift+ArrowRight")
        assert page.state()["pick"] == before["pick"].replace(f"{column},", f"{column + 1},", 1)


def test_the_address_holds_the_state(browser: Any, address: str, spheres_dataset: Path) -> None:
    record = open_dataset(spheres_dataset).scene(1)
    state, _ = random_state(np.random.default_rng(3), record)
    state |= {"layout": "pair", "curve": "stops", "left": "background", "divider": 0.3, "pick": "5,7,target"}
    with mixer(browser, address) as page:
        page.open(**state)
        shown, picture = page.state(), page.picture("background")
        with mixer(browser, address) as again:
            again.open(**shown)
            assert again.state() == shown
            assert np.array_equal(again.picture("background"), picture)
        page.page.goto(f"{address}#scene=1&object=none&view=99&layout=odd&scene_light=1;2;3&divider=x")
        page.press()
        assert page.state()["view"] == shown["view"]  # what means nothing changes nothing
    with mixer(browser, address) as page:
        page.open(scene=1, view=1)
        assert page.state()["view"] == "1"
        assert page.state()["object"] in record.scene.insertable
        page.page.goto(f"{address}#scene=99&view=1")
        page.until("document.querySelector('.toast.there')")
        assert page.text(".toast") == "There is no scene 99 here: this is scene 0"


def saved(page: Mixer, side: str, folder: Path, name: str | None = None) -> tuple[str, str]:
    """Save the lighting of a side into a folder; returns the name that was proposed, and the command that is shown."""
    page.page.get_by_role("button", name="Save the lighting").click()
    dialog = page.page.get_by_role("dialog")
    dialog.locator("label", has_text=side).first.click()
    proposed = dialog.get_by_label("Name").input_value()
    dialog.get_by_label("Name").fill(name or proposed)
    command = dialog.get_by_label("The command").inner_text()
    with page.page.expect_download() as download:
        dialog.get_by_role("button", name="Save the file").click()
    download.value.save_as(folder / download.value.suggested_filename)
    return proposed, command


def test_a_saved_condition_makes_the_same_picture(
    browser: Any, address: str, spheres_dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the very command that is shown, whichever side is saved."""
    monkeypatch.chdir(tmp_path)
    record = open_dataset(spheres_dataset).scene(0)
    state, _ = random_state(np.random.default_rng(5), record)
    with mixer(browser, address) as page:
        for around in ("mixed", "all"):
            page.open(
                **state | {"edits": "scene", "layout": "all"} | ({"scene_light": "all"} if around == "all" else {})
            )
            for side, name, pane in (("Scene", "scene", "target"), ("Object", None, "composite")):
                proposed, command = saved(page, side, tmp_path, name)
                assert proposed == (around if side == "Scene" else "mixed")
                assert main(shlex.split(command)[1:]) == 0
                made = np.asarray(Image.open(tmp_path / f"{name or proposed}.png"))
                assert np.abs(page.picture(pane) - made).max() <= 2


def test_what_lights_is_drawn_lit_and_keys_work_after_a_slider(browser: Any, address: str) -> None:
    with mixer(browser, address) as page:
        page.open(scene=0, view=0, edits="scene", scene_light="key_only")
        lit = "[...document.querySelectorAll('.light .bulb')].map(each => getComputedStyle(each).boxShadow !== 'none')"
        names = page.page.evaluate("[...document.querySelectorAll('.light strong')].map(each => each.textContent)")
        assert page.page.evaluate(lit) == [name == "key" for name in names]
        other = next(i for i, name in enumerate(names) if name != "key")
        page.page.locator(".light .solo").nth(other).click()
        page.painted()
        assert page.page.evaluate(lit) == [i == other for i in range(len(names))]
        page.page.get_by_role("slider", name=f"Power of {names[other]} in stops").focus()
        page.press(f"Shift+Digit{other + 1}")
        assert page.page.evaluate(lit) == [name == "key" for name in names]
        before = page.state()["scene_light"]
        page.press("ArrowRight")  # moves the slider, not the view
        assert page.state()["view"] == "0"
        assert page.state()["scene_light"] != before
        assert page.page.evaluate("document.documentElement.scrollHeight <= innerHeight")


def test_meter_and_kelvin_are_those_of_python(
    browser: Any, address: str, sphere_view: tuple[SceneRecord, ViewData]
) -> None:
    record, view = sphere_view
    name = record.rig.names[0]
    with mixer(browser, address) as page:
        lamps = ";".join(["1:0", *["0:0"] * (len(record.rig.names) - 1)])
        page.open(scene=0, view=0, object=record.scene.insertable[0], edits="scene", scene_light=f"0;{lamps}")
        page.page.get_by_role("button", name="Meter").click()
        page.press()
        alone = LightingCondition(name="alone", gains={name: (1.0, 1.0, 1.0)})
        exposed = float(page.state()["scene_light"].split(";")[0])
        assert exposed == pytest.approx(metered(alone, view).exposure_ev, abs=0.01)
        page.page.get_by_label(f"Colour of {name} in kelvin").evaluate(
            "slider => { slider.value = -1e6 / 3200; slider.dispatchEvent(new Event('input')) }"
        )
        page.press()
        kelvin = 1e6 / round(1e6 / 3200)
        own = record.rig.lights[0].colour_temperature or 6504.0
        wanted = np.divide(temperature_to_rgb(kelvin), temperature_to_rgb(own))
        tint = [float(value) for value in page.state()["scene_light"].split(";")[1].split(":")[2].split("_")]
        assert tint == pytest.approx((wanted / luminance(wanted)).tolist(), rel=0.01)


def test_table_of_whites_is_that_of_python() -> None:
    rows = json.loads((WEB / "src" / "whites.json").read_text())
    for kelvin, *rgb in rows[::4]:
        assert rgb == pytest.approx(temperature_to_rgb(kelvin), abs=1e-3)


def test_a_dataset_at_an_address(browser: Any, spheres_dataset: Path) -> None:
    pytest.importorskip("aiohttp")
    with http_server(spheres_dataset) as (remote, _), serving(open_dataset(remote)) as address:
        source = open_dataset(spheres_dataset)
        with mixer(browser, address) as page:
            assert worst_of(page, source, np.random.default_rng(1), 1) <= 2


def test_what_is_broken_is_told(browser: Any, spheres_copy: Path) -> None:
    file = spheres_copy / "scenes/000000/views/00.exr"
    file.write_bytes(file.read_bytes()[:2000])
    with serving(open_dataset(spheres_copy)) as address, mixer(browser, address, broken=True) as page:
        page.page.goto(address)
        page.until("document.querySelector('.alarm:not([hidden])') !== null")
        assert "views/00.exr is truncated or replaced" in page.text(".alarm")
        assert "made anew by: multilight dataset" in page.text(".alarm")
        page.page.keyboard.press("ArrowRight")
        page.painted()
        page.page.get_by_role("button", name="Next scene").click()
        page.until("document.body.dataset.shown?.startsWith('scene=1&')")
        assert page.page.locator(".alarm").is_hidden()


def test_the_page_as_files(
    browser: Any, spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    export = ["export", "web", str(spheres_dataset), "--out", str(tmp_path / "site"), "--scenes", "1"]
    assert main(export) == 0
    written = {path: path.stat().st_mtime_ns for path in (tmp_path / "site").rglob("*.gz")}
    assert main(export) == 0
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "site").rglob("*.gz")} == written
    assert main(["verify", str(tmp_path / "site")]) == 0
    assert str(tmp_path) not in (tmp_path / "site/data/dataset.json").read_text()  # which is published
    with http_server(tmp_path / "site") as (remote, _), mixer(browser, f"{remote}/") as page:
        source = open_dataset(spheres_dataset, where="index = 1")
        assert worst_of(page, source, np.random.default_rng(2), 2) <= 2
    assert main([*export[:-1], "7"]) == 1
    assert "--scenes 7 is not in" in capsys.readouterr().err


def test_only_what_changes_is_painted(browser: Any, address: str, sphere_view: tuple[SceneRecord, ViewData]) -> None:
    script = (
        "window.drawn = 0; const draw = CanvasRenderingContext2D.prototype.drawImage;"
        "CanvasRenderingContext2D.prototype.drawImage = function (...words) { window.drawn++; draw.apply(this, words) }"
    )
    with mixer(browser, address, script=script, viewport={"width": 1200, "height": 800}) as page:
        state = {"scene": 0, "view": 0, "object": sphere_view[0].scene.insertable[0], "edits": "object"}
        page.open(**state, layout="divide", left="composite", right="target")

        def drawn(*keys: str) -> int:
            page.page.evaluate("window.drawn = 0")
            page.press(*keys)
            return int(page.page.evaluate("window.drawn"))

        assert drawn("1") == 1  # a light of the object: the composite alone
        page.page.get_by_role("slider", name="Divider").focus()
        assert drawn("End") == 0
        assert drawn("o", "1") == 2  # a light of the scene


def as_files(record: SceneRecord, view: ViewData, folder: Path) -> None:
    """Write the page of a scene of one view, whatever it holds."""
    place = folder / "data" / scene_folder(record.index)
    (place / view_folder(0)).mkdir(parents=True)
    for name in PAGE:
        shutil.copy(SITE / name, folder)
    about = {"index": record.index, "kind": "spheres", "views": 1, "lights": len(view.lights), "objects": 0}
    (folder / "data/dataset.json").write_text(json.dumps({"address": "set", "scenes": [about]}))
    (place / "scene.json").write_bytes(scene_json(record))
    files = ViewFiles(record, view)
    for name in files.names():
        (place / view_folder(0) / name).write_bytes(files.file(name, 6))


def test_one_view_from_which_nothing_can_be_taken_out(
    browser: Any, sphere_view: tuple[SceneRecord, ViewData], tmp_path: Path
) -> None:
    record, view = sphere_view
    bodies = tuple(body.model_copy(update={"insertable": False}) for body in record.scene.bodies)
    alone = {"scene": record.scene.model_copy(update={"bodies": bodies}), "views": record.views[:1]}
    kept = dataclasses.replace(view, variants={ALL: view.variants[ALL]}, coverage={})
    as_files(record.model_copy(update=alone), kept, tmp_path)
    for script in ("", NO_WEBGL):
        with http_server(tmp_path) as (remote, _), mixer(browser, f"{remote}/", script=script) as page:
            page.open(scene=0, object="", scene_light="all", layout="all", pick="3,3,target")
            target = to_display(compose.target(view, record.condition("all")))
            for pane in ("target", "composite", "background"):
                assert np.abs(page.picture(pane) - target).max() <= 2
            assert page.page.locator("header select").is_hidden()
            assert page.page.get_by_role("slider", name="View").is_hidden()
            page.page.get_by_role("button", name="Save the lighting").click()
            assert "--object" not in page.text("dialog")


def test_twelve_lights(browser: Any, sphere_view: tuple[SceneRecord, ViewData], tmp_path: Path) -> None:
    record, view = sphere_view
    own = [i % len(view.lights) for i in range(12)]
    lights = [record.rig.lights[i].model_copy(update={"name": f"lamp_{n}"}) for n, i in enumerate(own)]
    names = tuple(light.name for light in lights)
    many = dataclasses.replace(view, lights=names, variants={k: layers[own] for k, layers in view.variants.items()})
    gains = {name: (0.1 * n, 0.05 * n, 0.2) for n, name in enumerate(names)}
    lit = LightingCondition(name="twelve", gains=gains, exposure_ev=record.conditions[0].exposure_ev - 2)
    energy = {ALL: dict.fromkeys(names, next(iter(record.views[0].energy[ALL].values())))}
    told = {
        "rig": record.rig.model_copy(update={"lights": tuple(lights)}),
        "conditions": (lit,),
        "views": (record.views[0].model_copy(update={"energy": energy}),),
    }
    as_files(record.model_copy(update=told), many, tmp_path)
    with http_server(tmp_path) as (remote, _), mixer(browser, f"{remote}/") as page:
        page.open(scene=0, object=(name := record.scene.insertable[0]), layout="all")
        assert page.page.locator(".light").count() == 12
        for pane, picture in expected(many, name, lit, lit).items():
            assert np.abs(page.picture(pane) - picture).max() <= 2, pane


@needs_npm
@pytest.mark.parametrize(
    ("scheme", "width", "height"), [("dark", 1440, 900), ("light", 390, 844), ("light", 820, 1180)]
)
def test_nothing_bars_anyone(browser: Any, address: str, scheme: str, width: int, height: int) -> None:
    view = {"width": width, "height": height}
    with mixer(browser, address, viewport=view, color_scheme=scheme) as page:
        page.open(scene=0, view=0, object="none", edits="object", pick="3,3,target", curve="stops")
        assert barriers(page.page) == []
        assert page.page.evaluate("document.documentElement.scrollWidth") <= width
        for title in ("Help", "Save the lighting", "All scenes"):
            page.page.get_by_title(title).click()
            assert barriers(page.page) == [], title
            page.page.keyboard.press("Escape")


@needs_npm
def test_the_page_is_what_its_sources_give(tmp_path: Path) -> None:
    subprocess.run(["npx", "--no-install", "tsc"], cwd=WEB, check=True)
    words = ["npx", "--no-install", "vite", "build", "--logLevel", "error", "--emptyOutDir", "--outDir", str(tmp_path)]
    subprocess.run(words, cwd=WEB, check=True)
    for name in PAGE:
        assert (tmp_path / name).read_bytes() == (SITE / name).read_bytes(), f"{name} is not what web/ gives: make web"


@dataclass(frozen=True)
class Answer:
    status: int
    content: bytes
    policy: str | None


def ask(address: str, path: str, *, host: str | None = None, method: str = "GET") -> Answer:
    place = address.removeprefix("http://").rstrip("/")
    with contextlib.closing(http.client.HTTPConnection(place)) as connection:
        connection.request(method, path, headers={"Host": host or place})
        answer = connection.getresponse()
        return Answer(answer.status, answer.read(), answer.getheader("Content-Security-Policy"))


def test_the_server_answers_for_its_dataset_only(address: str) -> None:
    assert address.startswith("http://127.0.0.1:")
    port = address.rstrip("/").rpartition(":")[2]
    assert ask(address, "/", host=f"localhost:{port}").status == 200
    for host in ("evil.example", f"evil.example:{port}", "127.0.0.1"):
        assert ask(address, "/data/dataset.json", host=host).status == 403
    scene = "/data/scenes/000000"
    beside = ("/scene.json/", "/views/00/../scene.json", "/views/99/view.json", "/views/0/view.json", "/views/00.exr")
    none = ("/../../etc/passwd", "//etc/passwd", "/%2e%2e/dataset.json", "/data/../dataset.json", "/app.js.map")
    others = ("/data/scenes/0000000/scene.json", "/data/scenes/000009/scene.json", "/data/dataset.json/x")
    for path in (*none, *others, *(scene + name for name in (*beside, "/views/00/all.npy"))):
        assert ask(address, path).status == 404, path
    assert ask(address, "/", method="POST").status == 501
    head = ask(address, "/data/scenes/000000/views/00/all.gz", method="HEAD")
    assert (head.status, head.content) == (200, b"")
    assert "default-src 'none'" in str(ask(address, "/").policy)


def test_view_says_what_is_wrong(
    spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], address: str
) -> None:
    port = address.rstrip("/").rpartition(":")[2]
    for words, told in {
        (str(tmp_path),): "dataset.json is missing",
        (str(spheres_dataset), "--where", "index > 9"): "holds no finished scene for which index > 9",
        (str(spheres_dataset), "--port", port): f"--port {port} cannot be used",
        (str(spheres_dataset), "--port", "70000"): "--port 70000 must be 0 to 65535",
    }.items():
        assert main(["view", *words, "--no-open"]) == 1
        assert told in capsys.readouterr().err


def test_the_command_serves_until_it_is_stopped(spheres_dataset: Path) -> None:
    words = [sys.executable, "-m", "multilight", "view", str(spheres_dataset), "--no-open", "--port", "0"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT) as running:
        address, _, rest = running.stdout.readline().partition(" ")
        assert rest == "shows it; Ctrl+C ends\n"
        assert [scene["index"] for scene in json.loads(ask(address, "/data/dataset.json").content)["scenes"]] == [0, 1]
        running.terminate()  # not SIGINT, which background jobs of a shell ignore
        assert (running.wait(60), running.stderr.read()) == (143, "stopped\n")


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> DatasetSource:
    """A small tabletop by whichever renderer is there: noise, highlights beyond white, soft edges."""
    root = tmp_path_factory.mktemp("rendered") / "dataset"
    size = ["--width", "96", "--height", "72", "--views", "2", "--spp", "4", "--seed", "42"]
    assert main(["dataset", "--out", str(root), "--preset", "tabletop", "--scenes", "1", "--workers", "1", *size]) == 0
    return open_dataset(root)


@pytest.mark.slow
@PAINTERS
def test_a_rendered_scene_is_mixed_as_python_does(
    browser: Any, rendered: DatasetSource, script: str, painter: str
) -> None:
    with serving(rendered) as address, mixer(browser, address, script=script) as page:
        assert worst_of(page, rendered, np.random.default_rng(11), 10) <= 2
        assert page.page.evaluate("document.documentElement.dataset.painter") == painter


@pytest.mark.slow
def test_fingers_on_a_phone(browser: Any, rendered: DatasetSource) -> None:
    """Divider, views and sliders follow a finger, a tap reads, and what no finger meant stays."""
    phone: dict[str, Any] = {
        "viewport": {"width": 390, "height": 844},
        "has_touch": True,
        "is_mobile": True,
        "device_scale_factor": 2,
    }
    record = rendered.scene(0)
    with serving(rendered) as address, mixer(browser, address, **phone) as page:
        page.open(scene=0, view=0, object=record.scene.insertable[0], scene_light="all", edits="scene", divider=0.5)
        box = page.page.locator(".frame").bounding_box()

        def at(x: float, y: float = 0.2) -> tuple[float, float]:
            return box["x"] + x * box["width"], box["y"] + y * box["height"]

        swipe(page.page, at(0.5), at(0.2))
        page.painted()
        assert float(page.state()["divider"]) == pytest.approx(0.2, abs=0.02)
        swipe(page.page, at(0.4), at(0.95))
        page.painted()
        assert (page.state()["view"], page.state()["divider"][:3]) == ("1", "0.2")
        page.page.touchscreen.tap(*at(0.6, 0.7))
        page.painted()
        x, y, pane = page.state()["pick"].split(",")
        assert (int(x) / 96, int(y) / 72, pane) == (
            pytest.approx(0.6, abs=0.02),
            pytest.approx(0.7, abs=0.02),
            "target",
        )
        for word in ("pixel", "target", "depth", "object", "material"):
            assert word in page.text(".read")

        page.page.evaluate("document.querySelector('.panel').scrollIntoView()")
        light = page.page.get_by_label(f"Power of {record.rig.names[0].replace('_', ' ')}")
        light.scroll_into_view_if_needed()
        slider = light.bounding_box()
        middle = slider["y"] + slider["height"] / 2
        swipe(page.page, (slider["x"] + slider["width"] / 2, middle), (slider["x"] + 0.8 * slider["width"], middle))
        page.painted()
        stops = float(page.state()["scene_light"].split(";")[1].split(":")[1])
        assert stops > 1
        before = page.page.evaluate("scrollY")
        swipe(page.page, (200, 800), (200, 600))
        page.until(f"scrollY > {before} + 50")
        page.painted()
        assert float(page.state()["scene_light"].split(";")[1].split(":")[1]) == stops
