"""USD's own validators (what `usdchecker` runs) on a stage."""

from pathlib import Path
from typing import Any

from pxr import Usd, UsdValidation


def stage_faults(path: Path) -> list[str]:
    """Return what the validators find wrong with a stage, one line each."""
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    context = UsdValidation.ValidationContext(validators)
    return [_told(error) for error in context.Validate(Usd.Stage.Open(str(path)))]


def _told(error: Any) -> str:
    places = ", ".join(str(site.GetPrim().GetPath()) for site in error.GetSites() if site.IsPrim())
    return f"{error.GetName()}: {error.GetMessage()} {places}".strip()
