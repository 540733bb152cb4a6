"""Other answers that the kernels are compared with: by scipy and scikit-image, and plain loops compiled by numba.

scikit-image and numba are used where they are installed.
"""

import math
from typing import Any

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse import csgraph

try:
    # Ignored types, here and below: an extra that need not be installed; scipy and skimage, which say too little.
    from numba import njit  # type: ignore[import-not-found]

    NATIVE = True
except ImportError:
    NATIVE = False

    def njit(function: Any) -> Any:
        """Return the loops unchanged if numba is missing: the same answers, but not worth timing."""
        return function


try:
    import skimage  # type: ignore[import-not-found]

    SKIMAGE = True
except ImportError:
    skimage: Any = None
    SKIMAGE = False

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
def dijkstra(traversable: np.ndarray, row: int, col: int, goals: np.ndarray, stop: bool) -> tuple[np.ndarray, int]:
    """Run Dijkstra's algorithm with a binary heap; a diagonal step needs both orthogonal neighbours traversable.

    Args:
      traversable, goals: `[H, W]` bool.
      row, col: start, which need not be traversable.
      stop: end as soon as the nearest goal is settled; else fill the map.

    Returns:
      `cost`: `[H, W]` int32; FAR where no path leads, and at first where `stop` ended the search.
      `target`: flat index of the nearest goal, the lowest among equals; -1 without one.
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
def walk(
    occupied: np.ndarray,
    offset: np.ndarray,
    length: np.ndarray,
    cells: np.ndarray,
    headings: np.ndarray,
    hits: np.ndarray,
    misses: np.ndarray,
    update: bool,
) -> tuple[np.ndarray, int]:
    """Cast scans, beam by beam and cell by cell along the beam table; count them into a map if `update`.

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


def masks(
    hits: np.ndarray,
    misses: np.ndarray,
    driven: np.ndarray,
    exhausted: np.ndarray,
    inside: np.ndarray,
    row: int | np.int32,
    col: int | np.int32,
    *,
    p_free: float,
    near_d2: int,
    clearance_d2: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Compute traversable and frontier cells by scipy, arguments as for `frontier.plan_masks`: two `[H, W]` bool."""

    def near_walls(occupied):
        if not occupied.any():
            return occupied
        distance = np.asarray(ndimage.distance_transform_edt(~occupied))
        return np.rint(distance**2) <= clearance_d2

    def beside(mask):
        return ndimage.binary_dilation(mask, np.ones((3, 3), bool))

    return _masks(hits, misses, driven, exhausted, inside, row, col, p_free, near_d2, near_walls, beside)


def masks_skimage(
    hits: np.ndarray,
    misses: np.ndarray,
    driven: np.ndarray,
    exhausted: np.ndarray,
    inside: np.ndarray,
    row: int | np.int32,
    col: int | np.int32,
    *,
    p_free: float,
    near_d2: int,
    clearance_d2: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the same by scikit-image: clearance as a dilation by a disc."""
    radius = math.isqrt(clearance_d2)
    rows, cols = np.ogrid[-radius : radius + 1, -radius : radius + 1]
    disc = rows**2 + cols**2 <= clearance_d2

    def near_walls(occupied):
        return skimage.morphology.dilation(occupied, disc)

    def beside(mask):
        return skimage.morphology.dilation(mask, np.ones((3, 3), bool))

    return _masks(hits, misses, driven, exhausted, inside, row, col, p_free, near_d2, near_walls, beside)


def _masks(hits, misses, driven, exhausted, inside, row, col, p_free, near_d2, near_walls, beside):
    seen = hits + misses
    occupied = (seen > 0) & (hits.astype(np.float32) > np.float32(p_free) * seen.astype(np.float32))
    free = (seen > 0) & ~occupied
    clear = free & ~near_walls(occupied)
    rows, cols = np.ogrid[: free.shape[0], : free.shape[1]]
    near = (rows - row) ** 2 + (cols - col) ** 2 <= near_d2
    return clear | (free & near) | driven, clear & beside(inside & (seen == 0)) & ~exhausted


def clusters(frontier: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute 8-connected groups by scipy, as `in_order`."""
    labels, count = ndimage.label(frontier, np.ones((3, 3), int))  # type: ignore[misc]
    return in_order(labels, count)


def clusters_skimage(frontier: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the same by scikit-image."""
    labels, count = skimage.measure.label(frontier, connectivity=2, return_num=True)  # type: ignore[misc]
    return in_order(labels, count)


def in_order(labels: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Renumber labels 1 to count (0: none) in the order of their lowest flat index (-1: none), and return sizes."""
    first = np.full(count + 1, labels.size)
    np.minimum.at(first, labels.reshape(-1), np.arange(labels.size))
    order = np.full(count + 1, -1)
    order[1 + np.argsort(first[1:])] = np.arange(count)
    labels = order[labels]
    return labels, np.bincount(labels[labels >= 0], minlength=count)


def motion_graph(traversable: np.ndarray) -> Any:
    """Build the graph of cells and motions with their cost: a scipy sparse matrix `[H * W, H * W]`, float64."""
    height, width = traversable.shape
    index = np.arange(height * width).reshape(height, width)
    ends, costs = [], []
    for drow, dcol in ((0, 1), (1, 0), (1, 1), (1, -1)):
        rows, cols = slice(0, height - drow), slice(max(-dcol, 0), width - max(dcol, 0))
        to_rows, to_cols = slice(drow, height), slice(max(dcol, 0), width - max(-dcol, 0))
        possible = traversable[rows, cols] & traversable[to_rows, to_cols]
        if drow and dcol:
            possible &= traversable[rows, to_cols] & traversable[to_rows, cols]
        a, b = index[rows, cols][possible], index[to_rows, to_cols][possible]
        ends += [(a, b), (b, a)]
        costs += 2 * [np.full(len(a), DIAGONAL if drow and dcol else STRAIGHT, np.float64)]
    a, b = (np.concatenate([pair[i] for pair in ends]) for i in (0, 1))
    return sparse.csr_matrix((np.concatenate(costs), (a, b)), shape=(index.size, index.size))


def graph_costs(graph: Any, shape: tuple[int, int], row: int, col: int) -> np.ndarray:
    """Run scipy's Dijkstra on a `motion_graph`, from a traversable cell: `[H, W]` int32, FAR as above."""
    cost = csgraph.dijkstra(graph, indices=row * shape[1] + col)
    return np.where(np.isinf(cost), FAR, cost).astype(np.int32).reshape(shape)


def flooded(clear: np.ndarray, row: int, col: int) -> np.ndarray:
    """Return the 4-connected component of a True cell, by scipy: `[H, W]` bool.

    A diagonal step needs both orthogonal neighbours, so that steps in 8 directions lead no further.
    """
    labels = np.asarray(ndimage.label(clear)[0])  # type: ignore[index]
    return labels == labels[row, col]


def flooded_skimage(clear: np.ndarray, row: int, col: int) -> np.ndarray:
    """Compute the same by scikit-image."""
    return skimage.segmentation.flood(clear, (row, col), connectivity=1)
