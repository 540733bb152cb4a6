"""Expected gain of a look-around at a view point: scans simulated on the present map.

Unknown cells let beams through, and count as information.
"""

import math
from typing import NamedTuple

import chex
import jax.numpy as jnp
from flax import struct
from jax import Array, lax

from jexplore.arrays import bits
from jexplore.arrays.loops import run_if
from jexplore.grid import Grid, count, empty_grid, entropy, is_known, is_occupied
from jexplore.native import kernels
from jexplore.raycast import Beams, fold, scan


@struct.dataclass
class Prospect:
    """Map prepared for simulated scans. M slots for the cells at which beams have disagreed until now."""

    stops: Array  # [H, W] bool, cells that stop a beam
    unknown: Array  # [H, W] bool, cells that nobody has observed, inside the world
    mixed: Array  # [M] int32, flat index of cells with both hits and misses; H * W in an unused slot
    hits: Array  # [M] float32, theirs
    misses: Array  # [M] float32
    before: Array  # [M] float32, their entropy, bits; 0 in an unused slot
    overflow: Array  # int32, such cells that did not fit: their change of entropy is not counted


class ViewGain(NamedTuple):
    """Expected gain of a look-around at a cell."""

    gain: Array  # float32, bits: entropy of the map before less that after the simulated scan
    unknown: Array  # int32, unknown cells that its beams would pass; each adds one bit to the gain
    known: Array  # int32, known cells that its beams would pass


def stops_and_unknown(
    grid: Grid, extent: Array | tuple[Array | int, Array | int], p_free: Array | float, within: Array | None = None
) -> tuple[Array, Array]:
    """Return cells that stop a simulated beam, and cells that it would observe.

    Beams end at the world's outermost cells, known or not.

    Args:
      grid: `Grid`, `[H, W]`.
      extent: `(height, width)` of the world without padding, int32.
      p_free: scalar.
      within: `[H, W]` bool, cells that are to be known; None: all.

    Returns:
      two of `[H, W]` bool.
    """
    rows, cols = (lax.broadcasted_iota(jnp.int32, grid.hits.shape, axis) for axis in (0, 1))
    inner = (rows > 0) & (cols > 0) & (rows < extent[0] - 1) & (cols < extent[1] - 1)
    return is_occupied(grid, p_free) | ~inner, ~is_known(grid) & (inner if within is None else inner & within)


def prospect(
    grid: Grid, extent: Array | tuple[Array | int, Array | int], p_free: Array | float, within: Array | None = None
) -> Prospect:
    """Make the `Prospect` of a map. Arguments as for `stops_and_unknown`. One cell in 16 may be mixed."""
    stops, unknown = stops_and_unknown(grid, extent, p_free, within)
    mixed = (grid.hits > 0) & (grid.misses > 0)
    none = mixed.size
    at = bits.first_cells(bits.pack(mixed), max(256, none // 16))
    at = jnp.where(at < none, at, none)
    hits, misses = (a.reshape(-1).at[at].get(mode="fill", fill_value=0) for a in (grid.hits, grid.misses))
    before = jnp.where(at < none, entropy(Grid(hits, misses)), 0.0)
    overflow = jnp.maximum(jnp.sum(mixed, dtype=jnp.int32) - at.shape[0], 0)
    return Prospect(stops, unknown, at, hits.astype(jnp.float32), misses.astype(jnp.float32), before, overflow)


def window_of(beams: Beams, shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the sides of the square, at most the map, that a look-around from its middle can reach: `(h, w)`."""
    radius = math.ceil(beams.offset.shape[1] / math.sqrt(2)) + 1
    return tuple(min(2 * radius + 1, n) for n in shape)


def _corner(row: Array | int, col: Array | int, size: tuple[int, ...], shape: tuple[int, ...]) -> list[Array]:
    """Return the corner of the window of a look-around at a cell: `(row, col)`."""
    return [jnp.clip(at - m // 2, 0, n - m) for at, n, m in zip((row, col), shape, size)]


def most(prospect: Prospect, row: Array, col: Array, beams: Beams) -> Array:
    """Bound the gain of look-arounds at some cells: the entropy of all cells in reach, walls or not.

    Args:
      prospect: `Prospect`.
      row, col: `[n]` int32.
      beams: `Beams`.

    Returns:
      `[n]` float32, bits; no gain is larger.
    """
    shape = prospect.stops.shape
    size = window_of(beams, shape)
    entropy_of = prospect.unknown.astype(jnp.float32).reshape(-1).at[prospect.mixed].add(prospect.before, mode="drop")
    table = jnp.cumsum(jnp.cumsum(entropy_of.reshape(shape), axis=0), axis=1)
    table = jnp.pad(table, ((1, 0), (1, 0)))
    top, left = _corner(row, col, size, shape)
    bottom, right = top + size[0], left + size[1]
    inside = table[bottom, right] - table[top, right] - table[bottom, left] + table[top, left]
    return inside * (1 + 1e-4) + 1  # more than what float32 loses


def _passed(
    prospect: Prospect, row: Array | int, col: Array | int, beams: Beams, scratch: Grid
) -> tuple[Grid, list[Array], Array, Array]:
    """Cast a look-around on a scratch: scratch, corner of the window, and there the passed and unknown cells."""
    shape, zero = prospect.stops.shape, jnp.int32(0)
    chex.assert_shape([scratch.hits, scratch.misses], shape)
    found = scan(prospect.stops, row, col, zero, beams)
    scratch = fold(scratch, row, col, zero, found, beams)
    size = window_of(beams, shape)
    corner = _corner(row, col, size, shape)
    passed, unknown = (lax.dynamic_slice(a, corner, size) for a in (scratch.misses, prospect.unknown))
    return scratch, corner, passed > 0, unknown


def _wiped(scratch: Grid, corner: list[Array], size: tuple[int, ...]) -> Grid:
    """Reset a window of a scratch to zeros."""
    blank = jnp.zeros(size, jnp.int32)
    return Grid(*(lax.dynamic_update_slice(a, blank, corner) for a in (scratch.hits, scratch.misses)))


def look(
    prospect: Prospect, row: Array | int, col: Array | int, beams: Beams, scratch: Grid, *, native: str | None = None
) -> tuple[ViewGain, Grid]:
    """Compute the expected gain of a look-around at a cell.

    Args:
      prospect: `Prospect`.
      row, col: int32, the cell.
      beams: `Beams` from `raycast.all_round`.
      scratch: `Grid` of zeros, `[H, W]`.
      native: target of native code that counts cells, where beams have disagreed nowhere; None: JAX does. Static.

    Returns:
      `(ViewGain, scratch)`; the scratch is zeros again.

    Source:
      Holz et al. 2010, section 3.2, where the sign of the difference is a misprint.
    """
    if native:
        at = jnp.stack([row, col])[:, None]
        (seen,), (known,) = kernels.look(native, prospect.stops, prospect.unknown, at, 1, beams)

        def with_change(state: tuple[Array, Grid]) -> tuple[Array, Grid]:
            told, scratch = look(prospect, row, col, beams, state[1])
            return told.gain, scratch

        alone = seen.astype(jnp.float32), scratch
        gain, scratch = run_if(jnp.any(prospect.before > 0), with_change, alone)
        return ViewGain(gain, seen, known), scratch
    scratch, corner, passed, unknown = _passed(prospect, row, col, beams, scratch)
    seen = count(passed & unknown)
    known = count(passed) - seen

    def after(array: Array) -> Array:
        return array.reshape(-1).at[prospect.mixed].get(mode="fill", fill_value=0).astype(jnp.float32)

    # Without a Grid: hits and misses as float32 are exact up to 2**24.
    hits, misses = prospect.hits + after(scratch.hits), prospect.misses + after(scratch.misses)
    n = jnp.maximum(hits + misses, 1.0)
    entropy_after = -sum(jnp.where(q > 0, q * jnp.log2(jnp.where(q > 0, q, 1.0)), 0.0) for q in (hits / n, misses / n))
    change = jnp.sum(jnp.where(prospect.before > 0, prospect.before - entropy_after, 0.0))
    return ViewGain(seen.astype(jnp.float32) + change, seen, known), _wiped(scratch, corner, passed.shape)


def unknown_within(
    prospect: Prospect, row: Array | int, col: Array | int, beams: Beams, scratch: Grid, d2: Array
) -> tuple[Array, Grid]:
    """Count the unknown cells that a look-around at a cell would show within some distances.

    Args:
      prospect, row, col, beams, scratch: as for `look`.
      d2: `[R]` float32, squared distances, cells^2.

    Returns:
      `([R] int32, scratch)`; the scratch is zeros again.
    """
    scratch, corner, passed, unknown = _passed(prospect, row, col, beams, scratch)
    rows, cols = (lax.broadcasted_iota(jnp.int32, passed.shape, axis) + corner[axis] for axis in (0, 1))
    off = (rows - row) ** 2 + (cols - col) ** 2
    counts = jnp.stack([count(passed & unknown & (off <= d2[i])) for i in range(d2.shape[0])])
    return counts, _wiped(scratch, corner, passed.shape)


def unknown_seen(
    grid: Grid,
    extent: Array | tuple[Array | int, Array | int],
    p_free: Array | float,
    row: Array | int,
    col: Array | int,
    beams: Beams,
    within: Array | None = None,
) -> Array:
    """Count the unknown cells that a look-around at a cell would show: int32, the `unknown` of a `look`.

    Args:
      grid, extent, p_free, within: as for `stops_and_unknown`.
      row, col, beams: as for `look`.
    """
    stops, unknown = stops_and_unknown(grid, extent, p_free, within)
    zero = jnp.int32(0)
    found = scan(stops, row, col, zero, beams)
    passed = fold(empty_grid(stops.shape), row, col, zero, found, beams).misses
    return count((passed > 0) & unknown)
