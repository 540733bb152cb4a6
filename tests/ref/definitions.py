"""Definitions on whole arrays, one at a time, of what the kernels make packed, in one go, or only along a route."""

import jax
import jax.numpy as jnp

from jexplore.frontier import disc
from jexplore.grid import any_within_one, beside, bordered, is_known
from jexplore.planning.readout import _enterable, _last_motion
from jexplore.reach import FAR


def traversable_cells(clear, free, driven, row, col, near_d2):
    """Cells that a path may use: clear ones, free ones near the robot, and the way that the robot has driven.

    Without the last two, walls that are seen late close the way behind the robot.

    Args:
      clear, free, driven: `[H, W]` bool.
      row, col: int32, the robot's cell; may lie outside the arrays when these are a window.
      near_d2: squared distance, cells^2; scalar.

    Returns:
      `[H, W]` bool.
    """
    return clear | (free & disc(clear.shape, row, col, near_d2)) | driven


def frontier_cells(clear, grid, inside):
    """Clear cells that are 8-adjacent to an unknown cell; whether a path leads there is not asked here.

    Args:
      clear: `[H, W]` bool.
      grid: `Grid`, `[H, W]`.
      inside: `[H, W]` bool, False in padding: what lies outside the map is never unknown.

    Returns:
      `[H, W]` bool.

    Source:
      Holz et al. 2010, equation 2. Changed: unknown is "never observed", not p = 0.5.
    """
    return clear & any_within_one(~is_known(grid) & inside)


@jax.jit
def predecessors(cost, traversable):
    """The last motion of the shortest path to every cell.

    Among several that cost the same, the first in the order of `MOTIONS`: E, N, W, S, NE, NW, SW, SE.

    Args:
      cost: `[H, W]` int32, from `reach`.
      traversable: `[H, W]` bool, what `cost` was made from.

    Returns:
      `[H, W]` int8, index into `MOTIONS`; -1 at the start and where no path leads.

    Source:
      Holz et al. 2010, section 2.2.
    """
    b, t = bordered(cost, FAR), bordered(traversable, False)
    around = [[beside(a, drow, dcol) for drow in (-1, 0, 1) for dcol in (-1, 0, 1)] for a in (b, t)]
    cost, traversable = (jnp.stack(a).reshape(3, 3, *cost.shape) for a in around)
    return _last_motion(cost, _enterable(traversable))
