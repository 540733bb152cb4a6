"""A lower bound for many witnesses: the shortest path through one piece of each region, by branch and cut.

A walk that sees all witnesses enters their regions one after the other, each for the first time through its edge. The
edges are cut into pieces; between entering one piece and the next a walk is at least as long as the shortest path from
the one to the other. The shortest path that takes one piece of each edge, in the best order, is then no longer than any
walk. It is a generalised travelling salesman's problem, solved as a mixed-integer program by HiGHS, in floating point.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.optimize import Bounds, LinearConstraint, linprog, milp
from scipy.sparse.csgraph import maximum_flow

from jexplore.reach import STRAIGHT
from jexplore.studies.bounds.floor import Floor, edge_of

SAFE = 1e-6  # relative: what HiGHS's tolerances may add to a bound
MOST_ROUNDS = 60  # of cuts


class EdgePieces(NamedTuple):
    """Edges of regions, cut into pieces."""

    region: np.ndarray  # [P] int, which region each belongs to
    cost: np.ndarray  # [P, P] float64, cells, from each to each
    start: np.ndarray  # [P] float64, from the robot's start


def cut_up(floor: Floor, places: np.ndarray, side: int) -> list[np.ndarray]:
    """Divide places into parts that fit into squares of a side, cells."""
    rows, cols = floor.scene.cells(floor.cells[places])
    if max(np.ptp(rows), np.ptp(cols)) < side or len(places) == 1:
        return [places]
    along = rows if np.ptp(rows) >= np.ptp(cols) else cols
    low = along < (int(along.min()) + int(along.max()) + 1) / 2
    return [*cut_up(floor, places[low], side), *cut_up(floor, places[~low], side)]


def prepare_pieces(floor: Floor, cells: Sequence[int], most: int) -> EdgePieces:
    """Prepare the `EdgePieces` of the edges of witnesses' regions, at most about `most` in all: one flood each."""
    edges = [edge_of(floor, floor.region(cell)) for cell in cells]
    side = 4
    while sum(len(cut_up(floor, edge, side)) for edge in edges) > most and side < 2**12:
        side = side * 5 // 4 + 1
    parts = [cut_up(floor, edge, side) for edge in edges]
    flat = [part for own in parts for part in own]
    cost = np.zeros((len(flat), len(flat)))
    for i, part in enumerate(flat):
        away = floor.away_from(part)
        cost[i] = [away[other].min() for other in flat]
    start = np.array([floor.from_start[part].min() for part in flat], np.float64)
    region = np.repeat(np.arange(len(parts)), [len(own) for own in parts])
    return EdgePieces(region, np.minimum(cost, cost.T) / STRAIGHT, start / STRAIGHT)


class Path:
    """The program: which edges between pieces are taken, where the path begins and ends."""

    def __init__(self, pieces: EdgePieces, high: float) -> None:
        self.pieces, self.high = pieces, high
        n, self.n_regions = len(pieces.region), int(pieces.region.max()) + 1
        a, b = np.triu_indices(n, 1)
        take = (pieces.region[a] != pieces.region[b]) & (pieces.cost[a, b] <= high)
        self.a, self.b = a[take], b[take]
        self.cost = np.concatenate([pieces.cost[self.a, self.b], pieces.start, np.zeros(2 * n)])
        self._rows: list[Any] = []  # cuts
        self._free = np.ones(len(self.cost), bool)  # variables that may be other than 0

    def _matrices(self):
        """Build the equations: pieces, regions, one start, one end. Variables: edges, starts, ends, pieces taken."""
        n, m, k = len(self.pieces.region), len(self.a), self.n_regions
        ends = np.concatenate([self.a, self.b]), np.tile(np.arange(m), 2)
        edges = sparse.csr_array((np.ones(2 * m), ends), shape=(n, m))
        one, whole = sparse.eye_array(n), sparse.csr_array(np.ones((1, n)))
        taken = sparse.csr_array((np.ones(n), (self.pieces.region, np.arange(n))), shape=(k, n))
        rows = [
            [edges, one, one, -2 * one],
            [None, None, None, taken],
            [None, whole, None, None],
            [None, None, whole, None],
        ]
        return sparse.csr_array(sparse.block_array(rows)), np.concatenate([np.zeros(n), np.ones(k + 2)])

    def _inside(self, chosen):
        """Return the row of a cut: edges that leave a set of regions, starts and ends in it."""
        n, m = len(self.pieces.region), len(self.a)
        own = chosen[self.pieces.region]
        row = np.zeros(len(self.cost))
        row[:m] = own[self.a] != own[self.b]
        row[m : m + n], row[m + n : m + 2 * n] = own, own
        return row

    def _violated(self, x):
        """Find sets of regions that a solution does not connect with the rest: a list of bool arrays."""
        n, m, k = len(self.pieces.region), len(self.a), self.n_regions
        flow = np.zeros((k + 1, k + 1))  # the last node is the start and the end of all
        np.add.at(flow, (self.pieces.region[self.a], self.pieces.region[self.b]), x[:m])
        flow = flow + flow.T
        np.add.at(flow, (np.full(n, k), self.pieces.region), x[m : m + n] + x[m + n : m + 2 * n])
        np.add.at(flow, (self.pieces.region, np.full(n, k)), x[m : m + n] + x[m + n : m + 2 * n])
        capacity = sparse.csr_array(np.round(flow * 10**6).astype(np.int32))
        found = {}
        for region in range(k):
            if any(chosen[region] for chosen in found.values()):
                continue
            result = maximum_flow(capacity, region, k)
            if result.flow_value < 2 * 10**6 - 2000:
                left = capacity - result.flow
                order = sparse.csgraph.breadth_first_order(left > 0, region, return_predecessors=False)
                chosen = np.zeros(k, bool)
                chosen[order[order < k]] = True
                found[chosen.tobytes()] = chosen
        return list(found.values())

    def relax(self, over: Callable[[], bool]) -> tuple[float, Any]:
        """Compute the bound of the linear relaxation, cut until nothing is violated: `(bound, solution)`."""
        equations, right = self._matrices()
        bound, solution = 0.0, None
        for _ in range(MOST_ROUNDS):
            cuts = sparse.csr_array(-np.array(self._rows)) if self._rows else None
            found = linprog(
                *(self.cost, cuts, None if cuts is None else np.full(len(self._rows), -2.0), equations, right),
                bounds=np.stack([np.zeros(len(self.cost)), self._free.astype(float)], axis=1),
                method="highs",
            )
            if found.status == 2:
                return np.inf, None
            if found.status != 0:
                break
            bound, solution = max(bound, found.fun), found
            new = self._violated(found.x)
            if not new or over():
                break
            self._rows += [self._inside(chosen) for chosen in new]
        return bound, solution

    def fix(self, bound: float, solution: Any) -> None:
        """Fix variables that no path shorter than the best known one can take, by reduced costs."""
        gap = self.high - bound
        self._free &= solution.lower.marginals <= gap + 1e-6

    def branch(self, left_s: Callable[[], float], over: Callable[[], bool]) -> float:
        """Compute the bound by branching, from cut to cut: whole edges and pieces."""
        equations, right = self._matrices()
        ends: Any = right, right
        bound = 0.0
        keep = np.flatnonzero(self._free)
        for _ in range(MOST_ROUNDS):
            rules: list[Any] = [LinearConstraint(equations[:, keep], *ends)]
            if self._rows:
                rules.append(LinearConstraint(sparse.csr_array(np.array(self._rows)[:, keep]), 2.0, np.inf))
            options: dict[str, Any] = {"time_limit": max(0.2, left_s())}
            found = milp(
                self.cost[keep], integrality=np.ones(len(keep)), bounds=Bounds(0, 1), constraints=rules, options=options
            )
            if found.status == 2:
                return self.high
            if found.mip_dual_bound is None or not np.isfinite(found.mip_dual_bound):
                break
            bound = max(bound, float(found.mip_dual_bound))
            if found.x is None or over():
                break
            whole = np.zeros(len(self.cost))
            whole[keep] = np.round(found.x)
            new = self._violated(whole)
            if not new:
                break
            self._rows += [self._inside(chosen) for chosen in new]
        return bound


def bound_by_pieces(
    floor: Floor, cells: Sequence[int], high: int, *,
    most: int = 100, left_s: Callable[[], float], over: Callable[[], bool], branches: bool = True,
) -> int:  # fmt: skip
    """Compute a lower bound of every walk that sees all witnesses: a cost, at most `high`, that of a known walk.

    `cells` are the witnesses, whose regions are cut into about `most` pieces; `left_s` is asked for the seconds that
    are left, `over` between programs; `branches` tells whether to branch after the linear relaxation.
    """
    cells = [cell for cell in cells if len(floor.region(cell)) and floor.from_start[floor.region(cell)].min() > 0]
    if not cells:
        return 0
    path = Path(prepare_pieces(floor, cells, most), (high + 1) / STRAIGHT)
    bound, solution = path.relax(over)
    if solution is not None and branches and not over():
        path.fix(bound, solution)
        bound = max(bound, path.branch(left_s, over))
    return int(min(high, max(0.0, bound * (1 - SAFE) * STRAIGHT)))
