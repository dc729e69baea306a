"""What bytes depend on besides the configuration: recorded where a dataset begins, compared where it goes on."""

import importlib.metadata
import platform
from dataclasses import dataclass
from pathlib import Path

from multilight.datagen.backends.machine.mitsuba_variant import choose_variant
from multilight.datagen.config.dataset import RendererName
from multilight.datagen.storage.records import DatasetRecord
from multilight.scenes.assets.library import AssetLibrary

PACKAGES = ("multilight", "bpy", "mitsuba", "drjit", "mitsuba-oidn", "OpenEXR", "trimesh", "numpy", "colour-science")
WIDE = ("avx512f", "avx2")
"""What a processor's arithmetic may be like: the first that it has decides which code runs."""


@dataclass(frozen=True)
class Makers:
    """Mitsuba's variant, versions of packages and the kind of processor, the packs to draw from and what they hold."""

    variant: str
    versions: dict[str, str]
    packs: dict[str, str]

    def others(self, record: DatasetRecord) -> list[str]:
        """Say in what these are not those of a dataset, as far as it states them."""
        said = [
            f"{what} {was}, now {self.versions[what]}"
            for what, was in record.versions.items()
            if self.versions.get(what, was) != was
        ]
        if record.variant != self.variant:
            said.append(f"variant {record.variant or 'none'}, now {self.variant or 'none'}")
        packs = record.packs.keys() | self.packs.keys() if record.packs else ()
        for pack in sorted(packs):
            was, now = record.packs.get(pack), self.packs.get(pack)
            if was != now:
                kind = "without" if was is None else "with" if now is None else "with other content in"
                said.append(f"{kind} the pack {pack!r}" + ", which is not there" * (now is None))
        return said


def makers_here(renderer: RendererName, library: AssetLibrary | None) -> Makers:
    """Look at this machine, and at a library of assets (None: what is installed); closed forms use none."""
    flags = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace").split()
    wide = next((name for name in WIDE if name in flags), "")
    return Makers(
        (choose_variant().variant or "") if renderer == "mitsuba" else "",
        {package: importlib.metadata.version(package) for package in PACKAGES}
        | {"processor": f"{platform.machine()} {wide}".strip()},
        {} if renderer == "analytic" else (library or AssetLibrary()).contents(),
    )
