"""Loads assets for real and names what is wrong with them."""

from collections.abc import Callable, Iterator
from typing import get_args

import numpy as np

from multilight.scenes.assets.environments import read_environment
from multilight.scenes.assets.info import AssetError, AssetInfo, AssetRole
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.files.limits import open_picture
from multilight.scenes.meshes import Mesh
from multilight.scenes.spec import Material, Texture

LARGEST = {"object": 3.0, "table": 6.0, "surrounding": 100.0}
"""Longest side [m] of what may pass for a model of each role."""
MOST_FACES = 400_000
MODELS: tuple[AssetRole, ...] = ("object", "table", "surrounding")


def check_assets(
    library: AssetLibrary, pack: str | None = None, report: Callable[[int, int], None] = lambda done, total: None
) -> list[tuple[str, str]]:
    """Load every asset of a pack (None: of all packs) and return (asset id, problem) for each fault found.

    `report` is told how many of how many are done.
    """
    infos = [info for role in get_args(AssetRole) for info in library.list(role) if pack in (None, info.pack)]
    found = []
    for number, info in enumerate(infos):
        report(number, len(infos))
        found += [(info.id, problem) for problem in _problems(library, info)]
    return found


def account(library: AssetLibrary, info: AssetInfo) -> list[str]:
    """Say what was read of a user's model: its size, faces, materials and textures, what is not carried, what is odd.

    Empty where it cannot be read.
    """
    if info.role not in MODELS:
        return [f"{info.role}, {info.category}"]
    try:
        mesh = library.mesh(info.id)
    except AssetError:
        return []
    materials = {part.material.canonical_json(): part.material for part in mesh.parts}.values()
    x, y, z = mesh.bounds()[1] - mesh.bounds()[0]
    faces, textures = sum(len(part.faces) for part in mesh.parts), {t for m in materials for t in textures_of(m)}
    first = f"{info.role}, {info.category}: {x:.3g} x {y:.3g} x {z:.3g} m, {faces} faces, {len(materials)} materials, "
    return [
        f"{first}{len(textures)} textures",
        *(f"  not carried: {note}" for note in library.notes(info.id)),
        *(f"  odd: it {warning}" for warning in library.warnings(info.id)),
    ]


def textures_of(material: Material) -> list[str]:
    """Return the asset ids of a material's textures."""
    values = (getattr(material, name) for name in type(material).model_fields)
    return sorted({value.image for value in values if isinstance(value, Texture)})


def _problems(library: AssetLibrary, info: AssetInfo) -> Iterator[str]:
    try:
        match info.role:
            case _ if info.role in MODELS:
                yield from _mesh_problems(library, info, library.mesh(info.id))
            case "texture":
                yield from _image_problems(library, info.id)
                if info.normal_map is not None:
                    yield from _image_problems(library, info.normal_map)
            case "environment":
                image = read_environment(library.environment_path(info.id))
                if image.min() < 0:
                    yield f"holds negative radiance {image.min():.3g}"
    except AssetError as error:
        yield str(error)


def _mesh_problems(library: AssetLibrary, info: AssetInfo, mesh: Mesh) -> Iterator[str]:
    for part in mesh.parts:
        arrays = (part.vertices, part.normals, part.uv)
        if not all(np.isfinite(array).all() for array in arrays):
            yield f"part {part.name!r} has values that are not finite"
        elif part.faces.min() < 0 or part.faces.max() >= len(part.vertices):
            yield f"part {part.name!r} has faces that name vertices which are not there"
        elif np.abs(np.linalg.norm(part.normals, axis=1) - 1).max() > 1e-3:
            yield f"part {part.name!r} has normals that are not of unit length"
    low, high = mesh.bounds()
    size = high - low
    if not 0.005 <= size.max() <= LARGEST[info.role]:
        yield f"is {size.max():.4g} m large, expected 0.005 to {LARGEST[info.role]:g}"
    if info.size is not None and np.abs(size - info.size).max() > 1e-3 + 0.01 * size.max():
        yield f"measures {np.round(size, 4).tolist()} m, but is listed with {list(info.size)}"
    if abs(low[2]) > 1e-4 or np.abs((low + high)[:2]).max() > 1e-3:
        yield "does not stand on z = 0, centred in x and y"
    faces = sum(len(part.faces) for part in mesh.parts)
    if faces > MOST_FACES:
        yield f"has {faces} faces, more than {MOST_FACES}"
    if info.emissive_part is not None and info.emissive_part not in [part.name for part in mesh.parts]:
        yield f"has no part {info.emissive_part!r} that may glow; its parts are {[p.name for p in mesh.parts]}"
    for material in {part.material.canonical_json(): part.material for part in mesh.parts}.values():
        yield from _material_problems(library, material)


def _material_problems(library: AssetLibrary, material: Material) -> Iterator[str]:
    for image in textures_of(material):
        yield from _image_problems(library, image)


def _image_problems(library: AssetLibrary, image: str) -> Iterator[str]:
    try:
        path = library.texture_path(image)
        with open_picture(path) as picture:
            picture.load()
            if min(picture.size) < 2:
                yield f"texture {image!r} is only {picture.width}x{picture.height} pixels"
    except AssetError as error:
        yield str(error)
    except (OSError, ValueError, SyntaxError) as error:
        yield f"texture {image!r} cannot be decoded: {error}"
