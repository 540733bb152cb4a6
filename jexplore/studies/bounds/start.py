"""Bounds of one start: the task, and its result."""

import math
import os
from typing import Any, NamedTuple

import numpy as np

from jexplore.config import Lidar, Rules
from jexplore.exploration.results import length_along_m
from jexplore.raycast import scans_all_round
from jexplore.reach import DIAGONAL, FAR, STRAIGHT
from jexplore.studies.bounds.scene import Scene, prepare_scene
from jexplore.studies.bounds.search import Budget, Found, search
from jexplore.studies.results.provenance import world_digest
from jexplore.worlds.world import World

COLUMNS = (
    *("world", "start_row", "start_col", "low_m", "low_any_m", "high_m", "status", "witnesses", "seconds"),
    *("method", "start_heading_deg", "sha256"),
)
"""Columns of a table of bounds."""
OPTIMAL, BOUNDED, WEAK, STUCK = "OPTIMAL", "BOUNDED", "WEAK", "STUCK"
"""Status of a row: the walk is the shortest; it is between two bounds; no walk was found in the time, and the lower
bound
is weak; the start is enclosed."""


class Task(NamedTuple):
    """One start to be bounded."""

    world: World
    start: tuple[int, int, int]  # row, col, heading in degrees
    lidar: Lidar
    rules: Rules
    seconds: float | None
    max_floods: int | None


class Solved(NamedTuple):
    """Result of a task."""

    row: dict[str, Any]  # `COLUMNS`
    walk: np.ndarray  # [K, 2] int32, row and col
    witnesses: np.ndarray  # [N, 2] int32


def low_metres(cost: int, cell_m: float) -> float:
    """Convert a least cost to a least length in metres: rounded down to a millimetre.

    A diagonal step costs a millionth more than sqrt(2) straight ones, so a walk may be that much shorter than its cost.
    """
    shortest = cost / STRAIGHT * (STRAIGHT * math.sqrt(2) / DIAGONAL) * cell_m
    return math.floor(shortest * 1000 * (1 - 1e-12)) / 1000


def solve(task: Task) -> Solved:
    """Bound one start: a `Solved`."""
    world, start = task.world, task.start
    scene = prepare_scene(world, start, task.lidar, task.rules, scans_all_round(task.lidar.fov_deg))
    own = {"world": os.fspath(world.name), "start_row": start[0], "start_col": start[1]}
    own |= {"start_heading_deg": start[2], "sha256": world_digest(world)}
    nothing = np.zeros((0, 2), np.int32)
    if scene is None:
        row = {"low_m": 0.0, "low_any_m": 0.0, "high_m": math.nan, "status": STUCK, "witnesses": 0, "seconds": 0.0}
        return Solved(_row(own | row | {"method": "-"}), nothing, nothing)
    if scene.must_see.any():
        search(scene, Budget(None, 1))  # compiles
    budget = Budget(task.seconds, task.max_floods)
    found = search(scene, budget) if scene.must_see.any() else _nothing_to_see(scene)
    status = OPTIMAL if found.optimal else WEAK if found.high >= FAR else BOUNDED
    high_m = math.nan if status == WEAK else _length_m(scene, found.walk, world.cell_m)
    row = {
        **{"low_m": low_metres(found.low, world.cell_m), "low_any_m": low_metres(found.low_any, world.cell_m)},
        **{"high_m": high_m, "status": status, "witnesses": len(found.witnesses)},
        **{"seconds": budget.elapsed_s, "method": found.method},
    }
    walk, witnesses = (np.stack(scene.cells(cells), axis=1).astype(np.int32) for cells in (found.walk, found.witnesses))
    return Solved(_row(own | row), walk, witnesses.reshape(-1, 2))


def _row(values):
    return {name: values[name] for name in COLUMNS}


def _nothing_to_see(scene: Scene) -> Found:
    """Return the result of a start from which everything is seen."""
    return Found(np.array([scene.start]), 0, 0, 0, True, [], "subsets")


def _length_m(scene, walk, cell_m):
    rows, cols = scene.cells(walk)
    return float(length_along_m(rows, cols, cell_m)[-1])
