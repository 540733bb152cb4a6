"""The commands `jexplore sweep` and `jexplore merge`."""

import dataclasses
import os
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from tyro.conf import Positional

from jexplore.cli.compare import FINISHING
from jexplore.cli.options import EngineOptions, ReportOptions, ResumeOptions, TrustOptions, fields_of
from jexplore.cli.output.console import Out, note_if_slow, working
from jexplore.config import InputError

if TYPE_CHECKING:
    from jexplore.studies.sweeps.run import SweepResult

PRINTED_ROWS = 24  # of the summary
REPORTED_ROWS = 200  # of the summary, on the page


@dataclasses.dataclass(frozen=True)
class SweepCommand(EngineOptions, ReportOptions, ResumeOptions, TrustOptions):
    """Compare strategies over many settings of scanner, rules, worlds and parameters.

    Reads the varied settings from a YAML file, in which a list is an axis of the product: worlds: [cave, office],
    strategies: [closest, closest+recheck], episodes: 20, lidar: {range_m: [4, 8]}, rules: {clearance_m: [0.2, 0.3]}.
    Prints a table and writes episodes.parquet (a row an episode, settings as columns), summary.csv, asked.yaml,
    run.json and sweep.png. Finished units are stored on the way: --resume continues a run that was ended in any way.
    """

    spec: Positional[str] = ""
    """File with the varied settings (required)."""
    dry_run: bool = False
    """Only say how much work it is: episodes, units, compiled programs."""
    shard: str | None = None
    """Make only part I/N (1/4 to 4/4), each in a folder of its own; `jexplore merge` puts the parts together."""

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Run the command and return the exit status, None for 0."""
        from jexplore.studies.results.loading import load, run_record
        from jexplore.studies.sweeps import plan as plans
        from jexplore.studies.sweeps.run import run_sweep
        from jexplore.studies.sweeps.spec import read_spec

        if not self.spec:
            raise InputError("expected a file that says what is varied: jexplore sweep SPEC.yaml")
        shard = shard_of(self.shard)
        with note_if_slow("jexplore: loading worlds"):
            plan = plans.prepare_sweep(read_spec(self.spec))
        numbers = plans.in_shard(len(plan.units), shard)
        if not numbers:
            raise InputError(f"--shard {self.shard}: the sweep has only {len(plan.units)} units; use fewer parts")
        if self.dry_run:
            print("\n".join(plans.summary_lines(plan, numbers)))
            return 0
        with Out(self, arguments) as out:
            ledger = out.keep(plan.asked(shard), lambda n: len(dataclasses.replace(plan, after=n).units), shard)
            if ledger is None:
                found = load(out.run.path)
                text, pictures = found.to_markdown(PRINTED_ROWS), _pictures(out, found, run_record(out.run.path), plan)
                return out.finish({}, {}, text, pictures)
            total = sum(plan.units[number].n for number in numbers)
            how = fields_of(self, "engine lanes workers")
            with working(total, "episodes") as on_progress:
                found = run_sweep(plan, ledger=ledger, shard=shard, **how, on_progress=on_progress)
            with note_if_slow(FINISHING):
                return _finish(out, found, plan)


def shard_of(text: str | None) -> tuple[int, int] | None:
    """Parse `I/N` to `(i, n)`, i from 0; None for None."""
    if text is None:
        return None
    match = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text)
    if match is None or not 1 <= int(match[1]) <= int(match[2]):
        raise InputError(f"--shard must be I/N with I from 1 to N, such as 1/4, got {text!r}")
    return int(match[1]) - 1, int(match[2])


def _pictures(out, found, record, plan):
    """Return pictures of a sweep and its page: name -> content."""
    from jexplore.studies.results.saving import pictures_of
    from jexplore.studies.sweeps.run import labels_of, summary_table

    jobs, labels = None, ()
    if out.options.report and not found.missing:
        jobs, settings = zip(*plan.first_jobs())
        labels = labels_of(settings)
    rows = len(found.summary)
    heading = "Every setting" if rows <= REPORTED_ROWS else f"The first {REPORTED_ROWS} of {rows} rows of summary.csv"

    def tables():
        return [(heading, summary_table(found.summary.head(REPORTED_ROWS), found.varied))]

    return pictures_of(found.figures(), record, tables, jobs, labels=labels)


def _finish(out: Out, found: "SweepResult", plan: Any, **entries: Any) -> int:
    """Write, print and draw; return the exit status."""
    from jexplore.arrays.plain_yaml import dump
    from jexplore.studies.sweeps.spec import plain_spec

    costs = found.costs
    ran = len(found.episodes) - found.resumed
    record = out.record(
        episodes_per_s=ran / costs.run_s if costs.run_s else None,
        costs=costs,
        interrupted=found.missing,
        resumed=found.resumed,
        columns=found.columns,
        reference=found.reference,
        worlds=plan.worlds,
        **entries,
    )
    spec = dump(plain_spec(found.spec))
    files = {"episodes.parquet": found.episodes, "summary.csv": found.summary, "asked.yaml": spec}
    text = found.to_markdown(PRINTED_ROWS)
    text += f"warning: {found.missing} episodes are missing\n" if found.missing else ""
    pictures = _pictures(out, found, record, plan)
    return out.finish(record, files, text, pictures, interrupted=found.missing > 0)


def _real(folder):
    """Return the path by which a folder is the same however it is written."""
    return os.path.realpath(os.path.expanduser(folder))


@dataclasses.dataclass(frozen=True)
class Merge(ReportOptions, TrustOptions):
    """Put the parts of a sweep together that were made with --shard.

    Writes what the sweep as a whole would have written.
    """

    parts: Positional[tuple[str, ...]] = ()
    """Folders of all the parts (required)."""

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Run the command and return the exit status, None for 0."""
        from jexplore.studies.results.loading import merge

        if self.out is not None:
            folder = _real(self.out)
            part = next((part for part in self.parts if _real(part) == folder), None)
            if part is not None:
                raise InputError(f"--out {self.out} must be a folder of its own, got that of the part {part}")
        with Out(self, arguments, "sweep") as out:
            with note_if_slow("jexplore: reading the parts"):
                found, plan = merge(self.parts, trust=self.trust)
            out.asked, out.units = {"command": "sweep", **plan.asked()}, len(plan.units)
            return _finish(out, found, plan, parts=self.parts)
