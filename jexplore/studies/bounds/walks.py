"""Short walks that see everything: what a walk does not see becomes a witness, until it sees all."""

from collections.abc import Callable, Sequence

import numpy as np
from scipy import ndimage

from jexplore.reach import FAR
from jexplore.studies.bounds.floor import Floor, Tour
from jexplore.studies.bounds.scene import Coverage
from jexplore.studies.bounds.stops import StopOrder, Stops, improved_order, new_order

NEW = 16  # witnesses that one walk gives, at most
PATCH_SAMPLES = 4  # unseen cells of a patch of which one becomes a witness
ORDER_TRIES = 80  # of a new order; half for one that was tried before
FIRST_TRIES = 12  # of an order that sees not yet everything
KEPT_ORDERS = 3  # orders
STALE = 10  # orders in a row without a shorter walk, after which none is looked for


class Walks:
    """Walks on one floor, ever shorter."""

    walk: np.ndarray
    """The shortest that sees everything, numbers of cells from the start on; empty while none was found."""
    cost: int
    """Its cost; FAR while none was found."""
    stops: Stops
    """All witnesses."""

    def __init__(self, floor: Floor, coverage: Coverage, rng: np.random.Generator) -> None:
        self.floor, self.coverage, self._rng = floor, coverage, rng
        self.stops = Stops(floor)
        self.walk, self.cost = np.zeros(0, np.int64), FAR
        self._tour = Tour(floor)
        self._kept: list[StopOrder] = [StopOrder(self.stops)]

    @property
    def witnesses(self) -> list[int]:
        """Return the witnesses in the order in which they were found."""
        return list(self.stops.own)

    def find(self, over: Callable[[], bool]) -> bool:
        """Search for a walk until `over`; return whether one shorter than FAR was found."""
        walk = self.floor.scene.start * np.ones(1, np.int64)
        while True:
            unseen = self.coverage.unseen(walk)
            if not len(unseen):
                self.walk, self.cost = walk, self._tour.cost
                return True
            self._see(walk, unseen, over)
            if over():
                return False
            self._kept = [improved_order(self._kept[0], self._rng, FIRST_TRIES, over=over)]
            walk = self._exact(self._kept[0])
            if not len(walk):
                return False

    def shorten(self, over: Callable[[], bool], first: Sequence[int] = ()) -> None:
        """Search for shorter walks until `over`, or until nothing has improved for long.

        `first` are cells in an order to try, into which the other witnesses are put.
        """
        if first:
            for cell in first:
                if cell not in self.stops.own:
                    self._add(cell)
            order = StopOrder(self.stops, ((cell, int(self.stops.own[cell][0])) for cell in first))
            order.settle()
            for cell in self.witnesses:
                if cell not in first:
                    order.insert(cell)
            order.settle()
            self._kept = [order, *self._kept]
        stale = 0
        while not over() and stale < STALE and self.cost > 0:
            cells = self.witnesses
            fresh = new_order(self.stops, [cells[i] for i in self._rng.permutation(len(cells))])
            tried = [improved_order(order, self._rng, ORDER_TRIES // 2, over=over) for order in self._kept]
            tried.append(improved_order(fresh, self._rng, ORDER_TRIES, over=over))
            by_cost = {order.cost: order for order in reversed(tried)}  # of equal costs the first
            self._kept = [by_cost[cost] for cost in sorted(by_cost)][:KEPT_ORDERS]
            walk, cost = self._exact(self._kept[0]), self._tour.cost
            if cost >= self.cost:
                stale += 1
                continue
            unseen = self.coverage.unseen(walk)
            if len(unseen):
                self._see(walk, unseen, over)
            else:
                self.walk, self.cost, stale = walk, cost, 0

    def _exact(self, order):
        """Return the shortest walk in an order, none if it costs FAR; first sights of the witnesses become stops."""
        self._tour.to(order.witnesses)
        if self._tour.cost >= FAR:
            return np.zeros(0, np.int64)
        walk = self._tour.walk()
        places, at = self.floor.numbers(walk), 0
        for cell in order.witnesses:
            at += int(np.argmax(self.stops.inside[cell][places[at:]]))
            self.stops.touch(cell, int(places[at]))
        order.settle()
        return walk

    def _see(self, walk, unseen, over):
        """Make witnesses of cells that a walk does not see: one, or more until `over`."""
        for cell in self._new_witnesses(walk, unseen):
            self._add(cell)
            if over():
                break

    def _add(self, cell):
        """Make a cell a witness of all orders."""
        self.stops.add(cell)
        for order in self._kept:
            order.insert(cell)

    def _new_witnesses(self, walk, unseen):
        """Return of each patch of unseen cells the one farthest from being seen, of equals the one least seen."""
        scene = self.floor.scene
        mask = np.zeros(len(scene.occupied), bool)
        mask[unseen] = True
        labels, _ = ndimage.label(mask.reshape(-1, scene.width), np.ones((3, 3)))  # type: ignore[misc]
        unseen, away = self.floor.farthest_first(unseen, walk)
        patches, found = labels.reshape(-1)[unseen], []
        _, first = np.unique(patches, return_index=True)
        for patch in patches[np.sort(first)][:NEW]:
            own = unseen[patches == patch]
            some = own[np.unique(np.linspace(0, len(own) - 1, PATCH_SAMPLES).astype(int))].tolist()
            regions = {cell: self.floor.region(cell) for cell in some}
            found.append(max(some, key=lambda cell: (away[regions[cell]].min(), -len(regions[cell]))))
        return found
