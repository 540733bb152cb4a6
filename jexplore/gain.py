"""Expected gain of a look-around at a view point: scans simulated on the present map.

Unknown cells let beams through, and count as information.
"""

from typing import NamedTuple

import jax.numpy as jnp
from flax import struct
from jax import Array, lax

from jexplore.arrays import bits
from jexplore.arrays.loops import run_if
from jexplore.grid import Grid, count, empty_grid, entropy, is_known, is_occupied
from jexplore.native import kernels
from jexplore.raycast import Beams, fold, scan, square_side


class Known(NamedTuple):
    """The part of a world that a robot knows."""

    grid: Grid  # [H, W]
    p_free: Array | float  # largest reflection probability of a free cell
    within: Array | None = None  # [H, W] bool, cells that are to be known; None, or all of them: those beyond as well
    outline: Array | tuple[int, int] = (
        0,
        0,
    )  # height and width of the world, if known: beams end at its outermost cells


@struct.dataclass
class Prospect:
    """Map prepared for simulated scans. M slots for the cells at which beams have disagreed until now."""

    stops: Array  # [H + 2 R, W + 2 R] bool, of `stops_and_unknown`
    unknown: Array  # [H + 2 R, W + 2 R] bool, of the same
    mixed: Array  # [M] int32, flat index there of cells with both hits and misses; beyond the last in an unused slot
    hits: Array  # [M] float32, theirs
    misses: Array  # [M] float32
    before: Array  # [M] float32, their entropy, bits; 0 in an unused slot
    overflow: Array  # int32, such cells that did not fit: their change of entropy is not counted


class ViewGain(NamedTuple):
    """Expected gain of a look-around at a cell."""

    gain: Array  # float32, bits: entropy of the map before less that after the simulated scan
    unknown: Array  # int32, unknown cells that its beams would pass; each adds one bit to the gain
    known: Array  # int32, known cells that its beams would pass


def stops_and_unknown(known: Known, beams: Beams) -> tuple[Array, Array]:
    """Return cells that stop a simulated beam, and cells that it would observe, with a margin beyond the map.

    What lies beyond the map is unknown: a robot does not know where its world ends. `beams` are `Beams.all_round`,
    which reach R cells. Returns two of `[H + 2 R, W + 2 R]` bool.
    """
    grid, p_free, within, (height, width) = known
    rows, cols = (lax.broadcasted_iota(jnp.int32, grid.hits.shape, axis) for axis in (0, 1))
    inner = (rows > 0) & (cols > 0) & (rows < height - 1) & (cols < width - 1)
    ends = ~inner & (height > 0)
    wanted = True if within is None else within
    margin = [(square_side(beams) // 2, square_side(beams) // 2, 0)] * 2
    stops, unknown = is_occupied(grid, p_free) | ends, ~is_known(grid) & ~ends & wanted
    return lax.pad(stops, jnp.bool_(False), margin), lax.pad(unknown, jnp.all(wanted), margin)


def prospect(known: Known, beams: Beams) -> Prospect:
    """Make the `Prospect` of a map. Arguments as for `stops_and_unknown`. One cell in 16 may be mixed."""
    grid, margin = known.grid, square_side(beams) // 2
    stops, unknown = stops_and_unknown(known, beams)
    mixed = (grid.hits > 0) & (grid.misses > 0)
    none, width = mixed.size, mixed.shape[1]
    at = bits.first_cells(bits.pack(mixed), max(256, none // 16))
    at = jnp.where(at < none, at, none)
    hits, misses = (a.reshape(-1).at[at].get(mode="fill", fill_value=0) for a in (grid.hits, grid.misses))
    before = jnp.where(at < none, entropy(Grid(hits, misses)), 0.0)
    overflow = jnp.maximum(jnp.sum(mixed, dtype=jnp.int32) - at.shape[0], 0)
    at = jnp.where(at < none, (at // width + margin) * stops.shape[1] + at % width + margin, stops.size)
    return Prospect(stops, unknown, at, hits.astype(jnp.float32), misses.astype(jnp.float32), before, overflow)


def most(prospect: Prospect, row: Array, col: Array, beams: Beams) -> Array:
    """Bound the gain of look-arounds at some cells, `[n]` int32 each: `[n]` float32, bits; no gain is larger.

    It is the entropy of all cells in reach, walls or not. `beams` are `Beams.all_round`.
    """
    side = square_side(beams)
    entropy_of = prospect.unknown.astype(jnp.float32).reshape(-1).at[prospect.mixed].add(prospect.before, mode="drop")
    table = jnp.cumsum(jnp.cumsum(entropy_of.reshape(prospect.unknown.shape), axis=0), axis=1)
    table = jnp.pad(table, ((1, 0), (1, 0)))
    inside = table[row + side, col + side] - table[row, col + side] - table[row + side, col] + table[row, col]
    return inside * (1 + 1e-4) + 1  # more than what float32 loses


def _passed(stops: Array, unknown: Array, row: Array | int, col: Array | int, beams: Beams) -> tuple[Grid, Array]:
    """Cast a look-around: what it counts in the square round the cell, and the unknown cells there."""
    side, zero = square_side(beams), jnp.int32(0)
    stops, unknown = (lax.dynamic_slice(a, (row, col), (side, side)) for a in (stops, unknown))
    found = scan(stops, side // 2, side // 2, zero, beams)
    return fold(empty_grid((side, side)), side // 2, side // 2, zero, found, beams), unknown


def look(
    prospect: Prospect, row: Array | int, col: Array | int, beams: Beams, *, native: str | None = None
) -> ViewGain:
    """Compute the expected gain of a look-around at a cell; `beams` are `Beams.all_round`.

    `native` is the target of native code that counts cells, where beams have disagreed nowhere; None: JAX does. Static.

    Source:
      Holz et al. 2010, section 3.2, where the sign of the difference is a misprint.
    """
    if native:
        at = jnp.stack([row, col])[:, None]
        (seen,), (known,) = kernels.look(native, prospect.stops, prospect.unknown, at, 1, beams)
        alone = seen.astype(jnp.float32)
        gain = run_if(jnp.any(prospect.before > 0), lambda _: look(prospect, row, col, beams).gain, alone)
        return ViewGain(gain, seen, known)
    counted, unknown = _passed(prospect.stops, prospect.unknown, row, col, beams)
    passed = counted.misses > 0
    seen = count(passed & unknown)
    known = count(passed) - seen
    at_row, at_col = prospect.mixed // prospect.stops.shape[1] - row, prospect.mixed % prospect.stops.shape[1] - col

    def after(array: Array) -> Array:
        found = array.at[at_row, at_col].get(mode="fill", fill_value=0, wrap_negative_indices=False)
        return found.astype(jnp.float32)

    # Without a Grid: hits and misses as float32 are exact up to 2**24.
    hits, misses = prospect.hits + after(counted.hits), prospect.misses + after(counted.misses)
    n = jnp.maximum(hits + misses, 1.0)
    entropy_after = -sum(jnp.where(q > 0, q * jnp.log2(jnp.where(q > 0, q, 1.0)), 0.0) for q in (hits / n, misses / n))
    change = jnp.sum(jnp.where(prospect.before > 0, prospect.before - entropy_after, 0.0))
    return ViewGain(seen.astype(jnp.float32) + change, seen, known)


def seen_within(stops: Array, unknown: Array, row: Array | int, col: Array | int, beams: Beams, d2: Array) -> Array:
    """Count the cells that a look-around at a cell would see: `[R + 1]` int32, unknown within R distances, then known.

    `stops`, `unknown`: of `stops_and_unknown`; `d2`: `[R]` float32, squared distances, cells^2; the others as for
    `look`.
    """
    counted, unknown = _passed(stops, unknown, row, col, beams)
    rows, cols = (lax.broadcasted_iota(jnp.int32, unknown.shape, axis) - unknown.shape[0] // 2 for axis in (0, 1))
    passed, off = counted.misses > 0, rows**2 + cols**2
    shown = [count(passed & unknown & (off <= d2[i])) for i in range(d2.shape[0])]
    return jnp.stack([*shown, count(passed & ~unknown)])
