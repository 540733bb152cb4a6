"""Sensing: a scan at the robot's true pose, counted into its map at the estimated pose."""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jexplore.arrays import bits
from jexplore.arrays.loops import one_kernel, stored
from jexplore.distance import within_packed
from jexplore.engine.program import Given
from jexplore.exploration.state import MARKS, NEVER, PERCENTILES, WHOLE, Setup, State, Stream
from jexplore.frontier import disc
from jexplore.grid import Grid, beside, bordered, count, empty_grid, is_known
from jexplore.planning import MapModel
from jexplore.raycast import Scan, disturb, fold, scan
from jexplore.reach import flood


def stacked(given: Given, maps: Array) -> tuple[Array, Array]:
    """Stack maps of all worlds, and return the row where the run's own begins: `([M * H, W], int32)`."""
    return maps.reshape(-1, maps.shape[-1]), given.scene * maps.shape[-2]


def own_map(given: Given, maps: Array) -> Array:
    """Return the map of the run's own world, `[H, W]`, of maps of all worlds."""
    rows, base = stacked(given, maps)
    return lax.dynamic_slice(rows, (base, jnp.int32(0)), maps.shape[1:])


def blank_grid(given: Given) -> Grid:
    """Return the map of a robot that has seen nothing yet: what it knows all the same counts as seen once."""
    truth = given.scenes
    if truth.prior is None:
        return empty_grid(truth.occupied.shape[1:])
    prior = truth.prior[given.scene]
    return Grid(hits=(prior > 0).astype(jnp.int32), misses=(prior == 0).astype(jnp.int32))


class Square(NamedTuple):
    """A part of a map."""

    row: Array  # int32, first row
    col: Array  # int32, first column
    size: tuple[int, int]  # height and width; static


def square_round(setup: Setup, row: Array, col: Array, shape: tuple[int, ...]) -> Square | None:
    """Return the `Square` that holds every cell a scan can change; None where the whole map is counted as fast."""
    height, width = shape
    size = min(height, 2 * setup.window + 1), min(width, 2 * setup.window + 1)
    if not setup.window or 2 * size[0] * size[1] >= height * width:  # it is counted before and after
        return None
    row, col = (jnp.clip(at - setup.window, 0, n - m) for at, n, m in zip((row, col), shape, size))
    return Square(row, col, size)


def known_cells(grid: Grid, within: Array | None = None, square: Square | None = None) -> Array:
    """Count the known cells that count, those `within` (`[H, W]` bool; None: all), in a square or everywhere: int32."""
    row, col, (height, width) = square or (0, 0, grid.hits.shape)

    def run(maps: Any, row: Array, col: Array) -> Array:
        def add(i: Array, so_far: Array) -> Array:
            own, *more = (jax.tree.map(lambda a: lax.dynamic_slice(a, (row + i, col), (1, width)), one) for one in maps)
            return so_far + functools.reduce(jnp.logical_and, more, is_known(own))

        return jnp.sum(lax.fori_loop(0, height, add, jnp.zeros((1, width), jnp.int32)), dtype=jnp.int32)

    # In one piece: as operations of their own, which store the map between them, it took nearly twice the time.
    return one_kernel(run, (grid,) if within is None else (grid, within), jnp.int32(row), jnp.int32(col))


def shares(parts: Array, whole: int, n: Array) -> Array:
    """Return the least counts that are at least `parts / whole` of n: int32. No product overflows."""
    quotient, rest = n // whole, n % whole
    return parts * quotient + -(-parts * rest // whole)


def first_known(known: Array, last: Array, n_known: Array, knowable: Array) -> tuple[Array, Array, Array]:
    """Return where a record of known cells, which never become fewer, first has some shares: `(at, along, reached)`.

    `[4]` int32, those of `PERCENTILES` of `n_known`; `[MARKS]` int32, those of the cells that can be known, and bool,
    whether it has them at all. `last`: number of its last entry.
    """
    # What lies beyond the last entry was never reached.
    so_far = jnp.where(lax.iota(jnp.int32, known.shape[0]) < last, known, jnp.iinfo(jnp.int32).max)
    marks = shares(lax.iota(jnp.int32, MARKS) + 1, MARKS, knowable)
    # In whole numbers: the least count of which 100 times reaches q times the whole.
    wanted = shares(jnp.array(PERCENTILES), 100, n_known), marks
    at, along = (jnp.minimum(jnp.searchsorted(so_far, counts).astype(jnp.int32), last) for counts in wanted)
    return at, along, (marks > 0) & (marks <= n_known)


def explorable_and_knowable(given: Given, row: Array, col: Array, within: Array | None) -> tuple[Array, Array]:
    """Return the free cells 4-connected to a start, `[H, W]` bool, and the count of cells that can be known, int32.

    These are what a scanner without noise can come to know: the free ones and their walls.
    """
    occupied, region = own_map(given, given.scenes.occupied), own_map(given, given.scenes.region)
    explorable = (region == region[row, col]) & ~occupied
    walls = occupied if within is None else occupied & within
    near = bordered(explorable, False)
    above, right, below, left = (beside(near, *step) for step in ((1, 0), (0, 1), (-1, 0), (0, -1)))
    return explorable, count(explorable | (walls & (above | right | below | left)))


def enough_cells(given: Given, row: Array, col: Array, within: Array | None) -> Array:
    """Return the known cells at which an episode from a start ends; `NEVER` if it does not so: int32."""
    stop_at, (_, knowable) = given.numbers.stop_at, explorable_and_knowable(given, row, col, within)
    return jnp.where(stop_at > 0, shares(stop_at, WHOLE, knowable), NEVER)


def connected(
    model: MapModel, free: Array, walls: Array, row: Array, col: Array, within: Array | None = None
) -> tuple[Array, Array]:
    """Return the clear cells that are connected to a cell, packed; and whether there are none but its own."""
    shape = free.shape
    words, walls, near = stored(
        row >= 0, lambda: [bits.pack(m) for m in (free, walls, disc(shape, row, col, model.near_d2))]
    )
    if within is not None:
        words &= bits.pack(within)
    clear = words & ~within_packed(walls, model.clearance_d2)
    reached = clear & flood(clear | (words & near), row, col)
    rows, cols = (lax.broadcasted_iota(jnp.int32, shape, axis) for axis in (0, 1))
    return reached, ~jnp.any(reached & bits.pack((rows != row) | (cols != col)))


def find_goal(given: Given, row: Array, col: Array) -> tuple[Array, Array]:
    """Return the cells to be known in the end, those connected to the start, packed; and whether that is enclosed."""
    occupied = own_map(given, given.scenes.occupied)
    within = None if given.scenes.within is None else given.scenes.within[given.scene]
    goal, enclosed = connected(given.numbers.model, ~occupied, occupied, row, col, within)
    return goal, occupied[row, col] | enclosed


def without_silent(seen: Scan, blind: Array, no_echo_is_free: Array | bool) -> Scan:
    """Silence the beams of a scan that say nothing: those stopped too near, and maybe those that nothing stopped.

    `blind`: `[B]` int32, steps at which a beam that is stopped says nothing. A silent beam passes and hits no cell.
    """
    hit = seen.hit & (seen.end >= blind)
    speaks = hit | (~seen.hit & no_echo_is_free)
    return Scan(end=jnp.where(speaks, seen.end, 0), hit=hit)


def sense(setup: Setup, given: Given, state: State, when: Array) -> State:
    """Make one scan at the true pose and count it into the map at the estimated pose, if `when`."""
    belief, beams, occupied, base = state.belief, given.shared, *stacked(given, given.scenes.occupied)
    seen = scan(occupied, base + state.row, state.col, state.heading, beams)
    blind = lax.dynamic_index_in_dim(beams.blind, state.heading, keepdims=False)
    seen = without_silent(seen, blind, True)
    if setup.noisy:
        key = jax.random.fold_in(jax.random.fold_in(given.key, Stream.SENSOR), state.scans)
        noise = {"sigma_cells": given.numbers.sigma_cells, "dropout": given.numbers.dropout}
        seen = disturb(key, seen, state.row, state.col, state.heading, beams, belief.extent, **noise)
    seen = without_silent(seen, blind, given.numbers.no_echo_is_free)
    square = square_round(setup, belief.row, belief.col, belief.driven.shape)
    before, rest = jnp.int32(0), jnp.int32(0)
    if square is not None:
        before = known_cells(belief.grid, belief.within, square)
        rest = state.n_known - before
    # The number is added where it changes nothing (it is never negative), so that it is made first, and the map can
    # then be changed in place.
    row = belief.row + jnp.minimum(before, 0)
    grid = fold(belief.grid, row, belief.col, belief.heading, seen, beams, when=when)
    n_known = rest + known_cells(grid, belief.within, square)
    return state.replace(belief=belief.replace(grid=grid), scans=state.scans + when, n_known=n_known)
