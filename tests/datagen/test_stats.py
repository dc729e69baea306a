"""Statistics: coverage of known values, near-duplicates that are planted, leaks that are made, the page."""

import json
import re
from operator import methodcaller
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from multilight.datagen.cli import main
from multilight.datagen.report import silent
from multilight.datagen.stats.collect import measure_samples, summarize
from multilight.datagen.stats.duplicates import alike_in_content, alike_in_picture, picture_hash
from multilight.datagen.stats.facts import SceneFacts, scene_facts
from multilight.datagen.stats.pictures import colourfulness, dynamic_range
from multilight.datagen.stats.plots import bar_plot, direction_plot
from multilight.datagen.stats.quantities import (
    QUANTITIES,
    Coverage,
    Quantity,
    Value,
    coverage_of,
    evenness,
    filled_fraction,
)
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.store import read_dataset, read_scene, scene_dir
from multilight.datagen.verification.dataset import verify_dataset
from multilight.lights.spec import LightRig, SunLight
from multilight.scenes.appearance import material_class
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.spec import Material
from tests.conftest import SPHERES
from tests.datagen.chain import chain, rewrite_json

BY_KEY = {quantity.key: quantity for quantity in QUANTITIES}


@pytest.fixture(scope="module")
def library() -> AssetLibrary:
    return AssetLibrary(packs=("builtin",))


@pytest.fixture
def record(spheres_dataset: Path) -> SceneRecord:
    return read_scene(scene_dir(spheres_dataset, 0))


def test_known_counts_have_known_coverage() -> None:
    assert evenness([5, 5, 5, 5]) == pytest.approx(1.0)
    assert evenness([7, 0, 0]) == 0.0
    # Two of four bins, alike: ln 2 / ln 4.
    assert evenness([3, 3, 0, 0]) == pytest.approx(0.5)
    assert filled_fraction([3, 3, 0, 0]) == 0.5
    assert evenness([]) == filled_fraction([]) == 0.0


@given(values=st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=50))
def test_every_number_is_counted_even_beyond_the_bins(values: list[float]) -> None:
    for quantity in QUANTITIES:
        if quantity.edges:
            found = coverage_of(quantity, values)
            assert sum(found.counts) == len(values)
            assert len(found.labels) == len(found.counts) == len(quantity.edges) - 1
            assert 0 <= found.evenness <= 1 + 1e-9


def test_words_that_could_occur_are_counted_as_missing() -> None:
    found = coverage_of(BY_KEY["light_kind"], ["sun", "sun", "area", "laser"])
    assert dict(zip(found.labels, found.counts, strict=True)) == {
        "environment": 0, "sun": 2, "point": 0, "spot": 0, "area": 1, "emissive": 0, "laser": 1
    }  # fmt: skip
    assert found.filled == pytest.approx(3 / 7)


@pytest.mark.parametrize(
    ("values", "name"),
    [
        ({"metallic": 1, "roughness": 0.05}, "mirror"),
        ({"metallic": 1, "roughness": 0.4}, "metal"),
        ({"transmission": 1}, "glass"),
        ({"coat": 1}, "coated"),
        ({"roughness": 0.2}, "glossy"),
        ({"roughness": 0.5}, "satin"),
        ({"roughness": 0.9}, "matte"),
    ],
)
def test_material_classes(values: dict[str, float], name: str) -> None:
    assert material_class(Material(**values)) == name


def test_facts_of_a_known_scene(record: SceneRecord, library: AssetLibrary) -> None:
    angle = np.mean([np.arctan2(*camera.pose()[[1, 0], 3]) for camera in record.scene.cameras])
    sun = SunLight(
        name="sun",
        direction=(-float(np.cos(angle)), -float(np.sin(angle)), -1.0),
        irradiance=(1.0, 1.0, 1.0),
        angle=np.radians(0.5),
    )
    facts = scene_facts(record.scene, LightRig(lights=(sun,)), "val", library)
    values = facts.values
    assert (facts.index, facts.split, values["split"]) == (0, "val", ["val"])
    assert values["lights"] == [1.0]
    assert values["elevation"] == pytest.approx([45.0])
    assert values["azimuth"] == pytest.approx([0.0], abs=15)
    assert values["angular_size"] == pytest.approx([0.5], rel=0.01)
    assert "contrast" not in values  # one light has nothing to be compared with
    radii = [body.geometry.radius for body in record.scene.bodies if body.role == "object"]
    assert values["size"] == pytest.approx([2 * radius for radius in radii], rel=0.02)
    assert values["lens"] == pytest.approx([18 / np.tan(np.radians(18))] * len(record.scene.cameras))
    assert all(0 <= float(hidden) <= 1 for hidden in values["occlusion"])
    assert min(map(float, values["depth_range"])) >= 1
    eyes = [camera.pose()[:3, 3] for camera in record.scene.cameras]
    middle = np.mean([np.array(b.world_from_body)[:3, 3] for b in record.scene.bodies if b.insertable], axis=0)
    assert values["distance"] == pytest.approx([np.linalg.norm(eye - middle) for eye in eyes], rel=0.03)


def test_the_same_scene_twice_is_a_near_duplicate(record: SceneRecord, library: AssetLibrary) -> None:
    first = scene_facts(record.scene, record.rig, "train", library)
    moved = record.scene.model_copy(update={"index": 7, "cameras": record.scene.cameras[::-1]})
    again = scene_facts(moved, record.rig, "train", library)
    found = summarize("t", [first, again], []).duplicates
    assert [(pair.first, pair.second, pair.by, pair.distance) for pair in found] == [(0, 7, "content", 0.0)]


def test_planted_content_duplicates_are_found_among_many() -> None:
    rng = np.random.default_rng(0)
    scenes = [frozenset(f"mug {n}" for n in rng.choice(400, 12, replace=False)) for _ in range(60)]
    scenes[41] = frozenset(sorted(scenes[3])[:11] + ["new"])
    found = alike_in_content(range(100, 160), scenes)
    assert [(pair.first, pair.second) for pair in found] == [(103, 141)]
    assert found[0].distance == pytest.approx(1 - 11 / 13, abs=1e-3)
    assert alike_in_content([0], scenes[:1]) == []


def test_planted_picture_duplicates_are_found() -> None:
    rng = np.random.default_rng(1)

    def picture() -> np.ndarray:
        return np.asarray(Image.fromarray(rng.integers(0, 255, (6, 24, 3), dtype=np.uint8)).resize((512, 128)))

    pictures = [picture() for _ in range(12)]
    # Brighter, noisier, and a little out of place.
    pictures[9] = np.clip(np.roll(pictures[2], 1, axis=1) * 1.1 + rng.normal(0, 3, (128, 512, 3)), 0, 255).astype("u1")
    found = alike_in_picture(range(12), [picture_hash(Image.fromarray(p)) for p in pictures])
    assert [(pair.first, pair.second) for pair in found] == [(2, 9)]


def test_leaks_between_splits_are_told() -> None:
    def facts(index: int, split: str, *owned: str) -> SceneFacts:
        return SceneFacts(index, split, {}, frozenset(owned), frozenset({str(index)}))  # type: ignore[arg-type]

    clean = [facts(0, "train", "a", "b"), facts(1, "train", "b"), facts(2, "test", "c"), facts(3, "test_ood", "d")]
    assert summarize("t", clean, []).leaks == ()
    clean.append(facts(4, "val", "place venice_sunset", "b"))
    clean.append(facts(5, "test", "place venice_sunset"))
    assert [(leak.what, leak.splits) for leak in summarize("t", clean, []).leaks] == [
        ("b", ("train", "val")),
        ("place venice_sunset", ("val", "test")),
    ]


def test_picture_measures_of_known_pictures() -> None:
    assert colourfulness(np.full((4, 4, 3), 128.0)) == 0
    stripes = np.zeros((4, 4, 3))
    stripes[:, ::2, 0] = stripes[:, 1::2, 2] = 255
    # rg = 255, 0 and yb = 127.5, -255: deviations 127.5 and 191.25, means 127.5 and -63.75.
    expected = np.hypot(127.5, 191.25) + 0.3 * np.hypot(127.5, 63.75)
    assert colourfulness(stripes) == pytest.approx(expected)
    ramp = np.repeat(np.repeat([[0.25], [4.0]], 50, axis=0)[..., None], 3, axis=2)
    assert dynamic_range(ramp) == pytest.approx(4.0)
    assert dynamic_range(np.zeros((4, 4, 3))) == pytest.approx(0.0)


@pytest.mark.parametrize("quantity", QUANTITIES, ids=lambda quantity: quantity.key)
def test_every_quantity_can_be_plotted(quantity: Quantity) -> None:
    values: list[Value] = ["a", "b", "b"] if quantity.edges is None else [quantity.edges[0], quantity.edges[-1]]
    svg = bar_plot(quantity, coverage_of(quantity, values))
    assert svg.count("<svg") == 1
    assert svg == bar_plot(quantity, coverage_of(quantity, values))


def test_many_words_are_summed_up() -> None:
    def plot(words: int) -> str:
        return bar_plot(BY_KEY["category"], Coverage(tuple(f"w{i}" for i in range(words)), (1,) * words, 1.0, 1.0))

    assert len(plot(900)) < 1.1 * len(plot(60))


def test_directions_fill_the_sphere_evenly() -> None:
    rng = np.random.default_rng(0)
    towards = rng.normal(size=(20_000, 3))
    azimuth = np.degrees(np.arctan2(towards[:, 1], towards[:, 0]))
    elevation = np.degrees(np.arcsin(towards[:, 2] / np.linalg.norm(towards, axis=1)))
    assert direction_plot(list(azimuth), list(elevation))[1] == 1.0
    assert direction_plot([0.0], [45.0])[1] == pytest.approx(1 / (24 * 8))


def test_stats_of_a_dataset(spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stats", str(spheres_dataset), "--out", str(tmp_path / "s")]) == 0
    shown = capsys.readouterr().out
    assert "light_kind" in shown
    assert "0 models or places cross splits" in shown
    found = json.loads((tmp_path / "s" / "stats.json").read_text())
    assert found["scenes"] == 2
    keys = {entry["key"]: entry for entry in found["quantities"]}
    assert keys["kind"]["labels"] == ["spheres"]
    assert keys["luminance"]["values"] == 2 * 3
    assert sum(keys["lens"]["counts"]) == 2 * 3
    page = (tmp_path / "s" / "index.html").read_text()
    assert page.count("<img") == len(keys) + 1
    assert not re.search(r"(src|href)=.(?!data:)", page)  # nothing is fetched from elsewhere
    assert page.count("<div") == page.count("</div>")


def test_stats_from_specifications_alone(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "c.toml"
    path.write_text('kind = "spheres"\nviews = 2\nwidth = 32\nheight = 32\n')
    words = ["stats", "--sample", "5", "--config", str(path), "--out", str(tmp_path / "s")]
    assert main(words) == 0
    assert "5 sampled scenes" in capsys.readouterr().out
    found = json.loads((tmp_path / "s" / "stats.json").read_text())
    assert {entry["key"] for entry in found["quantities"]} >= {"kind", "split", "azimuth", "occlusion"}
    assert "luminance" not in {entry["key"] for entry in found["quantities"]}


@pytest.mark.parametrize("words", [[], ["--sample", "0"], ["DIR"]])
def test_stats_says_what_it_needs(words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stats", *(str(tmp_path) if word == "DIR" else word for word in words)]) == 1
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert "stats DIR" in line or "--sample 0" in line or "not a dataset" in line


def test_samples_are_those_of_the_dataset(spheres_dataset: Path) -> None:
    from multilight.datagen.config.dataset import load_config

    options = dict(zip([w[2:] for w in SPHERES[::2]], SPHERES[1::2], strict=True))
    config = load_config(None, {k: int(v) if v.isdigit() else v for k, v in options.items()})
    library = AssetLibrary()
    sampled = measure_samples(config, 2, library, silent)
    stored = [read_scene(scene_dir(spheres_dataset, i)) for i in range(2)]
    facts = [scene_facts(r.scene, r.rig, r.split, library) for r in stored]
    assert sampled.values == summarize("t", facts, []).values


def test_a_sample_of_a_dataset(spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["stats", str(spheres_dataset), "--out", str(tmp_path)]
    assert main([*words, "--sample", "1"]) == 0
    assert "dataset: 1 of 2 scenes" in capsys.readouterr().out
    assert main(words) == 0
    assert "dataset: 2 scenes" in capsys.readouterr().out


def test_what_was_thrown_away_is_told(spheres_copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    reasons = ["contacts: nothing carries cup", "exposure: view 1: black"]
    for index, why in enumerate((reasons, reasons[:1])):
        path = spheres_copy / f"scenes/{index:06d}/scene.json"
        rewrite_json(path, methodcaller("update", {"thrown_away": why, "attempt": len(why)}))
    chain(spheres_copy)
    assert read_dataset(spheres_copy).thrown_away == {"contacts": 2, "exposure": 1}
    assert verify_dataset(str(spheres_copy), quick=True).results[0][1] == []
    assert main(["stats", str(spheres_copy), "--out", str(tmp_path)]) == 0
    assert "3 draws failed a check and were drawn anew: contacts 2, exposure 1" in capsys.readouterr().out
    rewrite_json(spheres_copy / "dataset.json", lambda record: record.update(thrown_away={"contacts": 1}))
    assert "counts other draws" in verify_dataset(str(spheres_copy), quick=True).results[0][1][0].message
