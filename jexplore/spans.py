"""Which beams of a scan enter a cell: a run of neighbours, so that how many of them come to it is two looks into a
table of counts, for every cell round the robot at once. For many maps in lockstep.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import Array, lax

from jexplore.arrays import bits
from jexplore.grid import Grid
from jexplore.raycast import Beams, Scan

HALF = 2**16  # what half of the bits of a word can hold
ALIGN = 4  # columns and steps are made in whole multiples: as many are the work of one thread of an accelerator
ABREAST = 16  # rows of a table that are summed up in one go: for many more XLA makes a kernel a row
# Cells: the table of such a radius takes 30 MB, for eight headings, and making it 100 MB; it grows with the square.
FARTHEST = 240


@struct.dataclass
class Spans:
    """The run of beams that enter each cell round a robot, for each of K headings."""

    # [K, 2 A, 2 A] uint32, A = 2 R + ALIGN, the robot's cell in row and column A: the first beam of the run, and in the
    # upper half of the bits the one after its last; each as 32 times its group and its place therein
    runs: Array
    rounds: bool = struct.field(pytree_node=False)  # whether a run may go on from the last beam to the first

    @property
    def radius(self) -> int:
        """R, cells: the farthest row and column of which they tell. Those beyond are such as no beam enters."""
        return (self.runs.shape[-1] // 2 - ALIGN) // 2


def spans_of(beams: Beams, radius: int) -> Spans | None:
    """`Spans` of a table of beams.

    Args:
      beams: `Beams` of numpy arrays. Host.
      radius: R. Cells that lie farther off are left out: at least as many rows and columns as any beam crosses, or as
        the map has.

    Returns:
      `Spans` of numpy arrays; None where the beams that enter a cell are no run of neighbours, or are too many, and for
      a radius beyond `FARTHEST`.
    """
    if radius > FARTHEST:
        return None
    n_headings, n_beams = beams.length.shape
    side = 2 * radius + 1
    rows = [_runs(beams, heading, radius) for heading in range(n_headings)]
    if any(row is None for row in rows):
        return None
    first, size = (np.stack(a) for a in zip(*rows))
    size[:, radius * side + radius] = 1  # the robot's own cell, as if the first beam entered it
    rounds = bool((first + size > n_beams).any())
    group = _group((1 + rounds) * n_beams)
    begins, ends = (bits.WORD * (beam // group) + beam % group for beam in (first, first + size))
    if ends.max() >= HALF:
        return None
    middle = 2 * radius + ALIGN  # whatever part of a map is asked of lies within
    table, near = np.zeros((n_headings, 2 * middle, 2 * middle), np.uint32), slice(middle - radius, middle + radius + 1)
    table[:, near, near] = (begins + HALF * ends).reshape(n_headings, side, side)
    # Ignored types: numpy on the host, where the record says what it is on the device.
    return Spans(table, rounds)  # type: ignore[arg-type]


def _group(n):
    """Of n beams so many share a word of a table of counts, which has room for a number up to n besides."""
    return bits.WORD - max(8, n.bit_length())


def _runs(beams, heading, radius):
    """First beam and number of beams that enter each cell, `[(2 R + 1)**2]` each; None where they are no run."""
    length = np.asarray(beams.length[heading])
    drow, dcol = (np.asarray(a[heading]) for a in (beams.drow, beams.dcol))
    step, beam = np.nonzero(np.arange(drow.shape[0])[:, None] < length)
    drow, dcol, side = drow[step, beam], dcol[step, beam], 2 * radius + 1
    if (np.abs(drow) + np.abs(dcol) != step + 1).any():
        return None
    near = np.maximum(np.abs(drow), np.abs(dcol)) <= radius
    drow, dcol, beam = drow[near], dcol[near], beam[near]
    cell = (drow + radius) * side + dcol + radius
    size = np.bincount(cell, minlength=side**2).astype(np.int32)
    first, last = np.full(side**2, len(length), np.int32), np.full(side**2, -1, np.int32)
    np.minimum.at(first, cell, beam)
    np.maximum.at(last, cell, beam)
    for odd in np.flatnonzero((size > 0) & (last - first + 1 != size)):  # those that go on at the first beam
        own = np.sort(beam[cell == odd])
        gaps = np.diff(own, append=own[0] + len(length))
        first[odd] = own[(gaps.argmax() + 1) % len(own)]
        if np.count_nonzero(gaps > 1) > 1:
            return None
    return np.where(size > 0, first, 0), size


@jax.jit
def fold(
    grid: Grid, known: Array, pose: tuple[Any, Any, Any], seen: Scan, beams: Beams, when: Array | bool
) -> tuple[Grid, Array]:
    """`raycast.fold` without a cell that is written twice for its misses, and what comes to be known.

    Args:
      grid: `Grid`, `[H, W]`.
      known: `[ceil(H / 32), W]` uint32, packed, its known cells.
      pose: `(row, col, heading)` int32, where the scan was made. In a wall at the map's edge the answer is undefined.
      seen: `Scan`, `[B]`, which stays inside the map.
      beams: `Beams` with `Spans`, of a radius within which every cell of the map lies that a beam comes to.
      when: bool scalar; if False, nothing is counted.

    Returns:
      `(grid, known)`.
    """
    shape = grid.misses.shape
    counts, at = _entered(seen, when, pose, beams, shape)
    if counts.shape == shape:
        # Made with the misses, a byte a cell: else the counts would be stored.
        told, misses = lax.optimization_barrier(counts > 0), grid.misses + counts
        known = known | bits.pack(told, method="halves")
    else:
        # Both, though one would do: what is looked up would else be stored, four bytes for each look.
        kind = jnp.uint8 if seen.end.shape[0] < 2**8 else jnp.uint16
        told, counts = lax.optimization_barrier((counts > 0, counts.astype(kind)))
        misses = _added(grid.misses, counts.astype(jnp.int32), at)
        known = _also_known(known, told, at)
    # A beam passes all cells that it enters but the one that stops it.
    (row, col, heading), step = pose, jnp.minimum(seen.end, beams.offset.shape[1] - 1)
    stop = row * shape[1] + col + beams.offset[heading, step, lax.iota(jnp.int32, step.shape[0])]
    stop = jnp.where(seen.hit & when, stop, shape[0] * shape[1])
    hits, misses = (a.reshape(-1).at[stop].add(n, mode="drop") for a, n in ((grid.hits, 1), (misses, -1)))
    return Grid(hits=hits.reshape(shape), misses=misses.reshape(shape)), known


def _also_known(known, told, at):
    """Packed known cells, with those of a part of the map that begins at `at`."""
    n_words = min(known.shape[0], -(-(told.shape[0] + bits.WORD - 1) // bits.WORD))
    spare, word = bits.WORD * n_words - told.shape[0], jnp.minimum(at[0] // bits.WORD, known.shape[0] - n_words)
    rows = jnp.pad(told, ((spare, spare), (0, 0)))
    corner = spare - (at[0] - bits.WORD * word), jnp.zeros_like(word)
    words = bits.pack(lax.dynamic_slice(rows, corner, (bits.WORD * n_words, told.shape[1])), method="halves")
    words |= lax.dynamic_slice(known, (word, at[1]), words.shape)
    return lax.dynamic_update_slice(known, words, (word, at[1]))


def _added(array, values, at):
    """Values added to a part of an array that begins at `at`, each cell of which is written once."""
    axes = tuple(range(array.ndim))
    numbers = lax.ScatterDimensionNumbers(axes, (), axes)
    once = {"indices_are_sorted": True, "unique_indices": True, "mode": "promise_in_bounds"}
    return lax.scatter_add(array, jnp.stack(at), values, numbers, **once)


def _entered(seen, when, pose, beams, shape):
    """How many beams enter each cell of a map: those that pass it and those that it stops; one its own, the robot's.

    Returns:
      `(counts, at)`: `[h, w]` int32, of that part of the map that a scan can change, and where in the map it begins,
        `(row, col)` int32.
    """
    (row, col, heading), spans, radius = pose, beams.spans, beams.spans.radius
    size = min(shape[0], 2 * radius + 1), min(shape[1], -(-(2 * radius + 1) // ALIGN) * ALIGN)
    at = [jnp.clip(n - radius, 0, full - own) for n, full, own in zip((row, col), shape, size)]
    first = at[0] - row, at[1] - col
    corner = heading, *(n + spans.runs.shape[-1] // 2 for n in first)
    runs = lax.dynamic_slice(spans.runs, corner, (1, *size))[0]
    counts, group = _counts(jnp.where(when, seen.end + seen.hit, -1), beams.offset.shape[1], spans)
    # A beam enters a cell with that step by which it has crossed as many rows and columns as lie between.
    drow, dcol = (lax.broadcasted_iota(jnp.int32, size, axis) + first[axis] for axis in (0, 1))
    step = jnp.minimum(jnp.abs(drow) + jnp.abs(dcol), counts.shape[1] - 1).astype(jnp.uint32)

    def before(beam):
        """How many beams before one come as far as each cell."""
        word = counts.reshape(-1).at[beam // bits.WORD * counts.shape[1] + step].get(mode="promise_in_bounds")
        own = word & (jnp.uint32(1) << beam % bits.WORD) - 1
        return ((word >> group) + lax.population_count(own)).astype(jnp.int32)

    return before(runs // HALF) - before(runs % HALF), at


def _counts(told, farthest, spans):
    """How many beams come how far: for each step, that of the robot's own cell the first, a group of beams a word.

    Args:
      told: `[B]` int32, cells that each beam tells of; -1 for not even the robot's own.
      farthest: steps of a beam. Static.
      spans: `Spans`.

    Returns:
      `([n, s] uint32, group)`: in a word's `group` lower bits which beams come so far, in the others how many of those
        before them do.
    """
    told = jnp.concatenate([told, told]) if spans.rounds else told
    group = _group(told.shape[0])
    n_groups, n_steps = told.shape[0] // group + 1, -(-(min(farthest, 2 * spans.radius) + 1) // ALIGN) * ALIGN
    told = jnp.pad(told, (0, n_groups * group - told.shape[0]), constant_values=-1).reshape(n_groups, group, 1)
    step = lax.broadcasted_iota(jnp.int32, (n_groups, n_steps), 1)
    own = jnp.zeros(step.shape, jnp.uint32)
    for i in reversed(range(group)):  # by the sign of a difference: two operations a beam
        own = own << 1 | lax.bitcast_convert_type(step - 1 - told[:, i], jnp.uint32) >> 31
    own = lax.optimization_barrier(own)  # once, and not for each sum that it is in
    return lax.optimization_barrier(_sums_before(lax.population_count(own)) << group | own), group


def _sums_before(rows):
    """For each row the sum of all before it, `[n, s]` uint32 as the rows are: `ABREAST` of them at a time."""
    n, n_steps = rows.shape
    if n > ABREAST:
        n_blocks = -(-n // ABREAST)
        blocks = jnp.pad(rows, ((0, n_blocks * ABREAST - n), (0, 0))).reshape(n_blocks, ABREAST, n_steps)
        whole = _sums_before(lax.optimization_barrier(jnp.sum(blocks, axis=1, dtype=jnp.uint32)))
        return (whole[:, None] + jax.vmap(_sums_before)(blocks)).reshape(-1, n_steps)[:n]
    row, before = lax.broadcasted_iota(jnp.int32, rows.shape, 0), jnp.zeros_like(rows)
    for i in range(n - 1):
        before += jnp.where(row > i, rows[i], 0)
    return before
