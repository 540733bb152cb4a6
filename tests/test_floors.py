"""The house: folders stand on floors, imports go down, and some pairs must never be."""

import ast
import graphlib
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "jexplore"
FLOORS = (
    {"config"},
    {"lazy", "rules"},
    {"arrays"},
    {"kernels", "tracemap", "users"},
    {"engine", "btm", "worlds", "planning", "report"},
    {"policies", "native", "extraction"},
    {"exploration", "driving"},
    {"studies"},
    {"bench", "learn"},
    {"cli"},
)
"""Folders and modules of the package, from the ground up; what stands on one floor does not know each other."""
KERNELS = {"grid", "distance", "raycast", "reach", "skeleton", "frontier", "gain", "segment", "rooms", "slam2d"}
NEVER = {
    **{("engine", other): "the engine runs any program" for other in ("kernels", "worlds", "planning")},
    **{(low, "report"): "only studies, benchmarks and commands show anything" for low in (
        "policies", "exploration", "driving", "extraction"
    )},
    **{("exploration", other): "a robot on a grid knows no vehicle" for other in ("btm", "tracemap")},
    ("driving", "planning"): "a vehicle knows no frontier",
    ("driving", "policies"): "a vehicle knows no frontier",
    ("extraction", "engine"): "reads finished maps",
}  # fmt: skip
"""(who, whom): why not."""
MOST = 12  # modules in a folder
LINES = 400  # of a module
SCREEN = 60  # lines of a function


def room_of(parts):
    """Return the room of a module: its folder; a top-level module's own name; the kernels together.

    Calls of native kernels stand with the kernels that make them.
    """
    return "kernels" if parts[0] in KERNELS or list(parts) == ["native", "kernels"] else parts[0]


def name_of(path):
    """Dotted name below the package; a folder's `__init__` is the folder."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


OUTSIDE = {PACKAGE / "__init__.py", PACKAGE / "__main__.py"}  # the first loads by name
FILES = sorted(path for path in PACKAGE.rglob("*.py") if path not in OUTSIDE)
NAMES = {name_of(path) for path in FILES}


def imported(tree, names):
    """Modules of this package that a syntax tree imports, those in functions included."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            found = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in found:
            if name.split(".")[0] == "jexplore":
                parts = name.split(".")[1:]
                while parts and ".".join(parts) not in names:
                    parts.pop()
                if not (PACKAGE / f"{name.split('.')[1]}.pyi").exists():  # a stub holds names, and is never run
                    yield ".".join(parts)


def faults(name, source, names=NAMES):
    """The imports of a module that go up, sideways, round, or where they never must."""
    floor = {room: i for i, rooms in enumerate(FLOORS) for room in rooms}
    own = room_of(name.split("."))
    for other in imported(ast.parse(source), names):
        room = room_of(other.split(".")) if other else "the package itself"
        if other == name or (room != own and not floor.get(room, len(FLOORS)) < floor[own]):
            yield f"{name} -> {other or room}"
        elif (own, room) in NEVER:
            yield f"{name} -> {other}: {NEVER[own, room]}"


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_imports_go_down(path):
    assert list(faults(name_of(path), path.read_text(encoding="utf-8"))) == []


def test_there_is_no_circle():
    graph = {name_of(path): set(imported(ast.parse(path.read_text(encoding="utf-8")), NAMES)) for path in FILES}
    assert len(list(graphlib.TopologicalSorter(graph).static_order())) >= len(FILES)


def test_every_room_has_a_floor_and_every_floor_its_rooms():
    rooms = {room_of(name.split(".")) for name in NAMES}
    assert rooms == set().union(*FLOORS)
    assert rooms >= {room for pair in NEVER for room in pair}
    assert NAMES >= KERNELS


def test_no_folder_is_a_heap():
    folders = [PACKAGE, *(path for path in PACKAGE.rglob("*") if path.is_dir() and path.name != "__pycache__")]
    count = {
        str(f.relative_to(PACKAGE)): len([p for p in f.glob("*.py") if not p.name.startswith("__")]) for f in folders
    }
    assert {name: n for name, n in count.items() if n > MOST} == {}


def test_modules_and_functions_fit_a_screen():
    long = {}
    for path in PACKAGE.rglob("*.py"):
        source = path.read_text(encoding="utf-8")
        if source.count("\n") > LINES:
            long[name_of(path)] = source.count("\n")
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.FunctionDef) and node.end_lineno - node.lineno + 1 > SCREEN:  # type: ignore[operator]
                long[f"{name_of(path)}.{node.name}"] = node.end_lineno - node.lineno + 1  # type: ignore[operator]
    assert long == {}


def test_the_test_finds_what_it_looks_for():
    names = {
        "config",
        "grid",
        "reach",
        "engine.runner",
        "engine.one_by_one",
        "exploration.site",
        "driving.vehicle",
        "report.plot",
        "cli",
    }
    for name, source, expected in [
        ("reach", "import jexplore.grid, jax", []),
        ("engine.one_by_one", "from jexplore import config\nfrom jexplore.engine import runner", []),
        ("engine.threads", "from jexplore.grid import x", ["engine.threads -> grid: the engine runs any program"]),
        ("exploration.site", "from jexplore.engine.one_by_one import x", []),
        ("exploration.site", "from jexplore.driving import vehicle", ["exploration.site -> driving.vehicle"]),
        ("exploration.site", "def f():\n    from jexplore.cli import x", ["exploration.site -> cli"]),
        ("driving.vehicle", "if TYPE_CHECKING:\n    from jexplore.report import plot",
         ["driving.vehicle -> report.plot: only studies, benchmarks and commands show anything"]),
        ("grid", "from jexplore import grid", ["grid -> grid"]),
        ("grid", "from jexplore import compare", ["grid -> the package itself"]),
    ]:  # fmt: skip
        assert list(faults(name, source, names)) == expected
