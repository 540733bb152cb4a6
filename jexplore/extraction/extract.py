"""A Behavioral Trace Map from a grid map: what a robot's own would show, read off the generalised Voronoi graph.

A triangle by which a robot knows a dead end, a corner, a T or a crossing is an empty disc that touches three walls: a
junction of that graph, whose branches are passages or run into corners. Runs on the host but for the graph's cells.
"""

import itertools
import math
from collections.abc import Container

import jax
import jax.numpy as jnp
import numpy as np

from jexplore.arrays.padding import framed, within
from jexplore.config import InputError
from jexplore.extraction.lines import Lines, connected_cells, lines_of, take_corners
from jexplore.extraction.passages import SEARCH, PlaceDraft, places_and_passages
from jexplore.grid import centre_of, in_cells
from jexplore.rooms.scores import label_components
from jexplore.rooms.watershed import CLUTTER_M, clutter
from jexplore.tracemap.record import NOWHERE, STATUS, BtmMap, Link, Node

_UNSEARCHED, _SEARCHED = STATUS
_looked_through = jax.jit(clutter, static_argnames="edges")


def extract(
    free: np.ndarray,
    known: np.ndarray,
    cell_m: float,
    *,
    start_rc: tuple[int, int] | None = None,
    width_m: float = 0.39,
    open_m: float = 2.5,
    clutter_m: float = CLUTTER_M,
    origin_m: tuple[float, float] = (0.0, 0.0),
) -> BtmMap:
    """Extract the trace map of a grid map, on the host.

    Divergence nodes are junctions of the Voronoi graph with a dead end, a corner or three and more passages; those
    nearer to each other than their clearance are merged. A clearance above `open_m` means free space: one node at the
    mouth of each passage into it, the nodes linked in a ring. A way into unknown space is an un-searched link. Passages
    narrower than `width_m` are closed. Without obstacle nodes: a grid has no heights. Nodes are in the order of a
    depth-first search that takes the first link counter-clockwise from its entry.

    Args:
      free: `[H, W]` bool, cells known to be free.
      known: `[H, W]` bool, cells seen. Patches of unseen cells too small for the robot count as free.
      cell_m: edge of a cell, metres.
      start_rc: row, col of the robot's start, a free cell: the first node. Without, the largest part of the graph is
        taken and no terminal node is made for the start.
      width_m: width of the robot, metres.
      open_m: clearance above which a place is free space, metres: the paper's C1.
      clutter_m: obstacles in the open whose bounding box has a shorter diagonal, metres, are looked through.
      origin_m: x, y of the lower left corner of cell (0, 0), metres.

    Raises:
      InputError: no cell is free, or the start's is not.

    Source:
      Mano et al., Behavioral Trace Map. Changed: from the Voronoi graph of a whole map instead of single scans.
    """
    if not free.any():
        raise InputError("free: no cell of the map is free")
    if start_rc is not None and not (np.all(np.less(start_rc, free.shape)) and min(start_rc) >= 0 and free[start_rc]):
        raise InputError(f"start: cell {tuple(map(int, start_rc))} is not a free cell of the map")
    open_ = open_cells(known & ~free, known, in_cells(width_m, cell_m))[0]
    padded = framed(open_)
    mask, overflow = _looked_through(jnp.asarray(padded), jnp.float32(in_cells(clutter_m, cell_m)), edges=padded.size)
    assert not overflow
    open_ |= within(np.asarray(mask), free.shape, 1)
    lines = lines_of(known & ~free & ~open_, open_, width=in_cells(width_m, cell_m))
    corners = take_corners(lines)
    if start_rc is None:
        parts = connected_cells(lines.near, [i for i in range(len(lines.row)) if _counts(lines, i)])
        start, alive, terminals = None, max(parts, key=len, default=set()), {}
    else:
        start = attached(lines, corners, start_rc, open_)
        if start is None:
            return _numbered({0: PlaceDraft(*start_rc, "terminal", 0.0)}, [], 0, lines, cell_m, origin_m)
        alive = connected_cells(lines.near, [start])[0]
        terminals = {start: PlaceDraft(*start_rc, "terminal", float(lines.radius[start]))}
    places, ways = places_and_passages(lines, corners, alive, terminals, open_cells=in_cells(open_m, cell_m))
    first = min(places, key=lambda key: places[key][:2], default=None) if start is None else start
    return _numbered(places, ways, first, lines, cell_m, origin_m)


def open_cells(occupied: np.ndarray, known: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray]:
    """Return `(free, obstacle)`, `[H, W]` bool: unseen patches too small for a robot of `width` cells are free."""
    patches = label_components(~known)
    small = np.bincount(patches[patches >= 0], minlength=1) < max(width, 1) ** 2
    return (known & ~occupied) | ((patches >= 0) & small[patches]), known & occupied


def _counts(lines, cell):
    return bool(lines.known[cell] and lines.near[cell])


def attached(lines: Lines, corners: Container[int], place: tuple[int, int], free: np.ndarray) -> int | None:
    """Return the cell of the graph that a place, row and column, belongs to; None if it is on no part of the graph.

    That is the nearest in sight, no junction if that can be.
    """
    (row, col), parts = place, label_components(free)
    same = parts[lines.row, lines.col] == parts[row, col]
    cells = [i for i in np.flatnonzero(same).tolist() if _counts(lines, i)]
    cells = [i for i in cells if len(lines.near[i]) == 2 and i not in corners] or cells
    cells.sort(key=lambda i: math.hypot(lines.row[i] - row, lines.col[i] - col))
    seen = (i for i in cells if _in_sight(free, row, col, lines.row[i], lines.col[i]))
    return next(seen, cells[0] if cells else None)


def _in_sight(free, row, col, to_row, to_col):
    n = 2 * max(abs(to_row - row), abs(to_col - col)) + 1
    rows, cols = np.linspace(row, to_row, n).round().astype(int), np.linspace(col, to_col, n).round().astype(int)
    return bool(free[rows, cols].all())


# Records


def _numbered(places, ways, first, lines, cell_m, origin_m):
    """Renumber places and ways as one meets them from the place `first`: a `BtmMap`."""
    bearing, leaving = {}, {key: [] for key in places}  # of ends of ways: number, whether it is the last end
    for n, way in enumerate(ways):
        for last, key, path in ((False, way.start, way.path), (True, way.end, way.path[::-1])):
            if key is not None:
                bearing[n, last] = leaves(lines, places[key], path)
                leaving[key].append((n, last))
    number, links = {}, {}
    stack = [(first, None)] if places else []
    while stack:
        key, came = stack.pop()
        if came:
            if came[0] in links:
                continue
            links[came[0]] = came[1]
        if key is None or key in number:
            continue
        number[key] = len(number)
        entry = bearing[came[0], not came[1]] if came else 0.0
        out = sorted(leaving[key], key=lambda end: ((bearing[end] - entry - 1e-6) % 360, end[1]))
        stack += [(ways[n].start if last else ways[n].end, (n, last)) for n, last in reversed(out) if n not in links]
    at = [centre_of(places[key].row, places[key].col, cell_m=cell_m, origin_m=origin_m) for key in number]
    nodes = (Node(i, float(at[i][0]), float(at[i][1]), places[key].type) for i, key in enumerate(number))
    records = []
    for n, last in links.items():
        start, end = (number.get(key, NOWHERE) for key in (ways[n].start, ways[n].end))
        ends = (end, start) if last else (start, end)
        bearings = bearing[n, last], bearing.get((n, not last))
        records.append(_link(len(records), ends, bearings, ways[n], places, lines, cell_m))
    return BtmMap(tuple(nodes), tuple(records))


def _link(number, ends, bearings, way, places, lines, cell_m):
    """Make a `Link` between the nodes `ends`, along a way that may run from the last of them to the first."""
    (start, end), (start_deg, end_deg) = ends, bearings
    from_place, to_place = places[way.start], places.get(way.end)
    if to_place is None:
        seen = list(itertools.takewhile(lines.known.__getitem__, way.path))[: int(2 * from_place.radius) + 1]
        return Link(number, start, end, _UNSEARCHED, start_deg, opening_m=_narrowest(lines, seen) * cell_m)
    # Every fourth cell: a line of cells is longer than the line that it stands for.
    stops = [from_place[:2], *lines.at[way.path[2:-2:4]].tolist(), to_place[:2]]
    length = sum(math.dist(one, two) for one, two in itertools.pairwise(stops))
    narrowest = _narrowest(lines, way.path)
    return Link(number, start, end, _SEARCHED, start_deg, end_deg, length * cell_m, narrowest * cell_m)


def _narrowest(lines, path):
    """Return the least width along a path, cells. A line of cells may stray from the axis for one of them."""
    radius = lines.radius[path]
    if len(path) > 2:
        radius = np.maximum(radius, np.maximum(np.roll(radius, 1), np.roll(radius, -1)))
    return float(2 * radius.min() - 1)


def leaves(lines: Lines, place: PlaceDraft, path: list[int]) -> float:
    """Return the direction in which a path leaves a place: to where it crosses its search circle, degrees."""
    rows, cols = (lines.at[path] - place[:2]).T
    away = np.hypot(rows, cols)
    out = away >= SEARCH * place.radius
    i = int(np.argmax(out if out.any() else away))
    return float(np.degrees(np.arctan2(rows[i], cols[i])) % 360)
