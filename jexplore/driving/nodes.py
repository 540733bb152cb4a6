"""Making a node: its identity, the links that end and begin there, the choice of the next link, and the way to it."""

import math

import jax.numpy as jnp
from jax import Array

from jexplore import btm
from jexplore.arrays.loops import pick, run_if
from jexplore.driving import links, mapping
from jexplore.driving.params.tree import P
from jexplore.driving.records import Arrival, DueNode, Latch, Openings, State, Track, Writer
from jexplore.driving.sensing import obstacles
from jexplore.driving.sensing.openings import find_openings
from jexplore.driving.sensing.surround import known_points
from jexplore.driving.settings import Robot, Tuning
from jexplore.driving.vehicle import rotate_by, to_odometry, towards

MAX_OPENINGS = 8  # of a divergence


def _arrive(writer, event, found, back, posture_deg, tuning):
    """Return the node that is due: one that is known, or a new one."""
    is_obstacle, is_divergence = event.kind == btm.OBSTACLE, event.kind == btm.DIVERGENCE
    is_terminal = (event.kind == btm.TERMINAL) & ~event.returns
    near, distance = btm.nearest_node(writer.map, event.centre[0], event.centre[1], event.kind)
    # A place is in the circle of a node, and the node in that of the place.
    smaller = jnp.minimum(event.radius, writer.map.radius_m[jnp.maximum(near, 0)])
    reach = jnp.where(is_divergence, jnp.maximum(0.5, smaller), P.graph.same_node_m)
    may_be_last = is_divergence & mapping.has_left(writer, event.odometer_m, tuning.leave_m)
    again = (distance < reach) & ((near != writer.node) | may_be_last) & ~is_terminal
    alike, is_alike = links.match_node(
        writer, (event.centre, event.odometer_m), found, back, reach, is_divergence & ~again
    )
    is_led, to, place = links.led_to(writer)
    led_m = P.graph.led_node_m + P.graph.drift_share * (event.odometer_m - writer.node_m)
    is_led &= (jnp.hypot(*(place - event.centre)) < led_m) & (writer.map.kind[to] == event.kind)
    is_led &= ~is_divergence & ~is_terminal
    near = jnp.where(event.returns, 0, jnp.where(is_alike, alike, jnp.where(is_led, to, near)))
    again = again | is_alike | is_led | event.returns
    added, new = btm.add_node(
        writer.map,
        event.kind,
        event.centre[0],
        event.centre[1],
        radius_m=event.radius,
        posture_deg=jnp.where(is_obstacle, posture_deg, jnp.degrees(event.posture)),
        inclination_deg=jnp.where(is_obstacle & (event.step_m == 0), jnp.degrees(event.steepest), jnp.nan),
        obstacle=jnp.where(is_obstacle, jnp.where(event.step_m > 0, btm.STAIRS, btm.SLOPE), btm.NONE),
        step_m=jnp.where(event.step_m > 0, event.step_m, jnp.nan),
    )
    map_, node = pick(again, writer.map, added), jnp.where(again, near, new)
    fits = again | (writer.map.n_nodes < map_.kind.shape[0])
    met = again & is_divergence & ((distance < P.graph.shift_m) | is_alike)
    share = jnp.where(is_alike, 1.0, P.graph.shift_share)
    shift = jnp.where(met, share * (jnp.stack([map_.x_m[near], map_.y_m[near]]) - event.centre), 0.0)
    return Arrival(map_, node, again, met, fits, shift)


def _find_openings(writer, event, points, tuning):
    """Find the openings of a divergence and the way in: the last one used, else the nearest to the robot's way. A robot
    that started inside has no way in. Returns `(found, others, back)`: `Openings`; `[K]` bool, all but the way in; its
    bearing, radians."""
    is_divergence, centre = event.kind == btm.DIVERGENCE, event.centre
    inward = mapping.came_from(writer, centre, event.radius) - centre
    inward = jnp.where(is_divergence, inward, -towards(event.pose[2]))
    came = jnp.arctan2(inward[1], inward[0])
    circle = centre, event.radius, tuning.width_m
    found = find_openings(
        points[0], points[1], *circle, circle=tuning.circle, size=MAX_OPENINGS, seen_from=event.pose[:2]
    )
    off = jnp.where(found.valid, jnp.abs(btm.wrapped(found.bearing - came)), jnp.inf)
    passed = mapping.came_through(writer, centre + found.middle, found.bearing, found.width_m)
    passed = jnp.where(found.valid, passed, -1)
    entry = jnp.where(jnp.any(passed >= 0), jnp.argmax(passed), jnp.argmin(off))
    from_start = (writer.node == 0) & _holds_start(writer.map, event)
    entry_seen = ((passed[entry] >= 0) | (off[entry] < math.pi / 3)) & ~from_start
    back = jnp.where(is_divergence & entry_seen, found.bearing[entry], came)
    return found, found.valid & ~((jnp.arange(MAX_OPENINGS) == entry) & entry_seen), back


def _holds_start(map_, event):
    """Return whether the start lies in the circle of a place."""
    return jnp.hypot(event.centre[0] - map_.x_m[0], event.centre[1] - map_.y_m[0]) < event.radius


def _end_way_here(map_, writer, at, back, measures):
    """End the link that led here: `(map, link)`. A new node on a known link ends a way of its own; a new link to a
    known node replaces that node's record, unless the robot comes in by a known one; one that leads back to its own
    opening is dropped."""
    size = map_.start.shape[0]
    on_known = map_.status[jnp.minimum(writer.link, size - 1)] == btm.SEARCHED
    astray = on_known & ~at.again
    map_, own = btm.add_link(map_, writer.node, writer.left_bearing, when=astray)
    link = jnp.where(astray, own, writer.link)
    off = jnp.abs(btm.wrapped(back - map_.start_bearing[jnp.minimum(link, size - 1)]))
    turned_back = at.again & (at.node == writer.node) & ~on_known & (off < math.pi / 4)  # it comes back as it left
    map_ = map_.replace(blocked=map_.blocked.at[jnp.where(turned_back, link, size)].set(True, mode="drop"))
    known, comes_by_it = links.link_from(map_, writer.node, at.node, back)
    comes_by_it &= at.again & ~on_known
    link = jnp.where(comes_by_it, known, link)
    is_new = (~on_known | astray) & ~turned_back & ~comes_by_it
    map_ = btm.end_link(map_, link, at.node, back, when=is_new, **measures)
    return links.withdraw_double(map_, at.node, back, at.again & is_new), link


def write_node(
    writer: Writer, event: DueNode, points: tuple[Array, Array], tuning: Tuning, robot: Robot
) -> tuple[Writer, Array, Array, Array, Array]:
    """Make the node that is due, end the link that led to it, and choose the next link.

    Args:
      points: around the robot: `[P, 2]` float32, odometry; `[P]` bool, valid.

    Returns:
      `(writer, latch, target, out, correction)`: `Latch` and target point of branch selection, direction of the link
        there, radians; `[3]`, correction of the odometry at a node met again: metres, and radians about the node.
    """
    is_divergence, is_terminal = event.kind == btm.DIVERGENCE, (event.kind == btm.TERMINAL) & ~event.returns
    size, measures = writer.map.start.shape[0], mapping.link_measures(writer, event.odometer_m)
    measured, others, back = _find_openings(writer, event, points, tuning)
    at = _arrive(writer, event, measured, back, measures["link_posture_deg"], tuning)
    map_, step_m = obstacles.classify_obstacle(
        at.map, writer, event, tuning, robot, measures["link_posture_deg"], at.node
    )
    passes, which = _is_rejected(writer, event, measured, back, others, at, points, tuning)
    turned = links.turn_to(at.map, at.node, measured)
    turn = jnp.where(at.met, turned, 0.0)
    applied = P.graph.turn_share * turn
    frame = jnp.where(at.again, jnp.where(is_divergence, turned, jnp.nan), 0.0)  # turn of the node's own frame
    # From here on bearings are those of the map, not of the odometry.
    back, heading = back + turn, event.pose[2] + turn
    found = measured.replace(bearing=measured.bearing + turn, middle=rotate_by(turn)(measured.middle))
    measures |= {"max_step_m": step_m} | mapping.moved_from_node(writer, event.centre, frame)
    map_, link = _end_way_here(map_, writer, at, back, measures)
    map_ = _add_openings(map_, event, at, found, others, is_divergence)
    goes_on = ~is_divergence & ~is_terminal & ~at.again
    map_, new = btm.add_link(map_, at.node, heading, when=goes_on, blocked=event.blocked)
    after, map_, onto, bearing = links.choose_link(writer, map_, at.node, back)
    through = ~is_divergence & ~event.blocked & ~event.returns
    onto = jnp.where(through, jnp.where(goes_on, new, links.other_link(map_, at.node, link)), onto)
    plain = tuning.leave_m * towards(bearing), bearing
    way, out = pick(is_divergence, _beyond_opening(event, found, bearing, tuning.leave_m), plain)
    beyond = _beyond_opening(event, measured, measured.bearing[which], tuning.leave_m)
    target, out = pick(passes, beyond, (rotate_by(applied - turn)(way), out + applied - turn))
    taken = jnp.where(onto == btm.NONE, size, onto)
    crossed = is_divergence | ((event.kind == btm.FREE_SPACE) & (event.odometer_m >= writer.border_m))
    written = after.replace(
        map=map_,
        node=at.node,
        node_m=event.odometer_m,
        link=taken,
        left_bearing=jnp.where(through, heading, bearing),
        border_m=jnp.where(crossed, jnp.inf, writer.border_m),
        tries=after.tries.at[taken].add(1, mode="drop"),
        exhausted=~is_terminal & (taken == size),
        origin=jnp.stack([*(event.centre + at.shift), jnp.nan_to_num(frame) - applied]),
    )
    full = writer.replace(map=writer.map.replace(overflow=writer.map.overflow + 1), full=jnp.bool_(True))
    unchanged = writer.replace(passed=jnp.stack([*event.centre, event.radius, event.odometer_m]))
    correction = jnp.where(passes, 0.0, jnp.stack([*at.shift, applied]))
    latch = jnp.where((~through & (taken < size)) | passes, Latch.LEAVE, Latch.FREE).astype(jnp.int32)
    after = pick(passes, unchanged, pick(at.fits, written, full))
    return after, latch, event.centre + correction[:2] + target, out, correction


def make_due_node(state: State, event: DueNode, tuning: Tuning, robot: Robot) -> State:
    """Make the node that is due, if one is."""
    way, placed = state.writer.way, to_odometry(state.estimate)

    def written(carry):
        writer, drive, track, estimate = carry
        xy, known = known_points(state.around)
        whole, latch, target, out, correction = write_node(
            writer.replace(way=way), event, (placed(xy), known), tuning, robot
        )
        about = to_odometry(jnp.append(event.centre, correction[2]))
        estimate = jnp.append(about(estimate[:2] - event.centre), estimate[2]) + correction
        latches = (event.kind == btm.DIVERGENCE) | event.blocked | event.returns
        latched = drive.replace(latch=latch, target=target, since=jnp.int32(0), out=out), Track()
        return whole.replace(way=None), *pick(latches, latched, (drive, track)), estimate

    before = state.writer.replace(way=None), state.drive, state.track, state.estimate  # the way stays as it is
    writer, drive, track, estimate = run_if(event.kind != btm.NONE, written, before)
    return state.replace(writer=writer.replace(way=way), drive=drive, track=track, estimate=estimate)


def _add_openings(map_, event, at, found, others, when):
    """Add a divergence's links: the openings of a new one but the way in; at one met again those besides
    its links. A start in its circle is on no link."""
    own, bearing = links.ends_at(map_, at.node)
    known = jnp.any(
        own[:, None] & (jnp.abs(btm.wrapped(bearing[:, None] - found.bearing)) < P.graph.same_end_rad), axis=0
    )
    goes = others & when & (~at.again | (at.met & ~known))
    for i in range(MAX_OPENINGS):
        map_, _ = btm.add_link(map_, at.node, found.bearing[i], when=goes[i], opening_m=found.width_m[i])
    is_new = when & ~at.again
    map_ = map_.replace(overflow=map_.overflow + jnp.where(is_new, found.overflow, 0))
    holds = is_new & _holds_start(map_, event) & (map_.start == 0) & (map_.status == btm.UNSEARCHED)
    return map_.replace(blocked=map_.blocked | holds)


def _is_rejected(writer, event, found, back, others, at, points, tuning):
    """Decide whether to reject a candidate, and which of its openings the robot takes: `(passes, which)`.

    A candidate with two openings in line is a stretch of a passage, unless the link leads to a node there. So is a
    candidate whose only opening lies in line with the way in, if the passage is closed beyond its circle only. A
    candidate with a single opening that lies behind its centre is in the corner of a room.
    """
    n, other = jnp.sum(found.valid), jnp.argmax(others)
    straight = jnp.abs(btm.wrapped(found.bearing[other] - back)) > math.pi - P.places.in_line_rad
    followed, to, _ = links.led_to(writer)
    in_line = (jnp.sum(others) == 1) & straight & ~(at.again & followed & (at.node == to))
    free_m = links.reach_m(points, event.centre, back, event.radius)
    in_line &= (n == 2) | ((n == 1) & (free_m > tuning.circle * event.radius))
    corner = (n == 1) & jnp.any(found.valid & _is_behind(found)) & ~at.again
    passes = (event.kind == btm.DIVERGENCE) & (in_line | corner)
    return passes, jnp.where(corner, jnp.argmax(found.valid), other)


def _beyond_opening(event, found, bearing, leave_m):
    """Return a point beyond the opening in a direction, relative to the centre, and the direction of the opening's
    passage, radians; straight on where no opening exists."""
    off = jnp.where(found.valid, jnp.abs(btm.wrapped(found.bearing - bearing)), jnp.inf)
    which = jnp.argmin(off)
    out, plain = found.bearing[which], (event.radius + leave_m) * towards(bearing)
    near = (off[which] < math.pi / 4) & ~_is_behind(found)[which]
    return jnp.where(near, found.middle[which] + leave_m * towards(out), plain), jnp.where(near, out, bearing)


def _is_behind(found: Openings) -> Array:
    """Return openings whose narrowest place lies behind the centre, so that they have one wall only: `[K]` bool."""
    return found.middle[:, 0] * jnp.cos(found.bearing) + found.middle[:, 1] * jnp.sin(found.bearing) < 0
