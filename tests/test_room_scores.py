"""Scores of room segmentations: by hand, against literal loops, and on bad input."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from jexplore.config import InputError
from jexplore.rooms.scores import AGREEMENT, rooms_of, score, scored_regions

SHAPES = hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=6)
LABELS = st.integers(-1, 3)


@st.composite
def pairs(draw):
    """Ground truth and segmentation of one map, up to four regions each, in any number of parts."""
    shape = draw(SHAPES)
    return draw(hnp.arrays(np.int64, shape, elements=LABELS)), draw(hnp.arrays(np.int64, shape, elements=LABELS))


def image(text):
    """Labels from rows of digits; a point is -1."""
    return np.array([[-1 if mark == "." else int(mark) for mark in row] for row in text.split()])


def test_rooms_by_hand():
    free = image("1.11 1.1. .1.1 11.1") == 1  # touching at a corner does not connect
    np.testing.assert_array_equal(rooms_of(free, min_px=0), image("0.11 0.1. .2.3 22.3"))
    np.testing.assert_array_equal(rooms_of(free, min_px=2), image("..00 ..0. .1.. 11.."))  # 2 pixels are dropped
    assert rooms_of(free).dtype == np.int32


@pytest.mark.parametrize(("truth", "predicted", "value"), [("..", "..", 1.0), ("00", "..", 0.0), ("..", "01", 0.0)])
def test_no_rooms(truth, predicted, value):
    found = score(image(truth), image(predicted))
    assert [found[name] for name in AGREEMENT] == [value] * len(AGREEMENT)
    assert found["variation_of_information"] == 0.0
    assert found["room_count_error"] == found["rooms"] - found["rooms_truth"]


def correlation(tp, fp, fn, tn):
    below = math.sqrt((tp + fp) * (tp + fn) * (tn + fp) * (tn + fn))
    if below == 0:
        return 1.0 if fp == fn == 0 else 0.0
    return (tp * tn - fp * fn) / below


def literal(truth, predicted):
    """Every score from sets of pixels, each matching tried."""
    pixels = [
        [
            {(r, c) for r, c in np.ndindex(labels.shape) if labels[r, c] == value}
            for value in sorted(set(labels.flat) - {-1})
        ]
        for labels in (predicted, truth)
    ]
    regions, rooms = pixels
    n_both = sum(len(s & g) for s in regions for g in rooms)
    matchings = []
    few, many = sorted((regions, rooms), key=len)
    for chosen in itertools.permutations(many, len(few)):
        total, value = 0, 0.0
        for s, g in zip(few, chosen):
            tp, fp, fn = len(s & g), len(s - g), len(g - s)
            if tp:
                total, value = total + tp, value + correlation(tp, fp, fn, max(n_both - tp - fp - fn, 0))
        matchings.append((total, value))
    inside = [max(len(s & g) for g in rooms) for s in regions]
    covered = [max(len(s & g) for s in regions) for g in rooms]
    vi = 0.0
    for s in regions:
        for g in rooms:
            p = len(s & g) / max(n_both, 1)
            p_s, p_g = (
                sum(len(one & other) for other in of) / max(n_both, 1) for one, of in ((s, rooms), (g, regions))
            )
            if p > 0:
                vi -= p * (math.log2(p / p_s) + math.log2(p / p_g))
    return {
        "mcc": max(matchings)[1] / max(len(regions), len(rooms)),
        "precision_room": np.mean([i / len(s) for i, s in zip(inside, regions)]),
        "recall_room": np.mean([i / len(g) for i, g in zip(covered, rooms)]),
        "precision_pixel": sum(inside) / sum(map(len, regions)),
        "recall_pixel": sum(covered) / sum(map(len, rooms)),
        "iou_predicted": np.mean([max(len(s & g) / len(s | g) for g in rooms) for s in regions]),
        "iou_truth": np.mean([max(len(s & g) / len(s | g) for s in regions) for g in rooms]),
        "rooms": len(regions),
        "rooms_truth": len(rooms),
        "room_count_error": len(regions) - len(rooms),
        "variation_of_information": vi,
    }


@given(pairs())
def test_score_is_the_literal_one(pair):
    truth, predicted = pair
    if (truth >= 0).any() and (predicted >= 0).any():
        assert score(truth, predicted) == pytest.approx(literal(truth, predicted), abs=1e-8)


@settings(max_examples=30)
@given(hnp.arrays(np.int64, SHAPES, elements=LABELS), st.data())
def test_regions_are_the_literal_ones(labels, data):
    free = data.draw(hnp.arrays(bool, labels.shape))
    min_px = data.draw(st.integers(0, 3))
    regions, left = {}, {(r, c) for r, c in np.ndindex(free.shape) if free[r, c]}
    while left:
        seed = min(left)
        if labels[seed] >= 0:
            part = {at for at in left if labels[at] == labels[seed]}
        else:
            part, edge = {seed}, [seed]
            while edge:
                r, c = edge.pop()
                near = {(r + 1, c), (r - 1, c), (r, c + 1), (r, c - 1)} & left - part
                near = {at for at in near if labels[at] < 0}
                part, edge = part | near, edge + sorted(near)
        left -= part
        if len(part) > min_px:
            regions |= dict.fromkeys(part, len(set(regions.values())))
    want = np.full(labels.shape, -1)
    for at, number in regions.items():
        want[at] = number
    np.testing.assert_array_equal(scored_regions(labels, free, min_px=min_px), want)
    np.testing.assert_array_equal(
        rooms_of(free, min_px=min_px), scored_regions(np.full(labels.shape, -1), free, min_px=min_px)
    )


def test_wrong_sizes_are_refused():
    with pytest.raises(InputError, match=r"the segmentation must be as large .* 4 x 3 pixels, got 3 x 4$"):
        score(np.zeros((3, 4), int), np.zeros((4, 3), int))
    with pytest.raises(InputError, match=r"the labels must be as large as the free mask, 2 x 1 pixels, got 2$"):
        scored_regions(np.zeros(2, int), np.zeros((1, 2), bool))
