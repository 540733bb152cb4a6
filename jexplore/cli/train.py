"""The commands `jexplore train` and `jexplore tune`."""

import dataclasses
from collections.abc import Sequence

from jexplore.cli.options import OutOptions, ResumeOptions, RobotOptions, WorkerOptions, fields_of
from jexplore.cli.output.console import Out, note_if_slow, working


@dataclasses.dataclass(frozen=True)
class Train(WorkerOptions, ResumeOptions, RobotOptions):
    """Train a strategy that scores frontier clusters, and write its model.

    Prints the checks and writes model.msgpack, model.json, curve.parquet, curve.png and run.json. The model is a
    strategy: learned+recheck:path=DIR/model.msgpack. Checked rounds are stored on the way: --resume continues training
    that was ended.
    """

    algo: str = "es"
    """Train by evolution strategies (es) or proximal policy optimisation (ppo)."""
    network: str = "linear"
    """Train a weighted sum of the features (linear) or a small network with attention over the clusters (attention)."""
    model: str | None = None
    """Begin at this model instead of closest; a linear one for any network, another for its own."""
    worlds: tuple[str, ...] | None = None
    """Train in these worlds (default: eight of each kind of generator, #1000 to #1007)."""
    validation: tuple[str, ...] | None = None
    """Watch on these worlds (default: four of each kind, #2000 to #2003)."""
    starts: int = 1
    """Number of starts in each."""
    rounds: int = 40
    """Number of training rounds."""
    check_every: int = 5
    """Rounds between checks on the validation worlds, the last at the end; the best model by these checks is written.
    """
    set: tuple[str, ...] = ()
    """Settings of the algorithm, such as pairs=8 episodes=20 sigma=0.1 rate=0.05 of es; an unknown one lists all."""
    measure: str = "path_m"
    """Make this small: a column of the table of episodes such as path_m_at_95, area_m or time_s; for ppo path_m."""
    seed: int = 0
    """Draw all that is random from this seed."""

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Run the command and return the exit status, None for 0."""
        from jexplore.engine.backend import use_compilation_cache
        from jexplore.learn import bank, training
        from jexplore.learn.settings import parse_settings, require_rounds, trainer_settings
        from jexplore.policies.learned.model import load_model

        with Out(self, arguments) as out:
            settings = parse_settings(self.set)
            trainer_settings(self.algo, settings)  # before worlds are built, which takes seconds
            require_rounds(self.rounds, self.check_every)
            model = None if self.model is None else load_model(self.model)
            use_compilation_cache()
            with note_if_slow("jexplore: loading worlds"):
                how = fields_of(self, "cell_m lidar rules measure")
                worlds = bank.prepare_bank(bank.TRAINING if self.worlds is None else self.worlds, **how)
                watched = bank.prepare_bank(bank.VALIDATION if self.validation is None else self.validation, **how)
            plan = training.prepare_training(
                self.algo,
                self.network,
                worlds,
                watched,
                settings,
                **fields_of(self, "rounds check_every starts seed"),
                model=model,
            )
            ledger = out.keep(training.training_inputs(plan), plan.units)
            if ledger is None:
                return out.finish({}, {}, "")
            with working(plan.rounds, "rounds") as on_progress:
                found = training.run_training(plan, ledger=ledger, workers=self.workers, on_progress=on_progress)
            return _finish_training(out, found, plan)


@dataclasses.dataclass(frozen=True)
class Tune(WorkerOptions, OutOptions, RobotOptions):
    """Choose settings of strategies by one budget for all: the same number of trials in the same worlds.

    Settings are drawn at random within their bounds. All trials run in few worlds, the better half of them in twice as
    many, and so on; the defaults run in all. Prints the choices and writes tuned.json, for the option --tuned of
    `jexplore compare`, trials.parquet and run.json.
    """

    strategies: tuple[str, ...] | None = None
    """Tune these strategies; settings that a name gives stay (default: the league's that have settings)."""
    trials: int = 16
    """Number of settings that are drawn for each strategy, besides its defaults."""
    world_seeds: int = 4
    """Number of worlds of each of six kinds in the last round, #1000 and on, from one start each."""
    measure: str = "path_m"
    """Make this small: a column of the table of episodes such as path_m_at_95, area_m or time_s."""
    seed: int = 0
    """Draw settings, starts and all that is random from this seed."""

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Run the command and return the exit status, None for 0."""
        from jexplore.engine.backend import use_compilation_cache
        from jexplore.learn import bank, tuning
        from jexplore.studies.statistics.league import league_worlds

        with Out(self, arguments) as out:
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
            files = {"tuned.json": page, "trials.parquet": tuning.trials_table(searches)}
            return out.finish(out.record(worlds=own.worlds), files, tuning.tuning_table(searches, worlds))


def _finish_training(out, found, plan):
    from jexplore.policies.learned.model import write_page, write_weights

    interrupted = found.ended == "interrupted"
    command = ["jexplore", *out.arguments]
    model = found.model._replace(made={"command": command, **found.model.made})
    entries = {"ended": found.ended, "best": found.best, "interrupted": int(interrupted)}
    record = out.record(**entries, model=model.made, worlds=[*plan.training.worlds, *plan.validation.worlds])
    files = {
        "model.msgpack": lambda path: write_weights(path, model),
        "model.json": lambda path: write_page(path, model),
        "curve.parquet": found.curve,
    }
    lines = [
        f"round {row['round']:>5}: {row['validation']:.3f} of closest+recheck on the validation worlds"
        + ("  <- kept" if row["round"] == found.best else "")
        for row in found.curve.dropna(subset=["validation"]).to_dict("records")
    ]
    if found.ended == "not finite":
        lines.append("warning: the weights became no finite numbers; the best ones before are written")
    return out.finish(record, files, "\n".join(lines), {"curve.png": found.figure}, interrupted=interrupted)
