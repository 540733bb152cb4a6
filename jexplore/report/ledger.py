"""Finished units of a run: a Parquet file for every unit, so that nothing is computed twice.

pandas and pyarrow are imported by the functions that need them.
"""

import contextlib
import json
import os
import warnings
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from jexplore.arrays.files import first_line, opened, read_json
from jexplore.config import InputError, InputWarning
from jexplore.report.folders import RunFolder
from jexplore.report.store import MOST_RECORD_BYTES, jsonable, write_json, write_parquet

if TYPE_CHECKING:
    import pandas as pd

ASKED = "asked.json"  # what the run is asked, in the folder of its units
PART = "-part"  # ends the name of a unit's file, before the suffix, that holds some of its episodes only


class Shorter(NamedTuple):
    """Runs that ask the same as this one, of fewer episodes: what this one goes on with."""

    episodes: int  # of this one
    asked: Callable[[int], Mapping[str, Any]]  # settings of a run with this many episodes
    finished: Callable[[Path], "pd.DataFrame"]  # what the folder of one that is finished holds, as rows of its units
    units_of: Callable[["pd.DataFrame"], Iterable[tuple[int, "pd.DataFrame", bool]]]
    """Rows -> this one's units that have any: number, table, whether it is whole."""

    def includes(self, path: Path, there: Any, here: Mapping[str, Any], *, trust: bool) -> bool:
        """Return whether the content of a folder is a shorter run.

        Raises:
          InputError: it has more episodes, or other settings.
        """
        asked = there.get("asked", {}) if isinstance(there, dict) else {}
        n = asked.get("spec", asked).get("episodes")
        if not isinstance(n, int) or not isinstance(there.get("units"), int) or n == self.episodes:
            return False
        if n > self.episodes:
            raise InputError(
                f"{path} holds a run of {n} episodes, more than {self.episodes}: ask for {n} or more, choose another "
                "folder or allow overwriting (--overwrite)"
            )
        command = {"command": here["asked"]["command"]}
        page = {"asked": jsonable({**command, **self.asked(n)}), "units": there.get("units")}
        require_same(path, there, page, trust=trust)
        return True


class Ledger:
    """Units of a run that are finished, each a file of its own in the run's folder."""

    folder: Path
    done: set[int]
    """Numbers of the units that are finished."""
    parts: set[int]
    """Numbers of the units that are not finished, of which a part is kept."""

    def __init__(
        self,
        run: RunFolder,
        asked: Mapping[str, Any],
        units: int,
        *,
        resume: bool = False,
        trust: bool = False,
        shorter: Shorter | None = None,
    ) -> None:
        """Open the ledger of a run, new or to be continued.

        Args:
          run: the run's folder.
          asked: all settings that results depend on; plain JSON, see `store.jsonable`.
          units: number of units of the whole run.
          resume: bool, continue with an existing ledger; else it is removed.
          trust: as in `require_same`.
          shorter: other runs that may be continued.

        Warns:
          InputWarning: the file of a unit is damaged.

        Raises:
          InputError: the folder holds a run with other settings, or cannot be written.
        """
        self.folder, self.done, self.parts = run.unfinished, set(), set()
        self.units, self.first = units, 0
        page = {"asked": jsonable(dict(asked)), "units": units}
        page_file, record = self.folder / ASKED, run.path / "run.json"
        if not resume or not page_file.exists():
            run.forget()
        try:
            self.folder.mkdir(exist_ok=True)
        except OSError as error:
            raise InputError(f"{os.fspath(self.folder)!r} must be a folder that can be written: {error}") from error
        is_kept = page_file.exists()
        there = _read(page_file if is_kept else record) if is_kept or (resume and record.exists()) else None
        if there is not None and shorter is not None and shorter.includes(run.path, there, page, trust=trust):
            self._grow(shorter, self._all_of(there) if is_kept else [shorter.finished(run.path)], page)
        elif there is not None and is_kept:
            require_same(run.path, there, page, trust=trust)
            page["first"] = there.get("first", 0)
        else:
            write_json(page, page_file)
        self._open(page)

    def _open(self, page):
        """Count the units; remove files that are damaged or belong to none."""
        self.first, self.units, self.done, self.parts = page.get("first", 0), page["units"], set(), set()
        for file in self.folder.glob("*.parquet"):
            number = file.stem.removesuffix(PART)
            unit = int(number) - self.first if number.isdigit() else -1
            if 0 <= unit < self.units and _is_whole(file):
                (self.done if number == file.stem else self.parts).add(unit)
                continue
            if 0 <= unit < self.units:
                warnings.warn(f"{file.name} was damaged, and its unit is made again", InputWarning, stacklevel=4)
            with contextlib.suppress(OSError):
                file.unlink()
        self.parts -= self.done
        for file in self.folder.glob(".*.part"):  # of a holder that was killed while it wrote
            with contextlib.suppress(OSError):
                file.unlink()

    def _all_of(self, page):
        """Return the tables of all units."""
        self._open(page)
        return [self.get(unit) for unit in sorted(self.done | self.parts)]

    def _grow(self, shorter, tables, page):
        """Cut the finished part of a shorter run into units of this one.

        They get new numbers, which count once the page says so, so that whatever ends this leaves either run whole.
        """
        import pandas as pd

        page["first"] = self.first = self.first + self.units
        if tables:
            for unit, table, is_whole in shorter.units_of(pd.concat(tables, ignore_index=True)):
                write_parquet(table, self._file(unit, "" if is_whole else PART))
        write_json(page, self.folder / ASKED)

    def put(self, unit: int, table: "pd.DataFrame") -> None:
        """Store a finished unit: on the disk when this returns.

        Raises:
          InputError: it cannot be written.
        """
        write_parquet(table, self._file(unit))
        self.done.add(unit)
        self.parts.discard(unit)

    def put_part(self, unit: int, table: "pd.DataFrame") -> None:
        """Store the finished part of a unit, in place of a smaller part. Raises as `put`."""
        write_parquet(table, self._file(unit, PART))
        self.parts.add(unit)

    def get(self, unit: int) -> "pd.DataFrame":
        """Return the table of a finished unit, or of its finished part.

        Raises:
          InputError: its file is missing or damaged.
        """
        return _get(self._file(unit, PART if unit in self.parts else ""))

    @property
    def left(self) -> list[int]:
        """Return the numbers of the unfinished units."""
        return [unit for unit in range(self.units) if unit not in self.done]

    def _file(self, unit, tail=""):
        return self.folder / f"{self.first + unit:06d}{tail}.parquet"


def _get(file):
    try:
        return _table_in(file)
    except Exception as error:  # pyarrow raises many kinds of errors for a broken file
        what = f"was damaged meanwhile: {first_line(error)}"
        raise InputError(f"{file} must be a unit of this run, and {what}; --resume makes it again") from error


def _is_whole(file):
    """Return whether a unit's file can be read to its end and is unchanged."""
    try:
        _table_in(file)
    except Exception:  # pyarrow raises many kinds of errors for a broken file
        return False
    return True


def _table_in(file):
    import pandas as pd

    with opened(file) as content:
        return pd.read_parquet(content, engine="pyarrow", page_checksum_verification=True)


def is_finished(
    run: RunFolder, asked: Mapping[str, Any], units: int, *, trust: bool = False, shorter: Shorter | None = None
) -> bool:
    """Return whether a folder holds a finished run with these settings. Arguments as of `Ledger`.

    Raises:
      InputError: it holds a run with other settings, or another command's files.
    """
    page = run.path / "run.json"
    if (run.unfinished / ASKED).exists():
        return False
    if not page.exists():
        run.require_free()
        return False
    record, here = _read(page), {"asked": jsonable(dict(asked)), "units": units}
    if shorter is not None and shorter.includes(run.path, record, here, trust=trust):
        return False
    require_same(run.path, record, here, trust=trust)
    return not record.get("interrupted")  # else its units are gone, and it begins again


def _read(file):
    try:
        page = read_json(file, MOST_RECORD_BYTES)
    except InputError as error:
        raise InputError(f"{error}: it must say what the run is asked; use --overwrite") from error
    asked = page.get("asked", {}) if isinstance(page, dict) else None
    if not isinstance(asked, dict) or not all(isinstance(asked.get(key) or {}, dict) for key in ("own", "spec")):
        raise InputError(f"{os.fspath(file)!r}: does not say what the run is asked; use --overwrite")
    return page


def require_same(path: Path, there: Any, here: Mapping[str, Any], *, trust: bool = False) -> None:
    """Refuse to continue a run with other settings.

    Args:
      path: its folder.
      there, here: its settings, and the present ones.
      trust: bool, take strategies as unchanged.

    Raises:
      InputError: naming the first difference, or a strategy that cannot be compared.
    """
    pages = (page if isinstance(page, dict) else {} for page in (there, here))
    old, new = ({**page.get("asked", {}), "units": page.get("units")} for page in pages)
    was, is_ = old.pop("own", None) or {}, new.pop("own", None) or {}
    for key in dict.fromkeys((*new, *old)):
        if old.get(key) != new.get(key):
            raise InputError(_difference(path, key, old.get(key), new.get(key)))
    for name in () if trust else dict.fromkeys((*is_, *was)):
        if is_.get(name) is None:
            raise InputError(
                f"{path} holds a run of the {name}, which calls back into Python, so that nothing tells whether it has "
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
