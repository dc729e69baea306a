"""USD scenes: meshes, UsdPreviewSurface materials and UsdLux lights; with the exporter the only room for `pxr`.

Read are Mesh, Cube, Sphere and Cylinder prims as posed at the default time, instances included; curves, points and
point instancers are not.
"""

from multilight.scenes.assets.formats.usd.read import read_usd

__all__ = ["read_usd"]
