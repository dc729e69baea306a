"""`import multilight`: every name does what it says, is imported only when asked for, and refuses in one clear line."""

import importlib.metadata
import inspect
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import multilight
from tests import ROOT

SPHERES: dict[str, Any] = {
    "renderer": "analytic",
    "kind": "spheres",
    "width": 64,
    "height": 48,
    "views": 2,
    "spp": 4,
    "progress": False,
}
HEAVY = {
    *("bpy", "mitsuba", "drjit", "pxr", "torch", "trimesh", "pebble", "numpy", "polars", "pydantic", "OpenEXR", "tyro")
}


@pytest.fixture(scope="module")
def data(spheres_dataset: Path) -> multilight.Dataset:
    return multilight.open(spheres_dataset)


@pytest.fixture(scope="module")
def scene(data: multilight.Dataset) -> multilight.Scene:
    return data[0]


def run(code: str, **variables: str) -> str:
    """Run code in a process of its own and return what it prints."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)} | variables
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_import_is_light_and_quick() -> None:
    code = (
        "import sys, time; before = set(sys.modules); start = time.process_time(); import multilight\n"
        "print(time.process_time() - start, *sorted({m.partition('.')[0] for m in set(sys.modules) - before}))"
    )
    seconds, *modules = run(code).split()
    assert float(seconds) < 0.3
    assert not HEAVY & set(modules)


def test_names_are_typed_documented_and_no_others() -> None:
    assert len(multilight.__all__) <= 13
    assert set(multilight.__all__) <= set(dir(multilight))
    assert all(name in str(multilight.__doc__) for name in multilight.__all__ if name != "__version__")
    for name in multilight.__all__:
        value = getattr(multilight, name)
        if name == "__version__":
            continue
        assert inspect.getdoc(value), name
        if inspect.isfunction(value):
            found = inspect.signature(value)
            assert found.return_annotation is not inspect.Signature.empty
            assert all(p.annotation is not inspect.Parameter.empty for p in found.parameters.values()), name
    with pytest.raises(AttributeError, match="no attribute 'mixx'; it has Dataset"):
        multilight.mixx  # noqa: B018


def test_reading_starts_no_renderer_and_no_torch(spheres_dataset: Path) -> None:
    code = (
        f"import sys, multilight; place = {str(spheres_dataset)!r}; scene = multilight.open(place)[0]\n"
        "scene.mix(0, 1), scene.tuple(); assert multilight.verify(place) == []\n"
        "print(*sorted({'bpy', 'mitsuba', 'drjit', 'torch', 'trimesh', 'pebble'} & set(sys.modules)))"
    )
    assert run(code).split() == []


def test_what_is_not_installed_is_told_with_the_command() -> None:
    code = (
        "import sys\nsys.modules['torch'] = None\nimport multilight\n"
        "try: multilight.MultiLightDataset\nexcept ImportError as error: print(error)"
    )
    assert run(code).strip() == "multilight.MultiLightDataset needs torch: pip install 'multilight[train]'"


def test_version() -> None:
    assert multilight.__version__ == importlib.metadata.version("multilight")


def test_a_script_without_a_guard_makes_a_dataset_once(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        f"import multilight\ndata = multilight.make('demo', scenes=1, **{SPHERES})\n"
        "print('made', len(data), data.record.config.views)\n"
        "again = multilight.make('demo', scenes=2, progress=False)\n"
        "print('grown to', len(again), again.record.config.width)\n"
    )
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, script.name], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.stdout.splitlines() == ["made 1 2", "grown to 2 64"], done.stderr


def test_one_scene_is_that_of_the_whole_dataset(data: multilight.Dataset, tmp_path: Path) -> None:
    one = multilight.make_scene(tmp_path / "one", 1, **SPHERES | {"views": 3})  # as in the fixture
    assert (one.index, one.views) == (1, 3)
    assert one.record == data[1].record
    assert "__main__" in sys.modules
    assert sys.modules["__main__"].__name__ == "__main__"


def test_dataset_is_a_sequence_of_scenes(data: multilight.Dataset) -> None:
    assert len(data) == 2
    assert [scene.index for scene in data] == [0, 1]
    assert data[-1].index == data.scene(1).index == 1
    assert data[np.int64(1)].index == 1  # type: ignore[index]
    assert data.record.renderer == "analytic"
    assert data.table.height == 2
    assert data.query("index = 1 and kind = 'spheres'")["index"].to_list() == [1]
    narrowed = multilight.open(data.address, where="index = 1", on_broken="skip")
    assert [scene.index for scene in narrowed] == [narrowed[0].index] == [1]
    assert narrowed.skipped == {}


def test_scene_says_what_can_be_mixed(scene: multilight.Scene) -> None:
    assert "all" in scene.conditions
    assert len(scene.objects) == 3
    view = scene.view(1)
    assert set(view.lights) == set(scene.lights)
    assert view.geometry.z_depth.shape == (48, 64)
    assert "spheres" in repr(scene)


def test_pictures_by_name_gains_seed_and_condition(scene: multilight.Scene) -> None:
    picture = scene.mix(view=0, condition="all")
    assert picture.shape == (48, 64, 3)
    assert picture.dtype == np.float32
    assert not np.array_equal(scene.mix(0, 7), scene.mix(0, 8))
    drawn = scene.condition(7)
    assert isinstance(drawn, multilight.LightingCondition)
    assert np.array_equal(scene.mix(0, 7), scene.mix(0, drawn))
    gains: dict[str, float | tuple[float, float, float]] = dict.fromkeys(scene.lights, 0.5)
    gains[scene.lights[0]] = (1.0, 0.5, 0.25)
    assert np.allclose(
        multilight.to_display(scene.mix(0, gains)).mean(), 110, atol=50
    )  # metered: neither dark nor white


def test_light_adds_up(scene: multilight.Scene) -> None:
    alone = sum(scene.mix(1, {name: 1.0}, exposure_ev=0) for name in scene.lights)
    together = scene.mix(1, dict.fromkeys(scene.lights, 1.0), exposure_ev=0)
    assert np.allclose(alone, together, rtol=1e-5)
    assert np.allclose(scene.mix(1, "all", exposure_ev=1), 2 * together, rtol=1e-5)


def test_tuple_of_arrays(scene: multilight.Scene) -> None:
    composite, background, depth, target, mask = scene.tuple(0, insert_condition=3)
    assert composite.shape == background.shape == target.shape == (48, 64, 3)
    assert depth.shape == mask.shape == (48, 64)
    outside, inside = mask == 0, mask == 1
    assert np.array_equal(composite[outside], background[outside])
    assert not np.allclose(composite[inside], target[inside])
    same = scene.tuple(0, scene.objects[0], condition=3, insert_condition=3)
    assert np.allclose(same.composite[inside], same.target[inside], rtol=1e-3)
    assert np.array_equal(same.background, scene.mix(0, 3, without=scene.objects[0]))


def test_display(scene: multilight.Scene) -> None:
    shown = multilight.to_display(scene.mix(0, "all"))
    assert shown.dtype == np.uint8
    assert 40 < shown.mean() < 220


def test_verify_finds_what_is_wrong(spheres_copy: Path) -> None:
    assert multilight.verify(spheres_copy) == []
    view = spheres_copy / "scenes" / "000001" / "views" / "00.exr"
    view.write_bytes(view.read_bytes()[:-100])
    (fault,) = multilight.verify(spheres_copy, quick=True)
    assert "00.exr is truncated" in fault.message
    repaired = multilight.make(spheres_copy, progress=False)
    assert len(repaired) == 2
    assert multilight.verify(spheres_copy, quick=True) == []


def test_training_dataset(data: multilight.Dataset) -> None:
    settings = multilight.SampleSettings(size=32, length=2, split=None, visible=1)
    sample = multilight.MultiLightDataset(data.address, settings)[1]
    assert tuple(sample["composite"].shape) == (3, 32, 32)


def test_harmonize(scene: multilight.Scene) -> None:
    example = scene.tuple(0, condition="all", insert_condition=3)
    composite, background = multilight.to_display(example.composite), multilight.to_display(example.background)
    found = multilight.harmonize(composite, background, example.mask, example.depth)
    assert found.shape == composite.shape
    assert found.dtype == np.uint8
    assert not np.array_equal(found, composite)
    floats = multilight.harmonize(composite / 255.0, background / 255.0, example.mask > 0.5)
    assert floats.dtype == np.float32
    assert 0 <= floats.min() <= floats.max() <= 1


BAD: dict[str, tuple[Callable[[multilight.Dataset, Path], object], str]] = {
    "scene": (lambda data, _: data[2], r"scene 2 is not in .*; it holds 2, counted from 0"),
    "scene by name": (lambda data, _: data["a"], "scene 'a' is not in"),  # type: ignore[index]
    "index": (lambda data, _: data.scene(7), r"no scene 7 in .*; it has \[0, 1\]"),
    "query": (
        lambda data, _: data.query("weight > 3"),
        "where 'weight > 3': .*`multilight query DIR --describe` lists the columns",
    ),
    "view": (lambda data, _: data[0].mix(3), "view 3 must be a whole number from 0 to 2"),
    "half a view": (lambda data, _: data[0].mix(0.5), "view 0.5 must be"),  # type: ignore[arg-type]
    "condition": (lambda data, _: data[0].mix(0, "noon"), r"condition 'noon' is not one of \['all'"),
    "seed": (lambda data, _: data[0].mix(0, -1), "whole number of at most 10 digits"),
    "truth": (lambda data, _: data[0].mix(0, True), "condition True is no lighting; give one of"),
    "light": (lambda data, _: data[0].mix(0, {"moon": 1.0}), r"names the lights \['moon'\]; scene 0 has \['key'"),
    "gain": (lambda data, _: data[0].mix(0, {"key": -1.0}), "gains.key.0 = -1.0: .*greater than or equal to 0"),
    "exposure": (lambda data, _: data[0].mix(exposure_ev=100), "exposure_ev = 100: .*less than or equal to 64"),
    "object": (lambda data, _: data[0].mix(without="cup"), r"'cup' is not insertable; choose one of \['sphere_0'"),
    "object of a tuple": (lambda data, _: data[0].tuple(0, "cup"), "'cup' is not insertable; choose one of"),
    "address": (lambda _, folder: multilight.open(folder), r"dataset\.json is missing: not a dataset"),
    "on_broken": (lambda _, folder: multilight.open(folder, on_broken="stop"), "must be 'raise' or 'skip'"),  # type: ignore[arg-type]
    "nothing to verify": (lambda _, folder: multilight.verify(folder), r"dataset\.json is missing"),
    "preset": (lambda _, out: multilight.make(out, preset="kitchen"), "preset 'kitchen': there are tabletop, room"),  # type: ignore[arg-type]
    "setting": (lambda _, out: multilight.make(out, lense=3), r"^unknown key 'lense'; did you mean 'cameras\.lens_mm'"),
    "value": (lambda _, out: multilight.make(out, scenes=0), "^scenes = 0: .*greater than or equal to 1"),
    "file": (lambda _, out: multilight.make(out, config=out / "no.toml"), r"no\.toml does not exist"),
    "workers": (lambda _, out: multilight.make(out, workers=0), "workers 0 must be a whole number from 1 up"),
    "number": (lambda _, out: multilight.make_scene(out, -1), "index -1 must be a whole number from 0 up"),
    "renderer": (lambda _, out: multilight.make(out, renderer="analytic"), "cannot render kind 'tabletop'"),
    "folder": (lambda _, out: multilight.make(out / "d", assets=out / "no", **SPHERES), "no is not a folder"),
}


@pytest.mark.parametrize("bad", BAD.values(), ids=BAD.keys())
def test_bad_values_are_told_in_one_line(
    bad: tuple[Callable[[multilight.Dataset, Path], object], str], data: multilight.Dataset, tmp_path: Path
) -> None:
    call, expected = bad
    with pytest.raises(multilight.UserError, match=expected) as raised:
        call(data, tmp_path)
    assert "\n" not in str(raised.value)


def broken_pictures() -> Iterator[tuple[str, dict[str, object]]]:
    yield r"composite has shape \(8, 8\); it must be \(H, W, 3\)", {"composite": np.zeros((8, 8))}
    yield r"background has shape \(4, 8, 3\), the composite \(8, 8, 3\)", {"background": np.zeros((4, 8, 3))}
    yield (
        r"composite runs from 255 to 255; it must be 8-bit, or lie in \[0, 1\]",
        {"composite": np.full((8, 8, 3), 255.0)},
    )
    yield r"mask has shape \(8, 8, 1\); it must be \(H, W\)", {"mask": np.ones((8, 8, 1))}
    yield "depth must be one finite, positive number a pixel", {"depth": np.zeros((8, 8))}


@pytest.mark.parametrize(("expected", "changed"), list(broken_pictures()))
def test_bad_pictures_are_told(expected: str, changed: dict[str, object]) -> None:
    fine = {"composite": np.zeros((8, 8, 3)), "background": np.zeros((8, 8, 3)), "mask": np.ones((8, 8))}
    with pytest.raises(multilight.UserError, match=expected):
        multilight.harmonize(**fine | changed)  # type: ignore[arg-type]


def test_failed_scenes_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from multilight import making
    from multilight.datagen.production.dataset import Outcome

    monkeypatch.setattr(
        making, "make_dataset", lambda plan, report: Outcome((0,), 0, {1: "out of luck"}, {"mine/a": "cut"}, {}, ())
    )
    with pytest.raises(multilight.UserError, match=re.escape("1 scenes failed, 1 were made; 1: out of luck")):
        multilight.make(tmp_path / "d", **SPHERES)
