"""One step of the robot: move, scan, find the pose by matching, count the scan into a grid that moves along.

The grid is `SIDE` cells square with the robot near its middle. Cells that leave it are forgotten.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import Array, lax

from jexplore.arrays.loops import run_if
from jexplore.arrays.poses import between
from jexplore.driving.building.terrain import is_level
from jexplore.driving.records import Building, Draws, RobotBody, Senses
from jexplore.driving.settings import Noise, Robot, Tuning
from jexplore.driving.vehicle import (
    ANGLES_RAD,
    BEAMS,
    SCAN_RANGE_M,
    draw_one,
    initial_body,
    level_scan,
    move,
    read_sensors,
)
from jexplore.engine.devices import pinned_draws
from jexplore.grid import Grid, is_occupied
from jexplore.slam2d.beams import Reading, fold
from jexplore.slam2d.closing import Scanner
from jexplore.slam2d.mapping import Mapping, Sizes, begin, put
from jexplore.slam2d.settings import SlamSettings

CELL_M = 0.1  # edge of a cell
SIDE = 128  # cells: 12.8 m, three quarters of what the scanner sees on both sides
SHIFT = SIDE // 8  # cells by which the grid moves at once, at least half as many
P_FREE = 0.2  # a cell is occupied above this share of hits: a beam along a wall passes many of its cells
CONTACT_HITS = 30  # hits that a contact counts: seen free, such a cell is free again after 12 s, a few plans
SLAM_SIZES = Sizes(keys=8192, loops=1)  # key scans of a kilometre of way and as many turns


class Report(NamedTuple):
    """Report of a step; poses are x, y, metres, and heading, radians."""

    pose: np.ndarray  # [3] float32, estimated
    truth: np.ndarray  # [3] float32
    path_m: float
    contacts: int
    refused: int
    beacon_m: float  # distance of the goal; inf: not heard
    is_blind: bool  # more than half of the beams gave no number
    ahead_m: float  # from the outline to the nearest occupied cell in the way ahead; inf: none
    behind_m: float  # the same behind


class LocalState(struct.PyTreeNode):
    """State of the robot and of its local map."""

    body: RobotBody
    odometry: Array  # [3] float32
    draws: Draws
    senses: Senses
    slam: Mapping
    grid: Grid  # [SIDE, SIDE], cell (0, 0) is `corner`
    corner: Array  # [2] int32, row and col in cells of the odometry frame
    step: Array  # int32


class Fixed(NamedTuple):
    """Arrays of a run that do not change."""

    building: Building
    robot: Robot
    noise: Noise
    settings: SlamSettings
    key: Array  # of the run; step i draws by `fold_in(key, i)`


class LocalTask(NamedTuple):
    """All that a run needs."""

    fixed: Fixed
    tuning: Tuning
    start: np.ndarray  # [3] float32
    max_steps: int


def _sensed(fixed, body, step):
    draws = draw_one(jax.random.fold_in(fixed.key, step), fixed.noise)
    senses = read_sensors(draws, fixed.building, fixed.robot, fixed.noise, body)
    return draws, senses if is_level(fixed.building.terrain) else level_scan(senses, fixed.robot)[0]


def _scanner():
    return Scanner(jnp.asarray(ANGLES_RAD), jnp.float32(SCAN_RANGE_M))


@functools.partial(jax.jit, donate_argnums=())
@pinned_draws()
def begin_run(fixed: Fixed, start: Array) -> tuple[LocalState, Array]:
    """Return the state at a start `[3]` after the first scan, and its report.

    The robot's surroundings as far as it can turn in place are free.
    """
    body = initial_body(fixed.building, fixed.robot, start)
    draws, senses = _sensed(fixed, body, 0)
    slam = begin(fixed.settings, SLAM_SIZES, senses.ranges_m, start, _scanner(), start[:2])
    corner = jnp.floor(start[1::-1] / CELL_M).astype(jnp.int32) - SIDE // 2
    blank = jnp.zeros((SIDE, SIDE), jnp.int32)
    state = LocalState(body, start, draws, senses, slam, Grid(blank, blank), corner, jnp.int32(0))
    row, col = (c * CELL_M - a for c, a in zip(jnp.split(_centres(corner), 2, -1), start[1::-1]))
    turns = jnp.hypot(row, col)[..., 0] < jnp.hypot(fixed.robot.length_m, fixed.robot.width_m) / 2 + CELL_M
    state = state.replace(grid=Grid(blank, turns.astype(jnp.int32)))
    state = _counted(fixed, state)
    return state, _report(fixed, state)


@functools.partial(jax.jit, donate_argnums=1)
@pinned_draws()
def make_step(fixed: Fixed, state: LocalState, speed_m_s: Array, turn_rad_s: Array) -> tuple[LocalState, Array]:
    """Move for one step, scan, match and count the scan: `(state, report)`, see `read_report`."""
    how = fixed.building, fixed.robot, fixed.noise
    before = state.body.contacts
    body, odometry, _ = move(state.draws, *how, state.body, state.odometry, state.senses, speed_m_s, turn_rad_s)
    draws, senses = _sensed(fixed, body, state.step + 1)
    moved = between(state.odometry, odometry)
    slam = put(fixed.settings, state.slam, senses.ranges_m, moved, _scanner(), closing=False)
    state = LocalState(body, odometry, draws, senses, slam, state.grid, state.corner, state.step + 1)
    state = run_if(body.contacts > before, lambda s: _touched(fixed, s, speed_m_s, turn_rad_s), state)
    state = _counted(fixed, state)
    return state, _report(fixed, state)


def _report(fixed, state):
    body, blind = state.body, jnp.sum(jnp.isnan(state.senses.ranges_m)) > BEAMS / 2
    ahead, left = _in_frame(state)
    inside = is_occupied(state.grid, P_FREE) & (jnp.abs(left) < fixed.robot.width_m / 2)
    outline_m = (fixed.robot.length_m + CELL_M) / 2  # a wall begins up to half a cell before the centre of its cell
    rooms = [jnp.min(jnp.where(inside & (way > 0), way, jnp.inf)) - outline_m for way in (ahead, -ahead)]
    told = [body.path_m, body.contacts, body.refused, state.senses.beacon_m, blind, *rooms]
    return jnp.concatenate([state.slam.pose, body.pose, jnp.stack([jnp.float32(a) for a in told])])


def read_report(report: Array) -> Report:
    """Return the `Report` of a step."""
    values = np.asarray(report)
    path_m, contacts, refused, beacon_m, blind, *rooms = values[6:].tolist()
    return Report(values[:3], values[3:6], path_m, int(contacts), int(refused), beacon_m, bool(blind), *rooms)


def _centres(corner):
    """Return the centres of the grid's cells, rows and cols: `[SIDE, SIDE, 2]` float32, cells."""
    row, col = jnp.meshgrid(jnp.arange(SIDE), jnp.arange(SIDE), indexing="ij")
    return jnp.stack([row, col], -1) + corner + 0.5


def _in_frame(state):
    """Return the centres of the grid's cells in the robot's frame: ahead and to the left, metres."""
    row, col = jnp.moveaxis(_centres(state.corner), -1, 0)
    x, y, heading = state.slam.pose
    dx, dy = col * CELL_M - x, row * CELL_M - y
    cos, sin = jnp.cos(heading), jnp.sin(heading)
    return cos * dx + sin * dy, cos * dy - sin * dx


def _touched(fixed, state, speed, turn):
    """Count hits where the robot's outline has met something: before or behind it, or at the corners that turned."""
    ahead, left = _in_frame(state)
    length, width = fixed.robot.length_m / 2, fixed.robot.width_m / 2
    way = jnp.sign(speed) * ahead - length
    pushed = (way > 0) & (way < CELL_M) & (jnp.abs(left) < width)
    # Turning left, the front's left and the back's right corner lead.
    beside = jnp.abs(left) - width
    leads = jnp.sign(turn) * ahead * left > 0
    swept = leads & (beside > 0) & (beside < CELL_M) & (jnp.abs(ahead) > length - CELL_M) & (jnp.abs(ahead) < length)
    met = ((speed != 0) & pushed) | ((turn != 0) & swept)
    return state.replace(grid=Grid(state.grid.hits + CONTACT_HITS * met, state.grid.misses))


def _counted(fixed, state):
    """Count the scan into the grid, moved so that the robot is near its middle; its own cells are free."""
    pose = state.slam.pose
    off = jnp.floor(pose[1::-1] / CELL_M).astype(jnp.int32) - state.corner - SIDE // 2
    by = jnp.where(jnp.max(jnp.abs(off)) > SHIFT // 2, jnp.clip(off, -SHIFT, SHIFT), 0)

    def shifted(grid):
        return jax.tree.map(lambda a: lax.dynamic_slice(jnp.pad(a, SHIFT), by + SHIFT, (SIDE, SIDE)), grid)

    grid = run_if(jnp.any(by != 0), shifted, state.grid)
    state = state.replace(grid=grid, corner=state.corner + by)
    ranges, angle = state.senses.ranges_m, pose[2] + ANGLES_RAD
    reading = Reading(jnp.minimum(ranges, SCAN_RANGE_M) / CELL_M, jnp.isfinite(ranges), ~jnp.isnan(ranges))
    reading = reading._replace(distance=jnp.where(reading.speaks, reading.distance, 0.0))
    direction = jnp.stack([jnp.cos(angle), jnp.sin(angle)], -1)
    xy = pose[:2] / CELL_M - state.corner[::-1]
    extent = jnp.full(2, SIDE, jnp.int32)
    grid = fold(grid, xy, direction, reading, jnp.float32(SCAN_RANGE_M / CELL_M), extent)
    ahead, left = _in_frame(state)
    own = (jnp.abs(ahead) < fixed.robot.length_m / 2 - CELL_M / 2) & (
        jnp.abs(left) < fixed.robot.width_m / 2 - CELL_M / 2
    )
    return state.replace(grid=Grid(jnp.where(own, 0, grid.hits), grid.misses + own))


class Window(NamedTuple):
    """The grid as the host sees it; the outermost cells count as unknown."""

    corner: np.ndarray  # [2] int, row and col of cell (0, 0), cells of the odometry frame
    occupied: np.ndarray  # [SIDE, SIDE] bool
    known: np.ndarray  # [SIDE, SIDE] bool

    def cell(self, xy: np.ndarray) -> np.ndarray:
        """Return the cells, row and col, of points `[..., 2]`, metres; outside of the window they are out of range."""
        return np.floor(np.asarray(xy)[..., ::-1] / CELL_M).astype(int) - self.corner

    def xy(self, cell: np.ndarray) -> np.ndarray:
        """Return the centres, metres, of cells `[..., 2]`, row and col."""
        return (np.asarray(cell, float) + self.corner + 0.5)[..., ::-1] * CELL_M


def window_of(state: LocalState) -> Window:
    """Return the `Window` of a state."""
    hits, misses, corner = (np.asarray(a) for a in (state.grid.hits, state.grid.misses, state.corner))
    known = np.zeros((SIDE, SIDE), bool)
    known[1:-1, 1:-1] = (hits + misses > 0)[1:-1, 1:-1]
    return Window(corner, (hits > P_FREE * (hits + misses)) & known, known)
