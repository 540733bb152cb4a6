"""Closest frontier: always go to the frontier cell with the shortest path.

Holz et al. 2010, Figure 3. Yamauchi, "A Frontier-Based Approach for Autonomous Exploration", CIRA 1997, goes to the
centroid of the nearest frontier region of a least size instead.
"""

from jexplore.planning import nearest_frontier
from jexplore.policies.policy import Policy, no_carry


def _select(key, params, carry, belief, beams, route):
    choice, route = nearest_frontier(belief, route)
    return carry, choice, route


def closest() -> Policy:
    """Return the policy. Carry: `()`. Parameters: none."""
    return Policy(no_carry, _select)


def is_nearest(policy: Policy) -> bool:
    """Return whether a policy chooses exactly as this one."""
    return policy.select is _select
