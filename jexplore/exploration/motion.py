"""Kinematics of the robot that walks from cell to cell: motions, headings, turns.

Headings are int32 in units of 45 degrees, counter-clockwise, 0 along +x (east).
"""

from typing import Any

import jax.numpy as jnp
from jax import Array

from jexplore.reach import HEADING, MOTIONS

EIGHTH_TURN_RAD = 0.7853981633974483


def motion_step(motion: Any) -> tuple[Array, Array, Array]:
    """Return displacement and heading of a motion, index into `reach.MOTIONS`: `(drow, dcol, heading)`, int32."""
    table = jnp.asarray([(drow, dcol, heading) for (drow, dcol), heading in zip(MOTIONS, HEADING)], jnp.int32)
    step = table[motion]
    return step[..., 0], step[..., 1], step[..., 2]


def turn_between(heading: Any, new_heading: Any) -> Array:
    """Return the smaller turn from one heading to another, in units of 45 degrees: int32, 0 to 4."""
    turn = (new_heading - heading) % 8
    return jnp.minimum(turn, 8 - turn)
