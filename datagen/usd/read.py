"""A stage of the project's own read back: every number from the stage itself, bodies, lights and cameras.

The specifications that lie in the stage's metadata are believed, to the last digit, where the stage still says the
same; what was changed since counts as it is now.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom, UsdLux
from pydantic import ValidationError

from multilight.datagen.errors import UserError
from multilight.datagen.usd import layout
from multilight.datagen.usd.read_bodies import BodyReader
from multilight.datagen.usd.read_lights import read_lights
from multilight.lights.spec import LightRig
from multilight.scenes.assets.formats.usd.names import OWN, RIG, VARIANTS
from multilight.scenes.assets.formats.usd.read import open_stage, world_from_stage
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.frozen import Frozen
from multilight.scenes.poses import matrix4
from multilight.scenes.spec import Camera, SceneSpec

RELATIVE, ABSOLUTE = 1e-5, 1e-6
"""How far numbers may be apart that single precision has kept."""


@dataclass(frozen=True)
class StageScene:
    """A scene as a stage has it; `as_written` tells whether it is the one that was exported, to the last digit."""

    scene: SceneSpec
    rig: LightRig
    as_written: bool


def read_stage(path: Path, library: AssetLibrary) -> StageScene:
    """Read a stage that `multilight export usd` wrote, under the lighting variant of the rig itself.

    `library` has the stage as its background, so that what is not installed, or was changed, is taken from there.
    Raises `AssetError` or `UserError` in one line with the file and the remedy.
    """
    stage = open_stage(path)
    said = stage.GetRootLayer().customLayerData.get(OWN, {})
    if said.get("schema") != layout.SCHEMA:
        raise UserError(
            f"{path} was not written by `multilight export usd` (layout {layout.SCHEMA}); set scenes in it with: "
            f"multilight dataset --kind custom --background {path}"
        )
    _select_rig(stage, path)
    places = UsdGeom.XformCache()
    world = world_from_stage(stage)

    def place(prim: Any) -> Any:
        return world @ np.array(places.GetLocalToWorldTransform(prim)).T

    bodies = BodyReader(path, library, place)
    prims = list(stage.Traverse())
    for prim in prims:
        if prim.IsA(UsdGeom.Mesh):
            bodies.read(prim)
    cameras = tuple(_camera(prim, place(prim), path) for prim in prims if prim.IsA(UsdGeom.Camera))
    if not bodies.bodies or not cameras:
        raise UserError(f"{path} has {len(bodies.bodies)} mesh(es) and {len(cameras)} camera(s); it needs one of each")
    scene = SceneSpec(kind=said["kind"], index=said["index"], bodies=tuple(bodies.bodies), cameras=cameras)
    shining = [p for p in prims if p.HasAPI(UsdLux.LightAPI) or p.GetRelationship(layout.own("part"))]
    rig = LightRig(lights=read_lights(path, shining, place, bodies=bodies, library=library))
    written = _written(said)
    if written is not None and agree(scene, written[0]) and agree(rig, written[1]):
        return StageScene(*written, as_written=True)
    return StageScene(scene, rig, as_written=False)


def _written(said: dict[str, Any]) -> tuple[SceneSpec, LightRig] | None:
    """Return the specifications in a stage's metadata; None where they were removed or damaged."""
    try:
        return SceneSpec.from_json(said["scene"]), LightRig.from_json(said["rig"])
    except (KeyError, ValidationError):
        return None


def _select_rig(stage: Any, path: Path) -> None:
    """Choose the rig's variant for this reading only."""
    world = stage.GetPrimAtPath(layout.WORLD)
    variants = world.GetVariantSet(VARIANTS) if world else None
    if variants is None or RIG not in variants.GetVariantNames():
        raise UserError(f"{path} has no variant {RIG!r} of {VARIANTS!r} on {layout.WORLD}; export the scene again")
    with Usd.EditContext(stage, stage.GetSessionLayer()):
        variants.SetVariantSelection(RIG)


def _camera(prim: Any, pose: Any, path: Path) -> Camera:
    """Read a camera; its size in pixels is its own, else that of the stage's render settings."""
    camera = UsdGeom.Camera(prim)
    size = layout.get_own(prim, "resolution")
    if size is None:
        settings = prim.GetStage().GetPrimAtPath(f"{layout.RENDER}/settings")
        size = settings.GetAttribute("resolution").Get() if settings else None
    if size is None:
        raise UserError(f"{path}: the camera {prim.GetPath()} has no size; give it int2 {layout.own('resolution')}")
    width, height = int(size[0]), int(size[1])
    across, down = (float(a.Get()) for a in (camera.GetHorizontalApertureAttr(), camera.GetVerticalApertureAttr()))
    focal, stop = float(camera.GetFocalLengthAttr().Get()), float(camera.GetFStopAttr().Get())
    unit = float(UsdGeom.GetStageMetersPerUnit(prim.GetStage()))
    pose = pose.copy()
    pose[:3, :3] /= np.linalg.norm(pose[:3, :3], axis=0)
    return Camera(
        width=width,
        height=height,
        fx=focal / across * width,
        fy=focal / down * height,
        cx=width / 2 - float(camera.GetHorizontalApertureOffsetAttr().Get()) / across * width,
        cy=height / 2 + float(camera.GetVerticalApertureOffsetAttr().Get()) / down * height,
        c2w=matrix4(pose),
        aperture_radius=focal / 10 * unit / (2 * stop) if stop > 0 else 0.0,
        focus_distance=float(camera.GetFocusDistanceAttr().Get()) * unit,
    )


def agree(read: Frozen, written: Frozen) -> bool:
    """Tell whether all numbers agree within 1e-5 (rotations modulo 2 pi, directions by where they point)."""
    return _same(read.model_dump(mode="json"), written.model_dump(mode="json"), "")


def _same(a: Any, b: Any, key: str) -> bool:
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(_same(a[k], b[k], k) for k in a)
    if isinstance(a, list) and isinstance(b, list):
        if key == "direction":
            a, b = (list(np.array(v) / np.linalg.norm(v)) for v in (a, b))
        return len(a) == len(b) and all(_same(x, y, "") for x, y in zip(a, b, strict=True))
    if isinstance(a, bool) or isinstance(b, bool) or not isinstance(a, int | float) or not isinstance(b, int | float):
        return bool(a == b)
    if key in ("rotation", "roll"):
        return abs(math.remainder(a - b, 2 * math.pi)) <= RELATIVE
    return math.isclose(a, b, rel_tol=RELATIVE, abs_tol=ABSOLUTE)
