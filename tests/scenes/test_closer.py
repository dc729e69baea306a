"""Views that move in on an object: nearer, larger in the picture, same lens; refused where no place is good."""

import numpy as np
import pytest

from multilight.scenes.cameras.close_ups import MOVES_IN, closer_views, move_in
from multilight.scenes.cameras.pinhole import camera_from_lens, focal_length_mm, look_at, project
from multilight.scenes.spec import Camera

POINTS = np.random.default_rng(0).normal(size=(200, 3)) * 0.02 + np.array([0.3, 0.1, 0.8])


def path(count: int = 6) -> tuple[Camera, ...]:
    eyes = [np.array([1.5 - 0.1 * i, -1.8, 1.4]) for i in range(count)]
    return tuple(camera_from_lens(look_at(eye, np.zeros(3)), width=96, height=64, focal_length_mm=35.0) for eye in eyes)


def size(camera: Camera) -> float:
    return float(np.ptp(project(camera, POINTS)[0], axis=0).max() / camera.height)


def test_the_last_views_move_in() -> None:
    before = path()
    after = move_in(np.random.default_rng(1), before, POINTS, 2, lambda camera: True)
    assert after[:4] == before[:4]
    assert size(after[5]) > size(after[4]) > 2.5 * size(before[5])
    assert 0.25 < size(after[5]) < 1.0
    for camera in after:
        assert focal_length_mm(camera) == pytest.approx(35.0)
        pixels, depth = project(camera, POINTS)
        assert (depth > 0).all()
    pixels, _ = project(after[5], POINTS)
    assert (pixels > 0).all()
    assert (pixels < [96, 64]).all()


def test_nothing_moves_where_no_place_is_good_or_it_would_be_no_closer() -> None:
    before = path()
    assert move_in(np.random.default_rng(1), before, POINTS, 3, lambda camera: False) == before
    far = POINTS + 40 * (POINTS - POINTS.mean(axis=0))
    assert move_in(np.random.default_rng(1), before, far, 3, lambda camera: True) == before


def test_enough_views_are_left_to_show_everything() -> None:
    rng = np.random.default_rng(2)
    counts = [closer_views(rng, 16, 0.7) for _ in range(400)]
    assert set(counts) == {0, 3}
    assert np.mean(np.array(counts) > 0) == pytest.approx(MOVES_IN, abs=0.08)
    assert closer_views(rng, 16, 1.0) == 0
    assert closer_views(rng, 1, 0.7) == 0
