"""Free space in a Voronoi graph: its parts that are wide enough, the mouths of the passages there, the ways through."""

import collections
import itertools

import numpy as np

from jexplore.extraction.lines import Lines, bearing_deg, cells_apart, connected_cells

CLOSING = 0.9  # free space, once entered, ends where the clearance falls below this share of `open_cells`


def free_spaces(
    lines: Lines, near: dict[int, set[int]], special: set[int], open_cells: float
) -> tuple[list[set[int]], set[int]]:
    """Return parts of the graph in free space, sets of cells, and the mouths of passages: the cells next to them.

    Args:
      lines: `Lines`.
      near: neighbours by cell.
      special: cells that are terminals, junctions or loose ends.
      open_cells: clearance above which a place is free space, cells.
    """
    radius = lines.radius - 0.5
    wide = {cell for cell in near if radius[cell] > CLOSING * open_cells and lines.known[cell]}
    parts = connected_cells({cell: near[cell] & wide for cell in wide}, sorted(wide))
    inside = set().union(*(part for part in parts if radius[list(part)].max() > open_cells))
    while True:
        # A junction whose disc reaches a space belongs to it, and so does one without a passage in between.
        reached = set()
        for path in _leading_out(near, inside, special):
            last = path[-1]
            if last not in inside and (len(path) == 2 or cells_apart(lines, path[0], last) < lines.radius[last]):
                reached |= set(path[1:])
        if not reached:
            break
        inside |= reached
    mouths, grown = set(), set(inside)
    for path in _leading_out(near, inside, special):
        passage = path[1:-1]
        low = radius[passage[: max(int(open_cells), 1)]].min() + 0.5
        i = next(i for i, cell in enumerate(passage) if radius[cell] <= low)
        if path[-1] in inside:
            # Of a neck between two spaces only one half belongs to either.
            i = min(i, int(np.argmin(radius[passage])))
        grown |= set(passage[:i])
        mouths.add(passage[i])
    grown -= mouths
    return connected_cells({cell: near[cell] & grown for cell in grown}, sorted(grown)), mouths


def _leading_out(near, inside, special):
    """Yield paths from cells of a set to the next special cell outside or back into the set."""
    for cell in sorted(inside):
        for first in sorted(near[cell] - inside):
            path = [cell, first]
            while path[-1] not in inside and path[-1] not in special:
                (on,) = near[path[-1]] - {path[-2]}
                path.append(on)
            yield path


def paths_through(lines: Lines, near: dict[int, set[int]], space: set[int], ports: set[int]) -> list[list[int]]:
    """Find paths through one free space, from each port to the next one counter-clockwise and to unknown space.

    `ports` are mouths and terminals, wherever.
    """
    cells = space | {other for cell in space for other in near[cell] if other in ports}
    inner = {cell: near[cell] & (cells if cell in space else space) for cell in cells}
    ports = {cell for cell in cells & ports if lines.known[cell]}
    edge = {cell for cell in cells if not lines.known[cell] and any(lines.known[other] for other in near[cell])}
    if not ports:
        return []
    around = _around(lines, inner, min(ports), ports | edge)
    turns = [cell for cell in around if cell in ports]
    pairs = list(itertools.pairwise(turns)) + ([(turns[-1], turns[0])] if len(turns) > 2 else [])
    pairs += [(a, b) for a, b in itertools.pairwise(around) if a in ports and b in edge]
    return [_shortest(inner, a, b) for a, b in pairs]


def _around(lines, near, first, wanted):
    """Return those cells of a set that one meets along the wall, counter-clockwise, from the first."""
    found, seen, stack = [], set(), [(first, None)]
    while stack:
        cell, before = stack.pop()
        if cell in seen:
            continue
        seen.add(cell)
        if cell in wanted:
            found.append(cell)
        entry = 0.0 if before is None else bearing_deg(lines, cell, before)
        others = [((bearing_deg(lines, cell, other) - entry) % 360, other) for other in near[cell] - seen]
        stack += [(other, cell) for _, other in sorted(others, reverse=True)]
    return found


def _shortest(near, start, goal):
    """Return the cells of a shortest path, in steps."""
    before, queue = {goal: goal}, collections.deque([goal])
    while start not in before:
        cell = queue.popleft()
        for other in sorted(near[cell] - before.keys()):
            before[other] = cell
            queue.append(other)
    path = [start]
    while path[-1] != goal:
        path.append(before[path[-1]])
    return path
