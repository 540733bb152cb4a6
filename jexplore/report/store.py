"""Result files: written whole or not at all, into folders that hold one run each.

pandas, pyarrow and jax are imported by the functions that need them.
"""

import contextlib
import dataclasses
import datetime
import enum
import importlib.metadata
import itertools
import json
import math
import os
import platform
import secrets
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jexplore.config import InputError
from jexplore.version import __version__

if TYPE_CHECKING:
    import pandas as pd

OUR_FILES = (
    *("run.json", "episodes.parquet", "compare.png", "paths.png", "league.png"),  # compare
    *("episode.png", "episode.gif", "worlds.png"),  # explore, worlds
    *("bench.json", "bench.png"),  # bench
    *("scores.parquet", "segments.png"),  # segment
    "reproduce.png",  # reproduce
    *("btm.json", "btm.geojson", "btm.graphml", "btm.png", "btm.html", "runs.parquet"),  # trace
)
"""Names that a run writes into its folder: their presence marks it as taken, and only they are ever replaced."""

OLD = "old"  # folder for the files of a run that is being replaced

_PACKAGES = ("jax", "jaxlib", "numpy", "scipy", "flax", "chex", "pandas", "pyarrow", "matplotlib", "pillow")


def _reason(error):
    return (getattr(error, "strerror", None) or str(error)).splitlines()[0]


@contextlib.contextmanager
def atomic(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary path in the same folder that replaces `path` once the block has ended well.

    The data are synced before the replacement, so a reader finds the old file or the new one. If the block raises, the
    temporary file is removed and `path` stays as it was.

    Args:
      path: the file to write.

    Raises:
      InputError: the file cannot be written.
    """
    path = Path(path)
    part = path.parent / f".{path.name}.{os.getpid()}-{secrets.token_hex(4)}.part"
    try:
        yield part
        with open(part, "rb+") as file:
            os.fsync(file.fileno())
        os.replace(part, path)
        _sync_folder(path.parent)
    except OSError as error:
        raise InputError(f"{path} must be a file that can be written: {_reason(error)}") from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink()


def _sync_folder(folder):
    """Make a replacement in `folder` durable, where the system lets a folder be opened."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def write_parquet(episodes: "pd.DataFrame", path: str | os.PathLike[str]) -> None:
    """Write a DataFrame as Parquet, without its index, whole or not at all.

    Args:
      episodes: a pandas DataFrame.
      path: the file.

    Raises:
      InputError: the file cannot be written.
    """
    with atomic(path) as part:
        episodes.to_parquet(part, index=False)


def read_parquet(path: str | os.PathLike[str], *, required: Sequence[str] = ()) -> "pd.DataFrame":
    """Read a DataFrame that `write_parquet` wrote; column types come back as they were.

    Args:
      path: the file.
      required: names of columns that it must have.

    Raises:
      InputError: the file is missing, cannot be read, is no Parquet file, or lacks a required column.
    """
    import pandas as pd
    import pyarrow

    try:
        with open(path, "rb") as file:
            table = pd.read_parquet(file)
    except OSError as error:
        raise InputError(f"{path} must be a readable Parquet file: {_reason(error)}") from error
    except pyarrow.ArrowException as error:
        raise InputError(f"{path} must be a Parquet file: {_reason(error)}") from error
    missing = [name for name in required if name not in table.columns]
    if missing:
        raise InputError(f"{path} must have the column {missing[0]}, got {', '.join(map(str, table.columns))}")
    return table


def jsonable(value: Any) -> Any:
    """`value` as plain JSON types.

    Numbers and arrays of numpy and jax become numbers and lists; NaN, infinities and pandas' NA become None; records
    become objects, paths and times text, enumerations their names.

    Raises:
      TypeError: a type that has no such form.
    """
    if value is None or isinstance(value, (bool, str)):
        return value
    if isinstance(value, enum.Enum):
        return value.name
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, (datetime.datetime, datetime.date)):
        return value.isoformat()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: jsonable(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(key): jsonable(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [jsonable(item) for item in value]
    if type(value).__name__ == "NAType":
        return None
    if hasattr(value, "__array__"):
        return jsonable(np.asarray(value).tolist())
    raise TypeError(f"expected something that JSON can hold, got {type(value).__name__}")


def write_json(obj: Any, path: str | os.PathLike[str]) -> None:
    """Write `obj` as JSON (see `jsonable`), indented, whole or not at all.

    Args:
      obj: nested dicts, lists, records, numbers, arrays, text.
      path: the file.

    Raises:
      InputError: the file cannot be written.
      TypeError: `obj` holds something that has no JSON form; nothing is written.
    """
    text = json.dumps(jsonable(obj), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    with atomic(path) as part:
        part.write_text(text, encoding="utf-8")


def _writable(path, overwrite, names):
    """Makes the folder, proves that it can be written and that it may hold a run: `(taken files, folders made)`."""
    if not os.fspath(path):
        raise InputError("the output folder must have a name, got an empty one")
    path, made = Path(path), []
    try:
        if path.exists() and not path.is_dir():
            raise InputError(f"{path} must be a folder, got a file")
        taken = [path / name for name in names if os.path.lexists(path / name)]
        for file in taken:
            if not overwrite:
                raise InputError(
                    f"{path} holds a run ({file.name}): choose another folder or allow overwriting (--overwrite)"
                )
            if file.is_dir():
                raise InputError(f"{file} must be a file to be overwritten, got a folder")
        for folder in reversed([path, *path.parents]):
            if not folder.is_dir():
                folder.mkdir()
                made.append(folder)
        probe = path / f".probe.{os.getpid()}-{secrets.token_hex(4)}.part"
        probe.touch(exist_ok=False)
        probe.unlink()
    except InputError:
        raise
    except (OSError, ValueError) as error:
        _remove_folders(made)
        raise InputError(f"{str(path)!r} must be a folder that can be written: {_reason(error)}") from error
    return taken, made


def _remove_folders(made):
    for folder in reversed(made):
        with contextlib.suppress(OSError):
            folder.rmdir()


def check_out(path: str | os.PathLike[str], overwrite: bool = False, *, names: Iterable[str] = OUR_FILES) -> None:
    """Refuse a folder that cannot hold a run, and leave everything as it is.

    Args:
      path: the folder; it need not be there.
      overwrite: whether the folder may hold a run.
      names: the files that make up a run.

    Raises:
      InputError: the folder holds a run and `overwrite` is off, is a file, or cannot be made or written.
    """
    _remove_folders(_writable(path, overwrite, names)[1])


@contextlib.contextmanager
def _staged(folder, writers):
    """The files of a run, written into a hidden folder inside `folder` that is gone afterwards."""
    stage = Path(folder) / f".{os.getpid()}-{secrets.token_hex(4)}.part"
    try:
        stage.mkdir()
        for name, write in writers.items():
            write(stage / name)
        yield stage
    except OSError as error:
        raise InputError(f"{str(folder)!r} must be a folder that can be written: {_reason(error)}") from error
    finally:
        if not (stage / OLD).is_dir() or not any((stage / OLD).iterdir()):  # else what is there is there only
            shutil.rmtree(stage, ignore_errors=True)


@contextlib.contextmanager
def _locked(folder):
    """Keeps other processes that ask for the same lock waiting; where the system has none, does nothing."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def _exchange(stage, folder, taken, names):
    """Moves the files of a run from `stage` into `folder`, `run.json` last; those of the old run go to `stage/old`.

    If it is interrupted, everything is moved back.
    """
    old = stage / OLD
    old.mkdir()
    late = sorted(names, key=lambda name: name == "run.json")
    early = sorted((file.name for file in taken), key=lambda name: name != "run.json")
    try:
        for name in early:
            os.replace(folder / name, old / name)
        for name in late:
            os.replace(stage / name, folder / name)
    except BaseException as error:  # Ctrl-C too
        for name in reversed(early):
            if (old / name).exists():
                _done(os.replace, old / name, folder / name)
        for name in late:
            if name not in early and not (stage / name).exists():
                _done(os.unlink, folder / name)
        if any(old.iterdir()):
            raise InputError(f"the run in {folder} could not be replaced; its files are in {old}") from error
        raise
    os.replace(old, stage / "replaced")  # which goes with the stage


def _done(act, *paths):
    """Does what must be done, whatever Ctrl-C says; what cannot be done is left."""
    while True:
        try:
            return act(*paths)
        except KeyboardInterrupt:
            continue
        except OSError:
            return None


def write_run(
    path: str | os.PathLike[str], writers: Mapping[str, Callable[[Path], Any]], overwrite: bool = False
) -> Path:
    """Write the files of a run into its folder: all of them, or none.

    They are first written into a hidden folder inside it and moved when all are there, `run.json` last: where it
    stands, the rest does. If one fails, or the user interrupts, also while they are moved, the folder is as before: an
    earlier run is still whole, and folders that were made are gone.

    Args:
      path: the folder; missing parents are made too. Files of other names than a run's are never touched.
      writers: `{name: function}`, each called with the path that it is to write.
      overwrite: whether the folder may hold a run.

    Returns:
      `Path` of the folder.

    Raises:
      InputError: as `check_out`, or a file cannot be written; or files of the old run could be moved neither forth nor
        back: says where they are.
    """
    _, made = _writable(path, overwrite, OUR_FILES)
    path = Path(path)
    try:
        with _staged(path, writers) as stage, _locked(path):
            taken, _ = _writable(path, overwrite, OUR_FILES)
            _exchange(stage, path, taken, writers)
            _sync_folder(path)
            made = []
    finally:
        _remove_folders(made)
    return path


def write_new_run(paths: Iterable[str | os.PathLike[str]], writers: Mapping[str, Callable[[Path], Any]]) -> Path:
    """Write the files of a run into the first of some folders that is not there yet, as one: all of them, or none.

    Of several processes that write at once, each gets a folder of its own.

    Args:
      paths: folders, all in one folder.
      writers: as for `write_run`.

    Returns:
      `Path` of the folder.

    Raises:
      InputError: the folder cannot be made, or a file cannot be written.
    """
    names = map(Path, paths)
    path = next(names)
    _, made = _writable(path.parent, True, ())
    try:
        with _staged(path.parent, writers) as stage:
            while True:
                try:
                    os.rename(stage, path)  # fails where a folder with something in it is there
                    break
                except OSError:
                    if not os.path.lexists(path):
                        raise
                    path = next(names)
            _sync_folder(path.parent)
            made = []
    finally:
        _remove_folders(made)
    return path


def default_outs(
    command: str, now: datetime.datetime | None = None, *, root: str | os.PathLike[str] = "runs"
) -> Iterator[Path]:
    """Unused folder names for a run: `runs/20261121T093042Z-compare`, then with `-2`, `-3`, ...; without end.

    Args:
      command: what was run, part of the name.
      now: `datetime`, by default the present; one without a time zone counts as UTC.
      root: folder of the runs.

    Yields:
      `Path`s, of which none exists when it is given.
    """
    now = now or datetime.datetime.now(datetime.UTC)
    if now.tzinfo is not None:
        now = now.astimezone(datetime.UTC)
    first = Path(root) / f"{now:%Y%m%dT%H%M%SZ}-{command}"
    for count in itertools.count(1):
        path = first if count == 1 else first.with_name(f"{first.name}-{count}")
        if not os.path.lexists(path):
            yield path


def _version(package):
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def environment() -> dict[str, Any]:
    """What a run ran on, for its record. Starts jax's backend.

    Returns:
      A dict: `jexplore`, `python` and the packages' versions (None for one that is not installed), `platform`,
        `machine`, `cpu_count`, and jax's `backend`, `device` (kind of the first one) and `device_count`.
    """
    import jax

    devices = jax.devices()
    return {
        "jexplore": __version__,
        "python": platform.python_version(),
        **{name: _version(name) for name in _PACKAGES},
        "platform": platform.platform(),
        "machine": platform.machine(),
        "cpu_count": os.cpu_count(),
        "backend": devices[0].platform,
        "device": devices[0].device_kind,
        "device_count": len(devices),
    }
