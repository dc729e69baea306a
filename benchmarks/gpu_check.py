"""Everything that must be seen on a GPU, in one run and on one page: Mitsuba on CUDA, Cycles on OptiX or CUDA.

The contract that every renderer keeps, how far the two agree, seconds a scene by stage, tuples at equal quality, and a
small dataset made by one and by several processes that share the GPU. Each part runs in a process of its own; its last
lines, whether it went well and how long it took by the clock stand on the page. Tuples are counted by core-seconds, in
which the GPU's own work is not seen. Where there is no GPU, that is said in one line.

    python -m benchmarks.gpu_check > page.txt
"""

import runpy
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from multilight.datagen.backends.machine.mitsuba_variant import find_gpu

TESTS = "tests/datagen/backends/"
HERE = (sys.executable, "-m")
ON_GPU = (*HERE, "benchmarks.gpu_check", "--run")
Part = Literal["contract", "agreement", "volume", "tuples", "alone", "shared"]
CYCLES_DEVICES = ("OPTIX", "CUDA")


@dataclass
class Options:
    """Which parts to run, all where none is named, and by how many processes the GPU is shared."""

    parts: tuple[Part, ...] = ()
    processes: int = 4
    seconds: float = 1800.0
    """Each part is stopped after that long."""


def commands(options: Options, folder: Path) -> dict[Part, tuple[str, ...]]:
    """Return the parts by name."""
    dataset = ("multilight", "dataset", "--preset", "mixed", "--scenes", "8", "--views", "1", "--renderer", "mitsuba")
    small = ("--width", "128", "--height", "128")
    return {
        "contract": (*ON_GPU, "pytest", "-q", TESTS + "test_contract.py"),
        "agreement": (*ON_GPU, "pytest", "-q", TESTS + "test_agreement.py"),
        "volume": (*HERE, "benchmarks.volume", "--sizes", "128", "256", "--views", "1", "4", "--clock", "wall"),
        "tuples": (*ON_GPU, "benchmarks.tuples"),
        "alone": (*HERE, *dataset, *small, "--workers", "1", "--out", str(folder / "one")),
        "shared": (*HERE, *dataset, *small, "--workers", str(options.processes), "--out", str(folder / "shared")),
    }


def use_gpu_in_cycles() -> str:
    """Let Cycles render on the GPU, by OptiX where it can; returns by what."""
    import bpy

    from multilight.datagen.backends.blender import film

    preferences = bpy.context.preferences.addons["cycles"].preferences
    for kind in CYCLES_DEVICES:
        preferences.compute_device_type = kind
        preferences.get_devices()
        devices = [device for device in preferences.devices if device.type == kind]
        for device in preferences.devices:
            device.use = device in devices
        if devices:
            film.DEVICE = "GPU"
            return f"Cycles renders by {kind} on {devices[0].name}"
    return f"Cycles finds no device for {' or '.join(CYCLES_DEVICES)} and renders on the CPU"


def main(options: Options) -> int:
    """Run the parts, print the page; returns how many went wrong."""
    gpu = find_gpu()
    if gpu.fault:
        print(f"no GPU that can be used: {gpu.fault}; nothing was run")
        return 0
    print(f"{gpu.name}, {gpu.memory / 2**30:.0f} GiB", flush=True)
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        for name, command in commands(options, Path(folder)).items():
            if options.parts and name not in options.parts:
                continue
            start = time.monotonic()
            try:
                ran = subprocess.run(command, capture_output=True, text=True, timeout=options.seconds, check=False)
                said = ran.stdout + ran.stderr[-2000:]
                told = f"exit code {ran.returncode}" if ran.returncode else "well"
            except subprocess.TimeoutExpired as error:
                said, told = str(error.stdout or ""), "stopped, it took too long"
            wrong += told != "well"
            print(f"\n## {name}: {told}, {time.monotonic() - start:.0f} s")
            print("\n".join(said.strip().splitlines()[-25:]), flush=True)
    return wrong


if __name__ == "__main__":
    if sys.argv[1:2] == ["--run"]:  # a module, with Cycles on the GPU
        print(use_gpu_in_cycles(), flush=True)
        sys.argv = sys.argv[2:]
        runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
    else:
        sys.exit(main(tyro.cli(Options)))
