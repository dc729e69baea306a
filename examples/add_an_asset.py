"""Add models of your own: a folder of GLB, glTF or OBJ files, and a table that says what the files cannot."""

from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

import multilight


def main(out: Path) -> None:
    """Turn twelve vases, then make scenes that draw from them as from all other objects; show those that have some."""
    models = out / "turned"
    models.mkdir(parents=True, exist_ok=True)
    table = ["file,category,licence,metres_per_unit,up_axis"]
    for number in range(12):
        height = np.linspace(0.0, 0.24, 60)
        radius = 0.05 + 0.02 * np.sin(height * (20 + 6 * number) + number) * np.linspace(1.0, 0.6, 60)
        outline = np.stack([np.r_[0.0, radius, 0.0], np.r_[0.0, height, 0.24]], axis=1)
        vase = trimesh.creation.revolve(outline, sections=64)
        colour = [0.35 + 0.05 * number, 0.2, 0.12, 1.0]
        wood = trimesh.visual.material.PBRMaterial(baseColorFactor=colour, roughnessFactor=0.4, metallicFactor=0.0)
        vase.visual = trimesh.visual.TextureVisuals(material=wood)
        vase.export(models / f"vase_{number:02d}.glb")
        table.append(f"vase_{number:02d}.glb,turned {number},CC0,1,Z")
    (models / "assets.csv").write_text("\n".join(table))

    data = multilight.make(out / "own", preset="tabletop", assets=models, seed=30, scenes=3, views=1, objects=(8, 8))
    mine = data.query("array_to_string(categories, ' ') like '%turned%'")["index"].to_list()
    print(f"scenes {mine} of {len(data)} show some of them")
    shown = [multilight.to_display(data.scene(index).mix(0, "all")) for index in mine or [0]]
    Image.fromarray(np.concatenate(shown, axis=1)).save(out / "add_an_asset.jpg", quality=90)


if __name__ == "__main__":
    main(Path("out/examples"))
