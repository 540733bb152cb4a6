"""Making a node: its identity, the links that end and begin there, the choice of the next link, and the way to it."""

import dataclasses
import math

import jax.numpy as jnp
from jax import Array

from jexplore import btm
from jexplore.arrays.loops import pick, run_if
from jexplore.driving import behaviour, links
from jexplore.driving.mapping import came_from, came_through, has_left, pose_from_node, way_extremes
from jexplore.driving.params.tree import P
from jexplore.driving.records import Arrival, Drive, DueNode, Latch, Openings, State, Track, Writer
from jexplore.driving.sensing import obstacles
from jexplore.driving.sensing.openings import find_openings
from jexplore.driving.settings import Robot, Tuning
from jexplore.driving.vehicle import rotate_by, to_odometry, towards

MAX_OPENINGS = 8  # of a divergence


def _arrive(writer, event, found, back, tuning, is_divergence, is_terminal):
    """Return the node that is due: one that is known, or a new one."""
    is_obstacle = event.kind == btm.OBSTACLE
    near, distance = btm.nearest_node(writer.map, event.centre[0], event.centre[1], event.kind)
    # A place is in the circle of a node, and the node in that of the place.
    smaller = jnp.minimum(event.radius, writer.map.radius_m[jnp.maximum(near, 0)])
    reach = jnp.where(is_divergence, jnp.maximum(0.5, smaller), P.graph.same_node_m)
    may_be_last = is_divergence & has_left(writer, event.odometer_m, tuning.leave_m)
    again = (distance < reach) & ((near != writer.node) | may_be_last) & ~is_terminal
    alike, is_alike = links.match_node(
        writer, (event.centre, event.odometer_m), found, back, reach, is_divergence & ~again
    )
    to, is_led = links.is_led_to(writer, event.centre, event.odometer_m, P.graph.led_node_m)
    is_led &= ~is_divergence & ~is_terminal & (writer.map.kind[to] == event.kind)
    near = jnp.where(event.returns, 0, jnp.where(is_alike, alike, jnp.where(is_led, to, near)))
    again = again | is_alike | is_led | event.returns
    width, posture, roll = way_extremes(writer.way, writer.node_m, event.odometer_m)
    added, new = btm.add_node(
        writer.map,
        event.kind,
        event.centre[0],
        event.centre[1],
        radius_m=event.radius,
        posture_deg=jnp.where(is_obstacle, posture, jnp.degrees(event.posture)),
        inclination_deg=jnp.where(is_obstacle & (event.step_m == 0), jnp.degrees(event.steepest), jnp.nan),
        obstacle=jnp.where(is_obstacle, jnp.where(event.step_m > 0, btm.STAIRS, btm.SLOPE), btm.NONE),
        step_m=jnp.where(event.step_m > 0, event.step_m, jnp.nan),
    )
    map_ = pick(again, writer.map, added)
    fits = again | (writer.map.n_nodes < map_.kind.shape[0])
    met = again & is_divergence & ((distance < P.graph.shift_m) | is_alike)
    share = jnp.where(is_alike, 1.0, P.graph.shift_share)
    shift = jnp.where(met, share * (jnp.stack([map_.x_m[near], map_.y_m[near]]) - event.centre), 0.0)
    return Arrival(map_, jnp.where(again, near, new), again, near, met, fits, shift, width, posture, roll, jnp.zeros(3))


def _find_openings(writer, event, points, tuning, is_divergence):
    """Find the openings of a divergence and the way in: the last one used, else the nearest to the robot's way. A robot
    that started inside has no way in. Returns `(found, others, back)`: `openings.Openings`; `[K]` bool, all but the way
    in; its bearing, radians."""
    came = jnp.where(
        is_divergence, came_from(writer, event.centre, event.radius) - event.centre, -towards(event.pose[2])
    )
    came = jnp.arctan2(came[1], came[0])
    found = find_openings(
        points[0],
        points[1],
        event.centre,
        event.radius,
        tuning.width_m,
        circle=tuning.circle,
        size=MAX_OPENINGS,
        seen_from=event.pose[:2],
    )
    off = jnp.where(found.valid, jnp.abs(btm.wrapped(found.bearing - came)), jnp.inf)
    passed = came_through(writer, event.centre + found.middle, found.across, found.width_m)
    passed = jnp.where(found.valid, passed, -1)
    entry = jnp.where(jnp.any(passed >= 0), jnp.argmax(passed), jnp.argmin(off))
    entry_seen = ((passed[entry] >= 0) | (off[entry] < math.pi / 3)) & ~_holds_start(writer, event)
    back = jnp.where(is_divergence & entry_seen, found.bearing[entry], came)
    return found, found.valid & ~((jnp.arange(MAX_OPENINGS) == entry) & entry_seen), back


def _holds_start(writer, event):
    """Return whether the robot comes from its start, which lies in the circle."""
    off_m = jnp.hypot(event.centre[0] - writer.map.x_m[0], event.centre[1] - writer.map.y_m[0])
    return (writer.node == 0) & (off_m < event.radius)


def _end_way_here(map_, writer, event, at, back, step_m):
    """End the link that led here: `(map, link)`. A new node on a known link ends a way of its own; a new link to a
    known node replaces that node's record, unless the robot comes in by a known one; one that leads back to its own
    opening is dropped."""
    size = map_.start.shape[0]
    on_known = map_.status[jnp.minimum(writer.link, size - 1)] == btm.SEARCHED
    astray = on_known & ~at.again
    map_, own = btm.add_link(map_, writer.node, writer.left_bearing, when=astray)
    link = jnp.where(astray, own, writer.link)
    off = jnp.abs(btm.wrapped(back - map_.start_bearing[jnp.minimum(link, size - 1)]))
    turned_back = at.again & (at.near == writer.node) & ~on_known & (off < math.pi / 4)  # it comes back as it left
    map_ = map_.replace(blocked=map_.blocked.at[jnp.where(turned_back, link, size)].set(True, mode="drop"))
    known, comes_by_it = links.link_from(map_, writer.node, at.node, back)
    comes_by_it &= at.again & ~on_known
    link = jnp.where(comes_by_it, known, link)
    is_new = (~on_known | astray) & ~turned_back & ~comes_by_it
    map_ = _end_link(map_, writer, event, at, back, step_m, link, is_new)
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
    size = writer.map.start.shape[0]
    found, others, back = _find_openings(writer, event, points, tuning, is_divergence)
    at = _arrive(writer, event, found, back, tuning, is_divergence, is_terminal)
    map_, step_m = obstacles.classify_obstacle(at.map, writer, event, tuning, robot, at.posture, at.node)
    at, event, turn, applied, turned = _turns(writer, event, at, found)
    measured = back, found  # by the odometry; from here on as the map has them
    back, found = back + turn, dataclasses.replace(found, bearing=found.bearing + turn)
    map_, link = _end_way_here(map_, writer, event, at, back, step_m)
    map_ = _add_openings(map_, event, at, found, others, is_divergence)
    goes_on = ~is_divergence & ~is_terminal & ~at.again
    map_, new = btm.add_link(map_, at.node, event.pose[2], when=goes_on, blocked=event.blocked)
    passes, which = _is_rejected(writer, event, measured, others, at, is_divergence, points, tuning)
    correction = jnp.where(passes, 0.0, jnp.stack([*at.shift, applied]))
    after, map_, onto, bearing = links.choose_link(writer, map_, at.node, back)
    through = ~is_divergence & ~event.blocked & ~event.returns
    onto = jnp.where(through, jnp.where(goes_on, new, links.other_link(map_, at.node, link)), onto)
    ways = tuning.leave_m * towards(bearing), bearing
    ways = pick(is_divergence, _beyond_opening(event, found, bearing, turn, tuning.leave_m), ways)
    ways = rotate_by(applied - turn)(ways[0]), ways[1] + applied - turn
    beyond = _beyond_opening(event, measured[1], measured[1].bearing[which], 0.0, tuning.leave_m)
    target, out = pick(passes, beyond, ways)
    taken = jnp.where(onto == btm.NONE, size, onto)
    written = after.replace(
        map=map_,
        node=at.node,
        node_m=event.odometer_m,
        link=taken,
        left_bearing=jnp.where(through, event.pose[2], bearing),
        border_m=_border_left(writer, event),
        tries=after.tries.at[taken].add(1, mode="drop"),
        exhausted=~is_terminal & (taken == size),
        origin=jnp.stack([*(event.centre + at.shift), jnp.nan_to_num(turned) - applied]),
    )
    unchanged = writer.replace(passed=jnp.stack([*event.centre, event.radius, event.odometer_m]))
    return (
        pick(passes, unchanged, pick(at.fits, written, _full(writer))),
        jnp.where((~through & (taken < size)) | passes, Latch.LEAVE, Latch.FREE).astype(jnp.int32),
        event.centre + correction[:2] + target,
        out,
        correction,
    )


def _turns(writer, event, at, found):
    """Compare the bearings of a node's openings with its links: `(at, event, turn, applied, turned)`: with its pose
    from the last node; turned; radians that correct the odometry, their applied share; turn of any node, NaN if
    unknown."""
    turned = links.turn_to(at.map, at.node, found)
    turn = jnp.where(at.met, turned, 0.0)
    turned = jnp.where(at.again, jnp.where(event.kind == btm.DIVERGENCE, turned, jnp.nan), 0.0)
    at = at._replace(moved=pose_from_node(writer, event.centre, turned))
    return at, dataclasses.replace(event, pose=event.pose.at[2].add(turn)), turn, P.graph.turn_share * turn, turned


def make_due_node(
    state: State,
    writer: Writer,
    drive: Drive,
    track: Track,
    event: DueNode,
    points: tuple[Array, Array],
    tuning: Tuning,
    robot: Robot,
) -> tuple[Writer, Drive, Track, Array]:
    """Make the node that is due, if one is."""

    def written(carry):
        map_part, rest, drive, track, estimate = carry
        whole = writer.replace(map=map_part, **rest)
        whole, latch, target, out, correction = write_node(whole, event, points, tuning, robot)
        about = to_odometry(jnp.append(event.centre, correction[2]))
        estimate = jnp.append(about(estimate[:2] - event.centre), estimate[2]) + correction
        latches = (event.kind == btm.DIVERGENCE) | event.blocked | event.returns
        drive = drive.replace(
            latch=jnp.where(latches, latch, drive.latch),
            target=jnp.where(latches, target, drive.target),
            since=jnp.where(latches, 0, drive.since),
            out=jnp.where(latches, out, drive.out),
        )
        track = pick(latches, behaviour.empty_track(), track)
        return whole.map, {name: getattr(whole, name) for name in rest}, drive, track, estimate

    names = ("node", "node_m", "link", "left_bearing", "border_m", "passed", "tries", "fails", "last_chance", "full")
    names = (*names, "exhausted", "origin")
    rest = {name: getattr(writer, name) for name in names}
    map_, rest, drive, track, estimate = run_if(
        event.kind != btm.NONE, written, (writer.map, rest, drive, track, state.estimate)
    )
    return writer.replace(map=map_, **rest), drive, track, estimate


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
    off = jnp.hypot(event.centre[0] - map_.x_m[0], event.centre[1] - map_.y_m[0])
    holds = is_new & (off < event.radius) & (map_.start == 0) & (map_.status == btm.UNSEARCHED)
    return map_.replace(blocked=map_.blocked | holds)


def _full(writer):
    return writer.replace(map=writer.map.replace(overflow=writer.map.overflow + 1), full=jnp.bool_(True))


def _border_left(writer, event):
    """Return the border of a free space that is still ahead once a node has been made."""
    reached = (event.kind == btm.FREE_SPACE) & (event.odometer_m >= writer.border_m)
    return jnp.where(reached | (event.kind == btm.DIVERGENCE), jnp.inf, writer.border_m)


def _end_link(map_, writer, event, at_node, back, step_m, link, when):
    """End a link at a node."""
    found = {
        "length_m": event.odometer_m - writer.node_m,
        "min_width_m": at_node.width,
        "link_posture_deg": at_node.posture,
        "max_roll_deg": at_node.roll,
        "max_step_m": step_m,
        **dict(zip(("moved_x_m", "moved_y_m", "turned"), at_node.moved)),
    }
    return btm.end_link(map_, link, at_node.node, back, when=when, **found)


def _is_rejected(writer: Writer, event: DueNode, measured: tuple[Array, Openings], others: Array, at: Arrival,
              is_divergence: Array, points: tuple[Array, Array], tuning: Tuning) -> tuple[Array, Array]:  # fmt: skip
    """Decide whether to reject a candidate, and which of its openings the robot takes: `(passes, which)`.

    A candidate with two openings in line is a stretch of a passage, unless the link leads to a node there. So is a
    candidate whose only opening lies in line with the way in, if the passage is closed beyond its circle only. A
    candidate with a single opening that lies behind its centre is in the corner of a room.

    Args:
      measured: bearing of the way in, radians, and `Openings` of the place, in the odometry frame.
    """
    back, found = measured
    n, other = jnp.sum(found.valid), jnp.argmax(others)
    straight = jnp.abs(btm.wrapped(found.bearing[other] - back)) > math.pi - P.places.in_line_rad
    followed, to = links.leads_to(writer)
    in_line = (jnp.sum(others) == 1) & straight & ~(at.again & followed & (at.near == to))
    free_m = links.reach_m(points, event.centre, back, event.radius)
    in_line &= (n == 2) | ((n == 1) & (free_m > tuning.circle * event.radius))
    corner = (n == 1) & jnp.any(found.valid & _is_behind(found)) & ~at.again
    passes = is_divergence & (in_line | corner)
    return passes, jnp.where(corner, jnp.argmax(found.valid), other)


def _beyond_opening(
    event: DueNode, found: Openings, bearing: Array, turn: Array | float, leave_m: Array | float
) -> tuple[Array, Array]:
    """Return a point beyond the opening in a direction, relative to the centre; straight on where no opening exists.

    Returns:
      `(point, out)`: `[2]`, metres; direction of the opening's passage, radians. `turn` is that of the bearings against
        the odometry, radians; `leave_m` metres.
    """
    off = jnp.where(found.valid, jnp.abs(btm.wrapped(found.bearing - bearing)), jnp.inf)
    which = jnp.argmin(off)
    middle, across = found.middle[which], found.across[which] + turn
    middle = rotate_by(turn)(middle)
    plain = (event.radius + leave_m) * towards(bearing)
    near = (off[which] < math.pi / 4) & ~_is_behind(found)[which]
    return jnp.where(near, middle + leave_m * towards(across), plain), jnp.where(near, across, bearing)


def _is_behind(found: Openings) -> Array:
    """Return openings whose narrowest place lies behind the centre, so that they have one wall only: `[K]` bool."""
    return found.middle[:, 0] * jnp.cos(found.across) + found.middle[:, 1] * jnp.sin(found.across) < 0
