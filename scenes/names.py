"""Names made of any text: for bodies, lights, files and folders."""

import re
from collections.abc import Container

LONGEST = 30
"""Letters of a text that go into a name; what is put before and behind it must fit into a `Slug` too."""


def slug(text: str, separator: str = "_") -> str:
    """Return a text in lower-case letters, digits and `separator`; empty where it has none of them."""
    return re.sub(r"[^a-z0-9]+", separator, text.lower()).strip(separator)


def free_name(text: str, taken: Container[str], *, prefix: str = "", otherwise: str) -> str:
    """Name something after a text, as none in `taken` is: `mug`, `mug_2`; with `otherwise` before what is no letter."""
    plain = slug(text)[:LONGEST]
    plain = prefix + (plain if plain[:1].isalpha() else f"{otherwise}_{plain}".rstrip("_"))
    name, number = plain, 2
    while name in taken:
        name, number = f"{plain}_{number}", number + 1
    return name
