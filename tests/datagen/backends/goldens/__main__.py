"""Render the goldens of some backends anew."""

import os
import sys
import tempfile
from pathlib import Path

from multilight.datagen.backends.choose import open_backend, resolve_renderer
from multilight.datagen.backends.machine.mitsuba_variant import choose_variant, prepare_environment
from multilight.scenes.assets.library import AssetLibrary
from tests.datagen.backends.goldens import CASES, measure, save

prepare_environment(choose_variant())
for wanted in sys.argv[1:]:
    with tempfile.TemporaryDirectory() as cache:
        library = AssetLibrary(cache=Path(cache), packs=("builtin",))
        with open_backend(resolve_renderer(wanted), library) as backend:
            for case in CASES:
                save(f"{wanted}-{case}", measure(backend, case))
                print(wanted, case, flush=True)
sys.stdout.flush()
os._exit(0)  # Blender's own clean-up now and then waits for ever
