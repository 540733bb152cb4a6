"""Kernels in C++ for programs on a CPU: built once with the compiler that is there, called through JAX's typed FFI.

What is built is kept beside compiled programs, under a name that changes with the source, JAX and the command of the
compiler.
"""

import contextlib
import ctypes
import functools
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import jax

from jexplore.engine.backend import cache_folder

COMPILERS = ("c++", "g++", "clang++")
FLAGS = ("-std=c++17", "-O2", "-shared", "-fPIC")
BUILD_S = 300  # seconds that building may take


class Native(NamedTuple):
    """A kernel in C++, or why there is none."""

    target: str | None  # name for `jax.ffi.ffi_call`; None: there is none
    why_not: str = ""  # one line


def find_compiler() -> list[str]:
    """The command of a C++ compiler: `$CXX` if that is set, else the first of `COMPILERS` that is there; or none."""
    own = shlex.split(os.environ.get("CXX", ""))
    return own or [path for path in map(shutil.which, COMPILERS) if path][:1]


def load_kernel(source: Path, symbol: str) -> Native:
    """A kernel in C++ as a target of JAX's FFI, built if need be. Once in a process for each compiler.

    Args:
      source: C++ file that defines `symbol` by `XLA_FFI_DEFINE_HANDLER_SYMBOL`.
      symbol: name of the handler.

    Returns:
      `Native`. There is none without a compiler, where building fails, or where nothing can be written.
    """
    try:
        compiler = tuple(find_compiler())
    except ValueError as error:  # an open quote
        return Native(None, f"CXX must be a command, got {os.environ['CXX']!r}: {str(error).lower()}")
    return _loaded(source, symbol, compiler)


@functools.lru_cache(maxsize=8)
def _loaded(source, symbol, compiler):
    if not compiler:
        return Native(None, f"no C++ compiler was found: expected one of {', '.join(COMPILERS)}, or its name in CXX")
    text = source.read_bytes()
    made_from = [jax.__version__, version("jaxlib"), platform.machine(), *compiler, *FLAGS]
    name = f"{symbol}_{hashlib.sha256('|'.join(made_from).encode() + text).hexdigest()[:16]}"
    try:
        handler = _handler(source, symbol, cache_folder() / f"{name}.so", compiler)
    except subprocess.CalledProcessError as error:
        lines = [line for line in error.stderr.splitlines() if "error" in line] or [f"exit status {error.returncode}"]
        return Native(None, f"{compiler[0]} could not build {source.name}: {lines[0].strip()}")
    except (OSError, RuntimeError, AttributeError, subprocess.TimeoutExpired) as error:  # RuntimeError: no home
        return Native(None, f"{source.name} could not be built by {compiler[0]} or loaded: {error}")
    # The name tells programs in the cache of compiled ones apart as well.
    jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(handler), platform="cpu")
    return Native(name)


def _handler(source, symbol, library, compiler):
    """The handler in a library, which is built where there is none, or one that does not load."""
    if library.is_file():
        with contextlib.suppress(OSError, AttributeError):  # not whole, or built against other libraries
            return getattr(ctypes.cdll.LoadLibrary(str(library)), symbol)
    # Built and loaded beside its place, then moved there: whoever else builds it at the same time does no harm.
    with tempfile.TemporaryDirectory(dir=library.parent) as folder:
        made = Path(folder) / library.name
        command = [*compiler, *FLAGS, f"-I{jax.ffi.include_dir()}", str(source), "-o", str(made)]
        subprocess.run(command, check=True, capture_output=True, text=True, errors="replace", timeout=BUILD_S)
        handler = getattr(ctypes.cdll.LoadLibrary(str(made)), symbol)
        os.replace(made, library)
    return handler
