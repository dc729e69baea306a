"""Tests, in folders as the sources."""

from pathlib import Path

ROOT = Path(__file__).parent.parent
