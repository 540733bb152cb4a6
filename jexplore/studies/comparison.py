"""A comparison: strategies in worlds, all from the same starts, as a table with statistics and warnings.

pandas and matplotlib are imported by the functions that need them.
"""

import dataclasses
import functools
import os
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jexplore.config import MAX_SEED, InputError, Lidar, Rules, require_whole
from jexplore.engine.backend import use_compilation_cache
from jexplore.exploration import batch
from jexplore.exploration.batch import Job
from jexplore.exploration.results import columns, map_state, progress_m
from jexplore.exploration.state import Outcome
from jexplore.exploration.trail import RECORDS
from jexplore.studies import stats
from jexplore.studies.checks import (
    LIDAR,
    MAX_EPISODES,
    RULES,
    StrategyLike,
    WorldLike,
    ready_starts,
    ready_strategies,
    ready_worlds,
    require_memory,
    require_settings,
)
from jexplore.studies.league import standings
from jexplore.worlds.world import World

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

COLUMNS = (
    *("world", "strategy", "episode", "seed", "start_row", "start_col", "path_m", "turning_rad"),
    *("steps", "scans", "plans", "outcome", "exhausted", "explored_fraction"),
    *("path_m_at_50", "path_m_at_90", "path_m_at_95", "path_m_at_99", "room_entries"),
    *("start_heading_deg", "refused", "saturated", "overflow"),
)
"""Columns of a table of episodes. `stats` and `plot` read them by these names."""


class Seen(NamedTuple):
    """How episode 0 of a strategy in a world ended: its map and its way."""

    strategy: str
    state: object  # [H, W] uint8, 0 unknown, 1 free, 2 occupied
    rows: object  # [n + 1] int32, cells driven
    cols: object  # [n + 1] int32
    cell_m: float
    path_m: float


@dataclasses.dataclass(frozen=True)
class Comparison:
    """What `compare` found. Tables are pandas DataFrames."""

    episodes: "pd.DataFrame"
    """One row an episode, ordered by world, strategy, episode; columns `COLUMNS`."""
    worlds: tuple[World, ...]
    """The worlds, in order."""
    first: dict[str, list[Seen]]
    """Per world name, how episode 0 of every strategy ended."""
    compile_s: float
    """Seconds spent compiling, or loading compiled programs."""
    run_s: float
    """Seconds in which compiled programs ran."""
    interrupted: int = 0
    """Episodes that are missing because the run was interrupted; of the others, those that every strategy finished."""
    progress: dict[tuple[str, str], np.ndarray] = dataclasses.field(default_factory=dict)
    """(world, strategy) -> `[N, 100]` float64: metres driven when each episode in the table first knew 1, 2, ... 100 %
    of the cells that can be known in its world; NaN where it never did."""
    paths: dict[tuple[str, str], list[np.ndarray]] = dataclasses.field(default_factory=dict)
    """With `keep`: (world, strategy) -> a list with an array for each episode in the table, `[n + 1, 3]` int32: row,
    col and known cells, at the start and after each of n steps."""
    maps: dict[tuple[str, str], np.ndarray] = dataclasses.field(default_factory=dict)
    """With `keep="maps"`: (world, strategy) -> `[N, H, W]` uint8, the last map of each episode in the table: 0 unknown,
    1 free, 2 occupied."""

    @functools.cached_property
    def summary(self) -> "pd.DataFrame":
        """One row a world and strategy: see `stats.summarise`."""
        return stats.summarise(self.episodes)

    @functools.cached_property
    def standings(self) -> "pd.DataFrame":
        """One row a strategy, over all worlds: see `league.standings`."""
        return standings(self.episodes)

    @functools.cached_property
    def warnings(self) -> list[str]:
        """What makes the comparison unfair or inexact: a list of lines."""
        lines = [f"interrupted: {self.interrupted} episodes are missing"] if self.interrupted else []
        return [*lines, *stats.warnings_of(self.episodes, self.progress), *_bounds_met(self.episodes)]

    @property
    def episodes_per_s(self) -> float:
        """Episodes over the seconds in which compiled programs ran."""
        return len(self.episodes) / self.run_s

    def to_pandas(self) -> "pd.DataFrame":
        """The table of episodes."""
        return self.episodes

    def to_markdown(self) -> str:
        """The summary as a Markdown table."""
        return stats.markdown_table(self.summary)

    def plot(self, ax: Any, world: str | None = None) -> Any:
        """Mean path lengths in one world as bars.

        Args:
          ax: matplotlib `Axes`.
          world: its name; by default the first.

        Returns:
          The `BarContainer`.

        Raises:
          InputError: no such world in this comparison.
        """
        from jexplore.report import plot

        world = self.worlds[0].name if world is None else world
        rows = self.summary[self.summary["world"] == world]
        if not len(rows):
            raise InputError(f"world must be one of {', '.join(w.name for w in self.worlds)}, got {world!r}")
        return plot.bars(ax, rows["strategy"].tolist(), rows["mean"], rows["sd"], world)

    def compare_figure(self) -> "Figure":
        """Bars of mean path lengths, one panel a world: a matplotlib `Figure`."""
        from jexplore.report import plot

        return plot.compare_figure(self.summary)

    def paths_figure(self) -> "Figure":
        """The map as each strategy saw it in episode 0, with its path: a matplotlib `Figure`."""
        from jexplore.report import plot

        return plot.paths_figure(list(self.first.items()))

    def _repr_markdown_(self):
        return self.to_markdown()

    def __repr__(self) -> str:
        n_strategies = self.episodes["strategy"].nunique()
        return f"<Comparison of {n_strategies} strategies in {len(self.worlds)} worlds, {len(self.episodes)} episodes>"


BOUNDS = {
    "saturated": "some cells were too far to plan to",
    "overflow": "a plan had to leave out some frontier clusters, mixed cells, Voronoi nodes or critical points",
}


def _bounds_met(episodes):
    """Warnings about episodes that met a bound of what a plan can express or has room for."""
    lines = []
    for (world, strategy), rows in episodes.groupby(["world", "strategy"], sort=False):
        for column, what in BOUNDS.items():
            count = int((rows[column] > 0).sum())
            if count:
                lines.append(f"{world}: {strategy}: in {count} of {len(rows)} episodes {what}")
        refused = int((rows["outcome"] == Outcome.BAD_TARGET.name).sum())
        if refused:
            what = "ended because the strategy chose a target that no path leads to, three times in a row"
            lines.append(f"{world}: {strategy}: {refused} of {len(rows)} episodes {what}")
    return lines


def compare(
    worlds: WorldLike | Iterable[WorldLike],
    strategies: StrategyLike | Iterable[StrategyLike],
    *,
    episodes: int = 20,
    seed: int = 0,
    cell_m: float = 0.1,
    start: str = "random",
    lidar: Lidar = LIDAR,
    rules: Rules = RULES,
    engine: str | None = None,
    lanes: int | None = None,
    workers: int | None = None,
    on_progress: Callable[[int], object] | None = None,
    keep: str | None = None,
) -> Comparison:
    """Runs every strategy in every world, from the same starts. An interruption keeps what is finished.

    Args:
      worlds: names (`worlds.load_world`) or `World`s; one may stand for itself.
      strategies: names, functions of the view, constructors, `Policy`s (`policies.strategy`); the others are compared
        with the first.
      episodes: of each strategy in each world. More episodes leave the earlier ones as they were.
      seed: of starts and draws.
      cell_m: edge of a cell of the worlds that are loaded by name, metres.
      start: "random", or "world" for every world's own start in every episode.
      lidar: `Lidar`.
      rules: `Rules`.
      engine: one of `runner.ENGINES`; by default "serial" on a CPU, "lockstep" on an accelerator. Results are equal.
      lanes: episodes at a time on each device in lockstep; by default as many as its memory holds.
      workers: threads of the serial engine; by default one a core.
      on_progress: called now and then with the number of episodes finished.
      keep: "paths" for the way of every episode, 12 bytes a step, "maps" for its last map as well, a byte a cell; see
        `Comparison`.

    Returns:
      `Comparison`.

    Raises:
      InputError: a name, number, map or start that cannot be used. Raised before anything is compiled.
    """
    jobs = prepare_jobs(
        worlds, strategies, episodes=episodes, seed=seed, cell_m=cell_m, start=start, lidar=lidar, rules=rules
    )
    if keep is not None and keep not in tuple(RECORDS):
        raise InputError(f"keep must be None, {' or '.join(RECORDS)}, got {keep!r}")
    use_compilation_cache()
    how = {"engine": engine, "lanes": lanes, "workers": workers, "on_progress": on_progress}
    report = batch.run_jobs(jobs, lidar, rules, **how, keep=keep)
    return assemble(jobs, report, rules)


def prepare_jobs(
    worlds: WorldLike | Iterable[WorldLike],
    strategies: StrategyLike | Iterable[StrategyLike],
    *,
    episodes: int,
    seed: int,
    cell_m: float,
    start: str,
    lidar: Lidar,
    rules: Rules,
) -> list[Job]:
    """Everything that `compare` refuses or loads before it runs: a list of `Job`. Arguments as there."""
    require_settings(lidar, rules)
    episodes = require_whole("episodes", episodes, 1, MAX_EPISODES)
    seed = require_whole("seed", seed, 0, MAX_SEED)
    if start not in ("random", "world"):
        raise InputError(f"start must be random or world, got {start!r}")
    strategies = ready_strategies(strategies)
    jobs = []
    for world in ready_worlds(worlds, cell_m):
        require_memory(world, lidar, rules)
        starts = ready_starts(world, start, episodes, seed=seed, rules=rules)
        jobs += [Job(world, strategy, starts, seed) for strategy in strategies]
    return jobs


def assemble(jobs: Sequence[Job], report: batch.Finished, rules: Rules) -> Comparison:
    """The `Comparison` of jobs that have run.

    Of a run that was interrupted it holds the episodes that every strategy has finished in a world.

    Raises:
      KeyboardInterrupt: there are none.
    """
    import pandas as pd

    finished = {}
    for job, (result, *_) in zip(jobs, report.outcomes):
        ended = result.outcome != Outcome.RUNNING
        finished[job.world.name] = finished.get(job.world.name, True) & ended
    tables, worlds, first, progress, paths, maps = [], {}, {}, {}, {}, {}
    for job, (result, final, records) in zip(jobs, report.outcomes):
        world, strategy, kept = job.world, job.strategy.name, finished[job.world.name]
        if not kept.any():
            continue
        found = columns(result, job.starts, seed=job.seed, cell_m=world.cell_m, has_rooms=world.rooms is not None)
        table = pd.DataFrame({"world": os.fspath(world.name), "strategy": strategy, **found})
        table["room_entries"] = table["room_entries"].astype("Int64")
        tables.append(table[kept])
        worlds[world.name] = world
        progress[world.name, strategy] = progress_m(result, world.cell_m)[kept]
        if records:
            own = [records[i] for i in np.flatnonzero(kept).tolist()]
            paths[world.name, strategy] = [record.path for record in own]
            states = [record.state for record in own if record.state is not None]
            if states:
                maps[world.name, strategy] = np.stack(states)
        if kept[0] and final is not None:
            state = map_state(final.hits, final.misses, rules.p_free)
            seen = Seen(strategy, state, final.rows, final.cols, world.cell_m, float(found["path_m"][0]))
            first.setdefault(world.name, []).append(seen)
    if not tables:
        raise KeyboardInterrupt
    table = pd.concat(tables, ignore_index=True).loc[:, list(COLUMNS)]
    missing = sum(len(job.starts) for job in jobs) - len(table)
    costs = report.costs
    return Comparison(
        *(table, tuple(worlds.values()), first, costs.compile_s, costs.run_s, missing),
        progress=progress,
        paths=paths,
        maps=maps,
    )
