"""Fill a page's template, which extends `base.html.jinja`; whatever stands in data shows as text."""

import base64
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from multilight.datagen.text import plain


def render_page(template: Path, **values: Any) -> str:
    """Return the page that a template makes of values; strings in them are escaped, control characters as well."""
    environment = Environment(
        loader=FileSystemLoader([template.parent, Path(__file__).parent]),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=lambda value: value if hasattr(value, "__html__") else plain(str(value)),
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template.name).render(values)


def data_uri(content: bytes, kind: str) -> str:
    """Return the address of a picture of MIME type `image/<kind>` that stands in the page itself."""
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"
