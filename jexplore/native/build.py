"""Libraries in C++ and CUDA, built once with the installed compiler.

Libraries lie in the cache of compiled programs, under a name that changes with the sources, the machine and the command
of the compiler.
"""

import contextlib
import ctypes
import errno
import functools
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from jexplore.config import InputWarning
from jexplore.engine.backend import cache_folder

FOLDER = Path(__file__).parent
COMPILERS = ("c++", "g++", "clang++")
FLAGS = ("-std=c++17", "-O3", "-shared", "-fPIC")
BUILD_S = 300  # seconds that building may take


class Library(NamedTuple):
    """A library, or the reason for having none."""

    loaded: ctypes.CDLL | None
    why_not: str = ""  # one line
    name: str | None = None  # of one that is there: tells apart what was built of other sources or by other compilers


@functools.cache
def told(instead: str) -> list[str]:
    """Return the reasons that have been given for one way to do without a library."""
    return []


def warn_once(why_not: str, instead: str = "JAX does without native code") -> None:
    """Warn why there is no library; only of the first where several are missing.

    Warns:
      InputWarning: saying so in a line.
    """
    if told(instead):
        return
    told(instead).append(why_not)
    warnings.warn(f"{why_not}: {instead}, with the same results", InputWarning, stacklevel=3)


def find_compiler(variable: str = "CXX", names: Sequence[str] = COMPILERS) -> list[str]:
    """Return a compiler's command: that of a variable (ValueError at an open quote), the first of some, or none."""
    own = shlex.split(os.environ.get(variable, ""))
    return own or [path for path in map(shutil.which, names) if path][:1]


def load_library(
    sources: Sequence[Path], flags: Sequence[str] = (), variable: str = "CXX", names: Sequence[str] = COMPILERS
) -> Library:
    """Load a library, built if missing, once in a process for each compiler; of `sources` the first is compiled.

    Those in C++ are built with `FLAGS`, too. Without a library if the compiler is missing, building fails, or nothing
    can be written.
    """
    try:
        compiler = find_compiler(variable, names)
    except ValueError as error:
        return Library(None, f"{variable} must be a command, got {os.environ[variable]!r}: {str(error).lower()}")
    what, common = ("C++ compiler", FLAGS) if variable == "CXX" else (names[0], ())
    if not compiler:
        return Library(None, f"no {what} was found: expected one of {', '.join(names)}, or its name in {variable}")
    return build_library(tuple(sources), (*compiler, *common, *flags))


@functools.lru_cache(maxsize=16)
def build_library(sources: tuple[Path, ...], command: tuple[str, ...]) -> Library:
    """Load what a compiler's command makes of sources, as `load_library` does."""
    what = "|".join((platform.machine(), platform.system(), *command)).encode()
    digest = hashlib.sha256(what + b"".join(source.read_bytes() for source in sources)).hexdigest()[:16]
    name = f"{sources[0].stem}_{digest}"
    try:
        loaded = _load(sources[0], cache_folder() / f"{name}.so", command)
    except subprocess.CalledProcessError as error:
        telling = "error", os.strerror(errno.ENOSPC)
        lines = [line for line in error.stderr.splitlines() if any(word in line for word in telling)]
        lines = lines or [f"exit status {error.returncode}"]
        return Library(None, f"{command[0]} could not build {sources[0].name}: {lines[0].strip()}")
    except (OSError, RuntimeError, subprocess.TimeoutExpired) as error:  # RuntimeError: no home
        return Library(None, f"{sources[0].name} could not be built by {command[0]} or loaded: {error}")
    return Library(loaded, name=name)


def _load(source, library, command):
    """Return the library, built if it is missing or does not load."""
    if library.is_file():
        with contextlib.suppress(OSError):  # not whole, or built against other libraries
            return ctypes.CDLL(str(library))
    # Built and loaded next to its place, then moved there: concurrent builds do no harm.
    with tempfile.TemporaryDirectory(dir=library.parent) as folder:
        made = Path(folder) / library.name
        subprocess.run(
            [*command, str(source), "-o", str(made)],
            check=True, capture_output=True, text=True, errors="replace", timeout=BUILD_S,
        )  # fmt: skip
        loaded = ctypes.CDLL(str(made))
        os.replace(made, library)
    return loaded
