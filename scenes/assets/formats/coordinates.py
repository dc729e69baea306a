"""How pictures lie on a surface, and one set of texture coordinates for all pictures of a material."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from multilight.scenes.arrays import Float64

Wrap = Literal["repeat", "clamp", "mirror"]
Affine = tuple[float, float, float, float, float, float]
"""Rows (a, b, c), (d, e, f): u' = a u + b v + c, v' = d u + e v + f."""
IDENTITY: Affine = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)


@dataclass(frozen=True)
class Place:
    """A picture is looked up at `affine` of the coordinates of a UV layer."""

    layer: str = ""
    affine: Affine = IDENTITY
    wrap: Wrap = "repeat"

    def within(self, chosen: "Place") -> tuple[float, float] | None:
        """Return how often the picture repeats in chosen coordinates; None where it lies in them in another way."""
        if self.layer != chosen.layer or abs(np.linalg.det(matrix(chosen.affine))) < 1e-12:
            return None
        relative = matrix(self.affine) @ np.linalg.inv(matrix(chosen.affine))
        scale_u, shear_u, u, shear_v, scale_v, v = relative[:2].ravel()
        whole = self.wrap == "repeat" and abs(u - round(u)) < 1e-6 and abs(v - round(v)) < 1e-6
        if abs(shear_u) + abs(shear_v) > 1e-6 or not (whole or abs(u) + abs(v) < 1e-6) or min(scale_u, scale_v) <= 0:
            return None
        return float(round(scale_u, 6)), float(round(scale_v, 6))


MESH = Place()
"""The coordinates of the mesh as they are."""


def matrix(affine: Affine) -> Float64:
    """Return an affine map of the plane as (3, 3)."""
    return np.array([affine[:3], affine[3:], (0, 0, 1)], np.float64)


def affine_of(linear: Float64) -> Affine:
    """Return the two upper rows of a (3, 3) or (2, 3)."""
    a, b, c, d, e, f = (float(v) for v in linear[:2].ravel())
    return a, b, c, d, e, f


def common(places: list[Place]) -> Place:
    """Choose the coordinates that the first pictures repeat in: those of the mesh, or of one of the pictures."""
    candidates = [Place(places[0].layer), *places] if places else [Place()]
    return max(candidates, key=lambda chosen: [place.within(chosen) is not None for place in places])


def laid(uv: Float64, affine: Affine) -> Float64:
    """Transform coordinates (N, 2)."""
    return np.asarray(uv @ matrix(affine)[:2, :2].T + matrix(affine)[:2, 2])
