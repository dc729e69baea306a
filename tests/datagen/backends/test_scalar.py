"""Mitsuba's scalar variant, light by light: the backend contract and what is its own.

One process has one variant, so all checks run in one process of their own; here each is looked up.
"""

import json
import subprocess
import sys

import pytest

from multilight.datagen.backends.choose import has_mitsuba
from tests import ROOT
from tests.datagen.backends.scalar_checks import all_checks

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not has_mitsuba(), reason="the package mitsuba is not installed"),
]


@pytest.fixture(scope="module")
def faults(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What failed, by the check's name: a traceback, empty where the check passed."""
    command = [sys.executable, "-W", "error", "-m", "tests.scalar_checks", str(tmp_path_factory.mktemp("cache"))]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return dict(json.loads(done.stdout.splitlines()[-1]))


def _nothing(_: object) -> None:
    """Stand in for a renderer, to list names only."""


@pytest.mark.parametrize("name", all_checks(_nothing, _nothing))  # type: ignore[arg-type]
def test_scalar(faults: dict[str, str], name: str) -> None:
    assert not faults[name], faults[name]
