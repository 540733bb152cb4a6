"""Results of a run read from its folder again."""

import contextlib
import functools
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from jexplore.arrays.files import first_line, read_json
from jexplore.config import InputError, __version__, checked_names, shown
from jexplore.engine.runner import Costs
from jexplore.report import store
from jexplore.report.folders import UNFINISHED
from jexplore.report.ledger import require_same
from jexplore.rules import Lidar, Rules
from jexplore.studies.reproduction import reproduction_of
from jexplore.studies.results.comparison import ComparisonResult
from jexplore.studies.results.details import read_details
from jexplore.studies.sweeps.plan import SweepPlan, prepare_sweep
from jexplore.studies.sweeps.run import SweepResult, whole_table
from jexplore.studies.sweeps.spec import read_spec

MADE_FROM = ("version", "spec", "episodes", "digests")  # entries of a sweep's settings that must not have changed


@checked_names
def load(path: str | os.PathLike[str]) -> Any:
    """Load the results of a run, from the folder that it has written.

    Args:
      path: folder of a `jexplore` command.

    Returns:
      A `ComparisonResult` for compare, a `ReproductionResult` for reproduce, a `SweepResult` for sweep and merge. For
        trace, segment, bound, explore and worlds a `pandas.DataFrame`: a row a run, a score, a start, the episode, a
        world. For bench the content of bench.json, a dict.

    Raises:
      InputError: no folder of a run, a run that was not finished, a file that is gone or damaged.
    """
    folder = Path(os.path.expanduser(path))
    record = run_record(folder)
    with _as_written(folder, record):
        return _load(folder, record)


def _load(folder, record):
    command = record["command"][1]
    if record.get("asked", {}).get("command") == "sweep":
        return _sweep(folder, record)
    if (folder / "episodes.parquet").is_file():
        return _comparison(folder, record, command)
    for name in ("runs.parquet", "scores.parquet", "bounds.parquet"):
        if (folder / name).is_file():
            return store.read_parquet(folder / name)
    found = record.get({"explore": "result", "worlds": "worlds"}.get(command, ""))
    if found is not None:
        return pd.DataFrame(found if isinstance(found, list) else [found])
    if (folder / "bench.json").is_file():
        return read_json(folder / "bench.json", store.MAX_RECORD_BYTES)
    raise InputError(f"{os.fspath(folder)}: `jexplore {command}` leaves no table to be read")


def run_record(folder: Path) -> dict[str, Any]:
    """Read the run.json of a run."""
    page = folder / "run.json"
    if not page.is_file():
        is_begun = (folder / UNFINISHED).is_dir()
        hint = "; it holds a run that was not finished: go on with --resume" if is_begun else ""
        raise InputError(f"{os.fspath(folder)} must be the folder of a run, with a run.json{hint}")
    record = read_json(page, store.MAX_RECORD_BYTES)
    kinds = {"command": list, "environment": dict, "configuration": dict, "asked": dict}
    parts = {name: kind() for name, kind in kinds.items()} | (record if isinstance(record, dict) else {})
    wrong = next((name for name, kind in kinds.items() if not isinstance(parts[name], kind)), None)
    if wrong or len(parts["command"]) < 2 or not all(isinstance(word, str) for word in parts["command"]):
        wrong = wrong or "command"
        raise InputError(f"{page} must be the record of a run: its {wrong} is {shown(parts[wrong])}")
    return record


@contextlib.contextmanager
def _as_written(folder, record):
    """Explain in one line that a file lacks something, or has something that this version does not know."""
    try:
        yield
    except Exception as error:  # a file may hold anything in anything's place
        written = record.get("environment", {}).get("jexplore")
        by = f"; jexplore {shown(written)} wrote it, this is {__version__}" if written != __version__ else ""
        if isinstance(error, InputError):
            raise (InputError(f"{error}{by}") if by else error) from None
        what = f"there is no {error}" if isinstance(error, KeyError) else first_line(error)
        raise InputError(f"{os.fspath(folder)} must hold a whole run of this version: {what}{by}") from error


def _comparison(folder, record, command):
    episodes, details, worlds = read_details(folder)
    found = ComparisonResult(
        episodes,
        worlds,
        **{name: record[name] for name in ("compile_s", "run_s", "interrupted", "resumed")},
        details=details,
        record=record,
        metrics=tuple(record.get("asked", {}).get("metrics", ())),
        lidar=Lidar(**record["configuration"]["lidar"]),
        rules=Rules(**record["configuration"]["rules"]),
    )
    if command != "reproduce":
        return found
    return reproduction_of(record["configuration"]["paper"], record["configuration"]["maps"], found)


def _sweep(folder, record):
    episodes = store.read_parquet(folder / "episodes.parquet", required=record["columns"])
    costs = Costs(
        compile_s=record["compile_s"] or 0.0,
        run_s=record["run_s"] or 0.0,
        engine=record["engine"],
        levels={name: list(own) for name, own in dict(record["levels"]).items()},
        why_not=list(record["why_not_native"]),
    )
    spec, columns = read_spec(folder / "asked.yaml"), tuple(record["columns"])
    return SweepResult(spec, episodes, columns, costs, record["interrupted"], record["resumed"], record["reference"])


def _require_alike(path, there, here, trust):
    """Refuse a part that was asked something else than the others."""
    try:
        require_same(path, {"asked": there}, {"asked": here}, trust=trust)
    except InputError as error:
        raise InputError(str(error).partition("; choose")[0]) from None


def merge(parts: Sequence[str | os.PathLike[str]], *, trust: bool = False) -> tuple[SweepResult, SweepPlan]:
    """Join the parts of a sweep, from the folders of all of them.

    With `trust` users' strategies and metrics are taken as the same in all parts, even where nothing tells.
    """
    if not parts:
        raise InputError("expected the folders of all parts, got none")
    first, n, tables, places = {}, 0, [], {}
    for part in parts:
        folder = Path(os.path.expanduser(part))
        page = run_record(folder)
        asked = page.get("asked", {})
        shard = re.fullmatch(r"(\d{1,5})/(\d{1,5})", str(asked.get("shard")))
        if asked.get("command") != "sweep" or shard is None:
            raise InputError(f"{part} must hold a part of a sweep, made with --shard")
        if page.get("interrupted"):
            raise InputError(f"{part} holds a part that was not finished: go on with --resume")
        i, n = int(shard[1]), int(shard[2])
        asked = {**asked, "shard": f"one of {n}"}
        first = first or asked
        _require_alike(part, asked, first, trust)
        if i in places:
            raise InputError(f"{part} is part {i}/{n}, and so is {places[i]}")
        places[i] = part
        with _as_written(folder, page):
            tables.append(_sweep(folder, page))
    missing = [f"{i}/{n}" for i in range(1, n + 1) if i not in places]
    if missing:
        raise InputError(f"all parts must be given, and {', '.join(missing)} are not")
    plan = prepare_sweep(tables[0].spec)
    now = store.jsonable(plan.asked())
    _require_alike(parts[0], first, {**first, **{key: now[key] for key in MADE_FROM}}, True)
    table = whole_table([found.episodes for found in tables], plan)
    twice = int(table.duplicated(["setting", "world", "strategy", "episode"]).sum())
    if twice or len(table) != plan.episodes:
        raise InputError(
            f"the parts must hold each episode once: {twice:,} are there twice and "
            f"{plan.episodes - len(table) + twice:,} nowhere, as parts continued with more episodes are cut in another "
            "way: make the part again, or continue all alike"
        )
    costs = functools.reduce(Costs.plus, (found.costs for found in tables))
    return SweepResult(plan.spec, table, tuple(plan.columns), costs, reference=plan.reference), plan
