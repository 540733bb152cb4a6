"""The reachability map: the cost of the shortest path from the robot to every cell, and its predecessors.

Costs are int32 fixed point, so that every algorithm, batch and device gives the same bits: 2**16 a straight step,
round(sqrt(2) * 2**16) a diagonal one. A diagonal step needs both orthogonal neighbours traversable.
"""

from collections.abc import Sequence
from typing import Any

import chex
import jax
import jax.numpy as jnp
from jax import Array, lax

from jexplore.arrays import bits
from jexplore.arrays.loops import one_kernel, stored
from jexplore.grid import bordered, count

STRAIGHT = 2**16
DIAGONAL = 92682  # round(sqrt(2) * 2**16)
FAR = 2**30  # not reached; larger than every cost. FAR + DIAGONAL fits int32, FAR + FAR does not and is never formed
# Motions in the order that settles ties between equal predecessors: E, N, W, S, NE, NW, SW, SE.
MOTIONS = ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, -1), (-1, 1))
HEADING = (0, 2, 4, 6, 1, 3, 5, 7)  # heading of each motion, in units of 45 degrees, counter-clockwise from east
NO_MOTION = -1
STEPS = (STRAIGHT, DIAGONAL)


def motions_into(words: Array) -> list[Array]:
    """Return the cells into which a robot can make each motion: list of 8 packed masks, from traversable cells."""
    diagonal = [words & bits.shifted(words, -drow, 0) & bits.shifted(words, 0, -dcol) for drow, dcol in MOTIONS[4:]]
    return [words] * 4 + diagonal


def _sweep(
    cost: Array,
    possible: Sequence[Array],
    rows: tuple[Array, Array],
    steps: tuple[int, int],
    extra: Array | None,
    reverse: bool,
) -> Array:
    """Move from each row into the next (or the one before, if `reverse`), row after row.

    One buffer, read and written in place a row at a time: half the time of a scan that stacks its rows.

    Args:
      cost: `[H + 2, W + 2]` int32, with a border of FAR.
      possible: three of `[H / 32, W]` uint32, the cells into which a robot can move straight ahead, ahead and to higher
        columns, ahead and to lower columns. Packed, as a barrier of a whole map costs more to make than to use.
      rows: `(first, last)` int32, rows to be entered.
      steps: costs of a straight and a diagonal step. Static.
      extra: `[H, W]` int32, what it costs to enter each cell besides; None for nothing.
      reverse: whether rows are taken from the last to the first. Static.
    """
    width = cost.shape[1] - 2

    def row(i: Array, cost: Array) -> Array:
        at = rows[0] + rows[1] - i if reverse else i
        before = lax.dynamic_slice(cost, (at + 2 if reverse else at, 0), (1, width + 2))
        best = lax.dynamic_slice(cost, (at + 1, 1), (1, width))
        after = [before[:, 1:-1] + steps[0], before[:, :-2] + steps[1], before[:, 2:] + steps[1]]
        if extra is not None:
            after = [step + lax.dynamic_slice(extra, (at, 0), (1, width)) for step in after]
        for step, words in zip(after, possible):
            here = lax.dynamic_slice(words, (at // bits.WORD, 0), (1, width)) >> jnp.uint32(at % bits.WORD)
            best = jnp.minimum(best, jnp.where(here & 1 != 0, step, FAR))
        return lax.dynamic_update_slice(cost, best, (at + 1, 1))

    return lax.fori_loop(rows[0], rows[1] + 1, row, cost)


def _lowest_change(
    cost: Array,
    motions: Sequence[Array],
    goals: Array | None,
    rows: tuple[Array, Array],
    steps: tuple[int, int],
    extra: Array | None,
) -> tuple[Array, Array]:
    """Return the least cost that one more motion lowers, and the cheapest goal, FAR for none: `(int32, int32)`.

    Row by row, of motions only those that a sweep to lower rows has not made. `cost`, `steps`, `extra` as for `_sweep`;
    `motions` from `motions_into`; `goals` `[H, W]` bool, or None; `rows` `(first, last)` int32, that are looked at.
    """
    width = cost.shape[1] - 2

    def row(i: Array, lows: list[Array]) -> list[Array]:
        before, own = (lax.dynamic_slice(cost, (i + k, 0), (1, width + 2)) for k in (0, 1))
        straight, ne, nw = (
            lax.dynamic_slice(motions[k], (i // bits.WORD, 0), (1, width)) >> jnp.uint32(i % bits.WORD) & 1 != 0
            for k in (0, 4, 5)
        )
        beside_it = jnp.minimum(jnp.minimum(own[:, :-2], own[:, 2:]), before[:, 1:-1]) + steps[0]
        after = jnp.where(straight, beside_it, FAR)
        after = jnp.minimum(after, jnp.where(ne, before[:, :-2] + steps[1], FAR))
        after = jnp.minimum(after, jnp.where(nw, before[:, 2:] + steps[1], FAR))
        if extra is not None:
            after = after + lax.dynamic_slice(extra, (i, 0), (1, width))
        here = own[:, 1:-1]
        found = [jnp.where(after < here, after, FAR)]
        if goals is not None:
            found.append(jnp.where(lax.dynamic_slice(goals, (i, 0), (1, width)), here, FAR))
        return [jnp.minimum(low, new) for low, new in zip(lows, found)]

    none = [jnp.full((1, width), FAR, jnp.int32)] * (1 if goals is None else 2)
    lows = [jnp.min(low) for low in lax.fori_loop(rows[0], rows[1] + 1, row, none)]
    return lows[0], jnp.int32(FAR) if goals is None else lows[1]


@jax.jit
def reach(traversable: Array, row: Array | int, col: Array | int) -> Array:
    """Compute the cost of the shortest path from a cell to every cell: the reachability map.

    Args:
      traversable: `[H, W]` bool; the start need not be.
      row, col: int32, start, inside the map.

    Returns:
      `[H, W]` int32, 2**16 a straight step; FAR where no path leads, or none cheaper than FAR (16,384 straight steps;
      see `saturated`).

    Raises:
      AssertionError: while tracing, if `traversable` is not a bool matrix.

    Source:
      Holz et al. 2010, section 2.2 (Dijkstra without a goal). Changed: relaxed to the fixpoint, exact because costs are
      integers, row by row.
    """
    chex.assert_rank(traversable, 2)
    chex.assert_type(traversable, bool)
    return spread(bits.pack(traversable), at=(row, col))[: traversable.shape[0]]


def nearest_source(traversable: Array, sources: Array, n: int) -> Array:
    """Return the nearest of many sources, along paths.

    Args:
      traversable: `[H, W]` bool.
      sources: `[H, W]` int32, number of the source in each cell, at least 0 and less than n; -1 elsewhere.
      n: sources, at most 4096. Static.

    Returns:
      `[H, W]` int32, number of the nearest source; -1 where no path leads. Equally near ones: the lowest. Lengths
        are in units of which a straight step has 70 and a diagonal one 99 (sqrt(2) to 1 in 10,000); a path of more than
        2**30 / 70 / n straight steps, n rounded up to a power of two, does not count.
    """
    # A cost and a source in one number: its lowest bits are the source's.
    scale = 2 ** max(n - 1, 1).bit_length()
    start = jnp.where(sources >= 0, sources, FAR)
    cost = spread(bits.pack(traversable), start, steps=(70 * scale, 99 * scale))[: start.shape[0]]
    return jnp.where(cost < FAR, cost % scale, -1)


def spread(
    words: Array,
    start: Array | None = None,
    *,
    at: tuple[Array | int, Array | int] = (0, 0),
    goals: Array | None = None,
    limit: Array | int = FAR,
    steps: tuple[int, int] = STEPS,
    extra: Array | None = None,
) -> Array:
    """Compute costs of the cheapest paths: `[32 K, W]` int32, FAR where no path leads.

    Args:
      words: `[K, W]` uint32, packed traversable cells.
      start: `[H, W]` int32, initial costs, FAR elsewhere; None for 0 at one cell. H is up to 32 K, here and below.
      at: `(row, col)` int32, that cell.
      goals: `[H, W]` bool, or None: costs above that of the cheapest goal may not be final. None with `start`.
      limit: costs above this may not be final either. FAR with `start`.
      steps: costs of a straight and a diagonal step. Static.
      extra: `[H, W]` int32, what it costs to enter each cell besides, at most `FAR - 1`; None for nothing.
    """

    def run(words: Array, start: Array | None, at: Any, goals: Array | None, limit: Any, extra: Array | None) -> Array:
        return _sweeps(words, start, at, goals, limit, steps, extra)

    return one_kernel(run, words, start, at, goals, jnp.int32(limit), extra)


def _sweeps(
    words: Array,
    start: Array | None,
    at: tuple[Array | int, Array | int],
    goals: Array | None,
    limit: Array,
    steps: tuple[int, int],
    extra: Array | None,
) -> Array:
    """Compute `spread` row by row in turn upwards, downwards, and across."""
    given_width = words.shape[1]
    words = jnp.pad(words, ((0, 0), (0, -given_width % bits.WORD)))
    height, width = bits.WORD * words.shape[0], words.shape[1]

    def padded(array: Array | None, fill: int) -> Array | None:
        if array is None or array.shape == (height, width):
            return array
        more = (0, height - array.shape[0]), (0, width - array.shape[1])
        return jnp.pad(array, more, constant_values=fill)

    start, goals, extra = padded(start, FAR), padded(goals, False), padded(extra, 0)

    def prepare() -> Any:
        across = bits.transposed(words)
        return motions_into(words), motions_into(across), _extent(across), _extent(words)

    motions, across, rows, cols = stored(words[0, 0] >= 0, prepare)

    def up_and_down(cost: Array, motions: Sequence[Array], within: Any, extra: Array | None) -> Array:
        ahead, (ne, nw, sw, se) = motions[0], motions[4:]
        cost = _sweep(cost, (ahead, ne, nw), within, steps, extra, reverse=False)
        return _sweep(cost, (ahead, se, sw), within, steps, extra, reverse=True)

    def near(extent: tuple[Array, Array], middle: Array | int, far: Array) -> tuple[Array, Array]:
        return jnp.maximum(extent[0], middle - far), jnp.minimum(extent[1], middle + far)

    def sweep(state: Any) -> Any:
        cost, far, _, n = state
        own = near(rows, at[0], far)
        cost = up_and_down(cost.T, across, near(cols, at[1], far), None if extra is None else extra.T).T
        cost = up_and_down(cost, motions, own, extra)
        # Costs depend on cheaper costs only: once one more motion makes no cost lower up to the horizon, all costs up
        # to there are final. Rows further away hold none of these, for the horizon never grows.
        seen = jnp.minimum(own[0], at[0]), jnp.maximum(own[1], at[0])
        change, best = _lowest_change(cost, motions, goals, seen, steps, extra)
        horizon = jnp.minimum(limit, best)
        # How far the horizon lies is known from a single start only.
        far = horizon // steps[0] if start is None else far
        return cost, far, (change <= horizon) & (change < FAR), n + 1

    if start is None:
        cost = jnp.full((height + 2, width + 2), FAR, jnp.int32)
        cost = lax.dynamic_update_slice(cost, jnp.zeros((1, 1), jnp.int32), (at[0] + 1, at[1] + 1))
    else:
        cost = bordered(start, FAR)
    # A path of n cells is settled after at most n sweeps.
    state: Any = cost, limit // STRAIGHT if start is None else jnp.int32(FAR), limit >= 0, jnp.int32(0)
    cost = lax.while_loop(lambda s: s[2] & (s[3] < height * width), sweep, state)[0]
    return cost[1:-1, 1 : 1 + given_width]


def flood(words: Array, row: Array | int, col: Array | int) -> Array:
    """Return the cells that a path reaches, however long, the start among them: `[K, W]` uint32, packed.

    `words` are packed traversable cells; the start need not be one.
    """
    at = jnp.stack([lax.broadcasted_iota(jnp.int32, words.shape, axis) for axis in (0, 1)])
    here = (at[0] == row // bits.WORD) & (at[1] == col)
    start = jnp.where(here, jnp.uint32(1) << jnp.uint32(row % bits.WORD), jnp.uint32(0))
    # Straight motions do: a diagonal one needs both orthogonal neighbours.
    return one_kernel(bits.filled, words | start, start)


def _extent(words: Array) -> tuple[Array, Array]:
    """Return the `(first, last)` column with a True cell; `last < first` without one. int32 scalars."""
    width = words.shape[1]
    used, at = jnp.any(words != 0, axis=0), lax.iota(jnp.int32, width)
    return jnp.min(jnp.where(used, at, width)), jnp.max(jnp.where(used, at, -1))


def saturated(cost: Array, traversable: Array) -> Array:
    """Count cells one motion beyond those with a cost that hold FAR, because their cost would not fit: int32.

    It is 0 unless some path has 16,384 straight steps or more; what lies beyond is then out of reach. `cost` is from
    `reach`.
    """
    reached, left, can = (bits.pack(mask) for mask in (cost < FAR, cost == FAR, traversable))
    entered = jnp.zeros_like(left)
    for (drow, dcol), possible in zip(MOTIONS, motions_into(can)):
        entered = entered | (left & possible & bits.shifted(reached, -drow, -dcol))
    return count(bits.unpack(entered, cost.shape[0]))
