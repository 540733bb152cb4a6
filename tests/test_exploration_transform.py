"""Exploration transform: by hand, and compared with Dijkstra's algorithm."""

import heapq

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref import beliefs

from jexplore.planning import field
from jexplore.policies.peers.exploration_transform import STEPS, Params, descent, transform
from jexplore.reach import FAR, MOTIONS

pytestmark = pytest.mark.jit

# A frontier 5 m to the right down the middle of a lane, another 4 m to the left in a bay one cell wide.
LANES = """
    #############
    #####......##
    ?...R.....?##
    #####......##
    #############
"""
LEFT, RIGHT = (2, 1), (2, 9)


def test_safe_way_is_taken_before_a_short_one():
    """To the left 3 m and two cells of danger 1, to the right 5 m and one of (2 - sqrt 2)^2: the same at 1.21."""
    belief = beliefs.belief_of(LANES, cell_m=1.0)
    for text, want in {"weight=0": LEFT, "weight=1.2,safe_m=2": LEFT, "weight=1.22,safe_m=2": RIGHT}.items():
        assert beliefs.target_of(f"exploration-transform:{text}", belief, beliefs.LIDAR) == want


def dijkstra(traversable, frontier, danger):
    """The transform, cell by cell."""
    value = np.where(frontier & traversable, 0, FAR)
    queue = [(0, *at) for at in map(tuple, np.argwhere(value == 0))]
    while queue:
        cost, row, col = heapq.heappop(queue)
        for drow, dcol in MOTIONS:
            r, c = row + drow, col + dcol
            inside = 0 <= r < value.shape[0] and 0 <= c < value.shape[1]
            if inside and traversable[r, c] and traversable[row, c] and traversable[r, col]:
                new = cost + STEPS[bool(drow and dcol)] + danger[r, c]
                if cost <= value[row, col] and new < value[r, c]:
                    value[r, c] = new
                    heapq.heappush(queue, (new, r, c))
    return value


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_transform_and_its_descent(seed):
    belief = beliefs.but_for_spots(seed, (21, 40))
    reached = field(belief)
    params = Params(jnp.float32(90.0), jnp.float32(0.35))
    value = np.asarray(jax.jit(transform)(params, belief, reached))
    occupied = np.argwhere(np.asarray(belief.grid.hits) > 0)
    cells = np.moveaxis(np.indices(value.shape), 0, -1)[:, :, None]
    off_m = 0.1 * np.sqrt(((cells - occupied) ** 2).sum(axis=-1)).min(axis=-1)
    danger = np.rint(90.0 * np.maximum(0.35 - off_m, 0) ** 2 * STEPS[0]).astype(int)
    want = dijkstra(np.asarray(reached.traversable), np.asarray(reached.frontier), danger)
    np.testing.assert_allclose(value, want, rtol=1e-4)  # danger is rounded from float32

    row, col, motions = jax.jit(descent)(value, reached.traversable, belief.row, belief.col)
    assert reached.frontier[row, col]
    at = int(belief.row), int(belief.col)
    while at != (int(row), int(col)):
        drow, dcol = MOTIONS[motions[at]]
        after = value[at[0] + drow, at[1] + dcol] + STEPS[bool(drow and dcol)]
        assert abs(value[at] - after - danger[at]) <= 1
        at = (at[0] + drow, at[1] + dcol)
