"""Folders that hold one run each: claimed before a run begins, and given its files all at once, or none."""

import contextlib
import datetime
import itertools
import os
import secrets
import shutil
import socket
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from jexplore.config import InputError
from jexplore.report.store import reason, sync_folder

OUR_FILES = (
    *("run.json", "episodes.parquet", "details.npz", "report.html"),
    *(
        "compare.png",
        "coverage.png",
        "paths.png",
        "waste.png",
        "league.png",
        "compare.svg",
        "coverage.svg",
        "league.svg",
    ),  # compare
    *("episode.png", "episode.gif", "explored.yaml", "explored.pgm", "worlds.png"),  # explore, worlds
    *("bounds.parquet", "walks.parquet", "bounds.png"),  # bound
    *("model.msgpack", "model.json", "curve.parquet", "curve.png"),  # train
    *("bench.json", "bench.png"),  # bench
    *("scores.parquet", "segments.png"),  # segment
    *("reproduce.png", "reproduce.svg"),  # reproduce
    *("asked.yaml", "summary.csv", "sweep.png", "sweep-map.png", "sweep.svg", "sweep-map.svg"),  # sweep
    *("btm.json", "btm.geojson", "btm.graphml", "btm.png", "btm.html", "runs.parquet"),  # trace
    *("route.json", "route.png"),  # route
)
"""Names that a run writes into its folder: their presence marks it as taken, and only they are ever replaced."""

UNFINISHED = ".unfinished"  # folder for the finished part of a run, in its own
LOCK = ".lock"  # file that is locked while a process has the folder to itself
PART = ".part"  # ending of hidden folders in which files are written before they are moved
NAMES = ".names"  # file that lists the files moved from such a folder
OLD = "old"  # folder for the files of a run being replaced, inside it


class RunFolder:
    """A folder that this process has to itself, for the files of one run."""

    path: Path
    overwrite: bool

    def __init__(self, path: Path, overwrite: bool, made: list[Path], lock: int | None) -> None:
        self.path, self.overwrite = path, overwrite
        self._made, self._lock, self._keeps = made, lock, False

    @property
    def unfinished(self) -> Path:
        """Return the folder for the finished part of a run."""
        return self.path / UNFINISHED

    def write(self, writers: Mapping[str, Callable[[Path], Any]], *, is_finished: bool = True) -> Path:
        """Write the files of a run: all of them, or none.

        They are first written into a hidden folder and moved once all exist, `run.json` last: if it exists, the rest
        does. If one fails, or the user interrupts, also during the move, the folder stays as before.

        Args:
          writers: `{name: function}`, each called with the path that it is to write.
          is_finished: bool, the run is finished: its ledger is removed.

        Returns:
          `Path` of the folder.

        Raises:
          InputError: a file cannot be written; or files of an old run could be moved neither forth nor back: names
            their place.
        """
        with _staged(self.path, writers) as stage:
            _exchange(stage, self.path, _taken(self.path, True), writers)
            sync_folder(self.path)
        self._keeps, self.overwrite = True, True
        if is_finished:
            self.forget()
        return self.path

    def forget(self) -> None:
        """Remove the ledger of the run: all at once, so that no part can be taken for the whole."""
        gone = self.path / f".{os.getpid()}-{secrets.token_hex(4)}{PART}"
        with contextlib.suppress(OSError):
            os.replace(self.unfinished, gone)
        shutil.rmtree(gone, ignore_errors=True)

    def add(self, name: str, write: Callable[[Path], Any]) -> None:
        """Add a file to a finished run, whole or not at all; `write` may add others next to it.

        Raises:
          InputError: it cannot be written.
        """
        with _staged(self.path, {name: write}) as stage:
            for file in sorted(stage.iterdir(), reverse=True):
                os.replace(file, self.path / file.name)

    def require_free(self) -> None:
        """Refuse a folder that holds a run.

        Raises:
          InputError: naming one of its files.
        """
        _taken(self.path, False)

    def release(self) -> None:
        """Give the folder back; without content, folders that were made for it are removed."""
        if self.unfinished.is_dir() and not any(self.unfinished.glob("*.parquet")):
            _done(self.forget)
        if self._lock is not None:
            with contextlib.suppress(OSError):
                os.unlink(self.path / LOCK)
            os.close(self._lock)
            self._lock = None
        if not self._keeps:
            _remove_folders(self._made)


@contextlib.contextmanager
def claimed(path: str | os.PathLike[str], *, overwrite: bool = False, resume: bool = False) -> Iterator[RunFolder]:
    """Claim a folder for one run, which no other process may claim meanwhile; missing parents are made.

    Nothing in it is changed before the run is written. The claim dies with its holder, however that ends.

    Args:
      path: the folder.
      overwrite: whether it may hold a run, which is then replaced by the new one as a whole. Files of other names
        than a run's are never touched.
      resume: whether it may hold a run, finished or not, that is to be gone on with.

    Yields:
      `RunFolder`.

    Raises:
      InputError: it holds a run, finished or not, or another process writes to it; it is a file, or cannot be made or
        written.
    """
    folder = _claim(path, overwrite, resume)
    try:
        yield folder
    finally:
        folder.release()


@contextlib.contextmanager
def claimed_new(paths: Iterable[str | os.PathLike[str]]) -> Iterator[RunFolder]:
    """Claim, as `claimed`, the first of some folders that does not exist. Several processes each get their own."""
    for path in map(Path, paths):
        parents = _make(path.parent)
        try:
            path.mkdir()
        except FileExistsError:
            continue
        except (OSError, ValueError) as error:
            _remove_folders(parents)
            raise _unwritable(path, error) from error
        folder = _claim(path, False, False)
        folder._made = [*parents, path]
        try:
            yield folder
        finally:
            folder.release()
        return


def _claim(path, overwrite, resume):
    if not os.fspath(path):
        raise InputError("the output folder must have a name, got an empty one")
    path = Path(path)
    made = _make(path)
    try:
        lock = _locked(path)
    except BaseException:
        _remove_folders(made)
        raise
    folder = RunFolder(path, overwrite, made, lock)
    try:
        _mend(path)
        _taken(path, overwrite or resume)
        if folder.unfinished.exists() and not (overwrite or resume):
            raise InputError(
                f"{path} holds a run that was not finished: go on with it (--resume), replace it (--overwrite) or "
                "choose another folder"
            )
    except BaseException as error:
        folder.release()
        if isinstance(error, OSError):
            raise _unwritable(path, error) from error
        raise
    return folder


def _unwritable(path, error):
    return InputError(f"{str(path)!r} must be a folder that can be written: {reason(error)}")


def _make(path):
    """Make a folder and its parents: a list of the new ones."""
    made = []
    try:
        if path.exists() and not path.is_dir():
            raise InputError(f"{path} must be a folder, got a file")
        for folder in reversed([path, *path.parents]):
            if not folder.is_dir():
                folder.mkdir(exist_ok=True)
                made.append(folder)
    except InputError:
        raise
    except (OSError, ValueError) as error:
        _remove_folders(made)
        raise _unwritable(path, error) from error
    return made


def _remove_folders(made):
    for folder in reversed(made):
        with contextlib.suppress(OSError):
            folder.rmdir()


def _taken(path, allowed):
    """Return the files of a run in a folder: a list of `Path`s; refuse them unless they are allowed."""
    taken = [path / name for name in OUR_FILES if os.path.lexists(path / name)]
    for file in taken:
        if not allowed:
            raise InputError(
                f"{path} holds a run ({file.name}): choose another folder or allow overwriting (--overwrite)"
            )
        if file.is_dir():
            raise InputError(f"{file} must be a file to be overwritten, got a folder")
    return taken


def _locked(path):
    """Lock a folder for this process, until it ends: a file descriptor; None on systems without locks.

    Raises:
      InputError: another process has it, or the folder cannot be written.
    """
    name = path / LOCK
    while True:
        try:
            handle = os.open(name, os.O_RDWR | os.O_CREAT, 0o644)
        except (OSError, ValueError) as error:
            raise _unwritable(path, error) from error
        try:
            if not _lock(handle):
                who = os.read(handle, 200).decode(errors="replace").strip() or "another process"
                raise InputError(f"{path} is being written by {who}: wait for it, or choose another folder")
            if os.path.samestat(os.fstat(handle), os.stat(name)):  # else its holder has just removed it
                os.ftruncate(handle, 0)
                os.write(handle, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
                return handle
        except FileNotFoundError:
            pass
        except OSError as error:
            os.close(handle)
            raise _unwritable(path, error) from error
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)


def _lock(handle):
    """Lock an open file; return whether that succeeded, True on systems without locks."""
    try:
        import fcntl
    except ImportError:
        return True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        return True
    return True


def _mend(path):
    """Repair a folder whose last holder was killed while files were written or moved.

    The old run is whole again unless the new one is.
    """
    for stage in path.glob(f".*{PART}"):
        old = stage / OLD
        is_whole = (path / "run.json").exists() and (old / "run.json").exists()  # the new one's and the old one's
        if old.is_dir() and not is_whole:
            for name in _names_in(stage):
                if not (old / name).exists() and not (stage / name).exists() and not (path / "run.json").exists():
                    with contextlib.suppress(OSError):
                        (path / name).unlink()  # a new file, already moved
            for file in sorted(old.iterdir(), key=lambda file: file.name == "run.json"):
                os.replace(file, path / file.name)
        shutil.rmtree(stage, ignore_errors=True)
        with contextlib.suppress(OSError):
            stage.unlink()


def _names_in(stage):
    """Return the names of the files that were to be moved from a hidden folder."""
    try:
        return (stage / NAMES).read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):
        return []


@contextlib.contextmanager
def _staged(folder, writers):
    """Write the files of a run into a hidden folder inside `folder` that is removed afterwards."""
    stage = Path(folder) / f".{os.getpid()}-{secrets.token_hex(4)}{PART}"
    try:
        stage.mkdir()
        for name, write in writers.items():
            write(stage / name)
        yield stage
    except OSError as error:
        raise _unwritable(folder, error) from error
    finally:
        if not (stage / OLD).is_dir() or not any((stage / OLD).iterdir()):  # otherwise these files exist only there
            shutil.rmtree(stage, ignore_errors=True)


def _exchange(stage, folder, taken, names):
    """Move the files of a run from `stage` into `folder`, `run.json` last; those of the old run go to `stage/old`.

    If it is interrupted, everything is moved back.
    """
    old = stage / OLD
    (stage / NAMES).write_text("\n".join(names), encoding="utf-8")
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
    """Do necessary steps despite Ctrl-C; those that fail are left."""
    while True:
        try:
            return act(*paths)
        except KeyboardInterrupt:
            continue
        except OSError:
            return None


def default_outs(
    command: str, now: datetime.datetime | None = None, *, root: str | os.PathLike[str] = "runs"
) -> Iterator[Path]:
    """Yield unused folder names for a run: `runs/20261121T093042Z-compare`, then with `-2`, `-3`, ...; without end.

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
