"""Slow or native answers that the kernels are compared with: plain loops, compiled by numba where it is installed."""

import numpy as np
from scipy import ndimage

try:
    from numba import njit

    NATIVE = True
except ImportError:
    NATIVE = False

    def njit(function):
        """Without numba the loops run as they are: the same answers, but not worth timing."""
        return function


STRAIGHT, DIAGONAL, FAR = 2**16, 92682, 2**30


@njit
def _push(heap, size, item):
    at = size
    while at > 0:
        up = (at - 1) // 2
        if heap[up] <= item:
            break
        heap[at] = heap[up]
        at = up
    heap[at] = item
    return size + 1


@njit
def _pop(heap, size):
    top, size = heap[0], size - 1
    item, at = heap[size], 0
    while True:
        down = 2 * at + 1
        if down >= size:
            break
        if down + 1 < size and heap[down + 1] < heap[down]:
            down += 1
        if heap[down] >= item:
            break
        heap[at] = heap[down]
        at = down
    heap[at] = item
    return top, size


@njit
def dijkstra(traversable, row, col, goals, stop):
    """Dijkstra's algorithm with a binary heap; a diagonal step needs both cells beside it traversable.

    Args:
      traversable, goals: `[H, W]` bool.
      row, col: start, which need not be traversable.
      stop: end as soon as the nearest goal is settled; else fill the map.

    Returns:
      `cost`: `[H, W]` int32; FAR where no path leads, and at first where `stop` ended the search.
      `target`: flat index of the nearest goal, the lowest among equals; -1 if there is none.
    """
    height, width = traversable.shape
    cost = np.full((height, width), FAR, np.int32)
    heap = np.empty(8 * height * width + 1, np.int64)  # cost * 2^24 + flat index: ties leave in the order of the index
    cost[row, col] = 0
    size = _push(heap, 0, row * width + col)
    while size > 0:
        item, size = _pop(heap, size)
        here, at = item >> 24, item & (2**24 - 1)
        r, c = at // width, at % width
        if here > cost[r, c]:
            continue
        if stop and goals[r, c]:
            return cost, at
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                y, x = r + dr, c + dc
                if (dr == 0 and dc == 0) or y < 0 or y >= height or x < 0 or x >= width or not traversable[y, x]:
                    continue
                step = STRAIGHT
                if dr != 0 and dc != 0:
                    if not (traversable[r, x] and traversable[y, c]):
                        continue
                    step = DIAGONAL
                if here + step < cost[y, x]:
                    cost[y, x] = here + step
                    size = _push(heap, size, (here + step) * 2**24 + y * width + x)
    return cost, -1


@njit
def walk(occupied, offset, length, cells, headings, hits, misses, update):
    """Scans, beam by beam and cell by cell along the beam table; counted into a map if `update`.

    Args:
      occupied: `[N]` bool, flat.
      offset: `[K, S, B]` int32; length: `[K, B]` int32, as in `raycast.Beams`.
      cells, headings: `[n]` int32, flat index of the cell where each scan is made, and its heading.
      hits, misses: `[N]` int32, changed in place.

    Returns:
      `end`: `[n, B]` int32, cells passed.
      `visited`: cells looked at in all scans.
    """
    n, n_beams = len(cells), length.shape[1]
    end = np.zeros((n, n_beams), np.int32)
    visited = 0
    for i in range(n):
        here, k = cells[i], headings[i]
        if update:
            misses[here] += 1
        for b in range(n_beams):
            step = 0
            while step < length[k, b]:
                at = here + offset[k, step, b]
                visited += 1
                if occupied[at]:
                    if update:
                        hits[at] += 1
                    break
                if update:
                    misses[at] += 1
                step += 1
            end[i, b] = step
    return end, visited


def masks(hits, misses, driven, exhausted, inside, row, col, *, p_free, near_d2, clearance_d2):
    """Traversable and frontier cells by scipy, arguments as for `frontier.plan_masks`: two `[H, W]` bool."""
    seen = hits + misses
    occupied = (seen > 0) & (hits.astype(np.float32) > np.float32(p_free) * seen.astype(np.float32))
    free = (seen > 0) & ~occupied
    clear = free.copy()
    if occupied.any():
        clear &= np.rint(ndimage.distance_transform_edt(~occupied) ** 2) > clearance_d2
    rows, cols = np.ogrid[: free.shape[0], : free.shape[1]]
    near = (rows - row) ** 2 + (cols - col) ** 2 <= near_d2
    frontier = clear & ndimage.binary_dilation(inside & (seen == 0), np.ones((3, 3), bool)) & ~exhausted
    return clear | (free & near) | driven, frontier


def clusters(frontier):
    """8-connected groups by scipy: labels in the order of lowest flat index (-1 elsewhere), and sizes."""
    labels, count = ndimage.label(frontier, np.ones((3, 3), int))
    first = np.full(count + 1, frontier.size)
    np.minimum.at(first, labels.reshape(-1), np.arange(frontier.size))
    order = np.full(count + 1, -1)
    order[1 + np.argsort(first[1:])] = np.arange(count)
    labels = order[labels]
    return labels, np.bincount(labels[labels >= 0], minlength=count)
