"""The typed configuration of a dataset; everything that decides its content is in here, and nothing else is."""

import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, model_validator

from datagen.errors import UserError
from scenes.frozen import Frozen

Kind = Literal["tabletop", "spheres"]
Renderer = Literal["auto", "cycles", "analytic"]


class DatasetConfig(Frozen):
    """What to make. Two datasets of equal configuration hold the same scenes."""

    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    """Seed of every random stream; 0 is a seed like any other."""
    scenes: Annotated[int, Field(ge=1, le=1_000_000)] = 4
    """Number of scenes; may grow when a dataset is continued."""
    kind: Kind = "tabletop"
    """`tabletop`; `spheres` goes with the closed-form renderer."""
    renderer: Renderer = "auto"
    """`auto` takes the fastest that is installed."""
    width: Annotated[int, Field(ge=16, le=8192)] = 256
    """Image width in pixels."""
    height: Annotated[int, Field(ge=16, le=8192)] = 256
    """Image height in pixels."""
    views: Annotated[int, Field(ge=1, le=100)] = 16
    """Views a scene, from distant to close."""
    spp: Annotated[int, Field(ge=1, le=65536)] = 8
    """Samples a pixel."""
    denoise: bool = True
    """Denoise each layer (Intel Open Image Denoise); the closed-form renderer has no noise and skips it."""
    conditions: Annotated[int, Field(ge=1, le=64)] = 12
    """Named lighting conditions a scene; any number more can be mixed later."""
    insertable: Annotated[int, Field(ge=1, le=8)] = 3
    """Objects a scene whose removal is rendered."""
    objects: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(le=8)]] = (4, 8)
    """Fewest and most objects on the table."""

    @model_validator(mode="after")
    def _enough_objects(self) -> "DatasetConfig":
        low, high = self.objects
        if not self.insertable <= low <= high:
            raise ValueError(f"objects must satisfy insertable <= fewest <= most, got {self.insertable}, {low}, {high}")
        return self


def describe_validation_error(error: ValidationError, source: str) -> str:
    """Put a validation error into one line: source, key, value and what is allowed."""
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"]) or "configuration"
    if first["type"] == "extra_forbidden":
        known = ", ".join(DatasetConfig.model_fields)
        return f"{source}: unknown key {key!r}; known keys: {known}"
    return f"{source}: {key} = {first['input']!r}: {first['msg']}"


def load_config(path: Path | None, overrides: dict[str, Any]) -> DatasetConfig:
    """Read a TOML file (if any), lay the command line's values over it and validate.

    Raises `UserError` with the file, the key, the value and the allowed range.
    """
    values: dict[str, Any] = {}
    source = "command line"
    if path is not None:
        source = str(path)
        try:
            values = tomllib.loads(path.read_text())
        except FileNotFoundError:
            raise UserError(f"configuration file {path} does not exist") from None
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise UserError(f"configuration file {path} is not valid TOML: {error}") from None
        except OSError as error:
            raise UserError(f"configuration file {path} cannot be read: {error.strerror}") from None
    values |= {key: value for key, value in overrides.items() if value is not None}
    try:
        return DatasetConfig.model_validate(values)
    except ValidationError as error:
        raise UserError(describe_validation_error(error, source)) from None
