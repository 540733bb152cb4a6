"""A maze on a square lattice."""

import collections
import itertools
from collections.abc import Sequence

import numpy as np

from jexplore.config import InputError
from jexplore.worlds.bounds import count_cells
from jexplore.worlds.generators.draft import passable_cells, random_stream, wall_span
from jexplore.worlds.world import World

_Place = tuple[int, int]


def maze(
    seed: int,
    *,
    cell_m: float = 0.1,
    width_m: float = 15.0,
    height_m: float = 15.0,
    corridor_m: float = 1.2,
    wall_m: float = 0.2,
    loops: float = 0.1,
) -> World:
    """Generate a maze: every place is reached, by exactly one way if `loops` is 0.

    As many corridors as fit are spread over the size: they are at least `corridor_m` wide, up to a cell. A random
    depth-first walk lays them: long corridors, deep dead ends. `loops` is the fraction of the walls between two places
    of the perfect maze that is taken away again.
    """
    shape, spans = [], []
    for side_m in (height_m, width_m):
        n = int((side_m - wall_m + 1e-6) // (corridor_m + wall_m))
        middles = [0.0, *(wall_m / 2 + k * (side_m - wall_m) / n for k in range(1, n)), side_m]
        spans.append([wall_span(middle, side_m, cell_m, wall_m=wall_m, outer_m=wall_m) for middle in middles])
        shape.append(n)
        narrowest = min(after[0] - before[1] for before, after in itertools.pairwise(spans[-1]))
        if narrowest < passable_cells(cell_m):
            raise InputError(
                f"maze: corridor_m = {corridor_m:g} leaves {max(narrowest, 0)} cells of {cell_m:g} m between walls "
                f"and a robot needs {passable_cells(cell_m)}; use wider corridors or a smaller cell_m"
            )
    occupied = np.ones((count_cells(height_m, cell_m), count_cells(width_m, cell_m)), bool)
    ys, xs = ([slice(a[1], b[0]) for a, b in itertools.pairwise(axis)] for axis in spans)
    for y, x in itertools.product(ys, xs):
        occupied[y, x] = False
    for (row, col), (to_row, to_col) in passages(random_stream(seed, "maze"), shape, loops):
        if row == to_row:
            occupied[ys[row], slice(*spans[1][max(col, to_col)])] = False
        else:
            occupied[slice(*spans[0][max(row, to_row)]), xs[col]] = False
    return World(occupied=occupied, cell_m=float(cell_m))


def passages(rng: np.random.Generator, shape: Sequence[int], loops: float) -> list[tuple[_Place, _Place]]:
    """Choose the neighbouring places `(row, col)` of a maze that are joined; the first rows * cols - 1 pairs are a
    tree.

    `loops`: fraction of the walls that this spanning tree leaves, and that are opened all the same.
    """
    rows, cols = shape

    def beside(place: _Place) -> list[_Place]:
        row, col = place
        ways = (row, col + 1), (row + 1, col), (row, col - 1), (row - 1, col)
        return [(y, x) for y, x in ways if 0 <= y < rows and 0 <= x < cols]

    trail: list[_Place] = [(int(rng.integers(rows)), int(rng.integers(cols)))]
    seen, joined = {trail[0]}, []
    while trail:
        ways = [way for way in beside(trail[-1]) if way not in seen]
        if not ways:
            trail.pop()
            continue
        way = ways[rng.integers(len(ways))]
        joined.append((trail[-1], way))
        seen.add(way)
        trail.append(way)
    tree = {frozenset(pair) for pair in joined}
    places = itertools.product(range(rows), range(cols))
    walls = [(a, b) for a in places for b in beside(a) if b > a and frozenset((a, b)) not in tree]
    order = [walls[i] for i in rng.permutation(len(walls))]
    return joined + _last_of_a_post_last(order, shape)[: round(loops * len(walls))]


def _last_of_a_post_last(walls: list[tuple[_Place, _Place]], shape: Sequence[int]) -> list[tuple[_Place, _Place]]:
    """Sort walls last without which a post between four places would stand alone."""
    ends = [((max(a[0], b[0]), max(a[1], b[1])), (a[0] + 1, a[1] + 1)) for a, b in walls]
    left = collections.Counter(post for pair in ends for post in pair)
    for y, x in left:
        left[y, x] += y in (0, shape[0]) or x in (0, shape[1])  # the outer wall holds it
    early, late = [], []
    for wall, posts in zip(walls, ends):
        if any(left[post] == 1 for post in posts):
            late.append(wall)
        else:
            early.append(wall)
            left.subtract(posts)
    return early + late
