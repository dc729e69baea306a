"""Reading a dataset: scenes, pictures under any lighting, tuples for compositing, verification."""

from collections.abc import Iterator, Mapping
from numbers import Integral
from pathlib import Path
from typing import NamedTuple

import numpy as np
import polars as pl
from numpy.typing import NDArray

from multilight.datagen.errors import UserError
from multilight.datagen.storage.manifest import CopyFault
from multilight.datagen.storage.open_dataset import DatasetSource, OnBroken, open_dataset, select
from multilight.datagen.storage.records import DatasetRecord, SceneRecord
from multilight.datagen.storage.store import ViewData
from multilight.datagen.tuples import compose
from multilight.datagen.tuples.condition_files import check_condition, check_lights, find_condition, metered
from multilight.datagen.verification.copies import copy_at, verify_copy
from multilight.datagen.verification.dataset import verify_dataset
from multilight.datagen.verification.views import Fault
from multilight.lights.spec import LightingCondition
from multilight.scenes.arrays import Float32

Gain = float | tuple[float, float, float]
Lighting = str | int | Mapping[str, Gain] | LightingCondition
"""A condition's name (or a JSON file of one), the seed of a random one, a gain for each light (a number, or one for
each of red, green and blue; lights that are not named are off), or a condition as it is."""
Names = tuple[str, ...]


class CompositingTuple(NamedTuple):
    """What compositing learns from; scene-linear radiance, float32.

    composite (H, W, 3): the object as lit by one lighting, pasted over the background as lit by another; background
    (H, W, 3): without the object; depth (H, W): along the optical axis [m], 0 where there is nothing; target (H, W, 3):
    the object in its place under the background's lighting; mask (H, W): the object's share of each pixel.
    """

    composite: Float32
    background: Float32
    depth: Float32
    target: Float32
    mask: Float32


class Scene:
    """A scene of a dataset; its pictures are mixed from stored layers, nothing is rendered.

    The view that was read last is kept, so that further lightings of it cost only arithmetic.
    """

    def __init__(self, source: DatasetSource, record: SceneRecord) -> None:
        """Take a record of an opened dataset; `Dataset` does so."""
        self.record = record
        """All that is known of the scene: bodies, materials, cameras, lights, credits (`scene.json`)."""
        self._source = source
        self._kept: tuple[int, ViewData] | None = None

    def __repr__(self) -> str:
        return f"<Scene {self.index}: {self.record.scene.kind}, {self.views} views, lights {', '.join(self.lights)}>"

    @property
    def index(self) -> int:
        """The scene's number in its dataset."""
        return self.record.index

    @property
    def views(self) -> int:
        """How many views there are; they count from 0."""
        return len(self.record.views)

    @property
    def lights(self) -> Names:
        """Names of the lights, one a layer."""
        return self.record.rig.names

    @property
    def objects(self) -> Names:
        """Names of the objects that can be taken out."""
        return self.record.scene.insertable

    @property
    def conditions(self) -> Names:
        """Names of the stored lighting conditions."""
        return tuple(condition.name for condition in self.record.conditions)

    def view(self, view: int = 0) -> ViewData:
        """Return all that is stored of a view: layers by variant and light, coverages, depth, normals, albedo, ids.

        Raises `UserError` where there is no such view or it is damaged.
        """
        if not _whole(view) or not 0 <= view < self.views:
            raise UserError(f"view {view!r} must be a whole number from 0 to {self.views - 1}")
        if self._kept is None or self._kept[0] != view:
            self._kept = None  # first, so that two views are never held
            self._kept = int(view), self._source.view(self.record, int(view))
        return self._kept[1]

    def condition(self, lighting: Lighting, view: int = 0, *, exposure_ev: float | None = None) -> LightingCondition:
        """Return a lighting as gains and exposure, to use for several views or to keep (`model_dump_json`).

        Random ones and plain gains are exposed as a camera would on this view, unless `exposure_ev` says how: at 0,
        pictures are radiance, and those of single lights add up. Raises `UserError` naming what is allowed.
        """
        condition = self._found(lighting, view, expose=exposure_ev is None)
        if exposure_ev is None:
            return condition
        return check_condition(condition.model_dump() | {"exposure_ev": exposure_ev}, "condition", self.record.rig)

    def mix(
        self,
        view: int = 0,
        condition: Lighting = "all",
        *,
        without: str | None = None,
        exposure_ev: float | None = None,
    ) -> Float32:
        """Return a picture of a view under any lighting, (H, W, 3) scene-linear float32; `without` takes an object out.

        `condition` and `exposure_ev` are as in `Scene.condition`. `multilight.to_display` makes 8 bits of it.
        """
        lit = self.condition(condition, view, exposure_ev=exposure_ev)
        data = self.view(view)
        return compose.target(data, lit) if without is None else compose.background(data, without, lit)

    def tuple(
        self, view: int = 0, object: str | None = None, *, condition: Lighting = "all", insert_condition: Lighting = 0
    ) -> CompositingTuple:
        """Return composite, background, depth, target and mask of an object (the first, unless named).

        The scene is lit by `condition`, the object in the composite by `insert_condition`.
        """
        name = self.objects[0] if object is None else object
        base, insert = self.condition(condition, view), self.condition(insert_condition, view)
        data = self.view(view)
        return CompositingTuple(
            composite=compose.composite(data, name, insert=insert, base=base),
            background=compose.background(data, name, base),
            depth=data.geometry.z_depth,
            target=compose.target(data, base),
            mask=data.coverage[name],
        )

    def depth(self, view: int = 0) -> Float32:
        """Return a view's depth along the optical axis [m], (H, W) float32; 0 where there is nothing."""
        return self.view(view).geometry.z_depth

    def normal(self, view: int = 0) -> Float32:
        """Return a view's unit normals in world axes (+Z up), (H, W, 3) float32; 0 where there is nothing."""
        return self.view(view).geometry.normal_world

    def albedo(self, view: int = 0) -> Float32:
        """Return a view's base colours, (H, W, 3) float32 linear."""
        return self.view(view).geometry.albedo

    def ids(self, view: int = 0) -> NDArray[np.uint16]:
        """Return which body each pixel shows, (H, W): its place in `record.scene.bodies` plus one, 0 for nothing."""
        return self.view(view).geometry.instance_id

    def _found(self, lighting: Lighting, view: int, *, expose: bool) -> LightingCondition:
        data, rig = self.view(view), self.record.rig
        match lighting:
            case str():
                return find_condition(lighting, self.record, data)
            case _ if _whole(lighting):
                return find_condition(f"random:{lighting}", self.record, data)
            case LightingCondition():
                check_lights(lighting.gains, "condition", rig)
                return lighting
            case Mapping():
                condition = check_condition({"name": "given", "gains": dict(lighting)}, "condition", rig)
                return metered(condition, data) if expose else condition
        raise UserError(f"condition {lighting!r} is no lighting; {self._allowed()}")

    def _allowed(self) -> str:
        return (
            f"give one of {list(self.conditions)}, a seed, a gain for each of {list(self.lights)}, or a "
            "LightingCondition"
        )


class Dataset:
    """An opened dataset, a sequence of scenes; nothing in it is ever changed.

    `address` is where it lies, `record` its `dataset.json` (configuration, versions, licences), `table` its index: a
    polars frame with a row a scene.
    """

    def __init__(self, source: DatasetSource) -> None:
        """Wrap an opened dataset; `open` does so."""
        self._source = source

    def __repr__(self) -> str:
        return f"<Dataset {self.address}: {len(self)} scenes>"

    @property
    def address(self) -> str:
        """The folder or address, as it was given."""
        return self._source.address

    @property
    def record(self) -> DatasetRecord:
        """Configuration, versions and every asset's creator and licence."""
        return self._source.record

    @property
    def table(self) -> pl.DataFrame:
        """The index, a row a scene; `multilight query DIR --describe` says what its columns mean."""
        return self._source.table

    @property
    def skipped(self) -> dict[int, str]:
        """Scenes that were passed over while iterating (`on_broken="skip"`), with the reason."""
        return self._source.skipped

    def __len__(self) -> int:
        return len(self._source.indices)

    def __iter__(self) -> Iterator[Scene]:
        return (Scene(self._source, record) for record in self._source.scenes())

    def __getitem__(self, position: int) -> Scene:
        """Return the scene at a position, as in a list; raises `UserError` where there is none or it is damaged."""
        count = len(self)
        if not _whole(position) or not -count <= position < count:
            raise UserError(f"scene {position!r} is not in {self.address}; it holds {count}, counted from 0")
        return self.scene(self._source.indices[position])

    def scene(self, index: int) -> Scene:
        """Return the scene of that number, which is its position where the dataset is whole and was not narrowed."""
        if index not in self._source.indices:
            raise UserError(f"there is no scene {index!r} in {self.address}; it has {list(self._source.indices)[:20]}")
        return Scene(self._source, self._source.scene(index))

    def query(self, where: str) -> pl.DataFrame:
        """Return the rows of the index for which an SQL expression holds, `kind = 'room' and emissive`, say.

        `open(address, where=...)` opens those scenes only.
        """
        return select(self.table, where)


def open(address: str | Path, *, where: str | None = None, on_broken: OnBroken = "raise") -> Dataset:
    """Open a dataset for reading: a folder, or any address that fsspec knows (`s3://bucket/set`).

    `where`, an SQL expression over the index, chooses scenes. With `on_broken="skip"`, iterating passes over scenes
    that cannot be read. Raises `UserError`.
    """
    if on_broken not in ("raise", "skip"):
        raise UserError(f"on_broken {on_broken!r} must be 'raise' or 'skip'")
    return Dataset(open_dataset(address, where=where, on_broken=on_broken))


def verify(address: str | Path, *, quick: bool = False) -> list[Fault | CopyFault]:
    """List what is wrong with a dataset, a packed copy or an export; an empty list is a sound one.

    `quick` looks at names, sizes, records and the index, not at what the pictures hold. Raises `UserError` where there
    is none of these.
    """
    if (copy := copy_at(str(address))) is not None:
        return list(verify_copy(copy, quick=quick))
    return [fault for _, faults in verify_dataset(str(address), quick=quick).results for fault in faults]


def _whole(value: object) -> bool:
    """Tell whether a value is a whole number; numpy's are, True and False are not."""
    return isinstance(value, Integral) and not isinstance(value, bool)
