"""The evaluation: the same tuples every time, subsets, consistency between views, tables and pages."""

import json
import mmap
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from multilight.datagen.cli import main
from multilight.datagen.errors import UserError
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.store import read_scene, scene_dir
from multilight.lights.display.tonemap import tone_curve
from multilight.lights.sample_conditions import WHITE
from multilight.lights.spec import AreaLight, EmissiveLight, Light, LightRig, PointLight, SunLight
from multilight.model.cli import COMMANDS
from multilight.model.commands.evaluate import named
from multilight.model.configs.stage2d import NetworkConfig
from multilight.model.evaluation.cases import Group, LazyGroup, dataset_groups, subsets_of
from multilight.model.evaluation.consistency import disagreement, sample, shared_pairs, shared_pixels
from multilight.model.evaluation.page import Table
from multilight.model.evaluation.run import evaluate, methods_of, peak_memory
from multilight.model.evaluation.settings import CaseSettings
from multilight.model.networks.checkpoint import save_network
from multilight.model.networks.compositing2d import Compositing2D
from multilight.scenes.cameras.pinhole import camera_from_fov, look_at, project, unproject
from multilight.scenes.colour import srgb_encode
from multilight.scenes.spec import Camera
from tests.browsing import AXE, barriers, swipe

SETTINGS = CaseSettings(splits=("train", "val", "test", "test_ood"), groups=2, size=64)


@pytest.fixture(scope="module")
def groups(spheres_dataset: Path) -> list[Group]:
    return [load() for load in dataset_groups(spheres_dataset, SETTINGS)]


@pytest.fixture(scope="module")
def record(spheres_dataset: Path) -> SceneRecord:
    return read_scene(scene_dir(spheres_dataset, 0))


def test_tuples_are_the_same_every_time(spheres_dataset: Path, groups: list[Group]) -> None:
    again = [load() for load in dataset_groups(spheres_dataset, SETTINGS)]
    other = dataset_groups(spheres_dataset, CaseSettings(SETTINGS.splits, 2, seed=1, size=64))[0]()
    assert [c.name for g in again for c in g.cases] == [c.name for g in groups for c in g.cases]
    for first, second in zip(groups, again, strict=True):
        assert first.subsets == second.subsets
        for a, b in zip(first.cases, second.cases, strict=True):
            np.testing.assert_array_equal(a.composite, b.composite)
    assert not np.array_equal(other.cases[0].composite, groups[0].cases[0].composite)


def test_as_many_views_as_asked_show_an_object(spheres_dataset: Path) -> None:
    for views in (1, 2):
        settings = CaseSettings(SETTINGS.splits, 1, views=views, size=64)
        assert all(len(load().cases) == views for load in dataset_groups(spheres_dataset, settings))


def test_cases_hold_their_identities(groups: list[Group]) -> None:
    for case in (case for group in groups for case in group.cases):
        assert case.target is not None
        assert case.effect is not None
        np.testing.assert_allclose(case.target - case.background, case.effect, atol=1e-6)
        outside = case.mask == 0
        np.testing.assert_allclose(case.composite[outside], case.background[outside], atol=1e-6)
        assert case.mask.sum() >= 30


def test_a_split_without_scenes_is_told(spheres_dataset: Path) -> None:
    with pytest.raises(UserError, match="--splits"):
        dataset_groups(spheres_dataset, CaseSettings(splits=("test_ood",)))


def test_light_fractions_are_those_of_the_target(spheres_dataset: Path) -> None:
    """The gains that the subsets are judged by must be those that lit the target."""
    from multilight.datagen.storage.open_training import open_training
    from multilight.model.data.dataset import MultiLightDataset
    from multilight.model.data.lighting import light_fractions, lit_conditions
    from multilight.model.data.settings import SampleSettings

    settings = SampleSettings(size=48, split=None, length=1, views=2, augment=False)
    samples = MultiLightDataset(spheres_dataset, settings)
    draw = samples.plan.draw(0, 0)
    source = open_training(spheres_dataset)
    views = [source.view(draw.place.scene, number) for number in draw.views]
    temperature = samples.lights(draw.place.scene, views[0].lights).temperature[: len(views[0].lights)]
    _, base = lit_conditions(draw.rng, views, 2, temperature, wild=False)
    lit = np.einsum("lhwc,lc->hwc", views[0].variant("all").astype(np.float32), base)
    shown = srgb_encode(tone_curve(lit))[:, 8:-8]
    np.testing.assert_allclose(samples[0]["target"][0].numpy().transpose(1, 2, 0), shown, atol=2e-3)
    fractions = light_fractions(views, base)
    assert fractions.sum() == pytest.approx(1.0)
    assert ((fractions == 0) == ~base.any(axis=1)).all()
    assert samples[0]["light_fraction"][0, : len(base)].tolist() == pytest.approx(fractions.tolist())


def with_rig(record: SceneRecord, *lights: Light) -> SceneRecord:
    return record.model_copy(update={"rig": LightRig(lights=lights)})


def test_subsets(record: SceneRecord) -> None:
    name = record.scene.insertable[0]
    sun = SunLight(name="sun", direction=(0, 0, -1), irradiance=WHITE, angle=0.01)
    panel = AreaLight(name="panel", width=2, height=2, world_from_light=np.eye(4).tolist(), radiance=WHITE)
    glow = EmissiveLight(name="glow", body=name, radiance=WHITE)
    lit = with_rig(record, sun, panel, glow)
    kind = f"kind: {record.scene.kind}"
    assert subsets_of(lit, name, {"sun": 0.8, "panel": 0.2, "glow": 0.0}) == (kind, "hard shadow")
    assert subsets_of(lit, name, {"sun": 0.3, "panel": 0.7, "glow": 0.0}) == (kind,)
    assert subsets_of(lit, name, {"sun": 0.1, "panel": 0.6, "glow": 0.3}) == (kind, "emissive")
    bulb = PointLight(name="sun", position=(0, 0, 1.5), intensity=WHITE, radius=0.5)
    assert "hard shadow" not in subsets_of(with_rig(record, bulb), name, {"sun": 1.0})
    body = record.scene.body(name)
    polished = tuple(m.model_copy(update={"metallic": 1.0, "roughness": 0.05}) for m in body.materials)
    bodies = tuple(b.model_copy(update={"materials": polished}) if b.name == name else b for b in record.scene.bodies)
    shiny = record.model_copy(update={"scene": record.scene.model_copy(update={"bodies": bodies})})
    assert "mirror" in subsets_of(shiny, name, dict.fromkeys(record.rig.names, 0.1))


def plane_views() -> tuple[list[Camera], list[np.ndarray], list[np.ndarray]]:
    """Two cameras over the plane z = 0, whose colour is a smooth function of the place: exact depth and pictures."""
    cameras = [
        camera_from_fov(look_at(eye, (0.1, 0, 0)), width=48, height=40, fov=0.7)
        for eye in ((1.0, -1.2, 1.5), (-0.6, -1.4, 1.6))
    ]
    depths, pictures = [], []
    for camera in cameras:
        one = unproject(camera, np.ones((40, 48)))
        eye = camera.pose()[:3, 3]
        depth = -eye[2] / (one - eye)[..., 2]
        points = unproject(camera, depth)
        depths.append(depth.astype(np.float32))
        colour = 0.5 + 0.2 * np.stack([np.sin(2 * points[..., 0]), np.cos(3 * points[..., 1]), points[..., 0]], -1)
        pictures.append(colour.astype(np.float32))
    return cameras, depths, pictures


def test_a_matt_plane_is_consistent() -> None:
    cameras, depths, pictures = plane_views()
    pairs = shared_pairs(cameras, depths, [np.ones((40, 48), bool)] * 2)
    assert [(pair.first, pair.second) for pair in pairs] == [(0, 1), (1, 0)]
    assert disagreement(pictures, pairs) < 1e-3
    assert disagreement([pictures[0], pictures[1] + 0.1], pairs) == pytest.approx(0.1, abs=2e-3)


def test_only_the_region_is_compared() -> None:
    cameras, depths, pictures = plane_views()
    regions = [np.zeros((40, 48), bool) for _ in range(2)]
    regions[0][:, :30] = True
    (pair,) = shared_pairs(cameras, depths, regions)
    wrong = pictures[0].copy()
    wrong[:, 30:] = 9.0
    assert disagreement([wrong, pictures[1]], [pair]) < 1e-3


def test_hidden_points_are_not_compared() -> None:
    cameras, depths, _ = plane_views()
    seen, pixels = shared_pixels(cameras[0], depths[0], cameras[1], depths[1])
    assert seen.mean() > 0.2
    there, _ = project(cameras[1], unproject(cameras[0], depths[0])[seen])
    np.testing.assert_allclose(there, pixels)
    nearer = depths[1] * 0.9  # something stands before everything that b sees
    assert not shared_pixels(cameras[0], depths[0], cameras[1], nearer.astype(np.float32))[0].any()


def test_too_few_shared_pixels_say_nothing() -> None:
    cameras, depths, pictures = plane_views()
    pairs = shared_pairs(cameras, depths, [np.zeros((40, 48), bool)] * 2)
    assert np.isnan(disagreement(pictures, pairs))


def test_lookup_is_bilinear() -> None:
    picture = np.zeros((2, 2, 3), np.float32)
    picture[0, 1] = 1.0
    np.testing.assert_allclose(sample(picture, np.array([[1.0, 0.5], [1.5, 0.5]])), [[0.5] * 3, [1.0] * 3])


def given(group: Group) -> LazyGroup:
    return lambda: group


def test_a_perfect_model_wins_everywhere(groups: list[Group]) -> None:
    targets = {case.composite.tobytes(): case.target for group in groups for case in group.cases}
    models = {
        "perfect": lambda composite, background, depth, mask: targets[composite.tobytes()],
        "dull": lambda composite, background, depth, mask: background,
    }
    found = evaluate([given(group) for group in groups], methods_of(models))
    both = "object and effect"
    assert found.means("perfect")[both]["PSNR"] == 60.0
    for method in found.methods[:-2] + ("dull",):
        assert found.means(method)[both]["PSNR"] < 45
        assert found.means(method)[both]["FLIP"] > found.means("perfect")[both]["FLIP"]
    assert found.inconsistency("perfect")[1] == pytest.approx(1.0)
    assert found.inconsistency("dull")[0] >= 0
    assert len(found.worst) == min(10, len(found.frames))
    order = [shown.scores["dull"][both]["PSNR"] for shown in found.worst]
    assert order == sorted(order)
    assert order[0] == min(frame.scores["dull"][both]["PSNR"] for frame in found.frames)
    assert found.subsets[0] in SETTINGS.splits or found.subsets[0].startswith("kind")


def test_peak_memory_is_measured() -> None:
    with peak_memory() as memory:
        pages = mmap.mmap(-1, 80 << 20)  # new ones: what tests before this one have freed counts as taken
        pages.write(bytes(80 << 20))
    pages.close()
    assert 60 < memory.megabytes < 400


def test_the_best_of_a_column_is_set_off() -> None:
    rows = {"a": (20.004, float("nan"), 1.0), "b": (20.0, 2.0, 0.5), "c": (19.0, 3.0, 2.0)}
    table = Table("t", "", ("x", "y", "z"), rows, (2, 0, 1), (True, False, None))
    assert table.cells("a") == [("20.00", True), ("–", False), ("1.0", False)]
    assert table.cells("b") == [("20.00", True), ("2", True), ("0.5", False)]
    assert table.cells("c") == [("19.00", False), ("3", False), ("2.0", False)]


@pytest.fixture(scope="module")
def evaluated(spheres_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the command writes of an untrained network, which returns the composite."""
    folder = tmp_path_factory.mktemp("evaluated")
    config = NetworkConfig(body="attention", head="light", width=16, groups=1, blocks=2, heads=2, window=4, pooled=2)
    save_network(folder / "tiny.safetensors", Compositing2D(config), config, {})
    words = ["evaluate", str(spheres_dataset), "--weights", str(folder / "tiny.safetensors"), "--groups", "2"]
    words += ["--size", "48", "--splits", "train", "val", "test", "--out", str(folder / "out")]
    assert main(words, COMMANDS) == 0
    return folder / "out"


def test_command_writes_tables_and_pictures(evaluated: Path) -> None:
    page = (evaluated / "index.html").read_text()
    assert not re.search(r'(src|href)="(?!data:)', page), "the page is self-contained"
    assert page.count("data:image/jpeg") > 12
    found = json.loads((evaluated / "evaluation.json").read_text())
    together = ["tiny, averaged over views", "tiny, one set of lights"]
    assert list(found["methods"]) == ["raw composite", "colour transfer", "histogram", "Poisson", "tiny", *together]
    untrained, raw = (found["methods"][name]["all"]["image"]["PSNR"] for name in ("tiny", "raw composite"))
    assert untrained == pytest.approx(raw, abs=0.05)
    assert all(set(frame["scores"]) == set(found["methods"]) for frame in found["frames"])
    table = (evaluated / "table.md").read_text()
    assert f"| raw composite | {raw:.2f}" in table or f"| raw composite | **{raw:.2f}**" in table


def test_models_of_equal_file_names_are_told_apart_by_folder() -> None:
    paths = [Path("runs/few/model.safetensors"), Path("runs/many/model.safetensors"), Path("slim")]
    assert named(paths) == dict(zip(("few/model", "many/model", "slim"), paths, strict=True))


def test_the_divider_follows_mouse_finger_and_keys(browser: Any, evaluated: Path) -> None:
    for scheme, width in (("dark", 1280), ("light", 390)):
        view = {"width": width, "height": 844}
        page = browser.new_page(viewport=view, color_scheme=scheme, has_touch=True)
        complaints: list[str] = []
        page.on("console", lambda said, complaints=complaints: complaints.append(said.text))
        page.on("pageerror", lambda error, complaints=complaints: complaints.append(str(error)))
        page.goto((evaluated / "index.html").as_uri())
        page.get_by_role("combobox", name="Left").select_option("target")
        compare = page.locator(".compare").first
        compare.scroll_into_view_if_needed()
        box = compare.bounding_box()
        place = [(box["x"] + share * box["width"], box["y"] + 40) for share in (0.5, 0.8, 0.3)]
        page.mouse.move(*place[0])
        page.mouse.down()
        page.mouse.move(*place[1], steps=3)
        page.mouse.up()
        assert divided(compare) == pytest.approx(80, abs=1)
        page.keyboard.press("ArrowLeft")
        assert divided(compare) == pytest.approx(79, abs=1)
        swipe(page, place[1], place[2])
        assert divided(compare) == pytest.approx(30, abs=2)
        first = page.locator(".case").first
        sources = [image.get_attribute("src") for image in compare.locator("img").all()]
        assert sources == [
            first.locator(f"figure[data-name='{name}'] img").get_attribute("src")
            for name in ("target", "tiny, one set of lights")
        ]
        assert (
            compare.get_by_role("slider")
            .get_attribute("aria-label")
            .endswith("target on the left, tiny, one set of lights on the right")
        )
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert not AXE.exists() or barriers(page) == []
        assert not complaints
        page.close()


def divided(compare: Any) -> float:
    """Return where the picture on the right begins, in percent of the width."""
    clip = compare.evaluate("compare => getComputedStyle(compare.children[1]).clipPath")
    return float(clip.removeprefix("inset(0px 0px 0px ").removesuffix("%)"))


def test_command_asks_for_data(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", "--out", str(tmp_path / "out")], COMMANDS) == 1
    assert "say what to evaluate on" in capsys.readouterr().err


def test_missing_ready_made_weights_say_how_to_train(
    spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["evaluate", str(spheres_dataset), "--splits", "train", "val", "test"]
    words += ["--out", str(tmp_path), "--weights", str(tmp_path / "none.safetensors")]
    assert main(words, COMMANDS) == 1
    assert "multilight train" in capsys.readouterr().err
