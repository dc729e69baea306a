"""Harmonize what the ready-made model has never seen: objects pasted into scenes whose light they do not have."""

from pathlib import Path

import numpy as np
from PIL import Image

import multilight


def main(out: Path) -> None:
    """Make six scenes of the test split; show of each a background, a composite, the model's result and the target."""
    unseen = {"train": 0, "test": 1, "val": 0}
    data = multilight.make(
        out / "unseen", preset="mixed", splits=unseen, seed=30, scenes=6, views=1, width=320, height=320
    )
    rows = []
    for scene in data:
        covered = scene.view().coverage
        made = scene.tuple(0, max(covered, key=lambda name: covered[name].sum()), insert_condition=7)
        background, composite, target = map(multilight.to_display, (made.background, made.composite, made.target))
        result = multilight.harmonize(composite, background, made.mask, made.depth)
        off = [np.square(picture / 255.0 - target / 255.0).mean() for picture in (result, composite)]
        rows.append((off[0] / off[1], [around(made.mask, p) for p in (background, composite, result, target)]))
        print(f"scene {scene.index}: {-10 * np.log10(off[0] / off[1]):+.1f} dB")
    rows.sort(key=lambda row: row[0])
    Image.fromarray(np.concatenate([np.concatenate(row, axis=1) for _, row in rows])).save(out / "harmonize_it.jpg")


def around(mask: np.ndarray, picture: np.ndarray) -> np.ndarray:
    """Cut out the square in which the object and what it changes can be seen, as 192 x 192 pixels."""
    half = min(int(1.5 * np.sqrt(mask.sum())) + 8, *(side // 2 for side in mask.shape))
    y, x = np.clip(np.argwhere(mask > 0).mean(0).astype(int), half, np.array(mask.shape) - half)
    return np.asarray(Image.fromarray(picture).resize((192, 192), box=(x - half, y - half, x + half, y + half)))


if __name__ == "__main__":
    main(Path("out/examples"))
