"""Closest frontier: always go to the frontier cell with the shortest path.

Holz et al. 2010, Figure 3. Yamauchi 1997 goes to centroids of frontier regions (`peers.nearest_region`).
"""

from typing import Any

import jax.numpy as jnp
from jax import Array

from jexplore.planning import Belief, Choice, choose, field, metres, nearest_frontier, nearest_of
from jexplore.policies.policy import Policy, no_carry
from jexplore.raycast import Beams


def _select(key, params, carry, belief, beams, route):
    choice, route = nearest_frontier(belief, route)
    return carry, choice, route


def nearest_scored(
    key: Array, params: Any, carry: Any, belief: Belief, beams: Beams, route: Array
) -> tuple[Any, Choice, Array, Array]:
    """Choose as this strategy, and return minus the path to every frontier cell: as `clusters.Best.scored`."""
    reached = field(belief)
    scores = jnp.where(reached.frontier, -metres(reached.cost, belief.model.cell_m), jnp.nan)
    return carry, *choose(belief, route, reached, *nearest_of(reached)), scores


def closest() -> Policy:
    """Return the policy. Carry: `()`. Parameters: none."""
    return Policy(no_carry, _select)


def is_nearest(policy: Policy) -> bool:
    """Return whether a policy chooses exactly as this one."""
    return policy.select is _select
