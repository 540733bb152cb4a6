"""The planners of DARE's Table I: nearest, utility, nbvp, tare-local, and the tour of one that knows the map.

A planner is `plan(explorer, rng)`, called at every node; it returns the linked node to go to, or None for none.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from parts.dare import rules
from parts.dare.rules import Explorer

Plan = Callable[[Explorer, np.random.Generator], int | None]
UTILITY_PER_M = 0.2  # decay of gain with distance; González-Baños and Latombe 2002, as Holz et al. 2010 cite it
NBVP_PER_M = 0.5  # decay of gain with distance; Bircher et al. 2016, as all of NBVP in ethz-asl/nbvplanner
NBVP_DRAWS = 30  # nodes drawn for a tree
NBVP_MOST = 200  # nodes drawn for a tree that has found no gain yet; then the way to the nearest gain is taken
DRAWS = 5  # sets of view points drawn at a decision by tare-local
TOUR_DRAWS = 10  # and by the tour


def _gain_and_way(explorer):
    """Return utilities, distances from the robot (infinite: unreachable) and the nodes before."""
    far, before = rules.distances(explorer.links, explorer.cells, [explorer.at])
    gain = np.where(np.isfinite(far[0]) & (far[0] > 0), explorer.utility, 0)
    return gain, far[0], before[0]


def nearest(explorer: Explorer, rng: np.random.Generator) -> int | None:
    """Go towards the nearest node that counts frontier cells (Yamauchi 1997)."""
    gain, far, before = _gain_and_way(explorer)
    if not gain.any():
        return None
    return rules.first_step(before, explorer.at, int(np.argmin(np.where(gain > 0, far, np.inf))))


def utility(explorer: Explorer, rng: np.random.Generator, *, per_m: float = UTILITY_PER_M) -> int | None:
    """Go towards the node with the greatest utility times exp(-`per_m` distance)."""
    gain, far, before = _gain_and_way(explorer)
    if not gain.any():
        return None
    score = np.where(gain > 0, np.log(np.maximum(gain, 1)) - per_m * far, -np.inf)
    return rules.first_step(before, explorer.at, int(np.argmax(score)))


def nbvp() -> Plan:
    """Take the first edge of the best branch of a random tree, and keep the rest for the next (Bircher et al. 2016).

    The tree grows over linked nodes: towards a drawn node, from the node of the tree that is nearest to it. A branch's
    gain is the sum of utilities times exp(-`NBVP_PER_M` length up to there).
    """
    rest: list[int] = []

    def plan(explorer: Explorer, rng: np.random.Generator) -> int | None:
        cells, gains = explorer.cells, explorer.utility
        parent, length, value = {explorer.at: -1}, {explorer.at: 0.0}, {explorer.at: 0.0}

        def add(node, before):
            parent[node] = before
            length[node] = length[before] + rules.CELL_M * math.dist(cells[node], cells[before])
            value[node] = value[before] + float(gains[node]) * math.exp(-NBVP_PER_M * length[node])

        for before, node in zip([explorer.at, *rest], rest):
            if node not in parent:
                add(node, before)
        draws = 0
        while draws < NBVP_DRAWS or (draws < NBVP_MOST and max(value.values()) == 0):
            draws += 1
            drawn = cells[rng.integers(len(cells))]
            tree = np.array(list(parent))
            before = int(tree[np.argmin(np.hypot(*(cells[tree] - drawn).T))])
            linked = [node for node in sorted(explorer.links[before]) if node not in parent]
            if linked:
                add(linked[int(np.argmin(np.hypot(*(cells[linked] - drawn).T)))], before)
        best = max(value, key=lambda node: value[node])
        if value[best] == 0:
            rest.clear()
            return nearest(explorer, rng)
        branch = [best]
        while parent[branch[-1]] != explorer.at:
            branch.append(parent[branch[-1]])
        rest[:] = branch[-2::-1]
        return branch[-1]

    return plan


def inserted(length: NDArray[np.float64], order: list[int]) -> list[int]:
    """Insert all other points into an open path where each costs least, the cheapest first; `[n, n]` lengths."""
    order, left = list(order), set(range(len(length))) - set(order)
    while left:
        at, rest = np.array(order), np.array(sorted(left))
        a, b, x = at[:-1, None], at[1:, None], rest[None]
        costs = np.append(length[a, x] + length[x, b] - length[a, b], length[at[-1:, None], x], 0)
        where, which = np.unravel_index(np.argmin(costs), costs.shape)
        order.insert(int(where) + 1, int(rest[which]))
        left.remove(int(rest[which]))
    return order


def shortened(length: NDArray[np.float64], path: list[int]) -> list[int]:
    """Shorten a path from a fixed point to an open end by 2-opt and moves of one point until neither helps."""
    n, order = len(path), np.array(path)
    wide = np.pad(length, (0, 1))  # point n closes the end at no cost
    for _ in range(4 * n):  # a bound; each pass shortens the path
        p = np.append(order, n)
        a, b, c, d = p[: n - 1, None], p[1:n, None], p[None, 1:n], p[None, 2 : n + 1]
        turn = wide[a, c] + wide[b, d] - wide[a, b] - wide[c, d]  # row i, column j: points i+1 to j+1 the other way
        turn = np.where(np.arange(n - 1)[:, None] < np.arange(n - 1), turn, 0)
        x, before, after = p[1:n], p[: n - 1], p[2 : n + 1]
        out = (wide[before, x] + wide[x, after] - wide[before, after])[:, None]
        shift = wide[p[:-1], x[:, None]] + wide[x[:, None], p[1:]] - wide[p[:-1], p[1:]] - out
        slot, own = np.arange(n), np.arange(1, n)[:, None]
        shift = np.where((slot == own) | (slot == own - 1), 0, shift)
        if min(turn.min(initial=0), shift.min(initial=0)) > -1e-9:
            break
        if turn.min(initial=0) <= shift.min(initial=0):
            i, j = np.unravel_index(np.argmin(turn), turn.shape)
            order[i + 1 : j + 2] = order[i + 1 : j + 2][::-1]
        else:
            i, j = np.unravel_index(np.argmin(shift), shift.shape)  # point i+1 goes between slots j and j+1
            point, kept = order[i + 1], np.delete(order, i + 1)
            order = np.insert(kept, j + 1 if j < i + 1 else j, point)
    return order.tolist()


def view_points(shows: NDArray[np.bool_], rng: np.random.Generator, first: list[int]) -> list[int]:
    """Draw view points by what they still show until all is shown: TARE's sampling, Cao et al. 2021, Algorithm 1.

    Args:
      shows: `[N, F]` True where a node shows a frontier cell. A node that shows fewer than `LEAST` shows none.
      first: nodes that are taken before any is drawn, where they still show something.
    """
    left, taken = shows.sum(axis=1), []
    hidden, first = np.ones(shows.shape[1], bool), list(first)
    while True:
        gain = np.where(left >= rules.LEAST, left, 0)
        if not gain.any():
            return taken
        node = first.pop(0) if first else int(rng.choice(len(gain), p=gain / gain.sum()))
        if gain[node] > 0:
            taken.append(node)
            shown = np.flatnonzero(shows[node] & hidden)
            hidden[shown] = False
            left -= shows[:, shown].sum(axis=1)


def _best_tour(shows, far, at, rng, kept, draws):
    """Return the shortest of several tours from node `at`, as nodes: over the view points kept, and over drawn ones.

    The tour before goes on as it was unless a shorter one is found: else the robot could turn to and fro for ever.
    `far(points)`: lengths between points, `[n, n]`.
    """
    best, least = [], math.inf
    for first in [kept] * bool(kept) + [[]] * draws:
        points = [at, *view_points(shows, rng, first)]
        length = far(points)
        n_kept = sum(point in first for point in points[1:])  # they come first, in the order of the tour before
        order = shortened(length, inserted(length, list(range(1 + n_kept))))
        total = length[order[:-1], order[1:]].sum()
        if total < least and len(points) > 1:
            best, least = [points[i] for i in order[1:]], total
    return best


def _shows(seen, reachable):
    """Tabulate what nodes show, `[N, F]`: nothing by those that cannot be reached."""
    cells = {cell: i for i, cell in enumerate(sorted(set().union(*seen)))}
    shows = np.zeros((len(seen), len(cells)), bool)
    for node in np.flatnonzero(reachable):
        shows[node, [cells[cell] for cell in seen[node]]] = True
    return shows


def tare_local() -> Plan:
    """Drive the shortest open tour over view points that show all known frontiers, anew at every node.

    View points of the tour before are tried again together with new draws.
    """
    kept: list[int] = []

    def plan(explorer: Explorer, rng: np.random.Generator) -> int | None:
        gain, _, before = _gain_and_way(explorer)
        if not gain.any():
            return None
        nodes = np.flatnonzero(gain).tolist()
        row = {node: i for i, node in enumerate([explorer.at, *nodes])}
        length = rules.distances(explorer.links, explorer.cells, list(row))[0]
        shows = _shows(explorer.seen, gain > 0)
        far = lambda points: length[[row[p] for p in points]][:, points]  # noqa: E731
        kept[:] = _best_tour(shows, far, explorer.at, rng, kept, DRAWS)
        return rules.first_step(before, explorer.at, kept[0])

    return plan


class _Known:
    """The graph of one that knows the map: frontier cells are free cells next to cells that are not."""

    def __init__(self, explorer: Explorer) -> None:
        free, start = explorer.truth, explorer.start
        self.places = {place: node for node, place in enumerate(rules.lattice(free, start, start))}
        self.cells = start + rules.STEP * np.array(list(self.places))
        links: list[set[int]] = [set() for _ in self.places]
        for place in self.places:
            rules.link(free, start, self.places, links, place)
        self.far, self.before = rules.distances(links, self.cells, list(range(len(self.cells))))
        found = rules.frontier_cells(np.where(free, rules.FREE, rules.UNKNOWN).astype(np.int8))
        self.seen: list[set[int]] = []
        for cell in self.cells:
            near = found[np.hypot(*(found - cell).T) < rules.SIGHT]
            self.seen.append(set((near[rules.in_sight(free, cell, near)] @ (free.shape[1], 1)).tolist()))


def tour() -> Plan:
    """Drive the tour of one that knows where it is free, over view points that show every cell next to a wall.

    Planned anew at every node with what the scan has shown; frontier cells of the belief count as well.
    """
    kept: list[int] = []
    known: Any = None

    def plan(explorer: Explorer, rng: np.random.Generator) -> int | None:
        nonlocal known
        known = known or _Known(explorer)
        belief, at = explorer.belief, known.places[explorer.places[explorer.at]]
        truth = np.where(belief == rules.OCCUPIED, rules.OCCUPIED, np.where(explorer.truth, rules.FREE, rules.UNKNOWN))
        cells = rules.frontier_cells(truth)
        cells = cells[belief[cells[:, 0], cells[:, 1]] != rules.FREE]
        left = set((cells @ (belief.shape[1], 1)).tolist())
        for node, place in enumerate(known.places):
            if known.seen[node]:
                mine = explorer.index.get(place)
                seen = (known.seen[node] & left) | (set() if mine is None else explorer.seen[mine])
                known.seen[node] = seen if len(seen) >= rules.LEAST else set()
        known.seen[at] = set()
        shows = _shows(known.seen, np.isfinite(known.far[at]))
        kept[:] = _best_tour(shows, lambda p: known.far[np.ix_(p, p)], at, rng, kept, TOUR_DRAWS)
        if not kept:
            return nearest(explorer, rng)
        step = explorer.index.get(list(known.places)[rules.first_step(known.before[at], at, kept[0])])
        return nearest(explorer, rng) if step is None else step

    return plan


PLANNERS: dict[str, Callable[[], Plan]] = {
    "nearest": lambda: nearest,
    "utility": lambda: utility,
    "nbvp": nbvp,
    "tare-local": tare_local,
    "tour": tour,
}
