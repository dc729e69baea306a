"""Pictures that screens and signs show: made-up user interfaces, photo-like views, patterns, dot-matrix text.

Each is sRGB-encoded, uint8, row 0 at the top, and fills its display; words are random syllables.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from multilight.scenes.assets.builtin.textures.patterns import noise, ramp
from multilight.scenes.random_streams import Rng, generator_of, pick

Ink = tuple[int, int, int]

_ACCENTS: tuple[Ink, ...] = (
    (38, 110, 235), (230, 64, 72), (24, 160, 110), (245, 150, 32), (132, 82, 220), (16, 150, 190), (232, 90, 150),
)  # fmt: skip
_SKIES = (
    ((0.16, 0.27, 0.48), (0.55, 0.66, 0.82), (0.96, 0.86, 0.72)),
    ((0.10, 0.08, 0.24), (0.62, 0.26, 0.38), (0.99, 0.68, 0.36)),
    ((0.22, 0.48, 0.80), (0.56, 0.76, 0.93), (0.90, 0.95, 0.97)),
)


def _words(rng: Rng, count: int) -> str:
    parts = ("ka", "lo", "mi", "ren", "ta", "so", "vel", "no", "pri", "du", "an", "er", "is", "um", "fe", "ga")
    return " ".join("".join(rng.choice(parts, int(rng.integers(1, 4)))) for _ in range(count))


def _paper(rng: Rng, size: tuple[int, int]) -> tuple[Image.Image, ImageDraw.ImageDraw, Ink, Ink]:
    """Start an interface in light or dark mode: picture, pen, colours of card and ink."""
    ground, card, ink = ((242, 243, 246), (255, 255, 255), (34, 36, 42))
    if rng.random() >= 0.6:
        ground, card, ink = ((16, 18, 24), (34, 37, 46), (228, 230, 236))
    image = Image.new("RGB", size, ground)
    return image, ImageDraw.Draw(image), card, ink


def _font(size: float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(max(6, round(size)))


def interface(rng: Rng, size: tuple[int, int]) -> Image.Image:
    """Draw an app: a bar, a banner picture, cards with text and a round button."""
    image, pen, card, ink = _paper(rng, size)
    w, h = size
    unit, accent = min(w, h) / 24, pick(rng, _ACCENTS)
    pen.rectangle((0, 0, w, 3 * unit), fill=accent)
    pen.text((unit, 0.8 * unit), _words(rng, 2).title(), fill=(255, 255, 255), font=_font(1.3 * unit))
    top = 4 * unit
    image.paste(view(rng, (round(w - 2 * unit), round(0.22 * h))), (round(unit), round(top)))
    top += 0.22 * h + unit
    while top < h:
        pen.rounded_rectangle((unit, top, w - unit, top + 4 * unit), 0.6 * unit, fill=card)
        pen.ellipse((1.6 * unit, top + 0.6 * unit, 4.4 * unit, top + 3.4 * unit), fill=pick(rng, _ACCENTS))
        pen.text((5.2 * unit, top + 0.6 * unit), _words(rng, 2).capitalize(), fill=ink, font=_font(1.2 * unit))
        pen.text((5.2 * unit, top + 2.2 * unit), _words(rng, 4), fill=(140, 144, 152), font=_font(unit))
        top += 4.8 * unit
    pen.ellipse((w - 5 * unit, h - 5 * unit, w - 1.4 * unit, h - 1.4 * unit), fill=accent)
    return image


def icons(rng: Rng, size: tuple[int, int]) -> Image.Image:
    """Draw a home screen: a grid of icons over a picture."""
    image = view(rng, size) if rng.random() < 0.6 else swirl(rng, size)
    pen = ImageDraw.Draw(image)
    w, h = size
    columns = 4 if w < h else 8
    pitch = w / columns
    for row in range(int((h / pitch - 0.4) * 0.8)):
        for column in range(columns):
            if rng.random() < 0.8:
                x, y = (column + 0.2) * pitch, (row + 0.6) * pitch
                pen.rounded_rectangle((x, y, x + 0.6 * pitch, y + 0.6 * pitch), 0.14 * pitch, fill=pick(rng, _ACCENTS))
                inner = (x + 0.17 * pitch, y + 0.17 * pitch, x + 0.43 * pitch, y + 0.43 * pitch)
                (pen.ellipse if rng.random() < 0.5 else pen.rectangle)(inner, fill=(250, 250, 250))
    return image


def chat(rng: Rng, size: tuple[int, int]) -> Image.Image:
    """Draw a conversation in bubbles."""
    image, pen, card, ink = _paper(rng, size)
    w, h = size
    unit, accent, top = min(w, h) / 22, pick(rng, _ACCENTS), 0.0
    while top < h:
        mine, length = rng.random() < 0.5, float(rng.uniform(0.35, 0.7)) * w
        lines = int(rng.integers(1, 4))
        left = w - unit - length if mine else unit
        bubble = (left, top + unit, left + length, top + (1.6 + 1.5 * lines) * unit)
        pen.rounded_rectangle(bubble, unit, fill=accent if mine else card)
        for line in range(lines):
            place = (left + 0.8 * unit, top + (1.3 + 1.5 * line) * unit)
            words = _words(rng, max(1, int(length / unit / 4)))
            pen.text(place, words, fill=(255, 255, 255) if mine else ink, font=_font(unit))
        top += (1.4 + 1.5 * lines) * unit
    return image


def dashboard(rng: Rng, size: tuple[int, int]) -> Image.Image:
    """Draw charts: columns, a line and figures."""
    image, pen, card, ink = _paper(rng, size)
    w, h = size
    unit = min(w, h) / 24
    for i, (x, y) in enumerate((x, y) for y in (0.04, 0.52) for x in (0.03, 0.51)):
        box = (x * w, y * h, (x + 0.46) * w, (y + 0.44) * h)
        pen.rounded_rectangle(box, 0.6 * unit, fill=card)
        colour = pick(rng, _ACCENTS)
        pen.text((box[0] + unit, box[1] + 0.6 * unit), _words(rng, 2).title(), fill=ink, font=_font(1.1 * unit))
        values = rng.uniform(0.15, 0.65, 9)
        xs = np.linspace(box[0] + unit, box[2] - unit, 10)
        ys = box[3] - unit - values * (box[3] - box[1])
        if i % 2:
            pen.line(list(zip(xs[:9] + unit, ys, strict=True)), fill=colour, width=max(2, round(unit / 3)))
        else:
            for left, right, top in zip(xs[:-1], xs[1:], ys, strict=True):
                pen.rectangle((left, top, right - 0.3 * unit, box[3] - unit), fill=colour)
    return image


def editor(rng: Rng, size: tuple[int, int]) -> Image.Image:
    """Draw coloured lines of text on a dark ground, with a side bar."""
    image = Image.new("RGB", size, (24, 26, 33))
    pen = ImageDraw.Draw(image)
    w, h = size
    step = min(w, h) / 26
    pen.rectangle((0, 0, 0.16 * w, h), fill=(34, 37, 46))
    indent = 0
    for row in range(int(h / step / 1.35)):
        x, y = 0.2 * w + indent * 2 * step, 1.35 * step * row + 0.5 * step
        pen.text((0.02 * w, y), _words(rng, 1), fill=(150, 155, 165), font=_font(0.8 * step))
        for _ in range(int(rng.integers(0, 5))):
            word = _words(rng, 1)
            ink = pick(rng, _ACCENTS) if rng.random() < 0.6 else (205, 208, 215)
            pen.text((x, y), word, fill=ink, font=_font(step))
            x += (len(word) + 1) * 0.55 * step
        indent = int(np.clip(indent + rng.integers(-1, 2), 0, 4))
    return image


def view(rng: Rng, size: tuple[int, int]) -> Image.Image:
    """Paint a landscape like a photograph: a sky with a sun, and ridges that pale with distance."""
    w, h = size
    n = 256
    sky = pick(rng, _SKIES)
    v, u = np.mgrid[0:n, 0:n] / n
    picture = ramp(np.clip(1.5 * v + 0.05 * noise(rng, n, scale=(6, 2)), 0, 1), sky)
    x, y = rng.uniform(0.2, 0.8), rng.uniform(0.15, 0.45)
    glow = np.exp(-(((u - x) * w / h) ** 2 + (v - y) ** 2) / 0.004)
    picture += glow[..., None] * (np.array([1.0, 0.95, 0.85]) - picture)
    near = np.array([rng.uniform(0.03, 0.12), rng.uniform(0.08, 0.2), rng.uniform(0.05, 0.15)])
    for i in range(4):
        ridge = 0.45 + 0.13 * i + 0.05 * noise(rng, n, scale=(1, 3), rough=1.2)[0]
        pale = (0.75 - 0.25 * i) * np.array(sky[1]) + (0.25 + 0.25 * i) * near
        picture = np.where((v > ridge[None])[..., None], np.clip(pale, 0, 1), picture)
    pixels = np.round(np.clip(picture, 0, 1) * 255).astype(np.uint8)
    return Image.fromarray(pixels).resize(size, Image.Resampling.BICUBIC)


def swirl(rng: Rng, size: tuple[int, int]) -> Image.Image:
    """Paint a wallpaper of soft colours that run into each other."""
    stops = tuple(tuple(c / 255 for c in pick(rng, _ACCENTS)) for _ in range(3))
    field = noise(rng, 256, scale=(1.5, 1.5), rough=2.2)
    pixels = np.round(ramp(np.clip(0.5 + 0.3 * field, 0, 1), stops) * 255).astype(np.uint8)  # type: ignore[arg-type]
    return Image.fromarray(pixels).resize(size, Image.Resampling.BICUBIC)


def dots(rng: Rng, size: tuple[int, int]) -> Image.Image:
    """Light a dot-matrix sign: a word, an arrow or a wave of lamps, dark between them."""
    rows, columns = 16, round(16 * size[0] / size[1])
    small = Image.new("RGB", (columns, rows), (0, 0, 0))
    pen = ImageDraw.Draw(small)
    colour = pick(rng, ((255, 60, 30), (255, 150, 20), (60, 255, 90), (70, 150, 255), (255, 255, 235)))
    word = pick(rng, ("OPEN", "BAR", "GO", "CAFE", "24H", "EXIT", "HELLO", "SALE"))
    pen.fontmode = "1"
    font = ImageFont.load_default(11)
    left = (columns - pen.textlength(word, font=font)) / 2
    pen.text((max(1.0, left), 1), word, fill=colour, font=font)
    pen.rectangle((0, 0, columns - 1, rows - 1), outline=colour)
    big = np.asarray(small.resize(size, Image.Resampling.NEAREST), np.float64)
    y, x = (np.mgrid[0 : size[1], 0 : size[0]].T / (size[0] / columns, size[1] / rows)).T[::-1]
    lamp = np.clip(1.6 - 3.2 * np.hypot(x % 1 - 0.5, y % 1 - 0.5), 0, 1)
    return Image.fromarray(np.round(big * lamp[..., None]).astype(np.uint8))


@dataclass(frozen=True)
class Screen:
    """A picture's kind, width and height [pixels], and the function that paints it."""

    category: str
    size: tuple[int, int]
    paint: Callable[[Rng, tuple[int, int]], Image.Image]


_UPRIGHT, _WIDE, _SIGN = (360, 780), (960, 600), (640, 256)
SCREENS: dict[str, Screen] = {
    **{
        f"screen-upright-{paint.__name__}-{i}": Screen("screen-upright", _UPRIGHT, paint)
        for paint in (interface, icons, chat, view, swirl)
        for i in (1, 2)
    },
    **{
        f"screen-wide-{paint.__name__}-{i}": Screen("screen-wide", _WIDE, paint)
        for paint in (interface, icons, dashboard, editor, view, swirl)
        for i in (1, 2)
    },
    **{f"screen-sign-dots-{i}": Screen("screen-sign", _SIGN, dots) for i in range(1, 7)},
}


def make_screen(name: str) -> Image.Image:
    """Paint a picture by name, the same for the same name."""
    screen = SCREENS[name]
    return screen.paint(generator_of(name), screen.size)
