"""Text that comes from data goes nowhere but where it belongs: no line, markup or terminal sequence of its own."""

import io
import json
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from markdown_it import MarkdownIt
from rich.console import Console

from multilight.datagen.cli import main
from multilight.datagen.export.credits import credit_lines
from multilight.datagen.export.dtc.readme import write_readme
from multilight.datagen.export.webdataset.card import Shards, write_card
from multilight.datagen.report import silent
from multilight.datagen.stats.collect import Leak, measure_dataset
from multilight.datagen.stats.duplicates import Pair
from multilight.datagen.stats.page import print_summary, write_page
from multilight.datagen.stats.plots import bar_plot
from multilight.datagen.stats.quantities import Coverage, Quantity
from multilight.datagen.storage.open_dataset import open_dataset
from multilight.datagen.storage.records import AssetCredit
from multilight.datagen.storage.store import file_sha256
from multilight.datagen.text import markdown, plain, terminal
from multilight.model.evaluation.page import write_evaluation
from multilight.model.evaluation.run import Evaluation, Frame
from multilight.scenes.assets.library import AssetLibrary
from tests.datagen.chain import rewrite_json

HOSTILE = (
    "a\n\n# Owned\n\n<script>alert(1)</script> | x | [c](javascript:d) ![e](http://f) `g` **h** "
    "\x1b[31mred\x1b]0;title\x07 \r\x9b2J \u202eabc\u2028 $\\frac{1}{$ [bold]i[/bold] \\| {0} --- '\"&amp;\ud800"
)
CREDIT = AssetCredit.model_construct(id=HOSTILE, pack=HOSTILE, name=HOSTILE, creator=HOSTILE, licence=HOSTILE)


def harmless(text: str, *, lines: int = 1) -> None:
    """Hold a text to so many lines and to characters that show."""
    assert len(text.splitlines()) == lines
    assert text.replace("\n", "").isprintable(), repr(text)
    text.encode()


def tokens(text: str) -> list[Any]:
    """Read Markdown as hubs do, HTML and tables allowed: all tokens, one after the other."""
    found = MarkdownIt("commonmark").enable("table").parse(text)
    return [token for one in found for token in (one, *(one.children or ()))]


def test_plain_text_is_one_line_that_shows() -> None:
    harmless(plain(HOSTILE))
    assert plain("Zoë, 日本 µ² – [x]") == "Zoë, 日本 µ² – [x]"


def test_rich_prints_it_as_it_is() -> None:
    console = Console(file=io.StringIO(), width=4000, force_terminal=True)
    console.print(terminal(HOSTILE), highlight=False)
    shown = console.file.getvalue()  # type: ignore[attr-defined]
    assert shown == plain(HOSTILE) + "\n"


def test_markdown_shows_it_in_its_cell() -> None:
    found = tokens(f"| a | b |\n|---|---|\n| {markdown(HOSTILE)} | z |")
    assert sum(token.type == "td_open" for token in found) == 2
    assert not {token.type for token in found} & {"html_block", "html_inline", "link_open", "image", "code_inline"}
    assert not [token for token in found if token.type.startswith(("strong", "em_", "heading"))]
    assert plain(HOSTILE) in [token.content for token in found if token.type == "text"]


@pytest.mark.parametrize("field", ["pack", "name", "creator", "licence"])
def test_credits_stay_one_row_an_asset(field: str) -> None:
    sound = AssetCredit(id="a", pack="p", name="vase", creator="Ann", licence="CC0-1.0")
    lines = credit_lines([sound, sound.model_copy(update={field: HOSTILE, "id": "b"})])
    assert len(lines) == (3 if field in ("pack", "name") else 4)
    assert all(len(line.splitlines()) == 1 for line in lines)
    found = tokens("\n".join(lines))
    assert sum(token.type == "td_open" for token in found) == 3 * (len(lines) - 2)
    assert not {token.type for token in found} & {"html_block", "html_inline", "link_open", "image"}


def test_cards_and_readmes_have_their_own_headings_only(spheres_dataset: Path, tmp_path: Path) -> None:
    source = open_dataset(spheres_dataset)
    write_card(tmp_path, Shards({"train": (("train-00000.tar", 3),)}), source.record, [CREDIT], title=HOSTILE)
    card = (tmp_path / "README.md").read_text()
    head, body = card.split("\n---\n", 1)
    assert "Owned" not in head
    assert "script" not in head
    records = [record.model_copy(update={"assets": (CREDIT,)}) for record in source.scenes()]
    write_readme(tmp_path, HOSTILE, records)
    for text, headings in ((body, 2), ((tmp_path / "README.md").read_text(), 2)):
        found = tokens(text)
        assert sum(token.type == "heading_open" for token in found) == headings
        assert not [token for token in found if token.type in ("html_block", "html_inline", "image")]
        assert not [token for token in found if token.type == "link_open" and "javascript" in str(token.attrs)]


def test_plots_show_words_as_they_are() -> None:
    quantity = Quantity("kind", "scenes", "kind", "", None)
    svg = bar_plot(quantity, Coverage((HOSTILE, "$x$"), (1, 2), 1.0, 1.0))
    assert "<script" not in svg


def test_the_statistics_page_shows_names_as_they_are(
    spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = measure_dataset(spheres_dataset, AssetLibrary(), silent)
    pair = Pair(0, 1, "content", 0.1)
    hostile = replace(found, title=HOSTILE, leaks=(Leak(HOSTILE, ("train", "test")),), duplicates=(pair,))
    write_page(hostile, tmp_path)
    shows_names(tmp_path / "index.html")
    print_summary(hostile)
    assert "\x1b" not in capsys.readouterr().out


def test_the_evaluation_shows_names_as_they_are(tmp_path: Path) -> None:
    score = {"image": {"PSNR": 20.0, "SSIM": 0.5, "FLIP": 0.1}}
    frame = Frame(HOSTILE, (HOSTILE,), {HOSTILE: score}, {HOSTILE: 0.1})
    found = Evaluation((HOSTILE,), [frame], megabytes={HOSTILE: 1.0})
    write_evaluation(found, {HOSTILE: HOSTILE}, tmp_path)
    shows_names(tmp_path / "index.html")
    read = tokens((tmp_path / "table.md").read_text())
    assert not [token for token in read if token.type in ("html_block", "html_inline", "image", "link_open")]
    assert {token.tag for token in read if token.type == "heading_open"} == {"h1", "h2"}
    assert sum(token.tag == "h1" and token.type == "heading_open" for token in read) == 1


class Reader(HTMLParser):
    """Lists a page's tags and their attributes, and its text."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.attributes: set[str] = set()
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.attributes |= {name for name, _ in attrs}

    def handle_data(self, data: str) -> None:
        self.text += data


def shows_names(path: Path) -> None:
    """Hold a page to the tags that it has of itself, and to characters that show."""
    reader = Reader()
    reader.feed(path.read_text())
    tags = {
        "html",
        "head",
        "meta",
        "title",
        "style",
        "body",
        "header",
        "main",
        "h1",
        "h2",
        "h3",
        "p",
        "div",
        "span",
        "i",
        "img",
    }
    assert reader.tags <= tags | {"table", "caption", "tr", "th", "td"}
    own = {"lang", "charset", "name", "content", "class", "role", "tabindex", "aria-hidden", "aria-label", "src", "alt"}
    assert reader.attributes <= own
    assert plain(HOSTILE) in reader.text
    harmless(reader.text.replace("\n", ""))


def test_a_query_prints_what_is_in_the_index(
    spheres_copy: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "3000")
    path = spheres_copy / "index.parquet"
    word = HOSTILE.replace("\ud800", "")
    table = pl.read_parquet(path).with_columns(kind=pl.lit(word), licences=[word])
    table.write_parquet(path)
    rewrite_json(spheres_copy / "dataset.json", lambda record: record.update(index_sha256=file_sha256(path)))
    main(["query", str(spheres_copy), "--columns", "index", "kind", "licences"])
    shown = capsys.readouterr().out
    harmless(shown.replace("\n", ""))
    assert "[bold]i" in shown
    main(["query", str(spheres_copy), "--json"])
    assert "\x1b" not in capsys.readouterr().out


def test_errors_are_one_line_whatever_they_name(
    tmp_path: Path, spheres_dataset: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a\n\x1b[31mb"
    assert main(["verify", str(path)]) == 1
    harmless(capsys.readouterr().err.removesuffix("\n"))
    shutil.copytree(spheres_dataset, path)
    record = path / "scenes" / "000000" / "scene.json"
    stated = json.loads(record.read_text())
    stated["assets"] = [{HOSTILE.replace("\ud800", ""): 1}]
    record.write_text(json.dumps(stated))
    main(["verify", str(path)])
    shown = capsys.readouterr()
    assert not re.search(r"[\x00-\x09\x0b-\x1f\x7f-\x9f\u202e\u2028]", shown.out + shown.err)


def test_a_models_names_are_listed_as_they_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bad\x1b[31m\n.glb").write_bytes(b"glTF nonsense")
    main(["assets", "check", str(tmp_path)])
    shown = capsys.readouterr()
    assert "\x1b[31m" not in shown.out + shown.err
