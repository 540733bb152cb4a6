"""Cells where a robot may stand, shortest paths there, and the shortest walks that see witnesses in an order."""

import functools
import math
from typing import Any

import jax
import numpy as np

from jexplore import reach
from jexplore.arrays import bits
from jexplore.reach import DIAGONAL, FAR, MOTIONS, STRAIGHT
from jexplore.studies.bounds.scene import Scene


@jax.jit
def _flood(words, start):
    return reach.spread(words, start)


def low_metres(cost: int, cell_m: float) -> float:
    """Convert a least cost to a least length in metres: rounded down to a millimetre.

    A diagonal step costs a millionth more than sqrt(2) straight ones, so a walk may be that much shorter than its cost.
    """
    shortest = cost / STRAIGHT * (STRAIGHT * math.sqrt(2) / DIAGONAL) * cell_m
    return math.floor(shortest * 1000 * (1 - 1e-12)) / 1000


class Floor:
    """Cells where a robot may stand, with shortest paths between them."""

    cells: np.ndarray
    """`[n]` int, their numbers in the scene, sorted."""
    start: int
    """The robot's place in `cells`."""

    def __init__(self, scene: Scene, stand: np.ndarray, budget: Any) -> None:
        self.scene, self.cells, self.budget = scene, np.flatnonzero(stand), budget
        height = -(-scene.shape[0] // bits.WORD) * bits.WORD
        self._shape = height, -(-scene.shape[1] // bits.WORD) * bits.WORD
        rows, cols = scene.cells(self.cells)
        self._at = rows * self._shape[1] + cols
        mask = np.zeros(self._shape, bool)
        mask.reshape(-1)[self._at] = True
        self._words = jax.jit(bits.pack)(mask)
        self._number = np.full(len(scene.occupied), -1, np.int32)
        self._number[self.cells] = np.arange(len(self.cells))
        self.start, self._regions = int(self._number[scene.start]), {}

    @functools.cached_property
    def from_start(self) -> np.ndarray:
        """Return the costs from the start to every place: `[n]` int32."""
        return self.away_from(np.array([self.start]))

    def region(self, cell: int) -> np.ndarray:
        """Return the places that see a cell: `[k]` int."""
        if cell not in self._regions:
            self._regions[cell] = self.numbers(self.scene.region(cell))
        return self._regions[cell]

    def numbers(self, flat: np.ndarray) -> np.ndarray:
        """Return places in `cells` of those of some cells that are among them: `[k]` int."""
        found = self._number[flat]
        return found[found >= 0]

    def flood(self, costs: np.ndarray) -> np.ndarray:
        """Compute costs of the shortest paths from cells with given costs, FAR where not given: both `[n]` int32."""
        self.budget.spent += 1
        start = np.full(self._shape, FAR, np.int32)
        start.reshape(-1)[self._at] = costs
        return np.asarray(_flood(self._words, start)).reshape(-1)[self._at]

    def away_from(self, places: np.ndarray) -> np.ndarray:
        """Return costs of the shortest paths from some places: `[n]` int32."""
        costs = np.full(len(self.cells), FAR, np.int32)
        costs[places] = 0
        return self.flood(costs)

    def farthest_first(self, cells: np.ndarray, walk: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Sort cells by their distance from a walk, the farthest first, and return every place's: `[k]`, `[n]` int."""
        away, far = self.away_from(self.numbers(walk)), np.full(len(self.scene.occupied), -1, np.int32)
        far[self.cells] = away
        return cells[np.argsort(-far[cells], kind="stable")], away

    @functools.cached_property
    def before(self) -> list[np.ndarray]:
        """Return for each of `MOTIONS` the place from which it leads to each place: `[n]` int; -1 without one."""
        width, found = self.scene.width, []
        for drow, dcol in MOTIONS:
            place = self._number[self.cells - drow * width - dcol]
            if drow and dcol:
                beside = self._number[self.cells - drow * width], self._number[self.cells - dcol]
                place = np.where((beside[0] >= 0) & (beside[1] >= 0), place, -1)
            found.append(place)
        return found

    def back(self, costs: np.ndarray, place: int, stop: Any) -> list[int]:
        """Return the way that led to a place: places from it back to the first where `stop` is true, both included."""
        way = [place]
        while not stop(place):
            for (drow, dcol), before in zip(MOTIONS, self.before):
                step = DIAGONAL if drow and dcol else STRAIGHT
                if before[place] >= 0 and costs[before[place]] + step == costs[place]:
                    place = int(before[place])
                    break
            else:
                raise AssertionError("a cost without a way")
            way.append(place)
        return way


def walk_cost(walk: np.ndarray, width: int) -> int:
    """Return cost of a walk of cells, one motion from each to the next."""
    steps = np.abs(np.diff(walk))
    assert all(step in (0, 1, width, width - 1, width + 1) for step in steps)
    return int(np.sum(np.where(steps == 0, 0, np.where((steps == 1) | (steps == width), STRAIGHT, DIAGONAL))))


def edge_of(floor: Floor, places: np.ndarray) -> np.ndarray:
    """Return the places through which a robot can enter a region: those with a motion from outside."""
    inside = np.zeros(len(floor.cells) + 1, bool)  # the last is no place, and counts as inside
    inside[places], inside[-1] = True, True
    entered = np.zeros(len(places), bool)
    for before in floor.before:
        entered |= ~inside[before[places]]
    return places[entered]


class Tour:
    """Witnesses in the order in which a walk sees them, and the shortest such walk, by a flood from region to region.

    Forward and backward costs together say, without a flood, what one more witness costs at each place of the order.
    """

    order: list[int]
    """Cells."""

    def __init__(self, floor: Floor) -> None:
        self.floor, self.order = floor, []
        self._ahead = [floor.from_start]  # i -> cost from the start by the first i regions
        self._behind = [np.zeros_like(floor.from_start)]  # i -> cost by the last i regions to the end, wherever that is

    def _through(self, costs, cell):
        """Compute costs to every cell by the region of one, from costs to its cells."""
        places, start = self.floor.region(cell), np.full(len(self.floor.cells), FAR, np.int32)
        start[places] = costs[places]
        return self.floor.flood(start)

    def _make(self, ahead, behind):
        """Compute costs by a number of regions from the front and from the back."""
        while len(self._ahead) <= ahead:
            self._ahead.append(self._through(self._ahead[-1], self.order[len(self._ahead) - 1]))
        while len(self._behind) <= behind:
            self._behind.append(self._through(self._behind[-1], self.order[-len(self._behind)]))

    @property
    def cost(self) -> int:
        """Return the cost of the walk."""
        n = len(self.order)
        done = min(n, len(self._ahead) - 1)
        self._make(done, n - done)
        return int((self._ahead[done].astype(np.int64) + self._behind[n - done]).min())

    def insertions(self, cell: int) -> np.ndarray:
        """Compute the cost of the walk with one more witness at each place of the order: `[n + 1]` int."""
        n, places = len(self.order), self.floor.region(cell)
        self._make(n, n)
        ahead = (self._ahead[i][places].astype(np.int64) for i in range(n + 1))
        return np.array([(costs + self._behind[n - i][places]).min() for i, costs in enumerate(ahead)])

    def to(self, order: list[int]) -> None:
        """Take another order; the common beginning and end are reused."""
        short = min(len(order), len(self.order))
        same = next((i for i, (a, b) in enumerate(zip(order, self.order)) if a != b), short)
        last = next((i for i, (a, b) in enumerate(zip(order[::-1], self.order[::-1])) if a != b), short)
        del self._ahead[same + 1 :], self._behind[last + 1 :]
        self.order = list(order)

    def walk(self) -> np.ndarray:
        """Return the shortest walk in this order: `[k]` int, numbers of cells."""
        n = len(self.order)
        self._make(n, 0)
        way: list[int] = [int(np.argmin(self._ahead[n]))]
        for i in range(n, -1, -1):
            region = set(self.floor.region(self.order[i - 1]).tolist()) if i else set()
            before, now = self._ahead[max(i - 1, 0)], self._ahead[i]

            def stop(place, i=i, region=region, before=before, now=now):
                return now[place] == 0 if i == 0 else place in region and before[place] == now[place]

            way += self.floor.back(self._ahead[i], way[-1], stop)[1:]
        return self.floor.cells[way[::-1]]
