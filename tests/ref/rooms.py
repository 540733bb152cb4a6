"""Oracle for rooms: Figure 7 of Holz et al. 2010, word by word. Arrays are `[row, col]`, row 0 at the bottom.

A skeleton is a set of cells `(row, col)`; a clearance map holds squared distances to the nearest obstacle, cells^2.
"""

import collections
import itertools
import math

import networkx as nx
import numpy as np
from scipy.sparse import csgraph, lil_matrix

from ref import plans

STRAIGHT, DIAGONAL = 70, 99  # steps of the geodesic distance: sqrt(2) to 1 in 10,000
DIRECTIONS = plans.MOTIONS  # straight ones first


def medial_axis(obstacle, gamma):
    """Of two free cells side by side whose nearest obstacles lie more than `gamma` apart, the one on whose side of
    their middle the boundary lies, where both obstacles are equally far; both if it runs through the middle.
    """
    site = plans.nearest_site(obstacle)[1]
    places = np.stack(np.divmod(site, obstacle.shape[1]), axis=-1)
    marked = np.zeros(obstacle.shape, bool)
    for cell in map(tuple, np.argwhere(~obstacle & (site >= 0))):
        for motion in DIRECTIONS[:4]:
            there = cell[0] + motion[0], cell[1] + motion[1]
            if not all(0 <= i < n for i, n in zip(there, obstacle.shape)) or obstacle[there]:
                continue
            own, other = places[cell], places[there]
            middle = (np.array(cell) + there) / 2
            if math.dist(own, other) > gamma and ((own - middle) ** 2).sum() >= ((other - middle) ** 2).sum():
                marked[cell] = True
    return marked


def linked(skeleton):
    """The skeleton as a graph. Cells side by side are linked; cells corner to corner where no third touches both."""
    graph = nx.Graph()
    graph.add_nodes_from(skeleton)
    for row, col in skeleton:
        for drow, dcol in DIRECTIONS:
            there = row + drow, col + dcol
            between = {(row + drow, col), (row, col + dcol)} if drow and dcol else set()
            if there in skeleton and not between & set(skeleton):
                graph.add_edge((row, col), there)
    return graph


def neighbours(graph, cell):
    """Linked cells, in the order of `DIRECTIONS`."""
    return [
        (cell[0] + drow, cell[1] + dcol)
        for drow, dcol in DIRECTIONS
        if graph.has_edge(cell, (cell[0] + drow, cell[1] + dcol))
    ]


def walk(graph, cell, towards):
    """The chain from a cell on through one of its neighbours: up to the first node that is not of degree 2, which is
    the last of the list; on a ring up to the cell where it began, left out.
    """
    chain, before = [], cell
    while towards != cell:
        chain.append(towards)
        if graph.degree(towards) != 2:
            break
        (after,) = set(graph[towards]) - {before}
        before, towards = towards, after
    return chain


def rise(chain, height, own):
    """The most that a chain rises above `own`, an orderable height, before it falls below; None if it never rises."""
    up = list(itertools.takewhile(lambda h: h > own, map(height, chain)))
    return max(up, default=None)


def is_extreme(graph, d2, cell, prominence, sign):
    """Return whether a node of degree 2 is a minimum (`sign` 1) or a maximum (-1) of the clearance along its chain."""
    if graph.degree(cell) != 2:
        return False

    def height(at):
        return sign * int(d2[at]), sign * (at[0] * d2.shape[1] + at[1])

    for side in graph[cell]:
        top = rise(walk(graph, cell, side), height, height(cell))
        if top is None or abs(math.sqrt(abs(top[0])) - math.sqrt(d2[cell])) < prominence:
            return False
    return True


def critical_points(graph, d2, *, max_hops, prominence):
    """Minima from which fewer than `max_hops` other minima and maxima lie on the way to a junction; all minima with
    `max_hops` None. Cells in (row, col) order.
    """
    minima, maxima = ({c for c in graph if is_extreme(graph, d2, c, prominence, sign)} for sign in (1, -1))

    def near_junction(cell):
        chains = [walk(graph, cell, side) for side in graph[cell]]
        ways = [chain for chain in chains if graph.degree(chain[-1]) >= 3]
        return any(len((minima | maxima) & set(chain)) < max_hops for chain in ways)

    return [c for c in sorted(minima) if max_hops is None or near_junction(c)]


def distances(passable, starts):
    """Compute the shortest paths from every start: `[len(starts), H, W]`, infinite without one."""
    height, width = passable.shape
    steps = lil_matrix((passable.size, passable.size))
    for row, col in itertools.product(range(height), range(width)):
        for drow, dcol in DIRECTIONS:
            if plans.may_step(passable, row, col, (drow, dcol)):
                length = DIAGONAL if drow and dcol else STRAIGHT
                steps[row * width + col, (row + drow) * width + col + dcol] = length
    flat = [row * width + col for row, col in starts]
    return csgraph.dijkstra(steps.tocsr(), indices=flat).reshape(len(flat), height, width)


def nearest_by_path(passable, seeds):
    """Return the seed with the shortest path, the lowest of several; -1 without one."""
    if not seeds:
        return np.full(passable.shape, -1)
    length = distances(passable, seeds)
    return np.where(passable & (length.min(0) < math.inf), length.argmin(0), -1)


def borders(label):
    """Count the pairs of adjacent cells for each pair of labels: `{(lower, higher): n}`."""
    shared = collections.Counter()
    for one, other in ((label[:, 1:], label[:, :-1]), (label[1:], label[:-1])):
        for pair in zip(one.ravel().tolist(), other.ravel().tolist()):
            if min(pair) >= 0 and pair[0] != pair[1]:
                shared[min(pair), max(pair)] += 1
    return shared


def merge(shared, seeds):
    """Groups of labels, one for each seed, that touch or have the same seed, the two sides 2 k and 2 k + 1 of a split
    never in one: list of sets.
    """
    groups = [{i for i, other in enumerate(seeds) if other == seed} for seed in dict.fromkeys(seeds)]
    for (a, b), _ in sorted(shared.items(), key=lambda item: (-item[1], item[0])):
        (one,), (other,) = ([g for g in groups if i in g] for i in (a, b))
        if one is not other and not any(i ^ 1 in other for i in one):
            groups = [g for g in groups if g is not one and g is not other] + [one | other]
    return groups


def segments(free, skeleton, d2, **criteria):
    """Figure 7: `(critical points, seeds, labels)`. A group is named after its lowest label; -1 for none."""
    graph = linked(skeleton)
    critical = critical_points(graph, d2, **criteria)
    seeds = [cell for c in critical for cell in neighbours(graph, c)]
    label = nearest_by_path(free, seeds)
    name = {i: min(group) for group in merge(borders(label), seeds) for i in group}
    return critical, seeds, np.vectorize(lambda i: name.get(i, -1), otypes=[int])(label)


def carved(draw, height, width):
    """Free cells: a few random rectangles cut out of rock, rooms and passages, with rock all around."""
    free = np.zeros((height, width), bool)
    for _ in range(draw.integers(1, 8)):
        sizes = draw.integers(1, [height // 2, width // 2], endpoint=True)
        if draw.random() < 0.5:  # a passage
            along = draw.integers(2)
            sizes[along], sizes[1 - along] = (height, width)[along], draw.integers(1, 4)
        row, col = draw.integers(0, np.array([height, width]) - sizes, endpoint=True)
        free[row : row + sizes[0], col : col + sizes[1]] = True
    free[[0, -1], :] = free[:, [0, -1]] = False
    return free


def walled(draw, height, width):
    """Free cells: rooms divided by walls one cell thick, with one or two doors, one or two cells wide, in each wall;
    a corner or a pillar here and there.
    """
    free = np.zeros((height, width), bool)
    free[1:-1, 1:-1] = True

    def divide(room):  # a view: writing to it writes to the map
        if room.shape[0] < room.shape[1]:
            room = room.T
        if room.shape[0] < 7 or draw.random() < 0.1:
            return
        at = int(draw.integers(3, room.shape[0] - 3))
        divide(room[:at]), divide(room[at + 1 :])
        room[at] = False
        for _ in range(draw.integers(1, 3)):
            door = int(draw.integers(room.shape[1]))
            room[at - 1 : at + 2, door : door + draw.integers(1, 3)] = True

    divide(free[1:-1, 1:-1])
    return free & (draw.random(free.shape) >= 0.01)


def same_partition(one, other):
    """Return whether two label maps divide the same cells in the same way, whatever their labels."""
    pairs = set(zip(np.ravel(one).tolist(), np.ravel(other).tolist()))
    named = [p for p in pairs if p != (-1, -1)]
    return all(-1 not in p for p in named) and all(len({p[i] for p in named}) == len(named) for i in (0, 1))
