"""Places and ways that the local map shows: the generalised Voronoi graph of the cells known to be free."""

import itertools
import math
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from jexplore.driving.local.lattice import distance_m
from jexplore.driving.local.window import CELL_M, Window
from jexplore.extraction.extract import attached, leaves, open_cells
from jexplore.extraction.lines import connected_cells, lines_of, take_corners
from jexplore.extraction.passages import PlaceDraft, places_and_passages

EVERY = 2  # of the cells along a way one in this many is kept
EVERY_WAY = np.ones((3, 3), bool)  # a cell's neighbours


def frontier(window: Window, known: np.ndarray, width_m: float) -> np.ndarray:
    """Return the cells next to the unknown where a robot of a width could pass on: `[SIDE, SIDE]` bool.

    `known` are the cells that count as known, those of the local map or more.
    """
    free, _ = open_cells(window.occupied, known, width_m / CELL_M)
    edge = window.known & ndimage.binary_dilation(~known & ~free, EVERY_WAY)
    return edge & (distance_m(window.occupied) > width_m / 2)


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
    is_sure: bool  # no frontier lies within its clearance
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
    here = attached(lines, corners, cell, free)
    if here is None:
        return []
    alive, terminals = connected_cells(lines.near, [here])[0], {}
    if all(0 < i < n - 1 for i, n in zip(began, free.shape, strict=True)) and free[began]:
        at = attached(lines, corners, began, free)
        if at in alive:
            terminals = {at: PlaceDraft(float(began[0]), float(began[1]), "terminal", float(lines.radius[at]))}
    places, ways = places_and_passages(lines, corners, alive, terminals, open_cells=open_m / CELL_M)
    edge_m = distance_m(frontier(window, window.known, width_m))
    number = {key: i for i, key in enumerate(places)}

    def seen(place):
        radius_m = place.radius * CELL_M
        xy = window.xy(np.array([place.row, place.col]))
        is_sure = place.type == "terminal" or edge_m[round(place.row), round(place.col)] > radius_m
        return SeenPlace(xy, place.type, radius_m, bool(is_sure), [])

    found = [seen(place) for place in places.values()]
    for way in ways:
        for key, other, path in ((way.start, way.end, way.path), (way.end, way.start, way.path[::-1])):
            if key in number:
                known = list(itertools.takewhile(lines.known.__getitem__, path)) or path[:1]
                xy = window.xy(lines.at[[*known[::EVERY], known[-1]]])
                bearing = math.radians(leaves(lines, places[key], path))
                found[number[key]].ways.append(SeenWay(bearing, number.get(other, -1), xy))
    return found
