"""The area that the robot has seen, beyond the local map: where free space leads on."""

import math

import numpy as np
from scipy import ndimage

from jexplore.driving.local.lattice import Lattice, distance_m
from jexplore.driving.local.window import Window

GROWTH = 256  # cells by which the area grows at least: two local maps
EVERY_WAY = np.ones((3, 3), bool)  # a cell's neighbours


class SeenArea:
    """Cells that were known in any local map."""

    def __init__(self) -> None:
        """Begin with none."""
        self._corner, self._known = np.zeros(2, int), np.zeros((0, 0), bool)

    def add(self, window: Window) -> None:
        """Add the known cells of a local map."""
        self.of(window)[...] |= window.known

    def of(self, window: Window) -> np.ndarray:
        """Return the cells of a local map that were known in any: `[SIDE, SIDE]` bool, a view."""
        side = np.array(window.known.shape)
        if not self._known.size:
            self._corner = window.corner.copy()
        before = np.maximum(self._corner - window.corner, 0)
        after = np.maximum(window.corner + side - self._corner - self._known.shape, 0)
        if before.any() or after.any():
            before, after = (np.where(n > 0, np.maximum(n, GROWTH), 0).astype(int) for n in (before, after))
            self._known = np.pad(self._known, np.stack([before, after], axis=1).tolist())
            self._corner = self._corner - before
        row, col = window.corner - self._corner
        return self._known[row : row + side[0], col : col + side[1]]

    def frontiers(self, lattice: Lattice, open_m: float) -> list[np.ndarray]:
        """Return the frontiers in free space, where a circle of radius `open_m` fits: `[SIDE, SIDE]` bool each.

        Across every frontier between walls the graph of a local map has a way; in free space it has none.
        """
        window, known = lattice.window, self.of(lattice.window)
        edge = window.known & ndimage.binary_dilation(~known, EVERY_WAY) & (distance_m(window.occupied) > open_m)
        parts = np.empty(edge.shape, np.int32)
        ndimage.label(edge, EVERY_WAY, output=parts)
        return [parts == i for i in range(1, parts.max() + 1)]

    def give_up(self, window: Window, frontier: np.ndarray) -> None:
        """Count what lies next to a frontier as known: the robot has been there, or something stops it."""
        known = self.of(window)
        known |= ndimage.binary_dilation(frontier, EVERY_WAY)


def nearest_to(frontier: np.ndarray, lattice: Lattice, within_m: float) -> tuple[np.ndarray, float] | None:
    """Return the cell that costs least no farther from a frontier than this, and its cost; None: none is reached."""
    cost = np.where(distance_m(frontier) <= within_m, lattice.cost, math.inf)
    cell = np.array(np.unravel_index(cost.argmin(), cost.shape))
    return (cell, float(cost[tuple(cell)])) if np.isfinite(cost[tuple(cell)]) else None
