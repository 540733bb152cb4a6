"""A comparison: strategies in worlds, all from the same starts, as a table with statistics and warnings."""

import collections
import dataclasses
import functools
import itertools
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from jexplore.arrays.pictures import MAX_TABLE_ROWS, axes_of, html_of, or_text, png_of
from jexplore.config import InputError, checked_names, unknown
from jexplore.engine.backend import use_compilation_cache
from jexplore.exploration.batch import Job
from jexplore.report.ledger import Ledger
from jexplore.report.plots import maps
from jexplore.report.tables import table_cells
from jexplore.rules import Lidar, Rules
from jexplore.studies.results import provenance, saving
from jexplore.studies.results.columns import TEAM_MEASURES
from jexplore.studies.results.details import EXTRAS, MAP, PROGRESS, SEEN, WAY, Seen, read_details
from jexplore.studies.results.tables import ByStrategy
from jexplore.studies.results.units import Ran, columns_of, cut_jobs, run_units
from jexplore.studies.statistics import by_world, figures, teams
from jexplore.studies.statistics.coverage import at_coverage, coverage_text
from jexplore.studies.statistics.league import over_worlds_text, standings, standings_table
from jexplore.studies.statistics.paired import MIN_PAIRS
from jexplore.worlds.world import World

SHORT_TABLE = (
    *("world", "strategy", "n", "path m", "ratio to the first", "ratio to the reference", "p (Holm)", "explored"),
    *("outcomes", "best in"),
)
"""Columns of tables that a notebook shows."""


@checked_names
@dataclasses.dataclass(frozen=True)
class ComparisonResult(ByStrategy):
    """Result of `compare`. Tables are pandas DataFrames.

    Iterating gives the names of its strategies, and `results["closest"]` the table of that one's episodes.
    """

    episodes: pd.DataFrame
    """One row an episode, ordered by world, strategy, episode; columns `columns.COLUMNS` and `metrics`."""
    worlds: tuple[World, ...]
    """The worlds, in order."""
    compile_s: float
    """Seconds spent compiling, or loading compiled programs."""
    run_s: float
    """Seconds in which compiled programs ran."""
    interrupted: int = 0
    """Episodes that are missing because the run was interrupted; of the others, those that every strategy finished."""
    resumed: int = 0
    """Episodes that an earlier run had finished, with which this one went on."""
    lidar: Lidar | None = None
    """The scanner; None if unknown."""
    rules: Rules | None = None
    """The rules; None if unknown."""
    metrics: tuple[str, ...] = ()
    """Names of the columns of your own metrics."""
    details: pd.DataFrame = dataclasses.field(default_factory=pd.DataFrame, repr=False)
    """One row an episode: see `details.EXTRAS`."""
    jobs: tuple[Job, ...] = dataclasses.field(default=(), repr=False, compare=False)
    """The jobs that ran; of a comparison that was loaded, or copied to another process, none."""
    record: Mapping[str, Any] = dataclasses.field(default_factory=dict, repr=False, compare=False)
    """Entries of run.json that its tables do not tell."""

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "jobs": ()}  # strategies are functions, which cannot be pickled

    @functools.cached_property
    def first(self) -> dict[str, list[Seen]]:
        """Return by world how episode 0 of every strategy ended."""
        found: dict[str, list[Seen]] = {}
        for (world, _), rows in self._kept(SEEN, list).items():
            found[world] = [*found.get(world, ()), *(seen for seen in rows if seen is not None)]
        return {world: own for world, own in found.items() if own}

    @functools.cached_property
    def progress(self) -> dict[tuple[str, str], np.ndarray]:
        """Return by (world, strategy) when each episode first knew 1, 2, ... 100 % of what can be known in its world.

        `[N, 100]` float64, metres driven; NaN where it never did.
        """
        return self._kept(PROGRESS, np.stack)

    @functools.cached_property
    def paths(self) -> dict[tuple[str, str], list[np.ndarray]]:
        """With `keep`, return by (world, strategy) the ways of its episodes: a list of arrays.

        Each is `[n + 1, 3]` int32: row, col and known cells, at the start and after each of n steps.
        """
        return self._kept(WAY, list)

    @functools.cached_property
    def maps(self) -> dict[tuple[str, str], np.ndarray]:
        """With `keep="maps"`, return by (world, strategy) the last map of each episode.

        `[N, H, W]` uint8: 0 unknown, 1 free, 2 occupied.
        """
        return self._kept(MAP, np.stack)

    def _kept(self, name, join):
        """Return a column of `details` by world and strategy; nothing where it has no such column."""
        keys = [self.episodes[key].to_numpy() for key in ("world", "strategy")]
        found: Any = self.details[name].groupby(keys, sort=False) if name in self.details else ()
        return {pair: join(rows.tolist()) for pair, rows in found}

    @functools.cached_property
    def summary(self) -> pd.DataFrame:
        """Tabulate means, one row a world and strategy: see `by_world.summarise`."""
        return by_world.summarise(self.episodes, self.metrics)

    @functools.cached_property
    def standings(self) -> pd.DataFrame:
        """Tabulate standings, one row a strategy, over all worlds: see `league.standings`."""
        return standings(self.episodes)

    @functools.cached_property
    def teams(self) -> pd.DataFrame:
        """Tabulate how much faster teams are than one robot, with `robots`: see `teams.tabulate`."""
        return teams.tabulate(self.episodes)

    @functools.cached_property
    def at_coverage(self) -> pd.DataFrame:
        """Tabulate ratios of paths and times to shares of a world: see `coverage.at_coverage`."""
        return at_coverage(self.episodes)

    @functools.cached_property
    def warnings(self) -> list[str]:
        """List the reasons that make the comparison unfair or inexact: lines."""
        lines = [f"interrupted: {self.interrupted} episodes are missing"] if self.interrupted else []
        return [*lines, *by_world.warnings_of(self.episodes, self.progress)]

    @property
    def episodes_per_s(self) -> float:
        """Return episodes per second of running compiled programs; 0 if none were run."""
        return max(len(self.episodes) - self.resumed, 0) / self.run_s if self.run_s else 0.0

    def to_markdown(self) -> str:
        """Format the summary and ratios at equal coverage as Markdown; for six worlds or more also those over all."""
        text = by_world.markdown_table(self.summary)
        together = len(self.worlds) >= MIN_PAIRS and max(self.standings["worlds"], default=0) >= MIN_PAIRS
        text = f"{over_worlds_text(self.standings)}\nIn each world:\n\n{text}" if together else text
        if TEAM_MEASURES[0] in self.episodes:
            text += f"\nTeams:\n\n{teams.team_table(self.teams)}"
        return f"{text}\n{coverage_text(self.at_coverage)}" if len(self) > 1 else text

    def league_text(self) -> str:
        """Format the statistics over all worlds, and ratios at equal coverage, as Markdown tables."""
        return f"{standings_table(self.standings)}\n{coverage_text(self.at_coverage)}"

    def save(self, folder: str | os.PathLike[str], *, overwrite: bool = False, report: bool = True) -> Path:
        """Write the folder that `jexplore compare` writes: tables, pictures, run.json, report.html; return its path.

        `jx.load` reads it, ways and maps included, and `jx.compare(..., out=folder, resume=True)` takes it for done.
        `overwrite` replaces a run that is there. The `report` of a comparison that was loaded has no replays.
        """
        if "command" not in self.record:
            raise InputError(
                "only what jx.compare or jx.load returned can be saved: episodes.to_csv() writes the table"
            )
        with saving.claimed_by_call(folder, overwrite=overwrite) as run:
            return saving.write_comparison(run, self, report=report)

    def plot(self, ax: Any = None, world: str | None = None) -> Any:
        """Draw path lengths in one world, by default the first: every episode, and the means with their 95 % intervals.

        Draws into matplotlib `Axes`, by default those of a new figure, and returns them. `compare_figure` shows all
        worlds.
        """
        world = self.worlds[0].name if world is None else world
        if world not in self.episodes["world"].to_numpy():
            raise unknown("world of this comparison:", str(world), [w.name for w in self.worlds])
        ax = axes_of(ax)
        figures.draw_world(ax, self.episodes, self.summary, world)
        return ax

    def compare_figure(self) -> Figure:
        """Draw every episode's path, means, intervals and paired ratios: see `figures.compare_figure`."""
        table = self.standings if len(self.worlds) > 1 else None
        return figures.compare_figure(self.episodes, summary=self.summary, table=table)

    def coverage_figure(self) -> Figure:
        """Draw the known part of the knowable share along the path, a panel a world: see `figures.coverage_figure`."""
        return figures.coverage_figure(self.progress)

    def paths_figure(self) -> Figure:
        """Draw the map as each strategy saw it in episode 0, with its path: a matplotlib `Figure`."""
        return maps.paths_figure(list(self.first.items()))

    def _repr_markdown_(self):
        return self.to_markdown()

    @functools.cached_property
    def _picture(self):
        return png_of(self.compare_figure())

    @or_text
    def _repr_png_(self):
        return self._picture

    @or_text
    def _repr_html_(self):
        n = len(self.warnings)
        more = f"; {n} warning{'s' if n > 1 else ''}, see .warnings" if n else ""
        return html_of(self._picture, repr(self)[1:-1] + more, *self._short_table())

    def _short_table(self):
        """Return names of the columns and rows of text: every world's, or of many worlds the statistics over all."""
        many = len(self.worlds) > 1 and len(self.summary) > MAX_TABLE_ROWS
        text = standings_table(self.standings) if many else by_world.markdown_table(self.summary)
        head, lines, _ = table_cells(text)
        shown = [name in SHORT_TABLE for name in head]
        return [*itertools.compress(head, shown)], [[*itertools.compress(line, shown)] for line in lines]

    def __repr__(self) -> str:
        n, m = len(set(self.episodes["strategy"])), len(self.worlds)
        strategies, worlds = "strategy" if n == 1 else "strategies", "world" if m == 1 else "worlds"
        return f"<Comparison of {n} {strategies} in {m} {worlds}, {len(self.episodes)} episodes>"


def assemble(jobs: Sequence[Job], ran: Ran) -> ComparisonResult:
    """Make the `ComparisonResult` of jobs whose units have run.

    Of a run that was interrupted it holds the episodes that every strategy has finished in a world.

    Raises:
      KeyboardInterrupt: there are none.
    """
    table: Any = pd.concat(ran.tables, ignore_index=True)
    places = {(os.fspath(job.world.name), job.strategy.name): i for i, job in enumerate(jobs)}
    place = [places[pair] for pair in zip(table["world"], table["strategy"])]
    wanted = table["world"].map(collections.Counter(world for world, _ in places))
    whole = table.groupby(["world", "episode"])["strategy"].transform("size") == wanted
    order = np.lexsort([table["episode"], place])
    table = table.iloc[order[whole.to_numpy()[order]]].reset_index(drop=True)
    if not len(table):
        raise KeyboardInterrupt
    worlds = {os.fspath(job.world.name): job.world for job in jobs}
    costs = ran.costs
    return ComparisonResult(
        table.drop(columns=[*EXTRAS], errors="ignore"),
        tuple(worlds[name] for name in dict.fromkeys(table["world"])),
        compile_s=costs.compile_s,
        run_s=costs.run_s,
        interrupted=sum(len(job.starts) for job in jobs) - len(table),
        resumed=ran.resumed,
        details=table.filter([*EXTRAS]),
        lidar=jobs[0].lidar,
        rules=jobs[0].rules,
        metrics=(*jobs[0].metrics, *(() if jobs[0].team is None else TEAM_MEASURES)),
        jobs=tuple(jobs),
        record=provenance.engine_of(costs),
    )


def run_comparison(jobs: Sequence[Job], *, ledger: Ledger | None = None, **how: Any) -> ComparisonResult:
    """Run jobs; `how` as of `run_units`. A ledger may continue a finished comparison of fewer episodes.

    Raises:
      KeyboardInterrupt: no episode has been finished by every strategy.
    """
    use_compilation_cache()
    after = 0 if ledger is None else ledger.after
    earlier: list[Any] = []
    if ledger is not None and after:
        episodes, extras, _ = read_details(ledger.folder.parent)
        earlier = [episodes[[*columns_of(jobs[0])]].join(extras)[episodes["episode"] < after]]
    return assemble(jobs, run_units(jobs, cut_jobs(jobs, after), ledger=ledger, earlier=earlier, **how))
