"""What is measured: each quantity with its unit and bins, and how well values cover them."""

import itertools
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from multilight.scenes.assets.splits import SPLITS

Value = float | str
Section = Literal["scenes", "objects", "lights", "cameras", "pictures"]
MATERIAL_CLASSES = ("mirror", "metal", "glass", "coated", "glossy", "satin", "matte")
LIGHT_KINDS = ("environment", "sun", "point", "spot", "area", "emissive")


@dataclass(frozen=True)
class Quantity:
    """One thing that is measured. `edges` are those of its bins, None for words; `words` are the words that could
    occur (None: only those that do); `log` says that the bins are even in the logarithm."""

    key: str
    section: Section
    title: str
    unit: str = ""
    edges: tuple[float, ...] | None = None
    words: tuple[str, ...] | None = None
    log: bool = False


@dataclass(frozen=True)
class Coverage:
    """How values fill a quantity's bins: `filled` is the fraction of bins that hold any, `evenness` the entropy of the
    fractions over that of even ones (0: all in one bin, 1: all alike; C. E. Shannon 1948); values beyond the bins are
    counted into the outermost.
    """

    labels: tuple[str, ...]
    counts: tuple[int, ...]
    filled: float
    evenness: float


def _even(low: float, high: float, count: int) -> tuple[float, ...]:
    return tuple(float(x) for x in np.linspace(low, high, count + 1))


def _logs(low: float, high: float, count: int) -> tuple[float, ...]:
    return tuple(float(x) for x in np.geomspace(low, high, count + 1))


QUANTITIES: tuple[Quantity, ...] = (
    Quantity("kind", "scenes", "kind of scene"),
    Quantity("split", "scenes", "split", words=SPLITS),
    Quantity("objects", "scenes", "objects a scene", "", _even(0.5, 8.5, 8)),
    Quantity("lights", "scenes", "lights a scene", "", _even(0.5, 8.5, 8)),
    Quantity("glows", "scenes", "an object glows", words=("yes", "no")),
    Quantity("contrast", "scenes", "key over all other light", "stops", _even(-3, 6, 9)),
    Quantity("category", "objects", "category"),
    Quantity("size", "objects", "longest side", "m", _logs(0.02, 1.28, 12), log=True),
    Quantity("material", "objects", "material class", words=MATERIAL_CLASSES),
    Quantity("roughness", "objects", "roughness", "", _even(0, 1, 10)),
    Quantity("metallic", "objects", "metallic", "", _even(0, 1, 5)),
    Quantity("transmission", "objects", "transmission", "", _even(0, 1, 5)),
    Quantity("occlusion", "objects", "hidden fraction of insertables", "", _even(0, 1, 10)),
    Quantity("in_frame", "objects", "insertable's size in frame", "of the shorter side", _even(0, 1, 10)),
    Quantity("shown", "objects", "views that show an insertable", "fraction", _even(0, 1, 10)),
    Quantity("light_kind", "lights", "kind of light", words=LIGHT_KINDS),
    Quantity("elevation", "lights", "elevation", "deg", _even(-30, 90, 12)),
    Quantity("azimuth", "lights", "azimuth from the cameras' side", "deg", _even(-180, 180, 12)),
    Quantity("illuminance", "lights", "illuminance at the objects", "lx", _logs(1, 100_000, 10), log=True),
    Quantity("temperature", "lights", "colour temperature", "K", _logs(1800, 12000, 10), log=True),
    Quantity("saturation", "lights", "colour: distance from white (CIE 1976 u'v')", "", _even(0, 0.3, 10)),
    Quantity("gel", "lights", "gel, where there is one"),
    Quantity("shaped", "lights", "shaped by a profile, gobo or texture", words=("yes", "no")),
    Quantity("angular_size", "lights", "angular size (small: hard shadows)", "deg", _logs(0.05, 180, 12), log=True),
    Quantity("lens", "cameras", "focal length, full-frame equivalent", "mm", _logs(24, 85, 8), log=True),
    Quantity("distance", "cameras", "distance to the objects", "m", _logs(0.2, 12.8, 12), log=True),
    Quantity("camera_elevation", "cameras", "elevation of the camera", "deg", _even(0, 90, 9)),
    Quantity("f_number", "cameras", "f-number, where there is an aperture", "", _logs(1, 16, 8), log=True),
    Quantity("near", "cameras", "near end of the depth (5 %)", "m", _logs(0.2, 12.8, 12), log=True),
    Quantity("depth_range", "cameras", "far over near end of the depth (95 % / 5 %)", "", _logs(1, 64, 12), log=True),
    Quantity("luminance", "pictures", "mean brightness as displayed (sRGB)", "", _even(0, 1, 10)),
    Quantity("colourfulness", "pictures", "colourfulness (Hasler and Süsstrunk 2003)", "", _even(0, 120, 12)),
    Quantity("dynamic_range", "pictures", "dynamic range of the target (99 % / 1 %)", "stops", _even(0, 16, 16)),
)


def coverage_of(quantity: Quantity, values: Sequence[Value]) -> Coverage:
    """Sort values into a quantity's bins."""
    if quantity.edges is None:
        found = Counter(str(value) for value in values)
        rest = [word for word, _ in found.most_common() if word not in (quantity.words or ())]
        labels = (*(quantity.words or ()), *rest)
        counts = tuple(found[label] for label in labels)
    else:
        edges = np.array(quantity.edges)
        inside = np.clip(np.array(values, dtype=np.float64), edges[0], edges[-1])
        counts = tuple(int(n) for n in np.histogram(inside, edges)[0])
        labels = tuple(f"{a:.3g} to {b:.3g}" for a, b in itertools.pairwise(quantity.edges))
    return Coverage(labels, counts, filled_fraction(counts), evenness(counts))


def filled_fraction(counts: Sequence[int]) -> float:
    """Return the fraction of bins that hold anything; 0 where there are none."""
    return sum(count > 0 for count in counts) / len(counts) if counts else 0.0


def evenness(counts: Sequence[int]) -> float:
    """Return the entropy of the fractions, over that of even ones; 0 where there is nothing or one bin only."""
    fractions = np.array([count for count in counts if count > 0], np.float64)
    if len(counts) < 2 or not len(fractions):
        return 0.0
    fractions /= fractions.sum()
    return max(0.0, float(-(fractions * np.log(fractions)).sum() / np.log(len(counts))))
