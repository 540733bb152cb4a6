"""The rules that DARE's test maps are explored by: maps, scanner, frontiers, graph of nodes, utility, end.

Plain numpy on the host, one map at a time. Cells are `(row, col)` with row 0 at the TOP, as in the pictures.

Source: Cao, Lew, Liang, Cheng, Sartoretti, "DARE: Diffusion Policy for Autonomous Robot Exploration", ICRA 2025,
section V, and where its text leaves a rule open the public repositories marmotlab/DARE and marmotlab/CogniPlan.
"""

import dataclasses
import functools
import itertools
import math
import os
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError
from scipy import ndimage
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from jexplore.config import InputError

CELL_M = 0.4
PIXELS = 500  # edge of a map; a cell is 2 x 2 of them
START = 208  # grey of the pixels round the start, of which
WHICH = 10  # this one, counted from 0 row by row, is the start
RANGE = 50  # of the scanner, cells: 20 m
BEAMS = 720
STEP = 10  # between nodes, cells: 4 m
SIGHT = 40  # within which a node's frontier cells count, cells: 16 m
VOXEL = 4  # edge of the squares that keep one frontier cell each, cells: 1.6 m
LEAST = 2  # frontier cells of a node: fewer count as none
UNKNOWN, FREE, OCCUPIED = 0, 1, 2
PAD = RANGE + 1  # occupied cells round a map: no beam leaves the arrays
ROUND = [(i, j) for i, j in itertools.product(range(-2, 3), repeat=2) if (i, j) != (0, 0)]
"""Nodes that a node may be linked to, as steps of `STEP` cells."""


class Scanner(NamedTuple):
    """The cells that a beam enters into the belief."""

    is_wide: bool
    """The 3 x 3 cells round every cell of a beam, not that cell alone."""
    depth: int
    """Occupied cells that a beam enters at most, one behind another."""


SCANNERS = {
    "dare": Scanner(is_wide=True, depth=1),  # marmotlab/DARE
    "ariadne": Scanner(is_wide=False, depth=9),  # marmotlab/ARiADNE, HDPlanner_Exp_and_Nav, CogniPlan
    "bare": Scanner(is_wide=False, depth=1),  # DARE's without the cells round a beam
}
"""Scanners of the public code of the same group."""


def read_map(path: str | os.PathLike[str]) -> tuple[NDArray[np.bool_], tuple[int, int]]:
    """Read a test map: `[250, 250]` bool, True where a cell is free, and the start.

    Raises:
      InputError: no picture, one of another size or without start pixels.
    """
    try:
        with Image.open(path) as picture:
            grey = np.asarray(picture.convert("L"))
    except (OSError, UnidentifiedImageError) as error:
        raise InputError(f"{path} must be a picture of a test map: {error}") from None
    if grey.shape != (PIXELS, PIXELS):
        raise InputError(f"{path} must have {PIXELS} x {PIXELS} pixels, not {grey.shape[1]} x {grey.shape[0]}")
    cells = grey.reshape(PIXELS // 2, 2, PIXELS // 2, 2).min(axis=(1, 3))
    starts = np.argwhere(cells == START)
    if len(starts) <= WHICH:
        raise InputError(f"{path} must show its start by more than {WHICH} cells of grey {START}, not {len(starts)}")
    return (cells > 150) | ((cells >= 50) & (cells <= 80)), (int(starts[WHICH][0]), int(starts[WHICH][1]))


@functools.cache
def lines() -> NDArray[np.int16]:
    """Tabulate straight lines of cells: `[R, R, L, 2]` offsets (row, col) to every offset within `RANGE`.

    Four-connected (Bresenham), the start first, without the end; then the start again, up to the length of the longest.
    """
    ends = np.stack(np.meshgrid(*[np.arange(-RANGE, RANGE + 1)] * 2, indexing="ij"), -1)
    size, sign = np.abs(ends), np.where(ends > 0, 1, -1)
    at, error = np.zeros_like(ends), size[..., 1] - size[..., 0]
    n = 2 * RANGE
    found = np.zeros((*ends.shape[:2], n, 2), np.int16)
    for i in range(n):
        on_way = (at != ends).any(-1)
        found[:, :, i] = np.where(on_way[..., None], at, 0)
        across = error > 0
        at[..., 1] += np.where(across, sign[..., 1], 0)
        at[..., 0] += np.where(across, 0, sign[..., 0])
        error = error + np.where(across, -2 * size[..., 0], 2 * size[..., 1])
        at = np.where(on_way[..., None], at, ends)
    return found


def in_sight(free: NDArray[np.bool_], cell: NDArray[np.int_], others: NDArray[np.int_]) -> NDArray[np.bool_]:
    """Tell which of `[N, 2]` cells within `RANGE` a cell sees: all cells of the line but its end are free."""
    to = others - cell
    path = lines()[to[:, 0] + RANGE, to[:, 1] + RANGE]
    return np.all(free[cell[0] + path[..., 0], cell[1] + path[..., 1]], axis=1)


@functools.cache
def beams() -> NDArray[np.int16]:
    """Return the lines of the beams, `[BEAMS, L, 2]`."""
    angle = np.arange(BEAMS) * (2 * math.pi / BEAMS)
    rows, cols = (np.rint(RANGE * turned(angle)).astype(int) for turned in (np.sin, np.cos))
    return lines()[rows + RANGE, cols + RANGE, : int((abs(rows) + abs(cols)).max())]


def scan(truth: NDArray[np.bool_], belief: NDArray[np.int8], cell: NDArray[np.int_], scanner: Scanner) -> None:
    """Enter what the scanner sees into a belief: the cells of every beam, into the wall that it hits."""
    rows, cols = cell[0] + beams()[..., 0], cell[1] + beams()[..., 1]
    hit = ~truth[rows, cols]
    before = np.cumsum(hit, axis=1) - hit  # occupied cells that the beam has passed
    in_first_wall = np.arange(hit.shape[1]) - hit.argmax(axis=1)[:, None] == before
    entered = (before == 0) | (hit & in_first_wall & (before < scanner.depth))
    passed = np.zeros_like(truth)
    passed[rows[entered], cols[entered]] = True
    rows, cols = np.nonzero(passed)
    for i, j in itertools.product((-1, 0, 1) if scanner.is_wide else (0,), repeat=2):
        belief[rows + i, cols + j] = np.where(truth[rows + i, cols + j], FREE, OCCUPIED)


def frontier_cells(belief: NDArray[np.int8]) -> NDArray[np.int_]:
    """Return free cells with 2 to 7 unknown ones among their eight neighbours, `[N, 2]`, column by column."""
    unknown = np.pad(belief == UNKNOWN, 1).astype(np.int8)
    rows = unknown[:-2] + unknown[1:-1] + unknown[2:]
    n = rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:]  # the cell itself is free
    return np.argwhere(((belief == FREE) & (n > 1) & (n < 8)).T)[:, ::-1]


def thinned(cells: NDArray[np.int_], start: NDArray[np.int_]) -> NDArray[np.int_]:
    """Keep one cell in every square of `VOXEL` cells counted from the start: that nearest to the square's corner."""
    offset = cells - start
    square = np.trunc(offset / VOXEL).astype(int)
    far = ((offset - square * VOXEL) ** 2).sum(axis=1)
    order = np.lexsort((np.arange(len(cells)), far))
    first = np.unique(square[order], axis=0, return_index=True)[1]
    return cells[order[first]]


def lattice(free: NDArray[np.bool_], start: NDArray[np.int_], here: NDArray[np.int_]) -> list[tuple[int, int]]:
    """Return where nodes are, in steps of `STEP` from the start: free cells that are joined to `here`."""
    joined = ndimage.label(free, np.ones((3, 3)))[0]  # type: ignore[index]
    low, high = -(start // STEP), (np.array(free.shape) - 1 - start) // STEP
    places = np.array(list(itertools.product(*[range(a, b + 1) for a, b in zip(low, high)])))
    rows, cols = (start + STEP * places).T
    places = places[joined[rows, cols] == joined[here[0], here[1]]]
    return list(map(tuple, places[np.lexsort(np.abs(places).T)].tolist()))


def link(
    free: NDArray[np.bool_], start: NDArray[np.int_], index: dict[tuple[int, int], int], links: list[set[int]],
    place: tuple[int, int],
) -> None:  # fmt: skip
    """Link a node, both ways, to those of the 5 x 5 round it that lie in its sight."""
    node, near = index[place], [(place[0] + i, place[1] + j) for i, j in ROUND]
    near = [other for other in near if other in index and index[other] not in links[node]]
    cell, cells = (start + STEP * np.array(at, int).reshape(-1, 2) for at in (place, near))
    for other in itertools.compress(near, in_sight(free, cell[0], cells)):
        links[node].add(index[other])
        links[index[other]].add(node)


@dataclasses.dataclass
class Explorer:
    """A robot on the way: what it knows, its graph of nodes and its path."""

    truth: NDArray[np.bool_]
    """`[H, W]` free cells, with `PAD` occupied ones round the map."""
    start: NDArray[np.int_]
    """`[2]` cell of the first node: all lie `STEP` cells apart from it."""
    scanner: Scanner
    at: int = 0
    """The node where the robot is."""
    path_m: float = 0.0
    moves: int = 0

    def __post_init__(self) -> None:
        self.belief = np.where(
            np.pad(np.zeros(np.subtract(self.truth.shape, 2 * PAD)), PAD, constant_values=1), OCCUPIED, UNKNOWN
        ).astype(np.int8)
        self.index: dict[tuple[int, int], int] = {}  # place on the lattice -> number of the node
        self.places: list[tuple[int, int]] = []
        self.seen: list[set[int]] = []  # of every node, flat indices of the frontier cells that it counts
        self.links: list[set[int]] = []
        self.looks: list[bool] = []  # whether a node still looks for links
        self.frontier: set[int] = set()
        self.look()

    @property
    def cells(self) -> NDArray[np.int_]:
        """Return the nodes' cells, `[N, 2]`."""
        return self.start + STEP * np.array(self.places).reshape(-1, 2)

    @property
    def utility(self) -> NDArray[np.int_]:
        """Return how many frontier cells every node counts."""
        return np.array([len(seen) for seen in self.seen])

    def move(self, node: int) -> None:
        """Go to a linked node and look round there."""
        self.path_m += CELL_M * math.dist(self.cells[self.at], self.cells[node])
        self.at, self.moves = node, self.moves + 1
        self.seen[node] = set()  # a node that has been visited counts none; the start has not, until it is come back to
        self.look()

    def look(self) -> None:
        """Scan, and bring frontiers, nodes and links up to date."""
        here = self.start if not self.places else self.cells[self.at]
        scan(self.truth, self.belief, here, self.scanner)
        found, width = thinned(frontier_cells(self.belief), self.start), self.truth.shape[1]
        flat = found @ (width, 1)
        fresh = ~np.isin(flat, list(self.frontier)) & (np.hypot(*(found - here).T) <= RANGE + VOXEL)
        self.frontier = set(flat.tolist())
        free = self.belief == FREE
        n_old = self._add_nodes(free, here)
        for node, cell in enumerate(self.cells):
            is_new = node >= n_old
            far = np.hypot(*(cell - here))
            if not is_new and (not self.seen[node] or far > 2 * RANGE):
                continue
            near = (np.hypot(*(found - cell).T) < SIGHT) & (is_new | fresh)
            shown = flat[near][in_sight(free, cell, found[near])]
            seen = (self.seen[node] & self.frontier) | set(shown.tolist())
            self.seen[node] = seen if len(seen) >= LEAST else set()
        self._link(free, here)

    def _add_nodes(self, free, here):
        """Add the nodes that have become free; return how many there were."""
        new, n_old = [place for place in lattice(free, self.start, here) if place not in self.index], len(self.places)
        self.index |= {place: n_old + i for i, place in enumerate(new)}
        self.places += new
        self.seen += [set() for _ in new]
        self.links += [set() for _ in new]
        self.looks += [True for _ in new]
        return n_old

    def _link(self, free, here):
        """Link nodes near the robot to those of the 5 x 5 round them that lie in sight."""
        for node in np.flatnonzero(np.hypot(*(self.cells - here).T) < RANGE + STEP):
            if not self.looks[node]:
                continue
            link(free, self.start, self.index, self.links, self.places[node])
            self.looks[node] = bool(self.seen[node])


def explorer(free: NDArray[np.bool_], start: tuple[int, int], scanner: Scanner = SCANNERS["dare"]) -> Explorer:
    """Put a robot into a map, where it has looked round once."""
    return Explorer(np.pad(free, PAD), np.array(start) + PAD, scanner)


def distances(
    links: list[set[int]], cells: NDArray[np.int_], sources: list[int]
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Compute shortest distances from nodes to all nodes, metres, and the node before each (below 0: none)."""
    pairs = np.array([(a, b) for a, linked in enumerate(links) for b in linked], int).reshape(-1, 2)
    length = CELL_M * np.hypot(*(cells[pairs[:, 0]] - cells[pairs[:, 1]]).T)
    graph = csr_array((length, (pairs[:, 0], pairs[:, 1])), shape=(len(links), len(links)))
    return dijkstra(graph, indices=sources, return_predecessors=True)


def first_step(before: NDArray[np.int32], source: int, target: int) -> int:
    """Return the node after `source` on the way to `target`, from the row of `distances` for that source."""
    while before[target] != source:
        target = int(before[target])
    return target
