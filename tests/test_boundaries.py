"""Who may import what: the source is read and held against the table in ARCHITECTURE.md."""

import ast
import re
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from tests import ROOT

ROOMS = ("scenes", "lights", "datagen", "model")
FENCED = {"bpy", "mathutils", "mitsuba", "drjit", "pxr", "torch"}


def import_table() -> dict[str, set[str]]:
    """Read the table: folder or file → the third-party modules and rooms it may import."""
    text = (ROOT / "ARCHITECTURE.md").read_text()
    section = text.split("<!-- import table -->")[1].split("<!-- end of import table -->")[0]
    rows = re.findall(r"^\| `([^`]+)` \|[^|]*\|([^|]*)\|$", section, flags=re.MULTILINE)
    return {place.rstrip("/"): set(re.findall(r"`([^`]+)`", allowed)) for place, allowed in rows}


def sources() -> list[Path]:
    return [
        *sorted(p for room in ROOMS for p in (ROOT / room).rglob("*.py")),
        *sorted((ROOT / "multilight").glob("*.py")),
    ]


def imports_of(path: Path) -> set[str]:
    """List the full names of all imported modules, wherever in the file the import stands."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def places_of(path: Path, table: dict[str, set[str]]) -> list[str]:
    relative = path.relative_to(ROOT).as_posix()
    return [place for place in table if relative == place or relative.startswith(place + "/")]


def test_table_names_every_source() -> None:
    table = import_table()
    assert set(ROOMS) - {"model"} <= set(table)
    homeless = [str(path.relative_to(ROOT)) for path in sources() if not places_of(path, table)]
    assert not homeless


@pytest.mark.parametrize("path", sources(), ids=lambda p: p.relative_to(ROOT).as_posix())
def test_imports_stay_inside_the_table(path: Path) -> None:
    table = import_table()
    allowed = set().union(*(table[place] for place in places_of(path, table)))
    standard = set(sys.stdlib_module_names)
    for name in imports_of(path):
        top, _, rest = name.partition(".")
        if top == "multilight" and rest:
            top = rest.split(".")[0]
        if top in standard:
            continue
        assert top in allowed, f"{path.relative_to(ROOT)} imports {name}; ARCHITECTURE.md allows {sorted(allowed)}"


def test_only_the_room_of_a_renderer_imports_it() -> None:
    table = import_table()
    for module in FENCED:
        holders = [place for place, allowed in table.items() if module in allowed]
        assert len(holders) <= 2, f"{module} may be imported in {holders}"


def test_no_circle_between_folders() -> None:
    """Each folder of a room, and each file that lies loose in one, comes before all that import it."""
    homes = {}
    for path in sources():
        parts = path.relative_to(ROOT).with_suffix("").parts
        name = ".".join(("multilight", *(part for part in parts if part not in ("multilight", "__init__"))))
        homes[name] = home_of(path)
    needs = {
        home: {homes[name] for path in sources() if home_of(path) == home for name in imports_of(path) if name in homes}
        for home in set(homes.values())
    }
    TopologicalSorter({home: needed - {home} for home, needed in needs.items()}).prepare()


def home_of(path: Path) -> str:
    return "/".join(path.relative_to(ROOT).with_suffix("").parts[:2])


def test_readers_do_not_import_makers() -> None:
    makers = ("multilight.datagen.backends.", "multilight.datagen.production")
    for reader in ("storage", "tuples", "verification"):
        for path in (ROOT / "datagen" / reader).glob("*.py"):
            named = imports_of(path)
            assert not [n for n in named if n.startswith(makers)], path


def test_light_imports_start_no_renderer() -> None:
    code = (
        "import sys, multilight.scenes.spec, multilight.lights.spec, multilight.lights.relight\n"
        "import multilight.datagen.storage.store, multilight.datagen.tuples.compose, multilight.datagen.cli\n"
        f"print(sorted(set({sorted(FENCED)}) & set(sys.modules)))"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert shown.stdout.strip() == "[]"


def test_help_is_light() -> None:
    code = (
        "import sys\nfrom multilight.datagen.cli import main\n"
        "main(['--help'])\n"
        f"bad = set({sorted(FENCED | {'OpenEXR', 'colour', 'trimesh'})}) & set(sys.modules)\n"
        "sys.exit(f'{sorted(bad)}' if bad else 0)"
    )
    subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, cwd=ROOT)


def test_errors_have_one_root() -> None:
    loose = {"Exception", "RuntimeError", "ValueError", "OSError", "KeyError", "TypeError"}
    for path in set(sources()) - {ROOT / "scenes" / "errors.py"}:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef) and node.name.endswith("Error"):
                bases = {base.id for base in node.bases if isinstance(base, ast.Name)}
                assert not bases <= loose, f"{path.relative_to(ROOT)}: {node.name} derives from {sorted(bases)} alone"
