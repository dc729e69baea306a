"""What happens when things go wrong: damage in every kind of file x every command, kills, full disks, closed streams.

    python -m tests.datagen.faults SEED [SEED ...]

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
from functools import partial
from pathlib import Path

import tyro
from rich.console import Console
from rich.table import Table

from multilight.datagen.cli import main as command_line

SETTINGS = "--kind spheres --renderer analytic --width 32 --height 32 --views 2 --spp 1"
SMALL = {
    "pack": "--workers 1",
    "dtc-multilight": "--size 32 --map-size 16 --workers 1 --conditions 1 --exposures 1",
    "webdataset": "--shard-mb 1",
    "nerfstudio": "--conditions 1",
    "colmap": "--conditions 1",
}
SCENES = 2
COPIES = ("pack", "webdataset", "nerfstudio", "colmap", "luxremix", "usd", "dtc-multilight", "web")
GOOD = ("found", "repaired", "refused", "rebuilt", "unread", "unseen", "-")
DATASET_FILES = ("dataset.json", "index.parquet") + tuple(
    f"scenes/000000/{name}" for name in ("scene.json", "views/00.exr", "preview.png")
)
ROOT = Path(__file__).parents[2]

Damage = Callable[[Path, random.Random], None]
Tree = dict[str, str]
Case = tuple[list[object], Path | None]
"""A command's words, and the file or folder that it writes."""


@dataclass(frozen=True)
class Ran:
    """How a command went: its exit code, what it said, and a hash of each file that it wrote."""

    code: int
    said: str
    output: Tree


@dataclass(frozen=True)
class Row:
    """A kind of file and of damage, and what came of it under each command."""

    file: str
    damage: str
    cells: dict[str, str]


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
    content = path.read_bytes()
    start = rng.randrange(len(content) // 2)
    length = rng.randrange(1, len(content) - start)
    changed = content[:start] + bytes(length) + content[start + length :]
    path.write_bytes(changed if changed != content else changed[:-1] + b"!")


def swap(path: Path, rng: random.Random) -> None:
    """Exchange a file with another of other content: of its own name if there is one, else of its own kind."""
    content = path.read_bytes()
    root = next(p for p in path.parents if (p / "dataset.json").exists() or (p / "manifest.json").exists())
    others = [p for p in files_in(root) if p.stat().st_size and p.read_bytes() != content]
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


DAMAGES: dict[str, Damage] = {damage.__name__: damage for damage in (flip, cut, empty, blank, swap, delete, extra)}


# --- commands ---


def run(case: Case) -> Ran:
    """Run a command in this process."""
    words, out = case
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


def process(words: list[object], before: str = "", after: str = "") -> "subprocess.CompletedProcess[str]":
    """Run a command in a shell of its own."""
    line = f"{before}{sys.executable} -m multilight {' '.join(map(str, words))} {after}; exit ${{PIPESTATUS[0]}}"
    return subprocess.run(["bash", "-c", line], cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)


def files_in(path: Path) -> list[Path]:
    """List a file, or every file under a folder but logs and hidden ones."""
    files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file())
    return [p for p in files if not p.name.startswith(".") and "logs" not in p.parts]


def tree(path: Path) -> Tree:
    """Hash a file, or the files under a folder, by name."""
    return {str(p.relative_to(path)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files_in(path)}


def sizes(root: Path) -> dict[str, int]:
    return {str(p.relative_to(root)): p.stat().st_size for p in root.rglob("*") if p.is_file()}


def readers(data: Path, out: Path) -> dict[str, Case]:
    """Return the commands that read a dataset."""
    cases: dict[str, Case] = {
        "query": (["query", data, "--json", "--columns", "all"], None),
        "mix": (["mix", data, "--out", out / "mix.exr", "--condition", "random:3"], out / "mix.exr"),
        "sheet": (["sheet", data, "--out", out / "sheet.png"], out / "sheet.png"),
        "stats": (["stats", data, "--out", out / "stats"], out / "stats" / "stats.json"),
    }
    for name in COPIES:
        words = ["pack"] if name == "pack" else ["export", name]
        cases[name] = [*words, data, "--out", out / name, *SMALL.get(name, "").split()], out / name
    return cases


def dataset(out: Path, *more: str, given: bool = True, scenes: int = SCENES) -> Case:
    """Return the command that makes or continues a dataset, its settings given or taken from there."""
    settings = ["--scenes", scenes, *SETTINGS.split()] if given else []
    return ["dataset", "--out", out, "--workers", "2", *settings, *more], out


# --- judging ---


def one_line(said: str) -> bool:
    """Tell whether a command failed with one line; progress, and what it passes over or counts, may come before."""
    lines = [line for line in said.splitlines() if line.strip()]
    errors = [line for line in lines if line.startswith("error:")]
    failed = [line for line in lines if line.startswith("failed: scene ")]  # one a scene
    return "Traceback" not in said and len(errors) + min(len(failed), 1) == 1 and lines[-1] in errors + failed


def failure(ran: Ran) -> str:
    """Say how a command failed, or nothing where it did not."""
    if "Traceback" in ran.said or ran.code not in (0, 1):
        return "TRACEBACK"
    return "" if ran.code == 0 else "refused" if one_line(ran.said) else "MANY LINES"


def judge_verify(ran: Ran, *, quick: bool, same_size: bool) -> str:
    if (failed := failure(ran)) == "TRACEBACK":
        return failed
    return "found" if failed else "unseen" if quick and same_size else "MISSED"


def judge_reader(ran: Ran, wanted: Ran) -> str:
    told, usual = ([line for line in r.said.splitlines() if line and "left" not in line] for r in (ran, wanted))
    if failed := failure(ran):
        return failed
    if ran.output != wanted.output:
        return "SILENT" if told == usual else "OTHER OUTPUT"
    return "unread" if told == usual else "rebuilt"


def judge_repair(ran: Ran, wanted: Tree, *, full: bool, same_size: bool) -> str:
    if (failed := failure(ran)) or ran.output == wanted:
        return failed or "repaired"
    if wanted.items() <= ran.output.items():
        return "unread"  # only something too much is left: nothing that others put there is removed
    return "unseen" if same_size and not full else "NOT REPAIRED"


# --- the table ---


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
        self.outputs = {name: run(case) for name, case in cases.items() if name not in COPIES or name in copies}
        self.copies: dict[str, Path] = {}
        for ran in self.outputs.values():
            _must(ran)
        for name in copies:
            self.copies[name] = (self.folder / "out" / name).rename(folder / f"copy-{name}")
            _must(run((["verify", self.copies[name]], None)))

    def fresh(self, name: str) -> Path:
        place = self.folder / name
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        return place

    def restore(self) -> None:
        """Put the dataset back as it was."""
        shutil.rmtree(self.place)
        shutil.copytree(self.sound, self.place)

    def damaged(self, original: Path, root: Path, name: str, damage: str, seed: str) -> bool:
        """Copy a folder and damage one file; tell whether names and sizes are as they were."""
        shutil.rmtree(root, ignore_errors=True)
        shutil.copytree(original, root)
        DAMAGES[damage](root / name, random.Random(f"{seed} {name} {damage}"))
        return sizes(root) == sizes(original)

    def dataset_row(self, name: str, damage: str, seed: str, chosen: Sequence[str] = ()) -> Row:
        """Damage a file of a dataset, and run the commands on it (all, or those chosen)."""
        root = self.place
        same = self.damaged(self.sound, root, name, damage, seed)

        def verified(*quick: str) -> str:
            ran = run((["verify", root, *quick], None))
            return judge_verify(ran, quick=bool(quick), same_size=same and name.endswith((".exr", ".png")))

        def read(command: str) -> str:
            return judge_reader(run(readers(root, self.folder / "out")[command]), self.outputs[command])

        def repaired(*full: str) -> str:
            self.damaged(self.sound, root, name, damage, seed)
            ran = run(dataset(root, *full, given=not full))
            return judge_repair(ran, self.wanted, full=bool(full), same_size=same)

        trials: dict[str, Callable[[], str]] = {"verify": verified, "verify --quick": partial(verified, "--quick")}
        trials |= {command: partial(read, command) for command in readers(root, self.fresh("out"))}
        trials |= {"dataset": repaired, "dataset --repair": partial(repaired, "--repair")}
        return Row(name, damage, {c: trial() for c, trial in trials.items() if not chosen or c in chosen})

    def copy_row(self, copy: str, name: str, damage: str, seed: str) -> Row:
        """Damage a file of a packed copy or an export, verify it, and go on with the command that made it."""
        root = self.folder / "out" / copy
        self.restore()
        same = self.damaged(self.copies[copy], root, name, damage, f"{seed} {copy}")
        cells = {
            " ".join(["verify", *quick]): judge_verify(
                run((["verify", root, *quick], None)), quick=bool(quick), same_size=same
            )
            for quick in ([], ["--quick"])
        }
        again = run(readers(self.place, self.folder / "out")[copy])
        cells["made again"] = judge_repair(again, tree(self.copies[copy]), full=False, same_size=same)
        return Row(f"{copy}: {name}", damage, cells)


def _must(ran: Ran) -> None:
    if ran.code:
        raise SystemExit(f"the bench cannot start: {ran.said}")


def copy_files(root: Path) -> list[str]:
    """Return the first file of each kind (suffix and depth) in a copy or an export."""
    found: dict[tuple[str, int], str] = {}
    for name in tree(root):
        found.setdefault((Path(name).suffix, name.count("/")), name)
    return list(found.values())


# --- kills, full disks, closed streams ---


def killed(bench: Bench, number: signal.Signals, group: bool, rng: random.Random, *, scenes: int = SCENES) -> str:
    """Send a signal at a random moment, continue, and compare with an undisturbed run."""
    root = bench.folder / "killed"
    shutil.rmtree(root, ignore_errors=True)
    case = dataset(root, scenes=scenes)
    words = [sys.executable, "-m", "multilight", *map(str, case[0])]
    started = subprocess.Popen(
        words, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    time.sleep(rng.uniform(0.3, 7.0))
    with contextlib.suppress(ProcessLookupError):
        (os.killpg if group else os.kill)(started.pid, number)
    try:
        _, said = started.communicate(timeout=60)
    except subprocess.TimeoutExpired:
        os.killpg(started.pid, signal.SIGKILL)
        return "HANGS"
    if number != signal.SIGKILL and "Traceback" in said and not group:
        return "TRACEBACK"
    deadline = time.monotonic() + 15
    while (ran := run(case)).code == 1 and "another process" in ran.said and time.monotonic() < deadline:
        time.sleep(0.5)  # a worker that has not yet noticed
    return judge_repair(ran, bench.wanted, full=True, same_size=False)


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
        case = readers(bench.place, out)[command] if command != "dataset" else dataset(out / "d")
        done = process(case[0], "" if disk else f"ulimit -f {kilobytes // 8}; ")
        if done.returncode == 0:
            return "unread"
        if not one_line(done.stderr):
            return "TRACEBACK" if "Traceback" in done.stderr else "MANY LINES"
        place = case[1]
        assert place is not None
        if list(out.rglob("*.tmp*")) or (command in ("mix", "sheet") and place.is_file()):
            return "LEFT CUT"  # of several files those that are there are whole
        if disk is None:
            return "refused"
        subprocess.run(["mount", "-o", "remount,size=200m", str(disk)], check=True)
        again = run(case)
        if again.code or (command in bench.copies and run((["verify", place], None)).code):
            return "NOT REPAIRED"
        if command == "dataset":
            return "repaired" if again.output == bench.wanted else "NOT REPAIRED"
        return "repaired" if again.output.keys() == bench.outputs[command].output.keys() else "NOT REPAIRED"


def closed_streams(bench: Bench, command: str, how: str) -> str:
    """Run a command with closed or full streams, or a reader that leaves."""
    bench.restore()
    out = bench.fresh("out")
    done = process((readers(bench.place, out)[command] if command != "dataset" else dataset(out / "d"))[0], after=how)
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
    return [f"{r.file}, {r.damage}, {c}: {cell}" for r in rows for c, cell in r.cells.items() if cell not in GOOD]


def print_table(title: str, rows: Sequence[Row]) -> None:
    """Print rows of files x damage with a column a command."""
    columns = dict.fromkeys(command for row in rows for command in row.cells)
    table = Table("file", "damage", *columns, title=title, box=None)
    for row in rows:
        table.add_row(row.file, row.damage, *(row.cells.get(column, "-") for column in columns))
    Console(width=250).print(table)


def main(seeds: tyro.conf.Positional[tuple[int, ...]], kills: int = 3) -> int:
    """Run the bench and return the exit code: 1 where a cell is bad.

    Args:
        seeds: each decides which bits, lengths, files and moments
        kills: of each kind and seed
    """
    faults: list[str] = []
    with tempfile.TemporaryDirectory(prefix="multilight-faults-") as folder:
        bench = Bench(Path(folder))
        for seed in seeds:
            rng = random.Random(seed)
            signals = [(s, group) for s in (signal.SIGKILL, signal.SIGTERM, signal.SIGINT) for group in (False, True)]
            written = ("dataset", "mix", "sheet", "stats", "pack", "webdataset", "nerfstudio", "dtc-multilight")
            hows = (">&-", "2>&-", ">&- 2>&- <&-", "| true", "2>&1 | true", ">/dev/full")
            tables: dict[str, Iterator[Row]] = {
                "dataset": (bench.dataset_row(name, damage, str(seed)) for name in DATASET_FILES for damage in DAMAGES),
                "copies and exports": (
                    bench.copy_row(copy, name, damage, str(seed))
                    for copy, root in bench.copies.items()
                    for name in copy_files(root)
                    for damage in DAMAGES
                ),
                "kills at random moments": (
                    Row(
                        s.name,
                        "group" if group else "driver",
                        {str(n): killed(bench, s, group, rng) for n in range(kills)},
                    )
                    for s, group in signals
                ),
                "full disks": (
                    Row("full disk", f"{size} kB", {c: full_disk(bench, c, size) for c in written})
                    for size in (rng.randrange(20, 120) for _ in range(2))
                ),
                "streams": (
                    Row(
                        "streams",
                        how,
                        {c: closed_streams(bench, c, how) for c in ("dataset", "query", "sheet", "pack")},
                    )
                    for how in hows
                ),
            }
            for title, rows in tables.items():
                print_table(f"{title}, seed {seed}", found := list(rows))
                faults += [f"seed {seed}: {fault}" for fault in bad(found)]
    print("\n".join(faults) or "every cell is as it must be")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(tyro.cli(main))
