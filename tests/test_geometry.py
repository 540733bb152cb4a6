"""Geometry of maps: some that one can measure with a pencil, then generated ones and the command."""

import json
import math

import numpy as np
import pytest
from ref.refusals import refused

from jexplore.studies.geometry import GEOMETRY_COLUMNS, geometry
from jexplore.worlds import load_world
from jexplore.worlds.world import World

CELL_M = 0.1


def two_rooms(gap=9, *, known=True, pillar=None):
    """Rooms of 40 x 40 and 60 x 40 cells, a wall of 2 cells with a gap between them, and perhaps a pillar."""
    occupied = np.ones((42, 104), bool)
    occupied[1:41, 1:41] = occupied[1:41, 43:103] = False
    begin = 21 - gap // 2
    occupied[begin : begin + gap, 41:43] = False
    rooms = np.full(occupied.shape, -1, np.int32)
    rooms[1:41, 1:41], rooms[1:41, 43:103] = 0, 1
    if pillar is not None:
        occupied[pillar], rooms[pillar] = True, -1
    return World(occupied=occupied, rooms=rooms if known else None, cell_m=CELL_M, name="two")


def test_two_rooms_and_a_door():
    found = geometry(two_rooms())
    assert found.rooms_from == "truth"
    assert (found.rooms, found.openings) == (2, 1)
    assert found.free_m2 == pytest.approx(16 + 24 + 0.18)
    assert found.rooms_per_100_m2 == pytest.approx(200 / 40.18)
    assert found.room_m2 == pytest.approx(20)
    assert (found.small_rooms, found.large_rooms, found.dead_ends) == (0, 0, 1)
    assert found.opening_m == pytest.approx(0.9)
    assert found.wide_openings == 0
    assert (found.loops_per_1000_m2, found.islands_per_100_m2, found.long_islands_per_100_m2) == (0, 0, 0)
    assert math.isnan(found.corridor_low_m), "neither a room nor a doorway is a corridor"
    # Within 0.3 m of a wall no robot stands: 3 cells remain in the doorway, and before it 5, 5, 9 of the next columns.
    assert found.clear_share == pytest.approx((34 * 34 + 34 * 54 + 2 * 3 + 2 * (5 + 5 + 9)) / 4018)
    assert geometry(two_rooms(), clearance_m=0.0).clear_share == 1
    assert geometry(two_rooms(), clearance_m=0.5).clear_share == pytest.approx((30 * 50 + 9 + 3 + 1 + 1 + 1) / 4018)


@pytest.mark.parametrize("gap", [8, 9, 15, 16, 18])
def test_an_opening_is_as_wide_as_its_gap(gap):
    found = geometry(two_rooms(gap))
    assert found.opening_m == pytest.approx(gap * CELL_M)
    assert found.wide_openings == (gap >= 16)


def test_rooms_side_by_side_without_a_doorway_have_an_opening():
    occupied = np.ones((22, 42), bool)
    occupied[1:21, 1:41] = False
    rooms = np.where(occupied, -1, (np.arange(42) > 20).astype(np.int32))
    found = geometry(World(occupied=occupied, rooms=rooms, cell_m=CELL_M))
    assert (found.openings, found.opening_m, found.wide_openings) == (1, pytest.approx(2.0), 1)


@pytest.mark.parametrize(
    ("rows", "cols", "loops", "islands", "long"),
    [(1, 1, 0, 1, 0), (3, 3, 0, 1, 0), (4, 3, 0, 1, 1), (4, 12, 0, 1, 1), (4, 13, 1, 0, 0), (20, 20, 1, 0, 0)],
)
def test_a_pillar_is_a_leg_a_block_or_a_way_round(rows, cols, loops, islands, long):
    world = two_rooms(pillar=(slice(10, 10 + rows), slice(60, 60 + cols)))
    found = geometry(world)
    assert found.loops_per_1000_m2 == pytest.approx(1000 * loops / world.free_m2)
    assert found.islands_per_100_m2 == pytest.approx(100 * islands / world.free_m2)
    assert found.long_islands_per_100_m2 == pytest.approx(100 * long / world.free_m2)


def test_what_stands_at_a_wall_is_no_island_and_diagonal_cells_are_one():
    world = two_rooms()
    world.occupied[1:5, 50:54] = True
    world.occupied[20, 80] = world.occupied[21, 81] = True
    assert geometry(world).islands_per_100_m2 == pytest.approx(100 / world.free_m2)


def ring_corridor(width=20):
    """A corridor round a block, 10 x 5 m outside."""
    occupied = np.ones((52, 102), bool)
    occupied[1:51, 1:101] = False
    occupied[1 + width : 51 - width, 1 + width : 101 - width] = True
    return World(occupied=occupied, rooms=np.where(occupied, -1, 0).astype(np.int32), cell_m=CELL_M)


@pytest.mark.parametrize("width", [9, 12])
def test_a_corridor_is_as_wide_as_it_is(width):
    found = geometry(ring_corridor(width))
    assert found.corridor_low_m == pytest.approx(width * CELL_M)
    assert found.corridor_high_m == pytest.approx(width * CELL_M)
    assert found.loops_per_1000_m2 == pytest.approx(1000 / found.free_m2)
    assert found.dead_ends == 0
    assert math.isnan(found.opening_m)


def test_turning_a_map_changes_nothing():
    world = load_world("office#1:furniture=1,width_m=16,height_m=12")
    for turn in (np.fliplr, np.flipud, np.transpose):
        other = world.replace(occupied=turn(world.occupied).copy(), rooms=turn(world.rooms).copy())
        one, two = (geometry(w) for w in (world, other))
        for field, _ in GEOMETRY_COLUMNS.values():
            assert getattr(two, field) == pytest.approx(getattr(one, field), rel=0.02, abs=0.02), field


@pytest.mark.slow
@pytest.mark.jit
def test_rooms_that_are_not_known_are_found():
    known, found = (geometry(two_rooms(9, known=flag, pillar=(20, 70))) for flag in (True, False))
    assert found.rooms_from == "segments"
    assert (found.rooms, found.openings) == (2, 1)
    assert found.opening_m == pytest.approx(0.9, abs=0.1)
    assert found.room_m2 == pytest.approx(known.room_m2, abs=0.2)
    assert found.islands_per_100_m2 == known.islands_per_100_m2 > 0
    assert geometry(two_rooms(18, known=False)).wide_openings == 1
    alone = np.ones((20, 20), bool)
    alone[5:15, 5:15] = False
    alone = geometry(World(occupied=alone, cell_m=CELL_M))
    assert (alone.rooms, alone.openings, alone.dead_ends) == (1, 0, 0)


def test_a_map_with_a_single_free_cell_has_no_figures_that_do_not_exist():
    occupied = np.ones((3, 3), bool)
    occupied[1, 1] = False
    found = geometry(World(occupied=occupied, rooms=np.where(occupied, -1, 0).astype(np.int32), cell_m=CELL_M))
    assert (found.rooms, found.clear_share) == (1, 0)
    assert math.isnan(found.opening_m)
    assert math.isnan(found.wide_openings)


def test_the_clearance_must_be_a_number():
    for wrong in (-1.0, math.nan, 1000.0):
        refused("clearance_m", geometry, two_rooms(), clearance_m=wrong)


def test_the_command_prints_and_records_it(tmp_path, printed):
    names = ["rooms:width_m=6,height_m=5", "rooms#1:width_m=6,height_m=5,furniture=1"]
    said = printed(["worlds", *names, "--geometry", "--clearance-m", "0.2", "--out", str(tmp_path)]).out
    assert "islands/100 m²" in said
    assert "median" in said
    worlds = json.loads((tmp_path / "run.json").read_text())["worlds"]
    assert [world["geometry"]["world"] for world in worlds] == names
    assert worlds[0]["geometry"]["islands_per_100_m2"] == 0 < worlds[1]["geometry"]["islands_per_100_m2"]
    assert worlds[0]["geometry"]["corridor_low_m"] is None
    command = ["worlds", names[0], "--geometry", "--clearance-m", "nan", "--out", str(tmp_path / "no")]
    assert "clearance_m" in printed(command, 2).err
