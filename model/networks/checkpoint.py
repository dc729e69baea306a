"""Checkpoints: tensors as safetensors, the rest as JSON beside or inside them; nothing is unpickled."""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TypeVar

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn
from torch.optim import Optimizer

from multilight.datagen.errors import UserError
from multilight.datagen.files.outputs import written
from multilight.datagen.storage.store import write_text
from multilight.model.configs.ready_made import weights_config, weights_file
from multilight.model.configs.stage2d import NetworkConfig, TrainingConfig
from multilight.model.configs.stage3d import SceneNetworkConfig
from multilight.model.networks.compositing2d import Compositing2D
from multilight.model.networks.compositing3d import Compositing3D, SceneNetwork, scene_network
from multilight.model.networks.points3d import PointTransformer
from multilight.scenes.files.limits import read_json

Tensors = dict[str, Tensor]
Config = TypeVar("Config", NetworkConfig, SceneNetworkConfig)
Network = TypeVar("Network", Compositing2D, Compositing3D | PointTransformer)
SCHEMA_VERSION = 1


@dataclass(frozen=True)
class Progress:
    """How far a training is: steps done and seconds spent on them, over all calls together."""

    step: int = 0
    seconds: float = 0.0


def save_checkpoint(
    folder: Path, config: TrainingConfig, progress: Progress, *, model: nn.Module, average: nn.Module, optim: Optimizer
) -> None:
    """Write `step_000123.safetensors`, then `step_000123.json`, which makes it count; then remove older ones."""
    folder.mkdir(parents=True, exist_ok=True)
    tensors = {f"model.{k}": v for k, v in model.state_dict().items()}
    tensors |= {f"ema.{k}": v for k, v in average.state_dict().items()}
    for number, state in optim.state_dict()["state"].items():
        tensors |= {f"optimizer.{number}.{k}": v for k, v in state.items()}
    name = f"step_{progress.step:06d}"
    _write_tensors(folder / f"{name}.safetensors", tensors, {})
    record = {"schema_version": SCHEMA_VERSION, "progress": asdict(progress), "config": config.model_dump(mode="json")}
    write_text(folder / f"{name}.json", json.dumps(record, indent=1))
    for old in folder.glob("step_*"):
        if not old.name.startswith(f"{name}."):
            old.unlink()


def newest_checkpoint(folder: Path) -> Path | None:
    """Return the JSON file of the newest finished checkpoint, if any."""
    found = [path for path in folder.glob("step_*.json") if re.fullmatch(r"step_\d+\.json", path.name)]
    return max(found, key=lambda path: int(path.stem.split("_")[1]), default=None)


def load_checkpoint(
    path: Path, config: TrainingConfig, *, model: nn.Module, average: nn.Module, optim: Optimizer
) -> Progress:
    """Put everything back where it was; raises `UserError` where the file is damaged or of another configuration."""
    try:
        record = read_json(path)
        if record["schema_version"] != SCHEMA_VERSION:
            raise ValueError(f"schema version {record['schema_version']}, this program reads {SCHEMA_VERSION}")
        stored = type(config).model_validate(record["config"])  # keys that are newer than the file get their defaults
        _same_training(path, stored.model_dump(mode="json"), config.model_dump(mode="json"))
        tensors, _ = _read_tensors(path.with_suffix(".safetensors"))
        model.load_state_dict(_under(tensors, "model."))
        average.load_state_dict(_under(tensors, "ema."))
        state: dict[int, Tensors] = {}
        for key, value in _under(tensors, "optimizer.").items():
            number, name = key.split(".", 1)
            state.setdefault(int(number), {})[name] = value
        optim.load_state_dict({"state": state, "param_groups": optim.state_dict()["param_groups"]})
        return Progress(**record["progress"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UserError(f"checkpoint {path} cannot be read: {error}; remove it, or start anew with --fresh") from None


def checkpoint_progress(folder: Path) -> Progress:
    """Return how far the training in a folder of checkpoints is: nowhere, where there is none."""
    path = newest_checkpoint(folder)
    try:
        return Progress() if path is None else Progress(**read_json(path)["progress"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UserError(f"checkpoint {path} cannot be read: {error}; remove it, or start anew with --fresh") from None


RUN_KEYS = {"out", "steps", "minutes", "device", "log_every", "save_every"}
"""Keys of the configuration that may change when a training goes on."""


def _same_training(path: Path, stored: dict[str, object], asked: dict[str, object]) -> None:
    for key in sorted((stored.keys() | asked.keys()) - RUN_KEYS):
        if stored.get(key) != asked.get(key):
            raise UserError(
                f"{path.parent} was trained with {key} = {stored.get(key)!r}, now it is {asked.get(key)!r}; "
                "choose another --out, or start anew with --fresh"
            )


def save_network(path: Path, network: nn.Module, config: NetworkConfig, about: Mapping[str, str]) -> None:
    """Write finished weights, with the network's configuration and `about` (free text) in the file's own header."""
    path.parent.mkdir(parents=True, exist_ok=True)
    header = {"network": config.canonical_json(), **about}
    _write_tensors(path, {k: v.float() for k, v in network.state_dict().items()}, header)


def load_network(path: Path) -> Compositing2D:
    """Read finished weights of the 2D stage, a file or ready-made ones by name; raises `UserError` naming the fault."""
    network, about = _loaded(path, weights_config(path, NetworkConfig), Compositing2D)
    if "size" in about:
        if not re.fullmatch("[1-9][0-9]{1,4}", about["size"]):
            raise UserError(f"weights {path} cannot be read: size in their header is {about['size']}, not pixels")
        network.size = int(about["size"])
    return network


def load_network3d(path: Path) -> SceneNetwork:
    """Read finished weights of the 3D stage; raises `UserError` naming the file and what is wrong with it."""
    return _loaded(path, weights_config(path, SceneNetworkConfig), scene_network)[0]


def _loaded(path: Path, config: Config, made: Callable[[Config], Network]) -> tuple[Network, dict[str, str]]:
    """Return the network and what its header says."""
    try:
        tensors, about = _read_tensors(weights_file(path))
        # Before the network is made, whose size the header decides.
        with torch.device("meta"):
            described = sum(value.numel() for value in made(config).state_dict().values())
        if described != (found := sum(value.numel() for value in tensors.values())):
            raise ValueError(f"its header describes a network of {described} numbers, the file holds {found}")
        network = made(config)
        network.load_state_dict(tensors)
    except (OSError, ValueError, RuntimeError) as error:
        raise UserError(f"weights {path} cannot be read: {str(error).splitlines()[0]}") from None
    return network.eval(), about


def _write_tensors(path: Path, tensors: Tensors, header: dict[str, str]) -> None:
    with written(path) as work:  # by ourselves, since the library's files are for their owner's eyes alone
        work.write_bytes(save({k: v.detach().cpu().contiguous() for k, v in tensors.items()}, metadata=header))


def _read_tensors(path: Path) -> tuple[Tensors, dict[str, str]]:
    try:
        with safe_open(path, framework="pt") as file:
            return {key: file.get_tensor(key) for key in file.keys()}, dict(file.metadata() or {})  # noqa: SIM118
    except SafetensorError as error:
        raise ValueError(f"{path.name}: {error}") from None


def _under(tensors: Tensors, prefix: str) -> Tensors:
    return {key.removeprefix(prefix): value for key, value in tensors.items() if key.startswith(prefix)}
