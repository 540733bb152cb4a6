"""What tells functions apart by what they compute, so that equal ones are compiled once and changed ones again.

A function that a constructor makes anew, or a notebook's cell defines again, is equal to the one before; one whose
helper, number, array or object has changed since is another.
"""

import functools
import hashlib
import os
import sys
import types
from collections.abc import Hashable
from typing import Any

import jax
import numpy as np
from jax.core import Tracer

from jexplore.policies.catalogue.own import is_library

PLAIN = (bool, int, float, complex, str, bytes, os.PathLike, type(None))
MOST = 20_000  # things that are looked at; of a function that refers to more none is like another
_HIDDEN = ("__dict__", "__weakref__", "__doc__", "__module__", "__annotations__", "__firstlineno__")


class _Itself:
    """A thing that is equal to nothing but itself; kept, so that nothing else takes its place in memory."""

    def __init__(self, thing: object) -> None:
        self.thing = thing

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Itself) and self.thing is other.thing

    def __hash__(self) -> int:
        return id(self.thing)


def fingerprint(thing: Any) -> Hashable:
    """What is equal for things that compute the same, as they are now: code, and all that it refers to."""
    seen: dict[Any, tuple[int, Any]] = {}
    found = _look(thing, (), seen)
    return _Itself(object()) if len(seen) > MOST else found


def files_of(thing: Any) -> list[str]:
    """Files that hold the code of a thing and of all that it refers to, in a user's folders: sorted."""
    seen: dict[Any, tuple[int, Any]] = {}
    _look(thing, (), seen)
    codes = (found.__code__ for _, found in seen.values() if isinstance(found, types.FunctionType))
    names = {code.co_filename for code in codes if not _is_installed(code.co_filename)}
    return sorted(name for name in names if os.path.isfile(name))


def _look(thing, names, seen):
    if isinstance(thing, PLAIN):
        return type(thing), thing, str(thing) if isinstance(thing, float) else None  # 0.0 and -0.0 differ
    place = (
        (id(thing), names) if isinstance(thing, types.ModuleType) else id(thing)
    )  # a module as each function sees it
    if place in seen:
        return "seen", seen[place][0]
    if len(seen) > MOST:
        return None
    seen[place] = len(seen), thing  # kept: what is made on the way must not make room for another

    def each(parts):
        return tuple(_look(part, names, seen) for part in parts)

    if isinstance(thing, np.ndarray) and thing.dtype != object:
        return "array", thing.shape, thing.dtype.str, hashlib.sha256(np.ascontiguousarray(thing).tobytes()).digest()
    if isinstance(thing, (tuple, list)):
        return type(thing).__name__, each(thing)
    if isinstance(thing, dict):
        return "dict", each(thing), each(thing.values())
    if isinstance(thing, functools.partial):
        return "partial", each((thing.func, thing.args, thing.keywords))
    if isinstance(thing, types.MethodType):
        return "method", each((thing.__func__, thing.__self__))
    if isinstance(thing, (staticmethod, classmethod)):
        return type(thing).__name__, each((thing.__func__,))
    if isinstance(thing, property):
        return "property", each((thing.fget,))
    if isinstance(thing, types.FunctionType):
        return _of_function(thing, seen)
    if isinstance(thing, types.ModuleType):
        return _of_module(thing, names, seen)
    return _of_object(thing, each)


def _of_function(function, seen):
    """Its code, what it refers to, its defaults, what it closes over, what hangs on it.

    What is installed refers to what is installed, which does not change; but it may have been made of what does.
    """
    names = () if _is_installed(function.__code__.co_filename) else tuple(sorted(_names(function.__code__)))
    known = [name for name in names if name in function.__globals__]
    refers = [function.__globals__[name] for name in known]
    closes = [cell.cell_contents for cell in function.__closure__ or () if _is_set(cell)]
    parts = (*refers, function.__defaults__, function.__kwdefaults__, *closes, vars(function))
    return function.__code__, tuple(known), tuple(_look(part, names, seen) for part in parts)


def _of_module(module, names, seen):
    """Of a user's module, what the names in the code that refers to it stand for in it."""
    if _is_fixed(module):
        return _Itself(module)
    known = [name for name in names if name in vars(module)]
    return "module", module.__name__, tuple(known), tuple(_look(vars(module)[name], names, seen) for name in known)


def _of_object(thing, each):
    """A class: what is written in it; an object: its class and what it holds; what holds nothing: itself."""
    if isinstance(thing, jax.Array) and not isinstance(thing, Tracer):
        return _Itself(thing)  # never changes
    if isinstance(thing, type):
        if _is_fixed(sys.modules.get(thing.__module__)):
            return _Itself(thing)
        own = {key: value for key, value in vars(thing).items() if key not in _HIDDEN}
        return "class", thing.__qualname__, each((own, *thing.__bases__))
    inner = getattr(thing, "__wrapped__", None)  # as by jax.jit
    if inner is not None:
        return "wrapped", each((inner, type(thing)))
    if hasattr(thing, "__dict__") and vars(thing):
        return "object", each((type(thing), vars(thing)))
    return _Itself(thing)


def _is_installed(file):
    return is_library(file) or "site-packages" in file or "dist-packages" in file


def _is_fixed(module):
    """Whether a module is installed, and not a user's: None is a class's that was made without one."""
    file = getattr(module, "__file__", None)
    return getattr(module, "__name__", None) in sys.builtin_module_names or (file is not None and _is_installed(file))


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
