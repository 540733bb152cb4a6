"""The shortest ways of many robots between many nodes of one map."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from jexplore.config import InputError
from jexplore.tracemap.record import NOWHERE
from jexplore.tracemap.route import LENGTH_UNIT_M, MapIndex

MAX_LINKS_M = 2**30 * LENGTH_UNIT_M  # of all links; a float holds that times eight million nodes exactly
GOALS_AT_ONCE = 256  # so that the distances from all nodes take 5 MB for every 1000 nodes


class Problem(NamedTuple):
    """Part of a map that a robot may use; robots with the same part share a problem."""

    shut: frozenset[int]  # ids of searched links that it may not use
    barriers: frozenset[int]  # ids of nodes that it may not pass
    stubs: frozenset[int]
    """Ids of nodes with an un-searched link that the robot may follow: the goals where the goal is None."""


class Walk(NamedTuple):
    """The way from a start to a goal."""

    nodes: tuple[int, ...]  # ids, one more than links
    links: tuple[int, ...]  # ids


class WalkGraph:
    """A map's searched links as seen from both ends: in the order of the nodes that they leave, then of their ids.

    Raises:
      InputError: links too long in all.
    """

    def __init__(self, index: MapIndex) -> None:
        links = [index.links[own] for own in sorted(index.links) if index.links[own].end != NOWHERE]
        metres = [index.length_m[link.id] for link in links]
        if sum(metres) >= MAX_LINKS_M:
            raise InputError(f"links must be less than {MAX_LINKS_M / 1000:.0f} km long in all")
        self.ids = list(index.nodes)
        self.row = {own: i for i, own in enumerate(self.ids)}
        ends = np.array([(self.row[link.start], self.row[link.end]) for link in links], int).reshape(-1, 2)
        order = np.argsort(ends.ravel(), kind="stable")
        self.tail, self.head = ends.ravel()[order], ends[:, ::-1].ravel()[order]
        self.link = np.repeat([link.id for link in links], 2)[order].astype(int)
        # The fewest links of equal lengths: each adds one, and all together less than a unit of length.
        cost = [round(own / LENGTH_UNIT_M) * (len(self.ids) + 1) + 1 for own in metres]
        self.cost = np.repeat(cost, 2)[order].astype(float)

    def walks(self, problem: Problem, pairs: Sequence[tuple[int, int | None]]) -> list[Walk | None]:
        """Find the walks between nodes, start and goal; None as the goal for the nearest of `Problem.stubs`.

        Of ways of equal length, in whole millimetres, the one with the fewest links counts, and of those the one whose
        links have the lowest ids in order. None without a way.
        """
        asked: dict[int | None, list[tuple[int, int]]] = {}
        for i, (start, goal) in enumerate(pairs):
            asked.setdefault(goal, []).append((i, start))
        goals = list(asked)
        found: list[Walk | None] = [None] * len(pairs)
        for first in range(0, len(goals), GOALS_AT_ONCE):
            for goal, walk in self._solved(problem, goals[first : first + GOALS_AT_ONCE]):
                for i, start in asked[goal]:
                    found[i] = walk(start)
        return found

    def _solved(self, problem, goals):
        """Yield `(goal, function of a start that returns the Walk)` for goals of a problem."""
        n, tail, head = len(self.ids), self.tail, self.head
        targets = [[self.row[own] for own in (problem.stubs if goal is None else (goal,))] for goal in goals]
        is_open = ~np.isin(self.link, list(problem.shut))
        is_barrier, is_stub = (np.isin(self.ids, list(own)) for own in (problem.barriers, problem.stubs))
        # Node v is passed where a way goes on from it, node n + v is v as the goal, node 2 n all stubs as one.
        uses = [np.flatnonzero(is_open & mask) for mask in (~is_barrier[tail], True, is_stub[tail])]
        rows = np.concatenate([tail[uses[0]], n + tail[uses[1]], np.full(len(uses[2]), 2 * n)])
        edges = np.concatenate(uses)
        until = np.searchsorted(rows, np.arange(2 * n + 2))
        graph = csr_array((self.cost[edges], head[edges], until), shape=(2 * n + 1, 2 * n + 1))
        away = dijkstra(graph, indices=[2 * n if goal is None else n + self.row[goal] for goal in goals])[:, :n]
        for goal, own, far in zip(goals, targets, away):
            far[own] = 0.0
            beyond = np.where(is_barrier, np.inf, far)
            beyond[own] = 0.0
            leads = np.flatnonzero(is_open & (far[tail] == self.cost + beyond[head]))[::-1]
            by = np.full(n, -1)
            by[tail[leads]] = leads  # the last one written is that of the lowest id
            yield goal, lambda start, far=far, by=by, own=frozenset(own): self._walk(start, far, by, own)

    def _walk(self, start, far, by, targets) -> Walk | None:
        at = self.row[start]
        if far[at] == np.inf:
            return None
        nodes, links = [start], []
        while at not in targets:
            links.append(int(self.link[by[at]]))
            at = int(self.head[by[at]])
            nodes.append(self.ids[at])
        return Walk(tuple(nodes), tuple(links))
