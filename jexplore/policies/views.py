"""Strategies that go to sampled view points, the best of them by gain and path: `decision-theoretic`, `gain-rate`.

Decision-theoretic: the most information, discounted by the path. Gonzalez-Banos and Latombe, "Navigation Strategies for
Exploring Indoor Environments", IJRR 21(10-11), 2002, in the form of Holz et al. 2010, section 3.2.

Gain rate: the most information for every metre of the path, the efficiency that Schmid et al., "An Efficient
Sampling-Based Method for Online Informative Path Planning in Unknown Environments", RA-L 5(2), 2020, maximise along a
tree. Here for single view points, with 1 m added to the path, so that the nearest are not preferred without bound.
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Annotated, Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
from jax import Array, lax

from jexplore.arrays import bits
from jexplore.arrays.loops import repeat
from jexplore.config import require_number, require_whole
from jexplore.gain import look, most, prospect, seen_within, stops_and_unknown
from jexplore.native import kernels
from jexplore.planning import Belief, Choice, Field, choose, field, known_of, metres, nearest_of
from jexplore.policies.policy import MinGain, Policy, Span, no_carry
from jexplore.raycast import Beams
from jexplore.reach import FAR

MAX_SAMPLES = 1024  # most samples a plan
Samples: TypeAlias = Annotated[int, Span(50, 1000, is_log=True)]
Spread: TypeAlias = Annotated[float, Span(0.0, 4.0)]


class Views(NamedTuple):
    """Parameters of a strategy that goes to view points."""

    weight: float  # of the path length, in the strategy's own unit
    samples: int  # view points that are drawn for a plan, at most `MAX_SAMPLES`
    spread_m: float  # how far they may lie from a frontier cell
    min_gain: int  # unknown cells that a view point must show to be worth going to
    by_rate: bool = False  # whether `gain_for_path` divides by the path, instead of discounting


def views(weight: tuple[str, float], samples: int, spread_m: float, min_gain: int, *, by_rate: bool = False) -> Views:
    """Check and make `Views`. `weight` is `(name, value)`."""
    return Views(
        require_number(*weight, high=1e6),
        require_whole("samples", samples, low=1, high=MAX_SAMPLES),
        require_number("spread_m", spread_m, high=100),
        require_whole("min_gain", min_gain, low=1, high=2**20),
        by_rate,
    )


def gain_for_path(params: Views, gain: Array, path_m: Array) -> Array:
    """Compute a gain after a path: `gain exp(-weight path)` or `gain / (weight + path)`, in one program."""
    return jnp.where(params.by_rate, gain / (params.weight + path_m), gain * jnp.exp(-params.weight * path_m))


def drawn(key: Array, belief: Belief, reached: Field, params: Views) -> tuple[Array, Array]:
    """Draw view points near frontiers: a frontier cell each, uniformly, and a cell in a disc round it.

    Draw i depends on the key and i only, neither on how many there are nor on the map's padding. Where the disc's cell
    cannot be reached, the frontier cell itself is the view point.

    Returns:
      `row`, `col`: `[MAX_SAMPLES]` int32, the first `params.samples` of which count; H and 0 without a frontier.

    Source:
      Gonzalez-Banos and Latombe 2002. Changed: uniform over frontier cells, and reachable, not merely visible.
    """
    height, width = reached.cost.shape
    key_which, key_where = jax.random.split(key)
    n = jnp.sum(reached.frontier, dtype=jnp.int32)
    which = jax.random.randint(key_which, (MAX_SAMPLES,), 0, jnp.maximum(n, 1))
    cell = jnp.minimum(bits.nth_cells(bits.pack(reached.frontier), which), height * width)
    row, col = cell // width, cell % width
    share, turn = jax.random.uniform(key_where, (2, MAX_SAMPLES))
    distance = jnp.sqrt(share) * params.spread_m / belief.model.cell_m
    near_row = row + jnp.round(distance * jnp.sin(2 * math.pi * turn)).astype(jnp.int32)
    near_col = col + jnp.round(distance * jnp.cos(2 * math.pi * turn)).astype(jnp.int32)
    at = jnp.clip(near_row, 0, height - 1), jnp.clip(near_col, 0, width - 1)
    good = (near_row == at[0]) & (near_col == at[1]) & (reached.cost[at] < FAR) & ~belief.exhausted[at] & (n > 0)
    return jnp.where(good, near_row, row), jnp.where(good, near_col, col)


def best_view(
    utility: Callable[[Views, Array, Array], Array],
    key: Array,
    params: Views,
    belief: Belief,
    reached: Field,
    beams: Beams,
) -> tuple[Array, Array]:
    """Find the view point of the greatest `utility(params, gain, path_m)`, float32, growing with the gain, bits.

    Returns its flat index, -1 if no view point shows enough, and the cells whose entropy could not be counted. Equal
    utilities go to the lowest index.
    """
    height, width = reached.cost.shape
    row, col = drawn(key, belief, reached, params)
    usable = (row < height) & (lax.iota(jnp.int32, MAX_SAMPLES) < params.samples)
    row = jnp.minimum(row, height - 1)
    beams, native = beams.all_round, kernels.target_of(belief.model.native)
    ahead = prospect(known_of(belief), beams)
    path_m = metres(reached.cost[row, col], belief.model.cell_m)
    # The most promising ones first, until the best that was found is better than what the next could be.
    hope = jnp.where(usable, utility(params, most(ahead, row, col, beams), path_m), -jnp.inf)
    order = jnp.argsort(-hope)
    row, col, path_m, hope = row[order], col[order], path_m[order], hope[order]

    def going(state):
        i, best, _ = state
        return (
            (i < MAX_SAMPLES)
            & (hope[jnp.minimum(i, MAX_SAMPLES - 1)] >= best)
            & (hope[jnp.minimum(i, MAX_SAMPLES - 1)] > -jnp.inf)
        )

    def evaluate(state):
        i, best, cell = state
        on, i_ = going(state), jnp.minimum(i, MAX_SAMPLES - 1)
        told = look(ahead, row[i_], col[i_], beams, native=native)
        worth, here = utility(params, told.gain, path_m[i_]), row[i_] * width + col[i_]
        better = on & (told.unknown >= params.min_gain) & ((worth > best) | ((worth == best) & (here < cell)))
        return i + on, jnp.where(better, worth, best), jnp.where(better, here, cell)

    state = jnp.int32(0), jnp.float32(-jnp.inf), jnp.int32(height * width)
    _, _, cell = repeat(going, evaluate, state)
    return jnp.where(cell < height * width, cell, -1), ahead.overflow


def select(
    utility: Callable[[Views, Array, Array], Array],
    key: Array,
    params: Views,
    carry: Any,
    belief: Belief,
    beams: Beams,
    route: Array,
) -> tuple[Any, Choice, Array]:
    """Return the `select` of a strategy with a utility: the best view point, else the nearest frontier."""
    reached = field(belief)
    width = reached.cost.shape[1]
    cell, overflow = best_view(utility, key, params, belief, reached, beams)
    row, col = nearest_of(reached)
    is_view, none = cell >= 0, row < 0
    row = jnp.where(is_view & ~none, cell // width, row)
    col = jnp.where(is_view & ~none, cell % width, col)
    choice, route = choose(belief, route, reached, row, col)
    return carry, dataclasses.replace(choice, is_view=is_view & ~none, overflow=overflow), route


SELECT = functools.partial(select, gain_for_path)
"""The `select` of strategies that weigh gain and path by `gain_for_path`."""


def live(params: Any, belief: Belief, beams: Beams, row: Array, col: Array) -> Array:
    """Return the `live` of such a strategy: a look-around at the view point would still show `params.min_gain`."""
    beams, native = beams.all_round, kernels.target_of(belief.model.native)
    maps = stops_and_unknown(known_of(belief), beams)
    if native:
        seen = kernels.look(native, *maps, jnp.stack([row, col])[:, None], 1, beams, enough=params.min_gain)[0, 0]
    else:
        seen = seen_within(*maps, row, col, beams, jnp.full(1, jnp.inf))[0]
    return seen >= params.min_gain


def decision_theoretic(
    samples: Samples = 500,
    lam: Annotated[float, Span(0.01, 5.0, is_log=True)] = 0.2,
    spread_m: Spread = 1.0,
    min_gain: MinGain = 10,
) -> Policy:
    """Return the policy. Carry: `()`. Parameters: `Views`, with lam (1/m) as the weight."""
    return Policy(no_carry, SELECT, views(("lam", lam), samples, spread_m, min_gain), live)


def gain_rate(
    samples: Samples = 500,
    plus_m: Annotated[float, Span(0.05, 20.0, is_log=True)] = 1.0,
    spread_m: Spread = 1.0,
    min_gain: MinGain = 10,
) -> Policy:
    """Return the policy. Carry: `()`. Parameters: `Views`, with plus_m, added to the path, as the weight."""
    return Policy(no_carry, SELECT, views(("plus_m", plus_m), samples, spread_m, min_gain, by_rate=True), live)
