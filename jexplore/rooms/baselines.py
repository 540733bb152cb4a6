"""Other ways to find rooms, written from their papers. Host code: numpy and scipy, seconds for a map.

All take a map without clutter, `inside` and `clearance` as `watershed.cleared` tells them.
"""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from jexplore.arrays import bits
from jexplore.reach import nearest_source
from jexplore.rooms.maoris import maoris
from jexplore.rooms.scores import components

SEEDS = 4096  # at most
DISTANCE_M2 = 0.35  # of a seed, at least
DISTANCE_STEP_M = 0.025  # from one level of clearance to the next
MORPHOLOGICAL_M2 = (0.8, 47.0)  # of a seed


@functools.partial(jax.jit, static_argnames=("n",))
def _nearest(inside, seeds, *, n):
    height = inside.shape[0]
    padded = jnp.pad(seeds, ((0, -height % bits.WORD), (0, 0)), constant_values=-1)
    return nearest_source(bits.pack(inside), padded, n)[:height]


def grown(seeds: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Assign every cell to the seed nearest along paths: `[H, W]` int32, -1 for unreachable cells.

    Seeds count from 1; 0 and those above `SEEDS` are none.
    """
    own = np.where(seeds <= SEEDS, seeds, 0).astype(np.int32) - 1
    return np.asarray(_nearest(jnp.asarray(inside), jnp.asarray(own), n=SEEDS))


def _parts(mask, cell_m):
    """Label components: `(parts, area_m2)`: `[H, W]` int32, from 1, 0 elsewhere; areas by number, 0 for 0."""
    parts = components(mask) + 1
    area_m2 = np.bincount(parts.ravel()) * cell_m**2
    area_m2[0] = 0
    return parts, area_m2


def distance_rooms(inside: np.ndarray, clearance: np.ndarray, cell_m: float) -> np.ndarray:
    """Divide by clearance: seeds are the cells above the level with most components; the rest goes to the nearest.

    Args:
      inside: `[H, W]` bool.
      clearance: `[H, W]` float, cells.
      cell_m: edge of a cell, metres.

    Returns:
      `[H, W]` int32, room; -1 outside, and where no seed gets to.

    Source:
      Bormann et al. 2016, "Room Segmentation: Survey, Implementation, and Analysis", distance transform, with the
        authors' least area of a seed. Of levels with equally many components the lowest, which has the largest seeds.
    """
    most, best = 0, np.zeros(inside.shape, np.int32)
    for level in np.arange(0.0, clearance[inside].max(initial=0.0), DISTANCE_STEP_M / cell_m):
        parts, area_m2 = _parts(inside & (clearance > level), cell_m)
        large = area_m2 >= DISTANCE_M2
        if large.sum() > most:
            most, best = large.sum(), np.where(large[parts], parts, 0)
    numbers = np.unique(best[best > 0])
    return grown(np.where(best > 0, np.searchsorted(numbers, best) + 1, 0), inside)


def morphological_rooms(inside: np.ndarray, clearance: np.ndarray, cell_m: float) -> np.ndarray:
    """Divide by erosion: a component is a seed once it is as small as rooms are; the rest goes to the nearest.

    Arguments and result as of `distance_rooms`.

    Source:
      Bormann et al. 2016, morphological, with the authors' areas of a seed. Changed: eroded by discs, so that a turned
        map has the same rooms.
    """
    seeds, n_seeds, level = np.zeros(inside.shape, np.int32), 0, 0.0
    left = inside.copy()
    while left.any():
        parts, area_m2 = _parts(left, cell_m)
        is_room = (area_m2 >= MORPHOLOGICAL_M2[0]) & (area_m2 <= MORPHOLOGICAL_M2[1])
        number = np.where(is_room, n_seeds + np.cumsum(is_room), 0)
        seeds += number[parts].astype(np.int32)
        n_seeds += int(is_room.sum())
        level += DISTANCE_STEP_M / cell_m
        too_small = area_m2 < MORPHOLOGICAL_M2[0]
        left &= ~(is_room | too_small)[parts] & (clearance > level)
    return grown(seeds, inside)


BASELINES: dict[str, Callable[[np.ndarray, np.ndarray, float], np.ndarray]] = {
    "distance": distance_rooms,
    "morphological": morphological_rooms,
    "maoris": maoris,
}
