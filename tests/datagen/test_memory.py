"""The number of workers follows the memory."""

import os

import pytest

from multilight.datagen.config.dataset import DatasetConfig
from multilight.datagen.production import memory

TAKEN = {128: 0.75, 256: 0.99, 512: 1.43, 1024: 1.49, 2048: 3.16}
"""Gigabytes that a process took for its first view, a tabletop of four lights, by the side of the picture."""
KEPT = {10: 1.56, 20: 1.97, 50: 2.34}
"""Gigabytes that a worker had after so many scenes of 48 x 48 pixels."""


def config(side: int) -> DatasetConfig:
    return DatasetConfig(width=side, height=side)


def test_few_workers_where_memory_is_short(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(16)))
    monkeypatch.setattr(memory, "free_bytes", lambda: 5 * memory.worker_bytes(config(128), 20))
    assert memory.default_workers(100, config(128)) == 5
    line = capsys.readouterr().err
    assert "5 instead of 16 workers" in line
    assert "--workers" in line
    assert memory.default_workers(4, config(128)) == 4
    assert memory.default_workers(16, config(128)) > 5, "such workers make few scenes"
    assert 1 <= memory.default_workers(100, config(2048)) < 5
    monkeypatch.setattr(memory, "free_bytes", lambda: 0)
    assert memory.default_workers(100, config(128)) == 1


def test_what_is_predicted_is_what_was_measured() -> None:
    for side, taken in TAKEN.items():
        assert memory.worker_bytes(config(side)) / 1e9 == pytest.approx(taken, rel=0.15)
    for scenes, taken in KEPT.items():
        assert memory.worker_bytes(config(48), scenes) / 1e9 == pytest.approx(taken, rel=0.15)
    assert memory.worker_bytes(config(2048), 50) == memory.worker_bytes(config(2048)) < 4e9
    assert 0 < memory.free_bytes() < 1e15
