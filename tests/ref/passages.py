"""Passages that meet: every kind of divergence, with its geometry."""

import math

import jax.numpy as jnp
import numpy as np

from jexplore.driving.building import walls

WIDTHS_M = (1.2, 2.0, 2.4)
CELL_M = 0.1
ARM_M = 6.0
SLOTS = 32
EAST, NORTH, WEST, SOUTH = 0.0, math.pi / 2, math.pi, -math.pi / 2

# Where the circle's centre lies and how large it is, in widths from the crossing of the axes, coming from the west; and
# the ways out.
CORNER = 0.5 - 1 / (1 + math.sqrt(0.5))  # 0.586 widths from both outer walls
FEATURES = {
    "dead end": ("w", (0, 0), 0.5, [WEST]),
    "left corner": ("wn", (CORNER, -CORNER), 0.5 - CORNER, [WEST, NORTH]),
    "right corner": ("ws", (CORNER, CORNER), 0.5 - CORNER, [SOUTH, WEST]),
    "T from the stem": ("wns", (-1 / 8, 0), 5 / 8, [SOUTH, NORTH, WEST]),
    "T from the side, left": ("wen", (0, 1 / 8), 5 / 8, [EAST, NORTH, WEST]),
    "T from the side, right": ("wes", (0, -1 / 8), 5 / 8, [SOUTH, EAST, WEST]),
    "crossing": ("wesn", (0, 0), math.sqrt(0.5), [SOUTH, EAST, NORTH, WEST]),
}


def building(arms, width_m):
    """Passages of a width from a crossing outwards: `(walls, crossing of the axes)`."""
    n, arm = round(width_m / CELL_M), round(ARM_M / CELL_M)
    size = 2 * arm + n
    occupied = np.ones((size, size), bool)
    mid, low, high = slice(arm, arm + n), slice(1, arm + n), slice(arm, size - 1)
    ways = {"w": (mid, low), "e": (mid, high), "s": (low, mid), "n": (high, mid)}
    for arm_to in arms:
        occupied[ways[arm_to]] = False
    middle = size * CELL_M / 2
    return walls.walls_of(occupied, CELL_M, multiple=SLOTS), np.array([middle, middle])


def wall(x, y):
    """Points every 5 cm from `(x[0], y[0])` to `(x[1], y[1])`: `[n, 2]`."""
    n = round(math.hypot(x[1] - x[0], y[1] - y[0]) / 0.05) + 1
    return np.stack([np.linspace(*x, n), np.linspace(*y, n)], axis=1)


def cast(walls_, pose, angles_rad, max_range_m):
    """Ranges of beams from a pose to the nearest wall, in directions relative to its heading; inf beyond the range."""
    x, y, heading = pose
    angle = heading + angles_rad
    return walls.cast_along(walls_, x, y, jnp.cos(angle), jnp.sin(angle), max_range_m)
