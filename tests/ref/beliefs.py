"""Beliefs for tests of strategies: drawn by hand, or what a robot would know after some scans."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from jexplore.grid import Grid
from jexplore.planning import Belief, MapModel
from jexplore.policies import parse_strategy
from jexplore.raycast import beam_table
from jexplore.rules import Lidar

from . import beams, maps, plans

LIDAR = Lidar(n_beams=19, range_m=0.5)
ONE_METRE = {"cell_m": 1.0}
CROSS = Lidar(n_beams=4, fov_deg=360, range_m=4.0)  # in cells of one metre: four cells back, right, ahead, left
STAR = Lidar(n_beams=8, fov_deg=360, range_m=1.5)  # the eight cells around

# One step to the left a frontier that shows 1 cell, six to the right one that shows 3; known cells 5 from either.
CORRIDOR = """
    ##############
    #?.R......???#
    ##############
"""
NEAR, FAR_OFF = (1, 2), (1, 9)

# Three unknown niches. The frontier at each is three cells wide; the nearest of them stands for all.
NICHES = """
    ##################
    ##?#######?###?###
    #......R.........#
    ##################
"""


def belief_from(hits, misses, robot, *, extent=None, cell_m=0.1, **kernels):
    """A `Belief` of two arrays of counts, of a robot at `(row, col)` that has driven nowhere yet."""
    shape = hits.shape
    return Belief(
        grid=Grid(jnp.asarray(hits, jnp.int32), jnp.asarray(misses, jnp.int32)),
        driven=jnp.zeros(shape, bool).at[robot].set(True),
        exhausted=jnp.zeros(shape, bool),
        row=jnp.int32(robot[0]),
        col=jnp.int32(robot[1]),
        heading=jnp.int32(0),
        start=jnp.asarray([*robot, 0], jnp.int32),
        extent=jnp.asarray(extent or shape, jnp.int32),
        model=MapModel(
            p_free=jnp.float32(0.25),
            near_d2=jnp.int32(0),
            cell_m=jnp.float32(cell_m),
            **({"clearance_d2": 0} | kernels),
        ),
    )


def belief_of(text, grow=(0, 0), **how):
    """A `Belief` of a drawn map: `.` free, `#` occupied, `?` unknown, `R` the robot; padded by `grow`."""
    cells = np.pad(maps.drawn(text), [(0, n) for n in grow], constant_values=" ")
    (robot,) = map(tuple, np.argwhere(cells == "R"))
    free = (cells == ".") | (cells == "R")
    return belief_from(cells == "#", free, robot, extent=maps.drawn(text).shape, **how)


def after_scans(seed, shape, *, n_scans=4, range_cells=9, n_beams=72, mixed=0.0, grow=(0, 0), **how):
    """A `Belief` of a cluttered world after scans all round from some cells, the robot at the last of them.

    `mixed`: the share of known cells in which beams have disagreed.
    """
    occupied, _ = maps.cluttered(seed, *shape)
    draw = np.random.default_rng(seed)
    cells = np.argwhere(~occupied)
    hits, misses = np.zeros(shape, int), np.zeros(shape, int)
    for robot in map(tuple, draw.choice(cells, n_scans)):
        beams.fold(hits, misses, *robot, beams.scan(occupied, *robot, 0, n_beams, 360, range_cells))
    odd = (hits + misses > 0) & (draw.random(shape) < mixed)
    odd[robot] = False
    hits, misses = hits + odd, misses + 4 * (odd & (hits == 0)) + (odd & (hits > 0))
    hits, misses = (np.pad(a, [(0, n) for n in grow]) for a in (hits, misses))
    return belief_from(hits, misses, robot, extent=shape, **how)


def but_for_spots(seed, shape, *, clearance_d2=0, **how):
    """A `Belief` of a cluttered world that is known but for six spots of 3 x 3 cells, the robot where it is clear."""
    occupied, _ = maps.cluttered(seed, *shape)
    draw = np.random.default_rng(seed)
    known = np.ones(shape, bool)
    for row, col in draw.integers(3, np.subtract(shape, 3), (6, 2)):
        known[row - 1 : row + 2, col - 1 : col + 2] = False
    free = known & ~occupied
    robot = draw.choice(np.argwhere(plans.clear(free, occupied & known, clearance_d2)))
    return belief_from(occupied & known, free, tuple(robot), clearance_d2=clearance_d2, **how)


def table(lidar, belief):
    """`Beams` for the maps of a belief."""
    return jax.device_put(beam_table(lidar, float(belief.model.cell_m), belief.driven.shape[1]))


def choice_of(name, key, belief, lidar=LIDAR):
    """`(carry, choice, route)` of a strategy in a belief of cells of 0.1 m."""
    policy = parse_strategy(name).policy
    carry = policy.init(policy.params, belief)
    beams = jax.device_put(beam_table(lidar, 0.1, belief.driven.shape[1]))
    route = jnp.full(belief.driven.shape, -1, jnp.int8)
    return policy.select(key, policy.params, carry, belief, beams, route)


@functools.partial(jax.jit, static_argnames=("select",))
def selected(select, key, params, belief, beams):
    """The `Choice` of a strategy without a carry: one program for all parameters of a strategy."""
    return select(key, params, (), belief, beams, jnp.full(belief.driven.shape, -1, jnp.int8))[1]


def target_of(name, belief, lidar, seed=0):
    """`(row, col)` of what a strategy chooses."""
    policy = parse_strategy(name).policy
    choice = selected(policy.select, jax.random.key(seed), policy.params, belief, table(lidar, belief))
    return int(choice.row), int(choice.col)
