"""The robot's numbers as one tree, and the tree that code reads while a program is traced.

Code reads `P.sensing.every_m`. Outside `using` that is a number of Python, a constant of whatever is compiled; inside
it is a leaf of the tree given there: runs that differ in any numbers then share one program.
"""

import contextlib
import contextvars
import dataclasses
from collections.abc import Iterator, Mapping
from typing import cast

import jax
import numpy as np
from jax.tree_util import register_dataclass

from jexplore.driving.params.groups import Params, default_numbers
from jexplore.rules import Settings

DEFAULT = Params()
for _kind in (Params, *map(type, vars(DEFAULT).values())):
    register_dataclass(_kind, [field.name for field in dataclasses.fields(_kind)], [])
_scope: contextvars.ContextVar[Params] = contextvars.ContextVar("params")


class _InScope:
    """Groups of the tree in scope."""

    def __getattr__(self, group: str) -> Settings:
        return getattr(_scope.get(DEFAULT), group)


P = cast(Params, _InScope())


@contextlib.contextmanager
def using(params: Params | None) -> Iterator[None]:
    """Let code read this tree; None: the defaults, as constants."""
    token = _scope.set(DEFAULT if params is None else params)
    try:
        yield
    finally:
        _scope.reset(token)


def params_with(values: Mapping[str, np.ndarray], n: int) -> Params | None:
    """Return the tree of n runs, leaves `[n]`: those named as `default_numbers` has them as given, the rest by default.

    None without any: then all are constants.
    """
    if not values:
        return None
    leaves, tree = jax.tree.flatten(DEFAULT)
    kinds = (np.int32 if isinstance(leaf, int) else np.float32 for leaf in leaves)
    filled = (
        np.asarray(values[name] if name in values else np.full(n, leaf), kind)
        for name, leaf, kind in zip(default_numbers(), leaves, kinds)
    )
    return jax.tree.unflatten(tree, filled)
