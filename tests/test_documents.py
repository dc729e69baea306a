"""What the documents say is so: links lead somewhere, commands and files exist, code runs, versions agree."""

import ast
import dataclasses
import re
import shlex
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest
import yaml

import multilight
from multilight.datagen.cli import COMMANDS as MAKING
from multilight.datagen.commands.arguments import parsed
from multilight.datagen.config.dataset import load_config
from multilight.lights.spec import LightingCondition
from multilight.model.cli import COMMANDS as LEARNING
from tests import ROOT

COMMANDS = MAKING | LEARNING
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").glob("*.md"))]
FENCED = re.compile(r"^ *```(\w*)\n(.*?)^ *```$", re.DOTALL | re.MULTILINE)
FOLDERS = "scenes|lights|datagen|model|multilight|tests|benchmarks|examples|docs"
LONGEST_LINE = 160
pages = pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)


def blocks(page: Path, language: str) -> list[str]:
    return [code for found, code in FENCED.findall(page.read_text()) if found == language]


def spans(page: Path) -> list[str]:
    """Return what stands between single backticks, each on one line."""
    text = re.sub(r"\s+", " ", FENCED.sub("", page.read_text()))
    return [span.replace(r"\|", "|") for span in re.findall(r"`([^`]+)`", text)]


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", FENCED.sub("", page.read_text()), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) < 150


@pages
def test_lines_are_short(page: Path) -> None:
    long = [n for n, line in enumerate(page.read_text().splitlines(), start=1) if len(line) > LONGEST_LINE]
    assert not long


@pages
def test_links_and_pictures_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", FENCED.sub("", page.read_text())):
        if re.match("https?:", target):
            continue
        file, _, anchor = target.partition("#")
        place = (page.parent / file).resolve() if file else page
        assert place.exists(), f"{page.name}: {target}"
        assert not anchor or anchor in anchors(place), f"{page.name}: {target}"


PICTURE = re.compile(r"!\[[^\]]*\]\(([^)]+)\)")


def sections(page: Path) -> list[str]:
    """Return what stands under each heading of a page."""
    text = FENCED.sub(lambda block: block[0].replace("\n#", "\n "), page.read_text())  # comments are no headings
    return re.split(r"^#+ ", text, flags=re.MULTILINE)


def says_how(section: str, picture: Path) -> bool:
    """Whether a section leads to the example that makes a picture, or names it in its commands."""
    code = " ".join([*(block for _, block in FENCED.findall(section)), *re.findall(r"`([^`]+)`", section)])
    return f"examples/{picture.stem}.py)" in section or bool(re.search(rf"\b{picture.stem}\.(png|jpg)", code))


def pictures_in(page: Path, section: str) -> list[Path]:
    return [(page.parent / target).resolve() for target in PICTURE.findall(section)]


@pages
def test_pictures_have_their_command_beside_them(page: Path) -> None:
    """In the section that shows it, or on a page that this leads to and that shows it as well."""
    for section in sections(page):
        linked = [(page.parent / link).resolve() for link in re.findall(r"\]\(([\w/]+\.md)\)", section)]
        for picture in pictures_in(page, section):
            others = [part for other in linked for part in sections(other) if picture in pictures_in(other, part)]
            assert any(says_how(part, picture) for part in (section, *others)), (page.name, picture.name)


def test_every_picture_is_shown() -> None:
    shown = {picture for page in PAGES for picture in pictures_in(page, page.read_text())}
    assert shown == set((ROOT / "docs").rglob("*.jpg")) | set((ROOT / "docs").rglob("*.png"))


@pages
def test_named_files_exist(page: Path) -> None:
    for span in spans(page):
        if re.fullmatch(rf"(?:{FOLDERS})/[\w./-]*", span):
            assert (ROOT / span).exists(), f"{page.name}: {span}"
    for module, file in re.findall(r"python (?:-m ([\w.]+)|(\S+\.py))", page.read_text()):
        place = ROOT / (file or module.replace(".", "/"))
        assert place.exists() or place.with_suffix(".py").exists(), f"{page.name}: {module or file}"


@pages
def test_make_targets_exist(page: Path) -> None:
    known = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    named = re.findall(r"(?:^|`)make ([a-z-]+)", page.read_text(), re.MULTILINE)
    assert set(named) <= known


def options(kind: Any) -> Iterator[str]:
    """Name every option of a command, those of its sub-commands among them."""
    for field, hint in get_type_hints(kind).items():
        yield "--" + field.lstrip("_").replace("_", "-")
        for part in (hint, *get_args(hint)):
            if dataclasses.is_dataclass(part):
                yield from options(part)


def check_command(words: list[str]) -> None:
    """Check that a command and its options exist, whatever stands in for their values."""
    if "|" in words:
        assert set(words[1:]) - {"|"} <= set(COMMANDS)
        return
    command = words[1]
    if command.isupper():
        return
    assert command in COMMANDS, words
    named = {word for word in words if word.startswith("--")}
    assert named <= {*options(COMMANDS[command]), "--help", "--traceback"}, words


@pages
def test_named_commands_exist(page: Path) -> None:
    for span in spans(page):
        if span.startswith("multilight "):
            check_command(shlex.split(span))


def printed(page: Path) -> Iterator[list[str]]:
    """Split the command lines in a page's blocks into words, without what they set or write to."""
    for line in "\n".join(blocks(page, "sh")).replace("\\\n", "").splitlines():
        words = shlex.split(line, comments=True)
        if words:
            yield words[: words.index(">")] if ">" in words else words


@pages
def test_printed_commands_can_be_given(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Also those that take too long to be run: values are allowed, and what they name of the repository is there."""
    in_text = [shlex.split(span) for span in spans(page) if re.match(r"(\w+=\S+ )*(python|pytest) ", span)]
    shown = "\n".join(blocks(page, "console")).replace("\\\n", "")
    typed = [shlex.split(line) for line in re.findall(r"^\$ (multilight [^&\n]*)", shown, re.MULTILINE)]
    for words in (*printed(page), *typed, *in_text):
        while "=" in words[0]:
            words = words[1:]
        for word in words[1:]:
            assert not re.match(rf"(?:{FOLDERS})/", word) or (ROOT / word).exists(), (page.name, words)
        match words:
            case ["multilight", *given]:
                try:
                    parsed(given, COMMANDS)
                except SystemExit:
                    pytest.fail(f"{page.name}: {words}\n{capsys.readouterr()}")
            case ["python", "-m", module, *given]:
                check_script(ROOT / (module.replace(".", "/") + ".py"), given)
            case ["python", file, *given]:
                check_script(ROOT / file, given)
            case [program, *_]:
                assert program in ("make", "pytest", ".venv/bin/pytest"), (page.name, words)


def check_script(file: Path, words: list[str]) -> None:
    """Check that a script's options are there, which are the fields of a class, or parameters."""
    named = {word[2:].replace("-", "_") for word in words if word.startswith("--")}
    assert not named or named <= set(re.findall(r"(?:^    |[(,] ?)(\w+): ", file.read_text(), re.MULTILINE)), file


def test_every_command_is_in_the_table() -> None:
    text = (ROOT / "docs" / "making.md").read_text()
    assert {
        re.sub("multilight ", "", name) for name in re.findall(r"^\| `(multilight \w+)`", text, re.MULTILINE)
    } == set(COMMANDS)


@pages
def test_code_is_python_and_its_names_exist(page: Path) -> None:
    for code in blocks(page, "python"):
        for node in ast.walk(ast.parse(code)):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "multilight":
                assert node.attr in multilight.__all__
            if isinstance(node, ast.ImportFrom) and node.module == "multilight":
                assert {alias.name for alias in node.names} <= set(multilight.__all__)


def test_example_of_reading_runs_as_printed(spheres_dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With OpenEXR alone, in few lines, it gives target and composite."""
    text = (ROOT / "docs" / "dataset.md").read_text()
    code = re.search(r"<!-- example -->\s*```python\n(.*?)```", text, re.DOTALL)
    assert code is not None
    assert "multilight" not in code[1]
    assert len([line for line in code[1].splitlines() if line.strip()]) <= 14
    monkeypatch.chdir(spheres_dataset)
    names: dict[str, object] = {}
    exec(compile(code[1], "dataset.md", "exec"), names)
    target, composite, background = (np.asarray(names[k]) for k in ("target", "composite", "background"))
    scene = multilight.open(".")[0]
    insert, base = scene.conditions[:2]
    stored = scene.tuple(0, condition=base, insert_condition=insert)
    assert np.allclose(target, stored.target, rtol=1e-3, atol=1e-4)
    assert np.allclose(composite, stored.composite, rtol=1e-3, atol=1e-4)
    assert np.allclose(background, stored.background, rtol=1e-3, atol=1e-4)


def test_printed_configuration_and_condition_are_valid(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    kinds = []
    for toml in (toml for page in PAGES for toml in blocks(page, "toml")):
        file.write_text(toml)
        kinds.append(load_config(file, {}).kind)
    assert kinds == ["room", "tabletop", "tabletop"]
    (text,) = blocks(ROOT / "docs" / "dataset.md", "json")
    assert LightingCondition.from_json(text).exposure_ev == 0.5


def test_hooks_are_those_of_make_check() -> None:
    recipe = re.search(r"^check:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert recipe is not None
    wanted = [line.strip().replace("$(BIN)", ".venv/bin") for line in recipe[1].splitlines()]
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"][0]["hooks"]
    assert [hook["entry"] for hook in hooks] == wanted


def test_versions_agree() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    released = re.findall(r"^## (\S+) \((.*)\)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert citation["version"] == released[0][0] == version
    assert str(citation["date-released"]) == released[0][1]


def test_issue_forms_are_sound() -> None:
    for form in (ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"):
        content = yaml.safe_load(form.read_text())
        if form.name != "config.yml":
            assert {"name", "description", "body"} <= set(content)
