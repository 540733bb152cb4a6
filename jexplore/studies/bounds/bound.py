"""Bounds: for each start how short a walk is that sees everything, and how short none is."""

import concurrent.futures
import concurrent.futures.process
import ctypes
import dataclasses
import hashlib
import json
import math
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from jexplore.config import InputError, __version__, checked_names, require_setting, require_whole
from jexplore.engine.backend import start_backend, use_compilation_cache
from jexplore.engine.runner import own_cores
from jexplore.exploration.results import length_along_m
from jexplore.raycast import scans_all_round
from jexplore.reach import FAR
from jexplore.report.ledger import Ledger, Work
from jexplore.report.tables import aligned_table, number_text
from jexplore.rules import Lidar, Rules
from jexplore.studies import checks
from jexplore.studies.bounds.beside import START, with_bound_ratios
from jexplore.studies.bounds.floor import low_metres
from jexplore.studies.bounds.scene import prepare_scene
from jexplore.studies.bounds.search import Budget, SearchResult, search
from jexplore.studies.bounds.teams import with_team_ratios
from jexplore.studies.results.progress import progress_bar
from jexplore.studies.results.provenance import world_digest
from jexplore.worlds.world import World

if TYPE_CHECKING:
    from matplotlib.figure import Figure

JOIN_S = 5.0  # seconds that a process may take to end
WALK, WITNESSES = "_walk", "_witnesses"  # columns of a unit's file besides


BOUND_COLUMNS = (
    *("world", "start_row", "start_col", "low_m", "low_any_m", "high_m", "status", "witnesses", "seconds"),
    *("method", "start_heading_deg", "sha256"),
)
"""Columns of a table of bounds."""
OPTIMAL, BOUNDED, WEAK, STUCK = "OPTIMAL", "BOUNDED", "WEAK", "STUCK"
"""Status of a row: the walk is the shortest; it is between two bounds; no walk was found in the time, and the lower
bound is weak; the start is enclosed."""


class BoundTask(NamedTuple):
    """One start to be bounded."""

    world: World
    start: tuple[int, int, int]  # row, col, heading in degrees
    lidar: Lidar
    rules: Rules
    seconds: float | None
    max_floods: int | None


def solve(task: BoundTask) -> pd.DataFrame:
    """Bound one start: a row with `BOUND_COLUMNS`, and `WALK` and `WITNESSES`, bytes of `[n, 2]` int32, row and col."""
    world, start = task.world, task.start
    scene = prepare_scene(world, start, task.lidar, task.rules, scans_all_round(task.lidar))
    row: dict[str, Any] = {"world": os.fspath(world.name), **dict(zip(START, start)), "sha256": world_digest(world)}
    if scene is None:
        row |= {"low_m": 0.0, "low_any_m": 0.0, "high_m": math.nan, "status": STUCK, "witnesses": 0, "seconds": 0.0}
        return pd.DataFrame(
            [row | {"method": "-", WALK: b"", WITNESSES: b""}], columns=[*BOUND_COLUMNS, WALK, WITNESSES]
        )
    found = SearchResult(np.array([scene.start]), 0, 0, 0, True, [], "subsets")  # everything is seen from the start
    budget = Budget(task.seconds, task.max_floods)
    if scene.must_see.any():
        search(scene, Budget(None, 1))  # compiles
        budget = Budget(task.seconds, task.max_floods)
        found = search(scene, budget)
    status = OPTIMAL if found.optimal else WEAK if found.high >= FAR else BOUNDED
    walk, witnesses = (
        np.stack(scene.cells(np.array(cells, int)), axis=1).astype(np.int32) for cells in (found.walk, found.witnesses)
    )
    row |= {"low_m": low_metres(found.low, world.cell_m), "low_any_m": low_metres(found.low_any, world.cell_m)}
    row["high_m"] = math.nan if status == WEAK else float(length_along_m(walk[:, 0], walk[:, 1], world.cell_m)[-1])
    row |= {"status": status, "witnesses": len(witnesses), "seconds": budget.elapsed_s, "method": found.method}
    row |= {WALK: walk.tobytes(), WITNESSES: witnesses.tobytes()}
    return pd.DataFrame([row], columns=[*BOUND_COLUMNS, WALK, WITNESSES])


@checked_names
@dataclasses.dataclass(frozen=True)
class BoundsResult:
    """Result of `bound`. Tables are pandas DataFrames."""

    table: pd.DataFrame
    """One row a world and start: `low_m`, `low_any_m`, `high_m`, metres; `status`; see `BOUND_COLUMNS`.

    `high_m` is the length of a walk on which the reference robot, which knows the map, stands on clear cells and turns
    for nothing, sees all that an episode must see. None of its walks is shorter than `low_m`; none of any robot that
    crosses free cells is shorter than `low_any_m`, so no complete episode of any strategy is."""
    walks: pd.DataFrame
    """One row a step: `world`, `start` (number of the row in `table`), `step`, `row`, `col`."""
    worlds: tuple[World, ...]
    """The worlds, in order."""
    witnesses: dict[int, np.ndarray]
    """Number of a row -> `[N, 2]` int32, row and col of the cells that make its lower bound."""
    settings: dict[str, Any]
    """Settings that bounds depend on, apart from world and start."""
    interrupted: int = 0
    """Starts that are missing because the run was interrupted."""

    def to_pandas(self) -> pd.DataFrame:
        return self.table

    def to_markdown(self) -> str:
        return bounds_table(self.table)

    def beside(self, comparison: Any) -> pd.DataFrame:
        """Compare the episodes of a `ComparisonResult` with the bounds: see `beside.with_bound_ratios`.

        Those of teams are compared with bounds of the whole team: see `teams.with_team_ratios`.
        """
        if not hasattr(comparison, "episodes") or not hasattr(comparison, "worlds"):
            raise InputError(f"expected a comparison, got {type(comparison).__name__}")
        if comparison.lidar is not None and comparison.rules is not None:
            require_perfect(comparison.lidar, comparison.rules)
            for name, value in bound_settings(comparison.lidar, comparison.rules).items():
                if self.settings[name] != value:
                    raise InputError(f"the bounds are for {name} {self.settings[name]:g}, the episodes had {value:g}")
        digests = {os.fspath(world.name): world_digest(world) for world in comparison.worlds}
        table = with_bound_ratios(comparison.episodes, self.table, digests)
        return with_team_ratios(table, self, comparison.jobs) if "robots" in table else table

    def figure(self) -> "Figure":
        """Draw the walks and the witnesses of the first starts: a matplotlib `Figure`."""
        from jexplore.report.plots.maps import bounds_figure

        return bounds_figure(self)

    def _repr_markdown_(self):
        return self.to_markdown()

    def __repr__(self) -> str:
        return f"<Bounds of {len(self.table)} starts in {len(self.worlds)} worlds>"


def bounds_table(table: pd.DataFrame) -> str:
    """Format rows of `BoundsResult.table` as Markdown."""
    head = ["world", "start", "low any m", "low m", "high m", "high / low", "status", "witnesses", "s"]
    lines = []
    for row in table.to_dict("records"):
        ratio = row["high_m"] / row["low_m"] if row["low_m"] else math.nan
        lengths = [number_text(row[name], 2) for name in ("low_any_m", "low_m", "high_m")]
        place = f"{row['start_row']},{row['start_col']}"
        line = [row["world"], place, *lengths, number_text(ratio, 3), row["status"]]
        lines.append([*line, str(row["witnesses"]), number_text(row["seconds"], 1)])
    return aligned_table(head, lines, left=("world", "start", "status"))


@checked_names
def bound(
    worlds: checks.WorldLike | Iterable[checks.WorldLike], *, starts: int = 5, seed: int = 0, cell_m: float = 0.1,
    start: checks.StartLike = "random", seconds: float = 10.0, max_floods: int | None = None,
    lidar: checks.LidarLike = checks.LIDAR, rules: checks.RulesLike = checks.RULES, workers: int = 1,
    on_progress: Callable[[int], object] | None = None, progress: bool | None = None,
) -> BoundsResult:  # fmt: skip
    """Bound the shortest walks that a robot with the map could drive, from the starts of `compare`.

    Args:
      worlds: names or `World`s, as for `compare`.
      starts: number in each world: those of the first episodes.
      seed: of the starts.
      cell_m: edge of a cell of the worlds that are loaded by name, metres.
      start: as for `compare`.
      seconds: for each start, compiling apart; a smaller gap takes more.
      max_floods: number of shortest-path maps instead of seconds, for results that are the same on every machine.
      lidar: `Lidar` without noise and drop-out, or a mapping of some of its fields.
      rules: `Rules`, or a mapping of some of its fields.
      workers: processes that work at a time. With more than one a script needs `if __name__ == "__main__":`.
      on_progress: called with the number of starts finished.
      progress: show a bar; by default in notebooks.
    """
    places = {"starts": starts, "seed": seed, "cell_m": cell_m, "start": start}
    tasks = prepare_bounds(worlds, **places, seconds=seconds, max_floods=max_floods, lidar=lidar, rules=rules)
    with progress_bar(progress, len(tasks), "starts", on_progress) as moved:
        return run_bounds(tasks, workers=workers, on_progress=moved)


def prepare_bounds(
    worlds: checks.WorldLike | Iterable[checks.WorldLike], *, starts: int, seed: int, cell_m: float,
    start: checks.StartLike, seconds: float, max_floods: int | None, lidar: checks.LidarLike, rules: checks.RulesLike,
) -> list[BoundTask]:  # fmt: skip
    """Check and load everything before `bound` runs: the tasks. Arguments as there."""
    lidar, rules = checks.ready_settings(lidar, rules)
    starts, seed = require_setting("starts", starts), require_setting("seed", seed)
    seconds, pairs = require_setting("seconds", seconds), []
    if max_floods is not None:
        require_whole("max_floods", max_floods, 1, 10**9)
    for world in checks.ready_worlds(worlds, cell_m):
        places = checks.ready_starts(world, start, starts if start == "random" else 1, seed=seed, rules=rules)
        pairs += [(world, (int(r), int(c), int(h))) for r, c, h in places]
    return bound_tasks(pairs, lidar, rules, None if max_floods else seconds, max_floods)


def require_perfect(lidar: Lidar, rules: Rules) -> None:
    """Refuse a scanner with noise, whose beams may say nothing, or that is not at the robot's centre, and odometry."""
    rules.require_lattice("bounds are")
    centre = "that sees all from the robot's centre: lidar.min_range_m, forward_m and left_m must be 0"
    for is_bad, needs in (
        (lidar.sigma_m or lidar.dropout, "without noise: lidar.sigma_m and lidar.dropout must be 0"),
        (lidar.no_echo != "free", "that shows what it has no echo from: lidar.no_echo must be free"),
        (lidar.min_range_m or lidar.mount_m, centre),
    ):
        if is_bad:
            raise InputError(f"bounds are of a scanner {needs}")


def bound_tasks(
    pairs: Iterable[tuple[World, tuple[int, int, int]]], lidar: Lidar, rules: Rules, seconds: float | None,
    max_floods: int | None = None,
) -> list[BoundTask]:  # fmt: skip
    """Return the tasks of worlds and starts.

    Raises:
      InputError: settings that no bound is of; a world with a region to stay in, or of which a part is known.
    """
    require_perfect(lidar, rules)
    tasks = [BoundTask(world, start, lidar, rules, seconds, max_floods) for world, start in pairs]
    for world, *_ in tasks:
        if world.within is not None or world.known is not None:
            raise InputError(f"{world.name!r}: bounds are of whole worlds, of which nothing is known beforehand")
    return tasks


def bound_settings(lidar: Lidar, rules: Rules) -> dict[str, Any]:
    """Return the settings that bounds depend on, apart from world and start."""
    own = {name: getattr(lidar, name) for name in ("n_beams", "fov_deg", "range_m", "yaw_deg")}
    return own | {"clearance_m": rules.clearance_m, "near_m": rules.near_m}


def asked_of_bounds(tasks: Sequence[BoundTask]) -> dict[str, Any]:
    """Return all that the results of some tasks depend on, as plain values."""
    starts = hashlib.sha256(json.dumps([task.start for task in tasks]).encode())
    worlds = {os.fspath(task.world.name): task.world for task in tasks}
    return {
        "version": __version__,
        "worlds": list(worlds),
        "digests": {name: world_digest(world) for name, world in worlds.items()},
        "starts": len(tasks),
        "start cells": starts.hexdigest()[:12],
        "seconds": tasks[0].seconds,
        "max_floods": tasks[0].max_floods,
        **bound_settings(tasks[0].lidar, tasks[0].rules),
    }


def run_bounds(
    tasks: Sequence[BoundTask], *, ledger: Ledger | None = None, first: int = 0, workers: int | None = None,
    on_progress: Callable[[int], object] | None = None,
) -> BoundsResult:  # fmt: skip
    """Bound all starts that the ledger, in which `first` is the first one's unit, does not have.

    Raises:
      KeyboardInterrupt: none was finished.
    """
    workers = min(own_cores() if workers is None else require_setting("workers", workers), len(tasks))
    numbers = range(first, first + len(tasks))
    work = Work(numbers, ledger)
    tasks_of = dict(zip(numbers, tasks))

    def take(number, found):
        work.put(number, found)
        if on_progress is not None:
            on_progress(len(work.done))

    try:
        _run(work.left, tasks_of, workers, take)
    except KeyboardInterrupt:
        if not work.done:
            raise
    worlds = {os.fspath(tasks_of[i].world.name): tasks_of[i].world for i in sorted(work.done)}
    table, steps, witnesses = pd.concat(work.results, ignore_index=True), [], {}
    for k, (world, *cells) in enumerate(zip(table["world"], table.pop(WALK), table.pop(WITNESSES))):
        walk, witnesses[k] = (np.frombuffer(own, np.int32).reshape(-1, 2) for own in cells)
        own = {"world": world, "start": k, "step": np.arange(len(walk))}
        steps.append(pd.DataFrame({**own, "row": walk[:, 0], "col": walk[:, 1]}))
    return BoundsResult(
        table=table,
        walks=pd.concat(steps, ignore_index=True),
        worlds=tuple(worlds.values()),
        witnesses=witnesses,
        settings=bound_settings(tasks[0].lidar, tasks[0].rules),
        interrupted=len(tasks) - len(table),
    )


def _run(left, tasks, workers, take):
    if workers == 1 or len(left) < 2:
        use_compilation_cache()
        start_backend(1)
        for i in left:
            take(i, solve(tasks[i]))
        return
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(workers, context, _begin_worker) as pool:
        futures = {pool.submit(solve, tasks[i]): i for i in left}
        try:
            for future in concurrent.futures.as_completed(futures):
                take(futures[future], future.result())
        except BaseException as error:
            processes = list((pool._processes or {}).values())
            for process in processes:
                process.terminate()
            for process in processes:
                process.join(JOIN_S)
            pool.shutdown(wait=False, cancel_futures=True)
            if isinstance(error, concurrent.futures.process.BrokenProcessPool):
                why = "a process that bounds was ended from outside, perhaps for want of memory"
                raise InputError(f"{why}: --resume goes on, --workers 1 needs less") from error
            raise


def _begin_worker():
    """Prepare a worker: it ends with its parent, and leaves Ctrl-C to it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
    use_compilation_cache()
    start_backend(1)
