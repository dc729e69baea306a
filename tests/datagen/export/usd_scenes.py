"""Scenes with every kind of body, material and light, as records to export; and a stage rendered by Blender itself."""

import subprocess
import sys
from pathlib import Path

import numpy as np

from multilight.datagen.storage.records import AssetCredit, SceneRecord
from multilight.lights.photometry.luminaires import luminaire
from multilight.lights.spec import (
    AreaLight,
    EmissiveLight,
    EnvironmentLight,
    LightingCondition,
    LightRig,
    PointLight,
    SpotLight,
    SunLight,
)
from multilight.scenes.arrays import Float32, Float64
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.cameras.pinhole import camera_from_fov, look_at
from multilight.scenes.poses import direction_from, matrix4
from multilight.scenes.spec import Body, Camera, Material, MeshAsset, Rectangle, SceneSpec, Sphere, Texture
from tests import ROOT

CHECKS = Texture(image="builtin/check-green", repeat=(2.5, 1.5))


def body(name: str, geometry: Sphere | Rectangle | MeshAsset, pose: Float64, *materials: Material) -> Body:
    return Body(
        name=name,
        role="object" if isinstance(geometry, MeshAsset) else "support",
        category="thing",
        geometry=geometry,
        materials=materials,
        world_from_body=matrix4(pose),
        insertable=isinstance(geometry, MeshAsset),
    )


def moved(x: float, y: float, z: float, *, turn: float = 0.0, scale: float = 1.0) -> Float64:
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    pose[:3, :3] *= scale
    pose[:3, 3] = x, y, z
    return pose


def scene(library: AssetLibrary, *, size: int = 64) -> SceneSpec:
    """A floor with every texture, a ball, a clear pane, a cut-out, and a model of two parts that glows."""
    bulb = library.mesh("builtin/bulb-01")
    model = MeshAsset(asset="builtin/bulb-01", mesh_sha256=bulb.sha256(), parts=len(bulb.parts))
    floor = Material(
        name="tiles",
        base_color=(0.9, 0.7, 0.5),
        base_color_texture=CHECKS,
        roughness=0.8,
        roughness_texture=CHECKS.model_copy(update={"image": "builtin/check-green-roughness"}),
        normal_texture=CHECKS.model_copy(update={"image": "builtin/check-green-normal"}),
        coat=0.25,
        coat_roughness=0.1,
    )
    brass = Material(name="brass", base_color=(0.8, 0.6, 0.3), metallic=1.0, roughness=0.35)
    pane = Material(name="pane", base_color=(0.9, 0.95, 1.0), transmission=0.9, roughness=0.05, ior=1.45, opacity=0.8)
    veil = Material(name="veil", base_color_texture=CHECKS, opacity=0.6, opacity_from_alpha=True)
    wall = moved(0.0, 0.9, 0.5)
    wall[:3, :3] = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    bodies = (
        body("floor", Rectangle(width=2.4, height=2.0), moved(0, 0, 0), floor),
        body("ball", Sphere(radius=0.18), moved(-0.35, 0.1, 0.18), brass),
        body("bulb", model, moved(0.3, 0.1, 0.0, turn=0.7, scale=2.5), *(p.material for p in bulb.parts)),
        body("pane", Rectangle(width=0.3, height=0.3), wall, pane),
        body("veil", Rectangle(width=0.2, height=0.2), moved(0.6, -0.4, 0.05), veil),
    )
    view = camera_from_fov(look_at((0.3, -1.8, 0.9), (0, 0.1, 0.15)), width=size, height=size, fov=0.8)
    odd = Camera(
        width=size,
        height=size * 3 // 4,
        fx=1.3 * size,
        fy=1.1 * size,
        cx=0.55 * size,
        cy=0.3 * size,
        c2w=view.c2w,
        aperture_radius=0.004,
        focus_distance=1.9,
    )
    return SceneSpec(kind="tabletop", index=7, bodies=bodies, cameras=(view, odd))


def rig() -> LightRig:
    """A light of every kind, with everything that one can have."""
    pose = look_at((1.0, -0.5, 1.2), (0, 0, 0))
    return LightRig(
        lights=(
            EnvironmentLight(name="sky", map="builtin/sky-3-2", radiance=(0.02, 0.025, 0.03), rotation=1.1),
            SunLight(name="sun", direction=(0.5, 1.0, -2.0), irradiance=(1.2, 1.0, 0.8), angle=0.01),
            PointLight(name="point", position=(-0.8, -0.4, 1.0), intensity=(0.3, 0.2, 0.1)),
            PointLight(
                name="lamp",
                position=(0.2, 0.6, 1.3),
                intensity=(0.4, 0.4, 0.2),
                radius=0.05,
                direction=tuple(direction_from(0.3, -1.1).tolist()),
                profile=luminaire("wall_washer").profile,
                colour_temperature=3000.0,
            ),
            EmissiveLight(name="bulb_glow", body="bulb", part=1, radiance=(3.0, 2.0, 1.0), gel="amber"),
            SpotLight(
                name="spot",
                position=(0.9, -0.9, 1.4),
                direction=(-1.0, 1.1, -1.5),
                intensity=(1.5, 1.2, 0.9),
                half_angle=0.4,
                blend=0.3,
                radius=0.02,
                gobo="builtin/gobo-window-2x3",
                roll=0.5,
            ),
            AreaLight(name="panel", width=0.5, height=0.3, world_from_light=matrix4(pose), radiance=(1.0, 2.0, 3.0)),
            AreaLight(
                name="disk",
                shape="disk",
                width=0.3,
                height=0.2,
                world_from_light=matrix4(look_at((-1.0, -0.5, 1.0), (0, 0, 0))),
                radiance=(4.0, 2.0, 1.0),
            ),
        )
    )


def record_of(spec: SceneSpec, lit: LightRig) -> SceneRecord:
    """A record without views, with two lightings."""
    dim = LightingCondition(name="dim", gains={lit.names[0]: (0.5, 0.25, 2.0), lit.names[-1]: (3, 1, 0)}, exposure_ev=1)
    every = LightingCondition(name="all", gains=dict.fromkeys(lit.names, (1.0, 1.0, 1.0)), exposure_ev=-0.5)
    return SceneRecord(
        seed=0,
        index=7,
        attempt=0,
        renderer="cycles",
        denoised=False,
        scene=spec,
        scene_sha256=spec.sha256(),
        rig=lit,
        rig_sha256=lit.sha256(),
        conditions=(every, dim),
        views=(),
        assets=(AssetCredit(id="builtin/bulb-01", pack="builtin", name="Bulb", creator="somebody", licence="CC0"),),
    )


_RENDER = """
import os, sys
from multilight.datagen.backends import blender
from multilight.datagen.backends.protocol import RenderSettings
import bpy, numpy as np
from multilight.datagen.backends.blender.film import beauty_filter, configure, render_passes
stage, out, camera, size, spp = sys.argv[1], sys.argv[2], sys.argv[3], int(sys.argv[4]), int(sys.argv[5])
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.world = bpy.data.worlds.new("world")
bpy.ops.wm.usd_import(filepath=stage)
for lamp in bpy.data.lights:
    if lamp.type == "SUN":
        lamp.energy /= 4  # Blender takes four times a distant light's illuminance
scene.camera = bpy.data.objects[camera]
scene.render.resolution_x = scene.render.resolution_y = size
configure(RenderSettings(spp=spp, threads=2), ())
beauty_filter(spp)
np.save(out, render_passes()["Combined"][..., :3])
os._exit(0)
"""


def blender_render(stage: Path, camera: str, *, size: int, spp: int) -> Float32:
    """Open a stage in a Blender of its own and render it with Cycles: luminance, (size, size, 3)."""
    out = stage.with_name("blender.npy")
    command = [sys.executable, "-c", _RENDER, str(stage), str(out), camera, str(size), str(spp)]
    subprocess.run(command, check=True, capture_output=True, cwd=ROOT)
    return np.asarray(np.load(out))
