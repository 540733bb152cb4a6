"""Paths of a rectangular robot on a grid of cells and eight headings: straight on, straight back, turns in place."""

import functools
import math
from typing import NamedTuple

import numpy as np
from scipy import ndimage
from scipy.signal import fftconvolve
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from jexplore.arrays.poses import wrapped
from jexplore.driving.local.window import CELL_M, SIDE, Window
from jexplore.driving.settings import Robot

STEPS = np.array([(0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1)])  # row, col; first along x
HEADINGS = len(STEPS)  # counter-clockwise
MARGIN_M = CELL_M / 2  # kept from occupied cells: the robot is driven to centres of cells, half a cell off at most
BACK = 2.5  # cost of a way back, of that ahead: the scanner does not see there
TURN_M = 0.25  # cost of an eighth of a turn, metres of way: 0.5 s at 1.5 rad/s
CLEAR_M = 0.6  # ways nearer to an obstacle than this cost more, in proportion,
CLOSE_COST = 2.0  # at an obstacle a metre costs this many metres more
START_CELLS = 3.0  # the plan begins at a state no farther than this from the robot, cells
START_RAD = 0.45  # and turned by no more than this: half an eighth of a turn, and the error of a turn


class State(NamedTuple):
    """A state of a path."""

    heading: int  # in eighths of a turn
    cell: np.ndarray  # [2] int, row and col in the window


@functools.lru_cache
def outlines(length_m: float, width_m: float) -> list[np.ndarray]:
    """Return the cells that a robot covers, at headings of sixteenths of a turn from 0 to 7: square bool masks."""
    n = math.ceil(math.hypot(length_m, width_m) / 2 / CELL_M) + 1
    row, col = np.mgrid[-n : n + 1, -n : n + 1] * CELL_M
    masks = []
    for k in range(HEADINGS):
        cos, sin = math.cos(k * math.pi / HEADINGS), math.sin(k * math.pi / HEADINGS)
        ahead, left = np.abs(cos * col + sin * row), np.abs(cos * row - sin * col)
        masks.append((ahead <= length_m / 2 + MARGIN_M) & (left <= width_m / 2 + MARGIN_M))
    return masks


def distance_m(mask: np.ndarray) -> np.ndarray:
    """Return the distance of all cells to the nearest one of a mask, metres; inf without one."""
    if not mask.any():
        return np.full(mask.shape, np.inf)
    return np.asarray(ndimage.distance_transform_edt(~mask)) * CELL_M


class Lattice:
    """Least costs from the robot to all states of a window."""

    def __init__(self, window: Window, pose: np.ndarray, robot: Robot, *, through_unknown: bool = False) -> None:
        """Search from a pose `[3]`. Unknown cells are passed only if `through_unknown`."""
        self.window = window
        solid = (window.occupied if through_unknown else window.occupied | ~window.known).astype(np.float32)
        masks = outlines(float(robot.length_m), float(robot.width_m))
        free = [fftconvolve(solid, mask.astype(np.float32), "same") < 0.5 for mask in masks]
        stands = [free[2 * (h % 4)] for h in range(HEADINGS)]
        turns = [stands[h] & free[(2 * h + 1) % HEADINGS] & stands[(h + 1) % HEADINGS] for h in range(HEADINGS)]
        clear_m = distance_m(window.occupied)
        cost = 1 + CLOSE_COST * np.maximum(1 - clear_m / CLEAR_M, 0)
        begins = _begins(window, pose, stands)
        self._first = n = HEADINGS * SIDE * SIDE
        graph = csr_matrix(_edges(stands, turns, cost, begins), shape=(n + 1, n + 1))
        costs, self._before = dijkstra(graph, indices=n, return_predecessors=True)
        self._costs = costs[:-1].reshape(HEADINGS, SIDE, SIDE)
        self.cost = self._costs.min(0)
        """`[SIDE, SIDE]`, metres, whatever the heading; inf: not to be reached."""

    def path_to(self, cell: np.ndarray) -> list[State]:
        """Return the cheapest path to a cell, from a state close to the robot on. The cell's cost must be finite."""
        at = int(self._costs[:, *cell].argmin()) * SIDE * SIDE + int(cell[0]) * SIDE + int(cell[1])
        path = [at]
        while self._before[path[-1]] != self._first:
            path.append(int(self._before[path[-1]]))
        return [State(s // (SIDE * SIDE), np.array(divmod(s % (SIDE * SIDE), SIDE))) for s in path[::-1]]

    def nearest(self, xy: np.ndarray, within_m: float) -> tuple[np.ndarray, float] | None:
        """Return the cell nearest to a point that can be reached and its cost; None: none lies within the distance."""
        middle, n = self.window.cell(xy), math.ceil(within_m / CELL_M)
        low, high = np.maximum(middle - n, 0), np.minimum(middle + n + 1, SIDE)
        if np.any(low >= high):
            return None
        row, col = np.mgrid[low[0] : high[0], low[1] : high[1]]
        off = np.hypot(row - middle[0], col - middle[1]) * CELL_M
        off = np.where(np.isfinite(self.cost[row, col]) & (off <= within_m), off, np.inf)
        best = np.unravel_index(off.argmin(), off.shape)
        if off[best] == np.inf:
            return None
        cell = np.array([row[best], col[best]])
        return cell, float(self.cost[*cell])


def _begins(window, pose, stands):
    """Return states about the robot from which a plan may begin, as numbers, and what it costs to get there."""
    middle, n = window.cell(pose[:2]), int(START_CELLS)
    states, costs = [], []
    for h in range(HEADINGS):
        turn = abs(wrapped(h * math.pi / 4 - pose[2]))
        if turn < START_RAD:
            row, col = np.nonzero(stands[h][middle[0] - n : middle[0] + n + 1, middle[1] - n : middle[1] + n + 1])
            off = np.hypot(row - n, col - n)
            near = off <= START_CELLS
            states.append((h * SIDE + row[near] + middle[0] - n) * SIDE + col[near] + middle[1] - n)
            costs.append((off[near] * CELL_M + 1e-3) * (1 + CLOSE_COST) + TURN_M * turn / (math.pi / 4))
    return np.concatenate(states), np.concatenate(costs)


def _edges(stands, turns, cost, begins):
    """Return `(costs, (from, to))` of all motions."""
    number = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    states, to_begin = begins
    first, last, costs = [np.full(len(states), HEADINGS * SIDE * SIDE)], [states], [to_begin]
    for h, step in enumerate(STEPS):
        for side, weight in ((1, 1.0), (-1, BACK)):
            here, there = _pair(*(side * step))
            goes = stands[h][here] & stands[h][there]
            first.append(h * SIDE * SIDE + number[here][goes])
            last.append(h * SIDE * SIDE + number[there][goes])
            costs.append(weight * math.hypot(*step) * CELL_M * cost[there][goes])
        at, other = number[turns[h]], (h + 1) % HEADINGS
        pair = h * SIDE * SIDE + at, other * SIDE * SIDE + at
        first += pair
        last += pair[::-1]
        costs += [np.full(len(at), TURN_M)] * 2
    return np.concatenate(costs), (np.concatenate(first), np.concatenate(last))


def _pair(drow, dcol):
    """Return slices of the cells from which a step stays in the window, and of those that it leads to."""
    here = tuple(slice(max(0, -d), SIDE - max(0, d)) for d in (drow, dcol))
    return here, tuple(slice(max(0, d), SIDE - max(0, -d)) for d in (drow, dcol))
