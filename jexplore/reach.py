"""The reachability map: the cost of the shortest path from the robot to every cell, and the way there.

Costs are int32 fixed point, so that every algorithm, batch and device gives the same bits: 2**16 a straight step,
round(sqrt(2) * 2**16) a diagonal one. A diagonal step needs both cells beside it traversable. `reach` fills a whole map
with raster sweeps; `wave` grows a wavefront and stops as soon as the nearest goal is settled. Both end in the same
costs where both have settled.
"""

import jax
import jax.numpy as jnp
from jax import lax

from jexplore import bits
from jexplore.control import stored
from jexplore.grid import beside, bordered, count, lowest

STRAIGHT = 2**16
DIAGONAL = 92682  # round(sqrt(2) * 2**16)
FAR = 2**30  # not reached; larger than every cost. FAR + DIAGONAL fits int32, FAR + FAR does not and is never formed
ROUNDS = 4  # relaxations between two looks at what they changed
# Motions in the order that settles ties between equal predecessors: E, N, W, S, NE, NW, SW, SE.
MOTIONS = ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, -1), (-1, 1))
HEADING = (0, 2, 4, 6, 1, 3, 5, 7)  # heading of each motion, in units of 45 degrees, counter-clockwise from east
NO_MOTION = -1


def _motions_into(words):
    """For each motion, the cells into which a robot can make it: list of 8 packed masks, from the packed
    traversable cells.
    """
    diagonal = [words & bits.shifted(words, -drow, 0) & bits.shifted(words, 0, -dcol) for drow, dcol in MOTIONS[4:]]
    return [words] * 4 + diagonal


def _barriers(words):
    """For each motion 0 where a robot can make it into the cell and FAR where it cannot: list of 8 `[32 K, W]` int32.

    As a floor under the cost after the motion (a maximum), never as a summand: two FARs would overflow.
    """
    possible = stored(words[0, 0] >= 0, lambda: _motions_into(words)[3:])
    straight, *diagonal = (jnp.where(bits.unpack(m), 0, FAR) for m in possible)
    return [straight] * 4 + diagonal


def _relax(cost, barriers):
    """The cheapest cost of every cell after at most one more motion: `[H, W]` int32."""
    b = bordered(cost, FAR)
    straight = jnp.minimum(
        jnp.minimum(beside(b, 0, -1), beside(b, 0, 1)), jnp.minimum(beside(b, -1, 0), beside(b, 1, 0))
    )
    best = jnp.maximum(straight + STRAIGHT, barriers[0])
    for (drow, dcol), barrier in zip(MOTIONS[4:], barriers[4:]):
        best = jnp.minimum(best, jnp.maximum(beside(b, -drow, -dcol) + DIAGONAL, barrier))
    return jnp.minimum(cost, best)


def _source(shape, row, col):
    """FAR everywhere but 0 at one cell: `[H, W]` int32."""
    return lax.dynamic_update_slice(jnp.full(shape, FAR, jnp.int32), jnp.zeros((1, 1), jnp.int32), (row, col))


@jax.jit
def wave(traversable, goals, row, col, bound):
    """Costs from a cell outwards, as far as needed to settle the nearest goal.

    Args:
      traversable: `[H, W]` bool; the start need not be.
      goals: `[H, W]` bool.
      row, col: int32, start.
      bound: int32, cost at which to give up.

    Returns:
      `cost`: `[H, W]` int32. Exact wherever it is at most `settled`; elsewhere an upper bound, or FAR.
      `best`: int32, cost of the nearest goal if that is at most `settled`, else an upper bound, or FAR.
      `settled`: int32, every cell this near has its final cost: `bound` at least, unless a goal was settled earlier or
        nothing was left to reach (then FAR).

    Source:
      Bellman and Ford's relaxation; after t rounds every path of cost t straight steps, which has at most t motions,
      is in.
    """
    words = bits.pack(traversable)
    goals = jnp.pad(goals, ((0, bits.WORD * words.shape[0] - goals.shape[0]), (0, 0)))
    cost, best, settled = wave_packed(words, goals, row, col, bound)
    return cost[: traversable.shape[0]], best, settled


def wave_packed(words, goals, row, col, bound):
    """`wave` with packed traversable cells, `[K, W]` uint32; goals and costs are `[32 K, W]`."""
    barriers = _barriers(words)

    def under_way(state):
        settled, _, best, changed = state
        return changed & (best > settled) & (settled < bound)

    def grow(state):
        settled, cost, _, _ = state
        new = lax.fori_loop(0, ROUNDS, lambda _, cost: _relax(cost, barriers), cost)
        best = lowest(jnp.where(goals, new, FAR))
        changed = count(new != cost) > 0
        return settled + ROUNDS * STRAIGHT, new, best, changed

    first = jnp.where(goals[row, col], 0, FAR)
    start = (jnp.int32(0), _source(goals.shape, row, col), first, True)
    settled, cost, best, changed = lax.while_loop(under_way, grow, start)
    return cost, best, jnp.where(changed, settled, FAR)


def _sweep(cost, barriers, reverse):
    """Motions from each row into the next (or the one before, if `reverse`), row after row.

    One buffer, read and written in place a row at a time: half the time of a scan that stacks its rows.

    Args:
      cost: `[H + 2, W + 2]` int32, with a border of FAR.
      barriers: `[H, W]` int32, straight ahead; or three of them: also ahead and to higher columns, to lower columns.
      reverse: whether rows are taken from the last to the first. Static.
    """
    height, width = barriers[0].shape

    def row(i, cost):
        at = height - 1 - i if reverse else i
        before = lax.dynamic_slice(cost, (at + 2 if reverse else at, 0), (1, width + 2))
        best = lax.dynamic_slice(cost, (at + 1, 1), (1, width))
        steps = (before[:, 1:-1] + STRAIGHT, before[:, :-2] + DIAGONAL, before[:, 2:] + DIAGONAL)
        for step, barrier in zip(steps, barriers):
            best = jnp.minimum(best, jnp.maximum(step, lax.dynamic_slice(barrier, (at, 0), (1, width))))
        return lax.dynamic_update_slice(cost, best, (at + 1, 1))

    return lax.fori_loop(0, height, row, cost)


@jax.jit
def reach(traversable, row, col, goals=None):
    """Cost of the shortest path from a cell to every cell: the reachability map.

    Args:
      traversable: `[H, W]` bool; the start need not be.
      row, col: int32, start, inside the map.
      goals: `[H, W]` bool, or None. If given, only the cheapest goals are wanted: costs above theirs may not be final.

    Returns:
      `[H, W]` int32, 2**16 a straight step; FAR where no path leads, or none cheaper than FAR (16,384 straight steps;
      see `saturated`).

    Raises:
      ValueError: while tracing, if `traversable` is not a bool matrix.

    Source:
      Holz et al. 2010, section 2.2 (Dijkstra without a goal). Changed: raster sweeps to the fixpoint, exact because
      costs are integers.
    """
    if traversable.ndim != 2 or traversable.dtype != bool:
        raise ValueError(f"expected traversable: [H, W] bool, got {traversable.shape} {traversable.dtype}")
    words = bits.pack(traversable)
    if goals is not None:
        goals = jnp.pad(goals, ((0, bits.WORD * words.shape[0] - goals.shape[0]), (0, 0)))
    return reach_packed(words, row, col, goals)[: traversable.shape[0]]


def reach_packed(words, row, col, goals=None):
    """`reach` with packed traversable cells.

    Args:
      words: `[K, W]` uint32.
      row, col: int32, start.
      goals: `[32 K, W]` bool, or None.

    Returns:
      `[32 K, W]` int32.
    """
    straight, (ne, nw, sw, se) = (b := _barriers(words))[0], b[4:]
    across = (straight.T,)  # rows and columns exchanged: east is ahead

    def sweep(state):
        cost, _, n = state
        new = _sweep(_sweep(cost.T, across, reverse=False), across, reverse=True).T
        new = _sweep(_sweep(new, (straight, ne, nw), reverse=False), (straight, se, sw), reverse=True)
        # Costs depend on cheaper costs only: once no cost below the best goal's changes any more, the best goals are
        # settled.
        change = lowest(jnp.where(new != cost, new, FAR))
        best = FAR if goals is None else lowest(jnp.where(goals, new[1:-1, 1:-1], FAR))
        return new, change < best, n + 1

    # A path of n cells is settled after at most n sweeps.
    height, width = straight.shape
    cost = _source((height + 2, width + 2), row + 1, col + 1)
    cost, _, _ = lax.while_loop(lambda s: s[1] & (s[2] < height * width), sweep, (cost, True, jnp.int32(0)))
    return cost[1:-1, 1:-1]


def saturated(cost, traversable):
    """Cells one motion beyond those with a cost that hold FAR, because their cost would not fit.

    Args:
      cost: `[H, W]` int32, from `reach`.
      traversable: `[H, W]` bool.

    Returns:
      int32. 0 unless some path has 16,384 straight steps or more; what lies beyond is then out of reach.
    """
    reached, left = bits.pack(cost < FAR), bits.pack(cost == FAR)
    entered = jnp.zeros_like(left)
    for (drow, dcol), possible in zip(MOTIONS, _motions_into(bits.pack(traversable))):
        entered = entered | (left & possible & bits.shifted(reached, -drow, -dcol))
    return count(bits.unpack(entered, cost.shape[0]))


def _last_motion(cost, traversable):
    """The pinned predecessor rule, for cells given with their 3 x 3 neighbourhoods.

    Args:
      cost: `[3, 3, ...]` int32, of the cell (in the middle) and its neighbours; FAR outside the map.
      traversable: `[3, 3, ...]` bool; False outside the map.

    Returns:
      `[...]` int8: the first of `MOTIONS` by which the cell's cost arises; -1 where there is none.
    """
    matches = []
    for drow, dcol in MOTIONS:
        before = cost[1 - drow, 1 - dcol]
        step = DIAGONAL if drow and dcol else STRAIGHT
        beside = traversable[1 - drow, 1] & traversable[1, 1 - dcol] if drow and dcol else True
        matches.append((before < FAR) & (before + step == cost[1, 1]) & traversable[1, 1] & beside)
    motion = jnp.argmax(jnp.stack(matches), axis=0).astype(jnp.int8)
    return jnp.where(jnp.any(jnp.stack(matches), axis=0), motion, jnp.int8(NO_MOTION))


@jax.jit
def predecessors(cost, traversable):
    """The last motion of the shortest path to every cell.

    Among several that cost the same, the first in the order of `MOTIONS`: E, N, W, S, NE, NW, SW, SE.

    Args:
      cost: `[H, W]` int32, from `reach`, or the settled part of a `wave`.
      traversable: `[H, W]` bool, what `cost` was made from.

    Returns:
      `[H, W]` int8, index into `MOTIONS`; -1 at the start and where no path leads.

    Source:
      Holz et al. 2010, section 2.2.
    """
    b, t = bordered(cost, FAR), bordered(traversable, False)
    around = [[beside(a, drow, dcol) for drow in (-1, 0, 1) for dcol in (-1, 0, 1)] for a in (b, t)]
    return _last_motion(*(jnp.stack(a).reshape(3, 3, *cost.shape) for a in around))


def lay_route(route, cost, traversable, start, target, origin):
    """Writes the way from the start to a target into a map of motions: the path read-out.

    Args:
      route: `[H, W]` int8, index into `MOTIONS`; at each cell of the path the motion to its next cell is written, the
        rest stays.
      cost: `[h, w]` int32, from `reach` or `wave`, of a window of the map or of all of it.
      traversable: `[h, w]` bool, what `cost` was made from.
      start, target: `(row, col)` int32, in the map; both inside the window, `target` with a final cost.
      origin: `(row, col)` int32 of the window's cell (0, 0) in the map.

    Returns:
      `route`: `[H, W]` int8. Following it from the start ends at the target, after at most h * w motions.
    """
    cost, traversable = jnp.pad(cost, 1, constant_values=FAR), jnp.pad(traversable, 1)
    motions = jnp.asarray(MOTIONS, jnp.int32)

    def under_way(state):
        n, row, col, _ = state
        return ((row != start[0]) | (col != start[1])) & (n < cost.size)

    def back(state):
        n, row, col, route = state
        corner = row - origin[0], col - origin[1]
        motion = _last_motion(*(lax.dynamic_slice(a, corner, (3, 3)) for a in (cost, traversable)))
        row, col = row - motions[motion, 0], col - motions[motion, 1]
        return n + 1, row, col, lax.dynamic_update_slice(route, motion[None, None], (row, col))

    return lax.while_loop(under_way, back, (jnp.int32(0), target[0], target[1], route))[3]
