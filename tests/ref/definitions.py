"""Definitions on whole arrays, one at a time, of what the kernels make packed, in one go, or only along a route."""

import jax
import jax.numpy as jnp

from jexplore.frontier import disc
from jexplore.grid import any_within_one, beside, bordered, is_known
from jexplore.planning.readout import _enterable, _last_motion
from jexplore.reach import FAR


def traversable_cells(clear, free, driven, row, col, near_d2):
    """Cells that a path may use, `[H, W]`: clear ones, free ones near the robot, and the way that it has driven."""
    return clear | (free & disc(clear.shape, row, col, near_d2)) | driven


def frontier_cells(clear, grid, inside):
    """Clear cells that are 8-adjacent to an unknown cell, `[H, W]`; padding is outside and never unknown."""
    return clear & any_within_one(~is_known(grid) & inside)


@jax.jit
def predecessors(cost, traversable):
    """The last motion of the shortest path to every cell, `[H, W]` int8, of several the first; -1: none."""
    b, t = bordered(cost, FAR), bordered(traversable, False)
    around = [[beside(a, drow, dcol) for drow in (-1, 0, 1) for dcol in (-1, 0, 1)] for a in (b, t)]
    cost, traversable = (jnp.stack(a).reshape(3, 3, *cost.shape) for a in around)
    return _last_motion(cost, _enterable(traversable))
