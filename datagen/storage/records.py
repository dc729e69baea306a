"""What is written beside the pictures: `scene.json` and `dataset.json`, as validated records.

Hashes chain them: `dataset.json` states that of the index, each row of the index that of a scene's record, and the
record those of its files.
"""

import hashlib
import json
from collections.abc import Iterator
from typing import Annotated, Any, Self

from pydantic import Field, ValidationInfo, model_validator

from multilight.datagen.config.dataset import DatasetConfig, RendererName
from multilight.datagen.storage.object_variants import ALL
from multilight.lights.spec import EmissiveLight, LightingCondition, LightRig
from multilight.scenes.assets.splits import Split
from multilight.scenes.frozen import Frozen, Matrix4
from multilight.scenes.spec import SceneSpec

SCHEMA_VERSION = 3
MOST_VIEWS = 100_000
MOST_SIDE = 16_384
"""Pixels of a view's longer side."""
MOST_PIXELS = 1 << 26
"""Pixels of a view: 8192 x 8192, the largest that is rendered."""


class Schema(Frozen):
    """A record that refuses to be read as another schema version, or where it is not what its own hash says.

    `record_sha256` is the hash of the canonical JSON of all else in the record.
    """

    schema_version: int = SCHEMA_VERSION
    record_sha256: str = ""

    def sealed(self) -> Self:
        """Return the record with its own hash, as it is written."""
        return self.model_copy(update={"record_sha256": record_hash(self.model_dump(mode="json"))})

    @model_validator(mode="before")
    @classmethod
    def _known_and_whole(cls, data: Any, info: ValidationInfo) -> Any:
        if not isinstance(data, dict):
            return data
        version = data.get("schema_version", SCHEMA_VERSION)
        if version != SCHEMA_VERSION:
            raise ValueError(f"schema version {version!r} cannot be read; this program reads {SCHEMA_VERSION}")
        if info.mode == "json" and data.get("record_sha256") != record_hash(data):
            raise ValueError("it was changed: it is not what its own hash (record_sha256) says")
        config = data.get("config")
        if info.mode == "json" and isinstance(config, dict) and "wild" not in config:  # of early builds of 0.2.0
            data = data | {"config": config | {"wild": True}}
        return data


def record_hash(values: dict[str, Any]) -> str:
    """Hash a record's canonical JSON without the hash itself (64 hex digits)."""
    rest = {key: value for key, value in values.items() if key != "record_sha256"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def view_file(view: int) -> str:
    """Return a view's file name inside its scene's folder."""
    return f"views/{view:02d}.exr"


class AssetCredit(Frozen):
    """An asset that was used, with what its licence asks for."""

    id: str
    pack: str
    name: str
    creator: str
    licence: str


class ImportAccount(Frozen):
    """What a file of the user's states and is not carried, a line each."""

    asset: str
    notes: tuple[str, ...]


class LayerEnergy(Frozen):
    """What one layer held before denoising, as radiance averaged over the colour channels.

    `mean` over the picture, and `noise`, one pixel's standard deviation by `noise_variance`.
    """

    mean: float
    noise: float


class Residuals(Frozen):
    """How far a variant's denoised layers are from what was rendered, beyond noise (`datagen.verification.residuals`).

    `inside`: where the removed object was to be seen; `outside`: everywhere else. Each maps a light to the largest
    residual; lights that are not named have none. `denoised_anew`: lights whose layers were denoised as a whole, since
    what is cheaper did not hold the light that was rendered.
    """

    inside: dict[str, float] = Field(default_factory=dict)
    outside: dict[str, float] = Field(default_factory=dict)
    denoised_anew: tuple[str, ...] = ()


class ViewRecord(Frozen):
    """One view's file and camera, and what was rendered before denoising.

    `K` is in pixels; `c2w` is camera-to-world with OpenGL axes, metres. `additivity` is the largest
    |sum of layers - combined| / (combined + mean) before denoising; `energy` holds, of each variant that is denoised
    as a whole (`all`, `without_<object>`), what each light's layer carried then, and `residuals` how far the layer is
    from that after denoising. `pixels` are the sums of each insertable object's coverage (empty in datasets of version
    0.2.0 and before).
    """

    file: Annotated[str, Field(pattern=r"^views/[0-9]{2,6}\.exr$")]
    file_sha256: str
    bytes: Annotated[int, Field(ge=0)]
    width: Annotated[int, Field(ge=1, le=MOST_SIDE)]
    height: Annotated[int, Field(ge=1, le=MOST_SIDE)]
    K: tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
    c2w: Matrix4
    additivity: float
    energy: dict[str, dict[str, LayerEnergy]]
    residuals: dict[str, Residuals] = Field(default_factory=dict)
    pixels: dict[str, float] = Field(default_factory=dict)


class SceneRecord(Schema):
    """Everything about one scene: `scenes/000123/scene.json`.

    `attempt` counts the draws that were thrown away because a check failed, and `thrown_away` says for each which
    check and why (empty in datasets of version 0.2.0 and before); `denoised` layers are cleaned one by one;
    `conditions` carry metered exposures; `split` says which assets and places the scene could draw from.
    """

    seed: int
    index: Annotated[int, Field(ge=0)]
    attempt: Annotated[int, Field(ge=0)]
    thrown_away: tuple[str, ...] = ()
    split: Split = "train"
    renderer: RendererName
    denoised: bool
    scene: SceneSpec
    scene_sha256: str
    rig: LightRig
    rig_sha256: str
    conditions: tuple[LightingCondition, ...]
    views: tuple[ViewRecord, ...] = Field(max_length=MOST_VIEWS)
    assets: tuple[AssetCredit, ...]
    preview_sha256: str = ""

    @model_validator(mode="after")
    def _hashes_hold(self) -> "SceneRecord":
        for name, spec, stated in (("scene", self.scene, self.scene_sha256), ("rig", self.rig, self.rig_sha256)):
            if spec.sha256() != stated:
                raise ValueError(f"{name}_sha256 is {stated[:12]}… but the {name} hashes to {spec.sha256()[:12]}…")
        return self

    def contradictions(self) -> Iterator[str]:
        """Name what in a finished record does not fit together; a record is made bit by bit, so only readers ask."""
        names = set(self.rig.names)
        if not self.conditions or not self.views:
            yield f"it has {len(self.conditions)} conditions and {len(self.views)} views"
        for condition in self.conditions:
            if unknown := sorted(set(condition.gains) - names):
                yield f"condition {condition.name} names the light {unknown[0]!r}, the rig has {list(self.rig.names)}"
        for light in self.rig.lights:
            if isinstance(light, EmissiveLight) and light.body not in {body.name for body in self.scene.bodies}:
                yield f"light {light.name} is on the body {light.body!r}, which is not there"
        if len(self.views) != len(self.scene.cameras):
            yield f"it has {len(self.views)} views and {len(self.scene.cameras)} cameras"
        for number, (view, camera) in enumerate(zip(self.views, self.scene.cameras, strict=False)):
            if view.file != view_file(number):
                yield f"view {number} is {view.file!r}, not {view_file(number)!r}"
            if (view.width, view.height) != (camera.width, camera.height) or view.width * view.height > MOST_PIXELS:
                yield f"view {number} is {view.width} x {view.height}, its camera {camera.width} x {camera.height}"
            if tuple(map(tuple, camera.intrinsics().tolist())) != view.K or view.c2w != camera.c2w:
                yield f"view {number} states another K or c2w than its camera"
            if view.pixels and set(view.pixels) != set(self.scene.insertable):
                yield f"view {number} states the pixels of other objects than {list(self.scene.insertable)}"
            if set(view.energy.get(ALL, ())) != names or any(set(held) - names for held in view.energy.values()):
                yield f"view {number} states the energy of other lights than the rig's {list(self.rig.names)}"

    def condition(self, name: str) -> LightingCondition:
        """Return the lighting condition of that name; raises `KeyError` naming those there are."""
        for condition in self.conditions:
            if condition.name == name:
                return condition
        raise KeyError(f"no condition {name!r}; there are {[c.name for c in self.conditions]}")


class DatasetRecord(Schema):
    """What a dataset was made with: `dataset.json`.

    `variant` is Mitsuba's (`llvm_ad_rgb`, say) on the machine that began the dataset, empty for other renderers, and
    `versions` are that machine's, of the kind of processor too; `packs` maps each pack that could be drawn from to a
    hash of its content (empty for closed forms, and in datasets of version 0.2.0 and before);
    `index_sha256` is the hash of `index.parquet`, `index_more` are those of the index's further blocks
    (`datagen.storage.blocks`), empty for those without rows, and `index_rows` is the number of its scenes: as the last
    call that made scenes left it, empty before. `thrown_away` counts, over all scenes of the index, the draws that
    failed a check and were drawn anew, by check. `imports` are the accounts of what the user brought;
    `background_sha256` is the hash of the background's file, which says that it is the same wherever it lies.
    """

    config: DatasetConfig
    renderer: RendererName
    variant: str = ""
    versions: dict[str, str]
    packs: dict[str, str] = Field(default_factory=dict)
    assets: tuple[AssetCredit, ...] = ()
    imports: tuple[ImportAccount, ...] = ()
    background_sha256: str = ""
    index_sha256: str = ""
    index_more: tuple[str, ...] = ()
    index_rows: Annotated[int, Field(ge=0)] = 0
    thrown_away: dict[str, int] = Field(default_factory=dict)

    def other_settings(self, config: DatasetConfig, *, same_background: bool) -> list[str]:
        """Say in what another configuration makes other scenes: `seed = 7, not 8`; a dataset may grow."""
        mine, theirs = self.config.model_dump(), config.model_dump()
        free = {"scenes", "renderer", *(("background",) if same_background else ())}
        return [
            f"{key} = {mine[key]!r}, not {theirs[key]!r}"
            for key in mine
            if mine[key] != theirs[key] and key not in free
        ]

    def misfit(self, record: SceneRecord) -> str:
        """Say in what a scene's record is not of this dataset, or nothing.

        What an imported stage decides itself, its size and its views, is not looked at.
        """
        config = self.config
        wanted: dict[str, object] = {
            "seed": config.seed,
            "split": config.split_of(record.index),
            "renderer": self.renderer,
        }
        found: dict[str, object] = {key: getattr(record, key) for key in wanted}
        if config.kind != "imported":
            wanted |= {"kind": config.kind_of(record.index), "views": config.views, "conditions": config.conditions}
            wanted |= {"width": config.width, "height": config.height}
            view = record.views[0]
            found |= {"kind": record.scene.kind, "views": len(record.views), "conditions": len(record.conditions)}
            found |= {"width": view.width, "height": view.height}
        return next(
            (f"its {key} is {found[key]!r}, not {wanted[key]!r}" for key in wanted if found[key] != wanted[key]), ""
        )
