"""Scenes in space: what the server holds, against the closed form, and what a browser shows of it."""

import io
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from multilight.datagen.cli import main
from multilight.datagen.storage.open_dataset import open_dataset
from multilight.datagen.tuples import compose
from multilight.lights.display.tonemap import to_display
from multilight.scenes.cameras.pinhole import project
from multilight.scenes.spec import Sphere

pytest.importorskip("viser", reason="pip install 'multilight[3d]'")
from multilight.datagen.view.space import FINE, Space, boxes_of, quaternion, seen_gaussians


@pytest.fixture(scope="module")
def space(spheres_dataset: Path) -> Iterator[Space]:
    with Space(open_dataset(spheres_dataset), 0) as space:
        yield space


def test_gaussians_have_the_colours_of_the_views(space: Space, spheres_dataset: Path) -> None:
    source = open_dataset(spheres_dataset)
    space.show(1)
    record = source.scene(1)
    views = list(source.views(record))
    for condition in record.conditions[:2]:
        space.relight(condition.name)
        pictures = np.stack([to_display(compose.target(view, condition)) for view in views])
        centres = space._gaussians.centers / FINE
        differences = []
        for camera, picture, view in zip(record.scene.cameras, pictures, views, strict=True):
            places, depths = project(camera, centres)
            columns, rows = np.floor(places).astype(int).T
            seen = (depths > 0) & (rows >= 0) & (rows < 48) & (columns >= 0) & (columns < 64)
            rows, columns, depths = rows[seen], columns[seen], depths[seen]
            near = np.abs(view.geometry.z_depth[rows, columns] - depths) < 1e-3
            told = space._gaussians.rgbs[seen][near].astype(int)
            differences.append(np.abs(told - picture[rows[near], columns[near]]).max(axis=1))
        assert np.median(np.concatenate(differences)) <= 2  # other views see gloss elsewhere


def test_boxes_hold_what_is_seen_of_spheres(spheres_dataset: Path) -> None:
    source = open_dataset(spheres_dataset)
    record = source.scene(0)
    views = list(source.views(record))
    boxes = boxes_of(record, views, seen_gaussians(record, views))
    assert set(record.scene.insertable) <= set(boxes)
    for name, (low, high, pose) in boxes.items():
        body = next(body for body in record.scene.bodies if body.name == name)
        assert isinstance(body.geometry, Sphere)
        assert np.linalg.norm(pose - np.asarray(body.world_from_body)) == 0
        assert (high - low).max() <= 2.02 * body.geometry.radius
        assert (high - low).max() > body.geometry.radius


def test_quaternions_leave_scale_out() -> None:
    pose = 3.0 * np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    assert quaternion(pose) == pytest.approx([np.sqrt(0.5), 0, 0, np.sqrt(0.5)])


def test_a_browser_shows_it(browser: Any, space: Space) -> None:
    assert space.address.startswith("http://127.0.0.1:")
    space.show(0)
    page = browser.new_page(viewport={"width": 640, "height": 480})
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(space.address)
    page.get_by_text("Lighting").wait_for(timeout=120_000)

    def drawn() -> np.ndarray:
        """Return what stands between the panels."""
        picture = np.asarray(Image.open(io.BytesIO(page.screenshot(timeout=120_000))).convert("L"))
        return picture[100:380, 150:420].astype(float)

    end = time.monotonic() + 120
    while drawn().std() < 5:
        assert time.monotonic() < end, "nothing was drawn"
    before = drawn()
    page.get_by_role("checkbox", name="boxes").click()
    while np.abs(drawn() - before).max() < 50:
        assert time.monotonic() < end, "no box was drawn"
    page.get_by_role("textbox", name="Scene").fill("1")
    page.keyboard.press("Enter")
    while space._record.index != 1:
        assert time.monotonic() < end, "the other scene was not shown"
        page.wait_for_timeout(100)
    assert all(url.startswith((space.address, "data:", "blob:")) for url in asked), asked
    page.close()


def test_what_is_missing_or_taken_is_told(
    space: Space, spheres_dataset: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["view", str(spheres_dataset), "--3d", "--no-open"]
    port = space.address.rstrip("/").rpartition(":")[2]
    assert main([*words, "--port", port]) == 1
    assert f"--port {port} cannot be used: it is taken" in capsys.readouterr().err
    monkeypatch.delitem(sys.modules, "multilight.datagen.view.space")
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main(words) == 1
    assert "--3d needs viser: pip install 'multilight[3d]'" in capsys.readouterr().err
