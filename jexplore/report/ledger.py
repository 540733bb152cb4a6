"""Finished units of a run: a file for every unit, so that nothing is computed twice.

A unit is finished if its file exists. pandas and pyarrow are imported by the functions that need them.
"""

import contextlib
import json
import os
import warnings
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jexplore.arrays.files import opened, read_json
from jexplore.config import InputError, InputWarning
from jexplore.report.folders import RunFolder
from jexplore.report.store import MAX_RECORD_BYTES, jsonable, write_json, write_parquet

if TYPE_CHECKING:
    import pandas as pd

ASKED_FILE = "asked.json"  # what the run is asked, in the folder of its units


class Ledger:
    """Units of a run that are finished, each a file of its own in the run's folder."""

    folder: Path
    units: int
    """Number of units of the run."""
    after: int
    """Number of episodes of the finished run that this one continues: those come in no unit."""
    done: "dict[int, pd.DataFrame]"
    """Numbers of the units that are finished -> their tables; empty of those that have been put."""

    def __init__(self, folder: Path, units: int, after: int) -> None:
        """Read the units that are there; remove files that are damaged or belong to none.

        Warns:
          InputWarning: the file of a unit is damaged.
        """
        self.folder, self.units, self.after, self.done = folder, units, after, {}
        for file in folder.iterdir():
            unit = int(file.stem) if file.stem.isdigit() else -1
            with contextlib.suppress(Exception):  # pyarrow raises many kinds of errors for a broken file
                if 0 <= unit < units:
                    self.done[unit] = _table_in(file)
            if unit not in self.done and file.name != ASKED_FILE:
                if 0 <= unit < units:
                    warnings.warn(f"{file.name} was damaged, and its unit is made again", InputWarning, stacklevel=4)
                with contextlib.suppress(OSError):  # a holder that was killed while it wrote has left temporary ones
                    file.unlink()

    def put(self, unit: int, table: "pd.DataFrame") -> None:
        """Store a finished unit: on the disk when this returns."""
        write_parquet(table, self.folder / f"{unit:06d}.parquet")
        self.done[unit] = table.head(0)  # whoever has made it keeps it


def _table_in(file):
    import pandas as pd

    with opened(file) as content:
        return pd.read_parquet(content, engine="pyarrow", page_checksum_verification=True)


def _unchanged(table: Any) -> Any:
    return table


class Work:
    """Units of a run: the tables of those that are finished, and the numbers of those that are left."""

    done: "dict[int, pd.DataFrame]"
    left: list[int]

    def __init__(
        self, numbers: Iterable[int], ledger: Ledger | None = None,
        to_file: Callable[["pd.DataFrame"], "pd.DataFrame"] = _unchanged,
        of_file: Callable[["pd.DataFrame"], "pd.DataFrame"] = _unchanged,
    ) -> None:  # fmt: skip
        """Read the finished units, of these numbers, of a ledger; `of_file` reverses `to_file`."""
        self._ledger, self._to_file, numbers = ledger, to_file, list(numbers)
        self.done = {} if ledger is None else {i: of_file(ledger.done[i]) for i in numbers if i in ledger.done}
        self.left = [i for i in numbers if i not in self.done]

    def put(self, number: int, found: "pd.DataFrame") -> None:
        """Take the table of a unit, which the ledger then has."""
        if self._ledger is not None:
            self._ledger.put(number, self._to_file(found))
        self.done[number] = found

    @property
    def results(self) -> "list[pd.DataFrame]":
        """Return the tables of the finished units, in order."""
        return [self.done[i] for i in sorted(self.done)]


def open_ledger(
    run: RunFolder, asked: Mapping[str, Any], units: int | Callable[[int], int], *, resume: bool = False,
    trust: bool = False,
) -> Ledger | None:  # fmt: skip
    """Open the ledger of a run, new or to be continued; None if the folder holds the finished run.

    Args:
      run: the run's folder.
      asked: all settings that results depend on; plain JSON, see `store.jsonable`.
      units: number of units of the whole run; or a function that returns that of the episodes from a number on: the run
        then continues a finished one of fewer `episodes`.
      resume: continue with existing units; else they are removed.
      trust: as in `require_same`.
    """
    asked, after = jsonable(dict(asked)), 0
    page_file, record_file = run.unfinished / ASKED_FILE, run.path / "run.json"

    def count(after):
        return units(after) if callable(units) else units

    if resume and page_file.exists():
        there = _read(page_file)
        after = there.get("after", 0)
        if callable(units):
            _require_as_many(run.path, there, asked, is_finished=False)
        require_same(run.path, there, {"asked": asked, "units": count(after)}, trust=trust)
        return Ledger(run.unfinished, count(after), after)
    if resume and record_file.exists():
        there = _read(record_file)
        is_finished, own = not there.get("interrupted"), asked  # else its units are gone, and it begins again
        if callable(units):
            own = {**asked, "episodes": _require_as_many(run.path, there, asked, is_finished=is_finished)}
        require_same(run.path, {"asked": there.get("asked")}, {"asked": own}, trust=trust)
        if is_finished and own == asked:
            return None
        after = own["episodes"] if own != asked else 0
    elif resume:
        run.require_free()
    run.forget()
    try:
        run.unfinished.mkdir()
    except OSError as error:
        raise InputError(f"{os.fspath(run.unfinished)!r} must be a folder that can be written: {error}") from error
    write_json({"asked": asked, "units": count(after), "after": after}, page_file)
    return Ledger(run.unfinished, count(after), after)


def _require_as_many(path, there, asked, *, is_finished):
    """Return the number of episodes of a run that is to be continued; refuse more, and fewer of an unfinished one."""
    n, episodes = (there.get("asked") or {}).get("episodes"), asked["episodes"]
    if not isinstance(n, int) or n == episodes:
        return episodes
    if n > episodes:
        raise InputError(
            f"{path} holds a run of {n} episodes, more than {episodes}: ask for {n} or more, choose another folder or "
            "allow overwriting (--overwrite)"
        )
    if not is_finished:
        raise InputError(f"{path} holds a run of {n} episodes that was not finished: finish these, then ask for more")
    return n


def _read(file):
    try:
        page = read_json(file, MAX_RECORD_BYTES)
    except InputError as error:
        raise InputError(f"{error}: it must say what the run is asked; use --overwrite") from error
    if not isinstance(page, dict) or not isinstance(page.get("asked", {}), dict):
        raise InputError(f"{os.fspath(file)!r}: does not say what the run is asked; use --overwrite")
    return page


def require_same(path: Path, there: Mapping[str, Any], here: Mapping[str, Any], *, trust: bool = False) -> None:
    """Refuse to continue a run with other settings, naming the first difference.

    `there` and `here` are what it was asked and is asked now: `asked`, and `units` where they count. With `trust`,
    users' strategies and metrics are taken as unchanged.
    """
    old, new = ({**(page.get("asked") or {}), "units": page.get("units")} for page in (there, here))
    was, is_ = old.pop("own", None) or {}, new.pop("own", None) or {}
    for key in dict.fromkeys((*new, *old)):
        if old.get(key) != new.get(key):
            raise InputError(_difference(path, key, old.get(key), new.get(key)))
    for name in () if trust else dict.fromkeys((*is_, *was)):
        if is_.get(name) is None:
            raise InputError(
                f"{path} holds a run of the {name}, of which nothing tells whether it has "
                "changed since: --trust goes on if you know that it has not, --overwrite begins anew"
            )
        if was.get(name) != is_[name]:
            raise InputError(
                f"{path} holds another run: its {name} computes something else now; choose another folder "
                "or allow overwriting (--overwrite)"
            )


def _difference(path, key, was, is_):
    """Describe the difference between two runs."""
    if isinstance(was, dict) and isinstance(is_, dict):  # of which one entry tells more than all
        inner = next(name for name in (*is_, *was) if was.get(name) != is_.get(name))
        key, was, is_ = f"{key}, {inner}:", was.get(inner), is_.get(inner)
    return (
        f"{path} holds another run: its {key} is {_short(was)}, not {_short(is_)}; choose another folder or allow "
        "overwriting (--overwrite)"
    )


def _short(value):
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 80 else text[:77] + "..."
