"""Motion of a robot that takes itself to be where its estimate says, through the world as it is."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jexplore.arrays.loops import pick
from jexplore.arrays.poses import rotated, wrapped
from jexplore.engine.program import Given
from jexplore.exploration.sensing import stacked
from jexplore.exploration.state import State, Stream
from jexplore.exploration.uncertain.poses import EIGHTH, cell_of, rounded
from jexplore.grid import Grid
from jexplore.reach import HEADING, MOTIONS
from jexplore.slam2d.odometry import corrected, encoded, spread

PARTS = 8  # of a step, after each of which the robot sees whether it is in a wall
MOST_CELLS = 2.5  # of a step: from a corner of where a robot stays in its cell to the middle of the next one
MAPS = ("seen", "trail", "mapping", "key_of")  # of `Poses`, what no motion changes
AHEAD = np.array([MOTIONS[HEADING.index(k)][::-1] for k in range(8)], np.float32)  # x, y of each heading's next cell


def turn_and_go(given: Given, state: State, heading: Array, goes: Array, when: Array) -> tuple[State, Array]:
    """Turn, and go on to the centre of the next cell.

    The robot steers by its estimate. It turns and goes by as much as it wants to, but for slip, and reads from its
    encoders what it has done. A wall of the true world stops it before its centre enters it.

    Args:
      heading: int32, heading of the lattice towards the next cell; that to turn to where it does not go.
      goes: bool, whether it goes.
      when: bool; False: nothing happens.

    Returns:
      `(state, bumped)`: its pose, true and estimated, moved.
    """
    poses, belief, own = state.poses, state.belief, given.numbers.unsure
    noise, cell_m = own.odometry, belief.model.cell_m
    draws = jax.random.normal(jax.random.fold_in(jax.random.fold_in(given.key, Stream.ODOMETRY), poses.motions), (4,))
    ahead = jnp.asarray(AHEAD)[heading]
    dcol, drow = ahead.astype(jnp.int32) * goes
    centre = jnp.stack([belief.col + dcol, belief.row + drow]) + 0.5
    wanted = jnp.where(goes, centre - poses.estimate[:2], 0)
    wanted *= jnp.minimum(1, MOST_CELLS / jnp.maximum(jnp.hypot(wanted[0], wanted[1]), 1))
    aside = jnp.arctan2(ahead[0] * wanted[1] - ahead[1] * wanted[0], jnp.sum(ahead * wanted))
    turn = wrapped((heading - state.heading) * EIGHTH + aside - poses.estimate[2])
    way = jnp.hypot(wanted[0], wanted[1])
    told_m, told_turn = encoded(noise, way * cell_m, turn, way * cell_m, draws)
    told_m, told_turn = corrected(noise, poses.errors, told_m, told_turn, way * cell_m)

    true_turn = poses.true[2] - poses.estimate[2] + aside - noise.slip * turn
    driven = rotated(wanted, true_turn - aside)
    share = _share_driven(given, poses.true[:2], driven)
    off = aside + told_turn - turn
    told = rotated(wanted, told_turn - turn) * (told_m / jnp.maximum(way * cell_m, 1e-9))
    told = jnp.where(way > 0, told, rotated(jnp.float32([1, 0]), heading * EIGHTH + off) * told_m / cell_m)
    errors, covariance = spread(noise, poses.errors, poses.covariance, told * cell_m, told_turn)
    told *= share  # the heading errs as on the whole way

    moved = poses.replace(
        true=jnp.append(poses.true[:2] + driven * share, true_turn),
        estimate=jnp.append(poses.estimate[:2] + told, off),
        covariance=covariance,
        errors=errors,
        way_m=poses.way_m + way * share * cell_m,
        motions=poses.motions + 1,
        bumps=poses.bumps + (share < 1),
    )
    new_heading, moved = rounded(heading, moved)
    arrived = share == 1  # else it is taken to be where it was, and not in the wall that it has met
    row, col = belief.row + drow * arrived, belief.col + dcol * arrived
    at_row, at_col = cell_of(moved.estimate, row, col, belief.extent)
    moved = moved.replace(strayed=(at_row != row) | (at_col != col))
    cell = jnp.floor(moved.true[:2]).astype(jnp.int32)
    new = state.replace(
        row=cell[1],
        col=cell[0],
        heading=new_heading,
        poses=moved,
        belief=belief.replace(row=at_row, col=at_col, heading=new_heading),
    )
    return _pick_pose(when, new, state), when & (share < 1)


def _share_driven(given: Given, xy: Array, driven: Array) -> Array:
    """Return the share of a step until a wall of the true world ends it: float32, 1 without one."""
    parts = (jnp.arange(PARTS) + 1.0) / PARTS
    at = jnp.floor(xy + driven * parts[:, None]).astype(jnp.int32)
    occupied, base = stacked(given, jnp.asarray(given.scenes.occupied))
    walls = occupied[base + at[:, 1], at[:, 0]]
    return jnp.sum(jnp.cumsum(walls) == 0) / PARTS


def _pick_pose(when: Array, new: State, old: State) -> State:
    """Return the state with the pose of one of two, whose maps are the same."""

    def own(state: State) -> Any:
        poses, belief = state.poses.replace(**dict.fromkeys(MAPS)), state.belief
        return poses, (state.row, state.col, state.heading, belief.row, belief.col, belief.heading)

    poses, (row, col, heading, own_row, own_col, own_heading) = pick(when, own(new), own(old))
    poses = poses.replace(**{name: getattr(old.poses, name) for name in MAPS})
    belief = old.belief.replace(row=own_row, col=own_col, heading=own_heading)
    return old.replace(row=row, col=col, heading=heading, poses=poses, belief=belief)


def mark_bump(state: State, row: Array, col: Array, when: Array) -> State:
    """Make a cell of the robot's map count as a wall that it has met, `when`: as a hit for every miss, and not driven.

    Less would leave a cell that beams have passed often free, and the next plan would lead there again.
    """
    belief = state.belief
    misses, hits = belief.grid.misses[row, col], belief.grid.hits[row, col]
    grid = Grid(
        belief.grid.hits.at[row, col].add(jnp.where(when, jnp.maximum(misses - hits, 1), 0)), belief.grid.misses
    )
    driven = belief.driven.at[row, col].set(belief.driven[row, col] & ~when)
    return state.replace(belief=belief.replace(grid=grid, driven=driven))
