"""The command `jexplore bench`."""

import dataclasses
from collections.abc import Sequence

from jexplore.cli.options import OutOptions, fields_of
from jexplore.cli.output.console import Out, progress_of


@dataclasses.dataclass(frozen=True)
class Bench(OutOptions):
    """Measure episodes on this machine.

    Whole episodes by engine and batch size, and compiling. Runs on one core, or on the first accelerator.
    Prints Markdown tables and writes bench.json and run.json. A quiet machine gives good figures.
    """

    worlds: tuple[str, ...] | None = None
    """Run episodes in these worlds, named as for `jexplore compare` (default: cave office hospital)."""
    strategies: tuple[str, ...] | None = None
    """Measure these strategies (default: closest+recheck)."""
    batch_sizes: tuple[int, ...] | None = None
    """Run this number of episodes, or of lanes of the engine jax on an accelerator (default: 1 4 16 64; up to 4096
    lanes)."""
    engine: tuple[str, ...] | None = None
    """Measure these engines: auto, jax or both, as for `jexplore compare` (default: both)."""
    repeat: int | None = None
    """Repetitions of every measurement (default: 5)."""
    quick: bool = False
    """Take smaller defaults: the cave, batches of 1 and 4, 2 turns."""
    cache: bool = False
    """Use compiled programs that earlier commands have kept: times of compiling are then those of loading."""

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Run the command and return the exit status, None for 0."""
        from jexplore import bench
        from jexplore.bench import tables

        with Out(self, arguments) as out:
            plan = bench.prepare_bench(**fields_of(self, "worlds strategies engine batch_sizes repeat quick"))
            with progress_of(len(plan.jobs), "measurements") as update:
                update(0)
                report = bench.run_bench(plan, cache=self.cache, on_progress=update)
            record = out.record(measured=report["settings"])
            return out.finish(record, {"bench.json": report}, tables.bench_tables(report))
