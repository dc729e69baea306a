"""The README's command `make dataset`, in the repository's own environment."""

import subprocess
from pathlib import Path

import pytest

from tests import ROOT

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (ROOT / ".venv" / "installed").exists(), reason="needs the environment that make sets up"),
]


def make(*words: str) -> str:
    done = subprocess.run(["make", *words], cwd=ROOT, capture_output=True, text=True, timeout=540)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return done.stdout


def test_make_dataset_then_nothing_to_do(tmp_path: Path) -> None:
    config = tmp_path / "tiny.toml"
    config.write_text("width = 64\nheight = 64\nviews = 2\nspp = 2\n")
    words = ("dataset", f"OUT={tmp_path / 'd'}", "SCENES=1", "SEED=3", "WORKERS=1", f"CONFIG={config}")
    first = make(*words)
    sheet = tmp_path / "d" / "contact_sheet.png"
    assert f"contact sheet: {sheet}" in first
    assert sheet.stat().st_size > 10_000
    second = make(*words)
    assert "nothing to do" in second
    assert f"contact sheet: {sheet}" in second
