"""What somebody else has written: found in a module, described in messages, called, its parameters read.

What a user gave is named in every message: the function, its file and line, and what went wrong.
"""

import contextlib
import functools
import importlib
import importlib.machinery
import inspect
import os
import sys
import traceback
import types
from collections.abc import Callable, Hashable
from typing import Any

import jax
import numpy as np

from jexplore.config import InputError
from jexplore.policies.policy import Policy

OUTER = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)


def name_of(thing: Any) -> str | None:
    """What a function or class is called; None if it has no name."""
    while isinstance(thing, functools.partial):
        thing = thing.func
    return getattr(thing, "__name__", None)


def place_of(thing: Any) -> str:
    """File and line where something is defined: text; its module where that is all there is."""
    if isinstance(thing, Policy):
        thing = thing.select
    while isinstance(thing, functools.partial):
        thing = thing.func
    thing = inspect.unwrap(thing) if callable(thing) else thing
    method = getattr(type(thing), "__call__", None)  # noqa: B004
    code = getattr(thing, "__code__", None) or getattr(method, "__code__", None)
    if code is None:
        return getattr(thing, "__module__", None) or "?"
    return f"{_short(code.co_filename)}:{code.co_firstlineno}"


def _short(file):
    """A file as people call it: relative where that is shorter."""
    with contextlib.suppress(ValueError):  # another drive
        relative = os.path.relpath(file)
        return relative if len(relative) < len(file) else file
    return file


def described(thing: Any) -> str:
    """How messages call what a user gave: `nearest (mine.py:3)`."""
    if isinstance(thing, Policy):
        thing = thing.select
    return f"{name_of(thing) or type(thing).__name__} ({place_of(thing)})"


def call(function: Callable[..., Any], what: str, *args: Any, **kwargs: Any) -> Any:
    """Calls what a user gave.

    Raises:
      InputError: it raised something: one line that says what, and where.
    """
    try:
        return function(*args, **kwargs)
    except InputError:
        raise
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        own = [frame for frame in frames if not _is_library(frame.filename)]
        where = f" at {_short(own[-1].filename)}:{own[-1].lineno}" if own else ""
        said = next((line.strip() for line in str(error).splitlines() if line.strip()), "")
        raise InputError(f"{what} raised {type(error).__name__}{where}: {said}") from error


_FILES = (jax.__file__, np.__file__, contextlib.__file__)  # of jax, numpy and Python itself
_LIBRARIES = tuple(
    os.path.join(os.path.abspath(folder), "")
    for folder in (*map(os.path.dirname, _FILES), os.path.join(os.path.dirname(__file__), "..", ".."))
)


def _is_library(file):
    return file.startswith("<frozen") or os.path.abspath(file).startswith(_LIBRARIES)


def parameters(make: Any) -> dict[str, inspect.Parameter]:
    """Keyword parameters of a constructor or score.

    Raises:
      InputError: something whose parameters cannot be read.
    """
    if isinstance(make, Policy):
        return {}
    try:
        found = inspect.signature(make).parameters.values()
    except (TypeError, ValueError):
        raise InputError(
            f"{make!r} is no strategy: expected a function of the view, a constructor or a Policy"
        ) from None
    needed = [p for p in found if p.kind in OUTER and p.default is p.empty]
    keyed = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    return {p.name: p for p in found if p.kind in keyed and p not in needed}


def is_score(make: Any) -> bool:
    """Whether a callable is a score: it has a positional argument without a default, the view.

    Raises:
      InputError: it has several.
    """
    if isinstance(make, Policy):
        return False
    parameters(make)  # readable
    needed = [p.name for p in inspect.signature(make).parameters.values() if p.kind in OUTER and p.default is p.empty]
    if len(needed) > 1:
        raise InputError(
            f"{described(make)} is no strategy: a score takes one argument, the view, and parameters that have "
            f"defaults, got {', '.join(needed)}"
        )
    return bool(needed)


def import_object(module: str, name: str) -> Any:
    """An object of a module, which may lie in the current folder.

    Raises:
      InputError: the module does not import (its own error), or has no such name.
    """
    here = os.getcwd()
    at_home = importlib.machinery.PathFinder.find_spec(module.partition(".")[0], [here]) is not None
    if at_home:  # before anything of that name that is installed; afterwards behind everything
        sys.path.insert(0, here)
    importlib.invalidate_caches()
    try:
        found = importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name and (module == error.name or module.startswith(f"{error.name}.")):
            raise InputError(f"no module {module!r}, neither installed nor in {here}") from error
        raise InputError(f"module {module!r} does not import: {type(error).__name__}: {error}") from error
    except Exception as error:
        said = next((line.strip() for line in str(error).splitlines() if line.strip()), "")
        raise InputError(f"module {module!r} does not import: {type(error).__name__}: {said}") from error
    finally:
        if at_home:
            sys.path.remove(here)
            sys.path += [here] * (here not in sys.path)
    try:
        return getattr(found, name)
    except AttributeError:
        have = [key for key, value in vars(found).items() if callable(value) and not key.startswith("_")]
        raise InputError(
            f"module {module!r} has no {name!r} (there are: {', '.join(have) or 'no functions'})"
        ) from None


class _Itself:
    """A thing that is equal to nothing but itself; kept, so that nothing else takes its place in memory."""

    def __init__(self, thing: object) -> None:
        self.thing = thing

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Itself) and self.thing is other.thing

    def __hash__(self) -> int:
        return id(self.thing)


def fingerprint(thing: Any, seen: tuple[Any, ...] = ()) -> Hashable:
    """What is equal for functions that compute the same: their code, and what they close over and refer to.

    A function that a constructor makes anew, or a notebook's cell defines again, is then compiled once; one whose
    helper has been changed since is another. What is no number, text or function counts as itself only.

    Args:
      thing: a function, or anything that one refers to.
      seen: functions that are being looked at.
    """
    if isinstance(thing, functools.partial):
        keywords = tuple((key, fingerprint(value, seen)) for key, value in sorted(thing.keywords.items()))
        return "partial", fingerprint(thing.func, seen), tuple(fingerprint(a, seen) for a in thing.args), keywords
    if isinstance(thing, types.MethodType):
        return "method", fingerprint(thing.__func__, seen), _Itself(thing.__self__)
    if isinstance(thing, (bool, int, float, complex, str, bytes, os.PathLike, type(None))):
        return type(thing), thing
    if isinstance(thing, tuple):
        return type(thing), tuple(fingerprint(part, seen) for part in thing)
    if not isinstance(thing, types.FunctionType) or _is_library(thing.__code__.co_filename):
        return _Itself(thing)
    if thing in seen:
        return "itself"
    within = *seen, thing
    names = [name for name in sorted(_names(thing.__code__)) if name in thing.__globals__]
    refers = [thing.__globals__[name] for name in names]
    defaults = [*(thing.__defaults__ or ()), *(thing.__kwdefaults__ or {}).values()]
    closes = [cell.cell_contents for cell in thing.__closure__ or () if _is_set(cell)]
    parts = tuple(fingerprint(part, within) for part in (*refers, *defaults, *closes))
    return thing.__code__, tuple(names), parts


def _is_set(cell):
    try:
        cell.cell_contents  # noqa: B018
    except ValueError:  # not yet
        return False
    return True


def _names(code):
    """Names that a code object refers to, and those that the functions in it do."""
    inner = (const for const in code.co_consts if isinstance(const, types.CodeType))
    return set(code.co_names).union(*map(_names, inner))
