"""The command `jexplore compare`, and what it shares with `reproduce`."""

import dataclasses
import functools
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

from jexplore.cli.console import Out, note, say, working
from jexplore.cli.listings import describe
from jexplore.cli.options import STRATEGIES, EngineName, OutFolder, OwnNames, default_worlds, is_small
from jexplore.config import InputError, Lidar, Rules

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from jexplore.exploration.batch import Finished, Job
    from jexplore.studies.comparison import Comparison

FINISHING = "jexplore: computing statistics and drawing"


def default_episodes() -> int:
    return 5 if is_small() else 20


@dataclasses.dataclass(frozen=True)
class Compare:
    """Compare strategies in worlds, all from the same starts.

    Prints a Markdown table and writes episodes.parquet, run.json, compare.png and paths.png.
    """

    worlds: OwnNames = None
    """Worlds: names of generators such as cave#3, or map files; see `jexplore worlds` (default: cave office
    hospital)."""
    strategies: OwnNames = None
    """Strategies; the others are compared with the first. See `jexplore strategies` (default: closest closest+recheck
    random)."""
    episodes: int = dataclasses.field(default_factory=default_episodes)
    """Episodes of each strategy in each world."""
    seed: int = 0
    """Seed of starts and draws."""
    cell_m: float = 0.1
    """Edge of a cell, metres."""
    start: Literal["random", "world"] = "random"
    """Starts drawn from the seed, or every world's own start for all episodes."""
    league: bool = False
    """Every strategy in 48 worlds of six kinds (in cells over 0.2 m: 40 of five), unless --worlds and --strategies say
    otherwise: prints who ranks where over all worlds, and what a plan costs, and writes league.png instead of the
    pictures of single worlds."""
    engine: EngineName = "auto"
    """How episodes run: one after the other on each core, or many in lockstep, as suits a GPU. The results are equal.
    By default what suits the machine."""
    lanes: int | None = None
    """Episodes at a time in lockstep; by default as many as the memory holds."""
    out: OutFolder = None
    """Folder to write."""
    overwrite: bool = False
    """Replace the run that the folder holds."""
    lidar: Lidar = dataclasses.field(default_factory=Lidar)
    rules: Rules = dataclasses.field(default_factory=Rules)

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Runs the command; returns the exit status, None for 0."""
        from jexplore.studies.comparison import assemble, prepare_jobs
        from jexplore.studies.league import LEAGUE_STRATEGIES, league_worlds

        out = Out(self, "compare")
        worlds, strategies = (
            (league_worlds(self.cell_m), LEAGUE_STRATEGIES) if self.league else (default_worlds(), STRATEGIES)
        )
        worlds = worlds if self.worlds is None else self.worlds
        strategies = strategies if self.strategies is None else self.strategies
        self = dataclasses.replace(self, worlds=worlds, strategies=strategies)
        jobs = prepare_jobs(
            worlds,
            strategies,
            episodes=self.episodes,
            seed=self.seed,
            cell_m=self.cell_m,
            start=self.start,
            lidar=self.lidar,
            rules=self.rules,
        )
        report = run_with_bar(self, jobs)
        with note(FINISHING):
            found = assemble(jobs, report, self.rules)
            if self.league:
                return _finish_league(out, found, report, functools.partial(out.record, arguments, self))
            # Without any episode 0, as after an early interruption, there is no path to draw.
            figures = {"compare.png": found.compare_figure()} | (
                {"paths.png": found.paths_figure()} if found.first else {}
            )
            record = functools.partial(out.record, arguments, self)
            return finish(out, found, report, found.to_markdown(), figures, record)


def _finish_league(out, found, report, record):
    """Measures what a plan costs, and writes and prints the standings. Returns the exit status."""
    from jexplore.bench.plans import plan_costs
    from jexplore.report import plot_league
    from jexplore.studies.league import standings_table

    world, names, plan_ms = found.worlds[0], list(dict.fromkeys(found.episodes["strategy"])), {}
    if not report.costs.interrupted:
        try:
            with note("jexplore: measuring what a plan costs; Ctrl-C leaves that out"):
                plan_ms = plan_costs(world, names)
        except (InputError, KeyboardInterrupt):
            print("warning: what a plan costs could not be measured", file=sys.stderr)
    text = standings_table(found.standings, plan_ms)
    if plan_ms:
        text += (
            f"\nms a plan: on one core, in {world.name}, {world.shape[1]} x {world.shape[0]} cells, every strategy on\n"
        )
        text += "the same maps, with the default scanner and rules\n"
    record = functools.partial(record, standings=found.standings.to_dict("records"), plan_ms=plan_ms)
    return finish(out, found, report, text, {"league.png": plot_league.figure(found.standings)}, record)


def run_with_bar(options: Any, jobs: "Sequence[Job]") -> "Finished":
    """Compiles and runs, with a note and a bar: a `batch.Finished`."""
    from jexplore.engine.backend import use_compilation_cache
    from jexplore.exploration import batch

    use_compilation_cache()
    engine = None if options.engine == "auto" else options.engine
    with working(sum(len(job.starts) for job in jobs), "episodes") as on_progress:
        return batch.run_jobs(
            jobs, options.lidar, options.rules, engine=engine, lanes=options.lanes, on_progress=on_progress
        )


def finish(
    out: Out,
    found: "Comparison",
    report: "Finished",
    text: str,
    figures: "Mapping[str, Figure]",
    record: Callable[..., Any],
) -> int:
    """Writes and prints what comparisons and reproductions have in common. Returns the exit status.

    Args:
      out: `Out`.
      found: `Comparison`.
      report: `batch.Finished`.
      text: the tables.
      figures: `{name: Figure}`.
      record: called with more entries of run.json, returns all.
    """
    from jexplore.report import plot, store

    costs = report.costs
    record = record(
        episodes_per_s=found.episodes_per_s,
        compile_s=found.compile_s,
        run_s=found.run_s,
        engine=costs.engine,
        devices=costs.devices,
        lanes=costs.lanes,
        useful=costs.useful,
        useful_plans=costs.useful_decisions,
        interrupted=found.interrupted,
        worlds=[describe(world) for world in found.worlds],
        summary=found.summary.to_dict("records"),
        warnings=found.warnings,
    )
    wrote = out.write(
        {
            "episodes.parquet": lambda path: store.write_parquet(found.episodes, path),
            **{name: functools.partial(plot.save_figure, figure) for name, figure in figures.items()},
            "run.json": lambda path: store.write_json(record, path),
        }
    )
    print(text)
    for line in found.warnings:
        print(f"warning: {line}")
    print(wrote)
    if costs.interrupted:
        return say("jexplore: interrupted, what was finished was written", 130)
    return 0
