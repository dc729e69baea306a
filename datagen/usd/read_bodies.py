"""Meshes of a stage as bodies: of the models they were made of where unchanged, else of the stage's own triangles."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from pxr import UsdGeom, UsdShade

from multilight.datagen.errors import UserError
from multilight.datagen.usd.bodies import geometry_digest
from multilight.datagen.usd.layout import get_own
from multilight.scenes.assets.formats.imported import Emission, image_digest
from multilight.scenes.assets.formats.usd.materials import Picture, bound_surface, read_material
from multilight.scenes.assets.library import AssetError, AssetLibrary
from multilight.scenes.assets.packs.background import PACK
from multilight.scenes.poses import matrix4
from multilight.scenes.spec import Body, Geometry, Material, MeshAsset, Rectangle, Sphere, Texture


class BodyReader:
    """Reads meshes one by one into `bodies`; `glows` has what each part gives off, by the part's path."""

    def __init__(self, path: Path, library: AssetLibrary, place: Callable[[Any], Any]) -> None:
        self._path, self._library, self._place = path, library, place
        self.bodies: list[Body] = []
        self.glows: dict[str, tuple[str, int, Emission]] = {}

    def read(self, prim: Any) -> None:
        """Read one mesh."""
        surfaces = _surfaces(prim)
        if any(shader is None for _, shader in surfaces):
            raise UserError(f"{self._path}: {prim.GetPath()} has a part without UsdPreviewSurface; give it one")
        found = [read_material(self._path, shader, self.texture_of, has_uv=True) for _, shader in surfaces]
        geometry = self._geometry(prim, len(found))
        if geometry is None:
            self._as_it_is(prim, surfaces)
            return
        self._add(prim, prim.GetName(), geometry, tuple(surface.material for surface in found), self._place(prim))
        for part, ((place, _), surface) in enumerate(zip(surfaces, found, strict=True)):
            if surface.emission is not None:
                self.glows[place] = prim.GetName(), part, surface.emission

    def texture_of(self, picture: Picture, mode: str) -> Texture:
        """Return the installed texture that a picture was copied from, else the one that the stage brought."""
        if picture.asset is not None and self.is_installed(picture.asset, Path(picture.file)):
            return Texture(image=picture.asset)
        return Texture(image=f"{PACK}/texture-{image_digest(picture.image.convert(mode))}")

    def is_installed(self, asset: str, file: Path, *, environment: bool = False) -> bool:
        """Tell whether an asset is installed, and the file a copy of it."""
        try:
            path = self._library.environment_path(asset) if environment else self._library.texture_path(asset)
        except AssetError:
            return False
        return path.read_bytes() == file.read_bytes()

    def _geometry(self, prim: Any, parts: int) -> Geometry | None:
        """Return what a mesh stands for; None where its triangles were changed, or its model is not installed."""
        value = partial(get_own, prim)
        if value("geometry") != geometry_digest(UsdGeom.Mesh(prim)):
            return None
        match value("shape"):
            case "sphere":
                return Sphere(radius=value("radius"))
            case "rectangle":
                width, height = value("size")
                return Rectangle(width=width, height=height)
            case "mesh":
                geometry = MeshAsset(asset=value("asset"), mesh_sha256=value("meshSha256"), parts=parts)
                return geometry if self._has_model(geometry) else None
            case _:
                return None

    def _has_model(self, geometry: MeshAsset) -> bool:
        try:
            return self._library.mesh(geometry.asset).sha256() == geometry.mesh_sha256
        except AssetError:
            return False

    def _as_it_is(self, prim: Any, surfaces: list[tuple[str, Any]]) -> None:
        """Take a mesh's triangles and materials from the stage, as a background's are taken."""
        pack = self._library.background
        pieces = {} if pack is None else {piece.title: piece for piece in pack.pieces}
        if pack is None or prim.GetName()[:80] not in pieces:
            raise UserError(f"{self._path}: {prim.GetPath()} has no triangles that could be read; repair the mesh")
        piece = pieces[prim.GetName()[:80]]
        mesh = pack.mesh(piece.name)
        geometry = MeshAsset(asset=f"{PACK}/{piece.name}", mesh_sha256=mesh.sha256(), parts=len(mesh.parts))
        name = prim.GetName() if get_own(prim, "role") else piece.name
        self._add(prim, name, geometry, tuple(p.material for p in mesh.parts), piece.world_from_body)
        shining = [light for light in pack.lights if light.node == piece.name]
        bright = [
            place
            for place, shader in surfaces
            if read_material(self._path, shader, self.texture_of, has_uv=True).emission is not None
        ]
        for place, light in zip(bright, shining, strict=False):
            self.glows[place] = name, light.part, Emission(amount=light.amount, texture=light.texture)

    def _add(self, prim: Any, name: str, geometry: Geometry, materials: tuple[Material, ...], pose: Any) -> None:
        value = partial(get_own, prim)
        self.bodies.append(
            Body(
                name=name,
                role=value("role") or "surrounding",
                category=value("category") or PACK,
                geometry=geometry,
                materials=materials,
                world_from_body=matrix4(pose),
                insertable=bool(value("insertable")),
            )
        )


def _surfaces(prim: Any) -> list[tuple[str, Any]]:
    """Return the path and the surface of each part of a mesh, in order."""
    subsets = UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets()
    holders = [subset.GetPrim() for subset in subsets] or [prim]
    return [(str(holder.GetPath()), bound_surface(holder)) for holder in holders]
