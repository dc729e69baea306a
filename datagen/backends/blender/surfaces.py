"""Blender's materials as the project's: what a shader tree says, with its pictures written anew."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from multilight.datagen.backends.blender.bake import BAKED
from multilight.datagen.backends.blender.trees import Feed, Groups, UnreadError, feed_of, origin, product, triple
from multilight.scenes.arrays import Float32
from multilight.scenes.assets.derived_maps import slopes_to_normals
from multilight.scenes.assets.formats.coordinates import MESH, Place, common
from multilight.scenes.assets.formats.imported import KeepImage, Note
from multilight.scenes.assets.formats.mtl import part_name
from multilight.scenes.assets.formats.pictures import as_eight_bit
from multilight.scenes.assets.info import AssetError
from multilight.scenes.colour import LUMINANCE_WEIGHTS, srgb_decode, srgb_encode
from multilight.scenes.frozen import Rgb
from multilight.scenes.spec import Material, Texture

ZERO, GREY, HALF = (Feed((value,) * 3) for value in (0.0, 0.8, 0.5))
WHITE = Feed()
NUMBERS = ("roughness", "metallic")
_ENCODED, _LINEAR = ("sRGB",), ("Non-Color", "Linear Rec.709", "Raw")
_NEUTRAL = {
    "Subsurface Weight": "light below the surface", "Anisotropic": "anisotropy", "Sheen Weight": "sheen",
    "Thin Film Thickness": "a thin film",
}  # fmt: skip
"""Inputs of the Principled BSDF that are not carried where they are above 0."""
Bake = Callable[..., Feed]
"""Bakes what feeds a socket (within groups) into a picture; `colour`: in sRGB, else as numbers."""


@dataclass
class Surface:
    """What a shader says: feeds of colours and numbers, and plain numbers."""

    base: Feed = GREY
    roughness: Feed = HALF
    metallic: Feed = ZERO
    alpha: Feed = WHITE
    emission: Feed = ZERO
    normal: Feed | None = None
    bump: bool = False
    strength: float = 1.0
    plain: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Finished:
    """A material, the place of its coordinates, its vertex colours, and what it gives off."""

    material: Material
    place: Place = MESH
    colors: str | None = None
    emission: Rgb = (0.0, 0.0, 0.0)
    emission_texture: Texture | None = None


class ShaderReader:
    """Reads materials of one file; pictures of the inputs `times_plain` are multiplied with the plain value as well."""

    def __init__(
        self, keep: KeepImage, path_of: Callable[[Any], Path], notes: list[Note], times_plain: set[str], *, gltf: bool
    ) -> None:
        self._keep, self._path_of, self._notes, self._times_plain = keep, path_of, notes, times_plain
        self._gltf = gltf  # which says by its use how a picture is encoded; importers say it once for all uses
        self._pictures: dict[str, tuple[Image.Image, bool]] = {}
        self._read: dict[tuple[str, str], Finished] = {}

    def read(self, material: Any, bake: Bake, active: str) -> Finished:
        """Translate a material of a shape with the active UV layer `active`.

        Raises `AssetError` naming a picture that cannot be read.
        """
        key = material.name, active
        if key not in self._read:
            self._place, self._bake, self._active = f"material {material.name!r}", bake, active
            self._baked, self._all, notes = set[str](), False, list(self._notes)
            finished = self._translated(material)
            if BAKED in self._baked:  # a layout of its own: whatever else has a picture is to lie in it too
                self._all, self._notes[:] = True, notes
                finished = self._translated(material)
            if self._baked:
                return finished
            self._read[key] = finished
        return self._read[key]

    def _translated(self, material: Any) -> Finished:
        tree = material.node_tree if material.use_nodes else None
        outputs = [] if tree is None else [n for n in tree.nodes if n.type == "OUTPUT_MATERIAL" and n.is_active_output]
        if not outputs:
            surface = Surface(base=Feed(tuple(material.diffuse_color)[:3]))
        else:
            surface = self._shader(outputs[0].inputs["Surface"], ())
            if origin(outputs[0].inputs["Volume"], ()) is not None:
                self.note("what fills its volume", "the surface is shown alone", "none")
        return self._finished(material.name, surface)

    def note(self, feature: str, instead: str, remedy: str) -> None:
        """Add a line to the account, once."""
        note = Note(place=self._place, feature=feature, instead=instead, remedy=remedy)
        if note not in self._notes:
            self._notes.append(note)

    def _shader(self, socket: Any, groups: Groups) -> Surface:
        found = origin(socket, groups)
        if found is None:
            return Surface(base=ZERO)
        node, _, groups = found
        match node.type:
            case "BSDF_PRINCIPLED":
                return self._principled(node, groups)
            case "BSDF_DIFFUSE":
                return self._simple(node, groups, roughness=Feed(), ior=1.0)
            case "BSDF_GLOSSY":
                return self._simple(node, groups, roughness=self._feed(node, "Roughness", groups), metallic=WHITE)
            case "BSDF_GLASS" | "BSDF_REFRACTION":
                rough, ior = self._feed(node, "Roughness", groups), self._number(node, "IOR", groups)
                return self._simple(node, groups, roughness=rough, ior=ior, transmission=1.0)
            case "BSDF_TRANSPARENT":
                return Surface(alpha=ZERO)
            case "EMISSION":
                strength = self._feed(node, "Strength", groups)
                glow = self._times(self._feed(node, "Color", groups), strength)
                return Surface(base=ZERO, roughness=Feed(), plain={"ior": 1.0}, emission=glow)
            case "ADD_SHADER":
                a, b = (self._shader(s, groups) for s in list(node.inputs)[:2])
                return self._added(a, b)
            case "MIX_SHADER":
                return self._mixed(node, groups)
        self.note(f"its shader is a {node.bl_label}", "a matte grey surface stands in", "use a Principled BSDF")
        colour = next((s.name for s in node.inputs if s.type == "RGBA"), None)
        return self._simple(node, groups, roughness=Feed()) if colour == "Color" else Surface()

    def _simple(self, node: Any, groups: Groups, *, roughness: Feed, metallic: Feed = ZERO, **plain: float) -> Surface:
        surface = Surface(self._feed(node, "Color", groups, colour=True), roughness, metallic, plain=plain)
        self._normal(node, groups, surface)
        return surface

    def _added(self, a: Surface, b: Surface) -> Surface:
        """Add what gives off light to what reflects it."""
        shining, other = (a, b) if a.emission.factor != ZERO.factor else (b, a)
        if shining.emission.factor == ZERO.factor:
            self.note("a sum of two shaders", "the first is shown", "use one Principled BSDF")
            return a
        return replace(other, emission=shining.emission)

    def _mixed(self, node: Any, groups: Groups) -> Surface:
        """Mix with a see-through shader, which is opacity; of two others the larger is taken."""
        steering = origin(node.inputs[0], groups)
        if steering is not None and steering[0].type == "LIGHT_PATH":
            surface = self._shader(node.inputs[2], groups)
            if surface.emission.factor != ZERO.factor:  # as the glTF importer puts what is to be shown unlit
                self.note("it is meant to be shown unlit", "its colour is that of a matte surface", "give it lighting")
                return Surface(base=surface.emission, roughness=Feed(), alpha=surface.alpha, plain={"ior": 1.0})
            return surface
        share, (a, b) = self._feed(node, 0, groups), (self._shader(s, groups) for s in list(node.inputs)[1:3])
        clear_a, clear_b = (s.alpha.plain and s.alpha.value == 0 for s in (a, b))
        if clear_a:
            return replace(b, alpha=self._times(share, b.alpha))
        if clear_b and share.plain:
            return replace(a, alpha=self._times(Feed((1 - share.value,) * 3), a.alpha))
        self.note("a mix of two shaders", "the larger is shown", "bake it, or use one Principled BSDF")
        return b if not share.plain or share.value > 0.5 else a

    def _times(self, a: Feed, b: Feed) -> Feed:
        try:
            return product(a, b)
        except UnreadError as error:
            self.note(str(error), "the first is taken", "bake it into one picture")
            return a

    def _principled(self, node: Any, groups: Groups) -> Surface:
        for name, words in _NEUTRAL.items():
            if name in node.inputs and self._number(node, name, groups) > 1e-4:
                self.note(words, "the surface is shown without", "none")
        tint = self._feed(node, "Specular Tint", groups)
        if not tint.plain or max(tint.factor) - min(tint.factor) > 0.01:
            self.note("tinted reflections", "they are white", "none")
        transmission, ior = (self._number(node, name, groups) for name in ("Transmission Weight", "IOR"))
        level = self._number(node, "Specular IOR Level", groups)
        level *= sum(tint.factor) / 3
        if transmission == 0 and abs(level - 0.5) > 1e-6:
            zero = min(((ior - 1) / (ior + 1)) ** 2 * 2 * level, 0.25)  # as Cycles has it
            ior = (1 + zero**0.5) / max(1 - zero**0.5, 1e-3)
        strength = self._feed(node, "Emission Strength", groups)
        glow = self._times(self._feed(node, "Emission Color", groups, colour=True), strength)
        base = self._feed(node, "Base Color", groups, colour=True)
        rough, metal = self._feed(node, "Roughness", groups), self._feed(node, "Metallic", groups)
        base, rough, metal = (
            # A picture of an MTL file is multiplied with the plain value, which the importer leaves beside it.
            replace(feed, factor=triple(node.inputs[name].default_value)) if name in self._times_plain else feed
            for feed, name in ((base, "Base Color"), (rough, "Roughness"), (metal, "Metallic"))
        )
        alpha = self._feed(node, "Alpha", groups)
        if "Alpha" in self._times_plain and alpha.image is not None and "A" not in self._picture(alpha.image)[0].mode:
            alpha = replace(alpha, channel="RGB")  # an MTL file's mask, of which importers take the alpha
        surface = Surface(
            base, rough, metal, alpha, glow,
            plain={
                "ior": ior, "transmission": transmission, "coat": self._number(node, "Coat Weight", groups),
                "coat_roughness": self._number(node, "Coat Roughness", groups),
            },
        )  # fmt: skip
        self._normal(node, groups, surface)
        return surface

    def _feed(self, node: Any, name: str | int, groups: Groups, *, colour: bool = False) -> Feed:
        """Return what feeds an input; what is no product of pictures is baked, or else named."""
        socket = node.inputs[name]
        try:
            feed = feed_of(socket, groups)
            if not (self._all and feed.image is not None and node.type != "NORMAL_MAP"):
                return replace(feed, place=replace(feed.place, layer=feed.place.layer or self._active))
            error = "a picture beside what is baked"
        except UnreadError as refused:
            error = str(refused)
        try:
            baked: Feed = self._bake(socket, groups, colour=colour)
        except UnreadError:
            raise AssetError(f"{self._place}: {socket.name} comes of {error}; bake it into a picture") from None
        self._baked.add(baked.place.layer)
        self.note(f"its {socket.name} comes of {error}", "it is baked into a picture", "none is needed")
        return baked

    def _number(self, node: Any, name: str, groups: Groups) -> float:
        """Return a plain number; the mean of a picture where one feeds it."""
        feed = self._feed(node, name, groups)
        if feed.image is None:
            return feed.value
        values, _ = self._grey(feed)
        self.note(f"a picture of {name}", "one value, its mean", "none")
        return feed.value * float(values.mean())

    def _normal(self, node: Any, groups: Groups, surface: Surface) -> None:
        found = origin(node.inputs["Normal"], groups)
        if found is None:
            return
        bend, _, groups = found
        if bend.type not in ("NORMAL_MAP", "BUMP") or (bend.type == "NORMAL_MAP" and bend.space != "TANGENT"):
            self.note(f"its normal comes of a {bend.bl_label}", "the surface is smooth", "bake a normal map")
            return
        surface.bump = bend.type == "BUMP"
        surface.normal = self._feed(bend, "Height" if surface.bump else "Color", groups)
        surface.strength = self._number(bend, "Strength", groups)
        if surface.normal.image is None or surface.strength == 0:
            surface.normal = None

    def _finished(self, name: str, surface: Surface) -> Finished:
        """Write the pictures, and bring them to one set of coordinates."""
        feeds = {k: _without_black(getattr(surface, k)) for k in ("base", "roughness", "metallic", "alpha", "emission")}
        used = [feed for feed in (*feeds.values(), surface.normal) if feed is not None and feed.image is not None]
        at = common([feed.place for feed in used])
        for key in NUMBERS:
            if feeds[key].image is None:
                continue
            values, _ = self._grey(feeds[key])
            elsewhere = feeds[key].place.within(at) is None
            if elsewhere:
                self.note(f"its picture of {key} lies in another way", "one value, its mean", "bake one layout")
            if elsewhere or np.ptp(values) == 0:
                feeds[key] = Feed((feeds[key].value * float(values.mean()),) * 3)
        if surface.normal is not None and surface.normal.place.within(at) is None:
            self.note("its normal map lies in another way", "the surface is smooth", "bake one layout")
            surface.normal = None
        alpha, base = feeds["alpha"], feeds["base"]
        opacity, cut_out, picture = self._clearness(base, alpha)
        textures = {
            "base_color_texture": self._texture(picture, base if base.image is not None else alpha, at),
            "roughness_texture": self._number_texture(feeds["roughness"], at),
            "metallic_texture": self._number_texture(feeds["metallic"], at),
            "normal_texture": self._normal_texture(surface, at),
        }
        plain = {key: _share(v) for key, v in surface.plain.items() if key != "ior"}
        if not plain.get("coat"):
            plain.pop("coat_roughness", None)
        made = Material(
            name=part_name(name),
            base_color=tidy(np.clip(base.factor, 0, 1)),
            roughness=_share(feeds["roughness"].value),
            metallic=_share(feeds["metallic"].value),
            ior=float(f"{np.clip(surface.plain.get('ior', 1.5), 1, 3):.6g}"),
            opacity=_share(opacity),
            opacity_from_alpha=cut_out,
            alpha_cutoff=_share(alpha.cutoff) if cut_out else 0.0,
            **textures,
            **plain,
        )
        glow = feeds["emission"]
        shown = None if glow.image is None else self._texture(self._colour(glow), glow, at)
        return Finished(made, at, base.colors, tidy(np.maximum(glow.factor, 0)), shown)

    def _clearness(self, base: Feed, alpha: Feed) -> tuple[float, bool, Image.Image | None]:
        """Return opacity, whether a picture's alpha multiplies it, and the picture of the base colour."""
        picture = None if base.image is None else self._colour(base)
        if alpha.image is None:
            opacity = alpha.value if not alpha.cutoff else float(alpha.value >= alpha.cutoff)
            return opacity, False, picture
        values, _ = self._grey(alpha)
        if values.min() >= 1 - 1 / 512:  # no alpha in it after all
            return (float(alpha.value >= alpha.cutoff) if alpha.cutoff else alpha.value), False, picture
        mask = Image.fromarray(np.round(values * 255).astype(np.uint8))
        if picture is None:
            picture = Image.new("RGB", mask.size, "white")
        elif base.image != alpha.image:
            if base.place != alpha.place:
                self.note("its opacity lies in another way", "it lies as its colour does", "bake one layout")
            mask = mask.resize(picture.size, Image.Resampling.BILINEAR)
        picture = picture.convert("RGB")
        picture.putalpha(mask)
        return alpha.value, True, picture

    def _texture(self, picture: Image.Image | None, feed: Feed, at: Place) -> Texture | None:
        if picture is None:
            return None
        repeat = feed.place.within(at)
        if repeat is None:
            self.note("one of its pictures lies in another way", "it lies as the others do", "bake one layout")
            repeat = (1.0, 1.0)
        return self._keep(picture).model_copy(update={"repeat": repeat, "wrap": feed.place.wrap})

    def _number_texture(self, feed: Feed, at: Place) -> Texture | None:
        if feed.image is None:
            return None
        values, _ = self._grey(feed)
        return self._texture(Image.fromarray(np.round(values * 255).astype(np.uint8)), feed, at)

    def _normal_texture(self, surface: Surface, at: Place) -> Texture | None:
        feed = surface.normal
        if feed is None:
            return None
        image, encoded = self._picture(feed.image)
        pixels = np.asarray(image.convert("RGB"), np.float64)
        if surface.bump or float(np.ptp(pixels, axis=-1).max()) <= 2:
            self.note("a bump map", "a normal map with slopes of about five degrees is made of it", "give a normal map")
            return self._texture(Image.fromarray(slopes_to_normals(pixels[..., 0] / 16)), feed, at)
        encoded = encoded and not self._gltf
        if surface.strength != 1 or encoded:
            pixels = (srgb_decode(pixels / 255) if encoded else pixels / 255) * 2 - 1
            pixels[..., :2] *= surface.strength
            pixels /= np.maximum(np.linalg.norm(pixels, axis=-1, keepdims=True), 1e-9)
            image = Image.fromarray(np.round((pixels * 0.5 + 0.5) * 255).astype(np.uint8))
        return self._texture(image.convert("RGB"), feed, at)

    def _colour(self, feed: Feed) -> Image.Image:
        """Return a colour's picture in sRGB."""
        image, encoded = self._picture(feed.image)
        if feed.channel != "RGB":
            values, _ = self._grey(feed)
            return Image.fromarray(np.round(srgb_encode(values) * 255).astype(np.uint8)).convert("RGB")
        if not encoded and not self._gltf:
            image = Image.fromarray(
                np.round(srgb_encode(np.asarray(image.convert("RGB")) / 255) * 255).astype(np.uint8)
            )
        return image.convert("RGB")

    def _grey(self, feed: Feed) -> tuple[Float32, bool]:
        """Return a channel of a picture, linear, (H, W) in [0, 1]."""
        image, encoded = self._picture(feed.image)
        if feed.channel == "A":
            return np.asarray(image.convert("RGBA").getchannel("A"), np.float32) / 255, False
        pixels = np.asarray(image.convert("RGB"), np.float32) / 255
        pixels = srgb_decode(pixels).astype(np.float32) if encoded and not self._gltf else pixels
        grey = pixels @ LUMINANCE_WEIGHTS if feed.channel == "RGB" else pixels[..., "RGB".index(feed.channel)]
        return grey.astype(np.float32), encoded

    def _picture(self, image: Any) -> tuple[Image.Image, bool]:
        """Return a picture in 8 bits and whether it is encoded in sRGB; raises `AssetError` naming it."""
        if image.name not in self._pictures:
            space = image.colorspace_settings.name
            if space not in (*_ENCODED, *_LINEAR):
                self.note(f"the colour space {space!r}", "it is taken for sRGB", "save the picture in sRGB")
            self._pictures[image.name] = self._opened(image), space not in _LINEAR
        return self._pictures[image.name]

    def _opened(self, image: Any) -> Image.Image:
        source: Any = image.packed_file.data if image.packed_file is not None else None
        if source is None and image.source == "FILE":
            source = self._path_of(image)
        name = Path(image.filepath.replace("\\", "/")).name or image.name
        try:
            if source is not None:
                return as_eight_bit(source)
        except (OSError, ValueError, SyntaxError) as error:
            if 0 in image.size[:]:
                raise AssetError(
                    f"its picture {name!r} cannot be read ({str(error) or type(error).__name__}); save it as PNG"
                ) from error
        width, height = image.size  # EXR and others that Blender reads itself, and what it generates
        pixels = np.empty(width * height * 4, np.float32)
        image.pixels.foreach_get(pixels)
        rows = pixels.reshape(height, width, 4)[::-1]
        if image.is_float:
            self.note(f"the picture {name!r} has a high range", "it is cut off at 1", "none")
            if image.colorspace_settings.name not in _LINEAR[:1]:
                image.colorspace_settings.name = "sRGB"
                rows = np.concatenate([srgb_encode(np.clip(rows[..., :3], 0, 1)), rows[..., 3:]], axis=-1)
        return Image.fromarray(np.round(np.clip(rows, 0, 1) * 255).astype(np.uint8), "RGBA")


def tidy(colour: Any) -> Rgb:
    """Return a colour with the digits that Blender's 32 bits hold."""
    red, green, blue = (float(f"{v:.6g}") for v in list(colour)[:3])
    return red, green, blue


def _share(value: float) -> float:
    return float(f"{np.clip(value, 0, 1):.6g}")


def _without_black(feed: Feed) -> Feed:
    """Leave out a picture that is multiplied by nothing."""
    return Feed(feed.factor) if max(feed.factor) == 0 else feed
