"""Sensing: a scan at the robot's true pose, counted into its map at the estimated pose.

Known cells are counted as they come to be known.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jexplore.arrays.loops import one_kernel, run_if
from jexplore.engine.program import Given
from jexplore.exploration.state import Setup, State, Stream
from jexplore.grid import Grid, count, is_known
from jexplore.planning import Belief
from jexplore.raycast import Scan, disturb, fold, scan

STRIDE = 16  # cells by which the square moves in which known cells are counted


def stacked(given: Given, maps: Array) -> tuple[Array, Array]:
    """Stack maps of all worlds, and return the row where the run's own begins: `([M * H, W], int32)`."""
    return maps.reshape(-1, maps.shape[-1]), given.scene * maps.shape[-2]


def square(row: Any, col: Any, shape: tuple[int, ...], window: int) -> tuple[Array, tuple[int, ...]]:
    """Return corner and shape of a square that holds every cell that a scan can change: `((row, col), (h, w))`.

    It moves by `STRIDE` cells at a time, so that its known cells need not be counted anew for every scan.
    """
    size = tuple(min(n, 2 * window + STRIDE) for n in shape)
    corner = [jnp.clip((at - window) // STRIDE * STRIDE, 0, n - m) for at, n, m in zip((row, col), shape, size)]
    return jnp.stack(corner), size


class Square(NamedTuple):
    """A square round the robot: known cells outside it need not be counted for every scan."""

    corner: Array  # [2] int32, row and col
    outside: Array  # int32, known cells outside


def first_tally(setup: Setup, belief: Belief, *, is_blank: bool) -> tuple[Square, Array]:
    """Return known cells of a belief before its first scan, and the tally for counting from then on.

    Args:
      setup: as for `sense`.
      belief: `Belief`.
      is_blank: whether nothing is known. Static.

    Returns:
      `(tally, known)`: `Square`; int32.
    """
    shape, none = belief.driven.shape, jnp.int32(0)
    corner, size = square(belief.row, belief.col, shape, setup.window)
    if is_blank:
        return Square(corner, none), none
    known = count(_counted(belief.grid, belief.within))
    return Square(corner, known - known_in(belief.grid, corner, size, belief.within)), known


def uncounted(state: State) -> State:
    """Mark a `State` whose map is about to change otherwise than by `sense`, which then counts known cells anew."""
    return state.replace(tally=Square(jnp.full(2, -1, jnp.int32), jnp.int32(0)))


def _counted(grid, within):
    """Return the known cells that count: those of the goal."""
    return is_known(grid) if within is None else is_known(grid) & within


def known_in(grid: Grid, corner: Array, size: tuple[int, ...], within: Array | None = None) -> Array:
    """Return known cells in a square.

    Args:
      grid: `Grid`.
      corner: `[2]` int32, row and col where it begins.
      size: its height and width, inside the map. Static.
      within: `[H, W]` bool, the cells that count; None: all.

    Returns:
      int32.
    """
    if within is not None:
        grid, within = jax.tree.map(lambda a: lax.dynamic_slice(a, corner, size), (grid, within))
        return count(_counted(grid, within))

    def run(hits, misses, row, col):
        def add(i, so_far):
            here = (lax.dynamic_slice(a, (row + i, col), (1, size[1])) for a in (hits, misses))
            return so_far + is_known(Grid(*here))

        return jnp.sum(lax.fori_loop(0, size[0], add, jnp.zeros((1, size[1]), jnp.int32)), dtype=jnp.int32)

    # In one piece: as operations of their own, which store the square between them, it took nearly twice the time.
    return one_kernel(run, grid.hits, grid.misses, corner[0], corner[1])


def without_silent(seen: Scan, blind: Array, no_echo_is_free: Array | bool) -> Scan:
    """Silence the beams of a scan that say nothing: those stopped too near, and maybe those that nothing stopped.

    Args:
      seen: `Scan`, `[B]`.
      blind: `[B]` int32, steps at which a beam that is stopped says nothing.
      no_echo_is_free: bool scalar, whether a beam that nothing stopped shows its cells to be free.

    Returns:
      `Scan`, `[B]`: a silent beam has passed no cell and hit none.
    """
    hit = seen.hit & (seen.end >= blind)
    speaks = hit | (~seen.hit & no_echo_is_free)
    return Scan(end=jnp.where(speaks, seen.end, 0), hit=hit)


def _told(setup, state, seen, beams, when):
    """Count a scan into the map: `(grid, tally, known)`."""
    belief = state.belief
    corner, size = square(belief.row, belief.col, state.shape, setup.window)
    # Known cells outside the square, counted before the update. The number is added where it changes nothing (it is
    # never negative), so that it is made first, and the update can then be made in place.
    moved = jnp.any(corner != state.tally.corner)

    def recounted(_):
        return state.known - known_in(belief.grid, corner, size, belief.within)

    outside = run_if(moved, recounted, state.tally.outside)
    pose = belief.row + jnp.minimum(outside, 0), belief.col, belief.heading
    grid = fold(belief.grid, *pose, seen, beams, when=when)
    return grid, Square(corner, outside), outside + known_in(grid, corner, size, belief.within)


def sense(setup: Setup, given: Given, state: State, when: Array) -> State:
    """Make one scan at the true pose and count it into the map at the estimated pose, if `when`.

    Args:
      setup: `Setup`. Static.
      given: as for `environment.begin`.
      state: `State`.
      when: bool scalar, False: do nothing.

    Returns:
      `State`.
    """
    belief, beams, occupied, base = state.belief, given.shared, *stacked(given, given.scenes.occupied)
    seen = scan(occupied, base + state.row, state.col, state.heading, beams)
    blind = lax.dynamic_index_in_dim(beams.blind, state.heading, keepdims=False)
    seen = without_silent(seen, blind, True)
    if setup.noisy:
        key = jax.random.fold_in(jax.random.fold_in(given.key, Stream.SENSOR), state.scans)
        noise = {"sigma_cells": given.numbers.sigma_cells, "dropout": given.numbers.dropout}
        seen = disturb(key, seen, state.row, state.col, state.heading, beams, belief.extent, **noise)
    seen = without_silent(seen, blind, given.numbers.no_echo_is_free)
    grid, tally, known = _told(setup, state, seen, beams, when)
    state = state.replace(tally=tally, scans=state.scans + when, known=known)
    return state.replace(belief=belief.replace(grid=grid))
