"""One scene as a USD stage: bodies, lights, cameras, and a variant for each lighting condition."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom

from multilight.datagen.backends.body_parts import body_parts, glowing_parts
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.usd import layout
from multilight.datagen.usd.bodies import add_body, credit
from multilight.datagen.usd.cameras import add_camera, add_render_settings
from multilight.datagen.usd.files import Files
from multilight.datagen.usd.gains import Strength
from multilight.datagen.usd.lights import add_glow, add_light
from multilight.datagen.usd.materials import Materials
from multilight.lights.relight import gain_matrix
from multilight.lights.spec import EmissiveLight, LightingCondition
from multilight.scenes.assets.formats.usd.names import NITS, OWN, RIG, VARIANTS
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.spec import MeshAsset

STAGE = "scene.usdc"


def write_stage(record: SceneRecord, library: AssetLibrary, folder: Path) -> Path:
    """Write a scene's stage and its pictures into a folder; return the stage's path.

    Raises `AssetError` where an asset is missing, `BackendError` where one has changed since the scene was made, or a
    light names no part of it.
    """
    path = folder / STAGE
    stage = Usd.Stage.CreateNew(str(path))
    files = Files(library, folder)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    world = UsdGeom.Xform.Define(stage, layout.WORLD).GetPrim()
    stage.SetDefaultPrim(world)
    Usd.ModelAPI(world).SetKind("component")
    for scope in (layout.BODIES, layout.LIGHTS, layout.CAMERAS, layout.MATERIALS, layout.RENDER):
        UsdGeom.Scope.Define(stage, scope)
    materials = Materials(stage, layout.MATERIALS, files)
    places = _add_bodies(stage, record, library, materials)
    strengths: list[Strength] = []
    for light in record.rig.lights:
        target = f"{layout.LIGHTS}/{light.name}"
        if isinstance(light, EmissiveLight):
            add_glow(stage, target, light, places[light.body, light.part])
        else:
            strengths.append(add_light(stage, target, light, files))
    # Those that a variant speaks of would come first otherwise.
    stage.GetPrimAtPath(layout.LIGHTS).SetChildrenReorder(list(record.rig.names))
    for number, camera in enumerate(record.scene.cameras):
        add_camera(stage, f"{layout.CAMERAS}/view_{number:02d}", camera)
    add_render_settings(stage, f"{layout.CAMERAS}/view_00", record.scene.cameras[0])
    _add_variants(world, record, [*strengths, *materials.strengths])
    _add_metadata(stage, record)
    stage.GetRootLayer().Save()
    return path


def _add_bodies(
    stage: Any, record: SceneRecord, library: AssetLibrary, materials: Materials
) -> dict[tuple[str, int], str]:
    """Write all bodies; return the path of each part by body and number."""
    credits = {asset.id: asset for asset in record.assets}
    places: dict[tuple[str, int], str] = {}
    glowing = glowing_parts(record.scene, record.rig)
    for body in record.scene.bodies:
        path = f"{layout.BODIES}/{body.name}"
        glows = {part: light for (name, part), light in glowing.items() if name == body.name}
        parts = add_body(stage, path, body, body_parts(body, library), materials=materials, glows=glows)
        places |= {(body.name, part): place for part, place in parts.items()}
        if isinstance(body.geometry, MeshAsset) and body.geometry.asset in credits:
            credit(stage.GetPrimAtPath(path), credits[body.geometry.asset])
    return places


def _add_variants(world: Any, record: SceneRecord, strengths: Sequence[Strength]) -> None:
    """Author the lights' strengths: as the rig has them, then under each condition, exposure included."""
    variants = world.GetVariantSets().AddVariantSet(VARIANTS)
    lights = record.rig.names
    plain = LightingCondition.unchanged(lights, RIG)
    for condition in (plain, *record.conditions):
        variants.AddVariant(condition.name)
        variants.SetVariantSelection(condition.name)
        gains = dict(zip(lights, gain_matrix(lights, condition).astype(np.float64), strict=True))
        with variants.GetVariantEditContext():
            for light, set_gain in strengths:
                set_gain(gains[light])
            layout.set_own(world, "exposureEv", Sdf.ValueTypeNames.Double, condition.exposure_ev)
    variants.SetVariantSelection(RIG)


def _add_metadata(stage: Any, record: SceneRecord) -> None:
    """Write the specifications, to the last digit, and who made what."""
    layer = stage.GetRootLayer()
    layer.documentation = (
        "Lights are luminances [cd/m2] and illuminances [lx] at 179 lm/W; the cameras' responsivity of 1/179 gives "
        f"radiance in W/(m2 sr). The variant set '{VARIANTS}' holds the rig and each lighting condition."
    )
    layer.customLayerData = {
        OWN: {
            "schema": layout.SCHEMA,
            "kind": record.scene.kind,
            "index": record.scene.index,
            "emissiveColor": NITS,
            "scene": record.scene.canonical_json(),
            "rig": record.rig.canonical_json(),
            "sceneSha256": record.scene_sha256,
            "rigSha256": record.rig_sha256,
            "credits": {
                f"asset_{number:03d}": asset.model_dump(mode="json") for number, asset in enumerate(record.assets)
            },
        }
    }
