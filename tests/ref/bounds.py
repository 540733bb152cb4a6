"""The shortest walk that sees everything, by brute force: Dijkstra over the robot's cell and what it has seen."""

import heapq
import itertools
import warnings

import jax
import jax.numpy as jnp
import numpy as np

import jexplore as jx
from jexplore.arrays import bits
from jexplore.config import InputWarning
from jexplore.grid import empty_grid, is_known
from jexplore.raycast import beam_table, fold, scan

from . import plans

HEADINGS = range(8)


def seen_all_round(occupied, lidar, cell_m):
    """`look(row, col, headings)`: what scans with these headings see, `[H, W]` bool, by the episode's own kernels."""
    beams = jax.tree.map(jnp.asarray, beam_table(lidar, cell_m, occupied.shape[1]))
    walls = jnp.asarray(occupied)

    @jax.jit
    def one(row, col, heading):
        seen = scan(walls, row, col, heading, beams)
        return is_known(fold(empty_grid(walls.shape), row, col, heading, seen, beams))

    def look(row, col, headings=HEADINGS):
        return np.any([np.asarray(one(row, col, heading)) for heading in headings], axis=0)

    return look


def begun(world, start, lidar, rules):
    """Return the cells to see, and those seen at the start, by an episode's own state: two `[H, W]` bool."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)  # random worlds have floor apart
        env = jx.Environment(world, lidar=lidar, rules=rules)
    state, _ = env.reset(jax.random.key(0), jnp.asarray(start, jnp.int32))
    height, width = world.shape
    goal = np.asarray(bits.unpack(state.episode.goal))[:height, :width]
    return goal, np.asarray(is_known(state.episode.belief.grid))[:height, :width]


def neighbours(stand, cell):
    """Cells that one motion leads to, and what it costs."""
    for motion in plans.MOTIONS:
        if plans.may_step(stand, *cell, motion):
            yield (cell[0] + motion[0], cell[1] + motion[1]), plans.step_cost(motion)


def shortest(stand, start, left, look):
    """Cost of the shortest walk from a cell over others, after which nothing is left to be seen."""
    place = {cell: i for i, cell in enumerate(map(tuple, np.argwhere(left).tolist()))}
    sees = {}

    def bits_of(cell):
        if cell not in sees:
            known = look(*cell)
            sees[cell] = sum(1 << i for other, i in place.items() if known[other])
        return sees[cell]

    whole, first = (1 << len(place)) - 1, bits_of(start)
    best, tie = {(start, first): 0}, itertools.count()
    queue = [(0, next(tie), start, first)]
    while queue:
        cost, _, cell, have = heapq.heappop(queue)
        if best[cell, have] < cost:
            continue
        if have == whole:
            return cost
        for other, step in neighbours(stand, cell):
            key = other, have | bits_of(other)
            if cost + step < best.get(key, 1 << 40):
                best[key] = cost + step
                heapq.heappush(queue, (cost + step, next(tie), *key))
    return None
