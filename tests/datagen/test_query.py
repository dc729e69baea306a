"""Look-ups in the index."""

import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from multilight.datagen.cli import main
from multilight.datagen.errors import UserError
from multilight.datagen.storage.index import COLUMNS, index_row, index_table
from multilight.datagen.storage.open_dataset import open_dataset, select
from multilight.lights.photometry.angular_size import angular_diameter
from multilight.lights.spec import AreaLight, EmissiveLight, EnvironmentLight, PointLight, SunLight
from multilight.scenes.cameras.pinhole import look_at
from multilight.scenes.poses import matrix4

ROWS = pl.DataFrame(
    {
        "index": [0, 1, 2],
        "kind": ["room", "tabletop", "room"],
        "emissive": [True, True, False],
        "categories": [["vase", "mug"], ["box"], ["vase"]],
        "light_shares": [[0.7, 0.3], [0.4, 0.6], [1.0]],
        "hardest_deg": [0.5, None, 12.0],
    },
    schema_overrides={"light_shares": pl.List(pl.Float64)},
)


@pytest.mark.parametrize(
    ("where", "found"),
    [
        ("kind = 'room' and emissive", [0]),
        ("array_contains(categories, 'vase') and not emissive", [2]),
        ("array_length(categories) > 1", [0]),
        ("light_shares[1] > 0.5", [0, 2]),
        ("array_to_string(categories, ' ') like '%o%'", [1]),
        ("hardest_deg < 1 or hardest_deg is null", [0, 1]),
        ("kind in ('studio', 'tabletop')", [1]),
        ("index = 7", []),
    ],
)
def test_expressions(where: str, found: list[int]) -> None:
    assert select(ROWS, where)["index"].to_list() == found


@pytest.mark.parametrize("where", ["kind =", "colour = 'red'", "kind", "index = 1; drop table x", "", "nonsense(kind)"])
def test_bad_expressions_are_quoted_with_the_columns(where: str) -> None:
    with pytest.raises(UserError, match="multilight query DIR --describe` lists the columns") as caught:
        select(ROWS, where)
    assert repr(where) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_long_lists_of_numbers_are_understood_and_long_expressions_refused() -> None:
    assert select(ROWS, f"index IN ({', '.join(map(str, range(2, 10_000)))})")["index"].to_list() == [2]
    with pytest.raises(UserError, match=r"at most 4000 characters, lists of numbers aside"):
        select(ROWS, " or ".join(["index = 1"] * 1000))


def test_help_examples_are_understood() -> None:
    from multilight.datagen.commands.query import Query

    lines = [line.strip() for line in (Query.__doc__ or "").splitlines()]
    first = next(i for i, line in enumerate(lines) if line.startswith("Examples"))
    examples = [line for line in lines[first + 1 : -2] if line]
    assert len(examples) >= 5
    for example in examples:
        assert not len(select(index_table([]), example))


def test_command_prints_json_and_tables(spheres_dataset: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["query", str(spheres_dataset), "index = 1", "--json", "--columns", "index", "lights"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert row == {"index": 1, "lights": list(open_dataset(spheres_dataset).scene(1).rig.names)}
    assert main(["query", str(spheres_dataset)]) == 0
    assert "2 scenes" in capsys.readouterr().out
    assert main(["query", str(spheres_dataset), "kind = 'room'"]) == 1
    assert main(["query", str(spheres_dataset), "--columns", "colour"]) == 1
    assert "no column colour" in capsys.readouterr().err
    assert main(["query", str(spheres_dataset), "--describe"]) == 0
    shown = capsys.readouterr().out
    assert all(name in shown for name in COLUMNS)


def test_rows_say_what_the_scene_is(spheres_dataset: Path) -> None:
    source = open_dataset(spheres_dataset)
    assert source.table.columns == list(COLUMNS)
    for record in source.scenes():
        row = index_row(record)
        assert set(row) == set(COLUMNS)
        # The shares, once more from the layers themselves: nothing here is denoised.
        means = {
            name: np.mean([
                source.view(record, v).variants["all"][source.view(record, v).lights.index(name)].mean(dtype=np.float64)
                for v in range(len(record.views))
            ])
            for name in record.rig.names
        }  # fmt: skip
        shares = np.array([means[name] for name in record.rig.names]) / sum(means.values())
        np.testing.assert_allclose(row["light_shares"], shares, atol=2e-3)
        others = 1.0 - shares.max()
        assert row["contrast_ev"] == pytest.approx(np.log2(shares.max() / others), abs=0.05)


def test_a_single_light_has_no_contrast(spheres_dataset: Path) -> None:
    record = open_dataset(spheres_dataset).scene(0)
    first = record.rig.names[0]
    rig = record.rig.model_copy(update={"lights": record.rig.lights[:1]})
    row = index_row(record.model_copy(update={"rig": rig}))
    assert row["lights"] == [first]
    assert row["light_shares"] == [1.0]
    assert row["contrast_ev"] is None


def test_angular_diameters() -> None:
    here = (0.0, 0.0, 0.0)
    bulb = PointLight(name="bulb", position=(0, 0, 2), intensity=(1, 1, 1), radius=0.5)
    assert angular_diameter(bulb, here) == pytest.approx(2 * np.arctan(0.25))
    assert angular_diameter(SunLight(name="sun", direction=(0, 0, -1), irradiance=(1, 1, 1), angle=0.02), here) == 0.02
    pose = matrix4(look_at((0, 0, 3), here, up=(0, 1, 0)))
    disk = AreaLight(name="a", shape="disk", width=2, height=2, world_from_light=pose, radiance=(1, 1, 1))
    assert angular_diameter(disk, here) == pytest.approx(2 * np.arctan(1 / 3))
    aside = matrix4(look_at((0, 0, 3), (3, 0, 3), up=(0, 1, 0)))
    assert angular_diameter(disk.model_copy(update={"world_from_light": aside}), here) == pytest.approx(0, abs=1e-7)
    assert angular_diameter(EnvironmentLight(name="e"), here) is None
    assert angular_diameter(EmissiveLight(name="g", body="lamp", radiance=(1, 1, 1)), here) is None
