"""Laser beams through a grid: the cells that each beam enters, where it ends, and what that tells the map.

`beam_table` traces the beams of a robot on the lattice (cell centres, headings in steps of 45 degrees) once, on the
host, in float64; `scan` finds where beams end in a true map, `fold` counts the outcome into a `Grid`.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, ClassVar, Self

import chex
import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import Array, lax

from jexplore.grid import Grid, in_cells
from jexplore.rules import Lidar

BLOCK = 8  # steps of a beam looked at together, before asking whether all beams have ended
NOT_ENDED = 2**30  # step number of a beam that is still under way
BEYOND = 1e30  # cells; spacing of the crossings of an axis along which a beam does not move
HEADINGS = 8  # lattice headings, 45 degrees apart


@struct.dataclass
class Beams:
    """The cells that beams enter, in order, for each of K headings (8 in a `beam_table`).

    Steps count the cells entered after the robot's own; S is a multiple of `BLOCK`. B is the number of beams.
    """

    offset: Array  # [K, S, B] int32, flat cell entered at this step, relative to the robot's: drow * W + dcol
    by_beam: Array  # [K, S / BLOCK, B, BLOCK] int32, the same numbers, block by block, beam after beam
    drow: Array  # [K, S, B] int32, row of the cell entered at this step, relative to the robot's; 0 beyond the range
    dcol: Array  # [K, S, B] int32, column of the same
    entry: Array  # [K, S, B] float32, distance at which it is entered, cells; inf beyond the range
    length: Array  # [K, B] int32, cells entered at a distance below the range
    blind: Array  # [K, B] int32, of these the first ones: a beam that is stopped there says nothing
    reach: Array  # float32, the range, cells
    all_round: Any = None  # `Beams`, K = 1, of a look-around as one scan in the middle of a square of `square_side`
    replace: ClassVar[Callable[..., Self]]


@struct.dataclass
class Scan:
    """Ends of the beams of one scan."""

    end: Array  # [B] int32, cells passed; also the step at which the beam was stopped, if it was
    hit: Array  # [B] bool, stopped by an occupied cell (else the range ended it)


def exact_direction(deg: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the unit vector of angles in degrees, exact where sine or cosine is 0, 1/2, 1 or sqrt(1/2). Host.

    `(dx, dy)`, float64, of the shape of the angles.
    """
    deg = np.asarray(deg, np.float64) % 360.0
    dx, dy = np.cos(np.radians(deg)), np.sin(np.radians(deg))
    for sign in (-1, 1):
        for value in (0.0, 0.5, math.sqrt(0.5), 1.0):
            dx = np.where(np.abs(dx - sign * value) < 1e-12, sign * value, dx)
            dy = np.where(np.abs(dy - sign * value) < 1e-12, sign * value, dy)
    return dx, dy


def beam_angles_deg(lidar: Lidar) -> np.ndarray:
    """Compute the angles of beams relative to the robot's heading: `[B]` float64, degrees, from right to left.

    At a field of view of 360 degrees the last beam stops one step short of the first.
    """
    if lidar.n_beams == 1:
        return np.full(1, float(lidar.yaw_deg))
    full = lidar.fov_deg == 360
    step = lidar.fov_deg / (lidar.n_beams if full else lidar.n_beams - 1)
    return lidar.yaw_deg - lidar.fov_deg / 2 + step * np.arange(lidar.n_beams)


def advance_beams(state: tuple[Any, Any], geometry: tuple[Any, ...]) -> tuple[tuple[Any, Any], tuple[Any, Any, Any]]:
    """Advance every beam by one step of Amanatides and Woo's traversal; through an exact corner it steps in x first.

    Of numpy or JAX. `state` counts the crossings, `(0, 0)` at first. Returns the next state, and the cell entered with
    the distance at which: `(drow, dcol, entry)`, relative to the first cell, in cells.
    """
    nx, ny = state
    sign_x, sign_y, to_x, to_y, per_x, per_y = geometry
    xp = per_x.__array_namespace__()
    # The crossing distance comes from the crossing's number, never from a running sum: no drift along the beam.
    at_x, at_y = (nx + to_x) * per_x, (ny + to_y) * per_y
    step_x = at_x <= at_y
    nx, ny = xp.where(step_x, nx + 1, nx), xp.where(step_x, ny, ny + 1)
    return (nx, ny), (sign_y * ny, sign_x * nx, xp.where(step_x, at_x, at_y))


def beam_geometry(dx: Any, dy: Any, x: Any, y: Any) -> tuple[Any, ...]:
    """Return signs, distance to the first crossing in units of the crossings' spacing, and that spacing, on each axis.

    `dx`, `dy` are the beams' directions, `x`, `y` where in its cell, 0 to 1, a beam begins.
    """
    xp = dx.__array_namespace__()
    sign_x, sign_y = xp.where(dx < 0, -1, 1), xp.where(dy < 0, -1, 1)
    to_x, to_y = xp.where(dx < 0, x, 1 - x), xp.where(dy < 0, y, 1 - y)
    per_x = xp.where(dx == 0, BEYOND, 1 / xp.where(dx == 0, 1, xp.abs(dx)))
    per_y = xp.where(dy == 0, BEYOND, 1 / xp.where(dy == 0, 1, xp.abs(dy)))
    # A beam along an axis that starts on a cell's edge never crosses the other axis, not even at distance 0 * BEYOND.
    return sign_x, sign_y, xp.where(dx == 0, 1, to_x), xp.where(dy == 0, 1, to_y), per_x, per_y


def n_steps(range_cells: float) -> int:
    """Return the steps that a beam can need from anywhere in a cell, and one more to end it, in whole blocks."""
    return -(-(math.floor(range_cells * math.sqrt(2)) + 3) // BLOCK) * BLOCK


def by_beam(offset: np.ndarray) -> np.ndarray:
    """Reorder cell numbers block by block, beam after beam: `[K, S, B]` as `[K, S / BLOCK, B, BLOCK]`.

    Counted in this order, two beams side by side, which enter the same cells near the robot, add to a cell one long
    after the other. In the order of steps they do so one right after the other, and each waits for the one before
    (measured: 1.7 times the time).
    """
    n_headings, n, n_beams = offset.shape
    return offset.reshape(n_headings, n // BLOCK, BLOCK, n_beams).swapaxes(2, 3)


def _numbered(drow: np.ndarray, dcol: np.ndarray, width: int) -> dict[str, Any]:
    """Return cells as flat numbers in maps of a width, in both orders of `Beams`."""
    offset = drow * np.int32(width) + dcol
    return {"offset": offset, "by_beam": by_beam(offset)}


def scans_all_round(lidar: Lidar) -> int:
    """Return the number of evenly turned scans of a look-around: 1, 2, 4 or 8, so that every heading is on the lattice.

    ceil(360 / field of view) where that divides 8; below 45 degrees 8 scans leave gaps.
    """
    return next((n for n in (1, 2, 4) if n * lidar.fov_deg >= 360), HEADINGS)


def square_side(beams: Beams) -> int:
    """Return the side of the square that holds what beams reach from its middle, cells. Static."""
    return 2 * math.ceil(beams.offset.shape[1] / math.sqrt(2)) + 3


def farthest(lidar: Lidar, cell_m: float) -> float:
    """Bound how far from its cell's centre a robot sees, cells: the range, from a mount anywhere in its own cell."""
    mount = in_cells(lidar.mount_m, cell_m) + 1 if lidar.mount_m else 0.0
    return in_cells(lidar.range_m, cell_m) + mount


def _cells_to(x: float, y: float) -> np.ndarray:
    """Return cells entered on the way from a cell's centre to a point, cells: `[(drow, dcol), ...]` relative to it."""
    col, row = math.floor(x + 0.5), math.floor(y + 0.5)
    # Where the way crosses edges of columns and of rows, as parts of its length; through a corner in x first.
    columns = [(round((i + 0.5) / abs(x), 9), 0, (0, int(math.copysign(1, x)))) for i in range(abs(col))]
    rows = [(round((i + 0.5) / abs(y), 9), 1, (int(math.copysign(1, y)), 0)) for i in range(abs(row))]
    return np.cumsum([(0, 0), *(step for *_, step in sorted(columns + rows))], axis=0)[1:]


@functools.lru_cache(maxsize=8)
def beam_table(lidar: Lidar, cell_m: float, width: int, longest: float = 0.0) -> Beams:
    """Compute the beams of a robot on a cell's centre with a heading that is a multiple of 45 degrees.

    A beam begins at the robot's centre, goes to the scanner and on from there; what stops it before the scanner, or
    nearer than the least range, makes it silent.

    Args:
      lidar: `Lidar`.
      cell_m: edge of a cell, metres.
      width: W of the maps that the beams will cross, cells; `all_round` crosses its square.
      longest: a distance, as of `farthest`, that the table is to have room for, so that it has the shape of a longer
        scanner's, cells.

    Returns:
      `Beams` of numpy arrays, K = 8; index k is the heading 45 k degrees. Distances are from the scanner.

    Source:
      Amanatides and Woo 1987. A beam enters a cell at a distance strictly below the range, or not at all.
    """
    reach = in_cells(lidar.range_m, cell_m)
    angles = 45.0 * np.arange(HEADINGS)[:, None] + beam_angles_deg(lidar)
    dx, dy = exact_direction(angles)
    ahead, aside = exact_direction(45.0 * np.arange(HEADINGS))
    forward, left = (math.copysign(in_cells(abs(a), cell_m), a) for a in (lidar.forward_m, lidar.left_m))
    x, y = forward * ahead - left * aside, forward * aside + left * ahead
    inside_x, inside_y = ((a + 0.5 - np.floor(a + 0.5))[:, None] for a in (x, y))
    geometry = beam_geometry(dx, dy, inside_x, inside_y)
    state, steps = (np.zeros(dx.shape), np.zeros(dx.shape)), []
    size = n_steps(max(farthest(lidar, cell_m), longest))
    for _ in range(size):
        state, step = advance_beams(state, geometry)
        steps.append(step)
    drow, dcol, entry = (np.stack([s[i] for s in steps], axis=1) for i in range(3))
    blind = (entry < in_cells(lidar.min_range_m, cell_m)).sum(axis=1)
    for k, way in enumerate(map(_cells_to, x, y) if lidar.mount_m else ()):
        n, mount = len(way), way[-1] if len(way) else (0, 0)
        for table, before, origin in ((drow, way[:, 0], mount[0]), (dcol, way[:, 1], mount[1]), (entry, 0.0, 0.0)):
            table[k, n:] = table[k, : size - n] + origin
            table[k, :n] = np.broadcast_to(before, n)[:, None]
        blind[k] += n
    within = entry < reach
    drow, dcol = (np.where(within, d, 0).astype(np.int32) for d in (drow, dcol))
    entry, length = np.where(within, entry, np.inf).astype(np.float32), within.sum(axis=1).astype(np.int32)
    whole = {"drow": drow, "dcol": dcol, "entry": entry, "length": length, "blind": blind.astype(np.int32)}
    # Ignored types: numpy on the host, where the record says what it is on the device.
    table: Any = Beams(**_numbered(drow, dcol, width), **whole, reach=np.float32(reach))  # type: ignore[arg-type]
    turns = slice(None, None, HEADINGS // scans_all_round(lidar))
    around = {name: np.concatenate(list(a[turns]), axis=-1)[None] for name, a in whole.items()}
    numbered = _numbered(around["drow"], around["dcol"], square_side(table))
    return table.replace(all_round=Beams(**numbered, **around, reach=table.reach))  # type: ignore[arg-type]


@jax.jit
def scan(occupied: Array, row: Array | int, col: Array | int, heading: Array | int, beams: Beams) -> Scan:
    """Cast the beams of one scan in a true map. The first occupied cell entered stops a beam, not the robot's own.

    Args:
      occupied: `[H, W]` bool. Its outermost rows and columns must be occupied: beams are not tested against the edge.
      row, col, heading: int32, the robot's cell, and which of the K headings of `beams`.
    """
    chex.assert_rank(occupied, 2)
    chex.assert_type(occupied, bool)
    flat, here = occupied.reshape(-1), row * occupied.shape[1] + col
    length = lax.dynamic_index_in_dim(beams.length, heading, keepdims=False)

    def blocked(offset: Array) -> Array:
        return flat.at[here + offset].get(mode="clip", wrap_negative_indices=False)

    def first_stop(offset: Array, first: Array) -> Array:
        """Return the first step of some, `[n, B]`, at which each beam is stopped or ends."""
        step = first + lax.broadcasted_iota(jnp.int32, (offset.shape[0], 1), 0)
        stopped = blocked(offset) | (step >= length)
        return jnp.min(jnp.where(stopped, step, NOT_ENDED), axis=0)

    def not_ended(state: tuple[Array, Array]) -> Array:
        j, end = state
        return (j * BLOCK < beams.offset.shape[1]) & (jnp.max(end) == NOT_ENDED)

    def look(state: tuple[Array, Array]) -> tuple[Array, Array]:
        j, end = state
        # Sliced before it is reshaped: reshaping the whole table inside a loop would copy it.
        offset = lax.dynamic_slice(beams.offset, (heading, j * BLOCK, 0), (1, BLOCK, length.shape[0]))[0]
        return j + 1, jnp.minimum(end, first_stop(offset, j * BLOCK))

    _, end = lax.while_loop(not_ended, look, (jnp.int32(0), jnp.full(length.shape, NOT_ENDED, jnp.int32)))
    return Scan(end=end, hit=end < length)


@jax.jit
def fold(
    grid: Grid,
    row: Array | int,
    col: Array | int,
    heading: Array | int,
    seen: Scan,
    beams: Beams,
    *,
    when: Array | bool = True,
) -> Grid:
    """Count one scan, which stays inside the map: a miss for every cell passed, a hit where a beam was stopped.

    The robot's own cell gets one miss, whatever the number of beams. Arguments as for `scan`; nothing is counted if not
    `when`.

    Source:
      Holz et al. 2010, section 2.1.
    """
    chex.assert_rank([grid.hits, grid.misses], 2)
    height, width = grid.hits.shape
    here, outside = row * width + col, height * width
    end, hit = jnp.where(when, seen.end, 0), seen.hit & when
    misses = grid.misses.reshape(-1).at[here].add(jnp.asarray(when, jnp.int32))

    def cells(offset: Array, first: Array) -> Array:
        """Return the cells that some blocks of steps pass; an invalid one beyond the end of the beam."""
        step = first + lax.broadcasted_iota(jnp.int32, offset.shape, offset.ndim - 1)
        return jnp.where(step < end[:, None], here + offset, outside)

    def counted(state: tuple[Array, Array]) -> tuple[Array, Array]:
        j, misses = state
        offset = lax.dynamic_slice(beams.by_beam, (heading, j, 0, 0), (1, 1, *beams.by_beam.shape[2:]))[0, 0]
        return j + 1, misses.at[cells(offset, j * BLOCK)].add(1, mode="drop")

    last = jnp.max(end)
    _, misses = lax.while_loop(lambda s: s[0] * BLOCK < last, counted, (jnp.int32(0), misses))
    step = jnp.minimum(end, beams.offset.shape[1] - 1)
    stop = here + beams.offset[heading, step, lax.iota(jnp.int32, step.shape[0])]
    hits = grid.hits.reshape(-1).at[jnp.where(hit, stop, outside)].add(1, mode="drop")
    return Grid(hits=hits.reshape(height, width), misses=misses.reshape(height, width))


def steps_inside(
    beams: Beams,
    row: Array | int,
    col: Array | int,
    heading: Array | int,
    extent: Array | tuple[Array | int, Array | int],
) -> Array:
    """Count the steps that each beam can make before it leaves the map: `[B]` int32.

    Beams start at `row`, `col` with a `heading`; `extent` is `(height, width)` of the map without padding.
    """
    r = row + lax.dynamic_index_in_dim(beams.drow, heading, keepdims=False)
    c = col + lax.dynamic_index_in_dim(beams.dcol, heading, keepdims=False)
    within = (r >= 0) & (r < extent[0]) & (c >= 0) & (c < extent[1])
    step = lax.broadcasted_iota(jnp.int32, within.shape, 0)
    return jnp.min(jnp.where(within, within.shape[0], step), axis=0)


def disturb(
    key: Array,
    seen: Scan,
    row: Array | int,
    col: Array | int,
    heading: Array | int,
    beams: Beams,
    extent: Array | tuple[Array | int, Array | int],
    *,
    sigma_cells: Array | float,
    dropout: Array | float,
) -> Scan:
    """Add noise to a scan, made at `row`, `col` with a `heading`.

    A beam that was stopped reports its distance plus Gaussian noise; it is read as a hit in the cell at that distance,
    or as passing everything where that lies beyond the range. A beam that was not stopped is not disturbed. A beam that
    drops out tells nothing. No beam is read as ending outside the map: it ends in the last cell inside. A distance
    short of the first cell is read as that cell, or as too near by a scanner outside the robot's own cell.

    Args:
      key: consumed.
      extent: `(height, width)` of the map without padding, int32 scalars.
      sigma_cells: standard deviation of the range, cells; scalar.
      dropout: probability that a beam drops out; scalar.
    """
    key_range, key_drop = jax.random.split(key)
    n_beams = seen.end.shape[0]
    entry = lax.dynamic_index_in_dim(beams.entry, heading, keepdims=False)
    length = lax.dynamic_index_in_dim(beams.length, heading, keepdims=False)
    at = jnp.take_along_axis(entry, jnp.minimum(seen.end, entry.shape[0] - 1)[None], axis=0)[0]
    distance = at + sigma_cells * jax.random.normal(key_range, (n_beams,))
    # The cell at a distance is the last one entered before it; a distance short of the first cell reads as the first.
    step = jnp.where(distance == at, seen.end, jnp.sum(entry < distance, axis=0, dtype=jnp.int32) - 1)
    step = jnp.where(distance < beams.reach, jnp.maximum(step, 0), length)
    last = steps_inside(beams, row, col, heading, extent) - 1
    end = jnp.where(seen.hit, jnp.minimum(step, last), seen.end)
    hit = seen.hit & (end < length)
    kept = jax.random.uniform(key_drop, (n_beams,)) >= dropout
    return Scan(end=jnp.where(kept, end, 0), hit=hit & kept)
