"""What the answers to a blind comparison say.

People differ, and so do pictures, so the interval comes from drawing both anew (Owen 2007, the pigeonhole bootstrap).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TypeVar

import numpy as np
from pydantic import Field, ValidationError

from multilight.datagen.errors import UserError
from multilight.model.study.page import Key
from multilight.scenes.files.limits import read_json
from multilight.scenes.frozen import Frozen

DRAWS = 10_000
"""How often people and pictures are drawn anew."""
LEVEL = 0.95
Parsed = TypeVar("Parsed", bound=Frozen)


class Answer(Frozen):
    """One judgement: of which pair, which of its two pictures (0 or 1, None for neither), which was on the left."""

    pair: Annotated[int, Field(ge=0)]
    chosen: Annotated[int, Field(ge=0, le=1)] | None
    left: Annotated[int, Field(ge=0, le=1)]
    seconds: Annotated[float, Field(ge=0)]


class Answers(Frozen):
    """What one person answered."""

    study: str
    person: str
    answers: tuple[Answer, ...]


@dataclass(frozen=True)
class Verdict:
    """Judgements for the first method, the second, and neither; `share` of the first, a half for neither, with its
    interval of 95 %; `left` is the share of judgements that fell on the left picture, a half unless people guess.
    """

    people: int
    first: int
    second: int
    neither: int
    share: float
    interval: tuple[float, float]
    left: float


def read_key(path: Path) -> Key:
    """Read a study's key; raises `UserError` where it is none."""
    return _parsed(path, Key)


def read_answers(paths: Sequence[Path], key: Key) -> list[Answers]:
    """Read the answers of a study; raises `UserError` where a file is none, of another study, or somebody's twice."""
    found: dict[str, tuple[Answers, Path]] = {}
    for path in paths:
        answers = _parsed(path, Answers)
        if answers.study != key.study:
            raise UserError(f"{path} answers another study ({answers.study}, not {key.study})")
        if answers.person in found:
            raise UserError(f"{path} and {found[answers.person][1]} are of one person; leave one of them away")
        pairs = [answer.pair for answer in answers.answers]
        if len(set(pairs)) < len(pairs) or max(pairs, default=0) >= len(key.pairs):
            raise UserError(f"{path}: each of the {len(key.pairs)} pairs must be answered once at most")
        found[answers.person] = answers, path
    return [answers for answers, _ in found.values()]


def judge(key: Key, people: Sequence[Answers]) -> Verdict:
    """Count judgements and say how sure they make; raises `UserError` where there are none."""
    points = np.full((len(people), len(key.pairs)), np.nan)
    left = []
    for row, answers in enumerate(people):
        for answer in answers.answers:
            if answer.chosen is None:
                points[row, answer.pair] = 0.5
            else:
                points[row, answer.pair] = float((answer.chosen == 0) != key.swapped[answer.pair])
                left.append(answer.chosen == answer.left)
    given = ~np.isnan(points)
    if not given.any():
        raise UserError("nobody answered anything")
    value, rng = np.where(given, points, 0.0), np.random.default_rng(0)
    rows = rng.multinomial(len(people), np.full(len(people), 1 / len(people)), size=DRAWS)
    columns = rng.multinomial(len(key.pairs), np.full(len(key.pairs), 1 / len(key.pairs)), size=DRAWS)
    weight = np.einsum("dp,pq,dq->d", rows, given, columns)
    sums = np.einsum("dp,pq,dq->d", rows, value, columns)
    shares = sums[weight > 0] / weight[weight > 0]
    low, high = np.quantile(shares, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return Verdict(
        people=len(people),
        first=int((points == 1).sum()),
        second=int((points == 0).sum()),
        neither=int((points == 0.5).sum()),
        share=float(value.sum() / given.sum()),
        interval=(float(low), float(high)),
        left=float(np.mean(left)) if left else 0.5,
    )


def _parsed(path: Path, kind: type[Parsed]) -> Parsed:
    try:
        return kind.model_validate(read_json(path))
    except ValidationError as error:
        place = ".".join(map(str, error.errors()[0]["loc"]))
        raise UserError(
            f"{path} is no {kind.__name__.lower()} of a study: {place}: {error.errors()[0]['msg']}"
        ) from None
