"""The links of a node in a map that is being written."""

import math

import jax.numpy as jnp
from jax import Array

from jexplore import btm
from jexplore.btm import Btm
from jexplore.driving.params.tree import P
from jexplore.driving.records import Openings, Writer
from jexplore.driving.vehicle import to_robot


def turn_to(map_: Btm, node: Array, found: Openings) -> Array:
    """Return the mean turn of a known node's openings against its links, radians, to be added.

    Only openings with a link within `turn_rad` count.
    """
    own, bearing = ends_at(map_, node)
    off = btm.wrapped(bearing[:, None] - found.bearing)  # [2M, K]
    off = jnp.where(own[:, None] & found.valid, off, jnp.inf)
    near = jnp.argmin(jnp.abs(off), axis=0)
    least = jnp.take_along_axis(off, near[None], axis=0)[0]
    counts = jnp.abs(least) < P.graph.turn_rad
    return jnp.sum(jnp.where(counts, least, 0)) / jnp.maximum(jnp.sum(counts), 1)


def withdraw_double(map_: Btm, node: Array, back: Array, when: Array) -> Btm:
    """Take away the un-searched link of a node by which the robot has just come in from its other end."""
    off = jnp.abs(btm.wrapped(map_.start_bearing - back))
    off = jnp.where((map_.start == node) & (map_.status == btm.UNSEARCHED), off, jnp.inf)
    at = jnp.argmin(off)
    at = jnp.where(when & (off[at] < math.pi / 4), at, map_.start.shape[0])
    return map_.replace(
        status=map_.status.at[at].set(btm.NONE, mode="drop"), start=map_.start.at[at].set(btm.NONE, mode="drop")
    )


def other_link(map_: Btm, node: Array, link: Array) -> Array:
    """Return the link of a node that is not the one given; the same if it is the only one."""
    touches = ((map_.start == node) | (map_.end == node)) & (map_.status != btm.NONE)
    others = touches & (jnp.arange(touches.shape[0]) != link)
    return jnp.where(jnp.any(others), jnp.argmax(others).astype(jnp.int32), link)


def reach_m(points: tuple[Array, Array], place: Array, bearing: Array, width_m: Array | float) -> Array:
    """Compute the free length of a strip from a place in a direction: metres; inf: unlimited."""
    x, y = to_robot(jnp.append(place, bearing))(points[0]).T
    return jnp.min(jnp.where(points[1] & (jnp.abs(y) < width_m / 2) & (x > 0), x, jnp.inf))


def ends_at(map_: Btm, node: Array) -> tuple[Array, Array]:
    """Return the link ends at a node, `[2M]` bool, first ends before second ones, and bearings, `[2M]`, radians."""
    there = (jnp.arange(map_.start.shape[0]) < map_.n_links) & (map_.status != btm.NONE)
    own = [there & (map_.start == node), there & (map_.end == node) & (map_.status == btm.SEARCHED)]
    return jnp.concatenate(own), jnp.concatenate([map_.start_bearing, map_.end_bearing])


def leads_to(writer: Writer) -> tuple[Array, Array]:
    """Return whether the robot follows a known link, and the node at its end: `(followed, to)`."""
    map_, size = writer.map, writer.map.start.shape[0]
    link = jnp.minimum(writer.link, size - 1)
    to = jnp.where(map_.start[link] == writer.node, map_.end[link], map_.start[link])
    return (writer.link < size) & (map_.status[link] == btm.SEARCHED), to


def link_from(map_: Btm, start: Array, node: Array, back: Array) -> tuple[Array, Array]:
    """Find the searched link from another node at the side where the robot comes in: `(link, bool: found)`."""
    ends = (map_.start == start) & (map_.end == node), (map_.start == node) & (map_.end == start)
    bearing = jnp.where(ends[0], map_.end_bearing, map_.start_bearing)
    off = jnp.where((ends[0] | ends[1]) & (map_.status == btm.SEARCHED), jnp.abs(btm.wrapped(bearing - back)), jnp.inf)
    best = jnp.argmin(off).astype(jnp.int32)
    return best, (off[best] < P.graph.same_end_rad) & (start != node)


def choose_link(writer: Writer, map_: Btm, node: Array, back: Array) -> tuple[Btm, Array, Array]:
    """Choose the link by which the robot goes on from a place.

    Un-searched links that it has set off on in vain are left for the end, and after `tries` times given up.

    Returns:
      `(map, link, bearing)`: with those that were given up; int32, `NONE` where nothing is left; radians.
    """

    def chosen(tries):
        vain = (writer.tries >= tries) & (map_.status == btm.UNSEARCHED)
        left = map_.replace(blocked=map_.blocked | vain)
        open_link, (hop, hop_bearing, _) = btm.first_open(left, node, back), btm.next_hop(left, node)
        is_open = open_link != btm.NONE
        bearing = jnp.where(is_open, map_.start_bearing[jnp.maximum(open_link, 0)], hop_bearing)
        return left.blocked, jnp.where(is_open, open_link, hop), bearing

    (_, fresh, fresh_bearing), (blocked, link, bearing) = chosen(1), chosen(P.graph.tries)
    there_is = fresh != btm.NONE
    link, bearing = jnp.where(there_is, fresh, link), jnp.where(there_is, fresh_bearing, bearing)
    return map_.replace(blocked=blocked), link, bearing
