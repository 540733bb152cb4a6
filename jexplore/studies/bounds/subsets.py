"""The shortest walk through the regions of some witnesses, exactly: over subsets, by floods.

A witness is a cell that must be seen; its region is where it is seen from. With g(S, v) the cost of the shortest walk
from the start to v that visits the regions of all witnesses in S, g(S, .) are the shortest paths from all cells of the
region of some j in S, each begun at g(S without j, .) (Dreyfus and Wagner's recursion for walks). Costs are integers,
those of `reach`.
"""

from collections.abc import Iterator

import numpy as np

from jexplore.reach import FAR
from jexplore.studies.bounds.floor import Floor, edge_of


class Subsets:
    """The shortest walks through the regions of witnesses, of which more can be added."""

    witnesses: list[int]
    """Cells, in the order in which they were added."""
    low: int
    """Cost of the shortest walk through all their regions."""
    order: list[int]
    """The witnesses in the order in which the last `walk` sees them."""

    def __init__(self, floor: Floor, most: int = FAR) -> None:
        self.floor, self.most = floor, most
        self.witnesses, self.low, self.order = [], 0, []
        self._edges: list[np.ndarray] = []
        self._away: list[np.ndarray] = []  # cost to each region
        self._costs: dict[int, np.ndarray] = {0: floor.from_start}

    @property
    def bytes(self) -> int:
        """Return the bytes of memory in use."""
        n = len(self.witnesses)
        return 4 * len(self.floor.cells) * len(self._costs) + 4 * n * 2**n

    def add(self, cell: int) -> Iterator[None]:
        """Add a witness; the caller may stop after each flood: then nothing has changed."""
        places = self.floor.region(cell)
        assert len(places), "a witness that nobody can see"
        n = len(self.witnesses)
        edges = [*self._edges, edge_of(self.floor, places)]
        away = [*self._away, self.floor.away_from(edges[-1])]
        apart = np.array([[far[edge].min() for edge in edges] for far in away])
        ahead = _Ahead(apart, np.stack([np.concatenate([far[edge] for edge in edges]) for far in away]))
        at, first = np.concatenate(edges), np.cumsum([0, *map(len, edges)])
        new: dict[int, np.ndarray] = {}
        # Only sets of which some witness could have been the last: their number grows by one from layer to layer.
        layers: list[set[int]] = [set() for _ in range(n + 2)]
        for old in self._costs:
            layers[old.bit_count() + 1].add(old | 1 << n)
        for layer in layers:
            for mask in sorted(layer):
                costs, spans = [], []
                for i in range(n + 1):
                    before = mask & ~(1 << i)
                    known = (new if before >> n else self._costs).get(before)
                    if mask >> i & 1 and known is not None:
                        costs.append(known[edges[i]])
                        spans.append(np.arange(first[i], first[i + 1]))
                cost, span = np.concatenate(costs), np.concatenate(spans)
                take = np.flatnonzero(cost + ahead.of(((1 << n + 1) - 1) & ~mask, span) <= self.most)
                if len(take):
                    seeds = np.full(len(self.floor.cells), FAR, np.int32)
                    np.minimum.at(seeds, at[span[take]], cost[take])
                    new[mask] = self.floor.flood(seeds)
                    for i in range(n):
                        if not mask >> i & 1:
                            layers[mask.bit_count() + 1].add(mask | 1 << i)
                    yield
        self._costs.update(new)
        self._edges, self._away = edges, away
        self.witnesses.append(cell)
        whole = self._costs.get((1 << (n + 1)) - 1)
        self.low = FAR if whole is None else int(whole.min())

    def walk(self) -> np.ndarray:
        """Return the shortest walk: `[k]` int, numbers of cells from the start on."""
        mask, order = (1 << len(self.witnesses)) - 1, []
        way = [int(np.argmin(self._costs[mask]))]
        while mask:
            costs, before = self._costs[mask], self._before(mask)

            def came_from(place, costs=costs, before=before):
                """Return the witness that was seen here first, or None."""
                found = (i for i, edge, other in before if place in edge and other[place] == costs[place])
                return next(found, None)

            way += self.floor.back(costs, way[-1], lambda place: came_from(place) is not None)[1:]
            seen = came_from(way[-1])
            assert seen is not None
            order.append(self.witnesses[seen])
            mask &= ~(1 << seen)
        way += self.floor.back(self._costs[0], way[-1], lambda place: place == self.floor.start)[1:]
        self.order = order[::-1]
        return self.floor.cells[way[::-1]]

    def _before(self, mask):
        """Return witnesses that may be the last of a set to be seen: number, edge, costs without it."""
        rest = [(i, self._costs.get(mask & ~(1 << i))) for i in range(len(self.witnesses)) if mask >> i & 1]
        return [(i, set(self._edges[i].tolist()), costs) for i, costs in rest if costs is not None]


class _Ahead:
    """Least cost of a walk that still has to see some witnesses: from edge to edge in the best order."""

    def __init__(self, apart, away):
        """Prepare costs: `apart` is `[n, n]`, between edges; `away` is `[n, E]`, from the places of all edges."""
        self._away, self._onward, self._bits = away.astype(np.int64), _onward(apart), 1 << np.arange(len(away))

    def of(self, rest, span):
        """Return the costs from some of the places: `[k]` int64."""
        members = np.flatnonzero(rest & self._bits)
        if not len(members):
            return 0
        away = self._away[np.ix_(members, span)]
        return np.maximum((away + self._onward[rest, members][:, None]).min(axis=0), away.max(axis=0))


def _onward(apart):
    """Compute the least cost to see the others of a set from the edge of one on, in the best order: `[2**n, n]` int32.

    Over sets and their first ones, by Held and Karp's recursion on the distances between edges.
    """
    n, apart = len(apart), np.minimum(apart, FAR - 1).astype(np.int32)  # two FARs do not fit
    found, masks = np.full((1 << n, n), FAR, np.int32), np.arange(1 << n)
    size = np.bitwise_count(masks)
    for layer in range(1, n + 1):
        own = masks[size == layer]
        for i in range(n):
            some = own[own >> i & 1 == 1]
            rest = some & ~(1 << i)
            found[some, i] = np.where(rest == 0, 0, (apart[i] + found[rest]).min(axis=1))
    return found
