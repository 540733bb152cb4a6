"""Fingerprints of users' functions: their code, and the values that it uses."""

import hashlib
import sys
import types
import warnings
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jexplore.users import is_library

PLAIN = type(None), bool, int, float, complex, str, bytes, type(...)


def fingerprint(*things: Any) -> str:
    """Return SHA-256, in hexadecimal digits, of functions and values: the same in every process.

    A function counts with its bytecode, constants, defaults, closure, attributes, and the globals that it names.
    Functions, classes and modules of the user's count in the same way, those of installed packages and of Python by
    their names; other values as they would be pickled. What a function reads in another way, as from a file, does not.
    """
    found, seen = hashlib.sha256(), {}
    for part in _parts(things, seen):
        found.update(part + b";")
    return found.hexdigest()


def _parts(thing, seen) -> Iterator[bytes]:
    """Yield bytes that tell a value from others. `seen`: id -> number and object of those that were met."""
    yield type(thing).__qualname__.encode()
    if isinstance(thing, PLAIN):
        yield repr(thing).encode()
        return
    if id(thing) in seen:
        yield str(seen[id(thing)][0]).encode()
        return
    if not isinstance(thing, (tuple, types.CodeType)):  # those that are equal may be one object or several
        seen[id(thing)] = len(seen), thing
    if isinstance(thing, (np.generic, jax.Array)) or type(thing) is np.ndarray:
        yield from _array_parts(thing, seen)
        return
    for part in _inside(thing):
        yield from _parts(part, seen)


def _array_parts(array, seen):
    if jnp.issubdtype(array.dtype, jax.dtypes.prng_key):
        array = jax.random.key_data(array)
    array = np.asarray(array)
    yield f"{array.dtype}{array.shape}".encode()
    yield from _parts(array.tolist(), seen) if array.dtype.hasobject else [np.ascontiguousarray(array).tobytes()]


def _inside(thing) -> Iterator[Any]:
    """Yield what tells an object from others of its type."""
    if isinstance(thing, types.CodeType):
        yield from (thing.co_code, thing.co_names, thing.co_consts)
    elif isinstance(thing, types.FunctionType):
        yield thing.__qualname__
        if _is_own(thing.__module__, thing.__code__.co_filename):
            yield from (thing.__code__, thing.__defaults__, thing.__kwdefaults__, vars(thing), thing.__closure__)
            yield {name: thing.__globals__[name] for name in _names(thing.__code__) if name in thing.__globals__}
    elif isinstance(thing, types.CellType):
        yield from [thing.cell_contents] if thing != types.CellType() else []
    elif isinstance(thing, (type, types.ModuleType)):
        yield thing.__name__
        if _is_own(getattr(thing, "__module__", thing.__name__)):
            own = {name: value for name, value in vars(thing).items() if not name.startswith("__") or callable(value)}
            yield from (own, getattr(thing, "__bases__", ()))
    elif isinstance(thing, dict):
        for pair in thing.items():
            yield from pair
    elif isinstance(thing, (list, tuple)):
        yield from thing
    elif isinstance(thing, (set, frozenset)):
        yield from sorted(thing, key=repr)
    elif hasattr(thing, "__wrapped__"):  # as of jax.jit
        yield thing.__wrapped__
    else:
        yield type(thing)
        try:
            with warnings.catch_warnings(action="ignore"):
                how = thing.__reduce_ex__(4)
        except Exception:  # it cannot be pickled: a lock, a file, a compiled function
            return
        for part in [how] if isinstance(how, str) else how:
            yield list(part) if hasattr(part, "__next__") else part


def _names(code) -> Iterator[str]:
    """Return the names of globals and attributes in a code, and in those inside it."""
    yield from code.co_names
    for const in code.co_consts:
        if isinstance(const, types.CodeType):
            yield from _names(const)


def _is_own(name, file=None):
    """Return whether a module is the user's, not installed: by its name, or by the file of a function's code."""
    module = sys.modules.get(name or "")
    file = file or getattr(module, "__file__", None)
    if file is None:
        return getattr(module, "__spec__", None) is None
    return not (is_library(file) or "site-packages" in file or "dist-packages" in file)
