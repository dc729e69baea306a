"""What is read and worked out once is kept, and no more of it than its bytes allow."""

from pathlib import Path

import numpy as np
import pytest

from multilight.scenes.assets import mesh_memory
from multilight.scenes.assets.mesh_memory import MeshMemory
from multilight.scenes.meshes import Mesh, once_a_mesh, rectangle_part
from multilight.scenes.spec import Material, Rectangle


def mesh() -> Mesh:
    return Mesh((rectangle_part(Rectangle(width=1.0, height=1.0), Material()),))


def test_the_longest_unused_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    kept, loaded = MeshMemory(), list[str]()

    def ask(name: str) -> Mesh:
        def load() -> Mesh:
            loaded.append(name)
            return mesh()

        return kept.recall(Path(name), load)

    first = ask("a")
    monkeypatch.setattr(mesh_memory, "MOST_BYTES", 2 * 2000)  # two rectangles
    assert ask("b") is not first
    assert ask("a") is first
    ask("c")  # "b" goes
    assert ask("a") is first
    ask("b")
    assert loaded == ["a", "b", "c", "b"]


def test_things_are_worked_out_once_for_each_mesh_and_question() -> None:
    asked = []

    @once_a_mesh
    def shifted(of: Mesh, by: float, *, times: int = 1) -> float:
        asked.append((by, times))
        return float(of.bounds()[1, 0]) + by * times

    one, other = mesh(), mesh()
    assert [shifted(one, 1.0), shifted(one, 1.0), shifted(one, 1.0, times=2), shifted(other, 1.0)] == [
        1.5,
        1.5,
        2.5,
        1.5,
    ]
    assert asked == [(1.0, 1), (1.0, 2), (1.0, 1)]
    with pytest.raises(ValueError, match="read-only"):
        one.vertices()[0] = 0.0
    assert np.array_equal(one.vertices(), other.vertices())
