"""Records of a trace run: what the robot senses, remembers and writes.

Frozen pytrees of one robot. Poses are x, y, metres, and heading, radians; unless said otherwise in the odometry frame.
In the robot's frame x is ahead and y to the left. Defaults are those of the first step.
"""

import dataclasses
import enum
import math
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import Array
from jax.tree_util import register_dataclass

from jexplore.btm import Btm
from jexplore.driving.settings import Noise, Robot, Tuning

register_dataclass(Robot, [field.name for field in dataclasses.fields(Robot) if field.name != "name"], ["name"])
register_dataclass(Tuning)
register_dataclass(Noise)


def _of(value: float | int | bool, size: int | None = None) -> Any:
    """Return the default of a field: a number of 32 bits or a bool, or `size` of them."""
    kind = {bool: np.bool_, int: np.int32, float: np.float32}[type(value)]
    return kind(value) if size is None else struct.field(default_factory=lambda: jnp.full(size, value, kind))


class Walls(struct.PyTreeNode):
    """Segments along the axes, metres. Unused slots lie far away."""

    x: Array  # [V, 3] float32, x, lower and upper y of segments along y
    y: Array  # [U, 3] float32, y, lower and upper x of segments along x


class Terrain(struct.PyTreeNode):
    """Heights of a fine grid, between which they are interpolated bilinearly."""

    height_m: Array  # [h, w] float32
    spacing_m: Array  # float32, of the grid; its first point lies at half a spacing from the map's corner
    peak_m: Array  # float32, the largest height


class Building(struct.PyTreeNode):
    """Building of a run; cell (0, 0) begins at (0, 0)."""

    walls: Walls
    terrain: Terrain
    goal: Array  # [2] float32, metres; NaN: none
    marks: Array  # [K, 3] float32, x, y, radius, metres: places of which it is counted which ones a run has been at


class RobotBody(struct.PyTreeNode):
    """True state of the robot."""

    pose: Array  # [3] float32, building's frame
    pitch: Array  # float32, radians
    roll: Array  # float32, radians
    height_m: Array  # float32
    rise_m: Array  # float32, highest step under the fronts of its tracks
    path_m: Array = _of(0.0)  # float32, way in the plane
    contacts: Array = _of(0)  # int32, steps refused because of a wall
    refused: Array = _of(0)  # int32, steps refused because of the ground


class Senses(struct.PyTreeNode):
    """Sensor readings of one step."""

    ranges_m: Array  # [B] float32, inf: no return; NaN: no reading
    down_m: Array  # [D] float32, as `ranges_m`, of the scanner that looks down
    pitch: Array  # float32, radians
    roll: Array  # float32, radians
    beacon_m: Array  # float32, distance of the goal; inf: not heard


class Draws(struct.PyTreeNode):
    """Random numbers of one step, standard normal but for the last."""

    ranges: Array  # [B] float32
    down: Array  # [D] float32
    attitude: Array  # [2] float32, pitch and roll
    encoders: Array  # [4] float32, length and turn of the step, drift of the heading, length that turning feigns
    beacon: Array  # float32
    missing: Array  # [B] float32, uniform from 0 to 1


SECTORS = 360  # directions, a degree each, from -180 degrees


class Surround(struct.PyTreeNode):
    """The nearest point in every direction, robot's frame."""

    x_m: Array = _of(math.inf, SECTORS)  # [SECTORS] float32; inf: nothing known
    y_m: Array = _of(math.inf, SECTORS)  # [SECTORS] float32, as `x_m`


class KeyScan(struct.PyTreeNode):
    """The scan with which the next ones are matched. Poses are odometry without corrections at nodes."""

    ranges_m: Array  # [B] float32
    lean: Array  # [2] float32, radians, of the ground where it was taken, see `mapping.slope_under`
    pose: Array  # [3] float32, where it was taken
    last: Array  # [3] float32, where a scan was matched with it last


class Manoeuvre(struct.PyTreeNode):
    """Memory of obstacle avoidance between steps."""

    trail: Array  # [TRAIL_POSES, 3] float32, poses of the way here, odometry without corrections; a ring
    length: Array = _of(1)  # int32, place of the next one, counted on
    kept: Array = _of(1)  # int32, poses that it holds
    backing: Array = _of(False)  # bool, it is going back
    backed_m: Array = _of(0.0)  # float32, how far


class Divergence(struct.PyTreeNode):
    """The triangles of a scan that may mark a dead end, a corner, a T or a crossing; robot's frame."""

    corners: Array  # [T, 3, 2] float32, metres
    centre: Array  # [T, 2] float32, of the circle through the corners
    radius: Array  # [T] float32, metres
    valid: Array  # [T] bool
    overflow: Array  # int32, ends of walls and triangles that did not fit


class Openings(struct.PyTreeNode):
    """Exits of a place, counter-clockwise from -180 degrees. Unused slots: `valid` is False."""

    bearing: Array  # [K] float32, radians, square to the narrowest place between the walls on both sides, outward
    middle: Array  # [K, 2] float32, of that place, as seen from the centre
    width_m: Array  # [K] float32, of that
    valid: Array  # [K] bool
    overflow: Array  # int32, openings that did not fit


class LoneStep(struct.PyTreeNode):
    """A step ahead of the robot or under it, or several close together."""

    from_m: Array = _of(math.inf)  # float32, odometer at the first of them, inf: none
    to_m: Array = _of(math.inf)  # float32, at the last
    height_m: Array = _of(0.0)  # float32, of the highest


class RunMode(enum.IntEnum):
    """Run mode of the robot."""

    CENTRAL = 0
    WALL_FOLLOWING = 1
    DEAD_END = 2
    BRANCH_SELECTION = 3
    CONTACT_GUARD = 4


class Latch(enum.IntEnum):
    """State of branch selection until its target is reached."""

    FREE = 0
    APPROACH = 1  # the centre of a divergence
    LEAVE = 2  # a point on one of its links
    LOOK = 3  # the robot turns at its centre and looks round


class Track(struct.PyTreeNode):
    """A divergence that may lie ahead: where scan after scan has shown its triangle."""

    centre: Array = _of(0.0, 2)  # [2] float32, metres
    radius: Array = _of(0.0)  # float32, metres
    seen: Array = _of(0)  # int32, a bit a scan, the last one lowest: whether it showed the triangle
    age: Array = _of(0)  # int32, scans since it was first seen; 0: no divergence


class Drive(struct.PyTreeNode):
    """Memory of driving between steps."""

    latch: Array = _of(0)  # int32, `Latch`
    target: Array = _of(0.0, 2)  # [2] float32, of the latch, metres
    since: Array = _of(0)  # int32, steps of the latch
    out: Array = _of(0.0)  # float32, radians, direction of the link that is taken
    looked: Array = _of(0.0)  # float32, radians turned while looking round
    looked_m: Array = _of(-math.inf)  # float32, odometer when the robot last did
    turning: Array = _of(0)  # int32, side to which a dead end turns the robot: 1 left, -1 right, 0 none
    left_m: Array = _of(1.0)  # float32, last distance of a left wall within C1, or where it can turn next to one
    right_m: Array = _of(1.0)  # float32, as `left_m`, on the right


class Trajectory(struct.PyTreeNode):
    """Every step of the run. T slots."""

    odometer_m: Array  # [T] float32, inf where there was no step yet
    pose: Array  # [T, 3] float32
    pitch: Array  # [T] float32, measured, radians
    roll: Array  # [T] float32, as `pitch`
    posture: Array  # [T] float32, inclination of the body, radians
    width_m: Array  # [T] float32, of the passage; inf where a side is open
    ground_x_m: Array  # [T] float32, odometer at the point that the downward scanner saw; inf for none
    ground_z_m: Array  # [T] float32, its height above the start
    mode: Array  # [T] int32, `RunMode`


class SlopeEstimate(struct.PyTreeNode):
    """Slope of the ground under the robot, and of what it last stood on evenly; see `mapping.slope_at`."""

    even: Array = _of(0.0, 2)  # [2] float32, radians, when it last stood evenly
    anchor: Array = _of(
        0.0, 2
    )  # [2] float32, radians, about which it varies little: as it came there, then as it settled
    anchor_m: Array = _of(0.0)  # float32, odometer where that began
    stands: Array = _of(False)  # bool, whether it stands evenly
    left_m: Array = _of(0.0)  # float32, odometer where it last was the even one
    since_m: Array = _of(0.0)  # float32, odometer where it came to be


class Writer(struct.PyTreeNode):
    """State of writing a map. N nodes, M links."""

    map: Btm
    way: Trajectory
    link: Array  # int32, on which it is; M for none
    left_bearing: Array  # float32, radians, in which it left the last node
    origin: Array  # [3] float32, the last node: x, y, metres; turn of its frame, radians
    tries: Array  # [M] int32, how often the robot has set off on a link that was un-searched, or may do so no more
    fails: Array  # [M] int32, how often in a row a searched link has led elsewhere
    node: Array = _of(0)  # int32, where it was last
    node_m: Array = _of(0.0)  # float32, odometer there
    entry: Array = _of(0.0, 2)  # [2] float32, where it began to approach a divergence
    level: SlopeEstimate = struct.field(default_factory=SlopeEstimate)
    lone_step: LoneStep = struct.field(default_factory=LoneStep)  # that is ahead or under the robot
    border_m: Array = _of(math.inf)  # float32, odometer at which a free space will have been entered or left; inf: none
    passed: Array = struct.field(default_factory=lambda: jnp.array([0.0, 0.0, 0.0, -jnp.inf]))
    """[4] float32, the candidate last rejected: x, y, radius, metres; odometer there"""
    last_chance: Array = _of(-1)  # int32, searched links when those given up last got another chance; -1: never
    exhausted: Array = _of(False)  # bool, nothing is left to follow
    full: Array = _of(False)  # bool, a node did not fit


class DueNode(struct.PyTreeNode):
    """A node that is due in this step."""

    kind: Array  # int32, place in `NODE_TYPES`; `NONE`: no node is due
    odometer_m: Array  # float32, where
    pose: Array  # [3] float32, there
    centre: Array  # [2] float32, of the node
    radius: Array  # float32, of a divergence's circle
    posture: Array  # float32, radians, inclination of the body
    steepest: Array  # float32, radians, of an obstacle
    step_m: Array  # float32, height of a step that it has gone over, or cannot climb; 0
    blocked: Array  # bool, an obstacle that the robot cannot pass
    returns: Array  # bool, to the node where it started


class Arrival(NamedTuple):
    """The node at which the robot is, and how it is met."""

    map: Btm  # with the node
    node: Array  # int32
    again: Array  # bool, whether it was known
    met: Array  # bool, whether the robot is at its middle, so that the odometry can be corrected
    fits: Array  # bool, whether there was room for it
    shift: Array  # [2] float32, correction of the odometry, metres


class ScanWalls(NamedTuple):
    """Walls seen in one scan, robot's frame."""

    region_sides: tuple[Array | float, Array | float]  # clearance to the left and right in `Tuning.region`, metres
    roomy: Array | bool  # whether a circle as large as C1 fits there
    closed: Array | bool  # whether the way ahead is closed
    fronts_m: tuple[Array | float, Array | float]  # free length ahead of the left and right half of the robot's width
    left_m: Array  # float32, clearance by which it steers
    right_m: Array  # float32, as `left_m`
    beside: Array  # [2] float32, clearance to the left and right of the robot


class Ahead(NamedTuple):
    """The ground ahead, and the nodes just passed."""

    leans: Array  # bool, the robot stands otherwise than where it last stood evenly, or the ground rises before it
    missed: Array  # bool, where the free space begins was not reached before it ends
    changed: Array  # bool, whether the robot stands on ground of another inclination now
    crease_m: Array  # float32, odometer where it changed
    steepest: Array  # float32, the larger inclination, radians
    blocked: Array  # bool, there is ground ahead that the robot cannot climb
    beyond: tuple[Array, Array]  # height of the step and inclination of the slope that stop it, see `_ground_ahead`
    lone_step: LoneStep  # that is ahead, under the robot or just passed
    is_lone: Array  # bool, whether it has just passed it


class State(struct.PyTreeNode):
    """A run in progress."""

    body: RobotBody
    estimate: Array  # [3] float32, odometry, corrected where a node is met again
    odometry: Array  # [3] float32, odometry without corrections
    scanned: Array  # [3] float32, odometry without corrections where the last scan was taken
    key: KeyScan
    manoeuvre: Manoeuvre
    writer: Writer
    stray_from: Array  # [2] float32, where it has been near for long
    node_at: Array  # [N, 2] float32, where the robot truly was when it made a node
    met: Array  # [K] bool, which of the building's marks it has been at
    truth: Array  # [T, 3] float32, true poses
    around: Surround = struct.field(default_factory=Surround)  # where the last scan was taken
    track: Track = struct.field(default_factory=Track)
    drive: Drive = struct.field(default_factory=Drive)
    touched: Array = _of(False)  # bool, a wall has just refused a step
    odometer_m: Array = _of(0.0)  # float32
    climbed_m: Array = _of(0.0)  # float32, height above the start as the attitude has it
    inside: Array = _of(False)  # bool, the robot is in free space
    scan_overflow: Array = _of(0)  # int32, ends of walls that scans had more than there is room for
    mode: Array = _of(0)  # int32
    target: Array = _of(0.0, 2)  # [2] float32, target point in the robot's frame
    halts: Array = _of(False)  # bool, the ground has just refused a step
    blind: Array = _of(0)  # int32, scans in a row without numbers
    moved_m: Array = _of(0.0)  # float32, odometer when it last got on
    moved_step: Array = _of(0)  # int32, and the step
    stray_step: Array = _of(0)  # int32, since which step
    helps: Array = _of(0)  # int32
    since_node: Array = _of(0)  # int32, of them, since the last node
    mistaken: Array = _of(0)  # int32, times that it took a place for a node that truly lies elsewhere
    step: Array = _of(0)  # int32
    outcome: Array = _of(0)  # int32
    draws: Draws | tuple[()] = ()  # of `DRAWN_STEPS` steps
