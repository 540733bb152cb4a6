"""Folders that hold one run each: what is refused, and how a run's files come into one, all of them or none."""

import contextlib
import datetime
import itertools
import os
import secrets
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from jexplore.config import InputError
from jexplore.report.store import reason, sync_folder

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
        raise InputError(f"{str(path)!r} must be a folder that can be written: {reason(error)}") from error
    return taken, made


def _remove_folders(made):
    for folder in reversed(made):
        with contextlib.suppress(OSError):
            folder.rmdir()


def check_out(path: str | os.PathLike[str], overwrite: bool = False) -> None:
    """Refuse a folder that cannot hold a run, and leave everything as it is.

    Args:
      path: the folder; it need not be there.
      overwrite: whether the folder may hold a run.

    Raises:
      InputError: the folder holds a run and `overwrite` is off, is a file, or cannot be made or written.
    """
    _remove_folders(_writable(path, overwrite, OUR_FILES)[1])


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
        raise InputError(f"{str(folder)!r} must be a folder that can be written: {reason(error)}") from error
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
            sync_folder(path)
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
            sync_folder(path.parent)
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
