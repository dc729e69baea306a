"""Asks native libraries what they are and whether they work; run as a program, because a broken one crashes its caller.

    python probe.py llvm LIBRARY [NEEDED...]             version of a libLLVM
    python probe.py cuda                                 driver, ray tracing, first device
    python probe.py render VARIANT [NEEDED...]           seconds to start Mitsuba and to render a tiny picture

Prints one line of JSON; `fault` says what is wrong. Needs only the standard library, `render` also Mitsuba.
"""

import ctypes
import importlib
import json
import resource
import sys
import time
from collections.abc import Sequence

OLDEST_CUDA, BUGGY_CUDA = (12, 2), (12, 7)  # Dr.Jit switches CUDA, or ray tracing on it, off below / at these
WSL = "/usr/lib/wsl/lib/"


def load_in_any_order(libraries: Sequence[str]) -> None:
    """Load shared libraries that may need one another; those that cannot be loaded are left to whoever needs them."""
    waiting = list(libraries)
    loaded = True
    while waiting and loaded:
        loaded = False
        for library in tuple(waiting):
            try:
                ctypes.CDLL(library, mode=ctypes.RTLD_GLOBAL)
            except OSError:
                continue  # needs one of the others first
            waiting.remove(library)
            loaded = True


def llvm(library: str, needed: Sequence[str]) -> dict[str, object]:
    """Return the version of a libLLVM: `version` [major, minor, patch]."""
    load_in_any_order(needed)
    try:
        loaded = ctypes.CDLL(library)
    except OSError as error:
        return {"fault": f"cannot be loaded: {error}"}
    if not hasattr(loaded, "LLVMContextCreate"):
        return {"fault": "is not LLVM"}
    if not hasattr(loaded, "LLVMGetVersion"):
        return {"fault": "is LLVM 15 or older"}  # the function came with LLVM 16
    numbers = [ctypes.c_uint() for _ in range(3)]
    loaded.LLVMGetVersion(*(ctypes.byref(number) for number in numbers))
    return {"version": [number.value for number in numbers]}


def cuda() -> dict[str, object]:
    """Return the driver's CUDA version and the first device's name and memory in bytes."""
    driver = _first(("libcuda.so.1", WSL + "libcuda.so.1"))
    if driver is None:
        return {"fault": "no NVIDIA driver (libcuda.so.1)"}
    if status := driver.cuInit(0):
        return {"fault": f"the NVIDIA driver finds no usable device (cuInit: error {status})"}
    version, count, device, memory = ctypes.c_int(), ctypes.c_int(), ctypes.c_int(), ctypes.c_size_t()
    name = ctypes.create_string_buffer(256)
    driver.cuDriverGetVersion(ctypes.byref(version))
    driver.cuDeviceGetCount(ctypes.byref(count))
    if not count.value:
        return {"fault": "the NVIDIA driver shows no device"}
    driver.cuDeviceGet(ctypes.byref(device), 0)
    driver.cuDeviceGetName(name, len(name), device)
    driver.cuDeviceTotalMem_v2(ctypes.byref(memory), device)
    found: dict[str, object] = {"name": name.value.decode(errors="replace"), "memory": memory.value}
    number = (version.value // 1000, version.value % 1000 // 10)
    if number < OLDEST_CUDA or number == BUGGY_CUDA:
        shown = ".".join(map(str, number))
        return found | {"fault": f"driver for CUDA {shown} is too old or faulty; R535 to R550, or R570 and later, work"}
    if _first(("libnvoptix.so.1", WSL + "libnvoptix.so.1")) is None:
        return found | {"fault": "libnvoptix.so.1 (ray tracing) is missing; containers need the capability 'graphics'"}
    return found


def render(variant: str, needed: Sequence[str]) -> dict[str, object]:
    """Render a grey sphere in a white room: `start` and `picture` in seconds, `mean` radiance."""
    load_in_any_order(needed)
    start = time.perf_counter()
    # By name: importing this file must not import a renderer, and only this short-lived process does.
    mitsuba = importlib.import_module("mitsuba")
    mitsuba.set_variant(variant)
    ready = time.perf_counter()
    look = mitsuba.ScalarTransform4f().look_at(origin=[0, 0, 5], target=[0, 0, 0], up=[0, 1, 0])
    film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3},
        "sensor": {"type": "perspective", "to_world": look, "film": film},
        "sphere": {"type": "sphere", "bsdf": {"type": "principled", "roughness": 0.3}},
        "room": {"type": "constant"},
    }
    picture = importlib.import_module("numpy").array(mitsuba.render(mitsuba.load_dict(scene), spp=4))
    return {"start": ready - start, "picture": time.perf_counter() - ready, "mean": float(picture.mean())}


def _first(names: Sequence[str]) -> ctypes.CDLL | None:
    for name in names:
        try:
            return ctypes.CDLL(name)
        except OSError:
            continue
    return None


def _main(words: Sequence[str]) -> None:
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # a crash is an answer, not something to keep
    match words:
        case ["llvm", library, *needed]:
            answer = llvm(library, needed)
        case ["cuda"]:
            answer = cuda()
        case ["render", variant, *needed]:
            answer = render(variant, needed)
        case _:
            raise SystemExit(__doc__)
    print(json.dumps(answer))


if __name__ == "__main__":
    _main(sys.argv[1:])
