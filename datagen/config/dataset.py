"""The typed configuration of a dataset; everything that decides its content is in here, and nothing else is."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from multilight.datagen.config.loading import NONE, joined, read_values, validated
from multilight.datagen.config.presets import PRESETS, Preset
from multilight.datagen.errors import UserError
from multilight.scenes.assets.splits import Split, SplitShares, scene_place, scene_split
from multilight.scenes.cameras.paths import CameraSettings
from multilight.scenes.files.limits import shown
from multilight.scenes.frozen import Settings, UnitFloat
from multilight.scenes.random_streams import Weights

Kind = Literal["tabletop", "room", "outdoor", "studio", "custom", "spheres", "imported"]
RendererName = Literal["mitsuba", "cycles", "analytic"]
Renderer = Literal["auto", RendererName]
Denoise = Literal["auto", "on", "off"]

PIXELS = {"unit": "px"}


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


class DatasetConfig(Settings):
    """What to make. Two datasets of equal configuration hold the same scenes."""

    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    """Seed of every random stream; 0 is a seed like any other."""
    scenes: Annotated[int, Field(ge=1, le=1_000_000)] = 4
    """Number of scenes; may grow when a dataset is continued."""
    kind: Kind | Literal["mixed"] = "tabletop"
    """Kind of scene; `mixed` draws one for each scene; `spheres` goes with the renderer `analytic`; `imported` is the
    scene of an exported stage, as `multilight import` sets it."""
    kinds: KindShares = KindShares()
    """Shares of the kinds where `kind` is `mixed`."""
    splits: SplitShares = SplitShares()
    """Shares of the splits; each split has assets and environment places of its own."""
    ood_kinds: tuple[Kind, ...] = ()
    """Kinds that only scenes of the split `test_ood` are of; empty: those differ in assets and places only."""
    background: Path | None = None
    """GLB, glTF, USD, .blend or other file that scenes of kind `custom` are set in (scripts in it never run), or the
    stage of kind `imported`."""
    only_assets: bool = False
    """Draw from the folders of `assets` alone, not from what is installed."""
    renderer: Renderer = "auto"
    """Renderer; `auto` takes the fastest that is installed."""
    width: Annotated[int, Field(ge=16, le=8192, json_schema_extra=PIXELS)] = 256
    """Image width in pixels."""
    height: Annotated[int, Field(ge=16, le=8192, json_schema_extra=PIXELS)] = 256
    """Image height in pixels."""
    views: Annotated[int, Field(ge=1, le=100)] = 16
    """Views a scene."""
    spp: Annotated[int, Field(ge=1, le=65536)] = 16
    """Samples a pixel; Mitsuba spends what so many cost where there is noise."""
    denoise: Denoise = "auto"
    """Denoise each layer (Intel Open Image Denoise); `auto` does so below 2048 samples a pixel."""
    keep_raw: bool = False
    """Where layers are denoised, store them as they were rendered too (parts `raw_...`; twice the space)."""
    conditions: Annotated[int, Field(ge=1, le=64)] = 12
    """Named lighting conditions a scene; any number more can be mixed later."""
    insertable: Annotated[int, Field(ge=1, le=8)] = 3
    """Objects a scene whose removal is rendered."""
    objects: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(le=8)]] = (4, 8)
    """Fewest and most objects of the still life."""
    piles: UnitFloat = 0.1
    """Probability of a pile on a tabletop: a bowl of fruit, a stack of books or crockery, a heap of toys."""
    wild: bool = False
    """Lamps and conditions in saturated colours too, alone as well; else light as people photograph it."""
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


def load_config(
    path: Path | None, options: Mapping[str, Any], preset: Preset | None = None, below: Mapping[str, Any] = NONE
) -> DatasetConfig:
    """Read a TOML file (if any) over a preset (if any), lay the command line's options over both and validate.

    All goes over `below`, the settings of a dataset that is continued. The file may name the preset itself
    (`preset = "room"`); the argument goes first. Raises `UserError` with the file, the key, the value and the allowed
    range.
    """
    values = {} if path is None else read_values(path)
    named = values.pop("preset", None)
    base = preset or named
    if base is not None and str(base) not in PRESETS:
        raise UserError(f"{path}: preset = {shown(base)}: there are {', '.join(PRESETS)}")
    start = joined(below, PRESETS[base].values if base else NONE)
    return validated(joined(start, values), DatasetConfig, path, options)
