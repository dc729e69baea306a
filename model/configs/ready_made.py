"""Configurations and weights that come with the package, by name, and what a file of weights says of itself.

Imports no torch.
"""

import re
from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError
from safetensors import SafetensorError, safe_open

from multilight.datagen.errors import UserError
from multilight.datagen.text import did_you_mean
from multilight.model.configs.stage2d import NetworkConfig
from multilight.model.configs.stage3d import SceneNetworkConfig
from multilight.scenes.files.limits import parse_json

Network = TypeVar("Network", NetworkConfig, SceneNetworkConfig)
CONFIGS = {name: Path(__file__).with_name(f"{name}.toml") for name in ("slim", "long", "slim3d", "paper")}
"""Trainings by name."""
WEIGHTS = {path.stem: path for path in sorted((Path(__file__).parents[1] / "weights").glob("*.safetensors"))}
"""Finished weights of the 2D stage by name."""


def config_file(name: str) -> Path:
    """Return the TOML file of that name: a ready-made one's, or a file's; raises `UserError` where it is neither."""
    path = CONFIGS.get(name, Path(name))
    if not path.exists():
        near = did_you_mean(name, CONFIGS)
        raise UserError(f"configuration {name} does not exist; {near}give a TOML file, or one of {', '.join(CONFIGS)}")
    return path


def weights_file(path: Path) -> Path:
    """Return the file of weights that are named, or of that path."""
    return path if path.is_file() else WEIGHTS.get(str(path), path)


def weights_config(path: Path, kind: type[Network]) -> Network:
    """Return the network that a file of finished weights is of, as its header says, without reading the weights.

    Raises `UserError` where it is no such file, or of the other stage.
    """
    path = weights_file(path)
    wanted = "3D" if kind is SceneNetworkConfig else "2D"
    if not path.is_file():
        raise UserError(
            f"weights {path} do not exist; ready-made are: {', '.join(WEIGHTS)}; multilight train CONFIG makes others"
        )
    try:
        with safe_open(path, framework="numpy") as file:
            header = file.metadata() or {}
        if "network" not in header:
            raise UserError(
                f"weights {path} name no network: finished weights are the model.safetensors of multilight train"
            )
        values = parse_json(header["network"])
        stage = "3D" if "layout" in values else "2D"
        if stage != wanted:
            raise UserError(f"weights {path} are of the {stage} stage, those of the {wanted} stage are asked for")
        if stage == "2D":
            values = {"body": "attention"} | values  # files from before there was another do not say
        return kind.model_validate(values)
    except (SafetensorError, OSError, ValidationError, ValueError, TypeError) as error:
        raise UserError(f"weights {path} cannot be read: {str(error).splitlines()[0]}") from None


def check_device(name: str) -> None:
    """Raise `UserError` where no device has such a name; whether it is there is torch's to say."""
    if not re.fullmatch(r"auto|cpu|mps|cuda(:\d{1,3})?", name):
        raise UserError(f"--device {name} is no device; say auto, cpu, cuda or cuda:1, say")
