"""The last motion to every cell, which the kernels make along a route only."""

import jax
import jax.numpy as jnp

from jexplore.grid import beside, bordered
from jexplore.planning.readout import _enterable, _last_motion
from jexplore.reach import FAR


@jax.jit
def predecessors(cost, traversable):
    """The last motion of the shortest path to every cell, `[H, W]` int8, of several the first; -1: none."""
    b, t = bordered(cost, FAR), bordered(traversable, False)
    around = [[beside(a, drow, dcol) for drow in (-1, 0, 1) for dcol in (-1, 0, 1)] for a in (b, t)]
    cost, traversable = (jnp.stack(a).reshape(3, 3, *cost.shape) for a in around)
    return _last_motion(cost, _enterable(traversable))
