"""What the names of a user's files tell: what a thing is, where a sky was taken, what a picture holds, a licence."""

import re
import unicodedata
from pathlib import Path

from multilight.scenes.assets.formats.import_file import SUFFIXES
from multilight.scenes.assets.info import AssetRole

PLAIN_NAMES = (
    "3d-asset asset geometry glb gltf mesh meshes model models obj object original scene source textured untitled usd "
    "visual visuals"
)
"""Names of files and folders that say nothing of what is in them, as sets are published."""
USUAL: dict[str, tuple[AssetRole, float, float]] = {
    "table": ("table", 0.2, 3.5), "desk": ("table", 0.6, 3.0), "coffee_table": ("table", 0.3, 2.0),
    "chair": ("surrounding", 0.4, 1.6), "armchair": ("surrounding", 0.5, 1.6), "sofa": ("surrounding", 0.8, 4.5),
    "stool": ("surrounding", 0.25, 1.3), "bookcase": ("surrounding", 0.4, 3.5), "bed": ("surrounding", 0.8, 3.0),
    "wardrobe": ("surrounding", 0.6, 4.0), "floor_lamp": ("surrounding", 0.6, 2.5), "lamp": ("object", 0.08, 1.0),
    "mug": ("object", 0.05, 0.25), "cup": ("object", 0.04, 0.25), "bottle": ("object", 0.05, 0.6),
    "vase": ("object", 0.04, 1.2), "bowl": ("object", 0.05, 0.6), "plate": ("object", 0.08, 0.5),
    "shoe": ("object", 0.08, 0.6), "book": ("object", 0.05, 0.6), "toy": ("object", 0.02, 1.0),
    "teapot": ("object", 0.08, 0.5), "plant": ("object", 0.05, 3.0), "room": ("surrounding", 1.5, 500.0),
}  # fmt: skip
"""Role of a category, and its usual longest side [m]."""
LARGEST_OBJECT = 2.5
"""Longest side [m] beyond which a model whose name says nothing is furniture or more, not an object."""
_WORDS = {
    "coffee_table": "coffee_table coffeetable couchtisch 茶几", "desk": "desk schreibtisch escritorio bureau 书桌",
    "table": "table tisch mesa tavolo bord stol 桌 机 テーブル стол", "armchair": "armchair sessel fauteuil",
    "chair": "chair stuhl silla chaise sedia 椅 いす стул", "sofa": "sofa couch canape 沙发 диван",
    "stool": "stool hocker tabouret", "bookcase": "bookcase bookshelf shelf regal 书架", "bed": "bed bett cama 床",
    "wardrobe": "wardrobe closet cabinet schrank armoire 柜", "floor_lamp": "floor_lamp floorlamp stehlampe",
    "lamp": "lamp lampe lampara lantern 灯 лампа", "mug": "mug becher 马克杯", "cup": "cup tasse taza 杯 чашка",
    "bottle": "bottle flasche botella 瓶", "vase": "vase jarron 花瓶 ваза", "bowl": "bowl schale bol 碗",
    "plate": "plate teller plato 盘", "shoe": "shoe shoes sneaker boot schuh 鞋", "book": "book buch libro 书",
    "toy": "toy spielzeug juguete 玩具", "teapot": "teapot teekanne 茶壶", "plant": "plant pflanze planta 植物",
    "room": "room stage stages interior kitchen apartment frl raum zimmer background 房间",
}  # fmt: skip
_PLACES = {
    "indoor": "indoor interior room hall studio_apartment church kitchen office lobby workshop warehouse garage",
    "studio": "studio softbox photo_studio", "night": "night moon nacht", "outdoor": "",
}  # fmt: skip
_SURFACES = {
    "wood": "wood planks plank parquet oak holz bois laminate veneer", "brick": "brick bricks ziegel",
    "concrete": "concrete cement beton", "plaster": "plaster stucco wall paint putz", "metal": "metal steel iron rust",
    "tiles": "tile tiles fliesen", "fabric": "fabric cloth denim wool linen carpet leather", "marble": "marble",
    "stone": "stone rock granite slate cobble", "ground": "ground soil mud sand gravel grass snow asphalt",
}  # fmt: skip
KINDS = {
    "base": "albedo basecolor base_color base color col diff diffuse",
    "normal": "normal normals nor norm nrm normalgl nor_gl normal_opengl normaldx nor_dx normal_directx",
    "roughness": "roughness rough rgh", "metallic": "metallic metalness metal met", "height": "height disp "
    "displacement bump", "ao": "ao ambientocclusion occlusion arm orm",
}  # fmt: skip
"""Suffixes of the pictures of a surface."""
PICTURE_FOLDERS = frozenset(["images", "maps", "materials", "tex", "texture", "textures"])
"""Folders that hold the pictures of what lies beside them."""
_LICENCES = (
    ("CC0-1.0", r"CC0|CC-0|publicdomain/zero|public domain"), ("CC-BY-NC-4.0", r"CC[- ]BY[- ]NC|attribution-noncomm"),
    ("CC-BY-SA-4.0", r"CC[- ]BY[- ]SA|attribution-sharealike"), ("CC-BY-4.0", r"CC[- ]BY|licenses/by/|creative commons "
    r"attribution"), ("MIT", r"\bMIT\b"), ("Apache-2.0", r"apache"),
)  # fmt: skip


def words_of(text: str) -> list[str]:
    """Split a name into lower-case words of any script."""
    parted = re.sub(r"(?<=[a-z])(?=[A-Z0-9])", " ", unicodedata.normalize("NFC", text))
    return re.findall(r"[^\W_]+", parted.lower())


def named_id(parts: tuple[str, ...]) -> str:
    """Return an id made of the parts of a path without suffix: letters of any script, digits, dashes."""
    said = [part for part in ("-".join(re.findall(r"[^\W_]+", p.lower())) for p in parts) if part]
    telling = [part for part in said if part not in PLAIN_NAMES.split()]
    return unicodedata.normalize("NFC", "-".join(telling or said)) or "model"


def category_of(text: str) -> str | None:
    """Guess what a thing is from the last of its name's words that says so."""
    return _first(text, _WORDS)


def role_of(category: str | None, size: tuple[float, float, float] | None) -> AssetRole:
    """Guess the role of a model from its category, where its size [m] is one that such things have, else from that."""
    largest = 0.0 if size is None else max(size)
    if category in USUAL and (size is None or USUAL[category][1] <= largest <= USUAL[category][2]):
        return USUAL[category][0]
    return "surrounding" if largest > LARGEST_OBJECT else "object"


def place_of(text: str) -> tuple[str, str]:
    """Guess the category of a sky from its name, and name its place: without what says how large its file is."""
    words = [word for word in re.findall(r"[^\W_]+", text.lower()) if not re.fullmatch(r"\d+k|hdris?|hdr|exr", word)]
    return _first(text, _PLACES) or "outdoor", "_".join(words)


def surface_of(text: str) -> str:
    """Guess what a surface is made of."""
    return _first(text, _SURFACES) or "surface"


def kind_of(stem: str) -> tuple[str, str] | None:
    """Return the name of a set of pictures and which of them one is, without resolutions; None where it is of none."""
    text = re.sub(r"[-_ .](?:\d+k|\d{3,5}(?:px)?|jpg|png)(?=[-_ .]|$)", "", stem, flags=re.IGNORECASE)
    for kind, suffixes in KINDS.items():
        for suffix in sorted(suffixes.split(), key=len, reverse=True):
            found = re.fullmatch(rf"(.+?)[-_ .]{suffix}", text, re.IGNORECASE)
            if found:
                return found[1], f"{kind}-dx" if suffix.endswith(("dx", "directx")) else kind
    return None


def licence_of(text: str) -> str | None:
    """Return the licence that a text names; None where it names none that is known."""
    return next((name for name, words in _LICENCES if re.search(words, text, re.IGNORECASE)), None)


def credited(credits: dict[str, str]) -> tuple[str | None, str | None]:
    """Return the licence and the creator that a file states of itself; None each where it does not."""
    said = " ".join(credits.get(key, "") for key in ("license", "copyright"))
    return licence_of(said) or credits.get("license"), credits.get("author") or credits.get("copyright")


def licence_beside(file: Path, folder: Path) -> str | None:
    """Read the licence in a text beside a file or above it, up to `folder`; None where none is known."""
    for place in (file.parent, *file.parent.parents):
        for text in sorted(place.glob("*")) if place.is_relative_to(folder) else ():
            if re.match(r"(licen[cs]e|copying|attribution|metadata)", text.name, re.IGNORECASE) and text.is_file():
                said = text.read_bytes()[:20_000].decode("utf-8", "replace")
                if found := licence_of(said):
                    return found
        if place == folder:
            break
    return None


def of_a_model(picture: Path, folder: Path) -> bool:
    """Tell whether a picture is a model's: it lies beside one, or below one in a folder for pictures."""
    place = picture.parent
    while place.name.lower() in PICTURE_FOLDERS and place != folder:
        place = place.parent
    return any(child.suffix.lower() in SUFFIXES for child in place.iterdir())


def _first(text: str, table: dict[str, str]) -> str | None:
    words = words_of(text)
    joined = "_".join(words)
    for kind, said in table.items():
        for word in said.split():
            hit = word in joined if not word.isascii() else f"_{word}_" in f"_{joined}_"
            if hit:
                return kind
    return None
