"""Chooses Mitsuba's variant for this machine before Mitsuba is imported: CUDA, else LLVM, else none.

Neither `mitsuba` nor `drjit` is imported here: `import drjit` loads a libLLVM at once, so all is decided before.
"""

import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

from multilight.datagen.backends.machine import llvm, probe
from multilight.datagen.backends.protocol import BackendError

VariantName = Literal["cuda_ad_rgb", "llvm_ad_rgb"]


@dataclass(frozen=True)
class Gpu:
    """The first NVIDIA device: memory in bytes; `fault` is empty where Mitsuba can use it."""

    name: str = ""
    memory: int = 0
    fault: str = ""


@dataclass(frozen=True)
class Choice:
    """A variant (None: Mitsuba cannot run here), why, the libLLVM that goes with it, and what was passed over (a line
    each)."""

    variant: VariantName | None
    why: str
    library: llvm.Library | None = None
    passed_over: tuple[str, ...] = ()


def find_gpu() -> Gpu:
    """Ask the NVIDIA driver, if there is one, for its first device."""
    answer = llvm.ask("cuda")
    return Gpu(str(answer.get("name", "")), int(answer.get("memory", 0)), str(answer.get("fault", "")))


@cache
def choose_variant() -> Choice:
    """Look at this machine, once a process, and choose; takes some tenths of a second, never fails."""
    return choose(find_gpu(), llvm.find_libraries)


def choose(gpu: Gpu, libraries: Callable[[], tuple[llvm.Library, ...]]) -> Choice:
    """Choose a variant for a machine; libraries are looked for only where there is no usable GPU."""
    if not gpu.fault:
        return Choice("cuda_ad_rgb", f"{gpu.name} can be used")
    found = libraries()
    passed_over = (f"CUDA: {gpu.fault}", *(f"{lib.path}: {lib.fault}" for lib in found if lib.fault))
    library = llvm.best(found)
    if library is not None:
        return Choice("llvm_ad_rgb", f"no usable GPU, but LLVM {library.shown_version}", library, passed_over)
    return Choice(None, f"neither a usable GPU nor LLVM {llvm.OLDEST_USABLE} or newer", None, passed_over)


def prepare_environment(choice: Choice) -> None:
    """Make `import mitsuba` load the chosen libLLVM and no other; child processes inherit it.

    Raises `BackendError` where Dr.Jit has been imported before, with another library.
    """
    wanted = _library_path(choice)
    if "drjit" in sys.modules:
        if llvm.PATH_VARIABLE not in os.environ or llvm.named_library() != Path(wanted):
            raise BackendError(
                "Dr.Jit was imported before its libLLVM was chosen; call prepare_environment first, "
                f"or set {llvm.PATH_VARIABLE}={wanted}"
            )
        return
    os.environ[llvm.PATH_VARIABLE] = wanted
    probe.load_in_any_order(_needs(choice))


def try_out(choice: Choice) -> dict[str, Any]:
    """Render a tiny picture in a process of its own: `start`, `picture` (seconds), `mean`; or `fault`."""
    if choice.variant is None:
        return {"fault": choice.why}
    environment = os.environ | {llvm.PATH_VARIABLE: _library_path(choice)}
    return llvm.ask("render", choice.variant, *_needs(choice), environment=environment)


def _needs(choice: Choice) -> list[str]:
    own = choice.library.needs if choice.library else ()
    return [str(path) for path in (*llvm.unpacked_system_libraries(), *own)]


def _library_path(choice: Choice) -> str:
    # Without a library of our choice Dr.Jit would load whichever the system has, even one that crashes on loading.
    return str(choice.library.path) if choice.library else llvm.NOWHERE
