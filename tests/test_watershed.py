"""Rooms by the watershed of the clearance: pencil cases, the oracle, laws, bad input."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref import basins, maps, rooms

from jexplore.rooms import watershed as kernel
from jexplore.rooms.watershed import RoomForm, room_criteria, watershed

pytestmark = pytest.mark.jit
CLUTTER = jax.jit(kernel.clutter, static_argnames="edges")
SHAPE = (24, 24)
FORM = RoomForm(basins=128, passes=256, edges=576)
CELL_M = 0.25


def drawn(text):
    """`(free, unknown, label)` of a drawn map, `[24, 24]`, rock around it: `#` walls, `?` unknown, letters rooms,
    `+` doorways, which may belong to either side: label -2.
    """
    cells = maps.drawn(text)
    label = np.where((cells == "#") | (cells == "?"), -1, cells.astype("U1").view(np.int32).reshape(cells.shape))
    wide = [(0, full - n) for full, n in zip(SHAPE, cells.shape)]
    label = np.pad(label, wide, constant_values=-1)
    label = np.where(label == ord("+"), -2, label)
    return label != -1, np.pad(cells == "?", wide, constant_values=False), label


def found_in(free, unknown=None, **numbers):
    unknown = np.zeros_like(free) if unknown is None else unknown
    return watershed(jnp.asarray(free), jnp.asarray(unknown), room_criteria(CELL_M, **numbers), form=FORM)


def check(text, **numbers):
    """Asserts that free space, drawn as letters, falls into the rooms that the letters say."""
    free, unknown, expected = drawn(text)
    found = found_in(free, unknown, **numbers)
    label = np.where(expected == -2, -2, np.asarray(found.label))
    assert int(found.overflow) == 0
    assert rooms.same_partition(label, expected), "\n".join("".join(f"{n:4d}" for n in row) for row in label[::-1])
    return found


# ---------------------------------------------------------------- by hand

TWO_ROOMS = """
###################
#aaaaaaaa#bbbbbbbb#
#aaaaaaaa#bbbbbbbb#
#aaaaaaaa#bbbbbbbb#
#aaaaaaaa+bbbbbbbb#
#aaaaaaaa#bbbbbbbb#
#aaaaaaaa#bbbbbbbb#
#aaaaaaaa#bbbbbbbb#
###################
"""


def test_rooms_part_at_a_door():
    found = check(TWO_ROOMS)
    sizes = sorted(np.asarray(found.area)[np.asarray(found.area) > 0].tolist())
    assert sizes == [56, 57]
    assert sorted(np.asarray(found.door_d2)[np.asarray(found.area) > 0].tolist()) == [1, 1]


def test_what_is_wide_is_relative_to_the_rooms():
    """The same opening, five cells, is a door between halls, and none between small rooms."""
    halls = np.zeros(SHAPE, bool)
    halls[1:23, 1:11] = halls[1:23, 13:23] = halls[10:15, 11:13] = True
    small = np.zeros(SHAPE, bool)
    small[9:16, 6:11] = small[9:16, 13:18] = small[10:15, 11:13] = True
    assert [np.unique(np.asarray(found_in(free).label)[free]).size for free in (halls, small)] == [2, 1]


def test_small_rooms_face_each_other_across_a_corridor_narrower_than_they_are():
    """Openings of six of eight cells: by the ratio alone they are none, and a crossing wider than the corridor is a
    room of its own with both rooms. What narrows along its whole length is no door.
    """
    text = """
        ########################
        #aaaaaaaa##bbbbbbbb#####
        #aaaaaaaa##bbbbbbbb#####
        #aaaaaaaa##bbbbbbbb#####
        #aaaaaaaa##bbbbbbbb#####
        #aaaaaaaa##bbbbbbbb#####
        #aaaaaaaa##bbbbbbbb#####
        #aaaaaaaa##bbbbbbbb#####
        ##++++++####++++++######
        #cccccccccccccccccc#####
        #cccccccccccccccccc#####
        #cccccccccccccccccc#####
        #cccccccccccccccccc#####
        #cccccccccccccccccc#####
        ##++++++####++++++######
        #dddddddd##eeeeeeee#####
        #dddddddd##eeeeeeee#####
        #dddddddd##eeeeeeee#####
        #dddddddd##eeeeeeee#####
        #dddddddd##eeeeeeee#####
        #dddddddd##eeeeeeee#####
        #dddddddd##eeeeeeee#####
        ########################
        """
    check(text, ratio=0.65)  # 0.68 between two crossings so close
    free, _, _ = drawn(text)
    alone = np.asarray(found_in(free, ratio=0.65, narrowing=None).label)
    assert alone[3, 4] == alone[11, 4] == alone[19, 4]
    np.testing.assert_array_equal(found_in(free, ratio=0.65, narrowing=0.0).label, alone)


def test_a_leg_of_a_table_is_clutter():
    with_leg = TWO_ROOMS.split("\n")
    with_leg[4] = "#aaa##aaa#bbbbbbbb#"
    check("\n".join(with_leg))
    free, _, _ = drawn("\n".join(with_leg))
    mask, overflow = CLUTTER(jnp.asarray(free), 4.0, edges=576)
    assert np.argwhere(np.asarray(mask)).tolist() == [[5, 4], [5, 5]]
    assert int(overflow) == 0
    assert int(CLUTTER(jnp.asarray(free), 4.0, edges=10)[1]) > 0


HOLLOW = [np.s_[6:9, 6:13], np.s_[10:13, 6:13], np.s_[9, 6:9], np.s_[9, 10:13]]
ROOMS_IN_ROCK = [np.s_[1:5, 1:20], np.s_[16:22, 1:20], np.s_[10, 10]]


@pytest.mark.parametrize(
    ("ground", "drawn_on", "size", "edges", "expected"),
    [
        # filled, and neither off the rim nor long
        (True, [np.s_[5:8, 5:8], np.s_[0:2, 10:12], np.s_[12:20, 12:14]], 4.0, 576, [np.s_[5:8, 5:8]]),
        (False, ROOMS_IN_ROCK[2:], 4.0, 576, []),  # a pocket does not turn thick rock into clutter
        (False, ROOMS_IN_ROCK, 4.0, 576, []),
        *((True, [np.s_[4:20, 4:20]], 12.0, edges, []) for edges in (10, 576)),  # edges that do not fit are walls
        (True, HOLLOW, 9.0, 576, HOLLOW),  # as a whole
    ],
)
def test_clutter_by_hand(ground, drawn_on, size, edges, expected):
    free, clutter = np.full(SHAPE, ground), np.zeros(SHAPE, bool)
    for cells in drawn_on:
        free[cells] = not ground
    for cells in expected:
        clutter[cells] = True
    np.testing.assert_array_equal(CLUTTER(jnp.asarray(free), size, edges=edges)[0], clutter)


def test_no_free_space_and_no_wall():
    none = found_in(np.zeros(SHAPE, bool))
    assert (np.asarray(none.label) == -1).all()
    everything = found_in(np.ones(SHAPE, bool))
    assert (np.asarray(everything.label) == np.asarray(everything.label)[0, 0]).all()
    assert int(everything.overflow) == 0


# ---------------------------------------------------------------- the oracle

DENSITIES = (0.02, 0.1, 0.3)
RATIOS = (0.5, 0.75, 0.9)


def scattered(seed, density):
    """Free and unknown cells: walls at random, thickened into pieces, a part of the map unknown."""
    rng = np.random.default_rng(seed)
    free = rng.random(SHAPE) > density
    free &= np.roll(free, 1, axis=int(rng.integers(2)))
    unknown = np.zeros(SHAPE, bool)
    if seed % 2:
        row = int(rng.integers(8, 24))
        unknown[row:] = ~free[row:] | (rng.random(SHAPE)[row:] < 0.8)
    return free & ~unknown, unknown


def both(seed, density, ratio):
    """Kernel and oracle on one map: for each its label map, and of every room the way out and the area, sorted."""
    free, unknown = scattered(seed, density)
    found = found_in(free, unknown, ratio=ratio, narrowing=0.9, smallest_m2=1.0, clutter_m=0.8)
    label, doors, areas = basins.watershed(
        free, unknown, ratio=ratio, narrowing=0.9, smallest=16.0, size=np.float32(0.8 / CELL_M)
    )
    assert int(found.overflow) == 0
    sides = []
    for one, d2, area in ((found.label, found.door_d2, found.area), (label, doors, areas)):
        sides.append((np.asarray(one), sorted((d, n) for d, n in zip(np.ravel(d2).tolist(), np.ravel(area)) if n > 0)))
    return sides


def test_rooms_are_the_oracles_on_many_maps():
    # 1163, 2765, 2867: a pocket in rock; 1538, 2618: small rooms in a row.
    for seed in (*range(30), 1163, 1538, 2618, 2765, 2867):
        (label, ways), (expected, expected_ways) = both(seed, DENSITIES[seed % 3], RATIOS[seed // 3 % 3])
        assert rooms.same_partition(label, expected), seed
        assert ways == expected_ways, seed


# ---------------------------------------------------------------- bad input


@pytest.mark.slow
def test_what_does_not_fit_is_counted():
    free, unknown = scattered(0, 0.3)
    small = watershed(free, unknown, room_criteria(CELL_M), form=RoomForm(4, 4, 16))
    assert int(small.overflow) > 0


def test_what_is_refused():
    mask = np.zeros((4, 4), bool)
    for free, unknown in ((mask.astype(int), mask), (mask[0], mask[0]), (mask, mask[:3]), (mask, mask.astype(int))):
        with pytest.raises(AssertionError):
            watershed(free, unknown, room_criteria(CELL_M), form=FORM)
