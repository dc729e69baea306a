"""A blind comparison: the page in a real browser, and what its answers say, against closed forms."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from multilight.datagen.cli import main
from multilight.model.cli import COMMANDS
from multilight.model.study.answers import Answer, Answers, judge
from multilight.model.study.page import Key
from tests.browsing import AXE, barriers

PAIRS = 12
RED, GREEN = (200, 30, 30), (30, 200, 30)


def study(*words: object) -> int:
    return main(["study", *map(str, words)], COMMANDS)


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    """Two methods: one makes all red, the other all green."""
    for name, colour in {"ours": RED, "theirs": GREEN}.items():
        (tmp_path / name).mkdir()
        for number in range(PAIRS):
            Image.new("RGB", (32, 24), (*colour[:2], colour[2] + number)).save(tmp_path / name / f"{number:02d}.png")
    return tmp_path / "ours", tmp_path / "theirs"


COLOUR = """image => { const c = document.createElement("canvas").getContext("2d"); c.drawImage(image, 0, 0);
return Array.from(c.getImageData(1, 1, 1, 1).data.slice(0, 3)); }"""


def test_who_always_prefers_red_is_counted_so(
    folders: tuple[Path, Path], tmp_path: Path, browser: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    page_file = tmp_path / "study.html"
    assert study(*folders, "--out", page_file, "--seed", "3") == 0
    html = page_file.read_text()
    assert not re.search(r"\bours\b", html)
    assert "theirs" not in html
    page = browser.new_page()
    complaints: list[str] = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("console", lambda line: complaints.append(line.text) if line.type == "error" else None)
    page.goto(page_file.as_uri())
    assert not AXE.exists() or barriers(page) == []
    sides = set()
    for number in range(PAIRS):
        if number == 5:  # a slip, taken back; then the page is loaded anew
            page.keyboard.press("Space")
            page.click("#back")
            page.reload()
        images = page.locator(".pair img")
        images.first.evaluate("image => image.decode()")
        on_left = images.first.evaluate(COLOUR)[0] > 100
        sides.add(on_left)
        if number % 2:
            page.keyboard.press("ArrowLeft" if on_left else "ArrowRight")
        else:
            page.locator(".pair button").nth(0 if on_left else 1).click()
    assert sides == {True, False}
    with page.expect_download() as download:
        page.click("#save")
    answers = tmp_path / "answers.json"
    download.value.save_as(answers)
    assert not complaints
    capsys.readouterr()
    assert study("--key", tmp_path / "study.key.json", "--answers", answers, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["first"], told["second"], told["neither"], told["people"]) == (PAIRS, 0, 0, 1)
    assert told["share"] == 1.0
    assert told["interval"] == [1.0, 1.0]
    assert told["methods"] == ["ours", "theirs"]


def given(key: Key, wins: np.ndarray) -> list[Answers]:
    """Let people (rows) judge pairs (columns): 1 for the first method, 0 for the second."""
    return [
        Answers(study=key.study, person=str(row), answers=tuple(
            Answer(pair=pair, chosen=int((win == 1) == key.swapped[pair]), left=0, seconds=1.0)
            for pair, win in enumerate(line)
        ))
        for row, line in enumerate(wins)
    ]  # fmt: skip


def a_key(pairs: int) -> Key:
    swapped = tuple(bool(value) for value in np.random.default_rng(1).random(pairs) < 0.5)
    return Key(study="s", methods=("a", "b"), pairs=tuple(map(str, range(pairs))), swapped=swapped)


def test_the_interval_of_one_person_is_that_of_a_share() -> None:
    key, wins = a_key(400), (np.arange(400) % 10 < 7).astype(int)[None]
    verdict = judge(key, given(key, wins))
    assert verdict.share == pytest.approx(0.7)
    assert (verdict.first, verdict.second) == (280, 120)
    half = 1.96 * np.sqrt(0.7 * 0.3 / 400)  # normal approximation of the binomial
    np.testing.assert_allclose(verdict.interval, (0.7 - half, 0.7 + half), atol=0.1 * half)


def test_people_who_agree_with_themselves_count_little() -> None:
    """Four people who each judge 100 pairs alike are four judgements, not four hundred."""
    key, wins = a_key(100), np.repeat([[1], [1], [1], [0]], 100, axis=1)
    verdict = judge(key, given(key, wins))
    assert verdict.share == pytest.approx(0.75)
    low, high = verdict.interval
    assert low <= 0.25
    assert high == 1.0


def test_neither_is_a_half_and_sides_are_told() -> None:
    key = a_key(4)
    answers = [Answer(pair=pair, chosen=None, left=0, seconds=1.0) for pair in range(2)]
    answers.append(Answer(pair=2, chosen=1, left=1, seconds=1.0))
    verdict = judge(key, [Answers(study="s", person="p", answers=tuple(answers))])
    assert verdict.neither == 2
    assert verdict.left == 1.0
    assert verdict.share == pytest.approx((0.5 + 0.5 + float(key.swapped[2])) / 3)


@pytest.mark.parametrize(
    ("break_it", "words", "expected"),
    [
        (lambda folder: None, "ours theirs", "name two folders and a page"),
        (lambda folder: None, "ours theirs --out s.txt", "the suffix must be .html"),
        (lambda folder: None, "ours ours --out s.html", "is named twice"),
        (lambda folder: None, "ours nowhere --out s.html", "nowhere is no folder"),
        (lambda folder: None, "ours theirs --out s.html --most 0", "--most 0 must be 1 to 1000"),
        (lambda folder: None, "--key k.json", "to count, name both"),
        (lambda folder: (folder / "ours/03.png").write_bytes(b"\x89PNG"), "ours theirs --out s.html", "03.png"),
        (lambda folder: Image.new("RGB", (8, 8)).save(folder / "ours/03.png"), "ours theirs --out s.html",
         "03.png: sizes are 8 x 8, 32 x 24"),
        (lambda folder: shutil.move(folder / "ours", folder / "x") and (folder / "ours").mkdir(),
         "ours theirs --out s.html", "no picture has the same name"),
        (lambda folder: (folder / "k.json").write_text("{}"), "--key k.json --answers k.json", "is no key of a study"),
    ],
)  # fmt: skip
def test_mistakes_are_named(
    break_it: Any, words: str, expected: str, folders: tuple[Path, Path], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    break_it(tmp_path)
    assert study(*words.split()) == 1
    assert expected in capsys.readouterr().err


def test_answers_of_others_are_refused(
    folders: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert study(*folders, "--out", tmp_path / "s.html") == 0
    name = json.loads((tmp_path / "s.key.json").read_text())["study"]
    one = {"pair": 0, "chosen": 0, "left": 0, "seconds": 1}
    for content, expected in (
        ({"study": "other", "person": "p", "answers": []}, "answers another study"),
        ({"study": name, "person": "p", "answers": [one, one]}, "must be answered once"),
        ({"study": name, "person": "p", "answers": [one | {"pair": PAIRS}]}, "must be answered once"),
        ({"study": name, "person": "p", "answers": [one | {"chosen": 2}]}, "answers.0.chosen"),
        ({"study": name, "person": "p", "answers": []}, "nobody answered"),
    ):
        (tmp_path / "a.json").write_text(json.dumps(content))
        assert study("--key", tmp_path / "s.key.json", "--answers", tmp_path / "a.json") == 1
        assert expected in capsys.readouterr().err
    (tmp_path / "a.json").write_text(json.dumps({"study": name, "person": "p", "answers": [one]}))
    assert study("--key", tmp_path / "s.key.json", "--answers", tmp_path / "a.json", tmp_path / "a.json") == 1
    assert "are of one person" in capsys.readouterr().err
