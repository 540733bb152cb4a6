"""The search for the shortest walk of one start: a short one, and how short none is."""

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from jexplore.reach import FAR
from jexplore.studies.bounds.floor import Floor, walk_cost
from jexplore.studies.bounds.pieces import bound_by_pieces
from jexplore.studies.bounds.scene import Scene
from jexplore.studies.bounds.sights import Coverage
from jexplore.studies.bounds.stops import telling
from jexplore.studies.bounds.subsets import Subsets
from jexplore.studies.bounds.tour import Tour
from jexplore.studies.bounds.walks import Walks

MOST_WITNESSES = 24  # whose subsets are all looked at
MOST_BYTES = 1_500_000_000  # that they may take
MOST_REGIONS = 24  # of a bound by pieces
CLOSE = 1.01  # a walk that is not so close to the bound is looked for once more
FAR_OFF = 1.08  # a bound that is so far off is tried by pieces
MANY = 24  # unseen cells of which the one that costs most becomes a witness
# Shares of the budget that are used up when each part ends at the latest: walks, the lower bound by subsets and that by
# pieces, walks once more, the subsets of robots that stand anywhere.
WALKS, CLEAR, PIECES, AGAIN, ANY = 0.35, 0.6, 0.75, 0.85, 0.94


class Budget:
    """What may be spent on a start: seconds, or floods, which are the same on every machine."""

    def __init__(self, seconds: float | None, floods: int | None) -> None:
        self.seconds, self.floods, self.spent = seconds, floods, 0
        self._began = time.monotonic()

    @property
    def elapsed_s(self) -> float:
        return time.monotonic() - self._began

    def over(self, share: float = 1.0) -> bool:
        """Whether a share of it is spent."""
        if self.floods is not None:
            return self.spent >= share * self.floods
        return self.elapsed_s >= share * (self.seconds or 0.0)

    def left_s(self, share: float) -> float:
        """Seconds that are left of a share; without a clock, more than anything takes."""
        return 1e9 if self.floods is not None else max(0.0, share * (self.seconds or 0.0) - self.elapsed_s)


class Found(NamedTuple):
    """What a search found. Costs as in `reach`."""

    walk: np.ndarray  # numbers of cells, from the start on
    high: int  # its cost; FAR if none was found
    low: int  # no walk of the reference robot costs less
    low_any: int  # no walk of any robot does
    optimal: bool  # whether `high` is the least
    witnesses: list[int]  # cells of the lower bound
    method: str  # "subsets", "pieces", "farthest" or "outside": where `low` is from


class Search:
    """The search for lower bounds on one floor, of one start."""

    def __init__(
        self, scene: Scene, stand: np.ndarray, budget: Budget, coverage: Coverage, regions: dict[int, np.ndarray]
    ) -> None:
        """`regions`: what is known of them already, cell -> cells; is added to."""
        self.scene, self.budget, self.coverage, self._regions = scene, budget, coverage, regions
        self.floor = Floor(scene, stand, budget)
        self.start = self.floor.numbers(np.array([scene.start]))
        self.from_start = self.floor.away_from(self.start)
        self._places: dict[int, np.ndarray] = {}

    def region(self, cell: int) -> np.ndarray:
        """Places that see a cell."""
        if cell not in self._places:
            if cell not in self._regions:
                self._regions[cell] = self.scene.region(cell)
            self._places[cell] = self.floor.numbers(self._regions[cell])
        return self._places[cell]

    def dear_witness(self, order: list[int], walk: np.ndarray, unseen: np.ndarray) -> int:
        """Of the unseen cells one that costs much to be seen by a walk that sees others in an order."""
        tour = Tour(self.floor, self.from_start, self.region)
        tour.to(order)
        away = self.floor.away_from(self.floor.numbers(walk))
        far = np.full(len(self.scene.occupied), -1, np.int32)
        far[self.floor.cells] = away
        unseen = unseen[np.argsort(-far[unseen], kind="stable")]
        some = unseen[np.unique(np.linspace(0, len(unseen) - 1, MANY).astype(int))].tolist()
        return max(some, key=lambda cell: int(tour.insertions(cell).min()))

    def farthest(self, cells: list[int]) -> int:
        """What it costs at least to see the farthest of some cells."""
        return max((int(self.from_start[self.region(cell)].min()) for cell in cells), default=0)

    def shortest(self, share: float, high: int, known: Sequence[int] = ()) -> tuple[Subsets, np.ndarray | None]:
        """The exact search: witnesses are added that the shortest walk does not see, known ones first, until it sees
        everything.

        Args:
          share: of the budget.
          high: cost of a walk that is known: longer ones are not looked for.
          known: witnesses to begin with.

        Returns:
          `(Subsets, walk)`; None for the walk where the budget, the memory or the number of witnesses has ended first,
          or none is shorter than the known one.
        """
        subsets, walk = Subsets(self.floor, high), self.floor.cells[self.start]
        while True:
            unseen = self.coverage.unseen(walk)
            if not len(unseen):
                return subsets, walk
            cell = next((cell for cell in known if cell in unseen), None)
            if cell is None:
                cell = self.dear_witness(subsets.order, walk, unseen)
            for _ in subsets.add(cell, self.region(cell)):
                if self.budget.over(share):
                    return subsets, None
            full = len(subsets.witnesses) >= MOST_WITNESSES or 2 * subsets.bytes > MOST_BYTES
            if full or subsets.low >= high:
                return subsets, None
            walk = subsets.walk()

    def by_pieces(self, cells: list[int], share: float, high: int) -> int:
        """The bound of many witnesses, see `pieces`."""
        regions = [self.region(cell) for cell in cells[:MOST_REGIONS]]
        left: Callable[[], float] = lambda: self.budget.left_s(share)  # noqa: E731
        return bound_by_pieces(
            *(self.floor, regions, self.from_start, high),
            left_s=left,
            over=lambda: self.budget.over(share),
            branches=self.budget.floods is None,  # else it would end when the clock says so
        )


def search(scene: Scene, budget: Budget, seed: int = 0) -> Found:
    """The shortest walk of a start, as far as the budget goes: see the modules `walks`, `subsets` and `pieces`."""
    if scene.sights is None:
        return _outside(scene, budget)
    coverage, regions = Coverage(scene.sights, scene.must_see), {}
    clear, rng = Search(scene, scene.clear, budget, coverage, regions), np.random.default_rng(seed)
    walks = Walks(clear.floor, clear.from_start, clear.region, coverage, rng)
    if not walks.find(budget.over):
        wide = Search(scene, scene.any, budget, coverage, regions)
        low, low_any = clear.farthest(walks.witnesses), wide.farthest(walks.witnesses)
        return Found(walks.walk, FAR, max(low, low_any), low_any, False, walks.witnesses, "farthest")
    walks.shorten(lambda: budget.over(WALKS))
    known = telling(walks.stops, walks.witnesses, MOST_WITNESSES, rng, lambda: budget.over(PIECES))
    subsets, exact = clear.shortest(CLEAR, walks.cost, known)
    low, method, witnesses = min(subsets.low, walks.cost), "subsets", list(subsets.witnesses)
    farthest = clear.farthest(walks.witnesses)
    if farthest > low:
        low, method, witnesses = farthest, "farthest", walks.witnesses
    if exact is None and low * FAR_OFF < walks.cost:
        better = clear.by_pieces(known, PIECES, walks.cost)
        if better > low:
            low, method, witnesses = better, "pieces", known[:MOST_REGIONS]
    if exact is None and low * CLOSE < walks.cost:
        walks.shorten(lambda: budget.over(AGAIN), subsets.order)
    walk, high = walks.walk, walks.cost
    if exact is not None:
        walk, high = exact, walk_cost(exact, scene.width)
        assert low == high
    low_any = low
    if not np.array_equal(scene.any, scene.clear):
        wide = Search(scene, scene.any, budget, coverage, regions)
        low_any = max(_any(wide, high, known), min(high, wide.farthest(walks.witnesses)))
    return Found(walk, high, max(low, low_any), low_any, max(low, low_any) >= high, witnesses, method)


def _any(wide, high, known):
    """The lower bound of robots that may stand on any free cell."""
    subsets, exact = wide.shortest(ANY, high, known)
    low = min(subsets.low, high)
    if exact is None and low * FAR_OFF < high:
        low = max(low, wide.by_pieces(known, 1.0, high))
    return low


def _outside(scene, budget):
    """Lower bounds where nobody has looked what is seen from where: the way to within range of the farthest cell."""
    lows = []
    for stand in (scene.clear, scene.any):
        floor = Floor(scene, stand, budget)
        costs = np.full(len(scene.occupied), FAR, np.int32)
        costs[floor.cells] = floor.away_from(floor.numbers(np.array([scene.start])))
        near = ndimage.minimum_filter(costs.reshape(-1, scene.width), 2 * scene.range_cells + 1, mode="nearest")
        lows.append(int(near.reshape(-1)[scene.must_see].max(initial=0)))
    return Found(np.zeros(0, np.int64), FAR, max(lows), lows[1], False, [], "outside")
