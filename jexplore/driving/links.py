"""The links of a node in a map that is being written, and which known node a place is by its ways."""

import dataclasses
import math

import jax
import jax.numpy as jnp
from jax import Array

from jexplore import btm
from jexplore.arrays.loops import pick, run_if
from jexplore.btm import Btm
from jexplore.driving.params.tree import P
from jexplore.driving.records import Openings, Writer
from jexplore.driving.vehicle import rotate_by, to_odometry, to_robot


def turn_to(map_: Btm, node: Array, found: Openings) -> tuple[Array, Array]:
    """Return the turn of a known node's openings against its links, and how well they agree.

    Returns:
      `(turn, spread)`: radians, to be added; the farthest that a link lies from its opening once that is done, radians,
        inf where an opening has no link, or a link that it must have no opening, within `turn_rad`.
    """
    own, bearing = ends_at(map_, node)
    needed = _needed(map_, own)
    off = btm.wrapped(bearing[:, None] - found.bearing)  # [2M, K]
    off = jnp.where(own[:, None] & found.valid, off, jnp.inf)
    near = jnp.argmin(jnp.abs(off), axis=0)
    least = jnp.take_along_axis(off, near[None], axis=0)[0]
    counts = jnp.abs(least) < P.graph.turn_rad
    n = jnp.sum(counts)
    turn = jnp.sum(jnp.where(counts, least, 0)) / jnp.maximum(n, 1)
    has_opening = jnp.any(jnp.abs(off) < P.graph.turn_rad, axis=1)
    whole = (n >= 1) & jnp.all(counts == found.valid) & jnp.all(has_opening | ~needed)
    return turn, jnp.where(whole, jnp.max(jnp.where(counts, jnp.abs(least - turn), 0)), jnp.inf)


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


def link_toward(map_: Btm, node: Array, bearing: Array) -> tuple[Array, Array, Array]:
    """Return the link of a node whose bearing is nearest to a direction.

    Returns:
      `(link, bearing, off)`: int32; its bearing at the node and the difference, radians; inf without a link.
    """
    n, (ends, bearings) = map_.start.shape[0], ends_at(map_, node)
    off = jnp.where(ends, jnp.abs(btm.wrapped(bearings - bearing)), jnp.inf)
    best = jnp.argmin(off)
    return (best % n).astype(jnp.int32), bearings[best], off[best]


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


def leads_to(writer: Writer) -> tuple[Array, Array]:
    """Return whether the robot follows a known link, and the node at its end: `(followed, to)`."""
    map_, size = writer.map, writer.map.start.shape[0]
    link = jnp.minimum(writer.link, size - 1)
    to = jnp.where(map_.start[link] == writer.node, map_.end[link], map_.start[link])
    return (writer.link < size) & (map_.status[link] == btm.SEARCHED), to


def way_along(map_: Btm, link: Array, forward: Array) -> Array:
    """Return the odometry displacement along a searched link, in the frame of its first node: `[2]`, metres."""
    there = jnp.stack([map_.moved_x_m[link], map_.moved_y_m[link]])
    turned = jnp.nan_to_num(map_.turned[link])
    return jnp.where(forward, there, rotate_by(-turned)(-there))


def led_to(writer: Writer) -> tuple[Array, Array, Array]:
    """Return the end of the followed link, laid out from the odometry position of the last node.

    Returns:
      `(followed, to, place)`: bool, the followed link is known; int32, node at its other end; `[2]` float32.
    """
    followed, to = leads_to(writer)
    link = jnp.minimum(writer.link, writer.map.start.shape[0] - 1)
    way = way_along(writer.map, link, writer.map.start[link] == writer.node)
    return followed, to, writer.origin[:2] + to_odometry(jnp.stack([0.0, 0.0, -writer.origin[2]]))(way)


def is_led_to(writer: Writer, centre: Array, odometer_m: Array, reach: Array | float) -> tuple[Array, Array]:
    """Decide whether a place is the end of the followed link, judged by the length of the way: `(node, bool)`.

    The node must lie within `reach`, metres, plus a share of the way along the link.
    """
    followed, to, place = led_to(writer)
    limit_m = reach + P.graph.drift_share * (odometer_m - writer.node_m)
    return to, followed & (jnp.hypot(*(place - centre)) < limit_m)


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


def find_hypotheses(writer: Writer, centre: Array, odometer_m: Array, found: Openings, when: Array) -> Array:
    """Return loop-closure hypotheses for a place written as a new node: known divergences that it may be.

    One more node decides among them.

    Args:
      when: bool, False: do nothing.

    Returns:
      `[N]` float32: turn of its frame if it is that node, radians; NaN: no hypothesis.
    """
    map_, n = writer.map, writer.map.kind.shape[0]
    off_m = jnp.hypot(map_.x_m - centre[0], map_.y_m - centre[1])
    may = (map_.kind == btm.DIVERGENCE) & (off_m < jnp.minimum(P.graph.drift_share * odometer_m, P.graph.hypothesis_m))
    may &= when & (jnp.arange(n) != writer.node)

    def turns(none):
        turn, spread = jax.vmap(lambda node: turn_to(map_, node, found))(jnp.arange(n))
        return jnp.where(may & jnp.isfinite(spread), turn, none)

    return run_if(jnp.any(may), turns, jnp.full(n, jnp.nan))


def resolve_hypotheses(writer: Writer, kind: Array, centre: Array, odometer_m: Array, found: Openings) -> Writer:
    """Resolve the hypotheses about the last node by the way from there and the place at its end.

    A hypothesis holds if a known link leaves its node in the direction in which the robot has left this one, has the
    same length, and leads to a node of the same kind and exits as the robot's place. If exactly one holds, the last
    node is that node and the robot has followed the known link: what it has written since is removed. All other
    hypotheses are dropped and counted.

    Source:
      Choset and Nagatani 2001, Topological simultaneous localization and mapping.

    Args:
      kind, centre, odometer_m: of the robot's place: int32, `NONE` where it cannot be a known one; `[2]` float32,
        odometry; float32.

    Returns:
      `Writer`, without doubts.
    """
    n, there = writer.map.kind.shape[0], jnp.isfinite(writer.doubts)
    none = jnp.full(n, jnp.nan)

    def judged(carry):
        map_, _, _, origin, left, dropped, _ = carry
        holds, onto = jax.vmap(lambda node, turn: _holds(writer, node, turn, kind, centre, odometer_m, found))(
            jnp.arange(n), jnp.nan_to_num(writer.doubts)
        )
        holds &= there
        node, is_it = jnp.argmax(holds).astype(jnp.int32), jnp.sum(holds) == 1
        joined = _merge_last_node(map_, writer.node, node, writer.doubts[node])
        map_ = pick(is_it, joined, map_)
        origin = jnp.where(is_it, origin.at[2].set(writer.doubts[node]), origin)
        left = jnp.where(is_it, btm.wrapped(left + writer.doubts[node]), left)
        dropped += jnp.sum(there) - is_it
        return (
            map_,
            jnp.where(is_it, node, writer.node),
            jnp.where(is_it, onto[node], writer.link),
            origin,
            left,
            dropped,
            none,
        )

    names = "map", "node", "link", "origin", "left_bearing", "dropped", "doubts"
    before = tuple(getattr(writer, name) for name in names)
    return writer.replace(**dict(zip(names, run_if(jnp.any(there), judged, before))))


def _holds(writer, node, turn, kind, centre, odometer_m, found):
    """Return whether the last node may be another one, reached along a known link of that node: `(holds, link)`."""
    map_, size = writer.map, writer.map.start.shape[0]
    ends, bearings = ends_at(map_, node)
    off = jnp.where(ends, jnp.abs(btm.wrapped(bearings - writer.left_bearing - turn)), jnp.inf)
    best = jnp.argmin(off)
    link, forward = (best % size).astype(jnp.int32), best < size
    to = jnp.where(forward, map_.end[link], map_.start[link])
    way = rotate_by(turn)(centre - writer.origin[:2])
    apart_m = jnp.hypot(*(way - way_along(map_, link, forward)))
    within_m = P.graph.same_way_m + P.graph.drift_share * (odometer_m - writer.node_m)
    _, spread = turn_to(map_, to, dataclasses.replace(found, bearing=found.bearing + turn))
    holds = (off[best] < P.places.same_exit_rad) & (map_.status[link] == btm.SEARCHED) & (apart_m < within_m)
    holds &= (map_.kind[to] == kind) & ((kind != btm.DIVERGENCE) | jnp.isfinite(spread))
    return holds, link


def _merge_last_node(map_, last, node, turn):
    """Replace the last node by a known one, at which its link then ends and whose frame differs by `turn`, radians."""
    size = map_.start.shape[0]
    comes = (map_.end == last) & (map_.status == btm.SEARCHED)
    link = jnp.where(jnp.any(comes), jnp.argmax(comes), size)
    at = jnp.minimum(link, size - 1)
    back = btm.wrapped(map_.end_bearing[at] + turn)
    known, is_known = link_from(map_, map_.start[at], node, back)
    goes = (map_.start == last) | (is_known & (jnp.arange(size) == link) & (known != link))
    none = jnp.int32(btm.NONE)
    map_ = map_.replace(
        start=jnp.where(goes, none, map_.start),
        end=jnp.where(goes, none, map_.end).at[link].set(jnp.where(goes[at], none, node), mode="drop"),
        status=jnp.where(goes, none, map_.status),
        end_bearing=map_.end_bearing.at[link].set(back, mode="drop"),
        turned=map_.turned.at[link].set(btm.wrapped(map_.turned[at] - turn), mode="drop"),
        kind=map_.kind.at[last].set(none),
        x_m=map_.x_m.at[last].set(jnp.nan),
        y_m=map_.y_m.at[last].set(jnp.nan),
        intervention=map_.intervention.at[node].add(map_.intervention[last]).at[last].set(0),
        n_nodes=map_.n_nodes - 1,
    )
    return withdraw_double(map_, node, back, (link < size) & ~goes[at])


def link_from(map_: Btm, start: Array, node: Array, back: Array) -> tuple[Array, Array]:
    """Find the searched link from another node at the side where the robot comes in: `(link, bool: found)`."""
    ends = (map_.start == start) & (map_.end == node), (map_.start == node) & (map_.end == start)
    bearing = jnp.where(ends[0], map_.end_bearing, map_.start_bearing)
    off = jnp.where((ends[0] | ends[1]) & (map_.status == btm.SEARCHED), jnp.abs(btm.wrapped(bearing - back)), jnp.inf)
    best = jnp.argmin(off).astype(jnp.int32)
    return best, (off[best] < P.graph.same_end_rad) & (start != node)


def is_any_open(map_: Btm, tries: Array) -> Array:
    """Return whether any link is un-searched and not given up, such as the one the robot arrives on: bool."""
    return jnp.any((map_.status == btm.UNSEARCHED) & ~map_.blocked & (tries < P.graph.max_tries))


def choose_link(writer: Writer, map_: Btm, node: Array, back: Array) -> tuple[Writer, Btm, Array, Array]:
    """Choose the link by which the robot goes on from a place.

    Un-searched links that it has set off on in vain are given up, and searched ones that lead elsewhere are followed no
    more; when nothing else is left, all of them get another chance. After that the searched ones get one whenever
    un-searched ones are left that were not given up, and more are searched than the last time.

    Returns:
      `(writer, map, link, bearing)`: with what was given up; int32, `NONE` where nothing is left; radians.
    """
    fails, vain = _failed(writer, node), (writer.tries >= P.graph.max_tries) & (map_.status == btm.UNSEARCHED)
    writer, map_ = writer.replace(fails=fails), map_.replace(blocked=map_.blocked | vain)

    def chosen(map_, fails):
        open_link = btm.first_open(map_, node, back)
        usable = map_.replace(length_m=jnp.where(fails >= P.graph.max_tries, btm.NO_WAY_M, map_.length_m))
        hop, hop_bearing, _ = btm.next_hop(usable, node)
        bearing = map_.start_bearing[jnp.minimum(open_link, map_.start.shape[0] - 1)]
        return tuple(
            jnp.where(open_link != btm.NONE, one, two) for one, two in ((open_link, hop), (bearing, hop_bearing))
        )

    is_first, n_searched = writer.last_chance < 0, jnp.sum(map_.status == btm.SEARCHED, dtype=jnp.int32)

    def again(_):
        retried = vain & is_first
        tries, blocked = jnp.where(retried, P.graph.max_tries - 1, writer.tries), map_.blocked & ~retried
        one_less = jnp.minimum(fails, P.graph.max_tries - 1)
        return blocked, tries, one_less, *chosen(map_.replace(blocked=blocked), one_less)

    link, bearing = chosen(map_, fails)
    more = (link == btm.NONE) & (is_first | (is_any_open(map_, writer.tries) & (n_searched > writer.last_chance)))
    blocked, tries, fails, link, bearing = run_if(more, again, (map_.blocked, writer.tries, fails, link, bearing))
    last_chance = jnp.where(more, n_searched, writer.last_chance)
    writer = writer.replace(tries=tries, fails=fails, last_chance=last_chance)
    return writer, map_.replace(blocked=blocked), link, bearing


def _failed(writer, node):
    """Return `Writer.fails` with the link by which the robot has come to a node."""
    size = writer.map.start.shape[0]
    link = jnp.minimum(writer.link, size - 1)
    followed, to = leads_to(writer)
    return writer.fails.at[jnp.where(followed, link, size)].set(
        jnp.where(node == to, 0, writer.fails[link] + 1), mode="drop"
    )
