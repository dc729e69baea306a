"""The lights of a scene as a camera sees them: kinds, places and directions, filled up to one number for batches."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from multilight.datagen.errors import StoreError
from multilight.datagen.storage.address import Place
from multilight.datagen.storage.store import MOST_RECORD, scene_folder
from multilight.lights.photometry.angular_size import angular_diameter
from multilight.lights.sample_conditions import DAYLIGHT
from multilight.lights.spec import AreaLight, EmissiveLight, EnvironmentLight, Light, LightRig, SunLight
from multilight.scenes.arrays import Float32, Float64, Int64, Mask
from multilight.scenes.frozen import Frozen, Matrix4

LEAST = 8
"""Lights of a sample at least; of the generator's own rigs the largest has as many."""
KINDS = ("none", "environment", "sun", "point", "spot", "area", "emissive")
"""What the numbers in `light_kind` mean."""
NOWHERE = (0.0, 0.0, 0.0)
MIRROR = np.array([-1.0, 1.0, 1.0])


class _Body(Frozen, extra="ignore"):
    name: str
    world_from_body: Matrix4
    insertable: bool


class _Bodies(Frozen, extra="ignore"):
    bodies: tuple[_Body, ...]


class _Record(Frozen, extra="ignore"):
    """What of a `scene.json` lights need; the whole takes four times as long to understand."""

    rig: LightRig
    scene: _Bodies


@dataclass(frozen=True)
class SceneLights:
    """A scene's lights in the order of its layers, filled up with zeros to N.

    kind (N,) int64, numbers of `KINDS`; placed (N,), 1 where it has a place; position (N, 3) [m] and direction
    (N, 3), unit or zero, in world axes; amount (N, 3), what it carries; temperature (N,) of its colour [K], 0 where
    that is no white; size: object → (N,) [rad]; glow: object → (N,) bool, the lights that are parts of it.
    """

    kind: Int64
    placed: Float64
    position: Float64
    direction: Float64
    amount: Float32
    temperature: Float32
    objects: Mapping[str, Float64]
    size: Mapping[str, Float32]
    glow: Mapping[str, Mask]

    def filled(self, rows: Float32) -> Tensor:
        """Fill what is known of L lights, (L, ...), up to (N, ...)."""
        return torch.from_numpy(_filled(list(rows), len(self.kind)).astype(np.float32))

    def seen(self, c2w: Float64, name: str, *, mirrored: bool) -> dict[str, Tensor]:
        """Return what a sample says of the lights, in the axes of a camera; sizes are as object `name` sees them.

        A mirrored picture's camera sees everything with its x negated.
        """
        axes = c2w[:3, :3] * MIRROR if mirrored else c2w[:3, :3]
        placed = self.placed[:, None]
        position = (self.position - c2w[:3, 3]) @ axes * placed
        towards = np.where(placed > 0, self.position - self.objects[name], -self.direction) @ axes
        towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-9)
        return {
            "light_mask": torch.tensor(self.kind > 0),
            "light_kind": torch.tensor(self.kind),
            "light_position": torch.from_numpy(position.astype(np.float32)),
            "light_direction": torch.from_numpy((self.direction @ axes).astype(np.float32)),
            "light_towards": torch.from_numpy(towards.astype(np.float32)),
            "light_amount": torch.tensor(self.amount),
            "light_size": torch.tensor(self.size[name]),
        }


def read_lights(place: Place, index: int, names: tuple[str, ...], count: int) -> SceneLights:
    """Read a scene's lights, in the order of `names`, filled up to `count`; raises `StoreError`."""
    file = f"{scene_folder(index)}/scene.json"
    try:
        record = _Record.from_json(place.read(file, MOST_RECORD).decode())
    except ValueError as error:
        raise StoreError(f"{place.address}/{file} is damaged: {error}") from None
    by_name = {light.name: light for light in record.rig.lights}
    if set(by_name) != set(names):
        raise StoreError(f"{place.address}/{file} has the lights {sorted(by_name)}, its views {sorted(names)}")
    poses = {body.name: np.array(body.world_from_body) for body in record.scene.bodies}
    lights = [by_name[name] for name in names]
    places = [_place(light, poses) for light in lights]
    seen_from = {body.name: poses[body.name][:3, 3] for body in record.scene.bodies if body.insertable}
    return SceneLights(
        kind=_filled([KINDS.index(light.kind) for light in lights], count).astype(np.int64),
        placed=_filled([place is not None for place in places], count),
        position=_filled([NOWHERE if place is None else place for place in places], count),
        direction=_filled([_direction(light) for light in lights], count),
        amount=_filled([light.amount for light in lights], count).astype(np.float32),
        temperature=_filled([_temperature(light) for light in lights], count).astype(np.float32),
        objects=seen_from,
        size={
            name: _filled([angular_diameter(light, eye) or 0.0 for light in lights], count).astype(np.float32)
            for name, eye in seen_from.items()
        },
        glow={
            name: _filled([isinstance(light, EmissiveLight) and light.body == name for light in lights], count) > 0
            for name in seen_from
        },
    )


def _temperature(light: Light) -> float:
    return 0.0 if light.gel is not None else light.colour_temperature or DAYLIGHT


def _place(light: Light, poses: Mapping[str, Float64]) -> Float64 | None:
    match light:
        case EnvironmentLight() | SunLight():
            return None
        case EmissiveLight():
            return np.asarray(poses[light.body][:3, 3])
    return np.array(light.position)


def _direction(light: Light) -> Float64:
    """Return the unit direction in which a light shines, zero where it shines in all."""
    match light:
        case EnvironmentLight() | EmissiveLight():
            return np.zeros(3)
        case AreaLight():
            direction = -np.array(light.world_from_light)[:3, 2]
        case _:
            direction = np.array(light.direction)
    return np.asarray(direction / np.linalg.norm(direction))


def _filled(rows: list[object], count: int) -> Float64:
    values = np.array(rows, np.float64)
    return np.concatenate([values, np.zeros((count - len(values), *values.shape[1:]))])
