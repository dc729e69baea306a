"""What picture `mixing` is asked for; light to import, since the command line shows it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

What = Literal["target", "background", "composite", "effect", "depth", "normal", "albedo", "ids", "mask"]


@dataclass(frozen=True)
class MixRequest:
    """Which picture: a view of a scene, what to make of it, and the lighting of base and inserted object."""

    address: Positional[str | None] = None
    """Folder or address of the dataset."""
    out: Path | None = None
    """Picture to write: .png for the eye, or .exr: linear radiance, depth in metres, and so on."""
    scene: int = 0
    """Index of the scene."""
    view: int = 0
    """Number of the view."""
    condition: str | None = None
    """Lighting (default: all): a stored condition's name, random:SEED, or a JSON file, for example
    {"name": "warm", "gains": {"key": [1.2, 0.9, 0.5], "fill": 1}, "exposure_ev": 0.5}
    A gain is one number, or three: red, green, blue. Lights that are not named are off."""
    insert_condition: str | None = None
    """Lighting of the inserted object in a composite; as --condition."""
    object: str | None = None
    """Insertable object (default: the first)."""
    what: What | None = None
    """What to make (default: composite with --insert-condition, else target).
    Depth is along the optical axis, near bright; normals are in world axes, +Z up; ids are the bodies;
    the mask is the object's share of each pixel."""
    save_condition: Path | None = None
    """Also write the lighting, as a JSON file that --condition takes."""
    save_insert_condition: Path | None = None
    """Also write the lighting of the inserted object."""
    lights: bool = False
    """Only this: list the scene's lights, what they are, and its stored conditions."""
    condition_schema: bool = False
    """Only this: print the JSON schema of a condition's file."""
