"""Where the time of a scene goes."""

import contextlib
import time
from collections import defaultdict
from collections.abc import Iterator


class Stopwatch:
    """Counts the wall-clock seconds of named stages; what passes outside of any is the rest."""

    def __init__(self) -> None:
        self._start = time.perf_counter()
        self._stages: dict[str, float] = defaultdict(float)

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count what is done inside to a stage; stages do not nest."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self._stages[name] += time.perf_counter() - start

    def seconds(self) -> dict[str, float]:
        """Return the seconds of each stage and of the `rest`."""
        total = time.perf_counter() - self._start
        return dict(self._stages) | {"rest": total - sum(self._stages.values())}
