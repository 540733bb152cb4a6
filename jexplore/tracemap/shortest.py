"""The shortest ways of many robots between many nodes of one map: solved on the device, followed on the host."""

import math
import os
from collections import deque
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jexplore.arrays.graphs import FAR, NONE, Around, links_around, shortest_ways
from jexplore.arrays.padding import bucket
from jexplore.config import InputError
from jexplore.tracemap.record import NOWHERE, length_of
from jexplore.tracemap.route import UNIT_M, Index

BESIDE = 32  # goals side by side: a block of them stays in a core's cache
BLOCKS = 16  # of goals, in one call
AHEAD = max(4, os.cpu_count() or 1)  # calls on their way at a time, so that cores work while one is read


class Problem(NamedTuple):
    """Part of a map that a robot may use; robots with the same part share a problem."""

    shut: frozenset[int]
    """Ids of searched links that it may not use."""
    barriers: frozenset[int]
    """Ids of nodes that it may not pass."""
    stubs: frozenset[int]
    """Ids of nodes with an un-searched link that the robot may follow: the goals where the goal is None."""


class Walk(NamedTuple):
    """The way from a start to a goal."""

    nodes: tuple[int, ...]
    """Ids, one more than links."""
    links: tuple[int, ...]
    """Ids."""


def walks(
    index: Index, problems: Sequence[Problem], pairs: Sequence[tuple[int, int | None]]
) -> Iterator[list[Walk | None]]:
    """Yield the walks of every problem, while the next are being solved.

    Args:
      index: of the map.
      problems: usable parts of the map.
      pairs: ids of nodes, start and goal; None as the goal for the nearest of `Problem.stubs`.

    Returns:
      Iterator over the problems, of a list with a `Walk` for every pair; None without a way.

    Raises:
      InputError: links too long in all.
    """
    graph = _Graph(index)
    goals = list(dict.fromkeys(goal for _, goal in pairs))
    column = {goal: i for i, goal in enumerate(goals)}
    start = np.array([graph.place[one] for one, _ in pairs], np.int64)
    goal = np.array([column[one] for _, one in pairs], np.int64)
    beside = min(BESIDE, _power(len(goals)))
    size = beside * min(BLOCKS, _power(-(-len(goals) // beside)))
    calls = ((problem, first) for problem in problems for first in range(0, len(goals), size))
    found: list[Walk | None] = [None] * len(pairs)
    for first, is_target, link in _solved(graph, calls, goals, (size // beside, graph.n, beside)):
        own = np.flatnonzero((goal >= first) & (goal < first + size))
        for i, walk in zip(own.tolist(), graph.followed(is_target, link, start[own], goal[own] - first)):
            found[i] = walk
        if first + size >= len(goals):
            yield found
            found = [None] * len(pairs)


def _power(n):
    return 2 ** math.ceil(math.log2(max(n, 1)))


class _Graph:
    """A map as padded arrays; nodes and links by place, links in the order of their ids."""

    def __init__(self, index: Index) -> None:
        links = [index.links[own] for own in sorted(index.links) if index.links[own].end != NOWHERE]
        metres = [length_of(link, index.nodes) for link in links]
        if sum(metres) >= FAR * UNIT_M:
            raise InputError(f"links must be less than {FAR * UNIT_M / 1000:.0f} km long in all")
        length = [round(own / UNIT_M) for own in metres]
        self.place = {own: i for i, own in enumerate(index.nodes)}
        self.link_place = {link.id: i for i, link in enumerate(links)}
        self.n, self.m = bucket(len(self.place)), bucket(len(links))
        self.length = np.pad(np.asarray(length, np.int32), (0, self.m - len(length)))
        ends = [(self.place[link.start], self.place[link.end]) for link in links]
        self.around = links_around(np.array(ends, np.int64).reshape(-1, 2), self.n)
        self._both = np.array(ends, np.int64).reshape(-1, 2).sum(1)  # less one end: the other
        self._node_ids, self._link_ids = np.array(list(index.nodes)), np.array([link.id for link in links], np.int64)

    def used(self, problem: Problem) -> tuple[np.ndarray, np.ndarray]:
        """Return links that are open, `[M]`, and nodes that are not to be passed, `[N]`."""
        is_open, barrier = np.ones(self.m, bool), np.zeros(self.n, bool)
        is_open[[self.link_place[own] for own in problem.shut]] = False
        barrier[[self.place[own] for own in problem.barriers]] = True
        return is_open, barrier

    def targets(self, problem: Problem, goals: Sequence[int | None], shape: tuple[int, int, int]) -> np.ndarray:
        """Return `[C, N, B]` bool, the targets of goal c B + b in column b of block c; none for missing goals."""
        is_target = np.zeros(shape, bool)
        for g, goal in enumerate(goals):
            places = [self.place[own] for own in (problem.stubs if goal is None else (goal,))]
            is_target[g // shape[2], places, g % shape[2]] = True
        return is_target

    def followed(self, is_target, link, start, goal) -> list[Walk | None]:
        """Follow the ways out of nodes, all at once.

        Args:
          is_target: `[C, N, B]`.
          link: `[C, N, B]`, by which the best way to a goal leaves a node; `NONE` where there is no next.
          start, goal: `[P]`, places of nodes, numbers of goals.

        Returns:
          As many `Walk`, None where there is no way.
        """
        block, column = np.divmod(goal, link.shape[2])
        nodes, links, count = [start], [], np.zeros(len(start), np.int64)
        for _ in self.place:  # a way meets each of them once at most
            at = nodes[-1]
            by = link[block, at, column]
            goes = by != NONE
            if not goes.any():
                break
            nodes.append(np.where(goes, self._both[by] - at, at))
            links.append(by)
            count += goes
        is_found = (count > 0) | is_target[block, start, column]
        own_nodes = _rows(self._node_ids[np.stack(nodes, 1)], count + 1)
        own_links = _rows(self._link_ids[np.stack(links, 1)], count) if links else [()] * len(start)
        return [Walk(ids, ways) if there else None for ids, ways, there in zip(own_nodes, own_links, is_found.tolist())]


def _rows(table, count):
    """Return the first `count` [P] entries of every row of a table, `[P, L]`, L of them at most: a list of tuples."""
    flat = tuple(table[np.arange(table.shape[1]) < count[:, None]].tolist())
    ends = np.cumsum(count).tolist()
    return [flat[first:end] for first, end in zip([0, *ends], ends)]


def _solved(graph, calls, goals, shape):
    """Yield `(problem, first goal)` of every call: the first, then `is_target` and `link` of `_Graph.followed`."""
    waiting = deque()

    def read():
        first, is_target, link = waiting.popleft()
        return first, is_target, jax.device_get(link)

    for problem, first in calls:
        is_target = graph.targets(problem, goals[first : first + shape[0] * shape[2]], shape)
        waiting.append((first, is_target, _solve(graph.around, graph.length, *graph.used(problem), is_target)))
        if len(waiting) > AHEAD:
            yield read()
    while waiting:
        yield read()


@jax.jit
def _solve(around: Around, length: Array, is_open: Array, barrier: Array, target: Array) -> Array:
    """Compute `Ways.link` for blocks of goals in turn, `[C, N, B]`; `target` has the same blocks."""
    length, is_open, barrier = jnp.asarray(length), jnp.asarray(is_open), jnp.asarray(barrier)  # numpy's without jit
    return lax.map(lambda block: shortest_ways(around, length, is_open, barrier, block).link, target)
