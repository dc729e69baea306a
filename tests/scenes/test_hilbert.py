"""Hilbert curves: bijection, locality, published values, stable order."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from multilight.scenes.arrays import Int64
from multilight.scenes.gaussians.curves import box_cells, curve_order, fold, hilbert_index, morton_index


def curve(bits: int, dimensions: int) -> Int64:
    """List all cells in the curve's order."""
    grid = np.stack(np.meshgrid(*[np.arange(1 << bits)] * dimensions, indexing="ij"), axis=-1).reshape(-1, dimensions)
    return grid[np.argsort(hilbert_index(grid, bits))]


def _wikipedia_d2xy(n: int, d: int) -> tuple[int, int]:
    """https://en.wikipedia.org/wiki/Hilbert_curve, `d2xy`, in the article's own words."""
    x = y = 0
    t, s = d, 1
    while s < n:
        rx = 1 & (t // 2)
        ry = 1 & (t ^ rx)
        if ry == 0:
            if rx == 1:
                x, y = s - 1 - x, s - 1 - y
            x, y = y, x
        x += s * rx
        y += s * ry
        t //= 4
        s *= 2
    return x, y


@pytest.mark.parametrize(("dimensions", "bits"), [(2, 1), (2, 2), (2, 5), (2, 8), (3, 1), (3, 2), (3, 5)])
def test_visits_each_cell_once_and_steps_to_a_neighbour(dimensions: int, bits: int) -> None:
    cells = curve(bits, dimensions)
    assert (np.abs(np.diff(cells, axis=0)).sum(axis=1) == 1).all()
    np.testing.assert_array_equal(hilbert_index(cells, bits), np.arange(1 << (bits * dimensions)))


@pytest.mark.parametrize("bits", [1, 2, 3, 6])
def test_two_dimensions_as_in_wikipedia(bits: int) -> None:
    expected = [_wikipedia_d2xy(1 << bits, d) for d in range(1 << (2 * bits))]
    np.testing.assert_array_equal(curve(bits, 2), expected)


def test_first_orders_as_drawn_by_hilbert() -> None:
    assert curve(1, 2).tolist() == [[0, 0], [0, 1], [1, 1], [1, 0]]
    assert curve(2, 2).tolist() == [
        *([0, 0], [1, 0], [1, 1], [0, 1]),
        *([0, 2], [0, 3], [1, 3], [1, 2]),
        *([2, 2], [2, 3], [3, 3], [3, 2]),
        *([3, 1], [2, 1], [2, 0], [3, 0]),
    ]
    # The reflected Gray code: what Skilling's transform gives for one bit an axis.
    gray = [[0, 0, 0], [0, 0, 1], [0, 1, 1], [0, 1, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1], [1, 0, 0]]
    assert curve(1, 3).tolist() == gray


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 21), st.lists(st.tuples(*[st.integers(0, 2**21 - 1)] * 3), min_size=1, max_size=20))
def test_cells_have_indices_of_their_own_up_to_63_bits(bits: int, cells: list[tuple[int, int, int]]) -> None:
    inside = np.unique(np.array(cells) % (1 << bits), axis=0)
    index = hilbert_index(inside, bits)
    assert len(np.unique(index)) == len(inside)
    assert 0 <= index.min() <= index.max() < 1 << (3 * bits)
    beside = np.clip(inside + [[0, 0, 1]], 0, (1 << bits) - 1)
    assert ((hilbert_index(beside, bits) == index) == (beside == inside).all(axis=1)).all()


@pytest.mark.parametrize("dimensions", [2, 3])
def test_coarser_curve_is_the_finer_ones_outline(dimensions: int) -> None:
    """Dropping the lowest bit of every axis drops as many bits of the index: the curve is nested, up to a turn."""
    cells = curve(4, dimensions)
    blocks = (cells >> 1).reshape(-1, 1 << dimensions, dimensions)
    assert (blocks == blocks[:, :1]).all()


def test_hilbert_is_closer_than_morton() -> None:
    grid = np.stack(np.meshgrid(*[np.arange(16)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    jumps = {
        index: np.abs(np.diff(grid[np.argsort(index(grid, 4))], axis=0)).sum(axis=1)
        for index in (hilbert_index, morton_index)
    }
    assert jumps[hilbert_index].max() == 1
    assert jumps[morton_index].mean() > 1.5
    assert morton_index(np.array([[1, 0, 0], [0, 0, 1], [3, 3, 3]]), 2).tolist() == [4, 1, 63]


def test_fold_goes_from_corner_to_corner_in_single_steps() -> None:
    cells = fold(16)
    assert cells[0].tolist() == [0, 0]
    assert cells[-1].tolist() == [0, 15]
    assert (np.abs(np.diff(cells, axis=0)).sum(axis=1) == 1).all()
    assert len(np.unique(cells, axis=0)) == 256
    assert fold(2).tolist() == [[0, 0], [1, 0], [1, 1], [0, 1]]
    assert fold(1).tolist() == [[0, 0]]


def test_points_of_one_cell_keep_their_order() -> None:
    corners = np.array([[0.0, 0, 0], [8, 8, 8]])
    inside = np.array([[3.2, 3.4, 3.1], [3.3, 3.1, 3.9], [3.9, 3.5, 3.0]])
    order = curve_order(np.concatenate([corners, inside, inside[::-1]]), bits=3).tolist()
    assert [i for i in order if i >= 2] == [2, 3, 4, 5, 6, 7]
    assert order[0] == 0


def test_neighbours_on_the_curve_are_near_in_space() -> None:
    points = np.random.default_rng(0).random((4096, 3)) * [1.0, 5.0, 0.2]
    ordered = points[curve_order(points)] / [1.0, 5.0, 0.2]
    assert np.linalg.norm(np.diff(ordered, axis=0), axis=1).mean() < 2.0 / 16  # the grid's own spacing is 1/16


def test_order_does_not_change_with_place_and_size() -> None:
    points = np.random.default_rng(1).random((512, 3))
    moved = points * [4.0, 0.5, 2.0] + [16.0, -4.0, 1.0]
    assert (box_cells(moved, 4) != box_cells(points, 4)).mean() < 0.01  # rounding at cells' edges
    flat = points * [1.0, 1.0, 0.0]
    assert sorted(curve_order(flat).tolist()) == list(range(512))


@pytest.mark.parametrize(
    ("call", "reason"),
    [
        (lambda: hilbert_index(np.array([[0, 4]]), 2), "outside"),
        (lambda: hilbert_index(np.array([[0, -1]]), 2), "outside"),
        (lambda: hilbert_index(np.array([[0.5, 1.0]]), 2), "integers"),
        (lambda: hilbert_index(np.array([[0, 0, 0, 0]]), 2), "2 or 3 dimensions"),
        (lambda: hilbert_index(np.array([[0, 0, 0]]), 22), "1 to 21"),
        (lambda: curve_order(np.array([[0.0, np.nan, 0.0]])), "finite"),
        (lambda: fold(48), "power of two, not 48"),
    ],
)
def test_what_cannot_be_is_refused(call: object, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        call()  # type: ignore[operator]
