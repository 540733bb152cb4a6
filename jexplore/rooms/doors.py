"""Contacts of rooms, and true doors found by a segmentation. Host code: numpy and scipy."""

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from jexplore.rooms.scores import label_components

CROSS = ndimage.generate_binary_structure(2, 1)  # a cell and its four neighbours
DOOR_NEAR_M = 0.5  # a door is found if two rooms touch so close to its middle


class Doors(NamedTuple):
    """Middles of doors, each `[n, 2]` int, row and column."""

    found: np.ndarray  # true doors at which two rooms touch
    missed: np.ndarray  # true doors at which none do
    extra: np.ndarray  # places where two rooms touch, far from any true door; all of them without the truth
    touching: int  # places where two rooms touch


def with_doorways(label: np.ndarray, free: np.ndarray, gap: float) -> np.ndarray:
    """Assign free cells without a label, such as doorways, to the nearest room along free cells.

    Negative labels are none; a room may be `gap` steps to the four neighbours away.
    """
    label, left = label.copy(), free & (label < 0)
    for _ in range(int(gap)):
        around = ndimage.grey_dilation(label, footprint=CROSS, mode="constant", cval=-1)
        reached = left & (around >= 0)
        if not reached.any():
            break
        label[reached] = around[reached]
        left &= ~reached
    return label


def touching(label: np.ndarray) -> list[np.ndarray]:
    """Return the cells at which two rooms touch along an edge, a list of `[n, 2]` int for every piece of such a border.

    Negative labels are none.
    """
    cells, pairs = [], []
    here = np.indices(label.shape).transpose(1, 2, 0)
    for one, other in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        differ = (label[one] != label[other]) & (label[one] >= 0) & (label[other] >= 0)
        pair = np.sort(np.stack([label[one][differ], label[other][differ]], axis=1), axis=1)
        for side in (one, other):
            cells.append(here[side][differ])
            pairs.append(pair)
    cells, pairs = np.concatenate(cells), np.concatenate(pairs)
    pieces = []
    for pair in np.unique(pairs, axis=0):
        own = cells[(pairs == pair).all(axis=1)]
        low = own.min(axis=0)
        mask = np.zeros(own.max(axis=0) - low + 1, bool)
        mask[tuple((own - low).T)] = True
        parts = label_components(mask, corners=True)
        pieces += [np.argwhere(parts == k) + low for k in range(parts.max() + 1)]
    return pieces


def _middles(pieces):
    """Return the cell of every piece that is nearest to its mean: `[n, 2]` int."""
    if not pieces:
        return np.zeros((0, 2), int)
    return np.array([own[np.argmin(((own - own.mean(axis=0)) ** 2).sum(axis=1))] for own in pieces])


def middles_of(label: np.ndarray, free: np.ndarray, cell_m: float) -> np.ndarray:
    """Return the middles of the doors between rooms, `[n, 2]` int, row and column. Arguments as of `compared`."""
    return _middles(touching(with_doorways(label, free, DOOR_NEAR_M / cell_m)))


def compared(truth: np.ndarray | None, found: np.ndarray, free: np.ndarray, cell_m: float) -> Doors:
    """Compare the doors of a segmentation with the true ones.

    `truth` and `found` are `[H, W]` int, rooms, negative in doorways and walls; `truth` is None if unknown.
    """
    gap = DOOR_NEAR_M / cell_m
    own = touching(with_doorways(found, free, gap))
    true = [] if truth is None else touching(with_doorways(truth, free, gap))
    close = [_close(_middles(pieces), others, free.shape, gap) for pieces, others in ((true, own), (own, true))]
    middles = _middles(true), _middles(own)
    return Doors(middles[0][close[0]], middles[0][~close[0]], middles[1][~close[1]], len(own))


def _close(middles, pieces, shape, gap):
    """Return the middles within a distance of any piece: `[n]` bool."""
    if not pieces:
        return np.zeros(len(middles), bool)
    mask = np.ones(shape, bool)
    mask[tuple(np.concatenate(pieces).T)] = False
    return np.asarray(ndimage.distance_transform_edt(mask))[tuple(middles.T)] <= gap
