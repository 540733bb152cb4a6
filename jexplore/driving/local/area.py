"""The area that the robot has seen, beyond the local map: its walls, and where the unknown begins."""

import math

import numpy as np
from scipy import ndimage

from jexplore.driving.local.lattice import Lattice, distance_m
from jexplore.driving.local.sight import EVERY_WAY, frontier
from jexplore.driving.local.window import SIDE, Window

GROWTH = 2 * SIDE  # cells by which the area grows at least
AROUND = SIDE // 2  # cells about the local map in which places are looked for: halls are wider than the map


class SeenArea:
    """Cells that were known in any local map, the frontiers of all of them, and walls."""

    def __init__(self) -> None:
        """Begin with none."""
        self._corner, self._cells = np.zeros(2, int), np.zeros((3, 0, 0), bool)

    def add(self, window: Window, width_m: float) -> None:
        """Add the known cells of a local map, and its frontiers for a robot of a width in place of those there."""
        known, left, walls = self._of(window)
        known |= window.known
        walls[window.known] = window.occupied[window.known]
        left[1:-1, 1:-1] = frontier(window, known, width_m)[1:-1, 1:-1]

    def around(self, window: Window) -> Window:
        """Return a local map that was added, and `AROUND` cells more on each side as they were seen last."""
        side = np.array(window.known.shape) + 2 * AROUND
        wide = window._replace(corner=window.corner - AROUND, known=np.broadcast_to(False, side))
        known, _, walls = self._of(wide).copy()
        known[[0, -1]] = known[:, [0, -1]] = False
        return Window(wide.corner, walls & known, known)

    def _of(self, window):
        """Return the cells of a map that were known in any, frontiers and walls: `[3, H, W]` bool, a view."""
        side = np.array(window.known.shape)
        if not self._cells.size:
            self._corner = window.corner.copy()
        before = np.maximum(self._corner - window.corner, 0)
        after = np.maximum(window.corner + side - self._corner - self._cells.shape[1:], 0)
        if before.any() or after.any():
            before, after = (np.where(n > 0, np.maximum(n, GROWTH), 0).astype(int) for n in (before, after))
            self._cells = np.pad(self._cells, [(0, 0), *zip(before, after, strict=True)])
            self._corner = self._corner - before
        row, col = window.corner - self._corner
        return self._cells[:, row : row + side[0], col : col + side[1]]

    def frontiers(self, window: Window) -> list[np.ndarray]:
        """Return the frontiers in a local map that was added: `[SIDE, SIDE]` bool each."""
        parts = np.empty(window.known.shape, np.int32)
        ndimage.label(self._of(window)[1], EVERY_WAY, output=parts)
        return [parts == i for i in range(1, parts.max() + 1)]

    def elsewhere(self, window: Window) -> np.ndarray:
        """Return the frontier cells out of a local map: `[n, 2]`, metres."""
        inside = self._of(window)[1]
        kept = inside.copy()
        inside[...] = False
        found = np.argwhere(self._cells[1]) + self._corner - window.corner
        inside[...] = kept
        return window.xy(found)

    def give_up(self, window: Window, xy: np.ndarray) -> None:
        """Count frontier cells `[n, 2]`, metres, as none: the robot has been there, or something stops it."""
        row, col = (window.cell(xy) + window.corner - self._corner).T
        self._cells[1, row, col] = False
        near = np.zeros_like(self._cells[0])
        near[row, col] = True
        self._cells[0] |= ndimage.binary_dilation(near, EVERY_WAY)


def nearest_to(frontier: np.ndarray, lattice: Lattice, within_m: float) -> tuple[np.ndarray, float] | None:
    """Return the cell that costs least no farther from a frontier than this, and its cost; None: none is reached."""
    cost = np.where(distance_m(frontier) <= within_m, lattice.cost, math.inf)
    cell = np.array(np.unravel_index(cost.argmin(), cost.shape))
    return (cell, float(cost[tuple(cell)])) if np.isfinite(cost[tuple(cell)]) else None
