"""Presets: named starting points of a configuration, as the values that differ from its defaults."""

from dataclasses import dataclass
from typing import Any, Literal

Preset = Literal[
    "tabletop", "room", "outdoor", "studio", "mixed", "wild", "demo", "training", "volume", "held_out", "smoke"
]


@dataclass(frozen=True)
class PresetValues:
    """What a preset is for, and its values."""

    meaning: str
    values: dict[str, Any]


_MIXED: dict[str, Any] = {
    "kind": "mixed",
    "kinds": {"tabletop": 0.4, "room": 0.4, "outdoor": 0.0, "studio": 0.2},
    "ood_kinds": ("outdoor",),
    "splits": {"train": 0.75, "val": 0.08, "test": 0.09, "test_ood": 0.08},
    "cameras": {"depth_of_field": 0.15},
}
_VOLUME: dict[str, Any] = {
    "seed": 2027,
    "scenes": 2400,
    "views": 1,
    "width": 128,
    "height": 128,
    "kind": "mixed",
    "splits": {"train": 0.85, "val": 0.03, "test": 0.06, "test_ood": 0.06},
    "cameras": {"depth_of_field": 0.15},
}
_HELD_OUT: dict[str, Any] = {
    "seed": 31415,
    "scenes": 160,
    "width": 192,
    "height": 192,
    "splits": {"train": 0.0, "val": 0.0, "test": 0.5, "test_ood": 0.5},
}
PRESETS: dict[Preset, PresetValues] = {
    "tabletop": PresetValues("still lifes on tables", {"kind": "tabletop"}),
    "room": PresetValues("furnished rooms", {"kind": "room", "lights": (2, 8), "cameras": {"lens_mm": (24.0, 50.0)}}),
    "outdoor": PresetValues(
        "open ground under a sky", {"kind": "outdoor", "lights": (1, 4), "cameras": {"depth_of_field": 0.2}}
    ),
    "studio": PresetValues(
        "a photographer's studio: key, fill and rim lights, longer lenses, some with a shallow focus",
        {"kind": "studio", "lights": (2, 8), "cameras": {"lens_mm": (35.0, 85.0), "depth_of_field": 0.3}},
    ),
    "mixed": PresetValues("all kinds; open ground is held out for the out-of-domain test", _MIXED),
    "wild": PresetValues("as mixed, with lamps and conditions in saturated colours", _MIXED | {"wild": True}),
    "demo": PresetValues(
        "a small set on which every command runs: all kinds and splits; `make dataset` makes it",
        {
            "seed": 275,
            "scenes": 8,
            "views": 6,
            "kind": "mixed",
            "kinds": {"tabletop": 0.4, "room": 0.3, "outdoor": 0.1, "studio": 0.2},
            "splits": {"train": 0.5, "val": 0.15, "test": 0.2, "test_ood": 0.15},
            "cameras": {"depth_of_field": 0.15},
        },
    ),
    "training": PresetValues(
        "what `make train` learns from: as mixed, many scenes of few views; a quarter of an hour on two idle cores",
        _MIXED | {"seed": 2026, "scenes": 60, "views": 3, "width": 192, "height": 192},
    ),
    "volume": PresetValues(
        "what the bundled weights learn from: 2,400 scenes of all kinds, one view each; several core-hours", _VOLUME
    ),
    "held_out": PresetValues(
        "what weights are measured on: scenes drawn as those of `volume`, of assets and places that it holds back",
        _VOLUME | _HELD_OUT,
    ),
    "smoke": PresetValues(
        "the smallest dataset that shows everything works: a minute or two",
        {
            "scenes": 2,
            "width": 64,
            "height": 64,
            "views": 4,
            "spp": 4,
            "conditions": 4,
            "insertable": 2,
            "objects": (3, 4),
            "lights": (2, 3),
        },
    ),
}
