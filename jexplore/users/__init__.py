"""Users' code: found in a module, described in messages, called. Importing this loads neither jax nor numpy.

Every message names the user's function, its file and line, and the error.
"""

import contextlib
import dataclasses
import functools
import importlib
import importlib.machinery
import importlib.util
import inspect
import os
import sys
import traceback
from collections.abc import Callable
from typing import Any

from jexplore.arrays.files import first_line
from jexplore.config import InputError


def bare(thing: Any) -> Any:
    """Return the function that names an object: a policy's `select`, the function of a partial."""
    thing = thing.select if type(thing).__name__ == "Policy" else thing
    while isinstance(thing, functools.partial):
        thing = thing.func
    return thing


def name_of(thing: Any) -> str | None:
    """Return the name of a strategy, function or class; None without one."""
    return getattr(bare(thing), "__name__", None)


def place_of(thing: Any) -> str:
    """Return file and line of a definition: text; else its module."""
    thing = bare(thing)
    thing = inspect.unwrap(thing) if callable(thing) else thing
    method = getattr(type(thing), "__call__", None)  # noqa: B004
    code = getattr(thing, "__code__", None) or getattr(method, "__code__", None)
    if code is None:
        return getattr(thing, "__module__", None) or "?"
    return f"{_short(code.co_filename)}:{code.co_firstlineno}"


def _short(file):
    """Shorten the path of a file: relative if that is shorter."""
    with contextlib.suppress(ValueError):  # another drive
        relative = os.path.relpath(file)
        return relative if len(relative) < len(file) else file
    return file


def described(thing: Any) -> str:
    """Describe a user's object in messages: `nearest (mine.py:3)`."""
    return f"{name_of(thing) or type(bare(thing)).__name__} ({place_of(thing)})"


def call_user(function: Callable[..., Any], what: str, *args: Any, **kwargs: Any) -> Any:
    """Call a user's function; whatever it raises becomes an `InputError` of one line that says what, and where."""
    try:
        return function(*args, **kwargs)
    except InputError:
        raise
    except (Exception, SystemExit) as error:
        frames = traceback.extract_tb(error.__traceback__)
        own = [frame for frame in frames if not is_library(frame.filename)]
        where = f" at {_short(own[-1].filename)}:{own[-1].lineno}" if own else ""
        raise InputError(f"{what} raised {type(error).__name__}{where}: {first_line(error)}{_hint(error)}") from error


def _hint(error):
    """Return a hint for common errors."""
    jax = sys.modules.get("jax")
    if jax and isinstance(error, (jax.errors.ConcretizationTypeError, jax.errors.TracerArrayConversionError)):
        return " Values are not known while JAX traces: jnp.where instead of if, jnp instead of math and numpy."
    if isinstance(error, AttributeError) and type(error.obj).__name__ in ("View", "EpisodeView"):
        kind: Any = type(error.obj)
        names = [field.name for field in dataclasses.fields(kind)]
        names += [name for one in kind.__mro__ for name, value in vars(one).items() if isinstance(value, property)]
        return f" (it has {', '.join(names)}; the robot is in its belief)"
    return ""


_PYTHON = os.path.join(os.path.dirname(os.path.abspath(contextlib.__file__)), "")


@functools.cache
def _libraries():
    """Folders of jax, numpy and this package; found without importing them."""
    files = [spec.origin for spec in map(importlib.util.find_spec, ("jax", "numpy", "jexplore")) if spec]
    return tuple(os.path.join(os.path.dirname(os.path.abspath(file or "")), "") for file in files)


def is_library(file: str) -> bool:
    """Return whether a file belongs to Python, jax, numpy or this package, rather than to a user or another package."""
    file = os.path.abspath(file)
    installed = "site-packages" in file or "dist-packages" in file
    return file.startswith(_libraries()) or (file.startswith(_PYTHON) and not installed) or "<frozen" in file


_LOADED: dict[str, tuple[Any, bytes | None]] = {}  # modules of the current folder: file, and what was in it


def _is_own(file, folder):
    """Return whether a file lies in a folder and is not installed, as in an environment inside that folder."""
    if is_library(file) or "site-packages" in file or "dist-packages" in file:
        return False
    return os.path.realpath(file).startswith(os.path.join(os.path.realpath(folder), ""))


def import_object(module: str, name: str) -> Any:
    """Import an object of a module, possibly from the current folder; modules that it imports may lie there, too."""
    here = os.getcwd()
    with _imported_from(here, module.partition(".")[0]):
        try:
            found = importlib.import_module(module)
        except ModuleNotFoundError as error:
            if error.name and (module == error.name or module.startswith(f"{error.name}.")):
                raise InputError(f"no module {module!r}, neither installed nor in {here}") from error
            raise InputError(f"module {module!r} does not import: {type(error).__name__}: {error}") from error
        except (Exception, SystemExit) as error:
            what = f"{type(error).__name__}: {first_line(error)}"
            raise InputError(f"module {module!r} does not import: {what}") from error
    try:
        return getattr(found, name)
    except AttributeError:
        have = [key for key, value in vars(found).items() if callable(value) and not key.startswith("_")]
        what = f"(there are: {', '.join(have) or 'no functions'})"
        raise InputError(f"module {module!r} has no {name!r} {what}") from None


@contextlib.contextmanager
def _imported_from(here, top):
    """Import modules of a folder in their present form: those that a user has imported are set aside meanwhile."""
    if not all(_is_own(file, here) and _content(file) == data for file, data in _LOADED.values()):
        for name in _LOADED:
            sys.modules.pop(name, None)
        _LOADED.clear()
    aside = {name: module for name, module in sys.modules.items() if _is_theirs(name, module, here)}
    for name in aside:
        del sys.modules[name]
    before, writes_none = set(sys.modules), sys.dont_write_bytecode
    sys.path.insert(0, here)
    sys.dont_write_bytecode = True  # Python knows files by size and second
    importlib.invalidate_caches()
    try:
        spec = importlib.machinery.PathFinder.find_spec(top, [here])
        if spec is not None and spec.origin and top in sys.modules and top not in _LOADED:
            file = getattr(sys.modules[top], "__file__", None) or "Python itself"
            raise InputError(f"{_short(spec.origin)} is hidden by another module {top!r}, of {file}: rename it")
        yield
    finally:
        sys.dont_write_bytecode = writes_none
        sys.path.remove(here)
        loaded = {name: sys.modules[name] for name in set(sys.modules) - before}
        _LOADED.update({n: (m.__file__, _content(m.__file__)) for n, m in loaded.items() if _is_theirs(n, m, here)})
        tops = {name.partition(".")[0] for name in _LOADED}
        sys.modules.update({name: module for name, module in aside.items() if name.partition(".")[0] not in tops})


def _is_theirs(name, module, here):
    """Return whether a user has imported a module from a folder: with source, and not the program itself."""
    file = getattr(module, "__file__", None)
    is_source = isinstance(file, str) and file.endswith(".py")
    return is_source and name != "__main__" and name not in _LOADED and _is_own(file, here)


def _content(file):
    """Return the present content of a file; None if it does not exist."""
    with contextlib.suppress(OSError), open(file, "rb") as opened:
        return opened.read()
