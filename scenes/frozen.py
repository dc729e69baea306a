"""The base of every stored specification: frozen, validated, canonical JSON, hashed."""

import hashlib
import json
from collections.abc import Iterable
from typing import Annotated, Self, SupportsFloat

from pydantic import BaseModel, ConfigDict, Field

Vector3 = tuple[float, float, float]
Rgb = tuple[Annotated[float, Field(ge=0)], Annotated[float, Field(ge=0)], Annotated[float, Field(ge=0)]]
UnitFloat = Annotated[float, Field(ge=0, le=1)]
Row4 = tuple[float, float, float, float]
Matrix4 = tuple[Row4, Row4, Row4, Row4]
Slug = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=40)]


def triple(values: Iterable[SupportsFloat]) -> Vector3:
    """Return three numbers, such as an array (3,), as the tuple that specifications hold."""
    first, second, third = map(float, values)
    return first, second, third


class Frozen(BaseModel):
    """A value object: immutable, without unknown keys, NaN or infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def canonical_json(self) -> str:
        """Serialize with sorted keys and no spaces: equal specs give equal text."""
        return json.dumps(self.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))

    def sha256(self) -> str:
        """Hash the canonical JSON (64 hex digits)."""
        return hashlib.sha256(self.canonical_json().encode()).hexdigest()

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Parse and validate; raises `pydantic.ValidationError` naming the key and the value."""
        return cls.model_validate_json(text)


class Settings(Frozen):
    """Part of a configuration; the docstrings under its fields say what they mean wherever they are shown."""

    model_config = ConfigDict(use_attribute_docstrings=True)
