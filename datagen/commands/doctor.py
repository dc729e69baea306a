"""The command `doctor`: what this machine has, which renderer will be used and why, what would make it faster."""

import importlib.metadata
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from multilight.datagen.backends.choose import has_mitsuba, pick_renderer
from multilight.datagen.backends.machine import llvm
from multilight.datagen.backends.machine.fetch_llvm import fetch_llvm, has_apt, known_packages
from multilight.datagen.backends.machine.memory import whole_bytes
from multilight.datagen.backends.machine.mitsuba_variant import Choice, Gpu, choose, choose_variant, find_gpu, try_out
from multilight.datagen.commands.output import progress
from multilight.datagen.config.dataset import RendererName
from multilight.datagen.tables import print_table
from multilight.scenes.assets.cache import default_cache
from multilight.scenes.assets.fetch import SOURCES, is_fetched
from multilight.scenes.assets.info import AssetError

GIB = 2**30
LOADS_BLENDER = "from multilight.datagen.backends import blender"
LOADS_DENOISER = (
    "from multilight.datagen.backends.machine import llvm, probe; "
    "probe.load_in_any_order([*map(str, llvm.unpacked_system_libraries())]); "
    "import mitsuba_oidn as oidn; oidn.Device(oidn.DeviceType.CPU)"
)


@dataclass(frozen=True)
class Part:
    """A package: its version, and what is wrong with it (empty: it works)."""

    version: str
    fault: str


@dataclass(frozen=True)
class Diagnosis:
    """What was found; memory and disk in GiB; `command` is what would help most, or empty."""

    processor: str
    cores: int
    avx512: bool
    memory: float
    gpu: Gpu
    libraries: tuple[llvm.Library, ...]
    blender: Part
    mitsuba: Part
    choice: Choice
    denoiser: Part
    packs: dict[str, bool]
    cache: Path
    free_disk: float
    renderer: RendererName
    why: str
    command: str

    @property
    def can_render(self) -> bool:
        """Whether the command `dataset` can be expected to work."""
        renderer = {"mitsuba": self.mitsuba, "cycles": self.blender}.get(self.renderer)
        return renderer is not None and not renderer.fault and not self.denoiser.fault


def report(*, as_json: bool) -> int:
    """Examine this machine, print it and return the exit code: 1 where nothing can render."""
    found = diagnose()
    if as_json:
        print(json.dumps(asdict(found) | {"can_render": found.can_render}, indent=1, default=str))
    else:
        _print(found)
    return 0 if found.can_render else 1


def fetch() -> int:
    """Fetch a libLLVM where one is needed; says in one line what there is, or why there is none, and returns 1 then."""
    choice = choose_variant()
    if choice.variant == "cuda_ad_rgb":
        print(f"LLVM: not needed, {choice.why}")
        return 0
    try:
        with progress("packages", "fetching LLVM, 130 MB"):
            library = choice.library or fetch_llvm()
    except AssetError as error:
        print(f"LLVM: {error}", file=sys.stderr)
        return 1
    print(f"LLVM {library.shown_version}: {library.path}")
    return 0


def slow_note(wanted: str) -> str:
    """Return one line where Mitsuba is installed but cannot run and `wanted` would have taken it; else nothing."""
    if wanted != "auto" or not has_mitsuba() or choose_variant().variant is not None:
        return ""
    renderer, why = pick_renderer()
    return f"{why}: rendering with {renderer}; `multilight doctor` says what is faster"


def diagnose() -> Diagnosis:
    """Look at this machine; starts each renderer in a process of its own (some seconds)."""
    gpu, libraries, cache = find_gpu(), llvm.find_libraries(), default_cache()
    choice = choose(gpu, lambda: libraries)
    blender, denoiser = _part("bpy", LOADS_BLENDER), _part("mitsuba-oidn", LOADS_DENOISER)
    mitsuba = Part(_version("mitsuba"), "")
    if mitsuba.version:
        mitsuba = Part(mitsuba.version, str(try_out(choice).get("fault", "")))
    renderer, why = pick_renderer()
    return Diagnosis(
        processor=_first_match("/proc/cpuinfo", r"model name\s*:\s*(.+)") or os.uname().machine,
        cores=len(os.sched_getaffinity(0)),
        avx512=_first_match("/proc/cpuinfo", r"flags\s*:.*(avx512f)") != "",
        memory=whole_bytes() / GIB,
        gpu=gpu,
        libraries=libraries,
        blender=blender,
        mitsuba=mitsuba,
        choice=choice,
        denoiser=denoiser,
        packs={name: is_fetched(name, cache) for name in SOURCES},
        cache=cache,
        free_disk=shutil.disk_usage(next(p for p in (cache, *cache.parents) if os.path.exists(p))).free / GIB,
        renderer=renderer,
        why=why,
        command=_command(choice, (blender, mitsuba, denoiser)),
    )


def _command(choice: Choice, parts: Sequence[Part]) -> str:
    """Return the one command that helps most; empty where only other hardware would."""
    if not any(part.version for part in parts):
        return "pip install 'multilight[render]'"
    if any(llvm.MISSING_LIBRARY in part.fault for part in parts):
        return "make system-libraries"
    if choice.variant is not None:
        return ""
    if known_packages():
        return "multilight doctor --fetch"
    return "sudo apt-get update && multilight doctor --fetch" if has_apt() else ""


def _part(package: str, code: str) -> Part:
    """Try a package in a process of its own: it may crash, and must not stay loaded."""
    version = _version(package)
    if not version:
        return Part("", "is not installed")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, errors="replace", check=False)
    if done.returncode == 0:
        return Part(version, "")
    return Part(version, llvm.last_words(done.stderr))


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return ""


def _first_match(file: str, pattern: str) -> str:
    try:
        found = re.search(pattern, Path(file).read_text(errors="replace"))
    except OSError:
        return ""
    return found[1].strip() if found else ""


def _print(found: Diagnosis) -> None:
    print_table(("", ""), list(_rows(found)))
    if found.command:
        gain = "To make it faster" if found.can_render else "To make it work"
        packages = known_packages() if "--fetch" in found.command else []
        what = f"   (unpacks {packages[0]} into the cache; needs no root)" if packages else ""
        print(f"{gain}: {found.command}{what}")
    if not found.can_render:
        print("Nothing can be rendered here as things are: see the rows Blender, Mitsuba and denoiser.")


def _rows(found: Diagnosis) -> Iterator[tuple[str, str]]:
    cores = f"{found.cores} cores" if found.cores > 1 else "1 core"
    yield "processor", f"{found.processor}, {cores}, {'with' if found.avx512 else 'without'} AVX-512"
    yield "memory", f"{found.memory:.1f} GiB"
    gpu = f"{found.gpu.name}, {found.gpu.memory / GIB:.0f} GiB" if found.gpu.name else "none"
    yield "GPU", f"{gpu}: {found.gpu.fault}" if found.gpu.fault else gpu
    for library in found.libraries:
        yield "LLVM", f"{library.path}: {library.fault or f'{library.shown_version}, can be used'}"
    if not found.libraries:
        yield "LLVM", "none found"
    yield "Blender", _shown(found.blender)
    yield "Mitsuba", _shown(found.mitsuba)
    yield "variant", f"{found.choice.variant or 'none'}: {found.choice.why}"
    yield "denoiser", _shown(found.denoiser)
    yield "assets", ", ".join(f"{name}{'' if there else ' (not fetched)'}" for name, there in found.packs.items())
    yield "cache", f"{found.cache}, {found.free_disk:.1f} GiB free"
    yield "renderer", f"{found.renderer}: {found.why}"


def _shown(part: Part) -> str:
    if not part.version:
        return "is not installed"
    return f"{part.version}: {part.fault}" if part.fault else f"{part.version}, works"
