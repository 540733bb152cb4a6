"""Shortest ways in graphs as padded arrays, for one graph and many sets of targets side by side."""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jexplore.arrays.loops import repeat

NONE = -1
FAR = np.int32(2**30)
ROUNDS = 4  # between two looks at whether anything changes: a look costs as much as a round


class Around(NamedTuple):
    """Links around every node, in the order of the list; `NONE` in empty places."""

    link: np.ndarray  # [N, K] int32
    node: np.ndarray  # [N, K] int32, the one that it leads to


class Ways(NamedTuple):
    """The best way from every node to the nearest target of every set."""

    length: Array  # [N, B] int32, `FAR` without a way
    hops: Array  # [N, B] int32, its links; `FAR` without a way
    link: Array  # [N, B] int32, first link; `NONE` at targets, and without a way


def links_around(ends: np.ndarray, n: int) -> Around:
    """List the links around every node of a graph, on the host.

    Args:
      ends: `[M, 2]` int, the nodes that a link joins, each below n.
      n: nodes.

    Returns:
      `Around`, K the power of two that holds the most links of a node; a link from a node to itself is left out.
    """
    ends = np.asarray(ends, np.int64).reshape(-1, 2)
    node, far_end = ends.ravel(), ends[:, ::-1].ravel()
    link = np.repeat(np.arange(len(ends)), 2)
    order = np.lexsort((link, node))
    node, far_end, link = (a[order][(node != far_end)[order]] for a in (node, far_end, link))
    count = np.bincount(node, minlength=n)
    column = np.arange(len(node)) - np.repeat(np.cumsum(count) - count, count)
    width = 2 ** math.ceil(math.log2(max(count.max(initial=1), 1)))
    around = Around(*(np.full((n, width), NONE, np.int32) for _ in Around._fields))
    around.link[node, column], around.node[node, column] = link, far_end
    return around


def shortest_ways(around: Around, length: Array, is_open: Array, barrier: Array, target: Array) -> Ways:
    """Compute the shortest way from every node to a target over links that lead both ways.

    Of ways of equal length the one with the fewest links counts, and of those the one whose links, in their order, have
    the lowest places in the list. Whole numbers make that exact. Sets of targets lie side by side in the last axis,
    which a CPU works on at once.

    Args:
      around: of N nodes and M links.
      length: `[M]` int32, 0 or more; all together less than `FAR`.
      is_open: `[M]` bool, links that a way may use.
      barrier: `[N]` bool, nodes that a way may begin or end at, but not pass.
      target: `[N, B]` bool, B sets.

    Returns:
      `Ways`.
    """
    link, node = jnp.asarray(around.link), jnp.asarray(around.node)
    at = jnp.clip(link, 0, length.shape[0] - 1)
    leads = (link >= 0) & is_open[at]
    node = jnp.where(leads, node, jnp.arange(link.shape[0])[:, None])  # a shut link leads back at no cost: no gain
    cost = jnp.where(leads, length[at], 0)[:, :, None]
    ends_here = jnp.where(target, 0, FAR)

    def beyond(value):
        """Return the remaining way at the far end of every link, `[N, K, B]`; a barrier ends it."""
        return jnp.where(barrier[:, None] & ~target, FAR, value)[node]

    def nearer(state):
        # In round t `total` is the least over ways of t links at most: where it became what it is, t is the fewest.
        total, hops, t, _ = state
        before = total
        for more in range(ROUNDS):
            before, total = total, jnp.minimum(total, jnp.min(cost + beyond(total), axis=1))
            hops = jnp.where(total < before, t + more, hops)
        return total, hops, t + ROUNDS, jnp.any(total < before)

    # True, and not known to be: see `settled`. A way meets no node twice, so that N rounds are enough.
    start = ends_here, ends_here, jnp.int32(1), jnp.ravel(ends_here)[0] >= 0
    total, hops, _, _ = repeat(lambda state: state[3], nearer, start)
    is_first = leads[:, :, None] & (cost + beyond(total) == total[:, None]) & (1 + beyond(hops) == hops[:, None])
    place = jnp.min(jnp.where(is_first, link[:, :, None], length.shape[0]), axis=1)
    is_on = (total < FAR) & ~target
    return Ways(total, hops, jnp.where(is_on, place, NONE).astype(jnp.int32))
