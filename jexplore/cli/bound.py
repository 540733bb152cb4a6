"""The command `jexplore bound`."""

import dataclasses
from collections.abc import Sequence
from typing import Literal

from tyro.conf import Positional

from jexplore.cli.options import ResumeOptions, RobotOptions, WorkerOptions, fields_of
from jexplore.cli.output.console import Out, note_if_slow, working
from jexplore.config import InputError


@dataclasses.dataclass(frozen=True)
class Bound(WorkerOptions, ResumeOptions, RobotOptions):
    """Find how short a robot that knows the map could have driven: what there is to gain for any strategy.

    For each start a walk on which everything is seen, and bounds below which none is. Prints a table and writes
    bounds.parquet, walks.parquet, bounds.png and run.json.
    """

    worlds: Positional[tuple[str, ...]] = ()
    """Worlds, as for `jexplore compare` (required)."""
    starts: int = 5
    """Number of starts to bound in each world: those of the first episodes of `jexplore compare`."""
    seed: int = 0
    """Draw the starts from this seed."""
    seconds: float = 10.0
    """Seconds spent on each start, compiling apart."""
    max_floods: int | None = None
    """Number of shortest-path maps spent on each start instead of seconds: then results are the same everywhere."""
    start: Literal["random", "world"] = "random"
    """Draw the starts from the seed, or take every world's own start."""

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Run the command and return the exit status, None for 0."""
        from jexplore.report import store
        from jexplore.studies.bounds import bound

        if not self.worlds:
            raise InputError("expected worlds: jexplore bound cave maze#3")
        with Out(self, arguments) as out:
            with note_if_slow("jexplore: loading worlds"):
                tasks = bound.prepare_bounds(
                    self.worlds, **fields_of(self, "starts seed cell_m start seconds max_floods lidar rules")
                )
            ledger = out.keep(bound.asked_of_bounds(tasks), len(tasks))
            if ledger is None:
                table = store.read_parquet(out.run.path / "bounds.parquet")
                return out.finish({}, {}, bound.bounds_table(table))
            with working(len(tasks), "starts") as on_progress:
                found = bound.run_bounds(tasks, ledger=ledger, workers=self.workers, on_progress=on_progress)
            entries = {"interrupted": found.interrupted, "settings": found.settings}
            record = out.record(**entries, worlds=found.worlds)
            files = {"bounds.parquet": found.table, "walks.parquet": found.walks}
            pictures = {"bounds.png": found.figure}
            return out.finish(record, files, found.to_markdown(), pictures, interrupted=found.interrupted > 0)
