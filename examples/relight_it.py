"""Relight a scene that was rendered once: by name, by gains, by chance; and with an object taken out or lit wrongly."""

from pathlib import Path

import numpy as np
from PIL import Image

import multilight


def main(out: Path) -> None:
    """Mix eight pictures of one view, four a row; nothing is rendered after the scene is there."""
    scene = multilight.make_scene(out / "tabletop", preset="tabletop", seed=30, views=4)
    view, key, name = scene.views - 1, scene.lights[0], scene.objects[-1]

    pictures = [
        scene.mix(view, "all"),  # a stored condition
        scene.mix(view, {key: 1.0}),  # one light, exposed as a camera would
        scene.mix(view, dict.fromkeys(scene.lights, (1.0, 0.6, 0.3))),  # gains for red, green and blue
        scene.mix(view, 7),  # a random one; scene.condition(7, view) says which
    ]
    pair = scene.tuple(view, name, condition="all", insert_condition={key: 1.0})
    effect = pair.target - pair.background  # shadow, reflection, glow: signed
    pictures += [pair.background, pair.composite, pair.target, 0.2 + effect]

    shown = [multilight.to_display(picture) for picture in pictures]
    rows = [np.concatenate(shown[start : start + 4], axis=1) for start in (0, 4)]
    Image.fromarray(np.concatenate(rows)).save(out / "relight_it.jpg", quality=90)


if __name__ == "__main__":
    main(Path("out/examples"))
