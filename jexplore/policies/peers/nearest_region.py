"""Nearest region: the centroid of the nearest frontier region that is at least as large as the robot.

Yamauchi, "A Frontier-Based Approach for Autonomous Exploration", CIRA 1997, "Frontier Detection" and "Navigating to
Frontiers": frontier cells that touch are a region, the goal of a region of a least size is its centroid, and the robot
goes to the nearest goal that it can reach and has not visited, where it looks all round. The list of visited goals are
the exhausted targets; goals to which no path leads are passed over, as in the list of inaccessible ones. Changed: a
centroid that cannot be reached, or is exhausted, gives way to the cell of the region nearest to it; where only smaller
regions are left they count, so that pockets are seen as well. Left out: giving up a goal after some time without
progress.
"""

import dataclasses
from typing import Annotated, Any, NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from jexplore.config import require_number, require_whole
from jexplore.frontier import frontier_clusters
from jexplore.planning import Belief, Choice, Field, choose, field
from jexplore.policies.clusters import CLUSTERS
from jexplore.policies.policy import MinGain, Policy, Span, no_carry
from jexplore.policies.views import live
from jexplore.raycast import Beams
from jexplore.reach import FAR


class Params(NamedTuple):
    """Parameters."""

    least_m: float  # length of the smallest region, its cells side by side
    min_gain: int  # unknown cells that a look from a centroid must show for it to be live


def goals(belief: Belief, reached: Field) -> tuple[Array, ...]:
    """Find the goals of all regions: row, col, whether it is the centroid, and cells, `[CLUSTERS]`; overflow, int32."""
    found = frontier_clusters(reached.frontier, max_clusters=CLUSTERS)
    label = jnp.where(found.label < 0, CLUSTERS, found.label)
    at = jnp.stack([lax.broadcasted_iota(jnp.int32, label.shape, axis) for axis in (0, 1)])
    sums = jnp.zeros((2, CLUSTERS), jnp.int32).at[:, label].add(at, mode="drop")
    size = jnp.maximum(found.size, 1)
    row, col = (2 * sums + size) // (2 * size)
    # A centroid that is a frontier cell is that of `found`: a target like any other.
    is_centroid = (found.size > 0) & (reached.cost[row, col] < FAR) & ~belief.exhausted[row, col]
    is_centroid &= ~reached.frontier[row, col]
    row, col = (jnp.where(is_centroid, *both) for both in ((row, found.row), (col, found.col)))
    return row, col, is_centroid, found.size, found.overflow + found.left_out


def _select(
    key: Array, params: Params, carry: Any, belief: Belief, beams: Beams, route: Array
) -> tuple[Any, Choice, Array]:
    reached = field(belief)
    row, col, is_centroid, size, overflow = goals(belief, reached)
    large = size * belief.model.cell_m >= params.least_m
    usable = jnp.where(jnp.any(large), large, size > 0)
    which = jnp.argmin(jnp.where(usable, reached.cost[row, col], FAR))
    choice, route = choose(belief, route, reached, *(jnp.where(size[which] > 0, a[which], -1) for a in (row, col)))
    return carry, dataclasses.replace(choice, is_view=is_centroid[which], overflow=overflow), route


def nearest_region(least_m: Annotated[float, Span(0.1, 3.0, is_log=True)] = 0.6, min_gain: MinGain = 1) -> Policy:
    """Return the policy. Carry: `()`. Parameters: `Params`; by default the diameter of the robot."""
    least_m = require_number("least_m", least_m, high=100)
    return Policy(no_carry, _select, Params(least_m, require_whole("min_gain", min_gain, low=1, high=2**20)), live)
