"""What is written beside the pictures: `scene.json` and `dataset.json`, as validated records."""

from typing import Annotated, Any

from pydantic import Field, model_validator

from datagen.backends import RendererName
from datagen.config import DatasetConfig
from lights.spec import LightingCondition, LightRig
from scenes.frozen import Frozen, Matrix4
from scenes.spec import SceneSpec
from scenes.splits import Split

SCHEMA_VERSION = 2


class Schema(Frozen):
    """A record that refuses to be read as another schema version."""

    schema_version: int = SCHEMA_VERSION

    @model_validator(mode="before")
    @classmethod
    def _known_version(cls, data: Any) -> Any:
        version = data.get("schema_version", SCHEMA_VERSION) if isinstance(data, dict) else SCHEMA_VERSION
        if version != SCHEMA_VERSION:
            raise ValueError(f"schema version {version} cannot be read; this program reads {SCHEMA_VERSION}")
        return data


class AssetCredit(Frozen):
    """An asset that was used, with what its licence asks for."""

    id: str
    pack: str
    name: str
    creator: str
    licence: str


class LayerEnergy(Frozen):
    """What one layer held before denoising, as radiance averaged over the colour channels.

    `mean` over the picture, and `noise`, one pixel's standard deviation by `noise_variance`.
    """

    mean: float
    noise: float


class Residuals(Frozen):
    """How far a variant's denoised layers are from what was rendered, beyond noise (`datagen.residuals`).

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
    from that after denoising.
    """

    file: Annotated[str, Field(pattern=r"^views/[0-9]{2,6}\.exr$")]
    file_sha256: str
    bytes: int
    width: int
    height: int
    K: tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
    c2w: Matrix4
    additivity: float
    energy: dict[str, dict[str, LayerEnergy]]
    residuals: dict[str, Residuals] = Field(default_factory=dict)


class SceneRecord(Schema):
    """Everything about one scene: `scenes/000123/scene.json`.

    `attempt` counts the draws that were thrown away because a check failed; `denoised` layers are cleaned one by one;
    `conditions` carry metered exposures; `split` says which assets and places the scene could draw from.
    """

    seed: int
    index: Annotated[int, Field(ge=0)]
    attempt: Annotated[int, Field(ge=0)]
    split: Split = "train"
    renderer: RendererName
    denoised: bool
    scene: SceneSpec
    scene_sha256: str
    rig: LightRig
    rig_sha256: str
    conditions: tuple[LightingCondition, ...]
    views: tuple[ViewRecord, ...]
    assets: tuple[AssetCredit, ...]

    @model_validator(mode="after")
    def _hashes_hold(self) -> "SceneRecord":
        for name, spec, stated in (
            ("scene", self.scene, self.scene_sha256),
            ("rig", self.rig, self.rig_sha256),
        ):
            if spec.sha256() != stated:
                raise ValueError(f"{name}_sha256 is {stated[:12]}… but the {name} hashes to {spec.sha256()[:12]}…")
        return self

    def condition(self, name: str) -> LightingCondition:
        """Return the lighting condition of that name; raises `KeyError` naming those there are."""
        for condition in self.conditions:
            if condition.name == name:
                return condition
        raise KeyError(f"no condition {name!r}; there are {[c.name for c in self.conditions]}")


class DatasetRecord(Schema):
    """What a dataset was made with: `dataset.json`.

    `variant` is Mitsuba's (`llvm_ad_rgb`, say) on the machine that began the dataset, empty for other renderers.
    """

    config: DatasetConfig
    renderer: RendererName
    variant: str = ""
    versions: dict[str, str]
    assets: tuple[AssetCredit, ...] = ()
