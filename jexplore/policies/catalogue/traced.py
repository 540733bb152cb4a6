"""Identity of functions by the computation that JAX traces.

The trace holds every number that the functions work with, from any source: a helper, an object, a file. It does not
hold the Python code of a callback.
"""

import hashlib
import re
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

_ADDRESS = re.compile(r"0x[0-9a-fA-FX]+")  # address of an object in memory, irrelevant here


def digest(traced: ClosedJaxpr) -> str | None:
    """Return SHA-256 of a traced function, in hexadecimal digits: equal computations agree in every process.

    Returns:
      text; None where it cannot be told, because it calls back into Python.
    """
    text = traced.pretty_print(use_color=False)
    found = hashlib.sha256(_ADDRESS.sub("", text).encode())
    for one in _within(traced, set()):
        arrays = list(getattr(one, "consts", ()))
        for equation in getattr(one, "jaxpr", one).eqns:
            if "callback" in equation.primitive.name:
                return None
            written = jax.tree.leaves(list(equation.params.values()))
            arrays += [value.val for value in equation.invars if isinstance(value, Literal)]
            arrays += [value for value in written if isinstance(value, np.ndarray)]  # the text cuts long ones short
        for array in arrays:
            found.update(_bytes(array))
    return found.hexdigest()


def _within(traced, seen) -> Iterator[Any]:
    """Yield a traced function, and those that it calls: each once."""
    if id(traced) not in seen:
        seen.add(id(traced))
        yield traced
        for equation in getattr(traced, "jaxpr", traced).eqns:
            for part in jax.tree.leaves(list(equation.params.values())):
                if isinstance(part, (Jaxpr, ClosedJaxpr)):
                    yield from _within(part, seen)


def _bytes(array):
    """Return the elements of an array with their type and its shape."""
    if jnp.issubdtype(getattr(array, "dtype", np.bool_), jax.dtypes.prng_key):
        array = jax.random.key_data(array)
    array = np.asarray(array)
    return f"{array.dtype}{array.shape}".encode() + np.ascontiguousarray(array).tobytes()
