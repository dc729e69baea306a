"""WebDataset shards, read back by `webdataset` and by Hugging Face `datasets`."""

import io
import json
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from multilight.datagen.cli import main
from multilight.datagen.export.tars import TarShards
from multilight.datagen.export.webdataset.card import HUB_LICENCES, META, Shards, write_card
from multilight.datagen.export.webdataset.export import draw_pairs
from multilight.datagen.storage.open_dataset import open_dataset
from multilight.datagen.storage.records import AssetCredit
from multilight.datagen.tuples import compose
from multilight.lights.display.tonemap import to_display
from multilight.lights.spec import LightingCondition

MEMBERS = {"background.png", "composite.png", "depth.png", "mask.png", "meta.json", "target.png"}


@pytest.fixture(scope="module")
def shards(spheres_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("shards") / "spheres"
    assert main(["export", "webdataset", str(spheres_dataset), "--out", str(out)]) == 0
    return out


def members(path: Path) -> Iterator[tuple[tarfile.TarInfo, bytes]]:
    with tarfile.open(path, "r:") as tar:  # "r:" refuses compression
        for entry in tar:
            stream = tar.extractfile(entry)
            assert stream is not None
            yield entry, stream.read()


def picture(content: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(content)))


def samples(folder: Path) -> dict[str, dict[str, bytes]]:
    found: dict[str, dict[str, bytes]] = {}
    for path in sorted(folder.glob("*.tar")):
        for entry, content in members(path):
            key, _, name = entry.name.partition(".")
            found.setdefault(key, {})[name] = content
    return found


def test_every_sample_has_the_same_members_side_by_side(shards: Path) -> None:
    for path in shards.glob("*.tar"):
        names = [entry.name.partition(".") for entry, _ in members(path)]
        assert all("/" not in key for key, _, _ in names)
        for first in range(0, len(names), len(MEMBERS)):
            group = names[first : first + len(MEMBERS)]
            assert len({key for key, _, _ in group}) == 1
            assert {name for _, _, name in group} == MEMBERS


def test_pictures_are_those_that_the_lightings_make(shards: Path, spheres_dataset: Path) -> None:
    source = open_dataset(spheres_dataset)
    checked = 0
    for key, sample in list(samples(shards).items())[::5]:
        meta = json.loads(sample["meta.json"])
        record = source.scene(meta["scene"])
        view = source.view(record, meta["view"])
        assert key.startswith(f"{meta['scene']:06d}-{meta['view']:02d}-{meta['object']}-")
        insert, base = (
            LightingCondition(name=which, gains=dict(zip(meta["lights"], meta[f"{which}_gains"], strict=True)))
            for which in ("insert", "base")
        )
        wanted = {
            "background.png": compose.background(view, meta["object"], base),
            "composite.png": compose.composite(view, meta["object"], insert=insert, base=base),
            "target.png": compose.target(view, base),
        }
        for name, radiance in wanted.items():
            difference = np.abs(picture(sample[name]).astype(int) - to_display(radiance).astype(int))
            assert difference.max() <= 1, name  # the gains are rounded
        depth = picture(sample["depth.png"])
        assert depth.dtype == np.uint16
        np.testing.assert_allclose(depth / 1000.0, view.geometry.z_depth, atol=0.000501)
        mask = picture(sample["mask.png"])
        assert meta["box"] == list(Image.fromarray(mask).getbbox() or ())
        assert meta["insert_condition"] != meta["base_condition"]
        np.testing.assert_array_equal(
            picture(sample["composite.png"])[mask == 0], picture(sample["background.png"])[mask == 0]
        )
        checked += 1
    assert checked >= 3


def test_bytes_are_the_same_each_time_and_nobody_owns_them(shards: Path, spheres_dataset: Path, tmp_path: Path) -> None:
    again = tmp_path / "spheres"
    assert main(["export", "webdataset", str(spheres_dataset), "--out", str(again)]) == 0
    names = sorted(path.name for path in shards.iterdir())
    assert names == sorted(path.name for path in again.iterdir())
    assert all((shards / name).read_bytes() == (again / name).read_bytes() for name in names)
    for path in shards.glob("*.tar"):
        assert {(e.mtime, e.uid, e.gid, e.uname, e.gname, e.mode) for e, _ in members(path)} == {
            (0, 0, 0, "", "", 0o644)
        }


def test_shards_stay_below_their_bound(tmp_path: Path) -> None:
    with TarShards(tmp_path, most_bytes=30_720) as tars:
        for number in range(20):
            tars.add("train", {f"{number:03d}.a.bin": bytes(3000 + number), f"{number:03d}.b.bin": b"x"})
        tars.add("train", {"big.a.bin": bytes(50_000), "big.b.bin": b"x"})
        tars.add("train", {"last.a.bin": b"x", "last.b.bin": b"x"})
    sizes = [path.stat().st_size for path in sorted(tmp_path.iterdir())]
    assert [size > 30_720 for size in sizes] == [False] * (len(sizes) - 2) + [True, False]
    assert sizes[0] == 30_720  # filled as far as possible: 5 samples of 3584 + 1024 + 512 bytes
    assert sum(count for _, count in tars.shards["train"]) == 22
    kept = [entry.name for path in sorted(tmp_path.iterdir()) for entry, _ in members(path)]
    assert kept[:2] == ["000.a.bin", "000.b.bin"]
    assert len(kept) == 44


def test_pairs_are_drawn_once_each_and_any_number_begins_alike(spheres_dataset: Path) -> None:
    record = open_dataset(spheres_dataset).scene(0)
    count = len(record.conditions)
    every = draw_pairs(record, 0, "object", 10_000)
    assert len(set(every)) == len(every) == count * (count - 1)
    assert draw_pairs(record, 0, "object", 3) == every[:3]
    assert draw_pairs(record, 1, "object", 3) != every[:3]
    alone = record.model_copy(update={"conditions": record.conditions[:1]})
    assert draw_pairs(alone, 0, "object", 3) == [(0, 0)]


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_webdataset_reads_the_shards(shards: Path) -> None:
    import webdataset

    wanted = samples(shards)
    urls = [str(path) for path in sorted(shards.glob("*.tar"))]

    def sixteen_bits(content: bytes) -> np.ndarray:
        return picture(content)

    deep = webdataset.handle_extension("depth.png", sixteen_bits)
    found: list[dict[str, Any]] = list(webdataset.WebDataset(urls, shardshuffle=False).decode(deep, "rgb8"))
    assert [sample["__key__"] for sample in found] == list(wanted)
    for sample in found:
        raw = wanted[sample["__key__"]]
        np.testing.assert_array_equal(sample["target.png"], picture(raw["target.png"]))
        np.testing.assert_array_equal(sample["depth.png"], picture(raw["depth.png"]))
        assert sample["meta.json"] == json.loads(raw["meta.json"])


def test_datasets_reads_the_shards_and_the_card(shards: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    datasets = pytest.importorskip("datasets")
    datasets.disable_progress_bars()
    wanted = samples(shards)
    (split,) = {path.name.split("-")[0] for path in shards.glob("*.tar")}
    files = {split: [str(path) for path in sorted(shards.glob("*.tar"))]}
    plain = datasets.load_dataset("webdataset", data_files=files, split=split, cache_dir=str(tmp_path / "a"))
    carded = datasets.load_dataset(str(shards), split=split, cache_dir=str(tmp_path / "b"))
    assert plain.features == carded.features  # what the reader infers is what the card states
    assert len(plain) == len(carded) == len(wanted)
    assert plain[0]["meta.json"] == json.loads(wanted[plain[0]["__key__"]]["meta.json"])
    np.testing.assert_array_equal(np.asarray(plain[0]["depth.png"]), picture(wanted[plain[0]["__key__"]]["depth.png"]))


def test_card_states_licences_sizes_and_credits(
    spheres_dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    hub = pytest.importorskip("huggingface_hub")
    record = open_dataset(spheres_dataset).record
    licences = ("CC0-1.0", "CC-BY-3.0", "CC-BY-3.0", "Own-Licence-1")
    credits = [
        AssetCredit(id=f"a/{i}", pack="a", name=f"vase {i}", creator=f"Ann{i}", licence=x)
        for i, x in enumerate(licences)
    ]
    splits = {"train": (("train-00000.tar", 900), ("train-00001.tar", 300)), "test_ood": (("test_ood-00000.tar", 4),)}
    write_card(tmp_path, Shards(splits), record, credits, title="set")
    card = hub.DatasetCard.load(tmp_path / "README.md")
    assert card.data.license == ["cc-by-3.0", "cc0-1.0", "other"]
    assert set(card.data.license) - {"other"} <= HUB_LICENCES
    assert card.data.size_categories == ["1K<n<10K"]
    assert [part["split"] for part in card.data.configs[0]["data_files"]] == ["train", "test_ood"]
    for i, licence in enumerate(licences):
        assert f"| {licence} | Ann{i} | vase {i} (a) |" in card.text


def test_meta_has_the_keys_of_the_card(shards: Path) -> None:
    for sample in samples(shards).values():
        assert list(json.loads(sample["meta.json"])) == list(META)


def test_a_folder_with_something_in_it_is_refused(
    shards: Path, spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    assert main(["export", "webdataset", str(spheres_dataset), "--out", str(tmp_path)]) == 1
    assert "is not empty" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]
    assert main(["export", "webdataset", str(spheres_dataset), "--out", str(shards), "--where", "index = 0"]) == 1
    assert "was made with where = None, not index = 0" in capsys.readouterr().err
    assert main(["export", "webdataset", str(spheres_dataset), "--out", str(shards)]) == 0
    assert "nothing to do" in capsys.readouterr().out
