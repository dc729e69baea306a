"""Rays of a `scenes.spec.Camera`: the one place where its axes and pixels become Mitsuba's."""

import drjit as dr
import mitsuba as mi
import numpy as np

from multilight.datagen.backends.mitsuba.device import opaque
from multilight.scenes.spec import Camera


class Lens:
    """A camera on the device; its numbers are data, so that a view costs no new kernel."""

    def __init__(self, camera: Camera) -> None:
        pose = np.array(camera.c2w)
        self._columns = [mi.Vector3f(*(opaque(v) for v in pose[:3, i])) for i in range(4)]
        self._fx, self._fy = opaque(camera.fx), opaque(camera.fy)
        self._cx, self._cy = opaque(camera.cx), opaque(camera.cy)
        self._aperture, self._focus = opaque(camera.aperture_radius), opaque(camera.focus_distance)
        self.forward = -self._columns[2]

    def rays(self, pixel: mi.Point2f, u: mi.Point2f | None = None) -> mi.Ray3f:
        """Return unit rays through film positions [pixels]; through the lens at u in [0, 1)^2 where it has a size."""
        x, y, z, origin = self._columns
        local = mi.Vector3f((pixel.x - self._cx) / self._fx, -(pixel.y - self._cy) / self._fy, -1)
        o, d = mi.Point3f(origin), x * local.x + y * local.y + z * local.z
        if u is not None:
            on_lens = mi.warp.square_to_uniform_disk_concentric(u) * self._aperture
            aim = local * self._focus - mi.Vector3f(on_lens.x, on_lens.y, 0)
            thin = self._aperture > 0
            o = dr.select(thin, mi.Point3f(origin + x * on_lens.x + y * on_lens.y), o)
            d = dr.select(thin, x * aim.x + y * aim.y + z * aim.z, d)
        return mi.Ray3f(o, dr.normalize(d))
