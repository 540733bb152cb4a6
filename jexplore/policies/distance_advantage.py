"""Distance advantage: go to the frontier cluster that is near to the robot and far from the other clusters.

Ericson, Pedro, Jensfelt, "Information Gain Is Not All You Need", 2025, arXiv 2504.01980. Gain only decides which
clusters are considered at all: what is left behind alone costs a detour later.

Changed, with `pocket_m` above 0: a cluster behind which a look would show little, a pocket, is worth a detour of so
many metres now, rather than the way back later.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jexplore.config import require_number, require_whole
from jexplore.planning import field
from jexplore.policies.clusters import apart, best_of, go_to, init, seen_from, targets
from jexplore.policies.policy import Policy


class Params(NamedTuple):
    """Parameters."""

    weight: float  # of the mean distance from the other clusters, beside the robot's own path
    min_gain: int  # unknown cells that a look must show for a cluster to be considered
    pocket_m: float  # worth of a cluster with nothing behind it, metres
    pocket_m2: float  # unknown area that takes the e-th part of that worth, square metres


def advantage(path_m: Array, apart_m: Array, used: Array, weight: Array | float) -> Array:
    """Mean distance from the other targets, weighted, less the robot's path: `[M]` float32, metres.

    Args:
      path_m: `[M]` float32.
      apart_m: `[M, M]` float32; inf where no path leads: such pairs do not count.
      used: `[M]` bool, targets that count.
      weight: scalar.
    """
    other = used[:, None] & used[None] & jnp.isfinite(apart_m) & ~jnp.eye(len(used), dtype=bool)
    n = jnp.sum(other, axis=1)
    remote = jnp.sum(jnp.where(other, apart_m, 0.0), axis=1) / jnp.maximum(n, 1)
    return weight * remote - path_m


def _select(key, params, carry, belief, beams, route):
    known = field(belief)
    at = targets(belief, known)
    unknown, _ = seen_from(belief, at, beams)
    usable = at.used & (unknown >= params.min_gain)
    worth = advantage(at.path_m, apart(belief, at), usable, params.weight)
    gain_m2 = unknown.astype(jnp.float32) * belief.model.cell_m**2
    worth = worth + params.pocket_m * jnp.exp(-gain_m2 / params.pocket_m2)
    return carry, *go_to(belief, route, known, at, best_of(at, worth, usable))


def distance_advantage(
    weight: float = 1.0, min_gain: int = 1, pocket_m: float = 0.0, pocket_m2: float = 15.0
) -> Policy:
    """The policy. Carry: `()`. Parameters: `Params`."""
    params = Params(
        require_number("weight", weight, high=100),
        require_whole("min_gain", min_gain, low=0, high=2**20),
        require_number("pocket_m", pocket_m, high=1000),
        require_number("pocket_m2", pocket_m2, low_open=True, high=1e6),
    )
    return Policy(init, _select, params)
