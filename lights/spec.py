"""Lights, rigs and lighting conditions, in radiometric units: W, W/sr, W/m², W/(m² sr) per colour channel.

Colours are scene-linear, Rec.709 primaries, D65. Lights other than the environment and emissive bodies are
never seen by the camera directly; reflections show those that have a size.
"""

import math
from collections.abc import Iterable
from numbers import Real
from typing import Annotated, ClassVar, Literal, Self

from pydantic import BeforeValidator, ConfigDict, Field, PositiveFloat, model_validator

from multilight.scenes.colour import luminance
from multilight.scenes.frozen import Frozen, Matrix4, Rgb, Slug, Vector3, triple
from multilight.scenes.spec import Texture

NonNegative = Annotated[float, Field(ge=0)]
SUN_ANGLE, WIDEST_SUN = 0.0093, 0.5
"""Angular diameters [rad]: of the sun, in the mean of a year (32 arc minutes), and the largest of a parallel light."""


Quantity = Literal["radiance", "intensity", "irradiance"]


class _Light(Frozen):
    """What every light records: its name and, for statistics, where its colour came from.

    `quantity` names the field that says how strong it is.
    """

    quantity: ClassVar[Quantity] = "radiance"

    name: Slug
    colour_temperature: float | None = None
    gel: str | None = None

    @property
    def amount(self) -> Rgb:
        """What it carries by channel, in the unit of its quantity."""
        return triple(getattr(self, self.quantity))

    @property
    def grey(self) -> float:
        """The luminance of its amount, in the same unit."""
        return float(luminance(self.amount))

    @property
    def is_shaped(self) -> bool:
        """Whether it throws a pattern (gobo), has a beam profile or shows a picture."""
        return any(getattr(self, name, None) for name in ("gobo", "profile", "texture"))

    def scaled(self, factor: float) -> Self:
        """Return the same light `factor` times as strong."""
        return self.model_copy(update={self.quantity: triple(channel * factor for channel in self.amount)})


class EnvironmentLight(_Light):
    """Light from infinitely far: `radiance` [W/(m² sr)] times an equirectangular map (asset id), or uniform.

    In the map, azimuth runs to the left: the pixel at (u, v) in [0, 1]^2 from the top left lies in direction
    (cos(lat) cos(phi), cos(lat) sin(phi), sin(lat)) with phi = pi - 2 pi u + `rotation` and lat = pi/2 - pi v,
    so the centre column looks along +X, the top along +Z, and `rotation` [rad] is counter-clockwise about +Z.
    """

    kind: Literal["environment"] = "environment"
    map: str | None = None
    radiance: Rgb = (1.0, 1.0, 1.0)
    rotation: float = 0.0


class SunLight(_Light):
    """Parallel light: `irradiance` [W/m²] on a surface that faces it; `angle` is the disc's diameter [rad]."""

    quantity = "irradiance"

    kind: Literal["sun"] = "sun"
    direction: Vector3
    """Where the light travels, in world axes (any length but zero)."""
    irradiance: Rgb
    angle: Annotated[float, Field(ge=0, le=WIDEST_SUN)] = SUN_ANGLE


class PointLight(_Light):
    """A sphere of `radius` [m] (0: a point) with radiant `intensity` [W/sr] in every direction.

    A `profile` makes it depend on the angle from `direction`: relative intensities, at most 1, at evenly spaced
    angles from 0 to pi, linear in between (as an IES luminaire file gives them, averaged about the axis).
    """

    quantity = "intensity"

    kind: Literal["point"] = "point"
    position: Vector3
    intensity: Rgb
    radius: NonNegative = 0.0
    direction: Vector3 = (0.0, 0.0, -1.0)
    profile: tuple[Annotated[float, Field(ge=0, le=1)], ...] | None = Field(default=None, min_length=2)


class SpotLight(_Light):
    """A spot at `position` that shines along `direction`.

    `intensity` [W/sr] on the axis; zero outside `half_angle` [rad]; `blend` in [0, 1] is the soft part of the
    cone, with Blender's smoothstep fall-off. A `gobo` (asset id of an image, read as linear) multiplies it: the
    image's square is the one round the cone, seen from the light, its top rotated by `roll` [rad] from world up.
    """

    quantity = "intensity"

    kind: Literal["spot"] = "spot"
    position: Vector3
    direction: Vector3
    intensity: Rgb
    half_angle: Annotated[float, Field(gt=0, lt=1.5)]
    blend: Annotated[float, Field(ge=0, le=1)] = 0.15
    radius: NonNegative = 0.0
    gobo: str | None = None
    roll: float = 0.0


class AreaLight(_Light):
    """A one-sided Lambertian rectangle or ellipse of `radiance` [W/(m² sr)], `width` x `height` metres.

    It lies in the XY plane of its own frame and emits along -Z (as a camera looks); `world_from_light` is rigid.
    """

    kind: Literal["area"] = "area"
    shape: Literal["rectangle", "disk"] = "rectangle"
    width: PositiveFloat
    height: PositiveFloat
    world_from_light: Matrix4
    radiance: Rgb

    @property
    def position(self) -> Vector3:
        """Its centre."""
        return triple(row[3] for row in self.world_from_light[:3])

    @property
    def area(self) -> float:
        """Its area [m²]."""
        return self.width * self.height * (math.pi / 4 if self.shape == "disk" else 1.0)


class EmissiveLight(_Light):
    """One part of a body that glows with `radiance` [W/(m² sr)], Lambertian, on both sides.

    A `texture` (sRGB-encoded, looked up with the part's uv) multiplies it.
    """

    kind: Literal["emissive"] = "emissive"
    body: Slug
    part: Annotated[int, Field(ge=0)] = 0
    radiance: Rgb
    texture: Texture | None = None


Light = Annotated[
    EnvironmentLight | SunLight | PointLight | SpotLight | AreaLight | EmissiveLight, Field(discriminator="kind")
]


class LightRig(Frozen):
    """All the lights of a scene, in the order of their layers."""

    lights: tuple[Light, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _unique_names(self) -> "LightRig":
        if len(set(self.names)) != len(self.lights):
            raise ValueError(f"light names must be unique, got {list(self.names)}")
        return self

    @property
    def names(self) -> tuple[str, ...]:
        """The lights' names, in the order of their layers."""
        return tuple(light.name for light in self.lights)


Gain = Annotated[float, Field(ge=0, le=1e9)]
"""What a light is multiplied by; with the largest exposure and radiance still a float32."""


def _of_each_channel(gain: object) -> object:
    """Give all channels the gain where it is one number; a list counts as a tuple."""
    if isinstance(gain, Real) and not isinstance(gain, bool):
        return (gain, gain, gain)
    return tuple(gain) if isinstance(gain, list) else gain


Gains = Annotated[
    tuple[Gain, Gain, Gain], BeforeValidator(_of_each_channel, json_schema_input_type=Gain | tuple[Gain, Gain, Gain])
]


class LightingCondition(Frozen):
    """A lighting of a scene: what each of its lights is multiplied by, and an exposure."""

    model_config = ConfigDict(
        use_attribute_docstrings=True,
        json_schema_extra={
            "examples": [{"name": "warm", "gains": {"key": [1.2, 0.9, 0.5], "fill": 1}, "exposure_ev": 0.5}]
        },
    )

    name: Slug
    """Lower-case letters, digits and _, a letter first, at most 40."""
    gains: dict[str, Gains]
    """For each light that is on a number from 0 to 1e9, or three: of red, green and blue; all others are off."""
    exposure_ev: Annotated[float, Field(ge=-64, le=64)] = 0.0
    """A number of stops from -64 to 64: the picture is multiplied by 2 to the power of it."""

    @classmethod
    def unchanged(cls, lights: Iterable[str], name: str = "all") -> Self:
        """Return the condition in which these lights are on as the rig has them: unit gains, 0 EV."""
        return cls(name=name, gains=dict.fromkeys(lights, (1.0, 1.0, 1.0)))
