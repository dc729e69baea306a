"""What a dataset says that it was made with, and what is said where it goes on with others."""

from pathlib import Path

import trimesh

from multilight.datagen.config.dataset import DatasetConfig
from multilight.datagen.production.makers import Makers, makers_here
from multilight.datagen.storage.records import DatasetRecord
from multilight.scenes.assets.library import AssetLibrary


def recorded(makers: Makers) -> DatasetRecord:
    return DatasetRecord(config=DatasetConfig(), renderer="mitsuba", **vars(makers))


def test_packs_are_known_by_their_content(tmp_path: Path) -> None:
    mine, cache = tmp_path / "mine", tmp_path / "cache"
    mine.mkdir()
    trimesh.creation.box().export(mine / "box.glb")

    def here(*folders: Path) -> Makers:
        return makers_here("cycles", AssetLibrary(cache, folders=folders))

    with_mine, alone = here(mine), here()
    assert set(with_mine.packs) == {"builtin", "mine"}
    assert here(mine).others(recorded(with_mine)) == []
    assert alone.others(recorded(with_mine)) == ["with the pack 'mine', which is not there"]
    assert with_mine.others(recorded(alone)) == ["without the pack 'mine'"]
    trimesh.creation.box((1, 1, 2)).export(mine / "box.glb")
    assert here(mine).others(recorded(with_mine)) == ["with other content in the pack 'mine'"]


def test_what_is_not_stated_is_not_compared() -> None:
    old = DatasetRecord(config=DatasetConfig(), renderer="cycles", versions={"numpy": "1.0"})
    here = Makers("cuda_ad_rgb", {"numpy": "1.0", "processor": "x86_64"}, {"builtin": "1"})
    assert here.others(old) == ["variant none, now cuda_ad_rgb"]
