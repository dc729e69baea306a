"""Read a dataset with nothing of this project: JSON, numpy and OpenEXR are enough. Run make_a_scene.py before."""

import json
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image


def main(out: Path, folder: str = "tabletop") -> None:
    """Read the last view of scene 0 and put together a background, a composite, the target and the effect."""
    place = out / folder / "scenes" / "000000"
    scene = json.loads((place / "scene.json").read_text())
    parts = OpenEXR.File(str(place / scene["views"][-1]["file"]), separate_channels=True).parts
    channels = {name: channel.pixels.astype("f4") for part in parts for name, channel in part.channels.items()}

    def lit(variant: str, condition: dict) -> np.ndarray:  # a gain for each light and colour, and an exposure
        layers = [
            [gain[c] * channels[f"{variant}.{light}.{'RGB'[c]}"] for c in range(3)]
            for light, gain in condition["gains"].items()
        ]
        return 2 ** condition["exposure_ev"] * np.sum(layers, axis=0).transpose(1, 2, 0)

    base, insert = scene["conditions"][:2]
    *_, name = (body["name"] for body in scene["scene"]["bodies"] if body["insertable"])
    target, background = lit("all", base), lit(f"without_{name}", base)
    composite = lit(f"foreground_{name}", insert) + (1 - channels[f"coverage_{name}.A"])[..., None] * background

    row = np.concatenate([background, composite, target, 0.2 + target - background], axis=1)
    Image.fromarray((np.clip(row, 0, 1) ** (1 / 2.2) * 255).astype("u1")).save(out / "read_with_openexr_alone.jpg")


if __name__ == "__main__":
    main(Path("out/examples"))
