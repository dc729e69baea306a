"""Small scenes on which two renderers must agree: each kind of light, each kind of surface."""

import math

import numpy as np

from multilight.datagen.backends.protocol import RenderJob, RenderSettings
from multilight.lights.spec import (
    AreaLight,
    EmissiveLight,
    EnvironmentLight,
    Light,
    LightRig,
    PointLight,
    SpotLight,
    SunLight,
)
from multilight.scenes.cameras.pinhole import camera_from_fov, look_at, matrix4
from multilight.scenes.spec import Body, Material, Rectangle, SceneSpec, Sphere, Texture
from tests.datagen.backends.contract_scenes import placed

SIZE = 96
GREY = Material(name="grey", base_color=(0.5, 0.45, 0.4), roughness=1.0, ior=1.0)

SURFACES: dict[str, Material] = {
    "diffuse": GREY,
    "plastic": Material(base_color=(0.2, 0.4, 0.6), roughness=0.4),
    "rough_plastic": Material(base_color=(0.6, 0.3, 0.2), roughness=0.8),
    "polished": Material(base_color=(0.5, 0.1, 0.1), roughness=0.12),
    "rough_metal": Material(base_color=(0.9, 0.6, 0.3), roughness=0.5, metallic=1.0),
    "metal": Material(base_color=(0.9, 0.9, 0.9), roughness=0.15, metallic=1.0),
    "half_metal": Material(base_color=(0.7, 0.5, 0.3), roughness=0.3, metallic=0.5),
    "coated": Material(base_color=(0.1, 0.4, 0.2), roughness=0.6, coat=1.0, coat_roughness=0.1),
    "glass": Material(base_color=(0.9, 0.95, 0.9), roughness=0.0, ior=1.5, transmission=1.0),
    "frosted": Material(base_color=(0.9, 0.9, 0.95), roughness=0.4, ior=1.45, transmission=1.0),
    "textured": Material(base_color_texture=Texture(image="builtin/wood-ash", repeat=(2.0, 1.0)), roughness=0.5),
    "bumped": Material(base_color=(0.6, 0.6, 0.6), roughness=0.4,
                       normal_texture=Texture(image="builtin/weave-basket-normal", repeat=(2.0, 1.0))),
    "see_through": Material(base_color=(0.7, 0.2, 0.2), roughness=0.5, opacity=0.6),
}  # fmt: skip

SKY = EnvironmentLight(name="sky", map="builtin/hdri-courtyard", rotation=0.6)
PANEL_POSE = look_at((1.5, -1.5, 2.0), (0.0, 0.0, 0.3))
DISK_POSE = look_at((-1.2, 1.3, 1.8), (0.0, 0.0, 0.3))
LIGHTS: dict[str, Light] = {
    "environment": SKY,
    "uniform": EnvironmentLight(name="uniform", radiance=(0.3, 0.4, 0.5)),
    "sun": SunLight(name="sun", direction=(-0.6, 0.5, -1.0), irradiance=(3.0, 2.8, 2.5), angle=0.05),
    "point": PointLight(name="point", position=(-1.0, -1.0, 1.6), intensity=(2.0, 1.5, 1.0)),
    "bulb": PointLight(name="bulb", position=(-1.0, -1.0, 1.6), intensity=(2.0, 1.5, 1.0), radius=0.15),
    "spot": SpotLight(name="spot", position=(1.2, -1.0, 1.8), direction=(-1.2, 1.0, -1.5), intensity=(4.0, 4.0, 5.0),
                      half_angle=0.35, blend=0.4, radius=0.05),
    "rectangle": AreaLight(name="rectangle", width=0.8, height=0.4, world_from_light=matrix4(PANEL_POSE),
                           radiance=(5.0, 4.0, 3.0)),
    "disk": AreaLight(name="disk", shape="disk", width=0.6, height=0.6, world_from_light=matrix4(DISK_POSE),
                      radiance=(5.0, 5.0, 5.0)),
    "emissive": EmissiveLight(name="emissive", body="lamp", radiance=(6.0, 4.0, 2.0)),
}  # fmt: skip


def calibration_scene(material: Material) -> SceneSpec:
    """A ball of the material and a lamp-to-be on a grey ground."""
    bodies = (
        Body(name="ground", role="support", category="test", geometry=Rectangle(width=6.0, height=6.0),
             materials=(GREY,), world_from_body=matrix4(np.eye(4))),
        Body(name="ball", role="object", category="test", geometry=Sphere(radius=0.4), materials=(material,),
             world_from_body=matrix4(placed(0.0, 0.0, 0.4)), insertable=True),
        Body(name="lamp", role="object", category="test", geometry=Sphere(radius=0.15),
             materials=(Material(base_color=(0.0, 0.0, 0.0), roughness=1.0, ior=1.0),),
             world_from_body=matrix4(placed(0.7, -0.3, 0.15))),
    )  # fmt: skip
    camera = camera_from_fov(look_at((0.3, -2.6, 1.2), (0.1, 0.0, 0.3)), width=SIZE, height=SIZE, fov=math.radians(38))
    return SceneSpec(kind="custom", index=0, bodies=bodies, cameras=(camera,))


def calibration_job(material: Material, lights: tuple[Light, ...], spp: int) -> RenderJob:
    """Build the job of a calibration scene."""
    settings = RenderSettings(spp=spp, max_bounces=8, threads=2)
    return RenderJob(calibration_scene(material), LightRig(lights=lights), settings, 0)
