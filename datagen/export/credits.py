"""Who made the assets in an export, as their licences ask to be told."""

from collections.abc import Sequence

from multilight.datagen.storage.records import AssetCredit
from multilight.datagen.text import markdown


def credit_lines(credits: Sequence[AssetCredit]) -> list[str]:
    """Make a Markdown table of creators and works, one row a creator and licence."""
    if not credits:
        return ["The scenes hold nothing but shapes that the program makes itself."]
    works: dict[tuple[str, str], set[str]] = {}
    for credit in credits:
        works.setdefault((credit.licence, credit.creator), set()).add(f"{credit.name} ({credit.pack})")
    rows = [
        f"| {markdown(licence)} | {markdown(creator)} | {markdown(', '.join(sorted(works[licence, creator])))} |"
        for licence, creator in sorted(works)
    ]
    return ["| licence | by | works |", "|---|---|---|", *rows]
