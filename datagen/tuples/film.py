"""A scene as a film: its views in order, lit by one light after another; then the composite against the target."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from PIL import Image, ImageDraw, ImageFilter, ImageFont

from multilight.datagen.files.video import FPS
from multilight.datagen.report import Report
from multilight.datagen.storage.open_dataset import DatasetSource
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.tuples import compose
from multilight.datagen.tuples.condition_files import metered
from multilight.datagen.tuples.sheet import two_conditions
from multilight.lights.display.tonemap import to_display
from multilight.lights.spec import LightingCondition
from multilight.scenes.arrays import Float32, UInt8

HOLD, FADE, SWEEP = 0.9, 0.6, 2.2
"""Seconds: a light is looked at, one picture becomes the next, the divider crosses the picture."""
UNHURRIED = 12
"""Steps from which on each takes less time, so that many views make no long film."""
HEIGHTS = 480, 1080
"""Least and largest height of a film: captions stay sharp on small pictures, and players keep up with large ones."""
BLACK = 0.02
"""Exposed radiance below which nothing is to be seen."""


@dataclass(frozen=True)
class Still:
    """A picture: exposed scene-linear radiance (H, W, 3), and what it is; said on the left, or on the `right`."""

    radiance: Float32
    caption: str
    right: bool = False

    def shown(self) -> UInt8:
        """Return it as the film shows it when nothing moves."""
        return _frame(self.radiance, [(self, 1.0)])


def film(source: DatasetSource, record: SceneRecord, name: str | None, report: Report) -> Iterator[UInt8]:
    """Make the frames (H, W, 3) of a scene's film, `FPS` a second, which ends where it begins.

    `name` is the object of the composites; without one each view shows the one that covers most of it. It is lit by
    the stored condition that is most wrong there. All pictures fade in linear light, as lamps do.
    """
    views, lights = len(record.views), record.rig.names
    view = lru_cache(1)(lambda number: source.view(record, number))
    steps = max(views, len(lights))
    sweeps = views + views % 2  # which end on a target
    pace = min(1.0, UNHURRIED / steps)
    report(0, steps + sweeps, "light by light")
    first = last = Still(compose.target(view(0), record.conditions[0]), record.conditions[0].name)
    yield from _held(first, HOLD)
    for step in range(steps):
        light = lights[step * len(lights) // steps]
        data = view(step * views // steps)
        alone = metered(LightingCondition(name=light, gains={light: (1.0,) * 3}), data)
        still = Still(compose.target(data, alone), light)
        yield from _fade(last, still, FADE * pace)
        yield from _held(still, HOLD * pace)
        last = still
        report(step + 1, steps + sweeps)
    report(steps, steps + sweeps, "composite and target")
    for sweep in range(sweeps):
        data = view(sweep * views // sweeps)
        object_ = name or max(data.coverage, key=lambda each: float(data.coverage[each].sum()))
        _, base = two_conditions(record, sweep)
        truth = compose.target(data, base)
        pasted = (compose.composite(data, object_, insert=insert, base=base) for insert in record.conditions)
        wrong = max(pasted, key=partial(_wrongness, truth))
        target, composite = Still(truth, "target", right=True), Still(wrong, "composite")
        whole = composite if sweep % 2 else target
        yield from _fade(last, whole, FADE * pace)
        yield from _swept(composite, target, SWEEP * pace, leftwards=bool(sweep % 2))
        last = target if sweep % 2 else composite
        report(steps + sweep + 1, steps + sweeps)
    yield from _fade(last, first, FADE)


def _wrongness(truth: Float32, radiance: Float32) -> float:
    """Say how far a composite is from the truth; what is black shows nothing of its light, and counts nothing."""
    return float((np.abs(radiance - truth).clip(max=1.0) * (radiance > BLACK)).sum())


def _times(seconds: float) -> Iterator[float]:
    """Run from 0 to 1, slowly at both ends."""
    count = max(1, round(seconds * FPS))
    for number in range(count):
        at = (number + 1) / (count + 1)
        yield at * at * (3 - 2 * at)


def _held(still: Still, seconds: float) -> Iterator[UInt8]:
    shown = still.shown()
    return (shown for _ in range(max(1, round(seconds * FPS))))


def _fade(old: Still, new: Still, seconds: float) -> Iterator[UInt8]:
    for at in _times(seconds):
        yield _frame((1 - at) * old.radiance + at * new.radiance, [(old, 1 - at), (new, at)])


def _swept(left: Still, right: Still, seconds: float, *, leftwards: bool) -> Iterator[UInt8]:
    """Move a divider across: `left` stands on its left, `right` on its right."""
    one, other = left.shown(), right.shown()
    width = one.shape[1]
    for at in _times(seconds):
        place = round(width * (1 - at if leftwards else at))
        picture = np.concatenate([one[:, :place], other[:, place:]], axis=1)
        picture[:, max(place - 2, 0) : place + 2] //= 2
        picture[:, max(place - 1, 0) : place + 1] = 255
        yield picture


def _frame(radiance: Float32, captions: list[tuple[Still, float]]) -> UInt8:
    """Show radiance in the film's size, with captions of an opacity each."""
    picture = Image.fromarray(to_display(radiance))
    scale = np.clip(picture.height, *HEIGHTS) / picture.height
    width, height = (2 * round(side * scale / 2) for side in picture.size)
    picture = picture.resize((width, height), Image.Resampling.LANCZOS)
    for still, opacity in captions:
        lettering = _lettering(still.caption.replace("_", " "), (width, height), still.right)
        for colour, mask in zip(("black", "white"), lettering, strict=True):
            picture.paste(colour, mask=mask.point(lambda value, opacity=opacity: value * opacity))
    return np.asarray(picture)


@lru_cache(4)
def _lettering(text: str, size: tuple[int, int], right: bool) -> tuple[Image.Image, Image.Image]:
    """Return masks of a caption's shadow and of its letters."""
    width, height = size
    margin = height // 24
    letters = Image.new("L", size)
    place = (width - margin if right else margin, height - margin)
    font = ImageFont.load_default(height // 22)
    ImageDraw.Draw(letters).text(place, text, fill=255, font=font, anchor="rs" if right else "ls")
    return letters.filter(ImageFilter.GaussianBlur(height / 160)), letters
