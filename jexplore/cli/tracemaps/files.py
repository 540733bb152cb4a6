"""Files of trace maps on the command line: names, checks of output files; progress of merging."""

import contextlib
import os
from collections.abc import Callable, Sequence
from pathlib import Path

from jexplore.cli.output.console import working
from jexplore.config import InputError

TRACED = "btm"  # what every run calls its map


def names_of(command: str, paths: Sequence[str], given: Sequence[str] = ()) -> list[str]:
    """Return names of maps: the given ones, else each by its own file alone, however its path is typed.

    This is the file without suffix, or its folder if the file is `btm.json`.
    """
    again = [path for i, path in enumerate(paths) if any(_are_one(path, other) for other in paths[:i])]
    if again:
        raise InputError(f"{command}: expected every map once, got {again[0]} again")
    if given and len(given) != len(paths):
        raise InputError(f"{command}: --names: expected a name for each of {len(paths)} maps, got {len(given)}")
    names = list(given) or [_name(Path(path).expanduser().resolve()) for path in paths]
    for i, name in enumerate(names):
        if name in names[:i]:
            both = f"{paths[names.index(name)]} and {paths[i]}"
            raise InputError(f'{command}: {both} are both called "{name}": call them otherwise with --names')
    return names


def _name(path):
    return path.parent.name if path.stem == TRACED and path.parent.name else path.stem


def comparing(count: int) -> contextlib.AbstractContextManager[Callable[[int], None]]:
    """Show progress of merging a number of maps, as `console.working`."""
    return working((count - 1) ** 2, "pairs of maps", "jexplore: comparing maps")


def file_out(out: str, maps: Sequence[str], *, overwrite: bool) -> Path:
    """Check the path of an output file before anything is read, and return it."""
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
