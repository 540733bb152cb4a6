"""Which beams of a scan enter a cell: a run of neighbours, so that whether one of them reaches it is two looks into a
table of maxima, for every cell round the robot at once. For many maps in lockstep.
"""

import functools
from typing import Any

import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import Array, lax

from jexplore.arrays import bits
from jexplore.raycast import Beams, Scan

ROOM = 2**16  # places in a table of maxima: two bytes hold one
# Cells: the table of such a radius takes 33.5 MB, for eight headings, and making it 100 MB; it grows with the square.
FARTHEST = 240


@struct.dataclass
class Spans:
    """The run of beams that enter each cell round a robot, for each of K headings.

    A run of n beams is covered by two runs of 2**k of them, which begin where it begins and end where it ends.
    """

    # [K, 2 A, 2 B] uint32, A = 2 R + 64, B = 2 R + 1, the robot's cell in row A and column B: where in the table of
    # maxima the run stands that begins with it, and in the upper half of the bits the one that ends with it
    places: Array
    rounds: bool = struct.field(pytree_node=False)  # whether a run may go on from the last beam to the first

    @property
    def radius(self) -> int:
        """R, cells: the farthest row and column of which they tell. Those beyond are such as no beam enters."""
        return (self.places.shape[-1] // 2 - 1) // 2


def spans_of(beams: Beams, radius: int) -> Spans | None:
    """`Spans` of a table of beams.

    Args:
      beams: `Beams` of numpy arrays. Host.
      radius: R. Cells that lie farther off are left out: at least as many rows and columns as any beam crosses, or as
        the map has.

    Returns:
      `Spans` of numpy arrays; None where the beams that enter a cell are no run of neighbours, or are too many, and for
      a radius beyond `FARTHEST`.

    Source:
      Bender and Farach-Colton 2000, range maxima by a sparse table.
    """
    if radius > FARTHEST:
        return None
    n_headings, n_beams = beams.length.shape
    side = 2 * radius + 1
    rows = [_runs(beams, heading, radius) for heading in range(n_headings)]
    if any(row is None for row in rows):
        return None
    first, size = (np.stack(a) for a in zip(*rows))
    rounds = bool((first + size > n_beams).any())
    width, level = (1 + rounds) * n_beams, np.frexp(np.maximum(size, 1))[1] - 1
    never = _levels(n_beams) * width  # and after it the robot's own cell
    if never + 2 > ROOM:
        return None
    places = np.where(size > 0, level * width + first + np.stack([0 * size, size - 2**level]), never)
    places[..., radius * side + radius] = never + 1
    begins, ends = places.astype(np.uint32).reshape(2, n_headings, side, side)
    (above, left), never = _margins(radius), np.uint32(never * (ROOM + 1))
    table = np.full((n_headings, 2 * above, 2 * left), never)
    table[:, above - radius : above + radius + 1, left - radius : left + radius + 1] = begins + np.uint32(ROOM) * ends
    # Ignored types: numpy on the host, where the record says what it is on the device.
    return Spans(table, rounds)  # type: ignore[arg-type]


def _margins(radius):
    """Rows above the robot's in a table, and columns left of it: what `reached` asks of lies within."""
    return 2 * radius + 2 * bits.WORD, 2 * radius + 1


def _levels(n_beams):
    """Levels of the table of maxima: those of 1, 2, 4, ... beams, at most all."""
    return n_beams.bit_length()


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


def reached(
    seen: Scan, when: Array | bool, pose: tuple[Any, Any, Any], spans: Spans, shape: tuple[int, ...]
) -> tuple[Array, tuple[Array, Array]]:
    """The cells of a map of which a scan tells something: those that beams pass, those that stop one, the robot's own.

    Args:
      seen: `Scan`, `[B]`, which stays inside the map.
      when: bool scalar; if False, there are none.
      pose: `(row, col, heading)` int32, where the scan was made. In a wall at the map's edge the answer is undefined.
      spans: `Spans`, of a radius within which every cell of the map lies that a beam comes to.
      shape: `(H, W)` of the map. Static.

    Returns:
      `(words, at)`: `[k, w]` uint32, packed, of that part of the map that a scan can change, and where in the packed
        map it begins, `(word, col)` int32.
    """
    (row, col, heading), radius, n_beams = pose, spans.radius, seen.end.shape[0]
    n_words = min(-(-shape[0] // bits.WORD), -(-(2 * radius + bits.WORD) // bits.WORD))
    width = min(shape[1], 2 * radius + 1)
    at = (
        jnp.clip((row - radius) // bits.WORD, 0, -(-shape[0] // bits.WORD) - n_words),
        jnp.clip(col - radius, 0, shape[1] - width),
    )
    of_words, first = (n_words, width), (at[0] * bits.WORD - row, at[1] - col)
    drow_of_word = lax.broadcasted_iota(jnp.int32, of_words, 0) * bits.WORD + first[0]
    dcol = lax.broadcasted_iota(jnp.int32, of_words, 1) + first[1]
    tops = _tops(jnp.where(when, seen.end + seen.hit, 0), n_beams, spans.rounds, when)
    corner = heading, *(n + margin for n, margin in zip(first, _margins(radius)))
    # Cut out in one, so that all rows of a word are found from one place.
    places = lax.dynamic_slice(spans.places, corner, (1, bits.WORD * n_words, width))
    places = places.reshape(n_words, bits.WORD, width)

    def bit(i):
        """Row i of every word, at its place."""
        own = places[:, i]
        top = jnp.maximum(_at(tops, own % ROOM), _at(tops, own // ROOM))
        # A beam enters a cell with that step by which it has crossed as many rows and columns as lie between.
        told = top.astype(jnp.int32) - jnp.abs(dcol) >= jnp.abs(drow_of_word + i)
        return jnp.where(told, jnp.uint32(1 << i), jnp.uint32(0))

    # Row by row, and not packed by a sum over rows: on an accelerator a fraction of the instructions.
    return functools.reduce(jnp.bitwise_or, map(bit, range(bits.WORD))), at


def _at(table, places):
    return table.at[places.astype(jnp.int32)].get(mode="promise_in_bounds")


def _tops(told, n_beams, rounds, when):
    """The table of maxima: for 1, 2, 4, ... neighbours from each beam on, the most cells that one of them tells of."""
    # Fewer bytes, and enough: a beam goes on by a row or a column with every step, and ends in the map, all of whose
    # cells that it can come to lie within the radius: after 2 `FARTHEST` steps at most, that which is stopped after one
    # more.
    told = told.astype(jnp.int16)
    top = jnp.concatenate([told, told]) if rounds else told
    levels = [top]
    for k in range(_levels(n_beams) - 1):
        top = jnp.maximum(top, jnp.pad(top[2**k :], (0, 2**k), constant_values=-1))
        top = lax.optimization_barrier(top)  # else each level would be made anew from the scan itself
        levels.append(top)
    return jnp.concatenate([*levels, jnp.stack([jnp.int16(-1), jnp.where(when, jnp.int16(0), jnp.int16(-1))])])
