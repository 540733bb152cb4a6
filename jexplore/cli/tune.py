"""The command `jexplore tune`."""

import dataclasses
from collections.abc import Sequence

from jexplore.cli.options import OutOptions, OwnNames, RobotOptions, fields_of
from jexplore.cli.output.console import Out, note_if_slow, working


@dataclasses.dataclass(frozen=True)
class Tune(OutOptions, RobotOptions):
    """Choose settings of strategies by one budget for all: the same number of trials in the same worlds.

    Settings are drawn at random within their bounds. All trials run in few worlds, the better half of them in twice as
    many, and so on; the defaults run in all. Prints the choices and writes tuned.json, for `jexplore compare --tuned`,
    trials.parquet and run.json.
    """

    strategies: OwnNames = None
    """Tune these strategies; settings that a name gives stay (default: the league's that have settings)."""
    trials: int = 16
    """Number of settings that are drawn for each strategy, besides its defaults."""
    world_seeds: int = 4
    """Number of worlds of each of six kinds in the last round, #1000 and on, from one start each."""
    measure: str = "path_m"
    """Make this small: a column of the table of episodes such as path_m_at_95, area_m or time_s."""
    seed: int = 0
    """Draw settings, starts and all that is random from this seed."""
    cell_m: float = 0.1
    """Make the edge of a cell this long, in metres; above 0.2 m without furnished worlds."""
    workers: int | None = None
    """Number of cores; by default all that this process may use."""

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Run the command and return the exit status, None for 0."""
        from jexplore.engine.backend import use_compilation_cache
        from jexplore.learn import bank, tuning
        from jexplore.report import store
        from jexplore.studies.statistics.league import league_worlds

        with Out(self, "tune") as out:
            names = tuning.ready_spaces(self.strategies)
            worlds = league_worlds(self.cell_m, self.world_seeds, tuning.FIRST_SEED)
            use_compilation_cache()
            with note_if_slow("jexplore: loading worlds"):
                own = bank.prepare_bank(worlds, **fields_of(self, "cell_m lidar rules measure"))
            how = {"trials": self.trials, "seeds": self.world_seeds}
            with working(tuning.episodes_needed(len(names), len(worlds), **how), "episodes") as on_progress:
                how |= fields_of(self, "seed workers")
                searches = tuning.search(names, own, **how, on_progress=on_progress)
            page = {"command": ["jexplore", *arguments], "settings": tuning.chosen_settings(searches)}
            files = {
                "tuned.json": lambda path: store.write_json(page, path),
                "trials.parquet": lambda path: store.write_parquet(tuning.trials_table(searches), path),
            }
            return out.finish(out.record(arguments, self, worlds=worlds), files, tuning.tuning_table(searches, worlds))
