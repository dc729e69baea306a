"""`SceneSpec`: everything that is in a scene except its lights, in metres, +Z up."""

from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, PositiveFloat, PositiveInt, SerializerFunctionWrapHandler, model_serializer, model_validator

from multilight.scenes.arrays import Float64
from multilight.scenes.frozen import Frozen, Matrix4, Rgb, Slug, UnitFloat

SceneKind = Literal["tabletop", "room", "outdoor", "studio", "custom", "spheres"]


class _Grown(Frozen):
    """A record with fields that came later: they are written only where they say something, so that hashes stay."""

    later: ClassVar[tuple[str, ...]] = ()

    @model_serializer(mode="wrap")
    def _without_defaults(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        fields = type(self).model_fields
        unsaid = {name for name in self.later if getattr(self, name) == fields[name].default}
        return {name: value for name, value in handler(self).items() if name not in unsaid}


class Texture(_Grown):
    """An image looked up at `uv * repeat`; `image` is an asset id that `AssetLibrary.texture_path` resolves.

    `wrap` says what lies beyond the image: it again, its last pixels, or its mirror image.
    """

    later = ("wrap",)

    image: str
    repeat: tuple[PositiveFloat, PositiveFloat] = (1.0, 1.0)
    wrap: Literal["repeat", "clamp", "mirror"] = "repeat"


class Material(_Grown):
    """A principled surface (Burley 2012, as in Blender's Principled BSDF and Mitsuba's `principled`).

    Where a texture is given it multiplies the plain value, as the mesh's vertex colours do the base colour.
    `base_color` is linear Rec.709; base-colour textures are sRGB-encoded 8-bit files, all others linear. Opacity of
    `alpha_cutoff` and more counts as 1, of less as 0 (at a cutoff of 0 it is taken as it is). `emission` [cd/m²], times
    its texture, is what the surface gives off where a rig makes it a light.
    """

    later = ("metallic_texture", "alpha_cutoff", "emission", "emission_texture")

    name: str = "material"
    base_color: Rgb = (0.8, 0.8, 0.8)
    base_color_texture: Texture | None = None
    roughness: UnitFloat = 0.5
    roughness_texture: Texture | None = None
    metallic: UnitFloat = 0.0
    ior: Annotated[float, Field(ge=1.0, le=3.0)] = 1.5
    coat: UnitFloat = 0.0
    coat_roughness: UnitFloat = 0.05
    transmission: UnitFloat = 0.0
    opacity: UnitFloat = 1.0
    opacity_from_alpha: bool = False
    normal_texture: Texture | None = None
    metallic_texture: Texture | None = None
    alpha_cutoff: UnitFloat = 0.0
    emission: Rgb = (0.0, 0.0, 0.0)
    emission_texture: Texture | None = None


class Sphere(Frozen):
    """A sphere about the body's origin; radius in metres."""

    shape: Literal["sphere"] = "sphere"
    radius: PositiveFloat


class Rectangle(Frozen):
    """A rectangle in the body's XY plane about its origin, facing +Z; `uv` runs in metres from its centre."""

    shape: Literal["rectangle"] = "rectangle"
    width: PositiveFloat
    height: PositiveFloat


class MeshAsset(Frozen):
    """A mesh of the asset library, in metres, Z-up, standing on z = 0, centred in x and y.

    `mesh_sha256` is the hash of the converted mesh, so that a changed asset cannot pass for the old one.
    """

    shape: Literal["mesh"] = "mesh"
    asset: str
    mesh_sha256: str
    parts: PositiveInt


Geometry = Annotated[Sphere | Rectangle | MeshAsset, Field(discriminator="shape")]
Role = Literal["object", "support", "surrounding"]


class Body(Frozen):
    """One thing in the scene: a geometry, a material for each of its parts, and a rigid pose.

    `insertable` bodies are those whose removal is rendered. `world_from_body` is a 4x4 matrix (rotation,
    uniform scale, translation; metres).
    """

    name: Slug
    role: Role
    category: str
    geometry: Geometry
    materials: tuple[Material, ...] = Field(min_length=1)
    world_from_body: Matrix4
    insertable: bool = False

    @model_validator(mode="after")
    def _one_material_a_part(self) -> "Body":
        parts = self.geometry.parts if isinstance(self.geometry, MeshAsset) else 1
        if len(self.materials) != parts:
            raise ValueError(f"body {self.name!r} has {parts} part(s) but {len(self.materials)} material(s)")
        return self


class Camera(Frozen):
    """A camera in pixels: a pinhole, or a thin lens where `aperture_radius` [m] is not zero.

    `c2w` is camera-to-world with OpenGL axes (+X right, +Y up, looks along -Z); pixel centres lie at
    (x + 0.5, y + 0.5) from the top left. The lens is focused on the plane at `focus_distance` [m] along the
    optical axis; geometry buffers are those of the pinhole.
    """

    width: PositiveInt
    height: PositiveInt
    fx: PositiveFloat
    fy: PositiveFloat
    cx: float
    cy: float
    c2w: Matrix4
    aperture_radius: Annotated[float, Field(ge=0)] = 0.0
    focus_distance: PositiveFloat = 1.0

    def intrinsics(self) -> Float64:
        """Return K, 3x3, in pixels."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], dtype=np.float64)

    def pose(self) -> Float64:
        """Return `c2w` as a 4x4 array (OpenGL camera axes to world, metres)."""
        return np.array(self.c2w, dtype=np.float64)


class SceneSpec(Frozen):
    """What is there: bodies and cameras. It holds no lights, so a relit scene keeps its hash."""

    kind: SceneKind
    index: Annotated[int, Field(ge=0)]
    bodies: tuple[Body, ...] = Field(min_length=1)
    cameras: tuple[Camera, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _unique_names(self) -> "SceneSpec":
        names = [body.name for body in self.bodies]
        if len(set(names)) != len(names):
            raise ValueError(f"body names must be unique, got {names}")
        return self

    def body(self, name: str) -> Body:
        """Return the body of that name; raises `KeyError` naming those there are."""
        for body in self.bodies:
            if body.name == name:
                return body
        raise KeyError(f"no body {name!r}; there are {[b.name for b in self.bodies]}")

    def instance_id(self, name: str) -> int:
        """Return the body's id in `instance_id` images: its position plus one (0 is the environment)."""
        return self.bodies.index(self.body(name)) + 1

    @property
    def insertable(self) -> tuple[str, ...]:
        """Names of the insertable objects, in order."""
        return tuple(body.name for body in self.bodies if body.insertable)
