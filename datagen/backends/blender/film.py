"""Cycles' settings, and one render as named float arrays."""

import contextlib
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np
import OpenEXR

from multilight.datagen.backends.blender.materials import ALBEDO_AOV, SURFACE_AOV
from multilight.datagen.backends.protocol import BackendError, RenderSettings
from multilight.scenes.arrays import Float32

Passes = dict[str, Float32]
DEVICE = "CPU"
"""What Cycles renders on; `benchmarks.gpu_check` puts "GPU" here."""
_LAYER = "view"


def configure(settings: RenderSettings, lights: tuple[str, ...]) -> None:
    """Set what stays the same between the jobs of a scene: paths without clamping, one light group a light."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.resolution_percentage = 100
    scene.render.use_persistent_data = True
    scene.render.use_compositing = scene.render.use_sequencer = False
    scene.render.use_stamp = scene.render.use_file_extension = False
    scene.render.threads_mode = "FIXED" if settings.threads else "AUTO"
    if settings.threads:
        scene.render.threads = settings.threads
    output = scene.render.image_settings
    if hasattr(output, "media_type"):  # Blender 5 asks for the kind of file first
        output.media_type = "MULTI_LAYER_IMAGE"
    output.file_format, output.color_depth, output.exr_codec = "OPEN_EXR_MULTILAYER", "32", "NONE"
    _configure_cycles(scene.cycles, settings)
    _configure_passes(scene.view_layers[0], lights)


def _configure_cycles(cycles: bpy.types.PropertyGroup, settings: RenderSettings) -> None:
    cycles.device = DEVICE
    cycles.use_adaptive_sampling = cycles.use_denoising = cycles.use_auto_tile = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.light_sampling_threshold = 0.0
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = settings.max_bounces
    cycles.transmission_bounces = settings.max_bounces
    cycles.transparent_max_bounces = 32
    cycles.caustics_reflective = cycles.caustics_refractive = True
    # Tames fireflies; measured bias about 1 % of a layer's mean, all of it where caustics fall.
    cycles.blur_glossy = 0.25
    # At equal samples a tree over the lights gives layers of equal noise, at a fifth more time; and without it
    # a light's samples depend on no other light's power.
    cycles.use_light_tree = False
    cycles.sampling_pattern = "TABULATED_SOBOL"


def _configure_passes(layer: bpy.types.ViewLayer, lights: tuple[str, ...]) -> None:
    layer.name = _LAYER
    layer.use_pass_z = layer.use_pass_normal = layer.use_pass_object_index = True
    layer.cycles.denoising_store_passes = True
    for name in (ALBEDO_AOV, SURFACE_AOV):
        aov = layer.aovs.add()
        aov.name, aov.type = name, "COLOR"
    for name in lights:
        layer.lightgroups.add(name=name)


def beauty_filter(spp: int) -> None:
    """Average `spp` samples over each pixel's own square, so that a sample counts for one pixel only."""
    cycles = bpy.context.scene.cycles
    cycles.samples, cycles.pixel_filter_type = spp, "BOX"


def centre_filter() -> None:
    """Take one sample through each pixel's centre, to half a hundredth of a pixel, and through a pinhole."""
    cycles = bpy.context.scene.cycles
    # A box filter would ignore the width.
    cycles.samples, cycles.pixel_filter_type, cycles.filter_width = 1, "GAUSSIAN", 0.01
    bpy.context.scene.camera.data.dof.use_dof = False  # `place_camera` opens the lens again


def render_passes() -> Passes:
    """Render and return every pass by name, (H, W, channels) or (H, W) float32, top row first.

    Raises `BackendError` with the end of Blender's own log where the render fails.
    """
    with _memory_file() as path, _quiet() as log:
        bpy.context.scene.render.filepath = path
        try:
            bpy.ops.render.render(write_still=True)
            return _read(path)
        except RuntimeError as error:
            # Nothing to read means that nothing was written, which Blender only mentions in its log.
            raise BackendError(f"Cycles failed: {error}; its log ends: {_tail(log)}") from error


@contextlib.contextmanager
def _memory_file() -> Iterator[str]:
    """Yield the path of a file in memory.

    Unlike a file in /dev/shm it vanishes with the process, however that ends, and has no limit of its own.
    """
    file = os.memfd_create("render")
    try:
        yield f"/proc/self/fd/{file}"
    finally:
        os.close(file)


def _read(path: str) -> Passes:
    """Read a multilayer file and join its channels (`view.<pass>.<channel>`) to passes."""
    channels: dict[str, dict[str, Float32]] = {}
    with OpenEXR.File(path, separate_channels=True, num_threads=0) as file:
        for name, channel in file.parts[0].channels.items():
            group, _, letter = name.removeprefix(f"{_LAYER}.").rpartition(".")
            channels.setdefault(group, {})[letter] = channel.pixels
    return {name: _join(letters) for name, letters in channels.items()}


def _join(letters: dict[str, Float32]) -> Float32:
    if len(letters) == 1:
        return next(iter(letters.values()))
    return np.stack([letters[letter] for letter in "RGBAXYZ" if letter in letters], axis=-1)


@contextlib.contextmanager
def _quiet() -> Iterator[Path]:
    """Send what Blender's C code prints to a log file instead of standard output; errors stay on stderr."""
    sys.stdout.flush()
    saved = os.dup(1)
    with tempfile.NamedTemporaryFile(prefix="multilight-", suffix=".log") as log:
        os.dup2(log.fileno(), 1)
        try:
            yield Path(log.name)
        finally:
            os.dup2(saved, 1)
            os.close(saved)


def _tail(log: Path) -> str:
    return " | ".join(log.read_text(errors="replace").splitlines()[-3:])
