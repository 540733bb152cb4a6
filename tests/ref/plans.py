"""Oracle for planning: distances, reachability, paths, frontiers. Arrays are `[row, col]`, row 0 at the bottom."""

import heapq
import math

import numpy as np

FAR = 2**30
STRAIGHT = 2**16
DIAGONAL = round(math.sqrt(2) * 2**16)
# Motions as (drow, dcol), in the order that breaks ties: E, N, W, S, NE, NW, SW, SE.
MOTIONS = ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, -1), (-1, 1))


def radius2(radius_m, cell_m):
    """The largest squared distance, cells^2, that counts as within `radius_m`."""
    return math.floor((radius_m / cell_m) ** 2 + 1e-3)


def classify(hits, misses, p_free=0.25):
    """`(known, free, occupied)` of a reflection map: known = observed at all, free = known and p <= p_free."""
    known = hits + misses > 0
    p = hits / np.maximum(hits + misses, 1)
    return known, known & (p <= p_free), known & (p > p_free)


def nearest_site(sites):
    """Squared distance to the nearest site, cells^2, and the flat index of that site; ties to the lowest column, then
    row.

    `FAR` and -1 everywhere if there is no site.
    """
    d2 = np.full(sites.shape, FAR, np.int64)
    site = np.full(sites.shape, -1, np.int64)
    rows, cols = np.indices(sites.shape)
    for c, r in np.argwhere(sites.T):  # in the order that settles ties, so only a strictly nearer site replaces one
        here = (rows - r) ** 2 + (cols - c) ** 2
        nearer = here < d2
        d2[nearer] = here[nearer]
        site[nearer] = r * sites.shape[1] + c
    return d2, site


def disc(shape, row, col, r2):
    """Cells whose squared distance from `(row, col)` is at most `r2`."""
    rows, cols = np.indices(shape)
    return (rows - row) ** 2 + (cols - col) ** 2 <= r2


def clear(free, occupied_known, r2):
    """Free cells with no known occupied cell within squared distance `r2`, centre to centre."""
    reach = math.isqrt(r2)
    wide = np.pad(occupied_known, reach, constant_values=False)
    height, width = free.shape
    near_occupied = np.zeros(free.shape, bool)
    for dr in range(-reach, reach + 1):
        for dc in range(-reach, reach + 1):
            if dr * dr + dc * dc <= r2:
                near_occupied |= wide[reach + dr : reach + dr + height, reach + dc : reach + dc + width]
    return free & ~near_occupied


def traversable(free, occupied_known, driven, row, col, clear_r2, near_r2):
    """Clear cells, free cells near the robot at `(row, col)`, and driven cells, whatever is known of these."""
    return clear(free, occupied_known, clear_r2) | (free & disc(free.shape, row, col, near_r2)) | driven


def may_step(passable, row, col, motion):
    """Return whether a step is allowed: its end passable and, if diagonal, both orthogonal neighbours."""
    dr, dc = motion

    def at(r, c):
        return 0 <= r < passable.shape[0] and 0 <= c < passable.shape[1] and bool(passable[r, c])

    return at(row + dr, col + dc) and (dr == 0 or dc == 0 or (at(row + dr, col) and at(row, col + dc)))


def steps_from(passable, motion):
    """`may_step` from every cell at once."""
    height, width = passable.shape
    wide = np.pad(passable, 1, constant_values=False)

    def at(dr, dc):
        return wide[1 + dr : 1 + dr + height, 1 + dc : 1 + dc + width]

    dr, dc = motion
    return at(dr, dc) & at(dr, 0) & at(0, dc) if dr and dc else at(dr, dc).copy()


def step_cost(motion):
    """Fixed-point cost of a motion."""
    return DIAGONAL if motion[0] and motion[1] else STRAIGHT


def dijkstra(passable, start):
    """Reachability map: `(cost, pred)` of every cell from `start`, a passable `(row, col)`.

    `cost`: int64, `FAR` where there is no way that costs less. `pred`: flat index of the cell before it on the way; -1
    at the start and where there is no way. Among equal predecessors the first in the order of `MOTIONS` (motion into
    the cell) is taken.
    """
    if not passable[start]:
        raise ValueError(f"expected a passable start, got {start}")
    width = passable.shape[1]
    allowed = [steps_from(passable, motion) for motion in MOTIONS]
    ways = [(dr * width + dc, step_cost((dr, dc)), may.ravel().tolist()) for (dr, dc), may in zip(MOTIONS, allowed)]
    costs = [FAR] * passable.size
    here = start[0] * width + start[1]
    costs[here] = 0
    queue = [(0, here)]
    while queue:
        d, i = heapq.heappop(queue)
        if d > costs[i]:
            continue
        for offset, step, may in ways:
            if may[i] and d + step < costs[i + offset]:
                costs[i + offset] = d + step
                heapq.heappush(queue, (d + step, i + offset))

    cost = np.array(costs, np.int64).reshape(passable.shape)
    pred = np.full(passable.shape, -1, np.int64)
    for motion, may in list(zip(MOTIONS, allowed))[::-1]:  # the first in the order comes last, and stays
        row, col = np.nonzero(may & (cost < FAR))
        end = row + motion[0], col + motion[1]
        ours = cost[row, col] + step_cost(motion) == cost[end]
        pred[end[0][ours], end[1][ours]] = (row * width + col)[ours]
    return cost, pred


def follow(route, start, target):
    """Cells of a route after its start, and what they cost; `route` has the motion out of each of its cells."""
    cells, cost, (row, col) = [], 0, start
    while (row, col) != target:
        assert route[row, col] >= 0
        motion = MOTIONS[route[row, col]]
        row, col, cost = row + motion[0], col + motion[1], cost + step_cost(motion)
        cells.append((row, col))
        assert len(cells) <= route.size
    return cells, cost


def path(pred, start, target):
    """Cells of the way from `start` (left out) to `target`, as `(row, col)`; empty if they are the same cell."""
    cells = []
    cell = tuple(target)
    while cell != tuple(start):
        cells.append(cell)
        if pred[cell] < 0:
            raise ValueError(f"expected a reachable target, got {tuple(target)}")
        cell = divmod(int(pred[cell]), pred.shape[1])
    return cells[::-1]


def beside_unknown(known, connectivity=8):
    """Cells with an unknown one among 8 or 4 neighbours; what lies outside the array is never unknown."""
    height, width = known.shape
    unknown = np.pad(~known, 1, constant_values=False)
    out = np.zeros(known.shape, bool)
    for dr, dc in MOTIONS[:connectivity]:
        out |= unknown[1 + dr : 1 + dr + height, 1 + dc : 1 + dc + width]
    return out


def frontier(clear_cells, cost, known, exhausted, connectivity=8, least=1):
    """Cells that are clear, reachable, adjacent to an unknown cell, not exhausted, in a group that is not too small."""
    cells = clear_cells & beside_unknown(known, connectivity) & ~exhausted
    if least == 1:
        return cells & (cost < FAR)
    group = clusters(cells)
    sizes = np.bincount(group[cells], minlength=1)
    return cells & (cost < FAR) & (sizes[group] >= least)


def closest(targets, cost):
    """Flat index of the cheapest target, ties to the lowest index; -1 for none."""
    flat = np.flatnonzero(targets)
    if not flat.size:
        return -1
    return int(min(flat, key=lambda i: (cost.flat[i], i)))


def clusters(frontier_cells):
    """8-connected components: a number from 0 for each, in the order of their lowest flat index; -1 elsewhere."""
    height, width = frontier_cells.shape
    label = np.full(frontier_cells.shape, -1, np.int64)
    count = 0
    for seed in map(tuple, np.argwhere(frontier_cells)):
        if label[seed] >= 0:
            continue
        label[seed] = count
        stack = [seed]
        while stack:
            row, col = stack.pop()
            for dr, dc in MOTIONS:
                r, c = row + dr, col + dc
                if 0 <= r < height and 0 <= c < width and frontier_cells[r, c] and label[r, c] < 0:
                    label[r, c] = count
                    stack.append((r, c))
        count += 1
    return label
