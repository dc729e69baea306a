"""Gaussians as PLY files in the layout of the INRIA code, which every viewer of Gaussians reads.

One float32 vertex a Gaussian: `x y z nx ny nz f_dc_0..2 opacity scale_0..2 rot_0..3`, binary little endian, where
colour = 0.5 + C0 * f_dc (the constant spherical harmonic), opacity = sigmoid(`opacity`), scale = exp(`scale_i`) and
`rot` is a quaternion wxyz (Kerbl et al. 2023, `scene/gaussian_model.py`).
"""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from multilight.scenes.arrays import Float64
from multilight.scenes.files.limits import LimitError, read_bytes, shown
from multilight.scenes.gaussians.from_views import Gaussians

C0 = 0.28209479177387814
"""The constant real spherical harmonic, 1 / (2 sqrt(pi))."""
FIELDS = (
    *("x", "y", "z"),
    *("nx", "ny", "nz"),
    *(f"f_dc_{i}" for i in range(3)),
    "opacity",
    *(f"scale_{i}" for i in range(3)),
    *(f"rot_{i}" for i in range(4)),
)
TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
TYPES |= {"float": "f4", "double": "f8"}
TYPES |= {np.dtype(kind).name: kind for kind in TYPES.values()}  # int8, uint8, … are their other names
OPAQUE = 1.0 - 1e-6  # the logit of 1 is infinite
LEAST_SCALE = 1e-12  # metres; the logarithm of 0 is infinite


def write_gaussians(path: Path, gaussians: Gaussians) -> None:
    """Write Gaussians; opacities are held within 1e-6 of 0 and 1."""
    opacity = np.clip(gaussians.opacities.astype(np.float64), 1.0 - OPAQUE, OPAQUE)
    columns = np.concatenate(
        [
            gaussians.means,
            np.zeros_like(gaussians.means),
            (gaussians.colors - 0.5) / C0,
            np.log(opacity / (1.0 - opacity))[:, None],
            np.log(np.maximum(gaussians.scales, LEAST_SCALE)),
            gaussians.quats,
        ],
        axis=1,
    ).astype("<f4")
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(gaussians)}"]
    header += [f"property float {name}" for name in FIELDS] + ["end_header", ""]
    path.write_bytes("\n".join(header).encode("ascii") + columns.tobytes())


def read_gaussians(path: Path) -> Gaussians:
    """Read Gaussians; of their colour only what does not depend on the view is kept (`f_dc`, not `f_rest`).

    Quaternions come out with unit length. Raises `ValueError` naming the file and what is wrong with it.
    """
    vertices = _vertices(path)
    missing = [name for name in FIELDS if name not in (vertices.dtype.names or ()) and not name.startswith("n")]
    if missing:
        raise ValueError(f"{path} holds no Gaussians: its vertices have no {', '.join(missing)}")

    def columns(start: str) -> Float64:
        return np.stack([vertices[name].astype(np.float64) for name in FIELDS if name.startswith(start)], axis=-1)

    quats = columns("rot_")
    length = np.linalg.norm(quats, axis=-1, keepdims=True)
    values = Gaussians(
        means=np.stack([vertices[axis] for axis in "xyz"], axis=-1).astype(np.float32),
        quats=(quats / np.where(length > 0, length, 1.0)).astype(np.float32),
        scales=np.exp(columns("scale_")).astype(np.float32),
        opacities=(1.0 / (1.0 + np.exp(-vertices["opacity"].astype(np.float64)))).astype(np.float32),
        colors=(0.5 + C0 * columns("f_dc_")).astype(np.float32),
    )
    if (bad := ~np.isfinite(values.means).all(axis=1) | ~np.isfinite(values.scales).all(axis=1)).any():
        raise ValueError(f"{path}: Gaussian {int(np.argmax(bad))} has a place or a size that is not finite")
    return values


def _vertices(path: Path) -> NDArray[np.void]:
    """Read the first element, `vertex`, of a binary PLY file as a structured array."""
    try:
        return _parsed(path, read_bytes(path))
    except LimitError as error:
        raise ValueError(f"{path}: {error}") from None
    except IndexError:
        raise ValueError(f"{path}: a line of its header is cut short") from None


def _parsed(path: Path, content: bytes) -> NDArray[np.void]:
    head, found, body = content.partition(b"end_header\n")
    lines = [line.split() for line in head.decode("ascii", "replace").splitlines()]
    if not found or not lines or lines[0] != ["ply"]:
        raise ValueError(f"{path} is not a PLY file")
    orders = {"binary_little_endian": "<", "binary_big_endian": ">"}
    layout = next((line[1] for line in lines if line[:1] == ["format"]), "no")
    if layout not in orders:
        raise ValueError(f"{path} is a PLY file of {layout} format; Gaussians are read from binary ones")
    elements = [i for i, line in enumerate(lines) if line[:1] == ["element"]]
    if not elements or lines[elements[0]][1] != "vertex":
        raise ValueError(f"{path}: its first element is not `vertex`")
    end = elements[1] if len(elements) > 1 else len(lines)
    fields = [line[1:] for line in lines[elements[0] : end] if line[:1] == ["property"]]
    if unknown := [" ".join(f) for f in fields if len(f) != 2 or f[0] not in TYPES]:
        raise ValueError(f"{path}: property `{unknown[0]}` of a vertex cannot be read")
    kind = np.dtype([(name, orders[layout] + TYPES[type_]) for type_, name in fields])
    claimed = lines[elements[0]][2]
    if not re.fullmatch("[0-9]{1,12}", claimed) or not kind.itemsize:
        raise ValueError(f"{path}: it claims {shown(claimed)} vertices of {kind.itemsize} bytes")
    count = int(claimed)
    if len(body) < count * kind.itemsize:
        raise ValueError(
            f"{path} is truncated: {count} vertices take {count * kind.itemsize} bytes, {len(body)} are there"
        )
    return np.frombuffer(body, kind, count)
