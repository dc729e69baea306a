"""Simulated faults of users' inputs: each changes what it says, by as much as it says, and nothing else."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from multilight.datagen.errors import UserError
from multilight.model.configs.stage2d import FAULTS, Fault
from multilight.model.data import MultiLightDataset, SampleSettings
from multilight.model.data.faults import HOLES, NOISE, STEP, draw_placement, wrong_depth
from multilight.model.evaluation.cases import RIGHTLY, VARIANT, dataset_groups
from multilight.model.evaluation.run import evaluate, methods_of
from multilight.model.evaluation.settings import CaseSettings

pytestmark = pytest.mark.usefixtures("own_cache")
PLACED = ("misplaced", "scaled")
RAW = "raw composite"


def samples(packed: Path, **settings: Any) -> list[dict[str, Any]]:
    """Draw some samples of 48 pixels, whole pictures unless told."""
    wanted: dict[str, Any] = {"size": 48, "split": None, "visible": 20.0, "length": 6, "augment": False} | settings
    opened = MultiLightDataset(packed, SampleSettings(**wanted))
    return [opened[number] for number in range(len(opened))]


def changed(sample: dict[str, Any], true: dict[str, Any]) -> set[str]:
    """Name what differs by more than the last bits, and a step of the table of display values, of another sum."""
    names = [name for name in sample if name != "meta"]
    return {name for name in names if not torch.allclose(sample[name].float(), true[name].float(), atol=2e-4)}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_changes_what_it_says(packed: Path, fault: Fault) -> None:
    depth, pictures = {"depth"}, {"composite", "target", "effect", "mask"}
    for sample, true in zip(samples(packed, faults=1.0, kinds=(fault,)), samples(packed), strict=True):
        assert changed(sample, true) == (pictures if fault in PLACED else depth)
        assert torch.isfinite(sample["depth"]).all()
        assert sample["depth"].min() >= 0.0
        assert sample["depth"].max() <= 1.0


@pytest.mark.parametrize("augment", [False, True])
def test_samples_without_a_fault_are_as_they_were(packed: Path, augment: bool) -> None:
    some = samples(packed, augment=augment, faults=0.5, length=40)
    differ = [bool(changed(a, b)) for a, b in zip(some, samples(packed, augment=augment, length=40), strict=True)]
    assert 8 < sum(differ) < 32


def test_faults_are_drawn_by_the_seed(packed: Path) -> None:
    one, again = (samples(packed, augment=True, faults=1.0, length=10) for _ in range(2))
    assert not any(changed(a, b) for a, b in zip(one, again, strict=True))


def ramp() -> torch.Tensor:
    """Return depth from 0.2 to 0.9, and nothing in the rows above: (1, 64, 64)."""
    depth = torch.linspace(0.9, 0.2, 64)[None, :, None].repeat(1, 1, 64)
    depth[:, :8] = 1.0
    return depth


def test_affine_depth_is_affine_and_nothing_stays_nothing() -> None:
    depth, known = ramp().double(), ramp() < 1.0
    for seed in range(20):
        wrong = wrong_depth(ramp(), "affine depth", np.random.default_rng(seed)).double()
        assert (wrong[~known] == 1.0).all()
        assert (wrong[known] < 1.0).all()
        slope, offset = np.polyfit(depth[known].numpy(), wrong[known].numpy(), 1)
        torch.testing.assert_close(wrong[known], slope * depth[known] + offset, atol=1e-6, rtol=0)
        assert abs(offset) > 1e-3
        assert (wrong[known] > 0).all()


def test_noise_is_as_large_as_told_and_holes_as_many() -> None:
    depth, known = ramp(), ramp() < 1.0
    for seed in range(20):
        noisy = wrong_depth(depth, "noisy depth", np.random.default_rng(seed))
        spread = float((noisy[known] / depth[known]).log().std())
        assert 0.95 * NOISE[0] < spread < 1.05 * NOISE[1]
        holes = wrong_depth(depth, "depth with holes", np.random.default_rng(seed))
        assert float(((holes == 1.0) & (depth < 1.0)).float().mean()) <= HOLES + 0.01
        assert float((holes == 1.0).float().mean()) >= HOLES
        assert torch.equal(holes[holes < 1.0], depth[holes < 1.0])


def test_guessed_depth_keeps_the_order_of_far_and_near_and_loses_outlines() -> None:
    depth = torch.full((1, 64, 64), 0.8)
    depth[:, 20:44, 20:44] = 0.3
    for seed in range(10):
        guessed = wrong_depth(depth, "guessed depth", np.random.default_rng(seed))
        inside, outside = guessed[:, 26:38, 26:38], torch.cat((guessed[:, :12], guessed[:, 52:]))
        assert inside.max() < outside.min()
        height = float(outside.mean() - inside.mean())
        assert guessed[0, 32].diff().abs().max() < 0.5 * height  # the whole of it, without the blur


def test_a_misplaced_object_is_moved_with_its_light_and_its_shadow_stays(packed: Path) -> None:
    for number, (sample, true) in enumerate(
        zip(samples(packed, faults=1.0, kinds=("misplaced",)), samples(packed), strict=True)
    ):
        grid = torch.stack(torch.meshgrid(torch.arange(48.0), torch.arange(48.0), indexing="ij"))
        centres = [(grid * each["mask"]).sum((1, 2)) / each["mask"].sum() for each in (sample, true)]
        inside = true["mask"][0, [0, -1]].sum() + true["mask"][0, :, [0, -1]].sum() == 0
        if inside:
            length = float((centres[0] - centres[1]).norm()) / 48
            assert STEP[0] - 2e-3 < length < STEP[1] + 2e-3, number
            torch.testing.assert_close(sample["mask"].sum(), true["mask"].sum(), rtol=0.02, atol=0.5)
        outside = (sample["mask"] + true["mask"] == 0).expand(3, -1, -1)
        torch.testing.assert_close(sample["target"][outside], true["target"][outside], atol=2e-4, rtol=0)
        torch.testing.assert_close(sample["composite"][outside], true["composite"][outside], atol=2e-4, rtol=0)


def test_placements_are_those_of_their_fault() -> None:
    rng = np.random.default_rng(1)
    assert draw_placement(rng, "no depth") is None
    moved, scaled = draw_placement(rng, "misplaced"), draw_placement(rng, "scaled")
    assert moved is not None
    assert scaled is not None
    assert moved.scale == 1.0
    assert (scaled.right, scaled.down) == (0.0, 0.0)
    assert scaled.scale != 1.0


def test_light_that_is_right_needs_no_change(packed: Path) -> None:
    for sample in samples(packed, right=1.0):
        whole = (sample["mask"] > 0.999).expand(3, -1, -1)
        torch.testing.assert_close(sample["composite"][whole], sample["target"][whole], atol=1e-3, rtol=0)
        assert torch.equal(sample["insert_gains"], sample["base_gains"])


@pytest.mark.parametrize("name", ["right", "faults"])
def test_a_probability_beyond_one_is_told(name: str) -> None:
    with pytest.raises(UserError, match=rf"{name} 1.5 must be a probability"):
        SampleSettings(**{name: 1.5})  # type: ignore[arg-type]


def test_pictures_made_over_count_in_their_own_rows_alone(spheres_dataset: Path) -> None:
    plain = CaseSettings(splits=("train",), groups=2, size=48)
    found = evaluate(dataset_groups(spheres_dataset, plain), methods_of({}))
    both = evaluate(
        dataset_groups(spheres_dataset, CaseSettings(("train",), 2, size=48, variants=True)), methods_of({})
    )
    assert both.means(RAW) == found.means(RAW)
    assert set(both.subsets) - set(found.subsets) == {f"{VARIANT}{name}" for name in (RIGHTLY, *FAULTS)}
    for name in (RIGHTLY, *FAULTS):  # moved or made smaller, an object may show too little
        assert 0.5 * len(found.frames) <= len(both.frames_of(f"{VARIANT}{name}")) <= len(found.frames)
    rightly, wrongly = (both.means(RAW, name)["object"]["PSNR"] for name in (f"{VARIANT}{RIGHTLY}", None))
    assert rightly > wrongly + 10.0
