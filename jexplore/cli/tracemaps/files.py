"""Files of Behavioral Trace Maps on the command line: which they are, what they are called, where a result may go."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from jexplore.config import InputError

Files = Annotated[tuple[str, ...], tyro.conf.arg(metavar="FILE [FILE ...]", help_behavior_hint="")]


def names_of(paths: Sequence[str]) -> list[str]:
    """What maps are called: their files without folder and suffix where these differ, else the paths."""
    stems = [Path(path).stem for path in paths]
    return stems if len(set(stems)) == len(stems) else [str(path) for path in paths]


def require_once(command: str, paths: Sequence[str]) -> None:
    """Refuse a file that is given twice.

    Raises:
      InputError: naming it.
    """
    same = [path for i, path in enumerate(paths) if any(_are_one(path, other) for other in paths[:i])]
    if same:
        raise InputError(f"{command}: expected every map once, got {same[0]} again")


def file_out(out: str, maps: Sequence[str], *, overwrite: bool) -> Path:
    """Where to write one file, checked before anything is read.

    Raises:
      InputError: it is one of the maps, a folder, there already, or in no folder.
    """
    path = Path(out).expanduser()
    if any(_are_one(one, path) for one in maps):
        raise InputError(f"--out {out} is one of the maps: name another file")
    if path.is_dir():
        raise InputError(f"--out {out} must be a file, and is a folder")
    if path.exists() and not overwrite:
        raise InputError(f"--out {out} is there already: name another file, or replace it with --overwrite")
    if not path.absolute().parent.is_dir():
        raise InputError(f"--out {out}: there is no folder {path.absolute().parent}")
    return path


def _are_one(path, other):
    try:
        return os.path.samefile(path, other)
    except OSError:  # one is not there
        return os.path.abspath(path) == os.path.abspath(other)
