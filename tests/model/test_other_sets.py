"""Readers of other people's evaluation sets, on small folders in their exact layouts."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from multilight.datagen.errors import UserError
from multilight.model.evaluation.baselines import lab_from_srgb
from multilight.model.evaluation.cases import Case
from multilight.model.evaluation.foscom import difference_mask, foscom_groups
from multilight.model.evaluation.objects_with_lighting import camera_centre, owl_groups
from multilight.model.evaluation.run import evaluate, fitted_exposure, methods_of

HEIGHT, WIDTH = 36, 48


def save(path: Path, picture: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.rint(np.clip(picture, 0, 1) * 255).astype(np.uint8)).save(path)


def block() -> np.ndarray:
    mask = np.zeros((HEIGHT, WIDTH), np.float32)
    mask[10:26, 16:32] = 1.0
    return mask


def scene(tint: tuple[float, float, float]) -> np.ndarray:
    """A textured wall with a lit block before it, as linear light."""
    rng = np.random.default_rng(0)
    wall = np.broadcast_to([0.2, 0.25, 0.3], (HEIGHT, WIDTH, 3)) * rng.uniform(0.8, 1.2, (HEIGHT, WIDTH, 1))
    thing = rng.uniform(0.1, 0.5, (HEIGHT, WIDTH, 1)) * np.array(tint)
    return np.where(block()[..., None] > 0, thing, wall)


def tonemapped(linear: np.ndarray, ev: float) -> np.ndarray:
    return np.clip(linear * 2.0**ev, 0, 1) ** (1 / 2.2)


@pytest.fixture
def owl(tmp_path: Path) -> Path:
    """One object, two true pictures from two sides, three input pictures in another environment."""
    folder = tmp_path / "dataset" / "teapot" / "test"
    inputs = folder / "inputs"
    for number, angle in enumerate((0.0, 120.0, 240.0)):
        tint = ((2.0, 1.0, 0.5), (1.0, 1.0, 1.0), (0.5, 1.0, 2.0))[number]
        save(inputs / f"image_{number:04d}.png", tonemapped(scene(tint), -1.5))
        save(inputs / f"mask_{number:04d}.png", block())
        camera(inputs / f"camera_{number:04d}.txt", angle)
    (inputs / "exposure.txt").write_text("-1.5\n")
    (inputs / "object_bounding_box.txt").write_text("-0.1 0.1 -0.1 0.1 0 0.2\n")
    for number, angle in enumerate((10.0, 230.0)):
        save(folder / f"gt_image_{number:04d}.png", tonemapped(scene((0.8, 1.0, 0.9)), -0.5))
        save(folder / f"gt_mask_{number:04d}.png", block())
        camera(folder / f"gt_camera_{number:04d}.txt", angle)
        (folder / f"gt_exposure_{number:04d}.txt").write_text("-0.5\n")
    return tmp_path


def camera(path: Path, degrees: float) -> None:
    """Write a camera on a circle round the object, looking at its centre (0, 0, 0.1), in OpenCV's axes."""
    angle = np.radians(degrees)
    eye = np.array([np.cos(angle), np.sin(angle), 0.1])
    forward = np.array([-np.cos(angle), -np.sin(angle), 0.0])
    right = np.cross(forward, [0.0, 0.0, 1.0])
    rotation = np.stack([right, np.cross(forward, right), forward])
    intrinsics = np.array([[50.0, 0, WIDTH / 2], [0, 50.0, HEIGHT / 2], [0, 0, 1]])
    rows = np.vstack([intrinsics, rotation, -rotation @ eye, [WIDTH, HEIGHT, 3]])
    np.savetxt(path, rows)


def test_owl_cameras_stand_where_they_were_put(owl: Path) -> None:
    found = camera_centre(owl / "dataset" / "teapot" / "test" / "inputs" / "camera_0001.txt")
    np.testing.assert_allclose(found, [np.cos(2 * np.pi / 3), np.sin(2 * np.pi / 3), 0.1], atol=1e-6)


def test_owl_takes_the_colours_of_the_nearest_input_picture(owl: Path) -> None:
    first, second = (load().cases[0] for load in owl_groups(owl, None))
    inside = block() > 0
    for case, tint in ((first, (2.0, 1.0, 0.5)), (second, (0.5, 1.0, 2.0))):
        wanted = lab_from_srgb(tonemapped(scene(tint), -0.5))[inside]  # as if exposed like the true picture
        found = lab_from_srgb(case.composite)[inside]
        np.testing.assert_allclose(found.mean(axis=0), wanted.mean(axis=0), atol=1.5)
        assert case.target is not None
        np.testing.assert_array_equal(case.composite[~inside], case.target[~inside])


def test_owl_background_does_not_give_the_truth_away(owl: Path) -> None:
    case = owl_groups(owl, None)[0]().cases[0]
    inside = block() > 0
    assert case.target is not None
    np.testing.assert_array_equal(case.background[~inside], case.target[~inside])
    ring = case.target[8:28, 14:34][block()[8:28, 14:34] == 0]
    assert case.background[inside].min() >= ring.min()
    assert case.background[inside].max() <= ring.max(), "a harmonic filling has its extremes on the outline"


def test_owl_exposure_is_fitted_in_linear_light(owl: Path) -> None:
    case = owl_groups(owl, None)[0]().cases[0]
    assert case.target is not None
    darker = (case.target**2.2 * 2.0**-1.5) ** np.float32(1 / 2.2)
    np.testing.assert_allclose(fitted_exposure(darker, case), case.target, atol=1e-4)


def test_exposure_fit_is_least_squares() -> None:
    rng = np.random.default_rng(1)
    target = rng.uniform(0.2, 0.9, (8, 8, 3)).astype(np.float32)
    picture = rng.uniform(0.2, 0.9, (8, 8, 3)).astype(np.float32)
    ones = np.ones((8, 8), np.float32)
    case = Case("x", picture, picture, ones, ones, target=target, fit_exposure=True)

    def error(factor: float) -> float:
        return float(np.square(picture.astype(float) ** 2.2 * factor - target.astype(float) ** 2.2).sum())

    factor = float(np.median(fitted_exposure(picture, case) ** 2.2 / picture**2.2))
    assert error(factor) < min(error(factor * 0.99), error(factor * 1.01))


def test_owl_is_judged_on_valid_pixels_only(owl: Path) -> None:
    found = evaluate(owl_groups(owl, None), methods_of({}))
    assert len(found.frames) == 2
    assert found.subsets == ("OWL",)
    for frame in found.frames:
        assert set(frame.scores["raw composite"]) == {"image", "object", "object and effect"}
        assert frame.scores["raw composite"]["image"] == frame.scores["raw composite"]["object"]
        assert frame.scores["raw composite"]["object"]["PSNR"] < 40


def test_prepared_owl(tmp_path: Path) -> None:
    truth, composite = scene((1, 1, 1)), scene((2, 1, 0.5))
    save(tmp_path / "scene_00000" / "image.png", tonemapped(composite, 1))
    save(tmp_path / "scene_00000" / "gt.png", tonemapped(truth, 1))
    paths = {"image_path": "scene_00000/image.png", "gt_path": "scene_00000/gt.png"}
    (tmp_path / "scene_00000" / "transforms.json").write_text(json.dumps(paths))
    case = owl_groups(tmp_path, None)[0]().cases[0]
    assert case.name == "scene_00000"
    assert case.fit_exposure
    assert np.count_nonzero((case.mask > 0.5) != (block() > 0)) < 20
    assert case.target is not None
    assert np.abs(case.background - case.target)[15:20, 20:28].mean() > 0.05


@pytest.mark.parametrize("box", ["text", "picture"])
def test_published_foscom(tmp_path: Path, box: str) -> None:
    background = np.full((HEIGHT, WIDTH, 3), 0.2)
    foreground = np.zeros((20, 20, 3))
    foreground[:, :10] = (0.8, 0.1, 0.1)
    own = np.zeros((20, 20))
    own[:, :10] = 1.0
    save(tmp_path / "background" / "000000330273.png", background)
    save(tmp_path / "foreground" / "000000330273.png", foreground)
    save(tmp_path / "foreground_mask" / "000000330273.png", own)
    if box == "text":
        (tmp_path / "bbox").mkdir()
        (tmp_path / "bbox" / "000000330273.txt").write_text("8 4 28 24 000000330273_GT.png\n")
    else:
        marked = np.zeros((HEIGHT, WIDTH))
        marked[4:24, 8:28] = 1.0
        save(tmp_path / "mask_bbox" / "000000330273.png", marked)
    case = foscom_groups(tmp_path, None)[0]().cases[0]
    wanted = np.zeros((HEIGHT, WIDTH), np.float32)
    wanted[4:24, 8:18] = 1.0
    np.testing.assert_allclose(case.mask, wanted, atol=1e-6)
    np.testing.assert_allclose(case.composite[wanted > 0], [[0.8, 0.1, 0.1]] * 200, atol=1 / 255)
    np.testing.assert_array_equal(case.composite[wanted == 0], case.background[wanted == 0])
    assert case.target is None


def test_prepared_foscom_has_pictures_only(tmp_path: Path) -> None:
    save(tmp_path / "scene_00003" / "c.png", tonemapped(scene((2, 1, 0.5)), 1))
    save(tmp_path / "scene_00003" / "b.png", tonemapped(scene((0, 0, 0)), 1))
    paths = {"image_path": "scene_00003/c.png", "bg_path": "scene_00003/b.png"}
    (tmp_path / "scene_00003" / "transforms.json").write_text(json.dumps(paths))
    found = evaluate(foscom_groups(tmp_path, None), methods_of({}))
    assert found.frames[0].scores == {}
    assert len(found.examples) == 1
    np.testing.assert_array_equal(found.examples[0].case.mask, block())


def test_difference_mask_fills_holes() -> None:
    background = np.full((HEIGHT, WIDTH, 3), 0.5, np.float32)
    composite = np.where(block()[..., None] > 0, np.float32(0.9), background)
    composite[15:18, 20:24] = 0.5
    np.testing.assert_array_equal(difference_mask(composite, background), block())


@pytest.mark.parametrize("reader", [owl_groups, foscom_groups])
def test_other_folders_are_refused(reader: object, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="is not"):
        reader(tmp_path, None)  # type: ignore[operator]


def test_missing_parts_are_named(owl: Path) -> None:
    (owl / "dataset" / "teapot" / "test" / "inputs" / "mask_0000.png").unlink()
    with pytest.raises(UserError, match=r"mask_0000\.png does not exist"):
        owl_groups(owl, None)[0]()
    (owl / "dataset" / "teapot" / "test" / "gt_camera_0001.txt").write_text("1 2 3\n")
    with pytest.raises(UserError, match="8 rows of 3"):
        owl_groups(owl, None)[1]()
