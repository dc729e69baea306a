"""Choosing Mitsuba's variant, and the command `doctor`: an old or broken libLLVM must never end the process."""

import _ctypes
import importlib.util
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from multilight.datagen.backends import choose as backend_choice
from multilight.datagen.backends.choose import pick_renderer, resolve_renderer
from multilight.datagen.backends.machine import llvm
from multilight.datagen.backends.machine.fetch_llvm import fetch_llvm, known_packages
from multilight.datagen.backends.machine.llvm import Library
from multilight.datagen.backends.machine.mitsuba_variant import Choice, Gpu, choose, choose_variant, find_gpu, try_out
from multilight.datagen.backends.protocol import BackendError
from multilight.datagen.cli import main
from multilight.datagen.commands import doctor
from multilight.scenes.assets.info import AssetError
from tests import ROOT

NO_GPU = Gpu(fault="no NVIDIA driver")
AVX512 = "avx512f" in Path("/proc/cpuinfo").read_text()
OFFLINE = ("resolve", "Failed to fetch", "connect")


@pytest.fixture(autouse=True)
def _clean(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(llvm.PATH_VARIABLE, raising=False)


def installed(*majors: int) -> Path:
    """Find a real LLVM that Mitsuba cannot use, without the code under test; Debian and Ubuntu bring such along."""
    for major in majors:
        for path in Path("/usr/lib").glob(f"*-linux-gnu/libLLVM-{major}.so.1"):
            return path.resolve()
    pytest.skip(f"this machine has none of LLVM {majors}")


@pytest.fixture(scope="session")
def old() -> Path:
    return installed(14, 15, 16)


@pytest.fixture(scope="session")
def usable() -> Library:
    """The LLVM that `make assets` fetches."""
    return llvm.best(llvm.find_libraries()) or pytest.skip("no usable LLVM; `multilight doctor --fetch` fetches one")


def of(*versions: int) -> Callable[[], tuple[Library, ...]]:
    return lambda: tuple(Library(Path(f"/lib{v}.so"), (v, 1, 0), "too old" if v < 17 else "") for v in versions)


def run_python(code: str, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=os.environ | environment,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def test_a_gpu_comes_first_and_then_no_library_is_looked_for() -> None:
    def never() -> tuple[Library, ...]:
        raise AssertionError

    assert choose(Gpu("H200", 2**37), never).variant == "cuda_ad_rgb"


@pytest.mark.parametrize(
    ("versions", "taken"), [((14, 19, 15), 19), ((18, 20, 19), 20), ((17, 23), 17), ((23,), 23), ((14, 15, 16), None)]
)
def test_newest_tried_version_is_taken(versions: tuple[int, ...], taken: int | None) -> None:
    choice = choose(NO_GPU, of(*versions))
    assert choice.variant == ("llvm_ad_rgb" if taken else None)
    assert (choice.library and choice.library.version) == (taken and (taken, 1, 0))
    assert "CUDA: no NVIDIA driver" in choice.passed_over
    assert sum("too old" in line for line in choice.passed_over) == sum(v < 17 for v in versions)


def test_old_llvm_is_passed_over_even_where_it_is_asked_for(old: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(llvm.PATH_VARIABLE, str(old))
    choice = choose(NO_GPU, llvm.find_libraries)
    assert any(line.startswith(str(old)) and "17 or newer" in line for line in choice.passed_over)
    assert choice.library is None or choice.library.path != old


def test_old_llvm_under_a_new_name_is_found_out(old: Path, tmp_path: Path) -> None:
    renamed = Path(shutil.copy(old, tmp_path / "libLLVM.so.19.1"))
    assert llvm.examine(renamed).fault.endswith("LLVM 15 or older")


@pytest.mark.skipif(not AVX512, reason="LLVM 15 and 16 abort only on processors with AVX-512")
def test_why_versions_are_looked_up_first() -> None:
    aborting = Library(installed(15, 16))
    assert "SIGABRT" in try_out(Choice("llvm_ad_rgb", "to see it abort", aborting))["fault"]


def test_a_truncated_library_crashes_somebody_else(old: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cut = tmp_path / "libLLVM.so.19.1"
    with old.open("rb") as whole:
        cut.write_bytes(whole.read(8 << 20))
    monkeypatch.setenv(llvm.PATH_VARIABLE, str(cut))
    choice = choose(NO_GPU, llvm.find_libraries)
    (line,) = (line for line in choice.passed_over if line.startswith(str(cut)))
    assert "crashes" in line or "cannot be loaded" in line


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("libLLVM.so.19.1", b"not a library at all", "cannot be loaded"),
        ("libLLVM.so.20.1", b"", "cannot be loaded"),
        ("nowhere.so", None, "is not a file"),
        ("other.so", Path(_ctypes.__file__).read_bytes(), "is not LLVM"),
    ],
)
def test_rubbish_is_passed_over_with_a_reason(
    name: str, content: bytes | None, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    monkeypatch.setenv(llvm.PATH_VARIABLE, str(path))
    choice = choose(NO_GPU, llvm.find_libraries)
    assert any(line.startswith(f"{path}: {expected}") for line in choice.passed_over)


def test_the_named_library_is_preferred(usable: Library, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(llvm.PATH_VARIABLE, str(usable.path))
    other = Library(tmp_path / "libLLVM.so.22.1", (22, 0, 0))
    assert llvm.best((other, usable)) == usable
    monkeypatch.delenv(llvm.PATH_VARIABLE)
    assert llvm.best((other, replace(usable, version=(19, 1, 0)))) == other


def test_the_chosen_variant_renders(usable: Library) -> None:
    assert 0.5 < try_out(Choice("llvm_ad_rgb", "", usable))["mean"] < 1
    assert try_out(Choice(None, "no LLVM")) == {"fault": "no LLVM"}


LOADED = """
import sys
from multilight.datagen.backends.machine import mitsuba_variant
assert not {"mitsuba", "drjit"} & set(sys.modules)
choice = CHOICE
mitsuba_variant.prepare_environment(choice)
import mitsuba
mitsuba.set_variant(choice.variant or 'scalar_rgb')
mitsuba.render(mitsuba.load_dict(mitsuba.cornell_box()), spp=1)
mitsuba_variant.prepare_environment(choice)
print(sorted({line.split()[-1] for line in open("/proc/self/maps") if "libLLVM" in line}))
"""


def test_mitsuba_loads_the_chosen_library_and_no_other(usable: Library, old: Path) -> None:
    code = LOADED.replace(
        "CHOICE", "mitsuba_variant.choose(mitsuba_variant.Gpu(fault='none'), mitsuba_variant.llvm.find_libraries)"
    )
    assert run_python(code, **{llvm.PATH_VARIABLE: str(old)}).strip() == str([str(usable.path)])


def test_without_a_usable_library_none_is_loaded_at_all() -> None:
    assert run_python(LOADED.replace("CHOICE", "mitsuba_variant.Choice(None, '')")).strip() == "[]"


def test_too_late_is_refused() -> None:
    code = "import drjit\n" + LOADED.replace("CHOICE", "mitsuba_variant.Choice(None, '')").replace("assert", "#")
    with pytest.raises(AssertionError, match="imported before its libLLVM was chosen"):
        run_python(code)


def test_no_gpu_is_said() -> None:
    gpu = find_gpu()
    assert bool(gpu.name) or gpu.fault


def test_renderer_names() -> None:
    assert resolve_renderer("auto") == pick_renderer()[0]
    assert resolve_renderer("analytic") == "analytic"
    with pytest.raises(BackendError, match=r"'arnold'.*auto, mitsuba, cycles or analytic"):
        resolve_renderer("arnold")
    assert doctor.slow_note("analytic") == doctor.slow_note("cycles") == ""


def test_without_gpu_and_llvm_cycles_renders(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
                                             tmp_path: Path) -> None:  # fmt: skip
    for module in (backend_choice, doctor):
        monkeypatch.setattr(module, "choose_variant", lambda: choose(NO_GPU, tuple))
        monkeypatch.setattr(module, "has_mitsuba", lambda: True)
    assert pick_renderer()[0] == ("cycles" if importlib.util.find_spec("bpy") else "analytic")
    note = "neither a usable GPU nor LLVM 17 or newer"
    assert note in doctor.slow_note("auto")
    assert main(["dataset", "--out", str(tmp_path), "--renderer", "mitsuba"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert note in line
    assert "multilight doctor --fetch" in line


def test_a_bare_installation_is_told_what_to_install() -> None:
    nothing = doctor.Part("", "is not installed")
    assert doctor._command(Choice(None, "Mitsuba is not installed", None), (nothing,) * 3).endswith(
        "multilight[render]'"
    )


@pytest.fixture(scope="session")
def diagnosis() -> doctor.Diagnosis:
    return doctor.diagnose()


@pytest.mark.slow
def test_doctor_prints_a_table(
    diagnosis: doctor.Diagnosis, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(doctor, "diagnose", lambda: diagnosis)
    assert main(["doctor"]) == 0
    shown = capsys.readouterr().out
    for word in ("processor", "GPU", "LLVM", "Blender", "Mitsuba", "denoiser", "assets", "cache", diagnosis.renderer):
        assert word in shown


@pytest.mark.slow
def test_doctor_prints_json(
    diagnosis: doctor.Diagnosis, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(doctor, "diagnose", lambda: diagnosis)
    assert main(["doctor", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["cores"] >= 1
    assert found["choice"]["variant"] == choose_variant().variant
    assert found["mitsuba"] == {"version": found["mitsuba"]["version"], "fault": ""}
    assert found["can_render"] is True


@pytest.mark.slow
@pytest.mark.parametrize("broken", ["renderer", "denoiser"])
def test_doctor_fails_where_nothing_can_render(
    broken: str, diagnosis: doctor.Diagnosis, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    fault = doctor.Part("1.0", "ImportError: [lib] is broken")
    parts: dict[str, Any] = {"denoiser": fault} if broken == "denoiser" else {"blender": fault, "mitsuba": fault}
    monkeypatch.setattr(doctor, "diagnose", lambda: replace(diagnosis, **parts))
    assert main(["doctor"]) == 1
    assert "[lib] is broken" in capsys.readouterr().out


@pytest.mark.slow
def test_doctor_names_a_missing_system_library(tmp_path: Path) -> None:
    (tmp_path / "bpy.py").write_text("raise ImportError('libX11.so.6: cannot open shared object file')")
    done = subprocess.run(
        [sys.executable, "-m", "multilight", "doctor", "--json"],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        timeout=300,
    )
    found = json.loads(done.stdout)
    assert "libX11.so.6" in found["blender"]["fault"]
    assert found["command"] == "make system-libraries"
    assert done.returncode == (found["renderer"] == "cycles")


@pytest.mark.slow
def test_fetched_llvm_works_and_a_damaged_one_is_replaced(tmp_path: Path) -> None:
    if not known_packages():
        pytest.skip("apt offers no usable LLVM here")
    try:
        first = fetch_llvm(tmp_path)
    except AssetError as error:
        if any(word in str(error) for word in OFFLINE):
            pytest.skip(f"offline: {error}")
        raise
    assert first.path.is_relative_to(tmp_path)
    assert first in llvm.find_libraries(tmp_path)
    assert "fault" not in try_out(Choice("llvm_ad_rgb", "", first))
    first.path.write_bytes(first.path.read_bytes()[:100_000])
    assert first.path not in {library.path for library in llvm.find_libraries(tmp_path) if not library.fault}
    assert fetch_llvm(tmp_path) == first
    assert [path.name for path in (tmp_path / "llvm").iterdir()] == [first.path.relative_to(tmp_path).parts[1]]


def test_fetching_says_why_it_cannot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(AssetError, match=rf"no apt here.*{llvm.PATH_VARIABLE}"):
        fetch_llvm(tmp_path)
