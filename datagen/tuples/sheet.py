"""Contact sheets: scenes x (background, composite, target, depth, effect), tone-mapped for the eye."""

from collections.abc import Iterable
from itertools import islice
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from multilight.datagen.storage.open_dataset import DatasetSource
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.store import ViewData, read_view
from multilight.datagen.tuples import compose
from multilight.datagen.tuples.pictures import depth_picture, effect_picture
from multilight.lights.display.tonemap import to_display
from multilight.lights.spec import LightingCondition
from multilight.scenes.arrays import UInt8

COLUMNS = ("background", "composite", "target", "z_depth", "effect")
MARGIN, HEADER = 6, 20
SHOWN = 0.01
"""Fraction of a picture that its largest insertable object should cover to be looked at."""


def two_conditions(record: SceneRecord, shift: int) -> tuple[LightingCondition, LightingCondition]:
    """Choose the lighting of the inserted object (few lights) and of the base picture (many lights)."""
    by_lights = sorted(record.conditions, key=lambda condition: -len(condition.gains))
    half = max(1, len(by_lights) // 2)
    rich, poor = by_lights[:half], by_lights[half:] or by_lights
    return poor[shift % len(poor)], rich[shift % len(rich)]


def scene_row(record: SceneRecord, data: ViewData, *, shift: int) -> list[UInt8]:
    """Make one row of pictures in the order of `COLUMNS`, each (H, W, 3) uint8."""
    largest = max(data.coverage, key=lambda name: float(data.coverage[name].sum()))
    insert, base = two_conditions(record, shift)
    return [
        to_display(compose.background(data, largest, base)),
        to_display(compose.composite(data, largest, insert=insert, base=base)),
        to_display(compose.target(data, base)),
        depth_picture(data.geometry.z_depth),
        effect_picture(compose.effect(data, largest, base)),
    ]


def save_preview(folder: Path, record: SceneRecord) -> None:
    """Write `preview.png`: four views from distant to close, with all lights on."""
    lit = next((c for c in record.conditions if len(c.gains) == len(record.rig.lights)), record.conditions[-1])
    views = np.unique(np.linspace(0, len(record.views) - 1, 4).round().astype(int))
    pictures = [to_display(compose.target(read_view(folder / record.views[v].file, compact=True), lit)) for v in views]
    image = Image.fromarray(np.concatenate(pictures, axis=1))
    image.thumbnail((1024, 256))
    image.save(folder / "preview.png")


def telling_view(views: Iterable[tuple[int, ViewData]]) -> tuple[int, ViewData]:
    """Return the first view that shows an insertable object well, or else the one that shows most; reads no further."""
    best, most = None, -1.0
    for number, data in views:
        covered = max(float(coverage.mean()) for coverage in data.coverage.values())
        if covered > most:
            best, most = (number, data), covered
        if covered >= SHOWN:
            break
    assert best is not None, "a scene has a view"
    return best


def contact_sheet(source: DatasetSource, *, scenes: int, cell: int = 256) -> Image.Image:
    """Lay out one row a scene, of the first ones, from views and under pairs of lightings in turn."""
    rows = []
    for number, record in enumerate(islice(source.scenes(), scenes)):
        count, first = len(record.views), len(record.views) * (2 * number + 1) // 5
        view, data = telling_view((v % count, source.view(record, v % count)) for v in range(first, first + count))
        rows.append((record, view, scene_row(record, data, shift=number)))
    height, width = rows[0][2][0].shape[:2]
    cell_h = round(cell * height / width)
    size = (MARGIN + len(COLUMNS) * (cell + MARGIN), HEADER + len(rows) * (cell_h + HEADER))
    sheet = Image.new("RGB", size, "white")
    draw = ImageDraw.Draw(sheet)
    for column, title in enumerate(COLUMNS):
        draw.text((MARGIN + column * (cell + MARGIN), 4), title, fill="black")
    for row, (record, view, pictures) in enumerate(rows):
        top = HEADER + row * (cell_h + HEADER)
        for column, picture in enumerate(pictures):
            scaled = Image.fromarray(picture).resize((cell, cell_h), Image.Resampling.LANCZOS)
            sheet.paste(scaled, (MARGIN + column * (cell + MARGIN), top))
        insert, base = two_conditions(record, row)
        caption = f"scene {record.index}, view {view}: object lit by {insert.name}, picture by {base.name}"
        draw.text((MARGIN, top + cell_h + 2), caption, fill="gray")
    return sheet
