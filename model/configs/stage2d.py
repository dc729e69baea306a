"""The typed configuration of the 2D network and of its training; imports no torch."""

from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, model_validator

from multilight.scenes.frozen import Settings, UnitFloat

Head = Literal["light", "gain", "residual", "direct"]
Lighting = Literal["random", "wild", "stored"]
Input = Literal["background", "depth"]
Fault = Literal["no depth", "depth with holes", "affine depth", "noisy depth", "guessed depth", "misplaced", "scaled"]
FAULTS: tuple[Fault, ...] = get_args(Fault)
"""What users' inputs have wrong; simulated by `data.faults`."""
Positive = Annotated[float, Field(gt=0)]


class NetworkConfig(Settings):
    """The shape of the 2D network; `slim` and `paper` in `NETWORKS` are the two that are used."""

    body: Literal["pyramid", "attention"] = "pyramid"
    """What reads the picture: a convolutional pyramid of fixed shape, or attention in windows, as set out below."""
    stride: Literal[1, 2, 4, 8] = 8
    """Pixels a side of a token; 1 is attention at full resolution."""
    width: Annotated[int, Field(ge=8, le=1024)] = 96
    """Channels of a token."""
    groups: Annotated[int, Field(ge=1, le=16)] = 2
    """Groups of attention blocks, each ending in a dilated convolution."""
    blocks: Annotated[int, Field(ge=1, le=32)] = 3
    """Blocks a group; every second one shifts its windows."""
    heads: Annotated[int, Field(ge=1, le=64)] = 3
    """Attention heads a block; must divide `width`."""
    window: Annotated[int, Field(ge=2, le=32)] = 8
    """Tokens a side of a window."""
    pooled: Annotated[int, Field(ge=0, le=16)] = 4
    """Tokens a side of the whole picture's summary that every window attends to besides; 0: none."""
    head: Head = "light"
    """What is predicted: lights that shade and cast shadows, with gains and offsets in linear light; these alone; a
    residual, or the picture itself."""
    cues: bool = True
    """Compute the soft mask and the relief of the depth and hand them to the network as well."""
    blind: tuple[Input, ...] = ()
    """Inputs that are withheld: no pixel of them reaches the output; without `background` a mask must be given."""

    @model_validator(mode="after")
    def _heads_divide_width(self) -> "NetworkConfig":
        if self.width % self.heads:
            raise ValueError(f"heads = {self.heads} must divide width = {self.width}")
        return self


NETWORKS: dict[str, NetworkConfig] = {
    "slim": NetworkConfig(),
    "paper": NetworkConfig(
        body="attention", stride=1, width=96, groups=3, blocks=6, heads=6, window=8, pooled=0, head="direct", cues=False
    ),
}
"""The presets: ours, and the published network (Lyu et al. 2025, 2D stage), the yardstick."""


class DataConfig(Settings):
    """What is learnt from."""

    train: str
    """Folder or fsspec address of the dataset, native or packed."""
    where: str | None = None
    """SQL expression over the dataset's index that chooses scenes, `kind = 'room'`, say."""
    lighting: Lighting = "random"
    """Lighting of the training samples: drawn anew for each, such as the dataset's conditions are or wild (in saturated
    colours), or two of the scene's stored conditions."""
    augment: bool = True
    """Vary exposure, white balance, camera response, crop and direction."""
    faults: UnitFloat = 0.3
    """Probability that a sample's depth is missing, wrong or guessed, or its object misplaced; of augmented ones."""
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    """Seed of the samples."""
    workers: Annotated[int, Field(ge=0, le=256)] = 1
    """Loader processes beside each training process; 0 loads in the training process."""
    validation: str | None = None
    """Dataset of the validation samples; that of the training samples unless told."""
    validation_split: Literal["train", "val", "test", "test_ood"] = "val"
    """Split of the validation samples."""
    validation_samples: Annotated[int, Field(ge=0, le=100_000)] = 32
    """Validation samples, always the same, with stored lighting; 0: no validation."""


class LossConfig(Settings):
    """What is minimized: an error of the pixels + `perceptual` times a distance."""

    pixels: Literal["mse", "log"] = "log"
    """`mse`: mean squared error, as published. `log`: the logarithms of those on the object and on its effect,
    picture by picture, which are the mean PSNR there, up to 30 dB."""
    perceptual: Annotated[float, Field(ge=0, le=100)] = 0.05
    """Weight of the perceptual distance."""
    vgg: Path | None = None
    """VGG19 weights (torchvision .pth or MatConvNet .mat); without: a stand-in, gradients and SSIM."""
    lights: Annotated[float, Field(ge=0, le=1)] = 3e-3
    """Weight of how far guessed lights are from the true ones, of a head that guesses them."""
    glow: Annotated[float, Field(ge=0, le=1)] = 0.05
    """Weight of how wrong the same head is about where the object itself glows."""
    far: Positive = 3.0
    """Of `log`: weight of the mean error elsewhere, against 1 of that on the object, and on its effect."""


class StageConfig(Settings):
    """A stretch of the training with pictures of one size."""

    until: UnitFloat = 1.0
    """Fraction of the training at which the stretch ends; that of the last must be 1."""
    size: Annotated[int, Field(ge=16, le=4096, json_schema_extra={"unit": "px"})] = 256
    """Side of the pictures."""
    batch: Annotated[int, Field(ge=1, le=65536)] = 8
    """Pictures a step, over all processes together."""


class TrainingConfig(Settings):
    """A training of the 2D network. Equal configurations give equal weights on the same machine (with `steps`)."""

    out: Path
    """Folder of checkpoints, logs, sample pictures and the finished weights."""
    network: NetworkConfig = NetworkConfig()
    """The network, or the name of a preset: `slim` or `paper`."""
    start: Path | None = None
    """Finished weights of the same network to learn on from: a file, or ready-made ones by name (default: none)."""
    data: DataConfig
    loss: LossConfig = LossConfig()
    stages: Annotated[tuple[StageConfig, ...], Field(min_length=1)] = (StageConfig(),)
    """Stretches of the training, small pictures first."""
    steps: Annotated[int, Field(ge=1)] | None = None
    """Length of the training in steps; say either this or `minutes`."""
    minutes: Positive | None = None
    """Length of the training in minutes; the learning rate follows the clock."""
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    """Seed of the initial weights."""
    learning_rate: Positive = 1e-3
    """Largest learning rate."""
    final_rate: UnitFloat = 0.02
    """Learning rate at the end, as a fraction of the largest."""
    warmup: Annotated[int, Field(ge=0)] = 100
    """Steps in which the learning rate rises to its largest."""
    betas: tuple[UnitFloat, UnitFloat] = (0.9, 0.95)
    """AdamW's betas."""
    weight_decay: Annotated[float, Field(ge=0)] = 0.05
    """AdamW's weight decay; not on biases, norms and position biases."""
    clip: Positive = 1.0
    """Largest norm of the gradient."""
    ema: Annotated[float, Field(ge=0, lt=1)] = 0.998
    """Decay of the average of the weights that is validated and kept."""
    shadows: Positive = 1.0
    """Factor on the shadows that a head of lights casts, in the finished weights: in doubt it learns too faint ones."""
    glow: Annotated[float, Field(ge=0, le=5)] = 0.0
    """Added in the finished weights to the logit of what it takes for the object's own glow and leaves as it is."""
    precision: Literal["auto", "fp32", "bf16"] = "auto"
    """Arithmetic of the network; `auto`: bf16 on CUDA devices that have it, else fp32."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where to train."""
    log_every: Annotated[int, Field(ge=1)] = 20
    """Steps between lines of the log."""
    save_every: Annotated[int, Field(ge=1)] = 500
    """Steps between checkpoints, each with validation and sample pictures."""

    @model_validator(mode="before")
    @classmethod
    def _preset(cls, data: Any) -> Any:
        """Resolve a preset's name, alone (`network = "slim"`) or under other keys (`preset = "slim"`)."""
        if not isinstance(data, dict):
            return data
        network = data.get("network", {})
        values = {"preset": network} if isinstance(network, str) else network
        if not isinstance(values, dict) or "preset" not in values:
            return data
        name = values["preset"]
        if name not in NETWORKS:
            raise ValueError(f"network preset {name!r}: there are {', '.join(NETWORKS)}")
        given = {key: value for key, value in values.items() if key != "preset"}
        return data | {"network": NETWORKS[name].model_dump() | given}

    @model_validator(mode="after")
    def _lengths_hold(self) -> "TrainingConfig":
        if (self.steps is None) == (self.minutes is None):
            raise ValueError("say either steps or minutes")
        if getattr(self.network, "head", None) != "light":
            for key, given, idle in (("shadows", self.shadows, 1), ("glow", self.glow, 0)):
                if given != idle:
                    raise ValueError(f"{key} = {given:g}: only a network of head = 'light' has it; leave it at {idle}")
        ends = [stage.until for stage in self.stages]
        if ends != sorted(ends) or ends[-1] != 1.0 or ends[0] <= 0:
            raise ValueError(f"stages must end in ascending order, the last at 1; got until = {ends}")
        return self
