"""Mutual information: go to the frontier cluster whose look-around tells most about the map for a metre of the way.

Zhang, Henderson, Karaman, Sze, "FSMI: Fast Computation of Shannon Mutual Information for Information-Theoretic
Mapping", IJRR 39(9), 2020, Theorem 1, for a range without noise: a beam tells `sum_j P(e_j) C_j`, where P(e_j) is the
probability that cell j is the first occupied one, and C_j = f(delta_occ, r_j) + sum_{i<j} f(delta_emp, r_i) with
`f(delta, r) = log((r + 1) / (r + 1 / delta)) - log(delta) / (r delta + 1)`, r the odds that a cell is occupied. Beams
count as independent, as there; these formulas agree with the authors' code. Information for a metre of the way is after
Charrow et al., "Information-Theoretic Planning with Trajectory Optimization for Dense 3D Mapping", RSS 2015; how they
weigh information (CSQMI) and way is not verified. Changed: a beam that meets nothing tells of the cells that it passes;
r is of the reflection probability, 1 where nothing is known. Left out: noise of the range, information along the way,
trajectories.
"""

from typing import Annotated, NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from jexplore.config import InputError, require_number
from jexplore.gain import Known, stops_and_unknown
from jexplore.planning import Belief, known_of
from jexplore.policies.clusters import Best, Targets, at_each
from jexplore.policies.policy import Policy, Span, no_carry
from jexplore.raycast import Beams, square_side

NEGLIGIBLE = 1e-6  # probability that a beam reaches a cell, below which the cell is not counted


class Params(NamedTuple):
    """Parameters."""

    plus_m: float  # added to the path, so that the nearest are not preferred without bound
    delta: float  # by which a hit multiplies the odds that a cell is occupied, and a miss divides them


def tells(p: Array, delta: Array | float) -> Array:
    """Compute f(delta, r) of Theorem 1, nats, from probabilities `p = r / (1 + r)`: 0 where p is 0 or 1."""
    told = -jnp.log(p + (1 - p) / delta) - jnp.log(delta) * (1 - p) / (p * delta + 1 - p)
    return jnp.where((p > 0) & (p < 1), told, 0.0)


def _maps(known: Known, beams: Beams, delta: Array | float) -> Array:
    """Return the probability that a cell is occupied, and what a hit and a miss there tell: `[3, H + 2 R, W + 2 R]`."""
    stops, unknown = stops_and_unknown(known, beams)
    hits, misses = known.grid.hits, known.grid.misses
    seen = (hits / jnp.maximum(hits + misses, 1)).astype(jnp.float32)
    p = jnp.pad(seen, (stops.shape[0] - seen.shape[0]) // 2)
    p = jnp.where(unknown, 0.5, jnp.where(stops & (p == 0), 1.0, p))  # the outline, where it is known, stops beams
    return jnp.stack([p, tells(p, delta), tells(p, 1 / delta)])


def look_around(maps: Array, row: Array | int, col: Array | int, beams: Beams) -> Array:
    """Compute the mutual information of the map and a look-around at a cell: float32, nats.

    Args:
      maps: of `_maps`.
      row, col: int32, the cell.
      beams: `Beams.all_round`.
    """
    side = square_side(beams)
    near = lax.dynamic_slice(maps, (0, row, col), (3, side, side)).reshape(3, -1)
    middle = side // 2 * side + side // 2

    def going(state):
        step, reaches, *_ = state
        return (step < beams.offset.shape[1]) & jnp.any((reaches > NEGLIGIBLE) & (step < beams.length[0]))

    def enter(state):
        step, reaches, passed, told = state
        # Beyond its range a beam meets nothing, and what it passes tells nothing.
        p, hit, miss = jnp.where(step < beams.length[0], near[:, middle + beams.offset[0, step]], 0.0)
        return step + 1, reaches * (1 - p), passed + miss, told + reaches * p * (passed + hit)

    none = jnp.zeros(beams.length.shape[1], jnp.float32)
    _, reaches, passed, told = lax.while_loop(going, enter, (jnp.int32(0), none + 1, none, none))
    return jnp.sum(told + reaches * passed)


def _judge(params: Params, belief: Belief, at: Targets, beams: Beams) -> tuple[Array, Array]:
    beams = beams.all_round
    maps = _maps(known_of(belief), beams, params.delta)
    nats = at_each(at, lambda row, col: look_around(maps, row, col, beams), jnp.zeros(at.row.shape, jnp.float32))
    return nats / (params.plus_m + at.path_m), nats > 0


def mutual_information(
    plus_m: Annotated[float, Span(0.05, 20.0, is_log=True)] = 1.0,
    delta: Annotated[float, Span(1.1, 10.0, is_log=True)] = 1.5,
) -> Policy:
    """Return the policy. Carry: `()`. Parameters: `Params`."""
    params = Params(require_number("plus_m", plus_m, high=1e6), require_number("delta", delta, high=1e3))
    if params.delta <= 1:
        raise InputError(f"delta must be greater than 1, got {delta}")
    return Policy(no_carry, Best(_judge), params)
