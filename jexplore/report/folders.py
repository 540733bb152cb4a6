"""Folders that hold one run each: claimed before a run begins, and given its files all at once, or none.

Everything is written under a temporary name, and counts once it is renamed.
"""

import contextlib
import datetime
import itertools
import os
import secrets
import shutil
import socket
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from jexplore.config import InputError
from jexplore.report.store import atomic, reason, sync_folder, write_json, write_parquet

OUR_FILES = (
    *("run.json", "episodes.parquet", "details.parquet", "report.html"),
    *("compare.png", "coverage.png", "paths.png", "league.png"),  # compare
    *("compare.svg", "coverage.svg", "league.svg"),
    *("episode.png", "episode.gif", "explored.yaml", "explored.pgm", "worlds.png"),  # explore, worlds
    *("bounds.parquet", "walks.parquet", "bounds.png"),  # bound
    *("model.msgpack", "model.json", "curve.parquet", "curve.png"),  # train
    *("tuned.json", "trials.parquet"),  # tune
    "bench.json",  # bench
    *("scores.parquet", "segments.png"),  # segment
    *("trajectory.txt", "map.yaml", "map.pgm", "slam.png", "errors.parquet"),  # slam
    *("asked.yaml", "summary.csv", "sweep.png", "sweep.svg"),  # sweep
    *("btm.json", "btm.png", "btm.html", "runs.parquet"),  # trace
    *("station.html", "teams.parquet", "contacts.parquet", "team.png"),  # trace --robots
    *(f"robot-{i}.json" for i in range(16)),
    *("route.json", "route.png"),  # route
)
"""Names that a run writes into its folder: their presence marks it as taken, and only they are ever replaced."""

VECTORS = ("compare.png", "coverage.png", "league.png", "sweep.png")
"""Pictures that are written as SVG as well."""
UNFINISHED = ".unfinished"  # folder for the finished units of a run, in its own
LOCK = ".lock"  # file that is locked while a process has the folder to itself
STAGED = ".part"  # ending of hidden folders in which files are written before they count
READY = ".ready"  # folder of a run that is written and counts; the old one goes
MOVING = ".moving"  # the same, once the old one has gone


def write_content(content: Any, path: Path) -> None:
    """Write a file of a run, whole or not at all.

    Args:
      content: a table, plain values or text; a function that makes a figure for a picture (.png), for any other file
        one that writes it.
      path: the file. Its ending decides how a table is written; a picture of `VECTORS` is written as SVG as well.
    """
    if path.suffix == ".png":
        from jexplore.report import plot

        figure = content()
        for ending in (".png", ".svg") if path.name in VECTORS else (".png",):
            plot.save_figure(figure, path.with_suffix(ending))
    elif callable(content):
        content(path)
    elif isinstance(content, Mapping):
        write_json(content, path)
    elif path.suffix == ".parquet":
        write_parquet(content, path)
    else:
        with atomic(path) as part:
            part.write_text(content if isinstance(content, str) else content.to_csv(index=False), encoding="utf-8")


class RunFolder:
    """A folder that this process has to itself, for the files of one run."""

    path: Path

    def __init__(self, path: Path) -> None:
        self.path, self._made, self._lock, self._keeps = path, list[Path](), -1, False

    @property
    def unfinished(self) -> Path:
        """Return the folder for the finished units of a run."""
        return self.path / UNFINISHED

    def write(self, contents: Mapping[str, Any], *, is_finished: bool = True) -> Path:
        """Write the files of a run in place of the old one's: all or none. Return the folder.

        `contents` are name -> content for `write_content`. Files are written into a hidden folder, which one renaming
        makes the run of this folder. If that fails or the user interrupts before, the folder stays as it was; whatever
        comes after, the new run is there. The units of a finished run are removed.
        """
        with _staged(self.path, contents) as stage:
            self.require_free(allowed=True)
            self._keeps = True
            try:
                os.replace(stage, self.path / READY)
                self._install()
            except KeyboardInterrupt:
                self._install()
                raise
        if is_finished:
            self.forget()
        return self.path

    def forget(self) -> None:
        """Remove the units of the run: all at once, so that no part can be taken for the whole."""
        gone = _hidden(self.path)
        with contextlib.suppress(OSError):
            os.replace(self.unfinished, gone)
        shutil.rmtree(gone, ignore_errors=True)

    def add(self, name: str, content: Any) -> None:
        """Add a file to a finished run, whole or not at all; one that writes itself may add others next to it."""
        with _staged(self.path, {name: content}) as stage:
            for file in stage.iterdir():
                os.replace(file, self.path / file.name)

    def require_free(self, *, allowed: bool = False) -> list[Path]:
        """Return the files of a run in the folder; refuse them unless they are allowed."""
        taken = [self.path / name for name in OUR_FILES if os.path.lexists(self.path / name)]
        for file in taken:
            if not allowed:
                raise InputError(
                    f"{self.path} holds a run ({file.name}): choose another folder or allow overwriting (--overwrite)"
                )
            if file.is_dir():
                raise InputError(f"{file} must be a file to be overwritten, got a folder")
        return taken

    def _install(self):
        """Put the run that is ready in place of the old one. Each step may be the last before the same begins anew."""
        ready, moving = self.path / READY, self.path / MOVING
        if ready.is_dir():
            for file in self.require_free(allowed=True):  # run.json, the first of `OUR_FILES`, before all others
                file.unlink()
            os.replace(ready, moving)
        if moving.is_dir():
            for file in sorted(moving.iterdir(), key=lambda file: file.name == "run.json"):  # if it is there, all are
                os.replace(file, self.path / file.name)
            moving.rmdir()
            sync_folder(self.path)

    def claim(self, *, is_new: bool) -> None:
        """Make the folder and its parents, lock it, and complete what its last holder was killed at."""
        if self.path.is_file():
            raise InputError(f"{str(self.path)!r} must be a folder, got a file")
        with _writable(self.path, OSError, ValueError):
            for folder in reversed([self.path, *self.path.parents]):
                own = is_new and folder == self.path
                if own or not folder.is_dir():
                    folder.mkdir(exist_ok=not own)
                    self._made.append(folder)
            self._take_lock(self.path / LOCK)
            self._install()
        for stage in self.path.glob(f".*{STAGED}"):
            shutil.rmtree(stage, ignore_errors=True)

    def _take_lock(self, name):
        """Lock the folder for this process, until it ends."""
        while self._lock < 0:
            handle = os.open(name, os.O_RDWR | os.O_CREAT, 0o644)
            try:
                if not _is_locked(handle):
                    who = os.read(handle, 200).decode(errors="replace").strip() or "another process"
                    raise InputError(f"{self.path} is being written by {who}: wait for it, or choose another folder")
                if os.path.samestat(os.fstat(handle), os.stat(name)):
                    self._lock = handle
            except FileNotFoundError:  # its holder has just removed it
                pass
            finally:
                if self._lock < 0:
                    os.close(handle)
        os.ftruncate(self._lock, 0)
        os.write(self._lock, f"process {os.getpid()} on {socket.gethostname()}\n".encode())

    def release(self) -> None:
        """Give the folder back; without content, folders that were made for it are removed."""
        if self._lock >= 0:
            if self.unfinished.is_dir() and not any(self.unfinished.glob("*.parquet")):
                self.forget()
            with contextlib.suppress(OSError):
                os.unlink(self.path / LOCK)
            os.close(self._lock)
        for folder in [] if self._keeps else reversed(self._made):
            with contextlib.suppress(OSError):
                folder.rmdir()


@contextlib.contextmanager
def claimed(path: str | os.PathLike[str], *, overwrite: bool = False, resume: bool = False) -> Iterator[RunFolder]:
    """Claim a folder for one run, which no other process may claim meanwhile; missing parents are made.

    Nothing in it is changed before the run is written. The claim dies with its holder, however that ends. With
    `overwrite` it may hold a run, which the new one replaces as a whole; files of other names than a run's are never
    touched. With `resume` it may hold a run, finished or not, to be continued.
    """
    if not os.fspath(path):
        raise InputError("the output folder must have a name, got an empty one")
    with _held(Path(path)) as folder:
        folder.require_free(allowed=overwrite or resume)
        if folder.unfinished.exists() and not (overwrite or resume):
            raise InputError(
                f"{path} holds a run that was not finished: go on with it (--resume), replace it (--overwrite) or "
                "choose another folder"
            )
        yield folder


@contextlib.contextmanager
def claimed_new(command: str, now: datetime.datetime) -> Iterator[RunFolder]:
    """Claim, as `claimed`, a new folder: `runs/20261121T093042Z-compare`, or with `-2`, `-3`, ... if that exists."""
    name = f"{now.astimezone(datetime.UTC):%Y%m%dT%H%M%SZ}-{command}"
    for count in itertools.count(1):
        path = Path("runs") / (name if count == 1 else f"{name}-{count}")
        with contextlib.ExitStack() as stack:
            try:
                folder = stack.enter_context(_held(path, is_new=True))
            except InputError:
                if path.is_dir():  # it was there, or another process has just made it
                    continue
                raise
            yield folder
            return


@contextlib.contextmanager
def _held(path, *, is_new=False):
    """Have a folder for a block."""
    folder = RunFolder(path)
    try:
        folder.claim(is_new=is_new)
        yield folder
    finally:
        folder.release()


@contextlib.contextmanager
def _writable(path, *kinds):
    """Refuse a folder with which errors of these kinds occur in the block."""
    try:
        yield
    except InputError:
        raise
    except kinds as error:
        raise InputError(f"{str(path)!r} must be a folder that can be written: {reason(error)}") from error


def _is_locked(handle):
    """Lock an open file; return whether that succeeded, True on systems without locks."""
    try:
        import fcntl

        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except (ImportError, OSError):  # a system, or a file system, without locks
        return True
    return True


def _hidden(folder):
    return Path(folder) / f".{os.getpid()}-{secrets.token_hex(4)}{STAGED}"


@contextlib.contextmanager
def _staged(folder, contents):
    """Write files into a hidden folder inside `folder` that is removed afterwards."""
    stage = _hidden(folder)
    try:
        with _writable(folder, OSError):
            stage.mkdir()
            for name, content in contents.items():
                write_content(content, stage / name)
            yield stage
    finally:
        shutil.rmtree(stage, ignore_errors=True)
