"""What happens when things go wrong: damage in every kind of file x every command, kills, full disks, closed streams.

    python -m benchmarks.faults SEED [SEED ...]

Makes small closed-form datasets, copies and exports, damages one file at a time, and runs each command on what is left.
Every cell of the table must be one of

    found      verify says so, with exit code 1
    repaired   the dataset has again the bytes that an undisturbed run gives
    refused    exit code 1 and one line
    rebuilt    what was damaged is made up from the rest, and told; the output is that of the undamaged dataset
    unread     the damage lies in what the command does not read: its output is that of the undamaged dataset
    unseen     the damage leaves names and sizes as they were, and the command looks at no more than these

Anything else (a traceback, silence and another output) is printed in capitals, and the exit code is 1.
"""

import argparse
import contextlib
import hashlib
import io
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from multilight.datagen.cli import main as command_line

SETTINGS = ["--kind", "spheres", "--renderer", "analytic", "--width", "32", "--height", "32"]
SETTINGS += ["--views", "2", "--spp", "1"]
SMALL = {
    "dtc-multilight": ("--size", "32", "--map-size", "16", "--workers", "1", "--conditions", "1", "--exposures", "1"),
    "webdataset": ("--shard-mb", "1"),
    "nerfstudio": ("--conditions", "1"),
    "colmap": ("--conditions", "1"),
}
SCENES = 2
COPIES = ("pack", "webdataset", "nerfstudio", "colmap", "luxremix", "usd", "dtc-multilight")
GOOD = ("found", "repaired", "refused", "rebuilt", "unread", "unseen", "-")
ROOT = Path(__file__).parent.parent

Damage = Callable[[Path, random.Random], None]
Tree = dict[str, str]


@dataclass(frozen=True)
class Ran:
    """How a command went: its exit code, what it said, and a hash of each file that it wrote."""

    code: int
    said: str
    output: Tree


# --- damage ---


def flip(path: Path, rng: random.Random) -> None:
    """Flip one bit."""
    content = bytearray(path.read_bytes())
    content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    path.write_bytes(content)


def cut(path: Path, rng: random.Random) -> None:
    """Leave out the end."""
    content = path.read_bytes()
    path.write_bytes(content[: rng.randrange(1, len(content))])


def empty(path: Path, rng: random.Random) -> None:
    """Leave nothing."""
    path.write_bytes(b"")


def blank(path: Path, rng: random.Random) -> None:
    """Fill a part with zeros, as a failing disk does."""
    content = bytearray(path.read_bytes())
    start = rng.randrange(len(content) // 2)
    length = rng.randrange(1, len(content) - start)
    changed = content[:start] + bytes(length) + content[start + length :]
    path.write_bytes(changed if changed != content else changed[:-1] + b"!")


def swap(path: Path, rng: random.Random) -> None:
    """Exchange a file with another of other content: of its own name if there is one, else of its own kind."""
    content = path.read_bytes()
    others = [
        p for p in sorted(_root(path).rglob("*")) if p.is_file() and p.stat().st_size and p.read_bytes() != content
    ]
    others = [p for p in others if not p.name.startswith(".")]
    alike = [p for p in others if p.name == path.name] or [p for p in others if p.suffix == path.suffix] or others
    other = rng.choice(alike)
    path.write_bytes(other.read_bytes())
    other.write_bytes(content)


def delete(path: Path, rng: random.Random) -> None:
    """Remove the file."""
    path.unlink()


def extra(path: Path, rng: random.Random) -> None:
    """Add a copy beside the file under another name; beside dataset.json users may keep what they like."""
    folder = path.parent / "scenes" if path.name in ("dataset.json", "index.parquet") else path.parent
    shutil.copyfile(path, (folder if folder.is_dir() else path.parent) / f"{path.stem}7{path.suffix}")


def _root(path: Path) -> Path:
    return next(
        folder for folder in path.parents if (folder / "dataset.json").exists() or (folder / "manifest.json").exists()
    )


DAMAGES: dict[str, Damage] = {damage.__name__: damage for damage in (flip, cut, empty, blank, swap, delete, extra)}


# --- commands ---


def run(words: Sequence[object], out: Path | None = None) -> Ran:
    """Run a command in this process; `out` is the file or folder that it writes."""
    said, shown = io.StringIO(), io.StringIO()
    code = -1
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(shown):
            code = command_line([str(word) for word in words])
    except SystemExit as stop:
        code = int(stop.code or 0)
    except Exception as error:  # a fault of the program, which the command line lets through
        said.write(f"Traceback: {type(error).__name__}: {error}\n")
    output = tree(out) if out is not None else {"": hashlib.sha256(shown.getvalue().encode()).hexdigest()}
    return Ran(code, said.getvalue() + (shown.getvalue() if code and not said.getvalue() else ""), output)


def tree(path: Path) -> Tree:
    """Hash a file, or every file under a folder but logs and locks, by name."""
    files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file())
    kept = [p for p in files if not p.name.startswith(".") and "logs" not in p.parts]
    return {str(p.relative_to(path)): hashlib.sha256(p.read_bytes()).hexdigest() for p in kept}


def readers(data: Path, out: Path) -> dict[str, tuple[list[object], Path | None]]:
    """Return the commands that read a dataset: their words and what they write."""
    return {
        "query": (["query", data, "--json", "--columns", "all"], None),
        "mix": (["mix", data, "--out", out / "mix.exr", "--condition", "random:3"], out / "mix.exr"),
        "sheet": (["sheet", data, "--out", out / "sheet.png"], out / "sheet.png"),
        "stats": (["stats", data, "--out", out / "stats"], out / "stats" / "stats.json"),
        "pack": (["pack", data, "--out", out / "packed", "--workers", "1"], out / "packed"),
    } | {name: (["export", name, data, "--out", out / name, *SMALL.get(name, ())], out / name) for name in COPIES[1:]}


def dataset(out: Path, scenes: int | None = SCENES, *more: str) -> list[object]:
    """Return the words that make or continue a dataset."""
    given = [] if scenes is None else ["--scenes", scenes, *SETTINGS]
    return ["dataset", "--out", out, "--workers", "2", *given, *more]


# --- judging ---


def one_line(said: str) -> bool:
    """Tell whether a command failed with one line; progress, and what it passes over or counts, may come before."""
    lines = [line for line in said.splitlines() if line.strip()]
    errors = [line for line in lines if line.startswith("error:")]
    failed = [line for line in lines if line.startswith("failed: scene ")]  # one a scene
    return "Traceback" not in said and len(errors) + min(len(failed), 1) == 1 and lines[-1] in errors + failed


def judge_verify(ran: Ran, *, quick: bool, same_size: bool) -> str:
    if "Traceback" in ran.said or ran.code not in (0, 1):
        return "TRACEBACK"
    if ran.code == 1:
        return "found"
    return "unseen" if quick and same_size else "MISSED"


def judge_reader(ran: Ran, wanted: Ran) -> str:
    if "Traceback" in ran.said or ran.code not in (0, 1):
        return "TRACEBACK"
    if ran.code == 1:
        return "refused" if one_line(ran.said) or ran.said == wanted.said else "MANY LINES"
    if ran.output != wanted.output:
        return "SILENT" if _messages(ran) == _messages(wanted) else "OTHER OUTPUT"
    return "unread" if _messages(ran) == _messages(wanted) else "rebuilt"


def _messages(ran: Ran) -> list[str]:
    return [line for line in ran.said.splitlines() if line and "left" not in line]


def judge_repair(ran: Ran, root: Path, wanted: Tree, *, full: bool, same_size: bool) -> str:
    if "Traceback" in ran.said or ran.code not in (0, 1):
        return "TRACEBACK"
    if ran.code == 1:
        return "refused" if one_line(ran.said) else "MANY LINES"
    got = tree(root)
    if got == wanted:
        return "repaired"
    if wanted.items() <= got.items():
        return "unread"  # only something too much is left: nothing that others put there is removed
    return "unseen" if same_size and not full else "NOT REPAIRED"


# --- the table ---


@dataclass(frozen=True)
class Row:
    """A kind of file and of damage, and what came of it under each command."""

    file: str
    damage: str
    cells: dict[str, str]


class Bench:
    """Sound datasets, copies and exports in a folder, and what commands make of damaged ones."""

    def __init__(self, folder: Path, copies: Sequence[str] = COPIES) -> None:
        self.folder = folder
        self.sound, self.place = folder / "sound", folder / "set"
        _must(run(dataset(self.place)))
        shutil.copytree(self.place, self.sound)
        self.wanted = tree(self.sound)
        # Outputs may name the dataset that they were made of, so it always lies in the same place.
        cases = readers(self.place, self.fresh("out"))
        self.outputs = {name: run(*case) for name, case in cases.items() if name not in COPIES or name in copies}
        self.copies: dict[str, Path] = {}
        for ran in self.outputs.values():
            _must(ran)
        for name in copies:
            _, place = cases[name]
            assert place is not None
            self.copies[name] = place.rename(folder / f"copy-{name}")
            _must(run(["verify", self.copies[name]]))

    def fresh(self, name: str) -> Path:
        place = self.folder / name
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        return place

    def restore(self) -> None:
        """Put the dataset back as it was."""
        shutil.rmtree(self.place)
        shutil.copytree(self.sound, self.place)

    def damaged(self, original: Path, root: Path, name: str, damage: str, rng: random.Random) -> bool:
        """Copy a folder and damage one file; tell whether names and sizes are as they were."""
        shutil.rmtree(root, ignore_errors=True)
        shutil.copytree(original, root)
        DAMAGES[damage](root / name, rng)
        return _sizes(root) == _sizes(original)

    def dataset_row(self, name: str, damage: str, seed: str, chosen: Sequence[str] | None = None) -> Row:
        """Damage a file of a dataset, and run the commands on it (all, or those chosen)."""
        cells: dict[str, str] = {}

        def anew() -> bool:
            return self.damaged(self.sound, self.place, name, damage, random.Random(f"{seed} {name} {damage}"))

        root, same = self.place, anew()
        for command, quick in (("verify", False), ("verify --quick", True)):
            if chosen is None or command in chosen:
                ran = run(["verify", root, *(["--quick"] if quick else [])])
                cells[command] = judge_verify(ran, quick=quick, same_size=same and name.endswith((".exr", ".png")))
        for command, case in readers(root, self.fresh("out")).items():
            if chosen is None or command in chosen:
                cells[command] = judge_reader(run(*case), self.outputs[command])
        for command, full in (("dataset", False), ("dataset --repair", True)):
            if chosen is None or command in chosen:
                anew()
                ran = run(dataset(root, None, "--repair") if full else dataset(root))
                cells[command] = judge_repair(ran, root, self.wanted, full=full, same_size=same)
        return Row(name, damage, cells)

    def copy_row(self, copy: str, name: str, damage: str, seed: str) -> Row:
        """Damage a file of a packed copy or an export, verify it, and go on with the command that made it."""
        rng = random.Random(f"{seed} {copy} {name} {damage}")
        words, root = readers(self.place, self.folder / "out")[copy]
        assert root is not None
        self.restore()
        same = self.damaged(self.copies[copy], root, name, damage, rng)
        cells = {
            "verify": judge_verify(run(["verify", root]), quick=False, same_size=same),
            "verify --quick": judge_verify(run(["verify", root, "--quick"]), quick=True, same_size=same),
        }
        cells["made again"] = judge_repair(run(words), root, tree(self.copies[copy]), full=False, same_size=same)
        return Row(f"{copy}: {name}", damage, cells)


def _must(ran: Ran) -> None:
    if ran.code:
        raise SystemExit(f"the bench cannot start: {ran.said}")


def _sizes(root: Path) -> dict[str, int]:
    return {str(p.relative_to(root)): p.stat().st_size for p in root.rglob("*") if p.is_file()}


DATASET_FILES = (
    "dataset.json",
    "index.parquet",
    "scenes/000000/scene.json",
    "scenes/000000/views/00.exr",
    "scenes/000000/preview.png",
)


def copy_files(root: Path) -> list[str]:
    """Return the first file of each kind (suffix and depth) in a copy or an export."""
    found: dict[tuple[str, int], str] = {}
    for name in sorted(_sizes(root)):
        if not Path(name).name.startswith("."):
            found.setdefault((Path(name).suffix, name.count("/")), name)
    return list(found.values())


# --- kills, full disks, closed streams ---


def killed(bench: Bench, number: signal.Signals, group: bool, rng: random.Random, *, scenes: int = SCENES) -> str:
    """Send a signal at a random moment, continue, and compare with an undisturbed run."""
    root = bench.folder / "killed"
    shutil.rmtree(root, ignore_errors=True)
    words = [sys.executable, "-m", "multilight", *map(str, dataset(root, scenes))]
    process = subprocess.Popen(
        words, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    time.sleep(rng.uniform(0.3, 7.0))
    with contextlib.suppress(ProcessLookupError):
        (os.killpg if group else os.kill)(process.pid, number)
    try:
        _, said = process.communicate(timeout=60)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        return "HANGS"
    if number != signal.SIGKILL and "Traceback" in said and not group:
        return "TRACEBACK"
    deadline = time.monotonic() + 15
    while (
        (ran := run(dataset(root, scenes))).code == 1 and "another process" in ran.said and time.monotonic() < deadline
    ):
        time.sleep(0.5)  # a worker that has not yet noticed
    return judge_repair(ran, root, bench.wanted, full=True, same_size=False)


@contextlib.contextmanager
def small_disk(folder: Path, size: str) -> Iterator[Path | None]:
    """Mount a small file system, where that is allowed; else yield None."""
    folder.mkdir(exist_ok=True)
    words = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)]
    if shutil.which("mount") is None or subprocess.run(words, capture_output=True, check=False).returncode:
        yield None
        return
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def full_disk(bench: Bench, command: str, kilobytes: int) -> str:
    """Run a command on a disk that fills up, or, where none can be mounted, with a limit on the size of files."""
    bench.restore()
    with small_disk(bench.folder / "disk", f"{kilobytes}k") as disk:
        out = disk or bench.fresh("out")
        case, place = readers(bench.place, out)[command] if command != "dataset" else (dataset(out / "d"), out / "d")
        limit = "" if disk else f"ulimit -f {kilobytes // 8}; "
        line = " ".join([sys.executable, "-m", "multilight", *map(str, case)])
        done = subprocess.run(
            ["bash", "-c", limit + line], cwd=ROOT, capture_output=True, text=True, timeout=300, check=False
        )
        if done.returncode == 0:
            return "unread"
        if not one_line(done.stderr):
            return "TRACEBACK" if "Traceback" in done.stderr else "MANY LINES"
        assert place is not None
        if list(out.rglob("*.tmp*")) or (command in ("mix", "sheet") and place.is_file()):
            return "LEFT CUT"  # of several files those that are there are whole
        if disk is None:
            return "refused"
        subprocess.run(["mount", "-o", "remount,size=200m", str(disk)], check=True)
        again = run(case, place)
        if again.code or (command in bench.copies and run(["verify", place]).code):
            return "NOT REPAIRED"
        wanted = bench.wanted if command == "dataset" else bench.outputs[command].output
        same = tree(place) == wanted if command == "dataset" else again.output.keys() == wanted.keys()
        return "repaired" if same else "NOT REPAIRED"


def closed_streams(bench: Bench, command: str, how: str) -> str:
    """Run a command with closed or full streams, or a reader that leaves."""
    bench.restore()
    out = bench.fresh("out")
    case, _ = readers(bench.place, out)[command] if command != "dataset" else (dataset(out / "d"), None)
    line = " ".join([sys.executable, "-m", "multilight", *map(str, case)])
    done = subprocess.run(
        ["bash", "-c", f"{line} {how}; exit ${{PIPESTATUS[0]}}"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    if "Traceback" in done.stderr or "Exception" in done.stderr:
        return "TRACEBACK"
    if how == ">/dev/full" and done.returncode == 1:
        return "refused" if one_line(done.stderr) else "MANY LINES"
    if done.returncode not in (0, 128 + signal.SIGPIPE):
        return f"EXIT {done.returncode}"
    made = command != "dataset" or how == "2>&1 | true" or tree(out / "d") == bench.wanted
    return "unread" if made else "SCENES FAILED"


# --- printing ---


def bad(rows: Sequence[Row]) -> list[str]:
    """List the cells that are not as they must be."""
    return [
        f"{row.file}, {row.damage}, {command}: {cell}"
        for row in rows
        for command, cell in row.cells.items()
        if cell not in GOOD
    ]


def print_table(title: str, rows: Sequence[Row]) -> None:
    """Print rows of files x damage with a column a command."""
    columns = list(dict.fromkeys(command for row in rows for command in row.cells))
    names = [f"{row.file}  {row.damage}" for row in rows]
    wide = max(map(len, [*names, title]))
    widths = [max(len(c), *(len(row.cells.get(c, "-")) for row in rows)) for c in columns]
    print(title.ljust(wide), *(c.ljust(w) for c, w in zip(columns, widths, strict=True)), sep="  ")
    for name, row in zip(names, rows, strict=True):
        print(
            name.ljust(wide), *(row.cells.get(c, "-").ljust(w) for c, w in zip(columns, widths, strict=True)), sep="  "
        )
    print(flush=True)


def main() -> int:
    """Run the bench and return the exit code: 1 where a cell is bad."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("seeds", type=int, nargs="+", help="each decides which bits, lengths, files and moments")
    parser.add_argument("--kills", type=int, default=3, help="kills of each kind and seed (default 3)")
    given = parser.parse_args()
    faults: list[str] = []
    with tempfile.TemporaryDirectory(prefix="multilight-faults-") as folder:
        bench = Bench(Path(folder))
        for seed in given.seeds:
            rows = [bench.dataset_row(name, damage, str(seed)) for name in DATASET_FILES for damage in DAMAGES]
            print_table(f"dataset, seed {seed}", rows)
            copies = [
                bench.copy_row(copy, name, damage, str(seed))
                for copy, root in bench.copies.items()
                for name in copy_files(root)
                for damage in DAMAGES
            ]
            print_table(f"copies and exports, seed {seed}", copies)
            rng = random.Random(seed)
            kills = [
                Row(
                    number.name,
                    "whole group" if group else "driver",
                    {f"{n + 1}": killed(bench, number, group, rng) for n in range(given.kills)},
                )
                for number in (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
                for group in (False, True)
            ]
            print_table(f"kills at random moments, seed {seed}", kills)
            sizes = [rng.randrange(20, 120) for _ in range(2)]
            commands = ("dataset", "mix", "sheet", "stats", "pack", "webdataset", "nerfstudio", "dtc-multilight")
            disks = [Row("full disk", f"{size} kB", {c: full_disk(bench, c, size) for c in commands}) for size in sizes]
            print_table(f"full disks, seed {seed}", disks)
            hows = (">&-", "2>&-", ">&- 2>&- <&-", "| true", "2>&1 | true", ">/dev/full")
            streams = [
                Row("streams", how, {c: closed_streams(bench, c, how) for c in ("dataset", "query", "sheet", "pack")})
                for how in hows
            ]
            print_table(f"streams, seed {seed}", streams)
            faults += [f"seed {seed}: {fault}" for fault in bad([*rows, *copies, *kills, *disks, *streams])]
    print("\n".join(faults) or "every cell is as it must be")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
