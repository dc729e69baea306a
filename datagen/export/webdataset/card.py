"""The card of a shard set: what the Hugging Face hub and its readers want to know, and people too."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from multilight.datagen.export.credits import credit_lines
from multilight.datagen.storage.records import AssetCredit, DatasetRecord
from multilight.datagen.text import markdown

HUB_LICENCES = frozenset({"apache-2.0", "cc-by-3.0", "cc-by-4.0", "cc-by-sa-3.0", "cc-by-sa-4.0", "cc0-1.0", "mit"})
"""Names the hub knows, of those that assets come under; what is not among them is `other`."""
SIZES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))
PICTURES = ("background.png", "composite.png", "depth.png", "mask.png", "target.png")
WHOLE, WORD, NUMBERS = "dtype: int64", "dtype: string", "list:\n        list: float64"
META = {
    "scene": WHOLE, "view": WHOLE, "object": WORD, "category": WORD, "kind": WORD, "split": WORD,
    "insert_condition": WORD, "base_condition": WORD, "lights": "list: string", "insert_gains": NUMBERS,
    "base_gains": NUMBERS, "box": "list: int64", "K": NUMBERS, "c2w": NUMBERS,
}  # fmt: skip
"""Keys of `meta.json` and their types, as the card has them."""

TEXT = """
# {title}

Synthetic data for putting objects into pictures, made with multilight:
{samples} samples of {size}, rendered with {renderer}.

A sample is a view of a scene, an object in it, and two lightings: the object as lit by one, the picture by the other.
Each shard is an uncompressed tar; the files of a sample share their name up to the first dot, `SCENE-VIEW-OBJECT-PAIR`.

| file | |
|---|---|
| `composite.png` | the object, lit by `insert_condition`, pasted over the background |
| `background.png` | the scene without the object, lit by `base_condition`: no shadow or reflection of it either |
| `target.png` | the truth: the scene with the object, lit by `base_condition` |
| `mask.png` | the object's share of each pixel, 255 = all of it |
| `depth.png` | 16-bit millimetres along the optical axis, 0 where there is nothing or it is beyond 65.5 m |
| `meta.json` | where the sample comes from, lightings, the object's box (x0, y0, x1, y1), camera |

Pictures are 8-bit sRGB, tone-mapped. The picture decoders of `webdataset` would cut the depth to 8 bits, so give that
member a decoder of its own: `webdataset.handle_extension("depth.png", ...)`. `insert_gains` and `base_gains` are
linear RGB gains of `lights`, exposure included. `K` is in pixels, pixel centres at (x + 0.5, y + 0.5); `c2w` is
camera-to-world, OpenGL axes, metres, +Z up.

```python
from datasets import load_dataset
data = load_dataset("webdataset", data_files={{"train": "train-*.tar"}}, split="train", streaming=True)
```

| split | shards | samples |
|---|---|---|
{splits}

## Assets

{credits}
"""


@dataclass(frozen=True)
class Shards:
    """What was written: split → (file name, samples) of each shard."""

    splits: Mapping[str, Sequence[tuple[str, int]]]

    def samples_of(self, split: str) -> int:
        """Count a split's samples."""
        return sum(samples for _, samples in self.splits[split])

    @property
    def samples(self) -> int:
        """All samples."""
        return sum(map(self.samples_of, self.splits))


def write_card(
    folder: Path, shards: Shards, record: DatasetRecord, credits: Sequence[AssetCredit], *, title: str
) -> None:
    """Write `README.md` with YAML front matter: licence, size category, features, splits."""
    rows = [f"| {split} | {len(shards.splits[split])} | {shards.samples_of(split)} |" for split in shards.splits]
    text = TEXT.format(
        title=markdown(title),
        samples=shards.samples,
        size=f"{record.config.width} x {record.config.height} pixels",
        renderer=record.renderer,
        splits="\n".join(rows),
        credits="\n".join(credit_lines(credits)),
    )
    (folder / "README.md").write_text(
        "\n".join(["---", *_front_matter(shards, credits), "---", text]), encoding="utf-8"
    )


def _front_matter(shards: Shards, credits: Sequence[AssetCredit]) -> list[str]:
    names = {credit.licence.lower() for credit in credits} or {"cc0-1.0"}
    licences = sorted({name if name in HUB_LICENCES else "other" for name in names})
    size = next((name for most, name in SIZES if shards.samples < most), "1M<n<10M")
    lines = ["license:", *(f"- {name}" for name in licences)]
    if "other" in licences:
        lines += ["license_name: see-assets"]
    lines += ["task_categories:", "- image-to-image", "tags:", "- webdataset", "- image-compositing", "- relighting"]
    lines += ["size_categories:", f"- {size}", "configs:", "- config_name: default", "  data_files:"]
    for split in shards.splits:
        lines += [f"  - split: {split}", f"    path: {split}-*.tar"]
    struct = [line for name, kind in META.items() for line in (f"    - name: {name}", f"      {kind}")]
    features = {name: ["    dtype: image"] for name in PICTURES} | {"meta.json": ["    struct:", *struct]}
    lines += ["dataset_info:", "  features:"]
    lines += [line for name in sorted(features) for line in (f"  - name: {name}", *features[name])]
    return [*lines, "  - name: __key__", "    dtype: string", "  - name: __url__", "    dtype: string"]
