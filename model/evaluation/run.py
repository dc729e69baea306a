"""Run every method on every case and collect how good, how fast, how large and how consistent each is."""

import resource
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import torch

from multilight.datagen.report import Report, silent
from multilight.model.evaluation.baselines import BASELINES, Baseline
from multilight.model.evaluation.cases import VARIANT, Case, Group, LazyGroup
from multilight.model.evaluation.consistency import disagreement, shared_pairs
from multilight.model.evaluation.lpips import Lpips
from multilight.model.evaluation.method3d import GroupMethod
from multilight.model.evaluation.metrics import Regions, Scores, mean_scores, measure
from multilight.model.inference.harmonize import Harmonizer
from multilight.scenes.arrays import Float32

Method = Callable[[Case], Float32]
"""Harmonizes a case: its picture, (H, W, 3) float32 in [0, 1]."""

WORST = 10
EXAMPLES = 12
"""Cases that are shown, besides the worst; at most `SHOWN_OF_SUBSET` of each subset."""
SHOWN_OF_SUBSET = 2
JUDGED_BY = "object and effect"
GAMMA = 2.2
"""Transfer curve of Objects With Lighting, for whose cases the exposure is fitted."""


@dataclass(frozen=True)
class Frame:
    """One case, judged: scores and seconds by method."""

    name: str
    subsets: tuple[str, ...]
    scores: Mapping[str, Scores]
    seconds: Mapping[str, float]


@dataclass(frozen=True)
class Shown:
    """One case with all its pictures, kept for the page."""

    case: Case = field(repr=False)
    outputs: Mapping[str, Float32] = field(repr=False)
    subsets: tuple[str, ...]
    scores: Mapping[str, Scores]


@dataclass
class Evaluation:
    """What was found. `consistency` holds, by group, each method's disagreement between views, and "target"'s.

    `megabytes` is the most memory that each method took beyond what was there before, of any frame. `worst` are those
    where the last method is furthest from the truth, in the object-and-effect region.
    """

    methods: tuple[str, ...]
    frames: list[Frame] = field(default_factory=list)
    consistency: list[dict[str, float]] = field(default_factory=list)
    megabytes: dict[str, float] = field(default_factory=dict)
    examples: list[Shown] = field(default_factory=list)
    worst: list[Shown] = field(default_factory=list)

    @property
    def subsets(self) -> tuple[str, ...]:
        """The subsets that hold any frame: splits first, then kinds and what is hard."""
        names = {subset for frame in self.frames for subset in frame.subsets}
        return tuple(sorted(names, key=lambda name: (not name.startswith("test"), not name.startswith("kind"), name)))

    def frames_of(self, subset: str | None) -> list[Frame]:
        """Return the frames of a subset, or all that are no other's made over."""
        if subset is None:
            return [frame for frame in self.frames if not _made_over(frame)]
        return [frame for frame in self.frames if subset in frame.subsets]

    def means(self, method: str, subset: str | None = None) -> Scores:
        """Average a method's scores over the frames of a subset, or all."""
        return mean_scores([frame.scores[method] for frame in self.frames_of(subset) if frame.scores])

    def seconds(self, method: str) -> float:
        """Return the mean time [s] that a frame takes; what a method does once a scene is shared by its frames."""
        return float(np.mean([frame.seconds[method] for frame in self.frames]))

    def inconsistency(self, method: str) -> tuple[float, float]:
        """Return the mean disagreement between views, in [0, 1], and its ratio to that of the true pictures."""
        if not self.consistency:
            return float("nan"), float("nan")
        own, true = (float(np.mean([values[name] for values in self.consistency])) for name in (method, "target"))
        return own, own / max(true, 1e-9)


def _made_over(judged: Frame | Group) -> bool:
    return any(subset.startswith(VARIANT) for subset in judged.subsets)


def methods_of(models: Mapping[str, Harmonizer]) -> dict[str, Method]:
    """Return every method by its name: the raw composite, classical ones, then the models."""

    def classical(baseline: Baseline) -> Method:
        return lambda case: baseline(case.composite, case.background, case.mask)

    methods = {name: classical(baseline) for name, baseline in BASELINES.items()}
    return methods | {name: on_case(harmonizer) for name, harmonizer in models.items()}


def on_case(harmonizer: Harmonizer) -> Method:
    """Return a harmonizer of pictures as a method of the evaluation."""
    return lambda case: harmonizer(case.composite, case.background, case.depth, case.mask)


def evaluate(
    groups: Sequence[LazyGroup], methods: Mapping[str, Method], *, lpips: Lpips | None = None, report: Report = silent
) -> Evaluation:
    """Harmonize every case with every method and compare with the truth; `report` is told (done, total) groups."""
    found = Evaluation(tuple(methods), megabytes=dict.fromkeys(methods, 0.0))
    for number, load in enumerate(groups):
        report(number, len(groups))
        group = load()
        for method in methods.values():
            if isinstance(method, GroupMethod):
                method.begin(group)
        pictures = [_judge(case, group, methods, found, lpips) for case in group.cases]
        if len(group.cameras) > 1 and not _made_over(group) and all(case.effect is not None for case in group.cases):
            _compare_views(group, pictures, found)
    report(len(groups), len(groups))
    return found


def _judge(
    case: Case, group: Group, methods: Mapping[str, Method], found: Evaluation, lpips: Lpips | None
) -> dict[str, Float32]:
    """Run all methods on one case, add what they scored, and return their pictures."""
    outputs: dict[str, Float32] = {}
    seconds: dict[str, float] = {}
    for name, method in methods.items():
        with peak_memory() as memory:
            start = time.perf_counter()
            outputs[name] = method(case)
            seconds[name] = time.perf_counter() - start
        found.megabytes[name] = max(found.megabytes[name], memory.megabytes)
    if case.fit_exposure:
        outputs = {name: fitted_exposure(output, case) for name, output in outputs.items()}
    scores = {name: _scores(output, case, lpips) for name, output in outputs.items()} if case.target is not None else {}
    found.frames.append(Frame(case.name, group.subsets, scores, seconds))
    if not _made_over(group):
        _keep(Shown(case, outputs, group.subsets, scores), found, first=case is group.cases[0])
    return outputs


def _scores(output: Float32, case: Case, lpips: Lpips | None) -> Scores:
    assert case.target is not None
    regions = Regions.of(case.mask, np.zeros_like(case.target) if case.effect is None else case.effect)
    return measure(output, case.target, regions if case.valid is None else regions.within(case.valid), lpips)


def _keep(shown: Shown, found: Evaluation, *, first: bool) -> None:
    """Keep a case for the page: the first of a group whose subsets are not shown enough yet, and the worst of all."""
    counts = [sum(subset in other.subsets for other in found.examples) for subset in shown.subsets]
    if first and len(found.examples) < EXAMPLES and (not counts or min(counts) < SHOWN_OF_SUBSET):
        found.examples.append(shown)
    if shown.scores:
        last, every = found.methods[-1], [*found.worst, shown]
        judged = [(each.scores[last].get(JUDGED_BY) or each.scores[last]["image"])["PSNR"] for each in every]
        found.worst = [every[int(i)] for i in np.argsort(judged, kind="stable")[:WORST]]


def _compare_views(group: Group, pictures: Sequence[Mapping[str, Float32]], found: Evaluation) -> None:
    regions = []
    for case in group.cases:
        assert case.effect is not None
        regions.append(Regions.of(case.mask, case.effect).masks[JUDGED_BY])
    pairs = shared_pairs(group.cameras, group.z_depth, regions)
    if pairs:
        truth = [case.target for case in group.cases if case.target is not None]
        values = {name: disagreement([picture[name] for picture in pictures], pairs) for name in found.methods}
        found.consistency.append(values | {"target": disagreement(truth, pairs)})


def fitted_exposure(picture: Float32, case: Case) -> Float32:
    """Expose a picture anew so that it is closest to the truth, as the protocol of Objects With Lighting asks.

    y = (x 2^EV)^(1/2.2) with x linear; 2^EV is the least-squares factor over the object's valid pixels whose truth is
    not overexposed (B. Ummenhofer et al., Objects With Lighting, 2024).
    """
    assert case.target is not None
    known = (case.mask > 0.5) & (case.target.max(axis=-1) < 1.0)
    if case.valid is not None:
        known &= case.valid
    linear, truth = np.power(picture, GAMMA), np.power(case.target, GAMMA)
    weight = float(np.square(linear[known], dtype=np.float64).sum())
    if weight <= 0.0:
        return picture
    factor = float((linear[known].astype(np.float64) * truth[known]).sum()) / weight
    return np.clip(linear * factor, 0.0, 1.0).astype(np.float32) ** np.float32(1.0 / GAMMA)


@dataclass
class Memory:
    """The most memory that was taken, in MB beyond the beginning."""

    megabytes: float = 0.0


@contextmanager
def peak_memory() -> Iterator[Memory]:
    """Measure the peak of memory: the GPU's, else resident pages, looked at every two milliseconds."""
    memory = Memory()
    if torch.cuda.is_available():
        torch.cuda.reset_peak_memory_stats()
        before = torch.cuda.memory_allocated()
        yield memory
        memory.megabytes = (torch.cuda.max_memory_allocated() - before) / 1e6
        return
    start, done = _resident(), threading.Event()

    def look() -> None:
        while not done.wait(0.002):
            memory.megabytes = max(memory.megabytes, (_resident() - start) / 1e6)

    thread = threading.Thread(target=look, daemon=True)
    thread.start()
    try:
        yield memory
    finally:
        memory.megabytes = max(memory.megabytes, (_resident() - start) / 1e6)
        done.set()
        thread.join()


def _resident() -> int:
    """Return the bytes of the process's resident pages; on systems without /proc, their peak so far."""
    try:
        with open("/proc/self/statm") as statm:
            return int(statm.read().split()[1]) * resource.getpagesize()
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
