"""The links of a node in a map that is being written, and which known node a place is by its ways."""

import math

import jax.numpy as jnp
from jax import Array

from jexplore import btm
from jexplore.arrays.loops import run_if
from jexplore.btm import Btm
from jexplore.driving.params.tree import P
from jexplore.driving.records import Openings, Writer
from jexplore.driving.vehicle import rotate_by, to_robot


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


def _needed(map_, own):
    """Return the link ends that a place must have to be that node: those not given up, or all if these are too few."""
    needed = own & ~jnp.tile(map_.blocked, 2)
    return jnp.where(jnp.sum(needed) > 1, needed, own)


def is_alike(map_: Btm, node: Array, found: Openings, back: Array, leads: Array) -> Array:
    """Return whether a place may be a node: its openings and the node's links match, but for links given up.

    Args:
      leads: bool, the robot follows a link to that node; else one of the node's links must be un-searched there.
    """
    own, bearing = ends_at(map_, node)
    near = (
        own[:, None] & found.valid & (jnp.abs(btm.wrapped(bearing[:, None] - found.bearing)) < P.places.same_exit_rad)
    )
    needed = jnp.where(leads, own & ~jnp.tile(map_.blocked, 2), _needed(map_, own))
    missing = jnp.sum(needed & ~jnp.any(near, axis=1))
    more = jnp.sum(found.valid & ~jnp.any(near, axis=0))
    waits = (
        (map_.start == node)
        & btm.open_links(map_)
        & (jnp.abs(btm.wrapped(map_.start_bearing - back)) < P.places.same_exit_rad)
    )
    return (missing == 0) & (more == 0) & (leads | jnp.any(waits))


def led_to(writer: Writer) -> tuple[Array, Array, Array]:
    """Return the end of the followed link, laid out from the odometry position of the last node.

    Returns:
      `(followed, to, place)`: bool, the robot follows a known link; int32, node at its other end; `[2]` float32.
    """
    map_, size = writer.map, writer.map.start.shape[0]
    link = jnp.minimum(writer.link, size - 1)
    forward = map_.start[link] == writer.node
    moved = jnp.stack([map_.moved_x_m[link], map_.moved_y_m[link]])
    way = jnp.where(forward, moved, rotate_by(-jnp.nan_to_num(map_.turned[link]))(-moved))
    followed = (writer.link < size) & (map_.status[link] == btm.SEARCHED)
    place = writer.origin[:2] + rotate_by(-writer.origin[2])(way)
    return followed, jnp.where(forward, map_.end[link], map_.start[link]), place


def match_node(
    writer: Writer, place: tuple[Array, Array], found: Openings, back: Array, reach: Array, when: Array
) -> tuple[Array, Array]:
    """Match a place to a known divergence that lies elsewhere by odometry, which drifts: `(node, bool: matched)`.

    Either the node has exactly the observed exits and the one by which the robot came is un-searched, or it is the end
    of the followed link, as seen from the last node. The nearest match counts, if no other is nearly as near.

    Args:
      place: `[2]` float32, its centre, odometry; float32, odometer there.
      reach: float32, metres: a node within it is matched without these conditions.
      when: bool, False: do nothing.
    """
    map_, (centre, odometer_m) = writer.map, place
    n = map_.kind.shape[0]
    followed, to, expected = led_to(writer)
    leads = followed & (jnp.arange(n) == to)
    seen = jnp.where(followed, jnp.stack([map_.x_m[to], map_.y_m[to]]) + centre - expected, centre)
    off_m = jnp.hypot(map_.x_m - seen[0], map_.y_m - seen[1])
    drift_m = jnp.minimum(P.graph.match_drift[0] * odometer_m, P.graph.match_drift[1])
    gone_m = odometer_m - writer.node_m
    limit_m = reach + jnp.where(leads, P.graph.drift_share * gone_m, jnp.where(followed, 0.0, drift_m))
    may = when & (map_.kind == btm.DIVERGENCE) & (off_m < limit_m) & (jnp.arange(n) != writer.node)

    def judged(_):
        others = jnp.where((map_.kind == btm.DIVERGENCE) & (jnp.arange(n) != writer.node), off_m, jnp.inf)
        first = jnp.argmin(jnp.where(may, off_m, jnp.inf)).astype(jnp.int32)
        is_alone = jnp.min(others.at[first].set(jnp.inf)) > 2 * off_m[first]
        return first, is_alone & is_alike(map_, first, found, back, leads[first])

    return run_if(jnp.any(may), judged, (jnp.int32(0), jnp.bool_(False)))


def link_from(map_: Btm, start: Array, node: Array, back: Array) -> tuple[Array, Array]:
    """Find the searched link from another node at the side where the robot comes in: `(link, bool: found)`."""
    ends = (map_.start == start) & (map_.end == node), (map_.start == node) & (map_.end == start)
    bearing = jnp.where(ends[0], map_.end_bearing, map_.start_bearing)
    off = jnp.where((ends[0] | ends[1]) & (map_.status == btm.SEARCHED), jnp.abs(btm.wrapped(bearing - back)), jnp.inf)
    best = jnp.argmin(off).astype(jnp.int32)
    return best, (off[best] < P.graph.same_end_rad) & (start != node)


def choose_link(writer: Writer, map_: Btm, node: Array, back: Array) -> tuple[Writer, Btm, Array, Array]:
    """Choose the link by which the robot goes on from a place.

    Un-searched links that it has set off on in vain are given up, and searched ones that lead elsewhere are followed no
    more; when nothing else is left, all of them get another chance. After that the searched ones get one whenever
    un-searched ones are left that were not given up, and more are searched than the last time.

    Returns:
      `(writer, map, link, bearing)`: with what was given up; int32, `NONE` where nothing is left; radians.
    """
    fails, vain = _failed(writer, node), (writer.tries > 0) & (map_.status == btm.UNSEARCHED)
    writer, map_ = writer.replace(fails=fails), map_.replace(blocked=map_.blocked | vain)

    def chosen(map_, fails):
        open_link = btm.first_open(map_, node, back)
        usable = map_.replace(length_m=jnp.where(fails > 0, btm.NO_WAY_M, map_.length_m))
        hop, hop_bearing, _ = btm.next_hop(usable, node)
        bearing = map_.start_bearing[jnp.minimum(open_link, map_.start.shape[0] - 1)]
        return tuple(
            jnp.where(open_link != btm.NONE, one, two) for one, two in ((open_link, hop), (bearing, hop_bearing))
        )

    is_first, n_searched = writer.last_chance < 0, jnp.sum(map_.status == btm.SEARCHED, dtype=jnp.int32)

    def again(_):
        retried = vain & is_first
        tries, blocked = jnp.where(retried, 0, writer.tries), map_.blocked & ~retried
        none = jnp.zeros_like(fails)
        return blocked, tries, none, *chosen(map_.replace(blocked=blocked), none)

    link, bearing = chosen(map_, fails)
    is_any_open = jnp.any((map_.status == btm.UNSEARCHED) & ~map_.blocked & (writer.tries == 0))
    more = (link == btm.NONE) & (is_first | (is_any_open & (n_searched > writer.last_chance)))
    blocked, tries, fails, link, bearing = run_if(more, again, (map_.blocked, writer.tries, fails, link, bearing))
    last_chance = jnp.where(more, n_searched, writer.last_chance)
    writer = writer.replace(tries=tries, fails=fails, last_chance=last_chance)
    return writer, map_.replace(blocked=blocked), link, bearing


def _failed(writer, node):
    """Return `Writer.fails` with the link by which the robot has come to a node."""
    size = writer.map.start.shape[0]
    link = jnp.minimum(writer.link, size - 1)
    followed, to, _ = led_to(writer)
    return writer.fails.at[jnp.where(followed, link, size)].set(
        jnp.where(node == to, 0, writer.fails[link] + 1), mode="drop"
    )
