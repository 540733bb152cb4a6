"""Places of a Voronoi graph and the ways between them: a Behavioral Trace Map in the making."""

import itertools
import math
from typing import Any, NamedTuple

import numpy as np

from jexplore.extraction.free_space import free_spaces, paths_through
from jexplore.extraction.lines import Lines, cells_apart, chains, connected_cells

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

    Args:
      lines: `Lines`.
      corners: count of corners by cell.
      alive: set of the cells that count.
      terminals: by cell, all in `alive`.
      open_cells: clearance of free space, cells.
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
        paths += paths_through(lines, near, space, mouths | terminals.keys())
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
