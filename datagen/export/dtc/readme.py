"""The page beside DTC-MultiLight roots: where they came from, how they differ from the published set, whom to thank."""

from collections.abc import Sequence
from pathlib import Path

from multilight.datagen.export.credits import credit_lines
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.store import write_text
from multilight.datagen.text import markdown

TEXT = """# A Multilight dataset in the layouts of DTC-MultiLight

Made from {address}: {train} scenes of split `train` in the training roots, {rest} others in the evaluation roots.
MV-CoLight's loaders read `train.json` and `test.json`; these hold absolute paths: after moving the folder run the same
export again, which writes them anew, or edit them.

- Lighting `<a>_<b>` is condition 2a + b of the scene; `_ev0`, `_ev1`, ... are half a step apart in natural logarithm.
- Object masks hold the object's share of each pixel, so edges are grey; depths and environment masks are those of
  the pixels' centres and are never filtered.
- The masks of evaluation scenes cover the environment, as the published loader uses them: what they cover is left out.
- Gaussians are opaque (opacity 1) discs on the surface, not optimized ones. `gs.npy` and the masks of a scene's
  lightings are one file with many names (hard links): copy with `cp -a`, `rsync -H` or `tar`.

## Assets

{credits}
"""


def write_readme(out: Path, address: str, records: Sequence[SceneRecord]) -> None:
    """Write `README.md`, with the credits that the assets' licences ask for."""
    credits = [credit for record in records for credit in record.assets]
    train = sum(record.split == "train" for record in records)
    text = TEXT.format(
        address=markdown(address), train=train, rest=len(records) - train, credits="\n".join(credit_lines(credits))
    )
    write_text(out / "README.md", text)
