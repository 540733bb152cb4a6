"""The folder of a comparison: its files, pictures and page, as the command and the functions write them."""

import contextlib
import functools
import os
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from jexplore.arrays.files import first_line
from jexplore.config import InputError, InputWarning
from jexplore.engine.runner import Costs
from jexplore.exploration.batch import Job, Outcomes
from jexplore.exploration.results import to_occupancy
from jexplore.report import folders, plot, store
from jexplore.report.page.report import write_report
from jexplore.report.plots.standings import league_figure
from jexplore.studies.replays import replays_of
from jexplore.studies.results import provenance
from jexplore.studies.statistics.by_world import markdown_table
from jexplore.studies.statistics.league import standings_table
from jexplore.studies.statistics.paired import MIN_PAIRS
from jexplore.worlds.names import file_names, short_names
from jexplore.worlds.readers.ros import write_ros

DETAILS = "details.npz"
VECTORS = (
    "compare.png",
    "coverage.png",
    "league.png",
    "reproduce.png",
    "sweep.png",
    "sweep-map.png",
)  # written as SVG as well


def write_details(found: Any, path: Path) -> None:
    """Write worlds, first episodes, progress, ways, maps: parts of a result outside its table of episodes."""
    arrays: dict[str, Any] = {}
    for i, world in enumerate(found.worlds):
        arrays[f"world/{i}/occupied"] = world.occupied
        arrays[f"world/{i}/cell_m"] = np.float64(world.cell_m)
        arrays[f"world/{i}/origin_m"] = np.asarray(world.origin_m, np.float64)
        arrays[f"world/{i}/name"] = np.str_(os.fspath(world.name))
        if world.rooms is not None:
            arrays[f"world/{i}/rooms"] = world.rooms
        if world.start is not None:
            arrays[f"world/{i}/start"] = np.asarray(world.start, np.int64)
        for k, seen in enumerate(found.first.get(world.name, [])):
            at = f"first/{i}/{k}"
            arrays[f"{at}/strategy"] = np.str_(seen.strategy)
            arrays[f"{at}/state"], arrays[f"{at}/rows"], arrays[f"{at}/cols"] = seen.state, seen.rows, seen.cols
            arrays[f"{at}/path_m"] = np.float64(seen.path_m)
    if found.progress:
        arrays["progress"] = np.concatenate(list(found.progress.values()))
    for k, pair in enumerate(found.progress):
        if pair in found.paths:
            ways = found.paths[pair]
            arrays[f"ways/{k}"], arrays[f"ways/{k}/length"] = np.concatenate(ways), [len(way) for way in ways]
        if pair in found.maps:
            arrays[f"maps/{k}"] = found.maps[pair]
    np.savez_compressed(path, **arrays)


def write_maps(found: Any, folder: Path) -> list[Path]:
    """Write the maps of a result as yaml files with a picture each: `ComparisonResult.save_maps`."""
    short = dict(zip([world.name for world in found.worlds], short_names([world.name for world in found.worlds])))
    of_name, texts, made = {world.name: world for world in found.worlds}, [], []
    for (world, strategy), states in found.maps.items():
        own = found.episodes[(found.episodes["world"] == world) & (found.episodes["strategy"] == strategy)]
        texts += [f"{short[world]}-{strategy}-{number}" for number in own["episode"]]
        made += [(of_name[world], state) for state in states]
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"{name}.yaml" for name in file_names(texts)]
    for file, (world, state) in zip(files, made):
        write_ros(to_occupancy(state), file, cell_m=world.cell_m, origin_m=world.origin_m)
    return files


def figures_of(found: Any, *, league: bool = False) -> dict[str, Callable[[], Any]]:
    """Return pictures of a `ComparisonResult`: name of a file -> function that draws it."""
    if league:
        return {"league.png": lambda: league_figure(found.standings)}
    figures = {"compare.png": found.compare_figure, "coverage.png": found.coverage_figure}
    figures |= {"waste.png": found.waste_figure} if found.paths else {}
    # Without any episode 0, as after an early interruption, there is no path to draw.
    return figures | ({"paths.png": found.paths_figure} if found.first else {})


def comparison_files(
    found: Any, record: Mapping[str, Any], more: Mapping[str, Callable[[Path], Any]] = MappingProxyType({})
) -> dict[str, Callable[[Path], Any]]:
    """Return files of a `ComparisonResult`, and more: name -> writer. `record`: content of run.json."""
    return {
        "episodes.parquet": lambda path: store.write_parquet(found.episodes, path),
        DETAILS: lambda path: write_details(found, path),
        **more,
        "run.json": lambda path: store.write_json(record, path),
    }


def pictures_of(
    found: Any,
    firsts: Mapping[int, Outcomes],
    record: Mapping[str, Any],
    figures: Mapping[str, Callable[[], Any]],
    jobs: Sequence[Job] | None,
) -> dict[str, Callable[[Path], Any]]:
    """Return pictures of a `ComparisonResult` and its page: name -> writer.

    `figures` are name -> what draws it; `jobs` are those whose first episodes the page replays, None for no page.
    """
    drawn = picture_writers(figures)
    if jobs is not None:
        drawn["report.html"] = functools.partial(_page, found, firsts, record, jobs, list(drawn))
    return drawn


def picture_writers(figures: Mapping[str, Callable[[], Any]]) -> dict[str, Callable[[Path], Any]]:
    """Return what writes pictures, `VECTORS` as SVG as well, from what draws them."""
    return {name: functools.partial(_picture, make) for name, make in figures.items()}


def _picture(make, path):
    figure = make()
    plot.save_figure(figure, path)
    if path.name in VECTORS:
        plot.save_figure(figure, path.with_suffix(".svg"))


def _page(found, firsts, record, jobs, names, path):
    """Write the page of a comparison."""
    engine = "jax" if record["engine"] == "jax" else "auto"
    replays, notes = replays_of(jobs, firsts, engine=engine) if jobs else ([], [])
    tables = [("In each world", markdown_table(found.summary))]
    if len(found.worlds) >= MIN_PAIRS:
        tables.insert(0, ("Over all worlds", standings_table(found.standings)))
    write_report(path, record, tables, names, replays, notes)


def entries_of(found: Any) -> dict[str, Any]:
    """Return the entries of run.json for a `ComparisonResult`."""
    return {
        "episodes_per_s": found.episodes_per_s,
        "compile_s": found.compile_s,
        "run_s": found.run_s,
        "interrupted": found.interrupted,
        "resumed": found.resumed,
        "worlds": [provenance.describe_world(world) for world in found.worlds],
        "summary": found.summary.to_dict("records"),
        "warnings": found.warnings,
    }


def engine_of(costs: Costs) -> dict[str, Any]:
    """Return what run.json says of the engine."""
    return {
        "engine": costs.engine,
        "levels": costs.levels,
        "why_not_native": costs.why_not,
        "devices": costs.devices,
        "lanes": costs.lanes,
    }


def write_comparison(run: folders.RunFolder, found: Any, *, report: bool = True) -> Path:
    """Write the files and pictures of a `ComparisonResult` into a claimed folder; return its path.

    Warns:
      InputWarning: a picture that could not be drawn.
    """
    how = {"environment": {**store.environment(), "commit": provenance.package_commit()}}
    record = how | dict(found.made.record) | entries_of(found)
    run.write(comparison_files(found, record), is_finished=not found.interrupted)
    jobs = (() if found.interrupted else found.made.jobs) if report else None
    for name, draw in pictures_of(found, found.made.firsts, record, figures_of(found), jobs).items():
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


def save(found: Any, folder: str | os.PathLike[str], *, overwrite: bool, report: bool) -> Path:
    """Save a comparison: `ComparisonResult.save`."""
    if not found.made.record:
        raise InputError("only what jx.compare or jx.load returned can be saved; to_csv() writes the table alone")
    with claimed_by_call(folder, overwrite=overwrite) as run:
        return write_comparison(run, found, report=report)
