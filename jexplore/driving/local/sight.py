"""Places and ways that the local map shows: the generalised Voronoi graph of the cells known to be free."""

import itertools
import math
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from jexplore.driving.local.lattice import distance_m
from jexplore.driving.local.window import CELL_M, SIDE, Window
from jexplore.extraction.extract import attached, leaves, open_cells
from jexplore.extraction.lines import connected_cells, lines_of, take_corners
from jexplore.extraction.passages import PlaceDraft, places_and_passages

CONFIRM_M = 0.1  # a place is confirmed where all is known within its clearance and this: a cell
EVERY = 2  # of the cells along a way one in this many is kept


class SeenWay(NamedTuple):
    """A way out of a place."""

    bearing: float  # radians
    to: int  # place in `Sight.places`, -1: it leads into the unknown
    path: np.ndarray  # [n, 2] float, metres, as far as it is known


class SeenPlace(NamedTuple):
    """A place in the local map."""

    xy: np.ndarray  # [2] float, metres
    type: str  # one of `NODE_TYPES`
    radius_m: float  # clearance
    is_sure: bool  # all around it is known, or the robot is there
    ways: list[SeenWay]


def look(window: Window, pose: np.ndarray, start: np.ndarray, width_m: float, open_m: float) -> list[SeenPlace]:
    """Return the places of the part of the graph that the robot is at.

    Args:
      pose: `[3]`, of the robot.
      start: `[2]`, metres; the place there is a terminal node, where the window holds it.
      width_m, open_m: as of `extract`, which reads whole maps in this way.
    """
    free, obstacle = open_cells(window.occupied, window.known, width_m / CELL_M)
    lines = lines_of(obstacle, free, width=width_m / CELL_M)
    corners = take_corners(lines)
    cell, began = (tuple(window.cell(xy).tolist()) for xy in (pose[:2], start))
    here = attached(lines, corners, {"start": cell}, free).get("start")
    if here is None:
        return []
    alive, terminals = connected_cells(lines.near, [here])[0], {}
    if all(0 < i < SIDE - 1 for i in began) and free[began]:
        at = attached(lines, corners, {"start": began}, free).get("start")
        if at in alive:
            terminals = {at: PlaceDraft(float(began[0]), float(began[1]), "terminal", float(lines.radius[at]))}
    places, ways = places_and_passages(lines, corners, alive, terminals, open_cells=open_m / CELL_M)
    edge = free & ndimage.binary_dilation(~window.known & ~free)
    edge_m = distance_m(edge)
    number = {key: i for i, key in enumerate(places)}

    def seen(place):
        sure_m = place.radius * CELL_M + CONFIRM_M
        xy = window.xy(np.array([place.row, place.col]))
        is_there = place.type == "terminal" or math.dist(xy, pose[:2]) < sure_m
        is_sure = is_there or edge_m[round(place.row), round(place.col)] > sure_m
        return SeenPlace(xy, place.type, place.radius * CELL_M, bool(is_sure), [])

    found = [seen(place) for place in places.values()]
    for way in ways:
        for key, other, path in ((way.start, way.end, way.path), (way.end, way.start, way.path[::-1])):
            if key in number:
                known = list(itertools.takewhile(lines.known.__getitem__, path)) or path[:1]
                xy = window.xy(lines.at[[*known[::EVERY], known[-1]]])
                bearing = math.radians(leaves(lines, places[key], path))
                found[number[key]].ways.append(SeenWay(bearing, number.get(other, -1), xy))
    return found
