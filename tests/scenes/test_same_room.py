"""A room of a user's own, as .blend, GLB and USD, is one room: the same scenes are drawn in it, and look the same."""

import importlib.util
import subprocess
import sys
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from multilight.datagen.backends.choose import open_backend
from multilight.datagen.backends.machine.mitsuba_variant import choose_variant
from multilight.datagen.backends.protocol import RenderJob, RenderSettings
from multilight.datagen.config.dataset import load_config
from multilight.datagen.production.denoise import denoise_all
from multilight.datagen.production.scene import sample_scene
from multilight.lights.display.tonemap import meter_ev, to_display
from multilight.scenes.arrays import Float32
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.random_streams import Streams
from tests import ROOT

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(choose_variant().variant is None, reason="Mitsuba cannot run here"),
    pytest.mark.skipif(importlib.util.find_spec("bpy") is None, reason="the package bpy is not installed"),
]
LEAST = 34.0
"""Decibels between any two; docs/measurements.md has what is measured at a larger size."""
WIDTH, HEIGHT, SPP = 96, 72, 64


def test_a_room_looks_the_same_in_every_format(tmp_path: Path) -> None:
    subprocess.run(
        [sys.executable, "-m", "tests.scenes.same_room", str(tmp_path)], cwd=ROOT, check=True, capture_output=True
    )
    drawn: dict[str, Any] = {}
    shown: dict[str, Float32] = {}
    for kind in ("blend", "glb", "usdc"):
        file = tmp_path / f"room.{kind}"
        said = {"kind": "custom", "seed": 5, "views": 1, "width": WIDTH, "height": HEIGHT, "background": file}
        library = AssetLibrary(tmp_path / "cache", packs=("builtin",), background=file)
        scene, rig = sample_scene(load_config(None, said), library, Streams(5, 0, 0))
        rig = rig.model_copy(update={"lights": tuple(sorted(rig.lights, key=lambda light: light.kind))})
        with open_backend("mitsuba", library) as backend:
            stack = backend.render(RenderJob(scene, rig, RenderSettings(spp=SPP, threads=2), 0))
        drawn[kind] = [(b.category, np.round(b.world_from_body, 3).tolist()) for b in scene.bodies if b.insertable]
        shown[kind] = denoise_all(stack, threads=2).sum(axis=0)
        assert len(rig.lights) >= 4
    assert drawn["blend"] == drawn["glb"] == drawn["usdc"]
    exposure = meter_ev(shown["blend"])
    pictures = {kind: to_display(shown[kind], exposure).astype(float) for kind in shown}
    found = {pair: 10 * np.log10(255**2 / np.mean((pictures[pair[0]] - pictures[pair[1]]) ** 2))
             for pair in combinations(pictures, 2)}  # fmt: skip
    print({pair: round(float(value), 1) for pair, value in found.items()})
    assert min(found.values()) > LEAST, found
