"""The shape that every strategy has."""

from collections.abc import Callable
from typing import Annotated, Any, NamedTuple, TypeAlias

from jax import Array

from jexplore.config import checked_names
from jexplore.planning import Belief, Choice
from jexplore.raycast import Beams


@checked_names
class Policy(NamedTuple):
    """A strategy as a pair of pure functions of one robot's belief, and what it needs besides.

    `init(params, belief)` returns the carry, what the strategy remembers from plan to plan: a pytree of arrays, whose
    shapes and dtypes never change. `select(key, params, carry, belief, beams, route)` returns the next carry, a
    `Choice`, and the map of motions in which the way there is laid: `planning.choose` makes the last two, of a cell of
    a `planning.Field`, as `planning.nearest_frontier` does of the nearest frontier cell.

    Compiled once for each `init` and `select`. `params` are leaves, so that a sweep over numbers never recompiles;
    arrays among them (weights) are shared by all robots.
    """

    init: Callable[[Any, Belief], Any]
    """`(params, belief) -> carry`, before the first plan."""
    select: Callable[[Array, Any, Any, Belief, Beams, Array], tuple[Any, Choice, Array]]
    """`(key, params, carry, belief, beams, route) -> (carry, choice, route)`; the key is consumed."""
    params: Any = ()
    """Pytree of numbers and arrays."""
    live: Callable[[Any, Belief, Beams, Array, Array], Array] | None = None
    """`(params, belief, beams, row, col) -> bool`: whether a view point, a target that is no frontier cell
    (`Choice.is_view`), is worth going to. Without it the robot goes there whatever it sees on its way."""


@checked_names
class Strategy(NamedTuple):
    """A strategy as asked for."""

    name: str  # what tables call it
    policy: Policy
    recheck: bool = False  # whether a target is given up as soon as it is no longer live


def no_carry(params: Any, belief: Belief) -> tuple[()]:
    """Return the carry of a strategy that remembers nothing: its `init`."""
    return ()


class Span(NamedTuple):
    """Bounds between which `jexplore tune` draws a setting: the metadata of a constructor's annotated parameter."""

    low: float
    high: float
    is_log: bool = False  # whether its logarithm is drawn uniformly


MinGain: TypeAlias = Annotated[int, Span(1, 200, is_log=True)]
"""Unknown cells that a look must show: up to 2 m^2 of cells of 0.1 m."""


class Entry(NamedTuple):
    """Entry of a strategy in the list of strategies."""

    make: Any  # constructor (keyword parameters -> `Policy`), score (a function of the view), or `Policy`
    summary: str = ""
    source: str = ""
    is_own: bool = False  # whether it comes from outside this package
