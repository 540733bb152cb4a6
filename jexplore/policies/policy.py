"""The shape that every strategy has."""

from collections.abc import Callable
from typing import Any, NamedTuple


class Policy(NamedTuple):
    """A strategy as a pair of pure functions and what it needs besides.

    Compiled once per `init` and `select`; `params` are leaves, so a sweep over them never recompiles.
    """

    init: Callable  # (params, belief) -> carry, before the first plan
    select: Callable  # (key, params, carry, belief, beams, route) -> (carry, Choice, route); the key is consumed
    params: Any = ()  # pytree of numbers
    live: Callable | None = None  # (params, belief, beams, row, col) -> bool: whether a view point is worth going to


class Entry(NamedTuple):
    """What the list of strategies says about one of them."""

    make: Callable[..., Policy]  # keyword parameters -> Policy
    summary: str
    source: str
