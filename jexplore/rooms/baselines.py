"""Other ways to find rooms, written from their papers. Host code: numpy and scipy, seconds for a map.

All take a map without clutter, `inside` and `clearance` as `watershed.cleared` tells them.
"""

import itertools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from jexplore.reach import nearest_source
from jexplore.rooms.scores import label_components
from jexplore.rooms.watershed import SMALLEST_ROOM_M2

SEEDS = 4096  # at most
DISTANCE_M2 = 0.35  # of a seed, at least
DISTANCE_STEP_M = 0.025  # from one level of clearance to the next
MORPHOLOGICAL_M2 = (0.8, 47.0)  # of a seed
RIPPLE_SHARE = 0.4  # share of the perimeter: a zone that shares more with a wider one is a ripple of that
LIKENESS = 0.5  # zones are alike if the width of one is at least this share of that of the other
_nearest = jax.jit(nearest_source, static_argnames="n")


def grown(seeds: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Assign every cell to the seed nearest along paths: `[H, W]` int32, -1 for unreachable cells.

    Seeds count from 1; 0 and those above `SEEDS` are none.
    """
    own = np.where(seeds <= SEEDS, seeds, 0).astype(np.int32) - 1
    return np.asarray(_nearest(jnp.asarray(inside), jnp.asarray(own), n=SEEDS))


def _parts(mask, cell_m):
    """Label components: `(parts, area_m2)`: `[H, W]` int32, from 1, 0 elsewhere; areas by number, 0 for 0."""
    parts = label_components(mask) + 1
    area_m2 = np.bincount(parts.ravel()) * cell_m**2
    area_m2[0] = 0
    return parts, area_m2


def distance_rooms(inside: np.ndarray, clearance: np.ndarray, cell_m: float) -> np.ndarray:
    """Divide by clearance: seeds are the cells above the level with most components; the rest goes to the nearest.

    `clearance` is in cells. Returns `[H, W]` int32, room; -1 outside, and where no seed gets to.

    Source:
      Bormann et al. 2016, "Room Segmentation: Survey, Implementation, and Analysis", distance transform, with the
        authors' least area of a seed. Of levels with equally many components the lowest, which has the largest seeds.
    """
    most, best = 0, np.zeros(inside.shape, np.int32)
    for level in np.arange(0.0, clearance[inside].max(initial=0.0), DISTANCE_STEP_M / cell_m):
        parts, area_m2 = _parts(inside & (clearance > level), cell_m)
        large = area_m2 >= DISTANCE_M2
        if large.sum() > most:
            most, best = large.sum(), np.where(large, np.cumsum(large), 0)[parts]
    return grown(best, inside)


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


class _Zones(NamedTuple):
    """Zones of free and of other space, and the borders of the free ones, listed from both sides."""

    joined: np.ndarray  # [n] int, of every zone that there was at first
    width: np.ndarray  # [n] int, cells, of the widest zone in it; 0 where there is no free space
    area: np.ndarray  # [n] float, cells, of the widest zone in it
    one: np.ndarray  # [E] int
    other: np.ndarray  # [E] int
    length: np.ndarray  # [E] float, edges of cells


def _free_space(inside, clearance):
    """Compute the free-space image: `[H, W]` int32, cells: width of the widest disc over a cell; 0 outside."""
    rim = np.minimum.outer(*(np.minimum(np.arange(n), np.arange(n)[::-1]) + 0.5 for n in inside.shape))
    radius = np.where(inside, np.minimum(clearance, rim), 0.0)
    around = np.pad(radius, 3)
    is_middle = inside.copy()  # of a disc that no other disc covers, give or take a quarter of a cell
    for row, col in itertools.product(range(-3, 4), repeat=2):
        if max(abs(row), abs(col)) in (1, 3):
            there = around[3 + row :, 3 + col :][: inside.shape[0], : inside.shape[1]]
            is_middle &= there < radius + (np.hypot(row, col) - 0.25)
    image = 2 * radius.astype(np.int32) + 1
    rows, cols = np.nonzero(is_middle)
    discs = sorted(zip(radius[rows, cols].tolist(), rows.tolist(), cols.tolist()))
    for own, group in itertools.groupby(discs, lambda disc: disc[0]):
        reach = int(np.ceil(own - 0.5))
        square = np.arange(-reach, reach + 1) ** 2
        disc = square[:, None] + square <= (own + 0.5) ** 2 - 0.5
        for _, row, col in group:
            image[row - reach : row + reach + 1, col - reach : col + reach + 1][disc] = 2 * int(own) + 1
    return np.where(inside, image, 0)


def _zones(image):
    """Return `(label, zones)`: `[H, W]` int, 4-connected cells of one width; `_Zones`."""
    cell = np.arange(image.size).reshape(image.shape)
    one = np.concatenate([cell[:, :-1].ravel(), cell[:-1].ravel()])
    other = np.concatenate([cell[:, 1:].ravel(), cell[1:].ravel()])
    same = image.flat[one] == image.flat[other]
    links = sparse.coo_array((same[same], (one[same], other[same])), shape=(image.size, image.size))
    n, part = connected_components(links, directed=False)
    width = np.zeros(n, int)
    width[part] = image.ravel()
    one, other = part[one[~same]], part[other[~same]]
    one, other = np.concatenate([one, other]), np.concatenate([other, one])
    inside = width[one] > 0
    zones = _Zones(np.arange(n), width, np.bincount(part, image.flat > 0), one[inside], other[inside], inside[inside])
    return part.reshape(image.shape), _joined(zones, zones.joined)


def _joined(zones, to):
    """Join every zone to another one, `[n]` int, or leave it; there are no cycles."""
    while (to[to] != to).any():
        to = to[to]
    width = np.zeros_like(zones.width)
    np.maximum.at(width, to, zones.width)
    one, other = to[zones.one], to[zones.other]
    apart = one != other
    pairs, index = np.unique(one[apart] * len(to) + other[apart], return_inverse=True)
    borders = pairs // len(to), pairs % len(to), np.bincount(index, zones.length[apart])
    return _Zones(to[zones.joined], width, np.bincount(to, zones.area, len(to)), *borders)


def _longest(zones, may):
    """Return for every zone the one beyond its longest border, of those that count; itself without any: `[n]` int."""
    one, other, to = zones.one[may], zones.other[may], np.arange(len(zones.width))
    order = np.lexsort((np.maximum(one, other), np.minimum(one, other), zones.length[may]))
    to[one[order]] = other[order]
    return to


def _ripples(zones):
    """Join ripples to the wider zone around them. Arrays as of `_longest`, here and below."""
    is_wider = zones.width[zones.other] > zones.width[zones.one]
    perimeter = np.bincount(zones.one, zones.length, len(zones.width))
    return _longest(zones, is_wider & (zones.length > RIPPLE_SHARE * perimeter[zones.one]))


def _alike(zones):
    """Join zones of similar width, without a door between them, that share most of their borders."""
    widths = zones.width[zones.one], zones.width[zones.other]
    narrower, wider, own = np.minimum(*widths), np.maximum(*widths), np.arange(len(zones.width))
    to = _longest(zones, (narrower >= LIKENESS * wider) & (zones.length >= narrower))
    return np.where((to[to] == own) & (to < own), to, own)  # only if the border is the longest of both


def _small(zones, smallest):
    """Join rooms of fewer cells than `smallest` to a larger one."""
    one, other = zones.area[zones.one], zones.area[zones.other]
    is_larger = (other > one) | ((other == one) & (zones.other < zones.one))
    return _longest(zones, is_larger & (one < smallest))


def maoris(inside: np.ndarray, clearance: np.ndarray, cell_m: float) -> np.ndarray:
    """Divide free space into zones of one width; ripples join wider zones, then similar zones join, not through doors.

    A cell is as wide as the widest disc in free space that covers it: a room is wide up to its walls, a corridor narrow
    up to the room. No disc reaches beyond the map. Of borders of equal length the one that comes last in the map is
    taken, so that turning a map may move doors, seldom add or lose one. Arguments and result as of `distance_rooms`;
    rooms are 4-connected, their numbers not consecutive.

    Source:
      Mielle et al. 2018, "A method to segment maps from different modalities using free space layout": the image of
        widths, its zones, ripples by the share of their perimeter, joining of like zones. Changed: ripples join wider
        zones only. Like zones join only where their border is as long as the narrower one is wide: a shorter one is a
        door, as discs bulge through doors in thin walls. Of like zones those join first that have most border in
        common. Both steps are done twice. At last small rooms join the one beyond their longest border.
    """
    label, zones = _zones(_free_space(inside, clearance))
    for step in (_ripples, _alike, _ripples, _alike, lambda zones: _small(zones, SMALLEST_ROOM_M2 / cell_m**2)):
        while ((to := step(zones)) != np.arange(len(to))).any():
            zones = _joined(zones, to)
    return np.where(inside, zones.joined[label], -1).astype(np.int32)


BASELINES: dict[str, Callable[[np.ndarray, np.ndarray, float], np.ndarray]] = {
    "distance": distance_rooms,
    "morphological": morphological_rooms,
    "maoris": maoris,
}
