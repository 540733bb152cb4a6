"""Leagues under a name, which anybody can enter: worlds, starts, scanner, rules and version are fixed.

An entry is a JSON file with one strategy's episodes, taken from the folder of a comparison and checked.
"""

import dataclasses
import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from jexplore.config import InputError, shown, unknown
from jexplore.exploration.state import Outcome
from jexplore.report.store import read_parquet
from jexplore.rules import Lidar, Robot, Rules
from jexplore.studies.statistics.coverage import at_coverage, coverage_text
from jexplore.studies.statistics.league import league_worlds, standings, standings_table
from jexplore.worlds.names import file_names

REFERENCE = "closest+recheck"
"""Strategy that every submission holds: its episodes must equal those entered, and others are compared with it."""
WHOLE = ("episode", "start_row", "start_col", "start_heading_deg")
LENGTHS = (
    *("path_m", "path_m_at_50", "path_m_at_90", "path_m_at_95", "path_m_at_99", "area_m"),
    *("time_s", "time_s_at_50", "time_s_at_90", "time_s_at_95", "time_s_at_99", "area_s", "energy_j"),
)
COLUMNS = ("world", *WHOLE, "outcome", "explored_fraction", *LENGTHS)
"""Columns of an entry's episodes, a row a world; real numbers are rounded to `DECIMALS`."""
DECIMALS = 4


@dataclasses.dataclass(frozen=True)
class League:
    """A league: one episode in each world, with the default scanner, rules and robot, seed 0."""

    version: str  # of this package, with which episodes are made
    worlds: tuple[str, ...]
    digest: str  # SHA-256 of worlds to the bit and starts, in hexadecimal digits: see `digest_of`


LEAGUES = {
    "exploration-240": League(
        "0.1.0", league_worlds(0.1, 40), "6fe35fc556afd555ef58a7b1b94ba845c5694f4fda1adef2e9e71e6aeb271ed0"
    ),
}
"""Name -> league. What changes episodes is a new league with a new name."""


def league_of(name: str) -> League:
    """Return a league by its name."""
    if name not in LEAGUES:
        raise unknown("league", name, list(LEAGUES))
    return LEAGUES[name]


def digest_of(asked: Mapping[str, Any], episodes: pd.DataFrame) -> str:
    """Return SHA-256 of the worlds and starts of a comparison, in hexadecimal digits.

    Scanner, rules and robot are not in it: they must be the defaults, and later versions may have more fields.

    `asked` is as run.json has it; `episodes` are those of one strategy, a row a world, in the order of the worlds.
    """
    own = {key: asked[key] for key in ("worlds", "digests", "episodes", "seed")}
    own["starts"] = episodes[list(WHOLE)].to_numpy(int).tolist()
    return hashlib.sha256(json.dumps(own, sort_keys=True).encode()).hexdigest()


def entries_of(run: Path, name: str) -> list[dict[str, Any]]:
    """Make the entries of all strategies of a comparison, from its folder, for the league of a name."""
    from jexplore.studies.results.loading import run_record

    league, asked = league_of(name), run_record(run).get("asked", {})
    if asked.get("command") != "compare" or "own" not in asked or "digests" not in asked:
        raise InputError(f"{run}: not the folder of a comparison (jexplore compare)")
    records = {"lidar": Lidar(), "rules": Rules(), "robot": Robot()}
    wanted = {"version": league.version, "worlds": list(league.worlds), "episodes": 1, "seed": 0, "teams": None}
    wanted |= {"from_map": None, **{key: dataclasses.asdict(one) for key, one in records.items()}}
    for key, value in wanted.items():
        if (got := asked.get(key)) != (value := json.loads(json.dumps(value))):
            raise InputError(f"{run}: {key} must be as the league's, got other {_difference(value, got)}")
    table, made = read_parquet(run / "episodes.parquet", required=("strategy", *COLUMNS)), []
    if REFERENCE not in set(table["strategy"]):
        raise InputError(f"{run}: {REFERENCE} is missing: every submission runs it too")
    for strategy, own in table.groupby("strategy", sort=False):
        missing = [world for world in league.worlds if world not in set(own["world"])]
        if missing or len(own) != len(league.worlds):
            which = f"{missing[0]} has none" if missing else f"got {len(own)} in {len(league.worlds)} worlds"
            raise InputError(f"{run}: {strategy} must have one episode in each world, {which}")
        own = own.set_index("world").reindex(league.worlds).reset_index()
        if digest_of(asked, own) != league.digest:
            raise InputError(f"{run}: worlds or starts are not those of {name}, though their names and the seed are")
        rows = own[list(COLUMNS)].astype(dict.fromkeys(WHOLE, int)).round(DECIMALS).to_numpy(object).tolist()
        head = {"league": name, "version": league.version, "digest": league.digest, "strategy": strategy}
        _require_rows(f"{run}: {strategy}", rows)
        made.append({**head, "own": asked["own"].get(f"strategy {strategy!r}"), "columns": COLUMNS, "episodes": rows})
    return made


def _difference(wanted, got):
    """Return what differs: names of the fields of a record, members of a list, or the value."""
    if isinstance(wanted, dict) and isinstance(got, dict):
        return ", ".join(key for key in wanted if got.get(key) != wanted[key]) or "fields"
    if isinstance(wanted, list) and isinstance(got, list):
        return ", ".join(sorted({*wanted} ^ {*got})[:1]) or "order"
    return shown(got)


def _require_rows(what, rows):
    """Refuse episodes with another number of columns, numbers that are not finite, or an unknown outcome."""
    for row in rows:
        found = dict(zip(COLUMNS, row))
        numbers = [value for name, value in found.items() if name not in ("world", "outcome")]
        is_whole = len(row) == len(COLUMNS) and all(isinstance(a, int | float) and math.isfinite(a) for a in numbers)
        if not is_whole or found["outcome"] not in Outcome.__members__:
            raise InputError(f"{what}: the episode in {row[0]} must have an outcome and finite numbers")


def submit(run: Path, name: str, folder: Path) -> dict[str, bool]:
    """Enter the strategies of a comparison: write a file to the folder of entries for each that is not there yet.

    Returns strategy -> whether it is new. Those that were there must have the same episodes.
    """
    made = entries_of(run, name)
    before = {entry["strategy"]: entry for entry in read_entries(folder, name)} if folder.is_dir() else {}
    for entry in made:
        old = before.get(entry["strategy"], entry)
        for row, other in zip(entry["episodes"], old["episodes"]):
            if row != other:
                raise InputError(f"{run}: {entry['strategy']} is entered with another episode in {row[0]}: take its "
                                 "file away first, or give the strategy another name")  # fmt: skip
    new = [entry for entry in made if entry["strategy"] not in before]
    folder.mkdir(parents=True, exist_ok=True)
    names = file_names([*before, *(entry["strategy"] for entry in new)])[len(before) :]
    for entry, file in zip(new, names):
        head = ",\n ".join(json.dumps({key: value})[1:-1] for key, value in entry.items() if key != "episodes")
        rows = ",\n  ".join(map(json.dumps, entry["episodes"]))
        (folder / f"{file}.json").write_text(f'{{\n {head},\n "episodes": [\n  {rows}\n ]\n}}\n', encoding="utf-8")
    return {entry["strategy"]: entry in new for entry in made}


def read_entries(folder: Path, name: str) -> list[dict[str, Any]]:
    """Return the entries in a folder, the reference first, then by name."""
    league, found = league_of(name), []
    for path in sorted(folder.glob("*.json")):
        try:
            entry = json.loads(path.read_text(encoding="utf-8"))
            kept = [entry[key] for key in ("league", "version", "digest", "columns")]
            worlds, strategy = [row[0] for row in entry["episodes"]], entry["strategy"]
        except (OSError, ValueError, KeyError, TypeError, IndexError) as error:
            raise InputError(f"{path}: not an entry of a league: {error!r}") from error
        if kept != [name, league.version, league.digest, list(COLUMNS)] or worlds != list(league.worlds):
            raise InputError(f"{path}: not an entry of {name}, version {league.version}")
        _require_rows(f"{path}: {strategy}", entry["episodes"])
        found.append(entry)
    starts = {tuple(tuple(row[: 1 + len(WHOLE)]) for row in entry["episodes"]) for entry in found}
    if len(starts) > 1:
        raise InputError(f"{folder}: entries do not have the same starts")
    return sorted(found, key=lambda entry: (entry["strategy"] != REFERENCE, entry["strategy"]))


def entries_table(folder: Path, name: str) -> pd.DataFrame:
    """Return the episodes of all entries in a folder, a row an episode: `COLUMNS` and `strategy`."""
    entries = read_entries(folder, name)
    if not entries or entries[0]["strategy"] != REFERENCE:
        raise InputError(f"{folder}: no entry of {REFERENCE} there")
    rows = [[*row, entry["strategy"]] for entry in entries for row in entry["episodes"]]
    return pd.DataFrame(rows, columns=pd.Index([*COLUMNS, "strategy"]))


def league_text(folder: Path, name: str) -> str:
    """Format the standings of all entries in a folder, and their ratios at equal coverage, as Markdown tables."""
    episodes = entries_table(folder, name)
    return f"{standings_table(standings(episodes))}\n{coverage_text(at_coverage(episodes))}"
