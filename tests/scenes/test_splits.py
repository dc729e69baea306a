"""Splits: nothing that a test scene shows was ever seen in training, whatever is installed and drawn."""

import itertools
from collections import Counter, defaultdict

import pytest
from hypothesis import given
from hypothesis import strategies as st

from multilight.datagen.config.dataset import DatasetConfig
from multilight.datagen.production.scene import sample_scene
from multilight.datagen.stats.facts import owned_by
from multilight.scenes.assets.info import AssetInfo
from multilight.scenes.assets.library import AssetError, AssetLibrary
from multilight.scenes.assets.splits import (
    ASSET_SHARES,
    FITTINGS,
    SPLITS,
    Split,
    SplitShares,
    asset_split,
    in_split,
    scene_split,
)
from multilight.scenes.random_streams import Streams
from multilight.scenes.still_life.selection import INSERTABLE, LARGEST, SMALL, SMALLEST, TALL, THIN

SCENES = 16


@pytest.fixture(scope="module")
def library() -> AssetLibrary:
    return AssetLibrary()


def info(**changes: object) -> AssetInfo:
    plain = {"id": "p/a", "pack": "p", "role": "object", "name": "a", "category": "mug", "licence": "", "creator": ""}
    return AssetInfo(**(plain | changes))  # type: ignore[arg-type]


def places_and_models(library: AssetLibrary) -> set[str]:
    infos = (i for role in ("object", "table", "surrounding", "environment") for i in library.list(role))
    return {f"place {i.place}" if i.place else i.id for i in infos if asset_split(i) is not None}


def test_views_of_the_library_share_no_model_and_no_place(library: AssetLibrary) -> None:
    held = {split: places_and_models(library.restricted(split)) for split in SPLITS}
    for first, second in itertools.combinations(SPLITS, 2):
        assert not held[first] & held[second]
    assert set().union(*held.values()) == places_and_models(library)


def test_categories_out_of_domain_are_whole(library: AssetLibrary) -> None:
    lamps = {i.category for i in library.list("object") if i.emissive_part}
    out = {i.category for i in library.restricted("test_ood").list("object")} - lamps
    assert len(out) >= 3
    for split in ("train", "val", "test"):
        assert not out & {i.category for i in library.restricted(split).list("object")}


@pytest.mark.parametrize("split", SPLITS)
def test_builtin_assets_alone_fill_every_split(split: Split) -> None:
    view = AssetLibrary(packs=("builtin",)).restricted(split)
    sizes = {i.id: i.size for i in view.list("object") if i.size and SMALLEST <= max(i.size) <= LARGEST}
    fit = [s for s in sizes.values() if INSERTABLE[0] <= max(s) <= INSERTABLE[1] and sorted(s)[1] >= THIN]
    assert len(sizes) >= 8
    assert len(fit) >= 5
    assert any(size[2] >= TALL for size in fit)
    assert any(max(size) <= SMALL for size in fit)
    assert any(view.info(name).emissive_part for name in sizes)
    assert any(i.size and 0.3 <= i.size[2] <= 1.6 for i in view.list("table"))
    assert view.list("environment")
    assert view.list("texture")


def test_shares_of_the_default_packs(library: AssetLibrary) -> None:
    for role in ("object", "table", "environment"):
        infos = [i for i in library.list(role) if asset_split(i) is not None]
        found = Counter(asset_split(i) for i in infos)
        if len(infos) > 40:
            for split, share in ASSET_SHARES.items():
                assert found[split] / len(infos) == pytest.approx(share, abs=0.1), (role, found)


def test_what_else_is_installed_moves_nothing(library: AssetLibrary) -> None:
    alone = AssetLibrary(packs=("builtin",))
    assert {i.id: asset_split(i) for i in alone.list("object")}.items() <= {
        i.id: asset_split(i) for i in library.list("object")
    }.items()


def test_a_place_keeps_its_split_in_every_pack() -> None:
    sky = info(role="environment", id="a/noon", place="venice_sunset")
    same = info(role="environment", id="b/other", pack="b", place="venice_sunset")
    assert asset_split(sky) == asset_split(same) is not None


def test_surfaces_and_fittings_are_shared() -> None:
    assert asset_split(info(role="texture")) is None
    for category in FITTINGS:
        assert asset_split(info(role="surrounding", category=category)) is None
    assert asset_split(info(role="surrounding", category="sofa")) is not None
    assert in_split(info(role="texture"), "test")


def test_a_view_hands_out_no_foreign_asset(library: AssetLibrary) -> None:
    view = library.restricted("test")
    foreign = library.restricted("train").list("object")[0]
    with pytest.raises(AssetError, match=r"does not belong to the split 'test'"):
        view.mesh(foreign.id)
    assert library.split is None
    assert library.info(foreign.id) == foreign


@given(seed=st.integers(0, 2**32 - 1), start=st.integers(0, 10_000))
def test_any_run_of_scenes_holds_the_shares(seed: int, start: int) -> None:
    shares = SplitShares(train=0.7, val=0.1, test=0.1, test_ood=0.1)
    found: Counter[str] = Counter(scene_split(seed, start + i, shares) for i in range(200))
    for split, share in shares.model_dump().items():
        assert abs(found[split] - 200 * share) <= 5


def test_a_share_of_zero_is_none() -> None:
    only = SplitShares(train=0, val=0, test=0, test_ood=1)
    assert {scene_split(0, i, only) for i in range(100)} == {"test_ood"}
    with pytest.raises(ValueError, match="share above 0"):
        SplitShares(train=0, val=0, test=0)


def test_kinds_follow_their_shares_inside_every_split() -> None:
    config = DatasetConfig(
        kind="mixed",
        splits=SplitShares(train=0.5, val=0.2, test=0.2, test_ood=0.1),
        ood_kinds=("outdoor",),
        kinds={"tabletop": 0.5, "room": 0.3, "studio": 0.2, "outdoor": 0.0},
    )
    kinds: dict[str, Counter[str]] = defaultdict(Counter)
    for index in range(1000):
        kinds[config.split_of(index)][config.kind_of(index)] += 1
    assert set(kinds["test_ood"]) == {"outdoor"}
    for split in ("train", "val", "test"):
        total = kinds[split].total()
        assert kinds[split]["outdoor"] == 0
        for kind, share in (("tabletop", 0.5), ("room", 0.3), ("studio", 0.2)):
            assert kinds[split][kind] / total == pytest.approx(share, abs=0.06)


@pytest.mark.slow
def test_sampled_scenes_leak_nothing(library: AssetLibrary) -> None:
    config = DatasetConfig(
        seed=11, width=64, height=48, views=2, splits=SplitShares(train=0.4, val=0.2, test=0.2, test_ood=0.2)
    )
    shown: dict[str, set[str]] = defaultdict(set)
    for index in range(SCENES):
        scene, rig = sample_scene(config, library, Streams(config.seed, index))
        shown[config.split_of(index)] |= owned_by(scene, rig, library)
    assert all(len(shown[split]) > 10 for split in SPLITS)
    for first, second in itertools.combinations(SPLITS, 2):
        assert not shown[first] & shown[second], (first, second)
