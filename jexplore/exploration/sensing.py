"""Sensing: a scan at the robot's true pose, counted into its map at the estimated pose."""

import jax
import jax.numpy as jnp
from jax import Array, lax

from jexplore.arrays.loops import one_kernel
from jexplore.engine.program import Given
from jexplore.exploration.state import Setup, State, Stream
from jexplore.grid import Grid, is_known
from jexplore.raycast import Scan, disturb, fold, scan


def stacked(given: Given, maps: Array) -> tuple[Array, Array]:
    """Stack maps of all worlds, and return the row where the run's own begins: `([M * H, W], int32)`."""
    return maps.reshape(-1, maps.shape[-1]), given.scene * maps.shape[-2]


def known_cells(grid: Grid, within: Array | None = None) -> Array:
    """Count the known cells that count: those of the goal. int32.

    Args:
      grid: `Grid`.
      within: `[H, W]` bool, the cells that count; None: all.
    """
    maps = grid if within is None else (grid, within)

    def run(maps):
        def add(i, so_far):
            row = jax.tree.map(lambda a: lax.dynamic_index_in_dim(a, i, keepdims=False), maps)
            return so_far + (is_known(row) if within is None else is_known(row[0]) & row[1])

        none = jnp.zeros(grid.hits.shape[1], jnp.int32)
        return jnp.sum(lax.fori_loop(0, grid.hits.shape[0], add, none), dtype=jnp.int32)

    # In one piece: as operations of their own, which store the map between them, it took nearly twice the time.
    return one_kernel(run, maps)


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
    grid = fold(belief.grid, belief.row, belief.col, belief.heading, seen, beams, when=when)
    known = known_cells(grid, belief.within)
    return state.replace(belief=belief.replace(grid=grid), scans=state.scans + when, known=known)
