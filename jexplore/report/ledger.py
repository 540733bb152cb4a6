"""What a run has finished so far: a Parquet file for every unit of its work, so that nothing is computed twice.

pandas and pyarrow are imported by the functions that need them.
"""

import contextlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jexplore.arrays.files import opened, read_json
from jexplore.config import InputError
from jexplore.report.folders import RunFolder
from jexplore.report.store import MOST_RECORD_BYTES, jsonable, write_json, write_parquet

if TYPE_CHECKING:
    import pandas as pd

ASKED = "asked.json"  # what the run is asked, in the folder of its units


class Ledger:
    """Units of a run that are finished, each a file of its own in the run's folder."""

    folder: Path
    done: set[int]
    """Numbers of the units that are finished."""
    damaged: list[str]
    """Files that were found cut short; their units are made again."""

    def __init__(self, run: RunFolder, asked: Mapping[str, Any], units: int, *, resume: bool = False) -> None:
        """Opens the ledger of a run, or goes on with one.

        Args:
          run: the run's folder.
          asked: what the run is asked, all that its results depend on; plain JSON, see `store.jsonable`.
          units: how many units the whole run has.
          resume: whether to go on with what is there. Else it is thrown away.

        Raises:
          InputError: the folder holds a run that is asked something else, or cannot be written.
        """
        self.folder, self.done, self.damaged, self.units = run.unfinished, set(), [], units
        page = {"asked": jsonable(dict(asked)), "units": units}
        page_file = self.folder / ASKED
        if not resume or not page_file.exists():
            run.forget()
        if page_file.exists():
            require_same(run.path, _read(page_file), page)
        else:
            try:
                self.folder.mkdir(exist_ok=True)
            except OSError as error:
                raise InputError(f"{os.fspath(self.folder)!r} must be a folder that can be written: {error}") from error
            write_json(page, page_file)
        for file in self.folder.glob("*.parquet"):
            if file.stem.isdigit() and int(file.stem) < units:
                self._count(file)
        for file in self.folder.glob(".*.part"):  # of a holder that was killed while it wrote
            with contextlib.suppress(OSError):
                file.unlink()

    def _count(self, file):
        import pyarrow.parquet as pq

        try:
            with opened(file) as content:
                pq.read_metadata(content)
        except Exception:  # pyarrow raises many kinds of errors for a broken file
            self.damaged.append(file.name)
            with contextlib.suppress(OSError):
                file.unlink()
            return
        self.done.add(int(file.stem))

    def put(self, unit: int, table: "pd.DataFrame") -> None:
        """Keeps a unit that is finished: on the disk when this returns.

        Raises:
          InputError: it cannot be written.
        """
        write_parquet(table, self._file(unit))
        self.done.add(unit)

    def get(self, unit: int) -> "pd.DataFrame":
        """The table of a unit that is finished.

        Raises:
          InputError: its file is gone or damaged.
        """
        import pandas as pd

        try:
            return pd.read_parquet(self._file(unit))
        except Exception as error:  # pyarrow raises many kinds of errors for a broken file
            raise InputError(
                f"{self._file(unit)} must be a unit of this run: {str(error).splitlines()[0]}; remove it and go on "
                "with --resume"
            ) from error

    @property
    def left(self) -> list[int]:
        """Numbers of the units that are not finished."""
        return [unit for unit in range(self.units) if unit not in self.done]

    def _file(self, unit):
        return self.folder / f"{unit:06d}.parquet"


def is_finished(run: RunFolder, asked: Mapping[str, Any], units: int) -> bool:
    """Whether a folder holds a run that is finished and was asked this.

    Raises:
      InputError: it holds one that was asked something else, or another command's files.
    """
    page = run.path / "run.json"
    if run.unfinished.exists():
        return False
    if not page.exists():
        run.require_free()
        return False
    record = _read(page)
    require_same(run.path, record, {"asked": jsonable(dict(asked)), "units": units})
    return not record.get("interrupted")  # else its units are gone, and it begins again


def _read(file):
    try:
        return read_json(file, MOST_RECORD_BYTES)
    except InputError as error:
        raise InputError(f"{error}: it must say what the run is asked; use --overwrite") from error


def require_same(path: Path, there: Any, here: Mapping[str, Any]) -> None:
    """Refuse to go on with a run that is asked something else.

    Raises:
      InputError: naming the first difference.
    """
    pages = (page if isinstance(page, dict) else {} for page in (there, here))
    old, new = ({**page.get("asked", {}), "units": page.get("units")} for page in pages)
    for key in dict.fromkeys((*new, *old)):
        if old.get(key) != new.get(key):
            was, is_ = old.get(key), new.get(key)
            if isinstance(was, dict) and isinstance(is_, dict):  # of which one entry tells more than all
                inner = next(name for name in (*is_, *was) if was.get(name) != is_.get(name))
                key, was, is_ = f"{key}, {inner}:", was.get(inner), is_.get(inner)
            was, is_ = _short(was), _short(is_)
            raise InputError(
                f"{path} holds another run: its {key} is {was}, not {is_}; choose another folder or allow overwriting "
                "(--overwrite)"
            )


def _short(value):
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 80 else text[:77] + "..."
