"""Doors of segmentations, and the plain methods: by hand."""

import numpy as np
import pytest

from jexplore.rooms import baselines, doors


def labels(text):
    """A drawn label map: digits rooms, `#` and `.` none; row 0 is the bottom."""
    return np.array([[-1 if c in "#." else int(c) for c in line] for line in text.split()][::-1])


def test_rooms_touch_in_pieces():
    found = doors.touching(
        labels("""
            00011
            00011
            ##.##
            00011
            22211
            """)
    )
    cells = sorted(sorted(map(tuple, piece.tolist())) for piece in found)
    assert cells == sorted(
        sorted(piece)
        for piece in (
            [(3, 2), (3, 3), (4, 2), (4, 3)],  # 0 and 1, above
            [(1, 2), (1, 3)],  # 0 and 1, below the wall
            [(0, c) for c in range(3)] + [(1, c) for c in range(3)],  # 0 and 2
            [(0, 2), (0, 3)],  # 1 and 2
        )
    )


def test_doorways_go_to_the_nearest_room():
    label = labels("00.11")
    free = np.ones(label.shape, bool)
    assert doors.filled(label, free, 1.0)[0].tolist() in ([0, 0, 0, 1, 1], [0, 0, 1, 1, 1])
    assert doors.filled(label, free, 0.5)[0].tolist() == [0, 0, -1, 1, 1]
    assert doors.filled(label, label >= 0, 5.0)[0].tolist() == [0, 0, -1, 1, 1]


def test_rooms_do_not_reach_through_walls():
    """A closet that is too small to count, in a wall between two rooms: no door."""
    truth = labels("00##.##11")
    assert doors.filled(truth, np.array([[c in "01." for c in "00##.##11"]]), 5.0)[0].tolist() == truth[0].tolist()


def test_a_sliver_in_a_doorway_does_not_hide_the_door():
    free = np.ones((4, 20), bool)
    truth, found = np.zeros((2, 4, 20), int)
    truth[:, 10], truth[:, 11:] = -1, 1
    found[:, 9:12], found[:, 12:] = -1, 1
    assert [len(a) for a in doors.compared(truth, found, free, 0.1)[:3]] == [1, 0, 0]


def test_doors_found_missed_and_extra():
    free = np.ones((5, 40), bool)
    truth, found = np.zeros((2, 5, 40), int)
    truth[:, 10], truth[:, 11:] = -1, 1  # a doorway at column 10, one at 25
    truth[:, 25], truth[:, 26:] = -1, 2
    found[:, 12:], found[:, 33:] = 1, 2
    both = doors.compared(truth, found, free, 0.1)
    assert both.found.tolist() in ([[2, 9]], [[2, 10]], [[2, 11]])
    assert [len(a) for a in both[:3]] == [1, 1, 1]
    assert both.touching == 2
    assert abs(both.missed[0][1] - 25) <= 1
    assert both.extra[0].tolist() in ([2, 32], [2, 33])
    alone = doors.compared(None, found, free, 0.1)
    assert [len(a) for a in alone[:3]] == [0, 0, 2]
    one = doors.compared(np.zeros_like(truth), np.zeros_like(found), free, 0.1)
    assert [len(a) for a in one[:3]] == [0, 0, 0]
    assert one.touching == 0


@pytest.fixture
def halls():
    """Two halls of 6 x 6 m with a door of 1 m, in cells of 0.25 m."""
    inside = np.zeros((26, 51), bool)
    inside[1:25, 1:25] = inside[1:25, 26:50] = inside[11:15, 25] = True
    rows, cols = np.indices(inside.shape)
    walls = np.argwhere(~inside)
    clearance = np.sqrt(((rows[..., None] - walls[:, 0]) ** 2 + (cols[..., None] - walls[:, 1]) ** 2).min(-1)) - 0.5
    return inside, clearance


@pytest.mark.jit
@pytest.mark.parametrize("method", baselines.BASELINES)
def test_plain_methods_part_two_halls(halls, method):
    label = baselines.BASELINES[method](*halls, 0.25)
    assert (label[~halls[0]] == -1).all()
    assert [np.unique(label[1:25, cols]).tolist() for cols in (slice(1, 25), slice(26, 50))] in ([[0], [1]], [[1], [0]])


@pytest.mark.jit
def test_seeds_grow_along_paths():
    inside = np.ones((3, 9), bool)
    inside[:2, 4] = False
    seeds = np.zeros(inside.shape, int)
    seeds[0, 3], seeds[2, 8] = 1, 2
    grown = baselines.grown(seeds, inside)
    assert grown[0, 5] == 1  # as the crow flies the first seed is nearer
    assert grown[0, 0] == 0
    assert (grown[~inside] == -1).all()
    seeds[2, 8] = baselines.SEEDS + 1
    assert set(np.unique(baselines.grown(seeds, inside))) == {-1, 0}
