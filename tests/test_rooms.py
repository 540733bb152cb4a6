"""Doors of segmentations, and the plain methods: by hand, and by laws."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from ref import basins, maps, rooms

from jexplore.rooms import baselines, doors
from jexplore.rooms.baselines import _free_space, maoris
from jexplore.rooms.scores import label_components
from jexplore.rooms.watershed import SMALLEST_ROOM_M2


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
    assert doors.with_doorways(label, free, 1.0)[0].tolist() in ([0, 0, 0, 1, 1], [0, 0, 1, 1, 1])
    assert doors.with_doorways(label, free, 0.5)[0].tolist() == [0, 0, -1, 1, 1]
    assert doors.with_doorways(label, label >= 0, 5.0)[0].tolist() == [0, 0, -1, 1, 1]


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
    assert [len(a) for a in doors.compared(truth, np.zeros_like(found), free, 0.1)[:3]] == [0, 2, 0]


def clearance_of(inside):
    """Compute the distance from every cell to the edge of the nearest wall; far without one. The oracle."""
    return np.sqrt(basins.squared(~inside, 2**20)) - 0.5


@pytest.fixture
def halls():
    """Two halls of 6 x 6 m with a door of 1 m, in cells of 0.25 m."""
    inside = np.zeros((26, 51), bool)
    inside[1:25, 1:25] = inside[1:25, 26:50] = inside[11:15, 25] = True
    return inside, clearance_of(inside)


@pytest.mark.jit
@pytest.mark.parametrize("method", baselines.BASELINES)
def test_plain_methods_part_two_halls(halls, method):
    label = baselines.BASELINES[method](*halls, 0.25)
    assert (label[~halls[0]] == -1).all()
    left, right = (set(label[1:25, cols].ravel().tolist()) for cols in (slice(1, 25), slice(26, 50)))
    assert len(left) == len(right) == 1
    assert left.isdisjoint(right | {-1})
    assert -1 not in right


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


# ---------------------------------------------------------------- maoris

CELL_M = 0.5  # of the drawn maps: the smallest room is eight cells
MAPS = st.builds(
    lambda shape, density, seed: np.random.default_rng(seed).random(shape) >= density,
    hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=16),
    st.sampled_from((0.0, 0.02, 0.1, 0.3)),
    st.integers(0, 2**16),
)

PLANS = {
    "two rooms and a door": """
        ###################
        #aaaaaaaa#bbbbbbbb#
        #aaaaaaaa#bbbbbbbb#
        #aaaaaaaa#bbbbbbbb#
        #aaaaaaaa+bbbbbbbb#
        #aaaaaaaa#bbbbbbbb#
        #aaaaaaaa#bbbbbbbb#
        #aaaaaaaa#bbbbbbbb#
        ###################
        """,
    "a corridor with doors on its side": """
        ########################
        #aaaaaaa#bbbbbb#ccccccc#
        #aaaaaaa#bbbbbb#ccccccc#
        #aaaaaaa#bbbbbb#ccccccc#
        #aaaaaaa#bbbbbb#ccccccc#
        #aaaaaaa#bbbbbb#ccccccc#
        #aaaaaaa#bbbbbb#ccccccc#
        ###+########+######+####
        #dddddddddddddddddddddd#
        #dddddddddddddddddddddd#
        #dddddddddddddddddddddd#
        ########################
        """,
    "of like width, no door between": """
        ###############
        #aaaaaaaaaaaaa#
        #aaaaaaaaaaaaa#
        #aaaaaaaaaaaaa#
        #aaaaa#########
        #aaaaa#########
        ###############
        """,
    "of like width, a door between": """
        ##################
        #aaaaaaa##########
        #aaaaaaa##########
        #aaaaaaa#bbbbbbbb#
        #aaaaaaa+bbbbbbbb#
        #aaaaaaa+bbbbbbbb#
        #aaaaaaa+bbbbbbbb#
        #aaaaaaa#bbbbbbbb#
        ##################
        """,
    "of like width, those with most border in common first": """
        #########################
        #aaaaaaa#################
        #aaaaaaa#################
        #aaaaaaaaaaaaaaa#########
        #aaaaaaaaaaaaaaa#########
        #aaaaaaaaaaaaaaa+bbbbbbb#
        #aaaaaaaaaaaaaaa+bbbbbbb#
        #aaaaaaaaaaaaaaa+bbbbbbb#
        #########################
        """,
    "a closet that is just large enough": """
        #################
        #aaaaaaa#########
        #aaaaaaa#########
        #aaaaaaa#########
        #aaaaaaabbbbbbbb#
        #aaaaaaa#########
        #aaaaaaa#########
        #aaaaaaa#########
        #################
        """,
    "a closet is too small": """
        ##############
        #aaaaaaaaa#aa#
        #aaaaaaaaa#aa#
        #aaaaaaaaaaaa#
        #aaaaaaaaa####
        #aaaaaaaaa####
        #aaaaaaaaa####
        #aaaaaaaaa####
        ##############
        """,
}


@pytest.mark.parametrize("name", PLANS)
def test_maoris_by_hand(name):
    """Free space, drawn as letters, falls into the rooms that they say; a doorway, `+`, is of either side."""
    cells = maps.drawn(PLANS[name])
    expected = np.where(cells == "#", -1, cells.view(np.int32).reshape(cells.shape))
    for turned, undo in basins.turned(cells != "#"):
        label = undo(maoris(turned, clearance_of(turned), CELL_M))
        assert ((label >= 0) == (cells != "#")).all()
        assert rooms.same_partition(np.where(cells == "+", ord("+"), label), expected), label[::-1]


@settings(max_examples=15)
@given(inside=MAPS)
def test_cells_are_as_wide_as_discs_that_cover_them(inside):
    """Never wider than the widest disc over a cell, nor narrower than its own. A turned map has the same widths."""
    clearance = clearance_of(np.pad(inside, 1))[1:-1, 1:-1]
    image = _free_space(inside, clearance)
    widths = np.where(inside, 2 * np.floor(clearance) + 1, 0)
    widest, (rows, cols) = widths.copy(), np.indices(inside.shape)
    for row, col in np.argwhere(inside):
        disc = (rows - row) ** 2 + (cols - col) ** 2 <= (clearance[row, col] + 0.5) ** 2 - 0.5
        widest[disc] = np.maximum(widest[disc], widths[row, col])
    assert (image >= widths).all()
    assert (image <= widest).all()
    assert (image[widths == widths.max()] == widths.max()).all()
    for turned, undo in basins.turned(inside):
        around = clearance_of(np.pad(turned, 1))[1:-1, 1:-1]
        np.testing.assert_array_equal(undo(_free_space(turned, around)), image)


def test_maoris_of_hardly_anything():
    assert len(np.unique(maoris(np.ones((120, 90), bool), np.full((120, 90), 1023.5), CELL_M))) == 1
    assert maoris(np.zeros((5, 7), bool), np.full((5, 7), -0.5), CELL_M).tolist() == [[-1] * 7] * 5
    for shape in ((1, 1), (1, 9), (9, 1)):
        label = maoris(np.ones(shape, bool), np.full(shape, 1023.5), CELL_M)
        assert label.shape == shape
        assert len(np.unique(label)) == 1
        assert label.min() >= 0
    speck = np.zeros((3, 3), bool)
    speck[1, 1] = True
    assert ((maoris(speck, clearance_of(speck), CELL_M) >= 0) == speck).all()


@settings(max_examples=15)
@given(inside=MAPS, cell_m=st.sampled_from((0.25, 0.5, 2.0)))
def test_maoris_divides_all_free_space_into_whole_rooms(inside, cell_m):
    clearance = clearance_of(inside)
    label = maoris(inside, clearance, cell_m)
    assert label.dtype == np.int32
    assert ((label >= 0) == inside).all()
    assert all(label_components(label == room).max() == 0 for room in np.unique(label[inside]))
    areas = np.bincount(label[inside], minlength=1) * cell_m**2
    for one, other in ((label[1:], label[:-1]), (label[:, 1:], label[:, :-1])):
        beside = (one >= 0) & (other >= 0) & (one != other)
        assert (np.minimum(areas[one[beside]], areas[other[beside]]) >= SMALLEST_ROOM_M2).all()
    np.testing.assert_array_equal(label, maoris(inside.copy(), clearance.copy(), cell_m))
