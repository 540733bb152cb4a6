"""Places of a Voronoi graph and the ways between them: a Behavioral Trace Map in the making."""

import collections
import itertools
import math
from typing import Any, NamedTuple

import numpy as np

from jexplore.extraction.lines import Lines, bearing_deg, cells_apart, chains, connected_cells

CLOSING = 0.9  # free space, once entered, ends where the clearance falls below this share of `open_cells`
SEARCH = 1.5  # radius of the circle on which the ways out of a place are looked for, in clearances


class PlaceDraft(NamedTuple):
    """A node in the making."""

    row: float
    col: float
    type: str
    radius: float  # cells
    corners: int = 0


class PassageDraft(NamedTuple):
    """A link in the making: cells from one place to another."""

    start: Any  # key of a place
    end: Any  # key of a place, None for a way into the unknown
    path: list[int]


def places_and_passages(
    lines: Lines, corners: dict[int, int], alive: set[int], terminals: dict[int, PlaceDraft], *, open_cells: float
) -> tuple[dict[int, PlaceDraft], list[PassageDraft]]:
    """Return the places of a graph, by key, and the ways between them.

    `corners` counts corners by cell, `alive` are the cells that count, `terminals` lie there, by cell; `open_cells` is
    the clearance of free space.
    """
    near = {cell: set(lines.near[cell]) for cell in alive}
    fixed = corners.keys() | terminals.keys()
    _close_gaps(lines, near, corners, fixed, open_cells)
    special = {cell for cell in alive if cell in fixed or len(near[cell]) != 2}
    spaces, mouths = free_spaces(lines, near, special, open_cells)
    inside = set().union(*spaces)
    outside = {cell: near[cell] - inside for cell in sorted(alive - inside)}
    keys = (special | mouths) - inside
    paths = list(chains(outside, outside, keys))
    places = {cell: _place(lines, [cell], "free_space") for cell in mouths if lines.known[cell]} | terminals
    name = {cell: cell for cell in mouths | terminals.keys()}
    for part in _merged(lines, keys - name.keys(), paths):
        name |= dict.fromkeys(part, part[0])
        if lines.known[part].any():
            places[part[0]] = _place(lines, part, "divergence", sum(corners.get(cell, 0) for cell in part))
    for space in spaces:
        paths += _paths_through(lines, near, space, mouths | terminals.keys())
    ways = []
    for path in paths:
        start, end = name[path[0]], name.get(path[-1])
        if start == end and len(path) <= 2 * lines.radius[path[0]]:
            continue
        if lines.known[path].all():
            ways.append(PassageDraft(start, end, path))
        else:
            ways += [PassageDraft(name[p[0]], None, p) for p in (path, path[::-1]) if lines.known[p[0]]]
    return _tidied(places, ways)


def _place(lines, cells, kind, corners=0):
    row, col = lines.at[cells].mean(0).tolist()
    return PlaceDraft(row, col, kind, float(lines.radius[cells].max()), corners)


def _close_gaps(lines, near, corners, keys, open_cells):
    """Take ways through gaps of walls off `near`: far walls are seen as single points.

    Of the ways into the unknown a junction keeps those that are seen beyond its disc and beyond their narrowest place
    near it. One without any other way out keeps the one that is seen furthest. In free space all count.
    """
    blind = []
    for path in list(chains(near, sorted(near), keys)):
        for way in (path, path[::-1]):
            seen = list(itertools.takewhile(lines.known.__getitem__, way))
            radius = lines.radius[way[0]]
            if 0 < len(seen) < len(way) and radius - 0.5 <= open_cells:
                reach = max(cells_apart(lines, cell, way[0]) for cell in seen)
                neck = int(np.argmin(lines.radius[way[: int(SEARCH * radius)]]))
                if reach <= radius or neck >= len(seen) - 1:
                    blind.append((reach, way[0], way[1]))
    for _, a, b in sorted(blind):
        if len(near[a]) + corners.get(a, 0) > 2 and len(near[a]) > 1:
            near[a].discard(b)
            near[b].discard(a)


def _merged(lines, junctions, paths):
    """Merge junctions nearer to each other than the smaller of their clearances: sorted lists."""
    close = {cell: set() for cell in sorted(junctions)}
    for path in paths:
        a, b = path[0], path[-1]
        limit = max(min(lines.radius[a], lines.radius[b]) - 0.5, 2)
        if a in close and b in close and cells_apart(lines, a, b) < limit:
            close[a].add(b)
            close[b].add(a)
    return [sorted(part) for part in connected_cells(close, close)]


def _tidied(places, ways):
    """Remove junctions that are passed straight on, and the dead end in which a terminal stands."""
    for key in [key for key, place in places.items() if place.type == "divergence"]:
        own = [way for way in ways if key in (way.start, way.end)]
        degree = sum((way.start == key) + (way.end == key) for way in own)
        if degree == 0:
            del places[key]
        elif degree == len(own) == 2 and not places[key].corners:
            # First the way in, of which the far end is known if either is.
            into, on = sorted((_away(way, key) for way in own), key=lambda way: way.end is None)
            if into.end is not None:
                ways = [way for way in ways if way not in own]
                ways.append(PassageDraft(into.end, on.end, into.path[::-1] + on.path[1:]))
                del places[key]
        elif len(others := {_away(way, key).end for way in own} - {key}) == 1:
            other = places.get(others.pop())
            if other and other.type == "terminal" and math.dist(other[:2], places[key][:2]) < places[key].radius:
                ways = [way for way in ways if way not in own]
                del places[key]
    return places, ways


def _away(way, key):
    """Return the way as one that starts at `key`."""
    return way if way.start == key else PassageDraft(way.end, way.start, way.path[::-1])


# Free space


def free_spaces(
    lines: Lines, near: dict[int, set[int]], special: set[int], open_cells: float
) -> tuple[list[set[int]], set[int]]:
    """Return parts of the graph in free space, sets of cells, and the mouths of passages: the cells next to them.

    `near` has neighbours by cell; `special` cells are terminals, junctions or loose ends.
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
    for path in chains(near, sorted(inside), inside | special):
        yield from (way for way in (path, path[::-1]) if way[0] in inside and way[1] not in inside)


def _paths_through(lines: Lines, near: dict[int, set[int]], space: set[int], ports: set[int]) -> list[list[int]]:
    """Find paths from each port, a mouth or terminal, to the next one counter-clockwise, or to unknown space."""
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
