"""`multilight study`: which of two methods do people prefer?"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import tyro

from multilight.datagen.errors import UserError
from multilight.datagen.text import plain


@dataclass
class Study:
    """Compare two methods blindly by people: write the page that asks, or count the answers that it saved.

    Folders hold pictures of equal names, one for each pair. The page stands alone; its key, which says whose picture
    is whose, lies beside it and is not to be given away.
    """

    first: tyro.conf.Positional[Path | None] = None
    """Folder of the first method's pictures."""
    second: tyro.conf.Positional[Path | None] = None
    """Folder of the second method's."""
    out: Path | None = None
    """Page to write, .html; its key goes beside it."""
    context: Path | None = None
    """Folder of pictures to show above each pair, the composite, say."""
    question: str = "Which picture looks more real?"
    """What is asked."""
    most: int = 40
    """Pairs at most, drawn by lot."""
    seed: int = 0
    """Seed of the lot."""
    key: Path | None = None
    """Instead: the key of a page, to count answers."""
    answers: tuple[Path, ...] = ()
    """Files that the page has saved, one a person."""
    json: bool = False
    """Print the counts as JSON."""

    def run(self) -> int:
        """Write the page or count, and return the exit code."""
        return self._count() if self.key is not None or self.answers else self._write()

    def _write(self) -> int:
        from multilight.model.study.page import StudyRequest, key_file, write_study

        if self.first is None or self.second is None or self.out is None:
            raise UserError(
                "name two folders and a page, multilight study A B --out study.html; or a key and answers, "
                "multilight study --key study.key.json --answers FILE ..."
            )
        if not 1 <= self.most <= 1000:
            raise UserError(f"--most {self.most} must be 1 to 1000")
        request = StudyRequest(self.first, self.second, self.context, self.question, self.most, self.seed)
        key = write_study(request, self.out)
        print(plain(f"{self.out}: {len(key.pairs)} pairs of {' and '.join(key.methods)}; key {key_file(self.out)}"))
        return 0

    def _count(self) -> int:
        from multilight.model.study.answers import judge, read_answers, read_key

        if self.key is None or not self.answers:
            raise UserError("to count, name both: --key study.key.json --answers FILE ...")
        key = read_key(self.key)
        verdict = judge(key, read_answers(self.answers, key))
        if self.json:
            print(json.dumps(asdict(verdict) | {"methods": key.methods}, indent=1))
            return 0
        low, high = verdict.interval
        print(f"{verdict.people} people: {verdict.first} for {plain(key.methods[0])}, {verdict.second} for "
              f"{plain(key.methods[1])}, {verdict.neither} for neither")  # fmt: skip
        print(f"share of {plain(key.methods[0])}: {verdict.share:.1%}, 95 % interval {low:.1%} to {high:.1%}")
        print(f"on the left: {verdict.left:.1%} of the judgements")
        return 0
