"""The folder of a comparison: its files, pictures and page, as the command and the functions write them."""

import contextlib
import functools
import os
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from jexplore.arrays.files import first_line
from jexplore.config import InputError, InputWarning
from jexplore.exploration.batch import Job
from jexplore.report import folders, store
from jexplore.report.page.report import write_report
from jexplore.report.plots.compare import league_figure
from jexplore.studies.replays import replays_of
from jexplore.studies.results import provenance
from jexplore.studies.results.details import DETAILS, details_of
from jexplore.studies.statistics import figures
from jexplore.studies.statistics.by_world import markdown_table
from jexplore.studies.statistics.coverage import coverage_tables
from jexplore.studies.statistics.league import standings_table
from jexplore.studies.statistics.paired import MIN_PAIRS


def figures_of(found: Any, *, league: bool = False) -> dict[str, Callable[[], Any]]:
    """Return pictures of a `ComparisonResult`: name of a file -> function that draws it."""
    if league:
        return {
            "coverage.png": lambda: figures.league_coverage_figure(found.episodes, found.progress, found.standings),
            "league.png": lambda: league_figure(found.standings),
        }
    drawn = {"coverage.png": found.coverage_figure, "compare.png": found.compare_figure}
    # Without any episode 0, as after an early interruption, there is no path to draw.
    return drawn | ({"paths.png": found.paths_figure} if found.first else {})


def comparison_files(found: Any) -> dict[str, Any]:
    """Return files of a `ComparisonResult`, without run.json: name -> content."""
    return {"episodes.parquet": found.episodes, DETAILS: details_of(found)}


def pictures_of(
    figures: Mapping[str, Callable[[], Any]], record: Mapping[str, Any],
    tables: Callable[[], Sequence[tuple[str, str]]], jobs: Sequence[Job] | None, labels: Sequence[str] = (),
) -> dict[str, Any]:  # fmt: skip
    """Return pictures and the page of a run: name -> content.

    `figures` are name -> function that draws it, `record` the content of run.json, `tables` a function that returns the
    tables of the page, each with its heading. The page replays the first episodes of `jobs`; None for no page. `labels`
    are as of `replays.replays_of`.
    """

    def page(path):
        engine = "jax" if record["engine"] == "jax" else "auto"
        replays, notes = replays_of(jobs or (), labels=labels, engine=engine)
        write_report(path, record, tables(), list(figures), replays, notes)

    return dict(figures) if jobs is None else {**figures, "report.html": page}


def tables_of(found: Any) -> list[tuple[str, str]]:
    """Return the tables of a `ComparisonResult` for its page, each with its heading."""
    tables = [("In each world", markdown_table(found.summary))]
    if len(found.worlds) >= MIN_PAIRS:
        tables.insert(0, ("Over all worlds", standings_table(found.standings)))
    return tables + list(coverage_tables(found.at_coverage).items()) if len(found) > 1 else tables


def entries_of(found: Any) -> dict[str, Any]:
    """Return the entries of run.json for a `ComparisonResult`."""
    names = "episodes_per_s", "compile_s", "run_s", "interrupted", "resumed"
    return {
        **{name: getattr(found, name) for name in names},
        "worlds": [provenance.describe_world(world) for world in found.worlds],
        "summary": found.summary.to_dict("records"),
        "warnings": found.warnings,
    }


def write_comparison(run: folders.RunFolder, found: Any, *, report: bool = True) -> Path:
    """Write the files and pictures of a `ComparisonResult` into a claimed folder; return its path.

    Warns:
      InputWarning: a picture that could not be drawn.
    """
    how = {"environment": {**store.environment(), "commit": provenance.package_commit()}}
    record = how | dict(found.record) | entries_of(found)
    run.write({**comparison_files(found), "run.json": record}, is_finished=not found.interrupted)
    jobs = (() if found.interrupted else found.jobs) if report else None
    tables = functools.partial(tables_of, found)
    for name, draw in pictures_of(figures_of(found), record, tables, jobs).items():
        try:
            run.add(name, draw)
        except Exception as error:  # a picture less costs no results
            warnings.warn(f"{name} could not be drawn: {first_line(error)}", InputWarning, stacklevel=3)
    return run.path


@contextlib.contextmanager
def claimed_by_call(
    path: str | os.PathLike[str], *, overwrite: bool, resume: bool | None = None
) -> Iterator[folders.RunFolder]:
    """Claim a folder for a function, `resume` None for one that cannot: errors name arguments, not options."""
    try:
        with folders.claimed(os.path.expanduser(path), overwrite=overwrite, resume=bool(resume)) as run:
            yield run
    except InputError as error:
        text = str(error).replace("go on with it (--resume), ", "") if resume is None else str(error)
        raise InputError(re.sub(r"--(overwrite|resume|trust)\b", r"\1=True", text)) from None
