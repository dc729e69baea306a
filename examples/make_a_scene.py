"""Make a scene: objects on a table, lit by a rig of lights, seen by four cameras. Run again, it is only opened."""

from pathlib import Path

import numpy as np
from PIL import Image

import multilight


def main(out: Path) -> None:
    """Make the scene; any other setting that `multilight config show` lists can be given as well."""
    scene = multilight.make_scene(out / "tabletop", preset="tabletop", seed=30, views=4)

    print(scene)
    for body in scene.record.scene.bodies:
        print(f"  {body.role:12} {body.name:24}", "can be taken out" if body.name in scene.objects else "")
    for light in scene.record.rig.lights:
        print(f"  {light.kind:12} {light.name:24} {light.colour_temperature or '-'} K")

    pictures = [multilight.to_display(scene.mix(view, "all")) for view in range(scene.views)]
    Image.fromarray(np.concatenate(pictures, axis=1)).save(out / "make_a_scene.jpg", quality=90)


if __name__ == "__main__":
    main(Path("out/examples"))
