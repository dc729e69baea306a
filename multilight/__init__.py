"""Synthetic multi-light data: scenes rendered once, light by light, and mixed afterwards.

    import multilight

    data = multilight.make("out/demo", scenes=1, preset="tabletop", views=1)
    picture = data[0].mix(view=0, condition=7)  # lit at random, with seed 7

To make: `make`, `make_scene`. To read: `open`, `verify`, and what `open` returns, a `Dataset` of `Scene`s. Light:
`LightingCondition`; `to_display` turns radiance into what a screen shows. To learn: `MultiLightDataset` with its
`SampleSettings`, and `harmonize`. All that a user can mend is raised as `UserError`.

Names are imported when they are asked for, so `import multilight` starts no renderer and no torch. The folders
`scenes`, `lights`, `datagen` and `model` of the repository are this package's own, through links.
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from multilight.datagen.errors import UserError
    from multilight.harmonizing import harmonize
    from multilight.lights.display.tonemap import to_display
    from multilight.lights.spec import LightingCondition
    from multilight.making import make, make_scene
    from multilight.model.data import MultiLightDataset, SampleSettings
    from multilight.reading import Dataset, Scene, open, verify

    __version__: str

__all__ = [
    "Dataset",
    "LightingCondition",
    "MultiLightDataset",
    "SampleSettings",
    "Scene",
    "UserError",
    "__version__",
    "harmonize",
    "make",
    "make_scene",
    "open",
    "to_display",
    "verify",
]

_HOMES = {
    "Dataset": "reading",
    "LightingCondition": "lights.spec",
    "MultiLightDataset": "model.data",
    "SampleSettings": "model.data",
    "Scene": "reading",
    "UserError": "datagen.errors",
    "harmonize": "harmonizing",
    "make": "making",
    "make_scene": "making",
    "open": "reading",
    "to_display": "lights.display.tonemap",
    "verify": "reading",
}
_EXTRAS = {"making": "render", "model.data": "train", "harmonizing": "train"}
"""What a home needs beyond reading, as it is called in `pip install 'multilight[...]'`."""


def __getattr__(name: str) -> Any:
    """Import a name of `__all__` when it is first asked for."""
    if name == "__version__":
        return version("multilight")
    if name not in _HOMES:
        raise AttributeError(f"module 'multilight' has no attribute {name!r}; it has {', '.join(__all__)}")
    home = _HOMES[name]
    try:
        value = getattr(import_module(f"multilight.{home}"), name)
    except ModuleNotFoundError as error:
        if home not in _EXTRAS or str(error.name).startswith("multilight"):
            raise
        needs = f"multilight.{name} needs {error.name}: pip install 'multilight[{_EXTRAS[home]}]'"
        raise ImportError(needs, name=error.name) from error
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(set(globals()) | set(__all__))
