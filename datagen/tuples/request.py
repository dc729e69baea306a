"""What picture `mixing` is asked for; light to import, since the command line shows it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import Positional


@dataclass(frozen=True)
class MixRequest:
    """Which picture: a view of a scene, what to make of it, and the lighting of base and inserted object."""

    address: Positional[str]
    """Folder or address of the dataset."""
    out: Path
    """Picture to write: .png (tone-mapped) or .exr (scene-linear float)."""
    scene: int = 0
    """Index of the scene."""
    view: int = 0
    """Number of the view."""
    condition: str = "all"
    """Lighting: a condition's name, a JSON file, or random:SEED."""
    insert_condition: str | None = None
    """Lighting of the inserted object in a composite; as --condition."""
    object: str | None = None
    """Insertable object (default: the first)."""
    what: Literal["target", "background", "composite", "effect"] | None = None
    """What to make (default: composite with --insert-condition, else target)."""
