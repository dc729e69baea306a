"""The command `import`: a scene that was exported, edited elsewhere or not, made into a dataset again."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from multilight.datagen.commands.dataset import config_key, make_scenes
from multilight.datagen.config.dataset import Denoise, Renderer, load_config
from multilight.datagen.errors import UserError


@dataclass
class Import:
    """Render the scene of a stage that `multilight export usd` wrote: its bodies, materials, lights and cameras."""

    format: tyro.conf.Positional[Literal["usd"]]
    """What the scene lies in: an OpenUSD stage."""
    file: tyro.conf.Positional[Path]
    """The stage (.usdc, .usda, .usd). Other USD files serve as backgrounds: `dataset --kind custom --background`."""
    out: Path = field(kw_only=True)
    """Folder of the dataset of this one scene."""
    renderer: Annotated[Renderer | None, config_key("renderer")] = None
    spp: Annotated[int | None, config_key("spp")] = None
    denoise: Annotated[Denoise | None, config_key("denoise")] = None
    assets: tuple[Path, ...] = ()
    """Folders of your own models that the scene uses; what is missing is taken from the stage."""

    def run(self) -> int:
        """Make the dataset and return the exit code."""
        from multilight.datagen.files.outputs import check_folder

        if not self.file.is_file():
            what = "is not a file" if self.file.exists() else "does not exist"
            raise UserError(f"{self.file} {what}; name the stage of `multilight export usd`, scene.usdc")
        check_folder(self.out)
        from multilight.datagen.production.library import open_library
        from multilight.datagen.usd.read import read_stage

        given = {"renderer": self.renderer, "spp": self.spp, "denoise": self.denoise}
        values = given | {"kind": "imported", "background": self.file, "scenes": 1}
        config = load_config(None, values)
        found = read_stage(self.file, open_library(config, self.assets))
        camera, kept = found.scene.cameras[0], found.scene.insertable
        print(
            f"{self.file}: {len(found.scene.bodies)} bodies, {len(kept)} of them insertable, {len(found.rig.lights)} "
            f"lights, {len(found.scene.cameras)} cameras; "
            + ("as it was exported" if found.as_written else "changed since it was exported")
        )
        size = {"width": camera.width, "height": camera.height, "views": len(found.scene.cameras)}
        config = load_config(None, values | size)
        return make_scenes(self.out, config, (0,), workers=1, assets=self.assets)
