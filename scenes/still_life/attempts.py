"""Attempts at a scene: what every sampler is told, and trying again until nothing is in the way."""

from collections.abc import Callable
from typing import Annotated, TypeVar

from pydantic import Field, PositiveInt

from multilight.scenes.cameras.paths import CameraSettings
from multilight.scenes.cameras.trajectory import TrajectoryError
from multilight.scenes.errors import MultilightError
from multilight.scenes.frozen import Frozen
from multilight.scenes.random_streams import Streams
from multilight.scenes.still_life.placement import PlacementError

T = TypeVar("T")


class SceneSamplingError(MultilightError):
    """No attempt at a scene succeeded: names the seed, the index and the last reason."""


class SceneSettings(Frozen):
    """What all scenes of a dataset have in common, of whatever kind."""

    width: PositiveInt = 256
    """Image width [pixels]."""
    height: PositiveInt = 256
    """Image height [pixels]."""
    views: PositiveInt = 16
    """Number of cameras."""
    insertable: Annotated[int, Field(ge=1, le=8)] = 3
    """Objects whose removal is rendered, 1 to 8."""
    cameras: CameraSettings = CameraSettings()
    """Trajectories and lenses."""


def first_success(streams: Streams, attempts: int, draw: Callable[[int], T]) -> T:
    """Return what `draw` makes of the first attempt, by number, in which everything finds its place and is seen.

    What must not depend on whether an attempt fails is drawn before, so that rejection shifts no probability. Raises
    `SceneSamplingError` where no attempt succeeds.
    """
    reason: Exception | None = None
    for attempt in range(attempts):
        try:
            return draw(attempt)
        except (PlacementError, TrajectoryError) as error:
            reason = error
    raise SceneSamplingError(
        f"seed {streams.seed}, scene {streams.scene}: no attempt of {attempts} succeeded; the last: {reason}"
    )
