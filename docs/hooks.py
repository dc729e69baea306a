"""What `mkdocs build` is told besides: the root's documents and the examples are pages of the site as well."""

import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]


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


def on_page_markdown(markdown: str, **_: object) -> str:
    """Let links between the repository's files lead to the site's pages."""
    markdown = re.sub(r"\]\((?:\.\./)?examples/(\w+)\.py\)", r"](examples/\1.md)", markdown)
    markdown = re.sub(
        r"\[([^\]]+)\]\((?:examples|docs|CITATION\.cff|LICENSE|(?:\.\./)?deploy/[\w.-]+)\)", r"\1", markdown
    )
    return re.sub(r"\]\((?:\.\./|docs/)", "](", markdown)
