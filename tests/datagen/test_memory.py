"""The number of workers follows the memory."""

import os

import pytest

from multilight.datagen.config.dataset import DatasetConfig
from multilight.datagen.production import memory


def config(side: int) -> DatasetConfig:
    return DatasetConfig(width=side, height=side)


def test_few_workers_where_memory_is_short(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(16)))
    monkeypatch.setattr(memory, "free_bytes", lambda: 5 * memory.worker_bytes(config(128)))
    assert memory.default_workers(100, config(128)) == 5
    line = capsys.readouterr().err
    assert "5 instead of 16 workers" in line
    assert "--workers" in line
    assert memory.default_workers(4, config(128)) == 4
    assert 1 <= memory.default_workers(100, config(1024)) < 5
    monkeypatch.setattr(memory, "free_bytes", lambda: 0)
    assert memory.default_workers(100, config(128)) == 1


def test_a_large_picture_takes_less_than_its_pixels_would() -> None:
    assert memory.worker_bytes(config(1024)) < memory.worker_bytes(config(2048)) < 5e9
    assert 0 < memory.free_bytes() < 1e15
