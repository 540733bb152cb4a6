"""The shortest walk that sees witnesses in a given order, exactly: by a flood from region to region.

Forward and backward costs together say, without a flood, what one more witness costs at every place in the order.
"""

from collections.abc import Callable

import numpy as np

from jexplore.reach import FAR
from jexplore.studies.bounds.floor import Floor


class Tour:
    """Witnesses in the order in which a walk sees them."""

    order: list[int]
    """Cells."""

    def __init__(self, floor: Floor, from_start: np.ndarray, region: Callable[[int], np.ndarray]) -> None:
        """Prepare a tour: `from_start` is `[n]` int32, costs to every place; `region` gives places that see a cell."""
        self.floor, self.order, self.region = floor, [], region
        self._ahead = [from_start]  # i -> cost from the start by the first i regions
        self._behind = [np.zeros_like(from_start)]  # i -> cost by the last i regions to the end, wherever that is

    def _through(self, costs, cell):
        """Compute costs to every cell by the region of one, from costs to its cells."""
        places, start = self.region(cell), np.full(len(self.floor.cells), FAR, np.int32)
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
        n, places = len(self.order), self.region(cell)
        self._make(n, n)
        ahead = (self._ahead[i][places].astype(np.int64) for i in range(n + 1))
        return np.array([(costs + self._behind[n - i][places]).min() for i, costs in enumerate(ahead)])

    def to(self, order: list[int]) -> None:
        """Take another order; the common beginning and end are reused."""
        same = next((i for i, pair in enumerate(zip(order, self.order)) if pair[0] != pair[1]), None)
        same = min(len(order), len(self.order)) if same is None else same
        last = next((i for i, (a, b) in enumerate(zip(order[::-1], self.order[::-1])) if a != b), None)
        last = min(len(order), len(self.order)) if last is None else last
        del self._ahead[same + 1 :], self._behind[last + 1 :]
        self.order = list(order)

    def walk(self) -> np.ndarray:
        """Return the shortest walk in this order: `[k]` int, numbers of cells."""
        n = len(self.order)
        self._make(n, 0)
        way: list[int] = [int(np.argmin(self._ahead[n]))]
        for i in range(n, -1, -1):
            region = set(self.region(self.order[i - 1]).tolist()) if i else set()
            before, now = self._ahead[max(i - 1, 0)], self._ahead[i]

            def stop(place, i=i, region=region, before=before, now=now):
                return now[place] == 0 if i == 0 else place in region and before[place] == now[place]

            way += self.floor.back(self._ahead[i], way[-1], stop)[1:]
        return self.floor.cells[way[::-1]]
