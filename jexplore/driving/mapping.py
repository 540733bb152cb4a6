"""How the robot writes its map while it drives: what it remembers of the way, and when a node is made.

A node is made on arrival, never from afar: a divergence at the middle of its circle, free space where the robot enters
and leaves it, an obstacle where the ground's inclination changes, known once the robot stands evenly again.
"""

import math

import jax
import jax.numpy as jnp
from flax import struct
from jax import Array

from jexplore import btm
from jexplore.arrays.loops import run_if
from jexplore.btm import Btm
from jexplore.driving import ground_profile, perception
from jexplore.driving.behaviour import Latch

SNAPSHOTS = 16  # of scan points that are kept on the way, for the openings of the next divergence
SNAPSHOT_M = 0.2  # way between two
OPENINGS = 8  # of a divergence
EVEN_DEG = 1.0  # the robot stands evenly once its pitch has varied by less than this
EVEN_LENGTHS = 0.25  # over this way, in lengths of the robot: on a long robot a gentle slope comes slowly
SAME_NODE_M = 1.0  # free space and obstacles nearer than this to one that is known are that one
MEANT_STEPS = 5  # of which the width of a passage is the mean
MEANT_M = 0.1  # as far as they are this near
STEP_M = 0.04  # a rise of the profile by more than this within a cell's length is a step


@struct.dataclass
class Way:
    """Every step of the run. T slots."""

    odometer_m: Array  # [T] float32, inf where there was no step yet
    pose: Array  # [T, 3] float32, odometry: x, y, metres; heading, radians
    pitch: Array  # [T] float32, measured, radians
    posture: Array  # [T] float32, inclination of the body, radians
    width_m: Array  # [T] float32, of the passage; inf where a side is open
    ground_x_m: Array  # [T] float32, odometer at the point that the downward scanner saw; inf for none
    ground_z_m: Array  # [T] float32, its height above the start
    mode: Array  # [T] int32, `RunMode`


def no_way(size):
    """A way of no steps; `size` static."""
    return Way(
        odometer_m=jnp.full(size, jnp.inf),
        pose=jnp.zeros((size, 3)),
        pitch=jnp.zeros(size),
        posture=jnp.zeros(size),
        width_m=jnp.full(size, jnp.inf),
        ground_x_m=jnp.full(size, jnp.inf),
        ground_z_m=jnp.zeros(size),
        mode=jnp.full(size, -1, jnp.int32),
    )


@struct.dataclass
class Level:
    """The inclination of the ground that the robot stands on, and of what it last stood on evenly."""

    even: Array  # float32, radians, pitch when it last stood evenly
    anchor: Array  # float32, radians, pitch since which it has varied little
    anchor_m: Array  # float32, odometer there
    left_m: Array  # float32, odometer where it last had the even pitch


@struct.dataclass
class Writer:
    """What the robot knows while it writes."""

    map: Btm
    way: Way
    node: Array  # int32, where it was last
    node_m: Array  # float32, odometer there
    link: Array  # int32, on which it is; M for none
    left_bearing: Array  # float32, radians, in which it left the last node
    entry: Array  # [2] float32, where it began to approach a divergence
    level: Level
    border_m: Array  # float32, odometer at which a free space will have been entered or left; inf: none
    snapshot: Array  # [SNAPSHOTS, P, 2] float32, scan points, odometry
    snapshot_there: Array  # [SNAPSHOTS, P] bool
    snapshot_m: Array  # float32, odometer of the last one
    n_snapshots: Array  # int32
    exhausted: Array  # bool, nothing is left to follow
    full: Array  # bool, a node did not fit


def begin(n_steps, n_points, n_nodes, n_links, pose, behind):
    """A map of the node where the robot starts, the link on which it sets off and, if there is one, the one behind.

    Sizes static.
    """
    map_, node = btm.add_node(btm.empty(n_nodes, n_links), btm.TERMINAL, pose[0], pose[1])
    map_, link = btm.add_link(map_, node, pose[2])
    map_, _ = btm.add_link(map_, node, pose[2] + math.pi, when=behind)
    zero = jnp.float32(0)
    return Writer(
        map=map_,
        way=no_way(n_steps),
        node=node,
        node_m=zero,
        link=link,
        left_bearing=jnp.float32(1) * pose[2],
        entry=jnp.zeros(2),
        level=Level(even=zero, anchor=zero, anchor_m=zero, left_m=zero),
        border_m=jnp.float32(jnp.inf),
        snapshot=jnp.zeros((SNAPSHOTS, n_points, 2)),
        snapshot_there=jnp.zeros((SNAPSHOTS, n_points), bool),
        snapshot_m=jnp.float32(-jnp.inf),
        n_snapshots=jnp.int32(0),
        exhausted=jnp.bool_(False),
        full=jnp.bool_(False),
    )


def watch_level(level, pitch, odometer_m, threshold, even_m):
    """Takes one more pitch into account.

    Args:
      level: `Level`.
      pitch: measured, radians.
      odometer_m: float32.
      threshold: change of inclination that is an obstacle, radians.
      even_m: the robot stands evenly once its pitch has varied by less than `EVEN_DEG` over this way.

    Returns:
      `(level, changed, crease_m, steepest)`: whether the robot now stands evenly on ground of another inclination; the
        odometer at the crease between both, half way between leaving the one and arriving on the other; the larger of
        both inclinations, radians.
    """
    varied = jnp.abs(pitch - level.anchor) > math.radians(EVEN_DEG)
    anchor = jnp.where(varied, pitch, level.anchor)
    anchor_m = jnp.where(varied, odometer_m, level.anchor_m)
    even = odometer_m - anchor_m >= even_m
    changed = even & (jnp.abs(anchor - level.even) > threshold)
    crease = (level.left_m + anchor_m) / 2
    steepest = jnp.maximum(jnp.abs(anchor), jnp.abs(level.even))
    same = jnp.abs(pitch - level.even) <= math.radians(EVEN_DEG)
    after = Level(
        even=jnp.where(even, anchor, level.even),
        anchor=anchor,
        anchor_m=anchor_m,
        left_m=jnp.where(same | even, odometer_m, level.left_m),
    )
    return after, changed, crease, steepest


def keep_snapshot(writer, points_of, odometer_m):
    """Keeps the scan points of this step, if the robot has moved on since the last ones.

    Args:
      writer: `Writer`.
      points_of: function without arguments: `(points, there)`, `[P, 2]` and `[P]`.
      odometer_m: float32.

    Returns:
      `Writer`.
    """

    def kept(state):
        points, there = points_of()
        at = state[2] % SNAPSHOTS
        return state[0].at[at].set(points), state[1].at[at].set(there), state[2] + 1, odometer_m

    state = writer.snapshot, writer.snapshot_there, writer.n_snapshots, writer.snapshot_m
    snapshot, there, n, last_m = run_if(odometer_m - writer.snapshot_m >= SNAPSHOT_M, kept, state)
    return writer.replace(snapshot=snapshot, snapshot_there=there, n_snapshots=n, snapshot_m=last_m)


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


def pose_at(way, odometer_m):
    """The pose when the odometer had a value: `[3]` float32."""
    return way.pose[jnp.argmax(way.odometer_m >= odometer_m)]


def along(way, from_m, to_m):
    """Narrowest passage and largest inclination of the body between two places: `(metres, degrees)`; inf and 0 for no
    step.
    """
    within = (way.odometer_m >= from_m) & (way.odometer_m <= to_m)
    known = within & jnp.isfinite(way.width_m)
    n, half, total, count = known.shape[0], MEANT_STEPS // 2, 0, 0
    place, value = (
        jnp.pad(a, half, constant_values=jnp.inf) for a in (jnp.where(known, way.odometer_m, jnp.inf), way.width_m)
    )
    for k in range(MEANT_STEPS):
        near = jnp.abs(place[k : k + n] - way.odometer_m) <= MEANT_M
        total, count = total + jnp.where(near, value[k : k + n], 0), count + near
    width = jnp.min(jnp.where(known, total / jnp.maximum(count, 1), jnp.inf))
    return width, jnp.degrees(jnp.max(jnp.where(within, way.posture, 0)))


def write(writer, event, tuning, robot):
    """Makes the node that is due, ends the link that led to it, and chooses where to go on.

    Args:
      writer: `Writer`.
      event: `Event`, of any kind but `NONE`.
      tuning, robot: `Tuning`, `Robot`.

    Returns:
      `(writer, latch, target, shift)`: `Latch` and target point of branch selection; `[2]`, correction of the odometry,
        metres, where a node was met again.
    """
    is_divergence, is_obstacle = event.kind == btm.DIVERGENCE, event.kind == btm.OBSTACLE
    is_terminal = (event.kind == btm.TERMINAL) & ~event.returns
    size = writer.map.start.shape[0]

    # The node: one that is known, or a new one.
    near, distance = btm.nearest_node(writer.map, event.centre[0], event.centre[1], event.kind)
    reach = jnp.where(is_divergence, jnp.maximum(0.5, event.radius), SAME_NODE_M)
    may_be_last = is_divergence & _has_left(writer, event.odometer_m, tuning.leave_m)
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
    node = jnp.where(again, near, new)
    fits = again | (writer.map.n_nodes < map_.kind.shape[0])
    shift = jnp.where(again & is_divergence, jnp.stack([map_.x_m[near], map_.y_m[near]]) - event.centre, 0.0)

    # The obstacle that the way here led over.
    map_ = _judge_profile(map_, writer, event, tuning, robot, posture, node)

    # Openings of a divergence; the way in is the one nearest to where the robot came from.
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
    others = found.valid & ~((jnp.arange(OPENINGS) == entry) & entry_seen)

    # The link that led here. On a known link to a known node nothing is new; a new node on it shows that the robot has
    # left it unawares: it came by a way of its own. On a new link to a known node, the node's own record of it goes.
    # A new link that leads back to its own opening is none that could be followed.
    on_known = map_.status[jnp.minimum(writer.link, size - 1)] == btm.SEARCHED
    astray = on_known & ~again
    map_, own = btm.add_link(map_, writer.node, writer.left_bearing, when=astray)
    link = jnp.where(astray, own, writer.link)
    off = jnp.abs(btm.wrapped(back - map_.start_bearing[jnp.minimum(link, size - 1)]))
    turned_back = again & (near == writer.node) & ~on_known & (off < math.pi / 4)  # it comes back as it left
    map_ = map_.replace(blocked=map_.blocked.at[jnp.where(turned_back, link, size)].set(True, mode="drop"))
    is_new = (~on_known | astray) & ~turned_back
    map_ = _end_link(map_, writer, node, event, back, width, posture, link, is_new)
    map_ = _withdraw_double(map_, node, back, again & is_new)

    # Its new links.
    for i in range(OPENINGS):
        map_, _ = btm.add_link(
            map_,
            node,
            found.bearing[i],
            when=is_divergence & ~again & others[i],
            opening_m=found.width_m[i],
        )
    goes_on = ~is_divergence & ~is_terminal & ~again
    map_, onward = btm.add_link(map_, node, event.pose[2], when=goes_on, blocked=event.blocked)
    map_ = map_.replace(overflow=map_.overflow + jnp.where(is_divergence & ~again, found.overflow, 0))

    # Where to.
    open_link = btm.first_open(map_, node, back)
    hop, hop_bearing, _ = btm.next_hop(map_, node)
    other = _other_link(map_, node, link)
    through = ~is_divergence & ~event.blocked
    use_open = open_link != btm.NONE
    onto = jnp.where(use_open, open_link, hop)
    bearing = jnp.where(use_open, map_.start_bearing[jnp.minimum(open_link, size - 1)], hop_bearing)
    onto = jnp.where(through, jnp.where(goes_on, onward, other), onto)
    leaves = ~through & (onto != btm.NONE)
    out = jnp.where(is_divergence, event.radius, 0) + tuning.leave_m
    target = event.centre + shift + out * _heading(bearing)
    written = writer.replace(
        map=map_,
        node=node,
        node_m=event.odometer_m,
        link=jnp.where(onto == btm.NONE, size, onto),
        left_bearing=jnp.where(through, event.pose[2], bearing),
        border_m=_border_left(writer, event),
        snapshot_there=writer.snapshot_there & ~is_divergence,
        exhausted=~is_terminal & (onto == btm.NONE),
    )
    refused = writer.replace(map=writer.map.replace(overflow=writer.map.overflow + 1), full=jnp.bool_(True))
    return (
        jax.tree.map(lambda new, old: jnp.where(fits, new, old), written, refused),
        jnp.where(leaves, Latch.LEAVE, Latch.FREE).astype(jnp.int32),
        target,
        shift,
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


def _has_left(writer, odometer_m, leave_m):
    """Whether the robot has gone twice as far as it takes to leave the last node: it may come back to it."""
    last = jnp.minimum(writer.node, writer.map.kind.shape[0] - 1)
    return odometer_m - writer.node_m >= 2 * (writer.map.radius_m[last] + leave_m)


def is_near_known(writer, centres, odometer_m, leave_m):
    """Which places are the divergence that the robot has just left: `[T]` bool.

    No second node is made within half a metre, or the circle's radius, of the last one, until the robot has gone so far
    that it may come back.
    """
    last = jnp.minimum(writer.node, writer.map.kind.shape[0] - 1)
    is_divergence = writer.map.kind[last] == btm.DIVERGENCE
    place = jnp.stack([writer.map.x_m[last], writer.map.y_m[last]])
    reach = jnp.maximum(0.5, writer.map.radius_m[last])
    return (
        is_divergence & ~_has_left(writer, odometer_m, leave_m) & (jnp.sum((centres - place) ** 2, axis=-1) < reach**2)
    )
