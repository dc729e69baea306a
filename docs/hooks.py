"""What `mkdocs build` is told besides: the root's documents and the examples are pages; the light mixer is there."""

import re
from collections import Counter
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import Abort
from mkdocs.structure.files import File, Files
from mkdocs.structure.nav import Link, Navigation
from mkdocs.structure.pages import Page

from multilight.datagen.cli import main

ROOT = Path(__file__).parents[1]
MIXER = "mixer/index.html"
SMALL = ["--preset", "tabletop", "--views", "3", "--width", "256", "--height", "192", "--seed", "42"]
"""How the mixer's two scenes are made, which takes a minute; the folder `extra.scenes` keeps them."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that lie outside of docs/."""
    for page in ROOT.glob("*.md"):
        files.append(File.generated(config, page.name, content=page.read_text()))
    for example in (ROOT / "examples").glob("*.py"):
        code = example.read_text()
        title = example.stem.replace("_", " ").capitalize()
        files.append(
            File.generated(config, f"examples/{example.stem}.md", content=f"# {title}\n\n```python\n{code}```\n")
        )
    return files


def on_nav(nav: Navigation, **_: object) -> Navigation:
    """Name the mixer, which is no page of mkdocs."""
    nav.items.insert(2, Link("Try the light mixer", MIXER))
    return nav


def on_post_build(config: MkDocsConfig) -> None:
    """Put the mixer with two small scenes beside the pages."""
    scenes = Path(config.extra["scenes"])
    made = ["dataset", "--out", str(scenes), "--scenes", "2", *([] if scenes.exists() else SMALL)]
    for words in (made, ["export", "web", str(scenes), "--out", str(Path(config.site_dir, MIXER).parent)]):
        if main(words):
            raise Abort(f"multilight {' '.join(words)}: failed")


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Let links between the repository's files lead to the site's pages, and to the mixer."""
    if page.file.src_uri == "viewing.md":
        markdown = markdown.replace(
            "\n\n", f'\n\n<a href="{MIXER}"><strong>Try it here</strong></a>, with two small scenes.\n\n', 1
        )
    markdown = re.sub(r"\]\((?:\.\./)?examples/(\w+)\.py\)", r"](examples/\1.md)", markdown)
    markdown = re.sub(
        r"\[([^\]]+)\]\((?:examples|docs|CITATION\.cff|LICENSE|(?:\.\./)?deploy/[\w.-]+)\)", r"\1", markdown
    )
    return re.sub(r"\]\((?:\.\./|docs/)", "](", markdown)


def on_post_page(output: str, **_: object) -> str:
    """Mend what bars screen readers: a dialog without a name, headings of tables without a word, equal names."""
    output = output.replace('role="dialog"', 'role="dialog" aria-label="Search"')
    output = re.sub(r"<thead>\s*<tr>\s*(?:<th[^>]*></th>\s*)+</tr>\s*</thead>", "", output)
    output = re.sub(r"<th([^>]*)></th>", r"<td\1></td>", output)
    seen: Counter[str] = Counter()

    def numbered(nav: re.Match[str]) -> str:
        name = nav[0].lower().strip()
        seen[name] += 1
        return nav[0] if seen[name] == 1 else f"{nav[0]} {seen[name]}"

    return re.sub(r'<nav class="md-nav" aria-label="[^"]*', numbered, output)


def on_post_template(output_content: str, **_: object) -> str:
    """Mend the page that tells of a page that is not there."""
    return on_post_page(output_content)
