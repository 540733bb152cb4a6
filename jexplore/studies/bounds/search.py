"""The search for the shortest walk of one start: a short one, and how short none is."""

import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jexplore.reach import FAR
from jexplore.studies.bounds.floor import Floor, Tour, walk_cost
from jexplore.studies.bounds.pieces import bound_by_pieces
from jexplore.studies.bounds.scene import Coverage, Scene
from jexplore.studies.bounds.stops import telling
from jexplore.studies.bounds.subsets import Subsets
from jexplore.studies.bounds.walks import Walks

MOST_WITNESSES = 20  # whose subsets are all looked at
MAX_SUBSET_BYTES = 1_500_000_000  # that they may take
MOST_REGIONS = 24  # of a bound by pieces
CLOSE_RATIO = 1.01  # a walk that is not so close to the bound is looked for once more
FAR_RATIO = 1.08  # a bound with a larger ratio to the walk is tried by pieces
UNSEEN_TRIED = 24  # unseen cells of which the one that costs most becomes a witness
WALKS = 0.35  # of the budget, for walks; the first one may take all
# Latest ends of the parts as shares of the rest: witnesses, the lower bound by subsets and by pieces,
# walks once more, the subsets of robots that stand anywhere.
TELLING, CLEAR, PIECES, AGAIN, ANY = 0.15, 0.4, 0.6, 0.75, 0.9


class Budget:
    """Budget of a start: seconds, or floods, which are the same on every machine."""

    def __init__(self, seconds: float | None, floods: int | None) -> None:
        self.seconds, self.floods, self.spent = seconds, floods, 0
        self._began = time.monotonic()

    @property
    def elapsed_s(self) -> float:
        return time.monotonic() - self._began

    def share(self, of_what_is_left: float) -> float:
        """Return the spent share at which a part of the rest is used up."""
        whole = self.floods if self.floods is not None else self.seconds or 0.0
        spent = self.spent if self.floods is not None else self.elapsed_s
        used = min(1.0, spent / whole) if whole else 1.0
        return used + (1 - used) * of_what_is_left

    def over(self, share: float = 1.0) -> bool:
        """Return whether this share is spent."""
        if self.floods is not None:
            return self.spent >= share * self.floods
        return self.elapsed_s >= share * (self.seconds or 0.0)

    def left_s(self, share: float) -> float:
        """Return the seconds left of a share; without a clock, practically unlimited."""
        return 1e9 if self.floods is not None else max(0.0, share * (self.seconds or 0.0) - self.elapsed_s)


class SearchResult(NamedTuple):
    """Result of a search. Costs as in `reach`."""

    walk: np.ndarray  # numbers of cells, from the start on
    high: int  # its cost; FAR if none was found
    low: int  # no walk of the reference robot costs less
    low_any: int  # no walk of any robot does
    optimal: bool  # whether `high` is the least
    witnesses: list[int]  # cells of the lower bound
    method: str  # "subsets", "pieces" or "farthest": where `low` is from


class LowerBound(NamedTuple):
    """No walk that sees some witnesses costs less."""

    low: int
    method: str  # as in `SearchResult`
    witnesses: list[int]


class Search:
    """The search for lower bounds on one floor, of one start."""

    def __init__(self, scene: Scene, stand: np.ndarray, budget: Budget, coverage: Coverage) -> None:
        self.floor, self.budget, self.coverage = Floor(scene, stand, budget), budget, coverage

    def dear_witness(self, order: list[int], walk: np.ndarray, unseen: np.ndarray) -> int:
        """Return an unseen cell that is costly for a walk that sees others in an order."""
        tour = Tour(self.floor)
        tour.to(order)
        unseen, _ = self.floor.farthest_first(unseen, walk)
        some = unseen[np.unique(np.linspace(0, len(unseen) - 1, UNSEEN_TRIED).astype(int))].tolist()
        return max(some, key=lambda cell: int(tour.insertions(cell).min()))

    def farthest(self, cells: list[int]) -> int:
        """Return the least cost to see the farthest of some cells."""
        return max((int(self.floor.from_start[self.floor.region(cell)].min()) for cell in cells), default=0)

    def shortest(self, share: float, high: int, known: Sequence[int] = ()) -> tuple[Subsets, np.ndarray | None]:
        """Search exactly: witnesses that the shortest walk does not see are added, known ones first, until it sees all.

        Walks longer than `high` are not looked for. The walk is None where this share of the budget, the memory or the
        number of witnesses has ended first, or none is shorter than the known one.
        """
        subsets, walk = Subsets(self.floor, high), self.floor.cells[[self.floor.start]]
        while True:
            unseen = self.coverage.unseen(walk)
            if not len(unseen):
                return subsets, walk
            cell = next((cell for cell in known if cell in unseen), None)
            if cell is None:
                cell = self.dear_witness(subsets.order, walk, unseen)
            for _ in subsets.add(cell):
                if self.budget.over(share):
                    return subsets, None
            full = len(subsets.witnesses) >= MOST_WITNESSES or 2 * subsets.bytes > MAX_SUBSET_BYTES
            if full or subsets.low >= high:
                return subsets, None
            walk = subsets.walk()

    def bound(
        self, known: Sequence[int], walks: Walks, until: float, pieces_until: float
    ) -> tuple[LowerBound, list[int], np.ndarray | None]:
        """Return the best lower bound, the witnesses in the order of their shortest walk, and it if it sees everything.

        `known` are witnesses, the most telling first; subsets may use up the share `until` of the budget, pieces, if
        the bound is far off, `pieces_until`.
        """
        budget, high = self.budget, walks.cost
        subsets, exact = self.shortest(until, high, known)
        found = [LowerBound(min(subsets.low, high), "subsets", list(subsets.witnesses))]
        if exact is None:
            found.append(LowerBound(self.farthest(walks.witnesses), "farthest", walks.witnesses))
        if exact is None and found[0].low * FAR_RATIO < high and not budget.over(pieces_until):
            low = bound_by_pieces(
                *(self.floor, known, high),
                left_s=lambda: budget.left_s(pieces_until),
                over=lambda: budget.over(pieces_until),
                branches=budget.floods is None,  # else it would end when the clock says so
            )
            found.append(LowerBound(low, "pieces", list(known)))
        return max(found, key=lambda bound: bound.low), subsets.order, exact


def search(scene: Scene, budget: Budget, seed: int = 0) -> SearchResult:
    """Search the shortest walk of a start within the budget: see the modules `walks`, `subsets` and `pieces`."""
    coverage, rng = Coverage(scene.sights, scene.must_see), np.random.default_rng(seed)
    clear = Search(scene, scene.clear, budget, coverage)
    walks = Walks(clear.floor, coverage, rng)
    if not walks.find(budget.over):
        wide = Search(scene, scene.any, budget, coverage)
        low, low_any = clear.farthest(walks.witnesses), wide.farthest(walks.witnesses)
        return SearchResult(walks.walk, FAR, max(low, low_any), low_any, False, walks.witnesses, "farthest")
    walks.shorten(lambda: budget.over(WALKS))
    tell, until, pieces, again, wide_until = (budget.share(part) for part in (TELLING, CLEAR, PIECES, AGAIN, ANY))
    known = telling(walks.stops, walks.witnesses, MOST_REGIONS, rng, lambda: budget.over(tell))
    best, order, exact = clear.bound(known, walks, until, pieces)
    if exact is None and best.low * CLOSE_RATIO < walks.cost:
        walks.shorten(lambda: budget.over(again), order)
    walk, high = walks.walk, walks.cost
    if exact is not None:
        walk, high = exact, walk_cost(exact, scene.width)
        assert best.low == high
    low_any = best.low
    if not np.array_equal(scene.any, scene.clear):
        wide = Search(scene, scene.any, budget, coverage)
        other, _, _ = wide.bound(known, walks, wide_until, 1.0)
        low_any = min(other.low, high)
        best = max(best, other, key=lambda bound: bound.low)
    low = min(best.low, high)
    return SearchResult(walk, high, low, low_any, low >= high, best.witnesses, best.method)
