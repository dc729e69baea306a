"""Add a kind of light that no rig has, a string of bulbs: light adds up, so only the new light is rendered."""

from colorsys import hsv_to_rgb
from pathlib import Path

import numpy as np
from PIL import Image

import multilight
from multilight.datagen.backends.choose import open_backend
from multilight.datagen.backends.protocol import RenderJob, RenderSettings
from multilight.lights.spec import LightRig, PointLight
from multilight.scenes.assets.library import AssetLibrary


def string_of_bulbs(centre: np.ndarray, count: int = 8) -> LightRig:
    """Hang coloured points in a circle of half a metre round a place, 15 cm above it [W/sr]."""
    bulbs = []
    for number, angle in enumerate(np.linspace(0, 2 * np.pi, count, endpoint=False)):
        x, y, z = centre + [0.5 * np.cos(angle), 0.5 * np.sin(angle), 0.15]
        bulbs.append(PointLight(name=f"bulb_{number}", position=(x, y, z), intensity=hsv_to_rgb(number / count, 1, 1)))
    return LightRig(lights=tuple(bulbs))


def main(out: Path) -> None:
    """Render the string as one more layer of a scene, and mix it with the scene's own lights, dimmed."""
    scene = multilight.make_scene(out / "tabletop", preset="tabletop", seed=30, views=4)
    spec, name = scene.record.scene, scene.objects[0]
    rig = string_of_bulbs(np.array(spec.body(name).world_from_body)[:3, 3])
    with open_backend(scene.record.renderer, AssetLibrary()) as backend:
        layers = backend.render(RenderJob(spec, rig, RenderSettings(spp=128), view=0)).radiance
    own, string = scene.mix(0, "all"), layers.sum(axis=0) * (0.2 / layers.sum(axis=0).mean())
    row = np.concatenate([own, string, 0.2 * own + string], axis=1)
    Image.fromarray(multilight.to_display(row)).save(out / "add_a_kind_of_light.jpg", quality=90)


if __name__ == "__main__":
    main(Path("out/examples"))
