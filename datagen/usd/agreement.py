"""Whether two specifications say the same, within what single precision keeps."""

import math
from typing import Any

import numpy as np

from multilight.scenes.frozen import Frozen

RELATIVE, ABSOLUTE = 1e-5, 1e-6


def agree(read: Frozen, written: Frozen) -> bool:
    """Tell whether all numbers agree within 1e-5 (rotations modulo 2 pi, directions by where they point)."""
    return _same(read.model_dump(mode="json"), written.model_dump(mode="json"), "")


def _same(a: Any, b: Any, key: str) -> bool:
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(_same(a[k], b[k], k) for k in a)
    if isinstance(a, list) and isinstance(b, list):
        if key == "direction":
            a, b = (list(np.array(v) / np.linalg.norm(v)) for v in (a, b))
        return len(a) == len(b) and all(_same(x, y, "") for x, y in zip(a, b, strict=True))
    if isinstance(a, bool) or isinstance(b, bool) or not isinstance(a, int | float) or not isinstance(b, int | float):
        return bool(a == b)
    if key in ("rotation", "roll"):
        return abs(math.remainder(a - b, 2 * math.pi)) <= RELATIVE
    return math.isclose(a, b, rel_tol=RELATIVE, abs_tol=ABSOLUTE)
