"""Imports go strictly downward: no module knows one above it or beside it."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "jexplore"

FLOORS = {
    "config": 0,
    "bits": 0,
    "btm_map": 1,
    "control": 0,
    "grid": 1,
    "sparse": 1,
    "distance": 2,
    "raycast": 2,
    "reach": 2,
    "skeleton": 3,
    "frontier": 3,
    "gain": 3,
    "robot": 3,
    "world": 3,
    "segment": 4,
    "navigate": 4,
    "worlds": 5,
    "policies": 5,
    "episode": 6,
    "mesh": 0,
    "papers": 0,
    "lanes": 7,
    "site": 7,
    "measure": 7,
    "stats": 7,
    "scores": 7,
    "store": 7,
    "standings": 8,
    "cores": 0,
    "serial": 8,
    "lockstep": 8,
    "plot": 8,
    "plot_segments": 9,
    "plot_standings": 9,
    "batch": 9,
    "animate": 9,
    "plot_papers": 9,
    "preflight": 10,
    "comparison": 11,
    "replay": 12,
    "segmentation": 13,
    "reproduction": 12,
    "bench": 13,
    "options": 14,
    "console": 14,
    "cli_trace": 15,
    "cli": 16,
    "btm_settings": 1,
    "btm_json": 2,
    "btm_compare": 2,
    "exchange": 2,
    "walls": 0,
    "terrain": 0,
    "delaunay": 1,
    "perceive": 2,
    "heights": 3,
    "vehicle": 2,
    "btm": 2,
    "behave": 3,
    "btm_write": 4,
    "btm_run": 5,
    "btm_batch": 8,
    "operator_view": 8,
    "plot_btm": 9,
    "voronoi_lines": 8,
    "voronoi_ways": 10,
    "halls": 9,
    "btm_extract": 11,
    "tracing": 11,
    "btm_tables": 11,
    "btm_replay": 12,
    "btm_episode": 13,
    "__main__": 17,
}
"""Floor of every module; a package is one. `__init__` stands apart: it holds the version and loads by name."""


def floor_of(path):
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported(tree):
    """Names of the modules of this package that a syntax tree imports, those in functions included."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            names = [node.module]
            if node.module == "jexplore":
                names = [f"jexplore.{alias.name}" for alias in node.names if alias.name != "__version__"]
        else:
            continue
        yield from (name.split(".")[1] for name in names if name.startswith("jexplore."))


def rising(source, name, floors):
    """The imports of a module `name` that do not go downward."""
    own = floors[name]
    return sorted({other for other in imported(ast.parse(source)) if other != name and floors[other] >= own})


MODULES = sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py")


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_go_downward(path):
    source, name = path.read_text(encoding="utf-8"), floor_of(path)
    assert rising(source, name, FLOORS) == []
    package = path.relative_to(PACKAGE).parts[:-1]
    if not package:
        assert name not in imported(ast.parse(source)), "imports itself"


def test_every_module_has_a_floor_and_every_floor_a_module():
    assert {floor_of(path) for path in MODULES} == set(FLOORS)


def test_the_test_finds_what_it_looks_for():
    floors = {"low": 0, "beside": 1, "own": 1, "high": 2}
    for source, expected in [
        ("import jexplore.low, jax", []),
        ("from jexplore import __version__, low", []),
        ("from jexplore.high import x", ["high"]),
        ("from jexplore.beside.part import x", ["beside"]),
        ("def f():\n    from jexplore import high", ["high"]),
        ("if TYPE_CHECKING:\n    import jexplore.high.x", ["high"]),
        ("from jexplore.own import part", []),
    ]:
        assert rising(source, "own", floors) == expected
