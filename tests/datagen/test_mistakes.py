"""Every command with the mistakes that people make: one line that names the value and the remedy, before any work."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from safetensors.numpy import save_file

from multilight.datagen import cli as generator
from multilight.datagen.cli import main
from multilight.model import cli as learner
from multilight.model.configs.stage3d import SLIM3D
from tests import ROOT
from tests.conftest import SPHERES

COMMANDS = generator.COMMANDS | learner.COMMANDS
PICTURES = "harmonize --composite WHITE --background WHITE --mask WHITE"
INSERT = "insert CAPTURE --asset builtin/die-01 --frames 0 --side 16"
EVALUATE = "evaluate DATA --splits train --size 32 --groups 1"
FOLDERS = (  # what writes a folder
    f"dataset {' '.join(SPHERES)} --scenes 1 --out",
    f"scene {' '.join(SPHERES)} --out",
    "stats DATA --out",
    "pack DATA --out",
    *(f"export {name} DATA --out" for name in ("usd", "webdataset", "nerfstudio", "colmap", "luxremix", "web")),
    "export dtc-multilight DATA --size 48 --out",
    "import usd STAGE --out",
    "merge DATA --out",
    "train TRAINING --out",
    f"{EVALUATE} --out",
    "ablate head DATA --splits train --steps 1 --size 32 --out",
    f"{INSERT} --out",
)
FILES = ("mix DATA --out", "sheet DATA --out", f"{PICTURES} --out")
READERS = (  # what reads a dataset
    *("status", "verify", "query", "stats", "view --no-open"),
    *(
        "mix --out O.png",
        "sheet --out O.png",
        "video --out O.mp4",
        "pack --out O",
        "evaluate --out O",
        "ablate head --out O",
    ),
    "export dtc-multilight --out O",
    "merge --out O",
    *(f"export {name} --out O" for name in ("usd", "webdataset", "nerfstudio", "colmap", "luxremix", "web")),
    "view --no-open",
    "train TRAINING --out O --data",
)
MISTAKES = {
    # commands, options and choices that are mistyped
    "datset": "no command 'datset'; did you mean 'dataset'?",
    "export nerfstudo DATA --out O": "did you mean 'nerfstudio'?",
    "mix DATA --uot O.png": "no option '--uot'; did you mean '--out'?",
    "export colmap DATA --out O --conditons 1": "did you mean '--conditions'?",
    "dataset --out O --kind rom": "did you mean 'room'?",
    "assets lst": "did you mean 'list'?",
    "ablate hed DATA --out O": "did you mean 'head'?",
    "config show rom": "did you mean 'room'?",
    "evaluate DATA --out O --splits trian": "did you mean 'train'?",
    "query DATA --columns lihgts": "did you mean 'lights'?",
    "query DATA kid='room'": "did you mean 'kind'?",
    "query DATA kind=room": "a text is quoted: 'room'",
    "train slm": "did you mean 'slim'?",
    "assets list bulitin": "did you mean 'builtin'?",
    # files that are not there, or are something else
    "dataset --out O --config NONE": "configuration file NONE does not exist",
    "dataset --out O --config DIR": "configuration file DIR cannot be read",
    "dataset --out O --kind custom --renderer analytic": "kind custom and background go together",
    "import usd DIR --out O": "DIR is not a file; name the stage of",
    "assets check DIR": "no model, sky or surface found in DIR",
    "harmonize --composite DIR --background WHITE --mask WHITE --out O.png": "DIR cannot be read: Is a directory",
    "evaluate DATA --out O --splits train --size 32 --lpips TEXT": "TEXT cannot be read as weights that torch saved",
    "verify TEXT": "TEXT/dataset.json cannot be read: Not a directory",
    "export nerfstudio DATA --out TEXT": "output folder TEXT cannot be written: it is a file, not a folder",
    "train TRAINING --out TEXT": "TEXT cannot be written: it is a file, not a folder",
    "import usd NONE --out O": "NONE does not exist",
    "import usd TEXT --out O": "TEXT cannot be read: it is damaged, or not what its name says",
    "assets check NONE": "is no file or folder that is there, nor an installed pack",
    "assets fetch mug": "no pack 'mug'",
    "stats http://localhost:1/x": "http://localhost:1/x/dataset.json cannot be read",
    "train TEXT": "TEXT cannot be read as TOML",
    "evaluate DATA --out O --weights NONE": "weights NONE do not exist; ready-made are: slim",
    "evaluate DATA --out O --weights TEXT": "weights TEXT cannot be read",
    "evaluate DATA --out O --weights OTHER": "weights OTHER name no network",
    "evaluate DATA --out O --weights STAGE3D": "of the 3D stage, those of the 2D stage are asked for",
    "evaluate DATA --out O --weights-3d slim": "of the 2D stage, those of the 3D stage are asked for",
    "evaluate DATA --out O --depth-model NONE": "--depth-model NONE does not exist",
    "evaluate DATA --out O --lpips DIR": "--lpips DIR is a folder; name a file",
    "evaluate --out O --owl DIR": "DIR is not Objects With Lighting",
    "evaluate --out O --foscom NONE": "NONE is not FOSCom",
    "ablate order DATA --out O --weights-2d STAGE3D": "of the 3D stage",
    f"{PICTURES} --out O.png --weights OTHER": "weights OTHER name no network",
    f"{PICTURES} --out O.png --depth NONE.npy": "depth NONE.npy does not exist",
    f"{PICTURES} --out O.png --depth-model TEXT": "depth model TEXT cannot be opened",
    "insert NONE --asset builtin/die-01 --out O": "capture NONE does not exist",
    "insert DIR --asset builtin/die-01 --out O": "DIR is no capture",
    "insert CAPTURE --asset mug --out O": "no asset 'mug': there is no pack 'mug'; `multilight assets list` shows all",
    "insert CAPTURE --asset builtin/mug --out O": "no asset 'builtin/mug'",
    "insert CAPTURE --asset NONE.glb --out O": "asset NONE.glb does not exist",
    "insert CAPTURE --asset TEXT --out O": "TEXT is not one of .glb, .gltf, .obj",
    "insert CAPTURE --asset BROKEN.glb --out O": "BROKEN.glb cannot be read: it is cut short",
    "insert CAPTURE --asset FACE.obj --out O": "FACE.obj has no faces",
    f"{INSERT} --out O --weights-3d slim": "of the 2D stage",
    f"{INSERT} --out O --pose NONE": "--pose NONE does not exist",
    f"{INSERT} --out O --gaussians NONE": "--gaussians NONE does not exist",
    # values that make no sense, alone or together
    "plan --minutes 0": "--minutes 0.0 must be more than 0",
    "plan --config NONE": "configuration file NONE does not exist",
    "status DATA --out O": "--out goes with --prometheus",
    "status DATA --json --prometheus": "give one of them",
    "merge --out O": "--parts: name one or more",
    "study": "name two folders and a page",
    "study DIR NONE --out O.html": "NONE is no folder",
    "study DIR DIR --out O.png": "DIR is named twice",
    "stats": "say which dataset to measure",
    "query DATA --columns": "--columns: name one or more",
    "evaluate DATA --out O --splits": "--splits: name one or more",
    "query DATA ;drop": "where ';drop': unable to parse ';drop'",
    "export colmap DATA --out O --conditions 99": "--conditions 99 must be 1 to 12, as many as scene 0 has",
    "sheet DATA --out O.txt": "the suffix must be",
    "video DATA --out O.gif": "the suffix must be .mp4 or .webp",
    "mix DATA --out O.txt": "O.txt",
    f"{PICTURES} --out O.txt": "no picture is written that ends in '.txt'; use .png or .jpg",
    "evaluate --out O": "say what to evaluate on",
    "evaluate DATA --out O --size 7": "--size 7 must be 16 to 4096",
    "evaluate DATA --out O --splits test": "no scene of test; its scenes are of train",
    "evaluate DATA --out O --device gpu": "--device gpu is no device; say auto, cpu",
    "evaluate DATA --out O --weights slim slim": "give one or more different files",
    "ablate head DATA --out O --size 7": "--size 7 must be 16 to 4096",
    "ablate order DATA --out O": "give --weights-2d slim",
    f"{INSERT} --out O --side 100": "--side 100 must be a power of two",
    f"{INSERT} --out O --device gpu": "--device gpu is no device",
    "insert CAPTURE --asset builtin/die-01 --out O --max-side 3": "--max-side 3 must be 16 to 8192",
    "train slim3d --data DATA --minutes 1 --out O --data NONE": "data.train: NONE/dataset.json is missing",
    "train UNSEEN": "has no scene of split 'test_ood'; set data.validation_split",
    **{
        f"export {name} DATA --out O --where index=77": "holds no finished scene for which index=77"
        for name in ("usd", "webdataset", "nerfstudio", "colmap", "luxremix", "web")
    },
}
KEYS = {  # of a training's configuration
    "networ = 'slim'": "unknown key 'networ'; did you mean 'network'?",
    "[data]\ntrane = 'x'": "did you mean 'data.train'?",
    "[[stages]]\nsiz = 3": "did you mean 'stages.size'?",
    "zzzz = 1": "known keys: out, ",
    "network = 'slm'": "there are slim, paper",
    "precision = 'fp16'": "precision = 'fp16': did you mean 'bf16'?",
    "seed = -1": "seed = -1",
}


@pytest.fixture
def places(spheres_dataset: Path, capture_folders: dict[str, Path], tmp_path: Path) -> dict[str, str]:
    """What the words in capitals stand for."""
    for name in ("train", "unseen"):
        split = "validation_split = 'test_ood'\n" if name == "unseen" else ""
        text = f'out = "{tmp_path}/t"\nsteps = 1\n[data]\ntrain = "{spheres_dataset}"\n{split}'
        (tmp_path / f"{name}.toml").write_text(text)
    Image.fromarray(np.full((32, 32, 3), 255, np.uint8)).save(tmp_path / "white.png")
    (tmp_path / "text").write_text("some text")
    (tmp_path / "stage.usda").write_text("#usda 1.0\n")
    (tmp_path / "broken.glb").write_bytes(b"glTF" + bytes(40))
    (tmp_path / "face.obj").write_text("v 0 0 0\nf 1 2 3\n")
    (tmp_path / "folder").mkdir()
    save_file({"w": np.zeros(2, np.float32)}, tmp_path / "other.safetensors")
    header = {"network": SLIM3D.canonical_json()}
    save_file({"w": np.zeros(2, np.float32)}, tmp_path / "3d.safetensors", metadata=header)
    return {
        "DATA": str(spheres_dataset),
        "CAPTURE": str(capture_folders["nerfstudio"]),
        **{word: str(tmp_path / word.lower()) for word in ("O", "O.png", "O.txt", "NONE", "NONE.glb", "NONE.npy")},
        **{word: str(tmp_path / word.lower()) for word in ("TEXT", "BROKEN.glb", "FACE.obj")},
        "DIR": str(tmp_path / "folder"),
        "WHITE": str(tmp_path / "white.png"),
        "STAGE": str(tmp_path / "stage.usda"),
        "TRAINING": str(tmp_path / "train.toml"),
        "UNSEEN": str(tmp_path / "unseen.toml"),
        "OTHER": str(tmp_path / "other.safetensors"),
        "STAGE3D": str(tmp_path / "3d.safetensors"),
    }


def refused(capsys: pytest.CaptureFixture[str], line: str, places: dict[str, str], *more: object) -> str:
    """Run a command line that must fail, and return what it says, its places named by their words again."""
    words = [places.get(word, word) for word in line.split()] + [str(word) for word in more]
    capsys.readouterr()
    code = main(words, COMMANDS)
    said = capsys.readouterr().err
    assert code in (1, 2), words
    assert "Traceback" not in said
    if "error: " not in said and "assets: " not in said:  # tyro's box
        return " ".join(said.replace("│", " ").split())
    (error,) = [told for told in said.splitlines() if told.startswith(("error: ", "assets: "))]
    for word, place in sorted(places.items(), key=lambda item: -len(item[1])):
        error = error.replace(place, word)
    return error


def command_of(line: str) -> str:
    return line.split()[0]


@pytest.mark.parametrize("line", MISTAKES)
def test_mistakes_are_told_with_the_remedy(
    line: str, places: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert MISTAKES[line] in refused(capsys, line, places)
    assert not any(Path(places[word]).is_file() for word in ("O", "O.png", "O.txt"))


@pytest.mark.parametrize("line", [*FOLDERS, *FILES])
def test_outputs_that_cannot_be_are_refused(
    line: str, places: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    suffix = ".png" if line in FILES else ""
    (tmp_path / "file").write_text("x")
    (tmp_path / "taken.png").mkdir()
    taken = tmp_path / ("taken.png" if suffix else "file")
    for out in (taken, tmp_path / f"file/x{suffix}", "/dev/full", f"/proc/x{suffix}", tmp_path / ("x" * 300 + suffix)):
        said = refused(capsys, line, places, out)
        assert str(out) in said or str(Path(out).parent) in said, (out, said)
    if line in FOLDERS:
        (tmp_path / "link").symlink_to(tmp_path / "nowhere" / "deep")
        refused(capsys, line, places, tmp_path / "link")
        assert not (tmp_path / "nowhere").exists()


@pytest.mark.parametrize("line", READERS)
def test_addresses_that_are_none_are_named(
    line: str, places: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("x")
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    for place in (
        *(tmp_path / name for name in ("file", "file/x", "link", "none")),
        "/dev/null",
        "s3://",
        "a://b",
        "::",
    ):
        assert len(refused(capsys, line, places, place)) < 700


@pytest.mark.parametrize("text", KEYS)
def test_keys_of_trainings(text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "t.toml"
    path.write_text(text if "[" in text else f'{text}\nout = "o"\nsteps = 1\n[data]\ntrain = "x"\n')
    assert KEYS[text] in refused(capsys, "train", {}, path)


def test_every_command_that_writes_is_tried() -> None:
    tried = {command_of(line) for line in (*FOLDERS, *FILES, *READERS, *MISTAKES)}
    assert tried - {"datset"} == set(COMMANDS) - {"doctor"}


LINES = """
import sys
from multilight.datagen import cli as generator
from multilight.model import cli as learner
for line in sys.stdin.read().splitlines():
    generator.main(line.split(), generator.COMMANDS | learner.COMMANDS)
    loaded = {"torch", "mitsuba", "bpy"} & set(sys.modules)
    assert not loaded, (line, loaded)
"""


def test_mistakes_load_neither_torch_nor_a_renderer(places: dict[str, str]) -> None:
    """But for those that reading a capture, another set or a model shows."""
    late = (" is no", ".glb cannot be read", ".obj has no faces", "that torch saved")
    mine = [line for line in MISTAKES if command_of(line) in learner.COMMANDS]
    ours = [line for line in mine if not any(words in MISTAKES[line] for words in late)]
    lines = [*ours, *(f"{line} /proc/x.png" for line in (*FOLDERS, *FILES))]
    text = "\n".join(" ".join(places.get(word, word) for word in line.split()) for line in lines)
    words = [sys.executable, "-c", LINES]
    done = subprocess.run(words, input=text, capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr[-2000:]
