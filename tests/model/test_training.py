"""Training: exact resume, two processes as one, clear failures, and that it learns."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file
from torch import Tensor

from multilight.datagen.cli import main
from multilight.datagen.config.loading import keys_of, read_values, validated
from multilight.datagen.errors import UserError
from multilight.model.cli import COMMANDS
from multilight.model.configs.ready_made import CONFIGS, weights_config
from multilight.model.configs.stage2d import NETWORKS, LossConfig, NetworkConfig, TrainingConfig
from multilight.model.configs.stage3d import SceneTrainingConfig
from multilight.model.networks.checkpoint import load_network, newest_checkpoint
from multilight.model.networks.compositing2d import Compositing2D
from multilight.model.training.batches import ALONE, Batch, Process, stage_at, training_batches
from multilight.model.training.losses import CompositingLoss
from multilight.model.training.monitor import regional_psnr
from multilight.model.training.optimization import average_into, learning_rate, make_optimizer
from multilight.model.training.stage2d import Trainer2D, train
from tests import ROOT

TINY = {"body": "attention", "width": 16, "heads": 2, "groups": 1, "blocks": 2, "window": 4, "pooled": 2}
CPU = torch.device("cpu")


def config(dataset: Path, out: Path, **changes: Any) -> TrainingConfig:
    values: dict[str, Any] = {
        "out": out, "network": TINY, "steps": 4, "save_every": 2, "log_every": 2, "warmup": 2,
        "data": {"train": str(dataset), "workers": 0, "validation_split": "train", "validation_samples": 2},
        "stages": [{"until": 0.5, "size": 32, "batch": 4}, {"size": 48, "batch": 2}],
    }  # fmt: skip
    return TrainingConfig.model_validate(values | changes)


@pytest.fixture(autouse=True)
def one_thread() -> Any:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def test_resuming_is_exact(spheres_dataset: Path, tmp_path: Path) -> None:
    """Four steps are two steps, a stop, and two more, bit for bit: weights, average and optimizer."""
    whole, parts = config(spheres_dataset, tmp_path / "whole"), config(spheres_dataset, tmp_path / "parts")
    train(whole)
    interrupted = Stop(parts, CPU, after=2)
    with pytest.raises(KeyboardInterrupt):
        interrupted.run()
    assert newest_checkpoint(tmp_path / "parts" / "checkpoints") == tmp_path / "parts/checkpoints/step_000002.json"
    train(parts)
    first, second = (load_file(c.out / "checkpoints" / "step_000004.safetensors") for c in (whole, parts))
    assert first.keys() == second.keys()
    assert any(name.startswith("optimizer.") for name in first)
    for name, tensor in first.items():
        assert torch.equal(tensor, second[name]), name
    assert (whole.out / "model.safetensors").read_bytes()[-1000:] == (parts.out / "model.safetensors").read_bytes()[
        -1000:
    ]


def test_denormals_are_zero_in_training_alone(
    spheres_dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They make a trained network's gradients several times as slow; nothing else may change by it."""
    products = []
    step = Trainer2D._step

    def noted(self: Trainer2D, done: float) -> Any:
        products.append(product())
        return step(self, done)

    def product() -> float:
        return float(torch.tensor([1e-25]) * 1e-17)

    monkeypatch.setattr(Trainer2D, "_step", noted)
    train(config(spheres_dataset, tmp_path))
    assert products == [0.0] * 4
    assert product() > 0.0


class Stop(Trainer2D):
    """A training that is interrupted, as by Ctrl-C."""

    def __init__(self, *arguments: Any, after: int) -> None:
        super().__init__(*arguments)
        self.after = after

    def _step(self, done: float) -> Any:
        figures = super()._step(done)
        if self.progress.step + 1 == self.after:
            signal.raise_signal(signal.SIGINT)
        return figures


def test_finished_weights_load_and_say_what_they_are(spheres_dataset: Path, tmp_path: Path) -> None:
    chosen = config(spheres_dataset, tmp_path / "run", steps=1)
    found = train(chosen)
    assert set(found) == {"composite", "network"}
    network = load_network(tmp_path / "run" / "model.safetensors")
    assert network.config == chosen.network
    with safe_open(tmp_path / "run" / "model.safetensors", framework="pt") as file:
        header = file.metadata()
    assert header["perceptual_loss"] == "gradient+ssim"
    assert json.loads(header["config"])["data"]["seed"] == 0
    assert network.size == chosen.stages[-1].size != Compositing2D.size, "it looks at pictures as it did in training"
    assert list((tmp_path / "run" / "samples").glob("*.png"))
    assert list((tmp_path / "run" / "tensorboard").iterdir())
    (tmp_path / "cut.safetensors").write_bytes((tmp_path / "run" / "model.safetensors").read_bytes()[:5000])
    with pytest.raises(UserError, match=r"cut\.safetensors cannot be read"):
        load_network(tmp_path / "cut.safetensors")


def test_finished_weights_are_calibrated_as_told(spheres_dataset: Path, tmp_path: Path) -> None:
    chosen = config(spheres_dataset, tmp_path, steps=2, network=TINY | {"head": "light"}, shadows=1.5, glow=1.0)
    train(chosen)
    path = newest_checkpoint(tmp_path / "checkpoints")
    assert path is not None
    learnt, finished = (load_file(file) for file in (path.with_suffix(".safetensors"), tmp_path / "model.safetensors"))
    for name, tensor in finished.items():
        expected = learnt[f"ema.{name}"].clone()
        if name.startswith("light.last."):
            assert expected[-3:].abs().max() > 0
            expected[-3:] *= 1.5
        if name == "head.bias":
            expected[-1] += 1.0
        torch.testing.assert_close(tensor, expected, rtol=0, atol=0, msg=name)


def test_learning_on_begins_with_finished_weights(
    spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    train(config(spheres_dataset, tmp_path / "first", steps=2))
    begun = tmp_path / "first" / "model.safetensors"
    further = config(spheres_dataset, tmp_path / "on", steps=1, start=begun, learning_rate=1e-12, seed=1)
    train(further)
    old, new = (load_file(folder / "model.safetensors") for folder in (begun.parent, further.out))
    for name, tensor in old.items():
        torch.testing.assert_close(new[name], tensor, rtol=1e-5, atol=1e-7, msg=name)
    with pytest.raises(UserError, match=r"has network\.width = 16, not 32"):
        train(config(spheres_dataset, tmp_path / "wider", network=TINY | {"width": 32}, start=begun))
    words = ["train", "slim", "--data", str(spheres_dataset), "--out", str(tmp_path / "no"), "--start", str(begun)]
    assert main(words, COMMANDS) == 1
    assert "first/model.safetensors' has network.body = 'attention', not" in capsys.readouterr().err
    assert not (tmp_path / "no" / "checkpoints").exists()


def test_going_on_with_another_configuration_is_refused(spheres_dataset: Path, tmp_path: Path) -> None:
    train(config(spheres_dataset, tmp_path, steps=1))
    with pytest.raises(UserError, match=r"learning_rate = 0\.001, now it is 0\.01"):
        train(config(spheres_dataset, tmp_path, steps=2, learning_rate=0.01))
    assert train(config(spheres_dataset, tmp_path, steps=1, learning_rate=0.01), fresh=True)
    checkpoint = newest_checkpoint(tmp_path / "checkpoints")
    assert checkpoint is not None
    checkpoint.with_suffix(".safetensors").write_bytes(b"damaged")
    with pytest.raises(UserError, match=r"step_000001\.json cannot be read"):
        train(config(spheres_dataset, tmp_path, steps=2, learning_rate=0.01))


def test_by_the_clock(spheres_dataset: Path, tmp_path: Path) -> None:
    chosen = config(spheres_dataset, tmp_path, steps=None, minutes=0.02)
    told: list[tuple[float, float, str]] = []
    train(chosen, report=lambda done, total, note="": told.append((done, total, note)))
    assert told[0] == (0, 0, "training")
    assert told[-1][0] == told[-1][1] > 0
    assert all(done <= total for done, total, _ in told)
    assert {"validating", "training"} < {note for _, _, note in told}  # and with the loss
    progress = json.loads(newest_checkpoint(tmp_path / "checkpoints").read_text())["progress"]
    assert 1.2 <= progress["seconds"] < 10
    assert progress["step"] > 0
    train(chosen)  # nothing left to do
    assert json.loads(newest_checkpoint(tmp_path / "checkpoints").read_text())["progress"] == progress


def test_batches_are_pure_functions_of_the_step(spheres_dataset: Path, tmp_path: Path) -> None:
    chosen = config(spheres_dataset, tmp_path)
    whole = training_batches(chosen, 0, 0, ALONE)
    third = [next(whole) for _ in range(3)][2]
    assert torch.equal(next(training_batches(chosen, 0, 2, ALONE))["composite"], third["composite"])
    halves = [next(training_batches(chosen, 0, 2, Process(rank, 2)))["target"] for rank in range(2)]
    assert torch.equal(torch.cat(halves), third["target"])
    assert not torch.equal(next(training_batches(chosen, 0, 0, ALONE))["target"], third["target"])
    with pytest.raises(UserError, match="batch = 4 cannot be shared by 3"):
        training_batches(chosen, 0, 0, Process(0, 3))


@pytest.mark.timeout(180)
def test_two_processes_learn_as_one(spheres_dataset: Path, tmp_path: Path) -> None:
    """Gradients of two processes with half the batch each are those of one; weights end up equal on both."""
    toml = tmp_path / "two.toml"
    toml.write_text(
        f'out = "{tmp_path / "two"}"\nsteps = 2\nwarmup = 1\nsave_every = 1\nclip = 1e9\n'
        "network = {body = 'attention', width = 16, heads = 2, groups = 1, blocks = 2, window = 4, pooled = 2}\n"
        f'stages = [{{size = 32, batch = 4}}]\n[data]\ntrain = "{spheres_dataset}"\nworkers = 0\n'
        "validation_samples = 0\n"
    )
    script = tmp_path / "rank.py"
    script.write_text(
        "import torch, sys, pathlib\n"
        "from multilight.model.training.stage2d import Trainer2D, processes\n"
        "from multilight.datagen.config.loading import read_values, validated\n"
        "from multilight.model.configs.stage2d import TrainingConfig\n"
        "torch.set_num_threads(1)\n"
        "config = validated(read_values(pathlib.Path(sys.argv[1])), TrainingConfig, sys.argv[1])\n"
        "with processes(config) as (process, device):\n"
        "    trainer = Trainer2D(config, device, process)\n"
        "    trainer.run()\n"
        "    gradients = {n: p.grad.clone() for n, p in trainer.network.named_parameters()}\n"
        "    weights = {n: p.detach().clone() for n, p in trainer.network.named_parameters()}\n"
        "    torch.save((gradients, weights), f'{sys.argv[2]}/rank{process.rank}.pt')\n"
    )
    environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT), "CUDA_VISIBLE_DEVICES": ""}
    shown = subprocess.run(
        [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2", script, toml, tmp_path],
        env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert shown.returncode == 0, shown.stderr[-2000:]
    ranks = [torch.load(tmp_path / f"rank{rank}.pt", weights_only=True) for rank in range(2)]
    options = {"out": tmp_path / "one", "device": "cpu"}
    alone = Trainer2D(validated(read_values(toml), TrainingConfig, toml, options), CPU)
    alone.run()
    largest = max(float(p.grad.abs().max()) for p in alone.network.parameters() if p.grad is not None)
    for name, parameter in alone.network.named_parameters():
        assert torch.equal(ranks[0][1][name], ranks[1][1][name]), name
        assert parameter.grad is not None
        assert torch.allclose(ranks[0][0][name], parameter.grad, rtol=1e-3, atol=1e-5 * largest), name


def a_batch(count: int = 4, size: int = 32) -> Batch:
    """Rectangles lit at a quarter of what they should be, over a floor that lacks their shadow."""
    rng = torch.Generator().manual_seed(0)
    background = 0.3 + 0.4 * torch.rand(count, 3, size, size, generator=rng)
    mask = torch.zeros(count, 1, size, size)
    mask[..., 8:20, 8:20] = 1.0
    target = background.clone()
    target[..., 20:24, 8:20] *= 0.6
    target = torch.where(mask > 0, 0.8, target)
    composite = torch.where(mask > 0, 0.45, background)
    depth = torch.where(mask > 0, 0.5, 0.8)
    meta = {"scene": torch.arange(count), "view": torch.zeros(count), "object": ["box"] * count}
    lights = torch.zeros(len(mask), 8)
    return Batch(
        composite, background, depth, target, mask, 0 * mask, target - background, torch.eye(3)[None], lights, lights,
        meta,
    )  # fmt: skip


@pytest.mark.parametrize("head", ["light", "gain", "residual", "direct"])
def test_overfits_one_batch(head: str) -> None:
    torch.manual_seed(0)
    batch = a_batch()
    network = Compositing2D(NETWORKS["slim"].model_copy(update=TINY | {"head": head}))
    optimizer = torch.optim.AdamW(network.parameters(), lr=3e-3)
    before = regional_psnr(batch.composite, batch.target, batch.mask, batch.effect).mean()
    loss = CompositingLoss(LossConfig())
    for _ in range(80):
        optimizer.zero_grad()
        image = network(batch.composite, batch.background, batch.depth)
        loss(image, batch.target, batch.mask, batch.effect)["loss"].mean().backward()
        optimizer.step()
    after = regional_psnr(image.detach(), batch.target, batch.mask, batch.effect).mean()
    assert after > before + (6 if head == "direct" else 10)


class Poisoned(Trainer2D):
    """A training whose second step meets a picture with a NaN."""

    def _next_sample(self, done: float) -> Batch:
        batch = super()._next_sample(done)
        if self.progress.step == 1:
            batch.target[2, 0, 3, 3] = float("nan")
        return batch


def test_bad_pixels_are_named_by_sample(spheres_dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"step 1: NaN or infinite pixels in the data: scene \d+ view \d+ object \w+$"):
        Poisoned(config(spheres_dataset, tmp_path), CPU).run()


def test_divergence_is_told(spheres_dataset: Path, tmp_path: Path) -> None:
    trainer = Trainer2D(config(spheres_dataset, tmp_path), CPU)
    with torch.no_grad():
        next(trainer.network.head.parameters()).fill_(float("nan"))
    with pytest.raises(
        UserError, match="the loss is not finite, though the data are; lower the learning rate; samples"
    ):
        trainer.run()


def test_missing_data_and_devices_are_named(spheres_dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"nothing_here/dataset\.json is missing"):
        train(config(tmp_path / "nothing_here", tmp_path / "a"))
    unseen = {"train": str(spheres_dataset), "workers": 0, "validation_split": "test_ood"}
    with pytest.raises(UserError, match=r"validation: .*set data\.validation_split, or data\.validation_samples = 0"):
        train(config(spheres_dataset, tmp_path / "b", data=unseen))
    if not torch.cuda.is_available():
        with pytest.raises(UserError, match="device 'cuda' cannot be used"):
            train(config(spheres_dataset, tmp_path / "c", device="cuda"))


def test_a_broken_view_ends_a_training_with_one_line(spheres_copy: Path, tmp_path: Path) -> None:
    chosen = config(spheres_copy, tmp_path, data={"train": str(spheres_copy), "workers": 1, "validation_samples": 0})
    next(training_batches(chosen, 0, 0, ALONE))  # what can be seen is known from here on
    for path in spheres_copy.glob("scenes/*/views/*.exr"):
        path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(UserError, match=r"\.exr") as caught:
        train(chosen)
    assert "\n" not in str(caught.value)


def test_full_memory_names_the_remedy(spheres_dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Tensor, **__: object) -> Tensor:
        raise torch.cuda.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB.")

    trainer = Trainer2D(config(spheres_dataset, tmp_path), CPU)
    monkeypatch.setattr(trainer.network, "forward", full)
    with pytest.raises(UserError, match=r"stages\[0\] with batch = 4 and size = 32: lower batch or size"):
        trainer.run()


def test_learning_rate_rises_and_falls(tmp_path: Path) -> None:
    chosen = config(tmp_path, tmp_path, warmup=10)
    rates = [learning_rate(chosen, step, step / 100) for step in range(101)]
    assert rates[0] == pytest.approx(1e-4)
    assert max(rates) == rates[9]
    assert rates[10:] == sorted(rates[10:], reverse=True)
    assert rates[-1] == pytest.approx(2e-5)
    assert [stage_at(chosen, done) for done in (0.0, 0.49, 0.5, 1.0)] == [0, 0, 1, 1]


def test_average_follows_and_decay_spares_biases() -> None:
    network, average = torch.nn.Linear(2, 2), torch.nn.Linear(2, 2)
    before = average.weight.clone()
    average_into(average, network, 0.998, 0)
    assert torch.allclose(average.weight, 0.1 * before + 0.9 * network.weight)
    average_into(average, network, 0.998, 10**6)
    assert torch.allclose(average.weight, 0.998 * (0.1 * before + 0.9 * network.weight) + 0.002 * network.weight)
    tiny = Compositing2D(NETWORKS["slim"].model_copy(update=TINY))
    groups = make_optimizer(tiny, config(Path(), Path())).param_groups
    assert [group["weight_decay"] for group in groups] == [0.05, 0.0]
    assert all(p.ndim >= 2 for p in groups[0]["params"])
    assert sum(len(group["params"]) for group in groups) == len(list(tiny.parameters()))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("out = 1", "out = 1"),
        ("learning_rat = 1", "unknown key 'learning_rat'; did you mean 'learning_rate'"),
        ("[data]\ntrain = 'x'\nworker = 3", "unknown key 'data.worker'; did you mean 'data.workers'"),
        ("stages = [{sise = 3}]", "unknown key 'stages.sise'; did you mean 'stages.size'"),
        ("learning_rate = -1.0", "learning_rate = -1.0: Input should be greater than 0"),
        ("network = 'slin'", "network preset 'slin': there are slim, paper"),
        ("shadows = 2.0\nnetwork = 'paper'", "shadows = 2: only a network of head = 'light' has it"),
        ("glow = 1.0\nnetwork = 'paper'", "glow = 1: only a network of head = 'light' has it; leave it at 0"),
        ("minutes = 3.0", "say either steps or minutes"),
        ("stages = [{until = 0.5}]", "stages must end in ascending order"),
        ("= 3", "cannot be read as TOML"),
    ],
)
def test_configuration_errors_name_the_key(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "train.toml"
    start = "" if text.startswith("out") else 'out = "o"\n'
    path.write_text(f"{start}steps = 2\n{text}\n" + ("" if "[data]" in text else '[data]\ntrain = "x"\n'))
    with pytest.raises(UserError) as caught:
        validated(read_values(path), TrainingConfig, path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)


def test_ready_made_configurations_go_by_name_and_are_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, path in CONFIGS.items():
        kind: type[TrainingConfig] = SceneTrainingConfig if name == "slim3d" else TrainingConfig
        assert main(["train", name, "--data", "elsewhere", "--show"], COMMANDS) == 0
        (tmp_path / "shown.toml").write_text(capsys.readouterr().out)
        made = validated(read_values(tmp_path / "shown.toml"), kind, None)
        assert made == validated(read_values(path), kind, path, {"data.train": "elsewhere"})
    assert weights_config(Path("slim"), NetworkConfig) == NETWORKS["slim"]


def test_ready_made_configurations_are_valid() -> None:
    for path in (ROOT / "model" / "configs" / f"{name}.toml" for name in (*NETWORKS, "long")):
        made = validated(read_values(path), TrainingConfig, path, {"data.train": "elsewhere", "minutes": None})
        assert made.data.train == "elsewhere"
    assert "stages.size" in list(keys_of(TrainingConfig))
    with pytest.raises(UserError, match="does not exist"):
        read_values(ROOT / "nothing.toml")
    with pytest.raises(UserError, match=r"^command line: data\.workers = -1"):
        validated(read_values(path), TrainingConfig, path, {"data.workers": -1})
