"""Beams through a grid from any pose: where they end in a true map, and what they tell a robot's map.

Poses and distances are in cells: the centre of cell (row, col) is at x = col + 0.5, y = row + 0.5. On the lattice, with
directions of `raycast.beam_table`, the cells are those of that table.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from jexplore.grid import Grid
from jexplore.native import kernels
from jexplore.raycast import BLOCK, advance_beams, beam_geometry

CORNER = 1e-6  # share by which a beam reads more that passes an exact corner and the free cell next to it


class Reading(NamedTuple):
    """Readings of a scanner."""

    distance: Array  # [B] float32, cells; of a beam that nothing stopped its range
    hit: Array  # [B] bool, something stopped it
    speaks: Array  # [B] bool; False: the beam tells nothing


def _begin(xy, direction):
    """Return the cell that beams begin in, the geometry of their crossings, and the first cell that they enter."""
    cell = jnp.floor(xy)
    inside = xy - cell
    geometry = beam_geometry(direction[:, 0], direction[:, 1], inside[0], inside[1])
    zero = jnp.zeros(direction.shape[0], jnp.int32)
    row, col = cell[1].astype(jnp.int32), cell[0].astype(jnp.int32)
    crossed, entered = advance_beams((zero, zero), geometry)
    return (row, col), geometry, crossed, entered


def cast(
    occupied: Array, xy: Array, direction: Array, reach: Array, base: Array | int = 0, native: str | None = None
) -> Reading:
    """Cast beams in a true map.

    Args:
      occupied: `[H, W]` bool; its outermost rows and columns must be occupied.
      xy: `[2]` float32, x and y, cells, inside the map. The cell there stops no beam.
      direction: `[B, 2]` float32, unit vectors.
      reach: float32, range, cells.
      base: int32, row where the map begins, of maps of one width one above the other.
      native: target of native kernels, which give the same; None: JAX does it. Static.

    Returns:
      `Reading`: the distance at which the first occupied cell is entered.
    """
    native = kernels.target_of(native)
    if native is not None:
        n, terms = direction.shape[:1], (jnp.float32(reach), kernels.numbers([base]))
        results = [(n, jnp.float32), (n, bool)]
        distance, hit = kernels.call(native, "cast", results, occupied, xy, direction, *terms)
        return Reading(distance, hit, jnp.ones(n, bool))
    (row, col), geometry, crossed, entered = _begin(xy, direction)
    flat, width, row = occupied.reshape(-1), occupied.shape[1], row + base

    def block(state: Any) -> Any:
        crossed, (drow, dcol, entry), going, hit, distance = state
        for _ in range(BLOCK):
            at = (row + drow) * width + col + dcol
            stopped = going & (entry < reach) & flat.at[at].get(mode="clip", wrap_negative_indices=False)
            hit, distance = hit | stopped, jnp.where(stopped, entry, distance)
            going &= ~stopped & (entry < reach)
            before = entry
            crossed, (drow, dcol, entry) = advance_beams(crossed, geometry)
            # Told apart by the distance alone, or a map would not know which of the two cells stopped it.
            entry = jnp.where(entry == before, entry * (1 + CORNER), entry)
        return crossed, (drow, dcol, entry), going, hit, distance

    n = direction.shape[0]
    nothing = jnp.ones(n, bool), jnp.zeros(n, bool), jnp.full(n, 1.0, jnp.float32) * reach
    *_, hit, distance = lax.while_loop(lambda state: jnp.any(state[2]), block, (crossed, entered, *nothing))
    return Reading(distance, hit, jnp.ones(n, bool))


def fold(
    grid: Grid, xy: Array, direction: Array, reading: Reading, reach: Array, extent: Array, native: str | None = None,
    *, ends_first: bool = False,
) -> Grid:  # fmt: skip
    """Count readings into a map: a miss for every cell passed and for the robot's own, a hit where a beam ends.

    A beam ends in the cell that it enters nearest to its reading, at least in the first one, so that a pose or a
    reading that is off by less than half a cell moves few hits to another cell.

    Args:
      grid: `Grid`, `[H, W]`.
      xy, direction, reach: as of `cast`, where the robot takes itself to be; it may be anywhere.
      extent: `[2]` int32, height and width of the map without padding; cells outside are not counted.
      native: as of `cast`.
      ends_first: a cell in which a beam ends gets no misses of the others. At a place that is estimated walls lie
        anywhere in their cells, and beams that graze them pass through these before they end. At a place that is
        exact this changes nothing. Static.

    Returns:
      `Grid`.

    Source:
      Hornung et al., OctoMap (2013), for `ends_first`.
    """
    native = kernels.target_of(native)
    if native is not None:
        return kernels.fold(native, grid, xy, direction, reading, reach, extent, ends_first=ends_first)[0]
    (row, col), geometry, crossed, entered = _begin(xy, direction)
    height, width = grid.hits.shape

    def flat(drow: Array, dcol: Array, counts: Array) -> Array:
        r, c = row + drow, col + dcol
        inside = counts & (r >= 0) & (r < extent[0]) & (c >= 0) & (c < extent[1])
        return jnp.where(inside, r * width + c, height * width)

    none = jnp.zeros(direction.shape[0], jnp.int32)
    misses = grid.misses.reshape(-1).at[flat(none[:1], none[:1], jnp.ones(1, bool))].add(1, mode="drop")
    limit = jnp.where(reading.hit, reading.distance, jnp.inf)

    def block(state: Any) -> Any:
        crossed, (drow, dcol, entry), going, end, misses = state
        passed = []
        for _ in range(BLOCK):
            crossed, (next_row, next_col, after) = advance_beams(crossed, geometry)
            passes = going & (0.5 * (entry + after) < limit)
            end = jnp.where(going & ~passes, flat(drow, dcol, going), end)
            passed.append(flat(drow, dcol, passes))
            drow, dcol, entry, going = next_row, next_col, after, passes & (after < reach)
        return crossed, (drow, dcol, entry), going, end, misses.at[jnp.stack(passed)].add(1, mode="drop")

    going = reading.speaks & (entered[2] < reach)
    state = crossed, entered, going, jnp.full(none.shape, height * width), misses
    *_, end, misses = lax.while_loop(lambda state: jnp.any(state[2]), block, state)
    if ends_first:
        misses = misses.at[end].set(grid.misses.reshape(-1).at[end].get(mode="clip"), mode="drop")
    hits = grid.hits.reshape(-1).at[end].add(1, mode="drop")
    return Grid(hits=hits.reshape(height, width), misses=misses.reshape(height, width))
