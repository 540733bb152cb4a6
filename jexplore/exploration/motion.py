"""Kinematics of the robot that walks from cell to cell: motions, headings, turns, and how long they take.

Headings are int32 in units of 45 degrees, counter-clockwise, 0 along +x (east). Times are whole milliseconds, looked up
in a table that the host makes. A run is a number of steps in one direction between two stops. The robot speeds up and
brakes evenly, and stops where it turns, looks, or is refused a step; it scans on its way without stopping. A plan that
goes on in the same direction costs no stop, unless planning takes time.
"""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from jexplore.reach import HEADING, MOTIONS
from jexplore.rules import Robot

EIGHTH_TURN_RAD = 0.7853981633974483
SCAN, PLAN, TURN, RUN = 0, 1, 2, 7
"""Places in a table: ms of a scan in place and of a plan; of turns of 0 to 4 eighths; then three entries for every
number of steps and for straight and diagonal ones: ms from standing to the last cell without braking, ms until it
stands there, and thousandths of the kinetic energy at full speed that it had at most."""
STEP = RUN + 7
"""Place of the ms of one straight step from standing to standing."""
LENGTHS = 408, 577
"""Lengths of a straight and a diagonal step of which limits of the path count the sum: their ratio is the root of 2 to
two millionths."""
MOST_MS = 2**30
"""Clocks stand still there, after 12 days."""
_MOST_ENTRY_MS = 2**27  # of the five that a motion adds at most, the sum with a clock fits int32


def motion_step(motion: Any) -> tuple[Array, Array, Array]:
    """Return displacement and heading of a motion, index into `reach.MOTIONS`: `(drow, dcol, heading)`, int32."""
    table = jnp.asarray([(drow, dcol, heading) for (drow, dcol), heading in zip(MOTIONS, HEADING)], jnp.int32)
    step = table[motion]
    return step[..., 0], step[..., 1], step[..., 2]


def turn_between(heading: Any, new_heading: Any) -> Array:
    """Return the smaller turn from one heading to another, in units of 45 degrees: int32, 0 to 4."""
    turn = (new_heading - heading) % 8
    return jnp.minimum(turn, 8 - turn)


def _profile_s(way: Any, speed: float, acceleration: float) -> tuple[Any, Any]:
    """Return the seconds to the end of a way from standing, without braking and with: `(reached, stopped)`."""
    short, shorter = way < speed**2 / (2 * acceleration), way < speed**2 / acceleration
    reached = np.where(short, np.sqrt(2 * way / acceleration), way / speed + speed / (2 * acceleration) * (way > 0))
    stopped = np.where(shorter, 2 * np.sqrt(way / acceleration), way / speed + speed / acceleration * (way > 0))
    return reached, stopped


def clock_table(robot: Robot, cell_m: float, longest: int) -> np.ndarray:
    """Return the table of a robot for runs of up to `longest` steps: `[7 + 6 (longest + 1)]` int32, see `SCAN`."""
    ways_m = np.arange(longest + 1)[:, None] * cell_m * np.array([1, math.sqrt(2)])
    reached, stopped = _profile_s(ways_m, robot.speed_m_s, robot.acceleration_m_s2)
    _, turned = _profile_s(np.arange(5) * EIGHTH_TURN_RAD, robot.turn_rad_s, robot.turn_acceleration_rad_s2)
    share = np.minimum(1.0, robot.acceleration_m_s2 * ways_m / robot.speed_m_s**2)
    own = [robot.scan_s, robot.plan_s, *turned, *np.stack([reached, stopped, share], axis=-1).ravel()]
    return np.rint(np.minimum(1000.0 * np.array(own), _MOST_ENTRY_MS)).astype(np.int32)


def _entry(table: Array, run: Array, heading: Array) -> tuple[Array, Array, Array]:
    """Return what a table says of a run in a direction."""
    at = RUN + 3 * (2 * run + heading % 2)
    return table[at], table[at + 1], table[at + 2]


def tick(
    table: Array, state: Any, heading: Array, steps: Array, waits: Array, wait_ms: Array | int
) -> dict[str, Array]:
    """Return the clock of a `State` after a motion: `time_ms`, `run`, `starts`.

    It turns to `heading`, and then makes a step, if `steps`, or stands for `wait_ms`, if `waits`.
    """
    table = jnp.asarray(table)  # numpy's while shapes are told
    reached, stopped, share = _entry(table, state.run, state.heading)
    turn = turn_between(state.heading, heading)
    stops = (turn > 0) | waits
    run = jnp.where(stops, 0, state.run)
    came = jnp.where(stops, 0, reached)
    more = jnp.where(stops, stopped - reached, 0) + table[TURN + turn] + jnp.where(waits, wait_ms, 0)
    more += jnp.where(steps, _entry(table, run + 1, heading)[0] - came, 0)
    return {
        "time_ms": jnp.minimum(state.time_ms + more, MOST_MS),
        "run": run + steps,
        "starts": jnp.minimum(state.starts + jnp.where(stops, share, 0), MOST_MS),
    }
