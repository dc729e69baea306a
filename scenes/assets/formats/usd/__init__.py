"""USD scenes: meshes, UsdPreviewSurface materials and UsdLux lights; with the exporter the only room for `pxr`.

Read are meshes and solids as at the stage's first time, instances and point instancers included; curves and points are
named and left out.
"""

from multilight.scenes.assets.formats.usd.read import read_usd

__all__ = ["read_usd"]
