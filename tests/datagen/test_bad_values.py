"""Every command with bad values of every kind: exit code 1 with one line, or 2; never a traceback."""

import itertools
import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from multilight.datagen import cli as generator
from multilight.datagen.cli import main
from multilight.model import cli as learner
from multilight.scenes.assets.library import AssetError, AssetLibrary

COMMANDS = generator.COMMANDS | learner.COMMANDS
NUMBERS = ("nan", "inf", "-inf", "-1", "0x10", "1e400", "99999999999999999999", "9" * 4000, "²", "", "true")
TEXTS = ("", "x" * 4000, "\x1b[31m", "²", "a\nb", "'; drop table x; --", "(" * 2000, "%s%n{0}")


def refused(capsys: pytest.CaptureFixture[str], *words: object, lines: int = 1) -> str:
    """Run a command that must fail, and return what it says on standard error."""
    capsys.readouterr()
    code = main([str(word) for word in words], COMMANDS)
    said = capsys.readouterr().err
    assert "Traceback" not in said
    assert code in (1, 2), words
    assert "error: " not in said or said.count("\n") <= lines, said  # without: tyro's box, of what is no number
    assert len(said) < 3000
    return said


DATASET = ("dataset", "--kind", "spheres", "--renderer", "analytic", "--out", "OUT")
INSERT = ("insert", "CAPTURE", "--asset", "builtin/die-01", "--frames", "0", "--side", "16", "--out", "OUT")
NUMERIC: dict[tuple[str, ...], tuple[str, ...]] = {
    DATASET: ("--seed", "--scenes", "--width", "--height", "--views", "--spp", "--workers"),
    ("scene", *DATASET[1:]): ("--index",),
    ("mix", "DATA", "--out", "OUT.png"): ("--scene", "--view"),
    ("sheet", "DATA", "--out", "OUT.png"): ("--scenes",),
    ("stats",): ("--sample",),
    ("pack", "DATA", "--out", "OUT"): ("--workers",),
    ("export", "dtc-multilight", "DATA", "--out", "OUT"): (
        "--conditions",
        "--exposures",
        "--size",
        "--map-size",
        "--workers",
    ),
    ("export", "webdataset", "DATA", "--out", "OUT"): ("--pairs", "--shard-mb"),
    ("export", "nerfstudio", "DATA", "--out", "OUT"): ("--conditions", "--points"),
    ("export", "usd", "DATA", "--out", "OUT"): ("--scene",),
    INSERT: ("--max-side", "--every", "--side", "--frames", "--seed", "--scale", "--yaw"),
    ("evaluate", "DATA", "--splits", "train", "--out", "OUT"): ("--groups", "--size", "--refine-iterations"),
    ("ablate", "head", "DATA", "--steps", "1", "--out", "OUT"): ("--seeds", "--size", "--batch", "--groups"),
    ("ablate", "head", "DATA", "--out", "OUT"): ("--minutes",),
    ("train", "TRAINING", "--out", "OUT"): ("--minutes",),
}


@pytest.fixture
def places(spheres_dataset: Path, capture_folders: dict[str, Path], tmp_path: Path) -> dict[str, str]:
    training = tmp_path / "training.toml"
    training.write_text(f'out = "{tmp_path}/t"\nsteps = 1\n[data]\ntrain = "{spheres_dataset}"\n')
    return {
        "DATA": str(spheres_dataset),
        "CAPTURE": str(capture_folders["nerfstudio"]),
        "OUT": str(tmp_path / "out"),
        "OUT.png": str(tmp_path / "out.png"),
        "TRAINING": str(training),
    }


def cases() -> Iterator[tuple[tuple[str, ...], str]]:
    for command, options in NUMERIC.items():
        yield from ((command, option) for option in options)


@pytest.mark.parametrize(
    ("command", "option"), list(cases()), ids=lambda v: v if isinstance(v, str) else "-".join(v[:2])
)
def test_numbers(
    command: tuple[str, ...], option: str, places: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    words = [places.get(word, word) for word in command]
    for value in NUMBERS:
        if option != "--yaw" or value not in ("-1", "99999999999999999999"):
            refused(capsys, *words, f"{option}={value}", lines=5)


def test_conditions_that_are_none(spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "m.png"
    for text in (*TEXTS[1:], *(f"random:{value}" for value in (*NUMBERS, *TEXTS, "٣"))):
        refused(capsys, "mix", spheres_dataset, "--out", out, "--condition", text)
    file = tmp_path / "c.json"
    good = {"name": "a", "gains": {}, "exposure_ev": 0.0}
    for change in (
        {"exposure_ev": 1e6},
        {"exposure_ev": -1e300},
        {"gains": {"sun": [1e300, 0, 0]}},
        {"gains": {"x": [0, 0, 0]}},
    ):
        file.write_text(json.dumps(good | change))
        assert "c.json" in refused(capsys, "mix", spheres_dataset, "--out", out, "--condition", file)
    for content in (b"", b"\xff", b"[" * 100_000, b'{"name":' + b"9" * 100_000 + b"}", b"null"):
        file.write_bytes(content)
        assert "c.json" in refused(capsys, "mix", spheres_dataset, "--out", out, "--condition", file)
    assert not out.exists()


def test_expressions_that_are_none(spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    more = (
        "1",
        "'a'",
        "index + 1",
        "*",
        "select 1",
        "index; index",
        "sum(",
        "not " * 900,
        "index = 1" + " or index = 1" * 20_000,
    )
    for text in (*TEXTS, *more):
        refused(capsys, "query", spheres_dataset, text)
        refused(capsys, "export", "nerfstudio", spheres_dataset, "--out", tmp_path / "e", "--where", text)
        refused(capsys, "query", spheres_dataset, "index = 0", "--columns", text)


def test_pictures_that_are_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good = tmp_path / "good.png"
    Image.fromarray(np.full((32, 32, 3), 255, np.uint8)).save(good)
    bad = {
        "cut.png": good.read_bytes()[:60],
        "empty.png": b"",
        "text.png": b"no picture",
        "empty.npy": b"",
        "program.eps": b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n(x) run\n",
    }
    for name, content in bad.items():
        (tmp_path / name).write_bytes(content)
    np.save(tmp_path / "words.npy", np.array(["a"]))
    np.save(tmp_path / "none.npy", np.zeros((0, 3), np.float32))
    files = dict.fromkeys(("composite", "background", "mask", "depth"), good)
    for role, name in itertools.product(files, (*bad, "words.npy", "none.npy", "missing.png", "")):
        words = [w for key, path in (files | {role: tmp_path / name}).items() for w in (f"--{key}", path)]
        refused(capsys, "harmonize", *words, "--out", tmp_path / "h.png")
    words = [w for key, path in files.items() for w in (f"--{key}", path)]
    for device in ("meta", "cuda:99", "", "x" * 4000, "cpu:-1"):
        refused(capsys, "harmonize", *words, "--out", tmp_path / "h.png", "--device", device)
    assert not (tmp_path / "h.png").exists()


CAMERAS: dict[str, tuple[object, ...]] = {
    "w": (0, -1, 1e308, float("inf"), float("nan"), "x", [], {}),
    "fl_x": (0, -1, float("inf"), float("nan"), "x", None),
    "camera_model": (0, "x", None),
    "frames": (0, None, [], [[]], [{}], "abc", {}),
    "ply_file_path": (0, "../x.ply", "none.ply", "/dev/zero", "images", "x" * 5000, "a\0b"),
    "file_path": (0, None, "../x.png", "/etc/passwd", "images", "x" * 5000, "a\0b", []),
    "transform_matrix": (0, None, [], [[0] * 4] * 4, [[float("nan")] * 4] * 4, [[1e308] * 4] * 4, "x"),
    "depth_file_path": (0, "../x.png", "none.png", "images", "x" * 5000, "a\0b"),
}


@pytest.mark.parametrize("key", CAMERAS)
def test_captures_that_are_none(
    key: str, capture_folders: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = shutil.copytree(capture_folders["nerfstudio"], tmp_path / "capture")
    good = json.loads((folder / "transforms.json").read_text())
    for value in CAMERAS[key]:
        changed = json.loads(json.dumps(good))
        for place in changed["frames"] if key in good["frames"][0] else [changed]:
            place[key] = value
        (folder / "transforms.json").write_text(json.dumps(changed))
        refused(
            capsys, *(str(folder) if word == "CAPTURE" else word for word in INSERT[:-1]), tmp_path / "out", lines=3
        )


def test_poses_and_gaussians_that_are_none(
    capture_folders: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [str(capture_folders["nerfstudio"]) if word == "CAPTURE" else word for word in INSERT[:-1]]
    file = tmp_path / "pose.json"
    for text in (
        *("", "[]", "null", "1 2", "{}", "nan " * 16, "0 " * 16, "1e200 " * 16, "[" * 100_000, '{"matrix": null}'),
        *('{"position": [1, 2]}', '{"position": ["a", 0, 0]}', '{"position": [0, 0, 0], "up": [0, 0, 0]}'),
        *(
            '{"position": [0, 0, 0], "scale": 0}',
            '{"position": [1e400, 0, 0]}',
            '{"position": [0, 0, 0], "yaw": 1e400}',
        ),
    ):
        file.write_text(text)
        assert "pose.json" in refused(capsys, *words, tmp_path / "out", "--pose", file)
    ply = tmp_path / "g.ply"
    head = b"ply\nformat binary_little_endian 1.0\nelement vertex "
    for content in (
        *(b"", b"ply\n", b"end_header\n", b"ply\nformat\nend_header\n", head[:-8] + b"\nend_header\n"),
        *(
            head + b"-1\nproperty float x\nend_header\n" + bytes(40),
            head + b"9" * 5000 + b"\nproperty float x\nend_header\n",
        ),
        *(head + b"1\nend_header\n", head + b"9999999999\nproperty float x\nend_header\n"),
    ):
        ply.write_bytes(content)
        assert "g.ply" in refused(capsys, *words, tmp_path / "out", "--gaussians", ply)
    refused(capsys, *words, tmp_path / "out", "--gaussians", "/dev/zero")


def test_tables_of_models_with_odd_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "models"
    folder.mkdir()
    for row in ("a\0b.glb", "x" * 5000 + ".glb", "..", "a\x1b.glb", "/dev/zero", ".", "CON:.glb"):
        (folder / "assets.csv").write_text(f"file\n{row}\n")
        said = refused(capsys, "assets", "check", folder)
        assert "assets.csv, line 2" in said or not said  # a broken model is named on standard output
    for column, value in itertools.product(("metres_per_unit", "up_axis", "role"), (*NUMBERS[:4], "0", "²")):
        (folder / "assets.csv").write_text(f"file,{column}\na.glb,{value}\n")
        with pytest.raises(AssetError, match=r"assets\.csv, line 2"):
            AssetLibrary(tmp_path / "cache", packs=(), folders=(folder,)).list("object")
    (folder / "assets.csv").write_bytes(b"\xff\xfe")
    with pytest.raises(AssetError, match=r"assets\.csv"):
        AssetLibrary(tmp_path / "cache", packs=(), folders=(folder,)).list("object")
