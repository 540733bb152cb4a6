"""Strategies that weigh the robot's path against the clusters left behind: `distance-advantage` and `small-first`.

Distance advantage: go to the frontier cluster that is near to the robot and far from the other clusters. Ericson,
Pedro, Jensfelt, "Information Gain Is Not All You Need", 2025, arXiv 2504.01980. Gain only decides which clusters are
considered: an isolated cluster left behind costs a detour later.

Small first, this package's own: the other clusters count by the unknown area that a look-around would show there,
because the robot will spend its time there; a cluster with a large unknown area is put off, because it draws the robot
in. Small, near clusters are finished before the robot leaves for long.
"""

from typing import Annotated, NamedTuple

import jax.numpy as jnp
from jax import Array

from jexplore.config import require_number, require_whole
from jexplore.native.kernels import EVERY
from jexplore.policies.clusters import Best, looks, paths_apart
from jexplore.policies.policy import MinGain, Policy, Span, no_carry

MIN_COUNT = 1e-6  # keeps a quotient finite where nothing counts


class Params(NamedTuple):
    """Parameters of both, so that they share a program."""

    weight: float  # of the mean distance from the other clusters, relative to the robot's own path
    min_gain: int  # unknown cells that a look must show for a cluster to be considered
    by_area: bool = False  # whether the others count by the unknown area that a look would show there
    side_weight: float = 0.0  # of the side of a square as large as that area at the cluster itself


def advantage(path_m: Array, apart_m: Array, used: Array, weight: Array | float, counts: Array | float = 1.0) -> Array:
    """Compute the mean distance from the other targets, weighted, less the robot's path: `[M]` float32, metres."""
    return weight * mean_apart(apart_m, used, counts) - path_m


def mean_apart(apart_m: Array, used: Array, counts: Array | float = 1.0) -> Array:
    """Compute the mean distance of every target from the others: `[M]` float32, metres; 0 without others.

    `apart_m` `[M, M]` is inf where no path leads: such pairs do not count. `counts`: how much each, `[M]`, or all
    count.
    """
    other = used[:, None] & used[None] & jnp.isfinite(apart_m) & ~jnp.eye(len(used), dtype=bool)
    share = jnp.where(other, counts, 0.0)
    return jnp.sum(jnp.where(other, apart_m, 0.0) * share, axis=1) / jnp.maximum(jnp.sum(share, axis=1), MIN_COUNT)


def _judge(params, belief, at, beams):
    exact = params.by_area | (params.side_weight > 0)
    unknown, _ = looks(belief, at, beams, enough=jnp.where(exact, EVERY, params.min_gain))
    usable, area = at.used & (unknown >= params.min_gain), unknown.astype(jnp.float32)
    counts = jnp.where(params.by_area, area, 1.0)
    worth = advantage(at.path_m, paths_apart(belief, at), usable, params.weight, counts)
    return worth - params.side_weight * belief.model.cell_m * jnp.sqrt(area), usable


def _params(weight, min_gain, **more):
    return Params(
        require_number("weight", weight, high=100), require_whole("min_gain", min_gain, low=0, high=2**20), **more
    )


def distance_advantage(weight: Annotated[float, Span(0.0, 2.0)] = 1.0, min_gain: MinGain = 1) -> Policy:
    """Return the policy. Carry: `()`. Parameters: `Params`."""
    return Policy(no_carry, Best(_judge), _params(weight, min_gain))


def small_first(
    weight: Annotated[float, Span(0.0, 2.0)] = 0.5,
    side_weight: Annotated[float, Span(0.0, 2.0)] = 0.5,
    min_gain: MinGain = 1,
) -> Policy:
    """Return the policy. Carry: `()`. Parameters: `Params`.

    The defaults of the weights were chosen among twelve on worlds #1000 to #1013 of each kind, with known outlines.
    """
    side_weight = require_number("side_weight", side_weight, high=100)
    return Policy(no_carry, Best(_judge), _params(weight, min_gain, by_area=True, side_weight=side_weight))
