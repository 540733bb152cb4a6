"""How a node of the map is made: which one it is, the links that end and begin there, and where to go on."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct
from jax import Array

from jexplore import btm
from jexplore.btm import Btm
from jexplore.driving import ground_profile, perception
from jexplore.driving.behaviour import Latch
from jexplore.driving.mapping import Writer, along, has_left
from jexplore.driving.settings import Robot, Tuning

OPENINGS = 8  # of a divergence
SAME_NODE_M = 1.0  # free space and obstacles nearer than this to one that is known are that one


@struct.dataclass
class Event:
    """A node that is due in this step."""

    kind: Array  # int32, place in `NODE_TYPES`; `NONE`: no node is due
    odometer_m: Array  # float32, where
    pose: Array  # [3] float32, odometry there
    centre: Array  # [2] float32, of the node
    radius: Array  # float32, of a divergence's circle
    posture: Array  # float32, radians, inclination of the body
    steepest: Array  # float32, radians, of an obstacle
    step_m: Array  # float32, height of a step that the robot cannot climb; 0
    blocked: Array  # bool, an obstacle that the robot cannot pass
    returns: Array  # bool, to the node where it started


class Arrival(NamedTuple):
    """The node at which the robot is, and how it is met."""

    map: Btm  # with the node
    node: Array  # int32
    again: Array  # bool, whether it was known
    near: Array  # int32, the known node
    fits: Array  # bool, whether there was room for it
    shift: Array  # [2] float32, correction of the odometry, metres
    width: Array  # float32, of the way here, metres
    posture: Array  # float32, the steepest on it, degrees


def _arrive(writer, event, tuning, is_divergence, is_terminal):
    """The node that is due: one that is known, or a new one."""
    is_obstacle = event.kind == btm.OBSTACLE
    near, distance = btm.nearest_node(writer.map, event.centre[0], event.centre[1], event.kind)
    reach = jnp.where(is_divergence, jnp.maximum(0.5, event.radius), SAME_NODE_M)
    may_be_last = is_divergence & has_left(writer, event.odometer_m, tuning.leave_m)
    again = (distance < reach) & ((near != writer.node) | may_be_last) & ~is_terminal | event.returns
    near = jnp.where(event.returns, 0, near)
    width, posture = along(writer.way, writer.node_m, event.odometer_m)
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
    map_ = _either(again, writer.map, added)
    fits = again | (writer.map.n_nodes < map_.kind.shape[0])
    shift = jnp.where(again & is_divergence, jnp.stack([map_.x_m[near], map_.y_m[near]]) - event.centre, 0.0)
    return Arrival(map_, jnp.where(again, near, new), again, near, fits, shift, width, posture)


def _find_openings(writer, event, tuning, is_divergence):
    """Openings of a divergence, and the way in, which is the one nearest to where the robot came from.

    Returns:
      `(found, others, back)`: `perception.Openings`; which of them are not the way in; bearing of that way, radians.
    """
    came = jnp.where(is_divergence, writer.entry - event.centre, -_heading(event.pose[2]))
    came = jnp.arctan2(came[1], came[0])
    points = writer.snapshot.reshape(-1, 2), writer.snapshot_there.reshape(-1)
    found = perception.openings(
        *points, event.centre, event.radius, tuning.width_m, circle=tuning.circle, size=OPENINGS
    )
    off = jnp.where(found.valid, jnp.abs(btm.wrapped(found.bearing - came)), jnp.inf)
    entry = jnp.argmin(off)
    entry_seen = off[entry] < math.pi / 3
    back = jnp.where(is_divergence & entry_seen, found.bearing[entry], came)
    return found, found.valid & ~((jnp.arange(OPENINGS) == entry) & entry_seen), back


def _end_way_here(map_, writer, event, at, back):
    """Ends the link that led here: `(map, link)`.

    On a known link to a known node nothing is new; a new node on it shows that the robot has left it unawares: it came
    by a way of its own. On a new link to a known node, the node's own record of it goes. A new link that leads back to
    its own opening is none that could be followed.
    """
    size = map_.start.shape[0]
    on_known = map_.status[jnp.minimum(writer.link, size - 1)] == btm.SEARCHED
    astray = on_known & ~at.again
    map_, own = btm.add_link(map_, writer.node, writer.left_bearing, when=astray)
    link = jnp.where(astray, own, writer.link)
    off = jnp.abs(btm.wrapped(back - map_.start_bearing[jnp.minimum(link, size - 1)]))
    turned_back = at.again & (at.near == writer.node) & ~on_known & (off < math.pi / 4)  # it comes back as it left
    map_ = map_.replace(blocked=map_.blocked.at[jnp.where(turned_back, link, size)].set(True, mode="drop"))
    is_new = (~on_known | astray) & ~turned_back
    map_ = _end_link(map_, writer, at.node, event, back, at.width, at.posture, link, is_new)
    return _withdraw_double(map_, at.node, back, at.again & is_new), link


def write(writer: Writer, event: Event, tuning: Tuning, robot: Robot) -> tuple[Writer, Array, Array, Array]:
    """Makes the node that is due, ends the link that led to it, and chooses where to go on.

    Args:
      writer: `Writer`.
      event: `Event`, of any kind but `NONE`.
      tuning, robot: `Tuning`, `Robot`.

    Returns:
      `(writer, latch, target, shift)`: `Latch` and target point of branch selection; `[2]`, correction of the odometry,
        metres, where a node was met again.
    """
    is_divergence, size = event.kind == btm.DIVERGENCE, writer.map.start.shape[0]
    is_terminal = (event.kind == btm.TERMINAL) & ~event.returns
    at = _arrive(writer, event, tuning, is_divergence, is_terminal)
    map_ = _judge_profile(at.map, writer, event, tuning, robot, at.posture, at.node)
    found, others, back = _find_openings(writer, event, tuning, is_divergence)
    map_, link = _end_way_here(map_, writer, event, at, back)

    # Its new links.
    fresh = is_divergence & ~at.again
    for i in range(OPENINGS):
        bearing, opening_m = found.bearing[i], found.width_m[i]
        map_, _ = btm.add_link(map_, at.node, bearing, when=fresh & others[i], opening_m=opening_m)
    goes_on = ~is_divergence & ~is_terminal & ~at.again
    map_, onward = btm.add_link(map_, at.node, event.pose[2], when=goes_on, blocked=event.blocked)
    map_ = map_.replace(overflow=map_.overflow + jnp.where(fresh, found.overflow, 0))

    # Where to.
    open_link = btm.first_open(map_, at.node, back)
    hop, hop_bearing, _ = btm.next_hop(map_, at.node)
    through, use_open = ~is_divergence & ~event.blocked, open_link != btm.NONE
    onto = jnp.where(use_open, open_link, hop)
    bearing = jnp.where(use_open, map_.start_bearing[jnp.minimum(open_link, size - 1)], hop_bearing)
    onto = jnp.where(through, jnp.where(goes_on, onward, _other_link(map_, at.node, link)), onto)
    leaves = ~through & (onto != btm.NONE)
    out = jnp.where(is_divergence, event.radius, 0) + tuning.leave_m
    written = writer.replace(
        map=map_,
        node=at.node,
        node_m=event.odometer_m,
        link=jnp.where(onto == btm.NONE, size, onto),
        left_bearing=jnp.where(through, event.pose[2], bearing),
        border_m=_border_left(writer, event),
        snapshot_there=writer.snapshot_there & ~is_divergence,
        exhausted=~is_terminal & (onto == btm.NONE),
    )
    refused = writer.replace(map=writer.map.replace(overflow=writer.map.overflow + 1), full=jnp.bool_(True))
    return (
        jax.tree.map(lambda new, old: jnp.where(at.fits, new, old), written, refused),
        jnp.where(leaves, Latch.LEAVE, Latch.FREE).astype(jnp.int32),
        event.centre + at.shift + out * _heading(bearing),
        at.shift,
    )


def _border_left(writer, event):
    """The border of a free space that is still ahead once a node has been made."""
    reached = (event.kind == btm.FREE_SPACE) & (event.odometer_m >= writer.border_m)
    return jnp.where(reached | (event.kind == btm.DIVERGENCE), jnp.inf, writer.border_m)


def _heading(angle):
    return jnp.stack([jnp.cos(angle), jnp.sin(angle)])


def _either(condition, yes, no):
    return btm.Btm(**{name: jnp.where(condition, getattr(yes, name), getattr(no, name)) for name in yes.__dict__})


def _end_link(map_, writer, node, event, back, width, posture, link, when):
    """Ends a link at a node."""
    at = jnp.where(when, link, map_.start.shape[0])
    values = {
        "end": node,
        "status": btm.SEARCHED,
        "length_m": event.odometer_m - writer.node_m,
        "min_width_m": width,
        "link_posture_deg": posture,
        "end_bearing": btm.wrapped(back),
    }
    return map_.replace(**{name: getattr(map_, name).at[at].set(v, mode="drop") for name, v in values.items()})


def _withdraw_double(map_, node, back, when):
    """Takes away the un-searched link of a node by which the robot has just come in from its other end."""
    off = jnp.abs(btm.wrapped(map_.start_bearing - back))
    off = jnp.where((map_.start == node) & (map_.status == btm.UNSEARCHED), off, jnp.inf)
    at = jnp.argmin(off)
    at = jnp.where(when & (off[at] < math.pi / 4), at, map_.start.shape[0])
    return map_.replace(
        status=map_.status.at[at].set(btm.NONE, mode="drop"), start=map_.start.at[at].set(btm.NONE, mode="drop")
    )


def _other_link(map_, node, link):
    """The link of a node that is not the one given; the same where it is the only one."""
    touches = ((map_.start == node) | (map_.end == node)) & (map_.status != btm.NONE)
    others = touches & (jnp.arange(touches.shape[0]) != link)
    return jnp.where(jnp.any(others), jnp.argmax(others).astype(jnp.int32), link)


def _judge_profile(map_, writer, event, tuning, robot, posture, here):
    """Says of the obstacle that lies behind what it is, once the robot has passed it."""
    before = jnp.minimum(writer.node, map_.kind.shape[0] - 1)
    over = map_.kind[before] == btm.OBSTACLE
    margin = 0.1
    way = writer.way
    within = (way.ground_x_m > writer.node_m + margin) & (way.ground_x_m < event.odometer_m - margin)
    found = ground_profile.profile(way.ground_x_m, way.ground_z_m, within & jnp.isfinite(way.ground_x_m))
    is_steep = jnp.abs(jnp.arctan(found.slope)) > jnp.radians(tuning.inclination_deg)
    judged = over & is_steep & (found.count >= 3) & (event.odometer_m > writer.node_m)
    stairs = judged & (found.variance_m2 > tuning.variance_max_m2)

    def mark(array, at, value, when):
        return array.at[jnp.where(when, at, array.shape[0])].set(value, mode="drop")

    obstacle, step, variance = map_.obstacle, map_.step_m, map_.variance_m2
    for at, is_one in ((before, stairs), (here, stairs & (event.kind == btm.OBSTACLE))):
        obstacle = mark(obstacle, at, btm.STAIRS, is_one)
        step = mark(step, at, jnp.fmax(found.step_m, step[at]), is_one)
    for at, is_one in ((before, judged), (here, judged & (event.kind == btm.OBSTACLE))):
        variance = mark(variance, at, jnp.fmax(found.variance_m2, variance[at]), is_one)
    known = map_.posture_deg[before]
    # On the ground between, without the ramps of the robot's own length at both ends.
    margin = robot.length_m / 2 + 0.05
    on_it = (way.odometer_m > writer.node_m + margin) & (way.odometer_m < event.odometer_m - margin)
    n = jnp.sum(on_it)
    even = jnp.degrees(jnp.sum(jnp.where(on_it, jnp.abs(way.pitch), 0)) / jnp.maximum(n, 1))
    even = jnp.where(over & (n > 0) & (even > tuning.inclination_deg), even, jnp.nan)
    inclination = map_.inclination_deg
    for at, is_one in ((before, over), (here, over & (event.kind == btm.OBSTACLE))):
        inclination = mark(inclination, at, jnp.fmax(inclination[at], even), is_one)
    return map_.replace(
        obstacle=obstacle,
        step_m=step,
        variance_m2=variance,
        inclination_deg=inclination,
        posture_deg=mark(map_.posture_deg, before, jnp.fmax(known, posture), over),
    )
