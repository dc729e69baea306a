"""Where the time of a scene goes."""

import contextlib
import time
from collections import defaultdict
from collections.abc import Callable, Iterator


class Stopwatch:
    """Counts the seconds of named stages, by the wall's clock or another; what passes outside of any is the rest."""

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self._clock = clock
        self._start = clock()
        self._stages: dict[str, float] = defaultdict(float)

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count what is done inside to a stage; stages do not nest."""
        start = self._clock()
        try:
            yield
        finally:
            self._stages[name] += self._clock() - start

    def seconds(self) -> dict[str, float]:
        """Return the seconds of each stage and of the `rest`."""
        total = self._clock() - self._start
        return dict(self._stages) | {"rest": total - sum(self._stages.values())}
