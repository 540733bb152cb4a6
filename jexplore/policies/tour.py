"""Tour: the first stop of a short route from the robot through all frontier clusters, planned anew every time.

Goals as cities of a travelling salesman: Kulich, Faigl, Preucil, "On Distance Utility in the Exploration Task", ICRA
2011. Changed: a city is a frontier cluster that would show enough; the route, without return, is built by nearest
insertion (Rosenkrantz, Stearns, Lewis 1977) and improved by 2-opt (Croes 1958).
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from jexplore.arrays.loops import repeat
from jexplore.config import require_whole
from jexplore.planning import Belief, field
from jexplore.policies.clusters import CLUSTERS, Targets, go_to, looks, paths_apart, targets
from jexplore.policies.policy import MinGain, Policy, no_carry
from jexplore.raycast import Beams

NO_PATH_M = 1e6  # stands for "no path", so that sums stay finite
AT_A_TIME = 8  # stops of a route at which it is tried to turn it, together


class Params(NamedTuple):
    """Parameters."""

    min_gain: int  # unknown cells that a look must show for a cluster to be a stop


def inserted(length: Array, n: Array | int) -> Array:
    """Build an open route from node 0 to nodes 1 to n by nearest insertion.

    `length`: `[N, N]` float32, symmetric. Returns `[N]` int32, of which the first n + 1 count.
    """
    size = length.shape[0]
    nodes = lax.iota(jnp.int32, size)

    def insert(state):
        count, route, outside, near = state
        # The node nearest to the route goes where it makes it the least longer: between two stops or at the end.
        node = jnp.argmin(jnp.where(outside, near, jnp.inf)).astype(jnp.int32)
        after = jnp.roll(route, -1)
        detour = length[route, node] + length[node, after] - length[route, after]
        detour = jnp.where(nodes == count - 1, length[route, node], detour)
        at = jnp.argmin(jnp.where(nodes < count, detour, jnp.inf)).astype(jnp.int32) + 1
        new = jnp.where(nodes < at, route, jnp.where(nodes == at, node, jnp.roll(route, 1)))
        on = count <= n
        return (
            count + on, jnp.where(on, new, route), outside & ~(on & (nodes == node)), jnp.minimum(near, length[node]),
        )  # fmt: skip

    outside = (nodes > 0) & (nodes <= n)
    state = jnp.int32(1), jnp.zeros(size, jnp.int32), outside, length[0]
    return repeat(lambda state: state[0] <= n, insert, state)[1]


def two_opt(length: Array, route: Array, n: Array | int) -> Array:
    """Improve a route of `inserted` by reversing stretches for as long as that shortens it, the best reversal first."""
    size = length.shape[0]
    nodes = lax.iota(jnp.int32, size)

    def best_turn(route):
        """Return the gain of the best reversal, and its first and last stop."""
        # Reversing stops i..j replaces the ways into i and out of j; the last stop has no way out.
        before, after = jnp.roll(route, 1), jnp.roll(route, -1)
        enter, leave = length[before, route], jnp.where(nodes < n, length[route, after], 0.0)

        def look(state):
            first, best, *places = state
            i = first + lax.iota(jnp.int32, AT_A_TIME)
            i_ = jnp.minimum(i, size - 1)
            behind = jnp.where(nodes[None] < n, length[route[i_][:, None], after[None]], 0.0)
            swapped = length[before[i_][:, None], route[None]] + behind
            gain = enter[i_][:, None] + leave[None] - swapped
            valid = (i[:, None] >= 1) & (nodes[None] > i[:, None]) & (nodes[None] <= n)
            gain = jnp.where(valid, gain, -jnp.inf)
            at = jnp.argmax(gain).astype(jnp.int32)
            better = gain.reshape(-1)[at] > best
            new = gain.reshape(-1)[at], first + at // size, at % size
            best = [jnp.where(better, one, other) for one, other in zip(new, (best, *places))]
            return first + jnp.where(first <= n, AT_A_TIME, 0), *best

        none = jnp.int32(0)
        return repeat(lambda state: state[0] <= n, look, (none, jnp.float32(-jnp.inf), none, none))[1:]

    def turn(state):
        i, route, saved, first, last = state
        on = saved > 1e-3
        place = jnp.where((nodes >= first) & (nodes <= last) & on, first + last - nodes, nodes)
        route = route[place]
        return i + on, route, *best_turn(route)

    state = jnp.int32(0), route, *best_turn(route)
    return repeat(lambda state: (state[2] > 1e-3) & (state[0] < size * size), turn, state)[1]


def stops_of(belief: Belief, at: Targets, beams: Beams, min_gain: Array | int) -> Array:
    """Return the clusters that a route visits, those that show enough, else all: `[M]` bool."""
    usable = at.used & (looks(belief, at, beams, enough=min_gain)[0] >= min_gain)
    return jnp.where(jnp.any(usable), usable, at.used)


def first_stop(belief: Belief, at: Targets, usable: Array, begin_m: Array) -> Array:
    """Return the slot of the first stop of a short route through some clusters: int32, -1 without any.

    Args:
      usable: `[M]` bool, which.
      begin_m: `[M]` float32, what the way from the robot to each costs, metres.
    """
    stops = jnp.argsort(~usable, stable=True)  # slots to be visited first, in their order
    n = jnp.sum(usable, dtype=jnp.int32)
    apart_m = jnp.minimum(paths_apart(belief, at), NO_PATH_M)[stops][:, stops]
    path_m = jnp.minimum(begin_m, NO_PATH_M)[stops]
    length = jnp.zeros((CLUSTERS + 1, CLUSTERS + 1), jnp.float32)
    length = length.at[1:, 1:].set(apart_m).at[0, 1:].set(path_m).at[1:, 0].set(path_m)
    order = two_opt(length, inserted(length, n), n)
    return jnp.where(n > 0, stops[jnp.maximum(order[1] - 1, 0)], -1).astype(jnp.int32)


def _select(key, params, carry, belief, beams, route):
    reached = field(belief)
    at = targets(belief, reached)
    which = first_stop(belief, at, stops_of(belief, at, beams, params.min_gain), at.path_m)
    return carry, *go_to(belief, route, reached, at, which)


def tour(min_gain: MinGain = 1) -> Policy:
    """Return the policy. Carry: `()`. Parameters: `Params`."""
    return Policy(no_carry, _select, Params(require_whole("min_gain", min_gain, low=0, high=2**20)))
