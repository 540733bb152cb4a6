"""Agreement of a segmentation into rooms with the ground truth. Host code: numpy and scipy."""

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from jexplore.config import InputError

AGREEMENT = ("mcc", "precision_room", "recall_room", "precision_pixel", "recall_pixel", "iou_predicted", "iou_truth")
"""The scores that are 1 where segmentation and ground truth are the same."""


def _numbered(labels, *, min_px=0):
    """Renumber regions of more than `min_px` pixels as 0..n-1, in the order of their first pixels; -1 elsewhere."""
    values, first, index, size = np.unique(labels, return_index=True, return_inverse=True, return_counts=True)
    keep = (values >= 0) & (size > min_px)
    number = np.full(len(values), -1, dtype=np.int32)
    number[keep] = np.argsort(np.argsort(first[keep]))
    return number[index].reshape(labels.shape)


def label_components(mask: np.ndarray, *, corners: bool = False) -> np.ndarray:
    """Label components of a mask, 4-connected, or 8-connected by `corners`: `[H, W]` int32, -1 elsewhere.

    They count from 0 in the order of their lowest flat indices. A robot's diagonal step needs both orthogonal
    neighbours: what it reaches in 8 directions is a 4-connected component.
    """
    parts = np.zeros(mask.shape, dtype=np.int32)
    ndimage.label(mask, np.ones((3, 3)) if corners else None, output=parts)
    return parts - 1


def _same_size(name, array, name_of_other, other):
    if array.ndim != 2 or array.shape != other.shape:
        sizes = [" x ".join(str(side) for side in shape[::-1]) for shape in (other.shape, array.shape)]
        raise InputError(f"{name} must be as large as {name_of_other}, {sizes[0]} pixels, got {sizes[1]}")


def rooms_of(free: ArrayLike, *, min_px: int = 100) -> np.ndarray:
    """Label the rooms of a map in which walls and lines across doorways separate them.

    A room is a 4-connected component of more than `min_px` free pixels, by default 0.25 m2 at 0.05 m a pixel. `[H, W]`
    int32: rooms 0..n-1, in the order of their first pixels by row and column; -1 elsewhere.
    """
    return _numbered(label_components(np.asarray(free, dtype=bool)), min_px=min_px)


def scored_regions(labels: ArrayLike, free: ArrayLike, *, min_px: int = 100) -> np.ndarray:
    """Label the regions of a predicted segmentation for scoring: `[H, W]` int32 as from `rooms_of`.

    All free pixels of a label (a number from 0) form a region, even if it has several parts. Free pixels without a
    label are not excused: each of their 4-connected components is a region. Labels on pixels that are not free do not
    count. Regions of `min_px` pixels or fewer are dropped.
    """
    labels, free = np.asarray(labels), np.asarray(free, dtype=bool)
    _same_size("the labels", labels, "the free mask", free)
    labels = _numbered(np.where(free, labels, -1))
    bare = label_components(free & (labels < 0))
    return _numbered(np.where(bare >= 0, labels.max(initial=-1) + 1 + bare, labels), min_px=min_px)


def _matthews(overlap, size, size_truth):
    """Compute `[S, G]` Matthews correlations of pairs of regions, as classes of the pixels with both labels."""
    tp = overlap.astype(np.float64)
    fp, fn = size[:, None] - tp, size_truth[None, :] - tp
    tn = np.maximum(overlap.sum() - tp - fp - fn, 0.0)
    below = np.sqrt((tp + fp) * (tp + fn)) * np.sqrt((tn + fp) * (tn + fn))
    alike = (fp == 0) & (fn == 0)
    return np.divide(tp * tn - fp * fn, below, out=alike.astype(np.float64), where=below > 0)


def _matched(overlap, mcc):
    """Return the sum of `mcc` over the one-to-one matching of largest overlap, pairs without overlap left out.

    Overlaps are whole numbers and every |mcc| is at most 1, so a weight that sums to less than 1/2 decides between
    matchings of equal overlap, and nothing else.
    """
    from scipy.optimize import linear_sum_assignment  # loads slowly, and worlds need labels alone

    mcc = np.where(overlap > 0, mcc, 0.0)
    pairs = linear_sum_assignment(overlap + mcc / (4.0 * max(min(overlap.shape), 1) + 1.0), maximize=True)
    return mcc[pairs].sum()


def _variation_of_information(overlap):
    """Compute H(S | G) + H(G | S) in bits of the joint counts."""
    s, g = np.nonzero(overlap)
    both = overlap[s, g]
    bits = np.log2(overlap.sum(axis=1)[s] / both) + np.log2(overlap.sum(axis=0)[g] / both)
    return (both * bits).sum() / max(both.sum(), 1)


def _agreement(overlap, size, size_truth):
    """Compute the scores of regions and rooms, not empty: dict."""
    iou = overlap / (size[:, None] + size_truth[None, :] - overlap)
    best, best_truth = overlap.max(axis=1), overlap.max(axis=0)
    return {
        "mcc": _matched(overlap, _matthews(overlap, size, size_truth)) / max(overlap.shape),
        "precision_room": (best / size).mean(),
        "recall_room": (best_truth / size_truth).mean(),
        "precision_pixel": best.sum() / size.sum(),
        "recall_pixel": best_truth.sum() / size_truth.sum(),
        "iou_predicted": iou.max(axis=1).mean(),
        "iou_truth": iou.max(axis=0).mean(),
    }


def score(truth: ArrayLike, predicted: ArrayLike) -> dict[str, float]:
    """Score a predicted segmentation against the ground truth of the same map.

    Sizes of regions count all their pixels, also those without a label on the other side. One-sided scores are easily
    reached: pieces of rooms have precision 1, one region over everything recall 1. `mcc` rewards neither.

    Regions are matched with rooms one to one, for the largest total overlap, then for the largest sum of correlations;
    a pair without overlap is not a match. A matched pair is the confusion matrix of "in the region" against "in the
    room": tp = overlap, fp and fn = the rest of the region and of the room, tn = the rest of the pixels that have both
    labels, and 0 if that is negative, as it may be where much has one label only. Where the Matthews correlation is
    0 / 0 it is 1 if region and room are identical, else 0.

    If one side has no regions, all agreement is 0; if neither has, it is 1. Where no pixel has both labels the
    variation of information is 0. Nothing is NaN.

    Both are `[H, W]` int, negative for none, as from `rooms_of` and `scored_regions`.

    Returns:
      A dictionary of floats and whole numbers:
        `mcc`: sum of the correlations of matched pairs by the larger of the two counts, -1..1.
        `precision_room`: mean over regions of the largest share that lies in one room.
        `recall_room`: mean over rooms of the largest share that one region covers.
        `precision_pixel`, `recall_pixel`: the same, weighted by size.
        `iou_predicted`, `iou_truth`: mean over regions, and over rooms, of the best intersection over union.
        `rooms`, `rooms_truth`, `room_count_error`: regions, rooms, and regions less rooms.
        `variation_of_information`: bits, over the pixels that have both labels.

    Raises:
      InputError: shapes that differ.

    Source:
      Bormann et al. 2016, precision and recall; Mielle et al. 2018 (MAORIS), Matthews correlation of regions.
    """
    truth, predicted = np.asarray(truth), np.asarray(predicted)
    _same_size("the segmentation", predicted, "its ground truth", truth)
    truth, predicted = _numbered(truth), _numbered(predicted)
    size, size_truth = (np.bincount(labels[labels >= 0]) for labels in (predicted, truth))
    n, n_truth = len(size), len(size_truth)
    both = (truth >= 0) & (predicted >= 0)
    pairs = predicted[both].astype(np.int64) * n_truth + truth[both]
    overlap = np.bincount(pairs, minlength=n * n_truth).reshape(n, n_truth)
    none = dict.fromkeys(AGREEMENT, float(n == n_truth))
    agreement = _agreement(overlap, size, size_truth) if n and n_truth else none
    return {
        **{name: float(value) for name, value in agreement.items()},
        "rooms": n,
        "rooms_truth": n_truth,
        "room_count_error": n - n_truth,
        "variation_of_information": float(_variation_of_information(overlap)),
    }
