"""Cells where a robot may stand, and shortest paths there."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jexplore import reach
from jexplore.arrays import bits
from jexplore.reach import DIAGONAL, FAR, MOTIONS, STRAIGHT
from jexplore.studies.bounds.scene import Scene


@jax.jit
def _flood(words, start):
    return reach.spread(words, start, (0, 0), None, jnp.int32(FAR), reach.STEPS)


class Floor:
    """Cells where a robot may stand, with shortest paths between them."""

    cells: np.ndarray
    """`[n]` int, their numbers in the scene, sorted."""

    def __init__(self, scene: Scene, stand: np.ndarray, budget: Any) -> None:
        self.scene, self.cells, self.budget = scene, np.flatnonzero(stand), budget
        height = -(-scene.shape[0] // bits.WORD) * bits.WORD
        self._shape = height, -(-scene.shape[1] // bits.WORD) * bits.WORD
        rows, cols = scene.cells(self.cells)
        self._at = rows * self._shape[1] + cols
        mask = np.zeros(self._shape, bool)
        mask.reshape(-1)[self._at] = True
        self._words = jax.jit(bits.pack)(mask)
        self._number = np.full(len(scene.occupied), -1, np.int32)
        self._number[self.cells] = np.arange(len(self.cells))

    def numbers(self, flat: np.ndarray) -> np.ndarray:
        """Return places in `cells` of those of some cells that are among them: `[k]` int."""
        found = self._number[flat]
        return found[found >= 0]

    def flood(self, costs: np.ndarray) -> np.ndarray:
        """Compute costs of the shortest paths from cells with given costs, FAR where not given: both `[n]` int32."""
        self.budget.spent += 1
        start = np.full(self._shape, FAR, np.int32)
        start.reshape(-1)[self._at] = costs
        return np.asarray(_flood(self._words, start)).reshape(-1)[self._at]

    def away_from(self, places: np.ndarray) -> np.ndarray:
        """Return costs of the shortest paths from some places: `[n]` int32."""
        costs = np.full(len(self.cells), FAR, np.int32)
        costs[places] = 0
        return self.flood(costs)

    def farthest_first(self, cells: np.ndarray, walk: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Sort cells by their distance from a walk, the farthest first, and return every place's: `[k]`, `[n]` int."""
        away, far = self.away_from(self.numbers(walk)), np.full(len(self.scene.occupied), -1, np.int32)
        far[self.cells] = away
        return cells[np.argsort(-far[cells], kind="stable")], away

    @functools.cached_property
    def before(self) -> list[np.ndarray]:
        """Return for each of `MOTIONS` the place from which it leads to each place: `[n]` int; -1 without one."""
        width, found = self.scene.width, []
        for drow, dcol in MOTIONS:
            place = self._number[self.cells - drow * width - dcol]
            if drow and dcol:
                beside = self._number[self.cells - drow * width], self._number[self.cells - dcol]
                place = np.where((beside[0] >= 0) & (beside[1] >= 0), place, -1)
            found.append(place)
        return found

    def back(self, costs: np.ndarray, place: int, stop: Any) -> list[int]:
        """Return the way that led to a place: places from it back to the first where `stop` is true, both included."""
        way = [place]
        while not stop(place):
            for (drow, dcol), before in zip(MOTIONS, self.before):
                step = DIAGONAL if drow and dcol else STRAIGHT
                if before[place] >= 0 and costs[before[place]] + step == costs[place]:
                    place = int(before[place])
                    break
            else:
                raise AssertionError("a cost without a way")
            way.append(place)
        return way


def walk_cost(walk: np.ndarray, width: int) -> int:
    """Return cost of a walk of cells, one motion from each to the next."""
    steps = np.abs(np.diff(walk))
    assert all(step in (0, 1, width, width - 1, width + 1) for step in steps)
    return int(np.sum(np.where(steps == 0, 0, np.where((steps == 1) | (steps == width), STRAIGHT, DIAGONAL))))


def edge_of(floor: Floor, places: np.ndarray) -> np.ndarray:
    """Return the places through which a robot can enter a region: those with a motion from outside."""
    inside = np.zeros(len(floor.cells) + 1, bool)  # the last is no place, and counts as inside
    inside[places], inside[-1] = True, True
    entered = np.zeros(len(places), bool)
    for before in floor.before:
        entered |= ~inside[before[places]]
    return places[entered]
