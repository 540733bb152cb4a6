"""The search for the shortest walk of one start: a short one, and how short none is."""

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from jexplore.reach import FAR
from jexplore.studies.bounds.floor import Floor, walk_cost
from jexplore.studies.bounds.pieces import bound_by_pieces
from jexplore.studies.bounds.scene import Scene
from jexplore.studies.bounds.subsets import Subsets
from jexplore.studies.bounds.tour import Tour

MOST_WITNESSES = 20  # whose subsets are all looked at
MOST_BYTES = 1_500_000_000  # that they may take
MOST_REGIONS = 60  # of a bound by pieces
CLOSE = 1.005  # a bound so close to the walk is not made better
SIGHT_BYTES = 300_000_000  # of what is remembered of single cells
FEW, MANY = 4, 24  # unseen cells of which the one that is farthest from being seen becomes a witness
STALE = 200  # tries in a row without a shorter walk, after which none is looked for
GONE = 6  # witnesses that are taken out of a tour at once, at most


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
    method: str  # "subsets", "pieces" or "farthest": where `low` is from


class Sight:
    """What is seen from single cells, remembered."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.cells = scene, np.flatnonzero(scene.must_see)
        self._rows: dict[int, np.ndarray] = {}

    def unseen(self, walk: np.ndarray) -> np.ndarray:
        """Cells that must be seen and are not from a walk: `[n]` int."""
        if len(self._rows) * len(self.cells) // 8 > SIGHT_BYTES:
            self._rows.clear()
        seen = np.zeros(-(-len(self.cells) // 8), np.uint8)
        for cell in dict.fromkeys(walk.tolist()):
            if cell not in self._rows:
                self._rows[cell] = np.packbits(self.scene.seen_from([cell])[self.cells])
            seen |= self._rows[cell]
        return self.cells[np.unpackbits(seen, count=len(self.cells)) == 0]


class Search:
    """The search on one floor, of one start."""

    def __init__(self, scene: Scene, stand: np.ndarray, budget: Budget, sight: Sight, regions: dict[int, np.ndarray]):
        self.scene, self.budget, self.sight, self._regions = scene, budget, sight, regions
        self.floor = Floor(scene, stand, budget)
        self.start = self.floor.numbers(np.array([scene.start]))
        self.from_start = self.floor.away_from(self.start)

    def region(self, cell: int) -> np.ndarray:
        """Cells that see a cell, wherever a robot may stand."""
        if cell not in self._regions:
            self._regions[cell] = self.scene.region(cell)
        return self._regions[cell]

    def _spread(self, walk: np.ndarray, unseen: np.ndarray, n: int) -> tuple[list[int], np.ndarray]:
        """Some unseen cells, from the farthest from a walk to the nearest, and what each cell is away from it."""
        away = self.floor.away_from(self.floor.numbers(walk))
        full = np.full(len(self.scene.occupied), -1, np.int32)
        full[self.floor.cells] = away
        order = unseen[np.argsort(-full[unseen], kind="stable")]
        some: list[int] = order[np.unique(np.linspace(0, len(order) - 1, n).astype(int))].tolist()
        return some, away

    def far_witness(self, walk: np.ndarray, unseen: np.ndarray) -> int:
        """Of the unseen cells one whose region is far from a walk."""
        some, away = self._spread(walk, unseen, FEW)
        return max(some, key=lambda cell: int(away[self.floor.numbers(self.region(cell))].min()))

    def dear_witness(self, order: list[int], walk: np.ndarray, unseen: np.ndarray) -> int:
        """Of the unseen cells one that costs much to be seen by a walk that sees others in an order."""
        tour = Tour(self.floor, self.from_start, self.region)
        tour.to(order)
        some, _ = self._spread(walk, unseen, MANY)
        return max(some, key=lambda cell: int(tour.insertions(cell).min()))

    def _complete(self, tour: Tour, most: int) -> bool:
        """Adds witnesses until a tour's walk sees everything; False once it costs as much as a known one."""
        while tour.cost < most and not self.budget.over():
            walk = tour.walk()
            unseen = self.sight.unseen(walk)
            if not len(unseen):
                return True
            tour.add(self.far_witness(walk, unseen))
        return False

    def short_walk(self, share: float, rng: np.random.Generator, order: Sequence[int] = ()) -> tuple[Tour, bool]:
        """A walk that sees everything, made shorter until the budget is spent: witnesses are taken out, those that the
        walk does not see anyway are put in again where that costs least.

        Args:
          share: of the budget.
          rng: what is taken out.
          order: of witnesses to begin with.

        Returns:
          `(Tour, bool)`: whether it sees everything; else the whole budget was spent before.
        """
        tour = Tour(self.floor, self.from_start, self.region)
        tour.to(list(order))
        if not self._complete(tour, FAR):
            return tour, False
        best, order, stale = tour.cost, list(tour.order), 0
        while not self.budget.over(share) and order and stale < STALE:
            stale += 1
            tour.to(_without(order, _some(order, self.scene, rng)))
            gone = [cell for cell in order if cell not in tour.order]
            for cell in [gone[i] for i in rng.permutation(len(gone))]:
                costs = tour.insertions(cell)
                if costs.min() > tour.cost:
                    tour.insert(int(np.argmin(costs)), cell)
            if self._complete(tour, best):
                best, order, stale = tour.cost, list(tour.order), 0
            else:
                tour.to(order)
        return tour, True

    def farthest(self, cells: list[int]) -> int:
        """What it costs at least to see the farthest of some cells."""
        return max((int(self.from_start[self.floor.numbers(self.region(cell))].min()) for cell in cells), default=0)

    def shortest(
        self, share: float, high: int, known: Sequence[int] = (), subsets: Subsets | None = None
    ) -> tuple[Subsets, np.ndarray | None]:
        """The exact search: witnesses are added, the known ones first, until the shortest walk that sees them sees
        everything.

        Args:
          share: of the budget.
          high: cost of a walk that is known: longer ones are not looked for.
          known: witnesses to begin with.
          subsets: of a search that is gone on with.

        Returns:
          `(Subsets, walk)`; None for the walk where the budget, the memory or the number of witnesses has ended first,
          or none is shorter than the known one.
        """
        subsets, walk = subsets or Subsets(self.floor, high), self.floor.cells[self.start]
        subsets.most = high
        if subsets.low >= high:
            return subsets, None
        if subsets.witnesses:
            walk = subsets.walk()
        while True:
            unseen = self.sight.unseen(walk)
            if not len(unseen):
                return subsets, walk
            left = [cell for cell in known if cell not in subsets.witnesses]
            cell = left[0] if left else self.dear_witness(subsets.order, walk, unseen)
            for _ in subsets.add(cell, self.region(cell)):
                if self.budget.over(share):
                    return subsets, None
            full = len(subsets.witnesses) >= MOST_WITNESSES or 2 * subsets.bytes > MOST_BYTES
            if full or subsets.low >= high:
                return subsets, None
            if len(left) < 2:
                walk = subsets.walk()

    def by_pieces(self, cells: list[int], share: float, high: int) -> int:
        """The bound of many witnesses, see `pieces`."""
        regions = [self.floor.numbers(self.region(cell)) for cell in cells[:MOST_REGIONS]]
        left: Callable[[], float] = lambda: self.budget.left_s(share)  # noqa: E731
        return bound_by_pieces(
            *(self.floor, regions, self.from_start, high),
            left_s=left,
            over=lambda: self.budget.over(share),
            branches=self.budget.floods is None,  # else it would end when the clock says so
        )


def _some(order, scene, rng):
    """A few witnesses of an order: neighbours in it, or on the map."""
    n = len(order)
    first, size = int(rng.integers(n)), int(rng.integers(1, min(n, GONE) + 1))
    if rng.random() < 0.5:
        return set(order[first : first + size])
    rows, cols = scene.cells(np.array(order))
    near = np.argsort((rows - rows[first]) ** 2 + (cols - cols[first]) ** 2, kind="stable")
    return {order[i] for i in near[:size]}


def _without(order, gone):
    return [cell for cell in order if cell not in gone]


def search(scene: Scene, budget: Budget, seed: int = 0) -> Found:
    """The shortest walk of a start, as far as the budget goes: see the modules `tour`, `subsets` and `pieces`."""
    sight, regions = Sight(scene), {}
    clear = Search(scene, scene.clear, budget, sight, regions)
    rng = np.random.default_rng(seed)
    tour, whole = clear.short_walk(0.2, rng)
    if not whole:
        return _weak(scene, clear, Search(scene, scene.any, budget, sight, regions), tour.order)
    walk, high = tour.walk(), tour.cost
    subsets, exact = clear.shortest(0.4, high)
    if exact is None and subsets.low < high and not budget.over(0.5):
        other, whole = clear.short_walk(0.55, rng, subsets.order)
        if whole and other.cost < high:
            tour, walk, high = other, other.walk(), other.cost
        subsets, exact = clear.shortest(0.7, high, subsets=subsets)
    low, method, witnesses = min(subsets.low, high), "subsets", list(subsets.witnesses)
    if exact is not None:
        walk, high = exact, walk_cost(exact, scene.width)
        assert low == high
    many = list(dict.fromkeys([*tour.order, *subsets.witnesses]))
    if low * 1.08 < high:
        better = clear.by_pieces(many, 0.75, high)
        if better > low:
            low, method, witnesses = better, "pieces", many[:MOST_REGIONS]
    low_any = low
    if not np.array_equal(scene.any, scene.clear):
        low_any = _any(scene, budget, sight, regions, high, subsets.witnesses, many)
    return Found(walk, high, max(low, low_any), low_any, max(low, low_any) >= high, witnesses, method)


def _weak(scene, clear, wide, order):
    """Lower bounds where no walk was found."""
    start = np.array([scene.start])
    cells = order or [clear.far_witness(start, clear.sight.unseen(start))]
    subsets, exact = clear.shortest(0.9, FAR, cells)
    low, low_any = max(clear.farthest(cells), min(subsets.low, FAR)), wide.farthest(cells)
    if exact is not None:
        cost = walk_cost(exact, scene.width)
        return Found(exact, cost, cost, min(low_any, cost), True, list(subsets.witnesses), "subsets")
    return Found(np.zeros(0, np.int64), FAR, max(low, low_any), low_any, False, cells, "farthest")


def _any(scene, budget, sight, regions, high, known, many):
    """The lower bound of robots that may stand on any free cell."""
    wide = Search(scene, scene.any, budget, sight, regions)
    subsets, exact = wide.shortest(1.0, high, known)
    low = min(max(subsets.low, wide.farthest(many)), high)
    if exact is None and low * 1.08 < high and not budget.over(0.95):
        low = max(low, wide.by_pieces(many, 1.0, high))
    return low
