"""Revenue: go to the frontier cluster with the most unknown area round it, near ones counted twice, less the distance.

Umari and Mukhopadhyay, "Autonomous Robotic Exploration Based on Multiple Rapidly-exploring Randomized Trees", IROS
2017, and their package rrt_exploration, assigner.py, whose values are the defaults: the revenue of a frontier point x
is `R(x) = lambda h(x) I(x) - N(x)`, with I the unknown area within `radius_m`, seen or behind walls, N the distance as
the crow flies, and h the hysteresis, `near_gain` within `near_m` and 1 beyond. Left out: the randomized trees, which
find frontier points (clusters are found whole), and several robots, which discount each other's gains.
"""

from typing import Annotated, NamedTuple

import jax.numpy as jnp

from jexplore.config import require_number
from jexplore.frontier import disc
from jexplore.grid import is_known
from jexplore.policies.clusters import Best, at_each
from jexplore.policies.policy import Policy, Span, no_carry


class Params(NamedTuple):
    """Parameters."""

    weight: float  # lambda, metres that a square metre of unknown area is worth
    radius_m: float
    near_m: float
    near_gain: float


def _judge(params, belief, at, beams):
    cell_m, known = belief.model.cell_m, is_known(belief.grid)
    radius_d2 = jnp.floor((params.radius_m / cell_m) ** 2 + 1e-3).astype(jnp.int32)

    def count(row, col):
        return jnp.sum(known & disc(known.shape, row, col, radius_d2), dtype=jnp.int32)

    # The disc less its known cells: cells beyond the map count as unknown, however the map is padded.
    known_m2 = at_each(at, count, jnp.zeros(at.row.shape, jnp.int32)) * cell_m**2
    unknown_m2 = jnp.maximum(jnp.pi * params.radius_m**2 - known_m2, 0)
    off_m = jnp.hypot(at.row - belief.row, at.col - belief.col) * cell_m
    near = jnp.where(off_m <= params.near_m, params.near_gain, 1.0)
    return params.weight * near * unknown_m2 - off_m, at.used


def revenue(
    weight: Annotated[float, Span(0.1, 30.0, is_log=True)] = 3.0,
    radius_m: Annotated[float, Span(0.5, 5.0)] = 1.0,
    near_m: Annotated[float, Span(0.5, 10.0)] = 3.0,
    near_gain: Annotated[float, Span(1.0, 10.0, is_log=True)] = 2.0,
) -> Policy:
    """Return the policy. Carry: `()`. Parameters: `Params`."""
    given = {"weight": weight, "radius_m": radius_m, "near_m": near_m, "near_gain": near_gain}
    return Policy(no_carry, Best(_judge), Params(*(require_number(name, a, high=1e3) for name, a in given.items())))
