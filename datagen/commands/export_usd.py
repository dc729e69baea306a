"""The command `export usd`: a stage for each scene of a dataset."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import tyro

from multilight.datagen.text import plain


@dataclass
class Usd:
    """An OpenUSD stage a scene: meshes, UsdPreviewSurface, UsdLux lights in nits and lux, cameras, lightings."""

    dir: tyro.conf.Positional[str]
    """Folder or address of the dataset."""
    out: Path = field(kw_only=True)
    """Folder to write scene_000000/scene.usdc and its textures into; scenes that are there are kept."""
    scene: int | None = None
    """Index of the one scene to write (default: all)."""
    where: str | None = None
    """Which scenes: an SQL expression over the index, as in `multilight query`."""
    on_broken: Literal["raise", "skip"] = "raise"
    """What to do about a scene that cannot be read: stop with its file and the reason, or pass it over and count it."""
    assets: tuple[Path, ...] = ()
    """Folders of your own models that the dataset was made with."""

    def run(self) -> int:
        """Write the stages and return the exit code."""
        from multilight.datagen.commands.output import progress
        from multilight.datagen.storage.source import open_dataset
        from multilight.datagen.usd.write import export_usd

        source = open_dataset(self.dir, where=self.where, on_broken=self.on_broken)
        with progress("scenes") as report:
            made = export_usd(source, self.out, report, scene=self.scene, assets=self.assets)
        for index, reason in source.skipped.items():
            print(plain(f"passed over scene {index}: {reason}"))
        print(f"{self.out}: stages {len(made)}, passed over {len(source.skipped)}")
        return 0
