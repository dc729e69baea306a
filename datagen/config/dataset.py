"""The typed configuration of a dataset; everything that decides its content is in here, and nothing else is."""

import difflib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, ValidationError, model_validator

from multilight.datagen.config.presets import PRESETS, Preset
from multilight.datagen.errors import UserError
from multilight.scenes.assets.splits import Split, SplitShares, scene_place, scene_split
from multilight.scenes.cameras.paths import CameraSettings
from multilight.scenes.files.limits import read_toml, shown
from multilight.scenes.frozen import Frozen, UnitFloat
from multilight.scenes.streams import Weights

Kind = Literal["tabletop", "room", "outdoor", "studio", "custom", "spheres", "imported"]
RendererName = Literal["mitsuba", "cycles", "analytic"]
Renderer = Literal["auto", RendererName]

PIXELS, METRES = {"unit": "px"}, {"unit": "m"}


class KindShares(Weights[Kind]):
    """How often each kind of scene comes in a mixed dataset, relative to the others."""

    tabletop: UnitFloat = 0.35
    """A still life on a table."""
    room: UnitFloat = 0.35
    """A furnished room."""
    outdoor: UnitFloat = 0.15
    """Open ground under a sky."""
    studio: UnitFloat = 0.15
    """A photographer's studio."""


class DatasetConfig(Frozen):
    """What to make. Two datasets of equal configuration hold the same scenes."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    """Seed of every random stream; 0 is a seed like any other."""
    scenes: Annotated[int, Field(ge=1, le=1_000_000)] = 4
    """Number of scenes; may grow when a dataset is continued."""
    kind: Kind | Literal["mixed"] = "tabletop"
    """Kind of scene; `mixed` draws one for each scene; `spheres` goes with the closed-form renderer; `imported` is the
    scene of an exported stage, as `multilight import` sets it."""
    kinds: KindShares = KindShares()
    """Shares of the kinds where `kind` is `mixed`."""
    splits: SplitShares = SplitShares()
    """Shares of the splits; each split has assets and environment places of its own."""
    ood_kinds: tuple[Kind, ...] = ()
    """Kinds that only scenes of the split `test_ood` are of; empty: those differ in assets and places only."""
    background: Path | None = None
    """GLB, glTF, USD or .blend file that scenes of kind `custom` are set in (scripts in it never run), or the stage of
    kind `imported`."""
    renderer: Renderer = "auto"
    """`auto` takes the fastest that is installed."""
    width: Annotated[int, Field(ge=16, le=8192, json_schema_extra=PIXELS)] = 256
    """Image width."""
    height: Annotated[int, Field(ge=16, le=8192, json_schema_extra=PIXELS)] = 256
    """Image height."""
    views: Annotated[int, Field(ge=1, le=100)] = 16
    """Views a scene."""
    spp: Annotated[int, Field(ge=1, le=65536)] = 16
    """Samples a pixel; Mitsuba spends what so many cost where there is noise."""
    denoise: Literal["auto", "on", "off"] = "auto"
    """Denoise each layer (Intel Open Image Denoise); `auto` does so below 2048 samples a pixel."""
    keep_raw: bool = False
    """Where layers are denoised, store them as they were rendered too."""
    conditions: Annotated[int, Field(ge=1, le=64)] = 12
    """Named lighting conditions a scene; any number more can be mixed later."""
    insertable: Annotated[int, Field(ge=1, le=8)] = 3
    """Objects a scene whose removal is rendered."""
    objects: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(le=8)]] = (4, 8)
    """Fewest and most objects of the still life."""
    piles: UnitFloat = 0.1
    """Share of the tabletops with a pile besides: a bowl of fruit, a stack of books or crockery, a heap of toys."""
    lights: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(le=8)]] = (1, 8)
    """Fewest and most lights of a rig; what glows counts."""
    cameras: CameraSettings = CameraSettings()
    """Trajectories, lenses and how much they must show."""

    @model_validator(mode="after")
    def _ranges_hold(self) -> "DatasetConfig":
        low, high = self.objects
        if not self.insertable <= low <= high:
            raise ValueError(f"objects must satisfy insertable <= fewest <= most, got {self.insertable}, {low}, {high}")
        if self.lights[0] > self.lights[1]:
            raise ValueError(f"lights must ascend, got {self.lights[0]} to {self.lights[1]}")
        return self

    @model_validator(mode="after")
    def _background_goes_with_custom(self) -> "DatasetConfig":
        if bool({"custom", "imported"} & {self.kind, *self.ood_kinds}) != (self.background is not None):
            raise ValueError(
                "kind custom and background go together: say --kind custom --background FILE (GLB, glTF, USD or .blend)"
            )
        return self

    @model_validator(mode="after")
    def _a_stage_is_one_scene(self) -> "DatasetConfig":
        if "imported" in self.ood_kinds or (self.kind == "imported" and self.scenes != 1):
            raise ValueError("a stage holds one scene; make a dataset of it with: multilight import usd FILE --out DIR")
        return self

    @model_validator(mode="after")
    def _held_out_kinds_are_not_trained_on(self) -> "DatasetConfig":
        shares = self.kinds.model_dump() if self.kind == "mixed" else {self.kind: 1.0}
        for kind in self.ood_kinds:
            if shares.get(kind, 0) > 0:
                raise ValueError(f"ood_kinds holds {kind!r} out, but it is trained on; set kinds.{kind} = 0")
        return self

    def split_of(self, index: int) -> Split:
        """Return the split of a scene."""
        return scene_split(self.seed, index, self.splits)

    def kind_of(self, index: int) -> Kind:
        """Return the kind of a scene: of those held out in `test_ood`, else the one kind, or drawn by the shares."""
        place = scene_place(self.seed, index)[1]
        if self.ood_kinds and self.split_of(index) == "test_ood":
            return self.ood_kinds[int(place * len(self.ood_kinds))]
        if self.kind != "mixed":
            return self.kind
        return self.kinds.at(place)


def config_keys(model: type[Frozen] = DatasetConfig, prefix: str = "") -> Iterator[str]:
    """List every key of the configuration, nested ones with dots."""
    for name, field in model.model_fields.items():
        kind = field.annotation
        if isinstance(kind, type) and issubclass(kind, Frozen):
            yield from config_keys(kind, f"{prefix}{name}.")
        else:
            yield prefix + name


def describe_validation_error(error: ValidationError, source: str) -> str:
    """Put a validation error into one line: source, key, value and what is allowed."""
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"]) or "configuration"
    if first["type"] == "extra_forbidden":
        return f"{source}: unknown key {key!r}; {_nearest(key)}known keys: {', '.join(config_keys())}"
    return f"{source}: {key} = {shown(first['input'])}: {first['msg']}"


def _nearest(key: str) -> str:
    """Return a hint at the valid key that looks most like a wrong one: as a whole, or without its table."""
    known = {key: key for key in reversed(list(config_keys()))}
    known = {key.rpartition(".")[2]: key for key in known} | known
    close = difflib.get_close_matches(key, known, n=1) or difflib.get_close_matches(key.rpartition(".")[2], known, n=1)
    return f"did you mean {known[close[0]]!r}? " if close else ""


def load_config(
    path: Path | None, overrides: dict[str, Any], preset: Preset | None = None, below: dict[str, Any] | None = None
) -> DatasetConfig:
    """Read a TOML file (if any) over a preset (if any), lay the command line's values over both and validate.

    All goes over `below`, the settings of a dataset that is continued. The file may name the preset itself
    (`preset = "room"`); the argument goes first. Raises `UserError` with the file, the key, the value and the allowed
    range.
    """
    values = {} if path is None else _read_toml(path)
    given = {key: value for key, value in overrides.items() if value is not None}
    base = preset or values.pop("preset", None)
    values.pop("preset", None)
    if base is not None and str(base) not in PRESETS:
        raise UserError(f"{path}: preset = {shown(base)}: there are {', '.join(PRESETS)}")
    start = _joined(below or {}, PRESETS[base].values if base else {})
    try:
        return DatasetConfig.model_validate(_joined(_joined(start, values), given))
    except ValidationError as error:
        wrong = error.errors()[0]["loc"][:1]
        source = str(path) if path is not None and not set(wrong) & set(given) else "command line"
        raise UserError(describe_validation_error(error, source)) from None


def _joined(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Lay one table over another, table by table."""
    result = dict(below)
    for key, value in above.items():
        nested = isinstance(value, dict) and isinstance(result.get(key), dict)
        result[key] = _joined(result[key], value) if nested else value
    return result


def _read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file; raises `UserError` naming it."""
    try:
        return read_toml(path)
    except FileNotFoundError:
        raise UserError(f"configuration file {path} does not exist") from None
    except ValueError as error:
        raise UserError(f"configuration file {path} is not valid TOML: {error}") from None
    except OSError as error:
        raise UserError(f"configuration file {path} cannot be read: {error.strerror}") from None
