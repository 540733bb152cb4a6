"""Writing the map while driving: the record of the way, and the moment at which a node is made.

A node is made on arrival, never from afar: a divergence at the middle of its circle, free space where the robot enters
and leaves it, an obstacle where the ground's inclination changes or a single step lies, known once the robot stands
evenly again.
"""

import math

import jax
import jax.numpy as jnp
from jax import Array, lax

from jexplore import btm
from jexplore.arrays.loops import run_if
from jexplore.btm import Btm
from jexplore.driving.params.tree import P
from jexplore.driving.records import Latch, RunMode, Senses, SlopeEstimate, State, Trajectory, Writer
from jexplore.driving.sensing import ground_profile, smoothing
from jexplore.driving.settings import Robot
from jexplore.driving.vehicle import down_directions, rotate_by

SLOPE_STEPS = 32  # steps in which the noise of the attitude is told


def no_way(size: int) -> Trajectory:
    """Return a way of no steps; `size` static."""
    far, zeros, modes = jnp.full(size, jnp.inf), jnp.zeros(size), jnp.full(size, -1, jnp.int32)
    angles, poses = {"pitch": zeros, "roll": zeros, "posture": zeros}, jnp.zeros((size, 3))
    return Trajectory(odometer_m=far, pose=poses, width_m=far, ground_x_m=far, ground_z_m=zeros, mode=modes, **angles)


def begin_map(n_steps: int, n_nodes: int, n_links: int, pose: Array, behind: Array | bool) -> Writer:
    """Return a map with the start node, the link on which the robot sets off and, if it exists, the one behind.

    Sizes static.
    """
    map_, node = btm.add_node(btm.empty(n_nodes, n_links), btm.TERMINAL, pose[0], pose[1])
    map_, link = btm.add_link(map_, node, pose[2])
    map_, _ = btm.add_link(map_, node, pose[2] + math.pi, when=behind)
    none = jnp.zeros(n_links, jnp.int32)
    own = {"left_bearing": jnp.float32(1) * pose[2], "origin": jnp.zeros(3).at[:2].set(pose[:2])}
    return Writer(map=map_, way=no_way(n_steps), link=link, tries=none, fails=none, **own)


def slope_under(pitch: Array, roll: Array, heading: Array) -> Array:
    """Return direction and angle of the slope under a robot: `[2, ...]`, radians, in the frame of the heading."""
    cos, sin = jnp.cos(heading), jnp.sin(heading)
    return jnp.stack([-pitch * cos - roll * sin, -pitch * sin + roll * cos])


def last_steps(way: Trajectory, step: Array, n: int) -> tuple[Trajectory, Array]:
    """Return the last n steps of a way, n static, and how long ago each was: `[n]` int32, below 0 for none."""
    first = jnp.clip(step + 1 - n, 0, way.pitch.shape[0] - n)
    last = jax.tree.map(lambda a: lax.dynamic_slice_in_dim(a, first, n), way)
    return last, step - first - jnp.arange(n)


def slope_at(way: Trajectory, step: Array) -> tuple[Array, Array]:
    """Estimate direction (odometry frame) and angle of the slope on which the robot stands.

    A robot that turns on a slope changes pitch and roll; the estimated slope stays the same.

    Args:
      way: `Trajectory`, with this step.

    Returns:
      `(lean, odometer_m)`: `[2]` float32, radians, averaged over as many steps as the noise of the pitch requires;
        float32, in the middle of these steps.
    """
    last, age = last_steps(way, step, SLOPE_STEPS)
    share = smoothing.mean_weights(last.pitch, age)
    lean = slope_under(last.pitch, last.roll, last.pose[:, 2]) @ share
    return lean, share @ jnp.where(age >= 0, last.odometer_m, 0)


def update_slope(
    level: SlopeEstimate, lean: Array, odometer_m: Array | float, threshold: Array | float, even_m: Array | float
) -> tuple[SlopeEstimate, Array, Array, Array]:
    """Take one more lean into account.

    Args:
      threshold: change of inclination that is an obstacle, radians.
      even_m: the robot stands evenly once its lean has varied by less than `even_deg` over this way.

    Returns:
      `(level, changed, crease_m, steepest)`: whether the robot now stands evenly on ground of another inclination; the
        odometer at the crease between both, half way between leaving the one and arriving on the other; the larger of
        both inclinations, radians.
    """
    varied = jnp.hypot(*(lean - level.anchor)) > math.radians(1) * P.ground.even_deg
    anchor = jnp.where(varied, lean, level.anchor)
    anchor_m = jnp.where(varied, odometer_m, level.anchor_m)
    even = odometer_m - anchor_m >= even_m
    anchor = jnp.where(even & ~level.stands, lean, anchor)
    changed = even & (jnp.hypot(*(anchor - level.even)) > threshold)
    crease = (level.left_m + anchor_m) / 2
    steepest = jnp.maximum(jnp.hypot(*anchor), jnp.hypot(*level.even))
    same = jnp.hypot(*(lean - level.even)) <= math.radians(1) * P.ground.even_deg
    # Over the edge of ground on which it has stood for its length, a robot may stand evenly half way for less than
    # that: it still comes from there.
    length_m = even_m / P.ground.even_lengths
    near = jnp.hypot(*(anchor - level.even)) <= math.radians(1) * P.ground.even_deg
    tips = (level.left_m - level.since_m >= length_m) & (odometer_m - anchor_m < length_m)
    stays = even & (changed | near | ~tips)
    after = SlopeEstimate(
        even=jnp.where(stays, anchor, level.even),
        anchor=anchor,
        anchor_m=anchor_m,
        stands=even,
        left_m=jnp.where(same | even, odometer_m, level.left_m),
        since_m=jnp.where(stays & ~near, anchor_m, level.since_m),
    )
    return after, changed, crease, steepest


def moved_from_node(writer: Writer, centre: Array, turn: Array | float) -> dict[str, Array]:
    """Return the odometry pose of a node in the frame of the last one, as fields of the link between them.

    `turn` is that of its own frame against the odometry's, radians, NaN if unknown.
    """
    x_m, y_m = rotate_by(writer.origin[2])(centre - writer.origin[:2])
    return {"moved_x_m": x_m, "moved_y_m": y_m, "turned": btm.wrapped(writer.origin[2] - turn)}


def pose_at(way: Trajectory, odometer_m: Array | float) -> Array:
    """Return the pose when the odometer had a value: `[3]` float32."""
    return way.pose[jnp.argmax(way.odometer_m >= odometer_m)]


def way_extremes(way: Trajectory, from_m: Array | float, to_m: Array | float) -> tuple[Array, Array, Array]:
    """Return extremes between two places: `(metres, degrees, degrees)`; inf, 0 and 0 for no step.

    They are the narrowest passage, the largest inclination of the body and its largest roll.
    """
    within = (way.odometer_m >= from_m) & (way.odometer_m <= to_m)
    known = within & jnp.isfinite(way.width_m)
    meant = smoothing.mean_of_known(jnp.where(known, way.width_m, jnp.inf), smoothing.MEAN_STEPS)
    width = jnp.min(jnp.where(known, meant, jnp.inf))
    rolls = jnp.abs(smoothing.running_mean(way.roll, smoothing.MEAN_STEPS))
    posture, roll = (jnp.degrees(jnp.max(jnp.where(within, a, 0))) for a in (way.posture, rolls))
    return width, posture, roll


def link_measures(writer: Writer, odometer_m: Array) -> dict[str, Array]:
    """Return measures of the way since the last node, as fields of a link."""
    width_m, posture_deg, roll_deg = way_extremes(writer.way, writer.node_m, odometer_m)
    found = {"length_m": odometer_m - writer.node_m, "min_width_m": width_m}
    return found | {"link_posture_deg": posture_deg, "max_roll_deg": roll_deg}


def has_left(writer: Writer, odometer_m: Array | float, leave_m: Array | float) -> Array:
    """Return whether the robot has gone twice the distance for leaving the last node: it may return to it."""
    last = jnp.minimum(writer.node, writer.map.kind.shape[0] - 1)
    return odometer_m - writer.node_m >= 2 * (writer.map.radius_m[last] + leave_m)


def came_from(writer: Writer, centre: Array, radius: Array) -> Array:
    """Return the last position outside a circle since the last node: `[2]` float32, odometry.

    If the robot never was outside: the position where it began to approach.
    """
    outside = jnp.hypot(*(writer.way.pose[:, :2] - centre).T) >= radius
    last = jnp.max(jnp.where(outside & _since_node(writer), jnp.arange(outside.shape[0]), -1))
    return jnp.where(last >= 0, writer.way.pose[last, :2], writer.entry)


def came_through(writer: Writer, middles: Array, across: Array, width_m: Array) -> Array:
    """Return the last step since the last node at which the robot was beyond an opening: `[K]` int32, -1 for none."""
    offset = writer.way.pose[:, :2] - middles[:, None]  # [K, T, 2]
    cos, sin = jnp.cos(across)[:, None], jnp.sin(across)[:, None]
    out_m, aside_m = offset[..., 0] * cos + offset[..., 1] * sin, offset[..., 1] * cos - offset[..., 0] * sin
    there = (
        (out_m > -P.graph.beyond_opening_m[0])
        & (out_m < P.graph.beyond_opening_m[1])
        & (jnp.abs(aside_m) < width_m[:, None] / 2)
    )
    there &= _since_node(writer)
    return jnp.max(jnp.where(there, jnp.arange(there.shape[1]), -1), axis=1)


def end_broken_off(writer: Writer, pose: Array, odometer_m: Array, steps: Array, when: Array) -> tuple[Btm, Array]:
    """End the map of a run that breaks off on an un-searched link: it ends at the robot and continues un-searched.

    Args:
      steps: int32, of the run: later entries of the way are not part of the run.

    Returns:
      `(map, node)`: `Btm`; int32, N where nothing was added.
    """
    n, size = writer.map.kind.shape[0], writer.map.start.shape[0]
    link = jnp.minimum(writer.link, size - 1)
    when &= (writer.link < size) & (writer.map.status[link] == btm.UNSEARCHED) & (writer.map.n_nodes < n)

    def ended(map_):
        gone = jnp.arange(writer.way.odometer_m.shape[0]) < steps
        way = writer.way.replace(odometer_m=jnp.where(gone, writer.way.odometer_m, jnp.inf))
        found = link_measures(writer.replace(way=way), odometer_m) | moved_from_node(writer, pose[:2], 0.0)
        map_, node = btm.add_node(map_, btm.TERMINAL, pose[0], pose[1])
        map_ = btm.end_link(map_, link, node, pose[2] + math.pi, **found)
        return btm.add_link(map_, node, pose[2])[0]

    return run_if(when, ended, writer.map), jnp.where(when, writer.map.n_nodes, n)


def _since_node(writer):
    return jnp.isfinite(writer.way.odometer_m) & (writer.way.odometer_m >= writer.node_m)


def is_near_known(writer: Writer, centres: Array, odometer_m: Array | float, leave_m: Array | float) -> Array:
    """Return which places are the divergence just left, or a candidate just rejected: `[T]` bool.

    No second node is made within half a metre, or the circle's radius, of the last one until the robot may return.
    """
    last = jnp.minimum(writer.node, writer.map.kind.shape[0] - 1)
    is_divergence = writer.map.kind[last] == btm.DIVERGENCE
    place = jnp.stack([writer.map.x_m[last], writer.map.y_m[last]])
    reach = jnp.maximum(0.5, writer.map.radius_m[last])
    known = (
        is_divergence & ~has_left(writer, odometer_m, leave_m) & (jnp.sum((centres - place) ** 2, axis=-1) < reach**2)
    )
    x, y, radius, there_m = writer.passed
    reach = jnp.maximum(0.5, radius / 2)
    off2 = (centres[..., 0] - x) ** 2 + (centres[..., 1] - y) ** 2
    return known | ((odometer_m - there_m < 2 * (radius + leave_m)) & (off2 < reach**2))


def record_step(state: State, senses: Senses, width_m: Array, robot: Robot) -> Writer:
    """Record the measures of a step; no width where the robot turns in place."""
    way, at = state.writer.way, state.step
    ground_x, ground_z, ground_seen = ground_profile.ground_point(
        senses.down_m,
        down_directions(robot),
        senses.pitch,
        senses.roll,
        (robot.scanner_x_m, robot.scanner_height_m),
        robot.width_m / 2,
    )
    turns = (state.mode == RunMode.DEAD_END) | (state.mode == RunMode.CONTACT_GUARD) | (state.drive.latch == Latch.LOOK)
    new = {
        "odometer_m": state.odometer_m,
        "pose": state.estimate,
        "pitch": senses.pitch,
        "roll": senses.roll,
        "posture": jnp.arccos(jnp.cos(senses.pitch) * jnp.cos(senses.roll)),
        "width_m": jnp.where(turns, jnp.inf, width_m),
        "ground_x_m": jnp.where(ground_seen, state.odometer_m + ground_x, jnp.inf),
        "ground_z_m": state.climbed_m + ground_z,
    }
    way = way.replace(**{name: getattr(way, name).at[at].set(value, mode="drop") for name, value in new.items()})
    return state.writer.replace(way=way)


def record_truth(node_at: Array, before: Writer, after: Writer, at: Array) -> tuple[Array, Array]:
    """Record the true position at which a node is made, and report wrong node matches.

    Args:
      node_at: `[N, 2]` float32, metres, of the existing nodes.

    Returns:
      `(node_at, is_elsewhere)`: with the new nodes of this step; bool, the matched node truly lies elsewhere.
    """
    here, was = (jnp.stack([writer.map.x_m, writer.map.y_m]) for writer in (after, before))
    is_new = jnp.any(here != was, axis=0) & (jnp.arange(node_at.shape[0]) < after.map.n_nodes)  # its number may be old
    again = (after.node_m != before.node_m) & ~is_new[after.node]
    off_m = jnp.hypot(*(at - node_at[after.node]))
    is_elsewhere = again & (off_m > after.map.radius_m[after.node] + P.graph.elsewhere_m)
    return jnp.where(is_new[:, None], at, node_at), is_elsewhere
