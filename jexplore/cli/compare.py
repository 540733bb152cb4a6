"""The commands `jexplore compare` and `jexplore reproduce`."""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from tyro.conf import Positional

from jexplore.cli.options import (
    DEFAULT_STRATEGIES,
    EngineOptions,
    ReportOptions,
    ResumeOptions,
    SceneOptions,
    TimedOptions,
    TrustOptions,
    default_worlds,
    fields_of,
    is_small,
)
from jexplore.cli.output.console import Out, note_if_slow, working

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from jexplore.exploration.batch import Job
    from jexplore.studies.bounds.bound import BoundTask
    from jexplore.studies.results.comparison import ComparisonResult

FINISHING = "jexplore: computing statistics and drawing"


@dataclasses.dataclass(frozen=True)
class Compare(EngineOptions, ReportOptions, ResumeOptions, TrustOptions, SceneOptions):
    """Compare strategies in worlds, all from the same starts.

    Prints a table and writes episodes.parquet, details.parquet, run.json, compare.png, coverage.png, paths.png and
    report.html. Finished episodes are stored on the way: --resume continues a run that was ended in any way.
    """

    worlds: tuple[str, ...] | None = None
    """Run in these worlds: names of generators such as cave#3, or map files; see `jexplore worlds` (default: cave
    office hospital)."""
    strategies: tuple[str, ...] | None = None
    """Compare these strategies, the others with the first; see `jexplore strategies` (default: closest closest+recheck
    random)."""
    episodes: int = dataclasses.field(default_factory=lambda: 5 if is_small() else 20)
    """Number of episodes of each strategy in each world."""
    seed: int = 0
    """Draw starts and all that is random from this seed."""
    robots: tuple[int, ...] | None = None
    """Explore with teams of these sizes, up to 16 robots; the others are compared with the first. Paths are then times
    on the team's clock."""
    coordination: tuple[str, ...] | None = None
    """Have teams choose targets in these ways: independent, greedy, hungarian, minpos, voronoi, segments, or a function
    of yours such as mine:apart (default: independent)."""
    metric: tuple[str, ...] | None = None
    """Add columns of your own: functions of an episode in a module here or installed, such as mine:crowding;
    name=mine:crowding names the column."""
    league: bool = False
    """Run every strategy in 48 worlds of six kinds (in cells over 0.2 m: 40 of five), unless --worlds and --strategies
    say otherwise. Print who ranks where over all worlds, and write league.png and curves over all of them
    instead of the pictures of single worlds."""
    league_seeds: int = 8
    """Number of worlds of each kind for the league, #0 and on."""
    tuned: str | None = None
    """Give strategies the settings that `jexplore tune` wrote into this file; shipped: the file that comes with the
    package."""
    bounds: bool = False
    """Also find the shortest path of a robot that knows the map from each start, as `jexplore bound` does, and compare
    every path with it; writes bounds.parquet."""
    bound_seconds: float = 10.0
    """Seconds spent on the bounds of each start."""

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Run the command and return the exit status, None for 0."""
        from jexplore.exploration.team.team import INDEPENDENT
        from jexplore.studies.bounds.bound import bound_tasks
        from jexplore.studies.checks import prepare_jobs
        from jexplore.studies.results.saving import figures_of
        from jexplore.studies.statistics.league import LEAGUE_STRATEGIES, league_worlds

        worlds, strategies = (
            (league_worlds(self.cell_m, self.league_seeds), LEAGUE_STRATEGIES)
            if self.league
            else (default_worlds(), DEFAULT_STRATEGIES)
        )
        worlds = worlds if self.worlds is None else self.worlds
        strategies = strategies if self.strategies is None else self.strategies
        if self.tuned is not None:
            from jexplore.learn.tuning import with_settings

            strategies = with_settings(strategies, self.tuned)
        self = dataclasses.replace(self, worlds=worlds, strategies=strategies)
        with Out(self, arguments) as out:
            jobs = prepare_jobs(
                worlds,
                strategies,
                **fields_of(self, "episodes seed cell_m start within from_map lidar rules robot"),
                metrics=self.metric,
                **fields_of(self, "robots contact team_starts members"),
                coordination=self.coordination or INDEPENDENT,
            )
            pairs = [(job.world, tuple(start)) for job in jobs for start in job.starts.tolist()]
            once = {(world.name, *start): (world, start) for world, start in pairs}.values()  # strategies share starts
            tasks = bound_tasks(once, self.lidar, self.rules, self.bound_seconds) if self.bounds else []
            reported = jobs if self.report else None
            found = run_with_bar(self, jobs, out, tasks)
            with note_if_slow(FINISHING):
                entries = {"standings": found.standings.to_dict("records")} if self.league else {}
                text = found.league_text() if self.league else found.to_markdown()
            found, files, is_whole = self._beside(found, tasks, out)
            text += _more_tables(found.episodes, self.league)
            figures = figures_of(found, league=self.league)
            with note_if_slow(FINISHING):
                return finish_comparison(out, found, text, figures, entries, reported, files, is_whole=is_whole)

    def _beside(self, found, tasks, out):
        """Complete a comparison and its files by bounds; the last is False after an interruption."""
        from jexplore.studies.bounds.bound import run_bounds

        files, is_whole = {}, not found.interrupted
        if tasks and is_whole and not out.was_finished:
            try:
                with working(len(tasks), "starts") as on_progress:
                    how = {"ledger": out.ledger, "first": out.units - len(tasks), "workers": self.workers}
                    bounds = run_bounds(tasks, **how, on_progress=on_progress)
                is_whole = not bounds.interrupted
                found = dataclasses.replace(found, episodes=bounds.beside(found))
                files["bounds.parquet"] = bounds.table
            except KeyboardInterrupt:  # before the first: the comparison is there
                is_whole = False
        return found, files, is_whole


def _more_tables(episodes, league):
    """Format the table of bounds, if episodes have their columns: text; a league's by strategy."""
    from jexplore.studies.bounds import beside
    from jexplore.studies.results.columns import RATIO_COLUMNS

    if RATIO_COLUMNS[0] not in episodes:
        return ""
    table = beside.beside_table(episodes, ["strategy"] if league else ["world", "strategy"])
    return f"\nCompared with the shortest walks of one that knows the map:\n\n{table}"


def run_with_bar(options: Any, jobs: "Sequence[Job]", out: Out, starts: "Sequence[BoundTask]" = ()) -> Any:
    """Compile and run the unfinished part, with a note and a bar; read the results of a finished run.

    `starts` are bounded afterwards, as the last units of the run.
    """
    from jexplore.studies.results import comparison, loading, provenance, units

    asked = provenance.asked(jobs)
    asked |= {"bound_seconds": starts[0].seconds if starts else None} if hasattr(options, "bounds") else {}
    ledger = out.keep(asked, lambda n: len(units.cut_jobs(jobs, n)) + len(starts))
    if ledger is None:
        return loading.load(out.run.path)
    how = {"ledger": ledger, **fields_of(options, "engine lanes workers")}
    with working(sum(len(job.starts) for job in jobs), "episodes") as on_progress:
        return comparison.run_comparison(jobs, **how, on_progress=on_progress)


def finish_comparison(
    out: Out, found: "ComparisonResult", text: str, figures: "Mapping[str, Callable[[], Figure]]",
    entries: Mapping[str, Any], jobs: "Sequence[Job] | None" = None, more: Mapping[str, Any] = MappingProxyType({}), *,
    is_whole: bool = True,
) -> int:  # fmt: skip
    """Write, print and draw the common output of comparisons and reproductions; return the exit status.

    `entries` are more ones of run.json, `more` files besides: name -> content.
    """
    from jexplore.studies.results import loading, saving

    is_whole = is_whole and not found.interrupted
    if out.was_finished:
        page = loading.run_record(out.run.path)
    else:
        page = out.record(**entries, **saving.entries_of(found), **found.record)
    files = {**saving.comparison_files(found), **more}
    text += "".join(f"warning: {line}\n" for line in found.warnings)
    tables = functools.partial(saving.tables_of, found)
    pictures = saving.pictures_of(figures, page, tables, jobs if is_whole else None)
    return out.finish(page, files, text, pictures, interrupted=not is_whole)


@dataclasses.dataclass(frozen=True)
class Reproduce(EngineOptions, ResumeOptions, TimedOptions):
    """Reproduce a paper's tables: its strategies in its environments, next to its own figures.

    Prints a Markdown table an environment, and which orderings of the paper's means hold here. Writes episodes.parquet
    and run.json.
    """

    paper: Positional[str] = "holz2010"
    """Reproduce this paper: holz2010 (Holz, Basilico, Amigoni, Behnke 2010)."""
    maps: str | None = None
    """Read the paper's maps from this folder: stage/cave_filled.png, avz/avz5floor_open.yaml,
    stage/hospital_section.png. By default built-in counterparts stand in for them."""
    episodes: int = dataclasses.field(default_factory=lambda: 5 if is_small() else 100)
    """Number of episodes of each strategy in each environment. The first ones, as many as in the paper, are also
    reported alone."""
    seed: int = 0
    """Draw starts and all that is random from this seed."""

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Run the command and return the exit status, None for 0."""
        from jexplore.studies import reproduction

        with Out(self, arguments) as out:
            settings = fields_of(self, "maps episodes seed cell_m lidar rules robot")
            jobs = reproduction.prepare_paper(self.paper, **settings)
            found = run_with_bar(self, jobs, out)
            with note_if_slow(FINISHING):
                if not out.was_finished:
                    found = reproduction.reproduction_of(self.paper, self.maps, found)
                tables, orderings = (table.to_dict("records") for table in (found.tables, found.orderings))
                entries = {"notes": found.notes, "tables": tables, "orderings": orderings}
                return finish_comparison(out, found.comparison, found.to_markdown(), {}, entries)
