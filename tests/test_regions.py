"""Outside and inside of a plan, floor out of reach, and the messages about both."""

from typing import Any

import numpy as np
import pytest
from PIL import Image
from ref.refusals import refused

from jexplore.config import InputError, InputWarning
from jexplore.rules import Rules
from jexplore.studies.checks import ready_starts
from jexplore.worlds import load_world
from jexplore.worlds.regions import inside, warn_of_floor, warn_of_outside
from jexplore.worlds.starts import draw_starts, start_region
from jexplore.worlds.world import occupancy_to_world

CELL_M = 0.1
FLOOR = np.s_[31:59, 21:79]  # of the house below: 2.8 x 5.8 m


def house(page=(100, 100)):
    """A closed house of 3 x 6 m on a white page: `[H, W]` bool, True at a wall."""
    walls = np.zeros(page, bool)
    walls[30:60, 20:80] = True
    walls[FLOOR] = False
    return walls


def on_paper(path, walls):
    Image.fromarray(np.where(walls[::-1], 0, 255).astype(np.uint8)).save(path)
    return f"{path}@{CELL_M}"


def told(world, start: Any = "random", **rules):
    with pytest.warns(InputWarning) as said:
        ready_starts(world, start, 1, seed=0, rules=Rules(**rules))
    assert len(said) == 1
    text = str(said[0].message)
    assert "\n" not in text
    return text


def test_a_start_outside_is_told_with_both_areas_and_the_choice(tmp_path):
    name = on_paper(tmp_path / "house.png", house())
    text = told(load_world(name))
    assert text == (
        f"{name}: robots start outside, on 82 m2 along the edge of the map, and 16 m2 are enclosed; for the inside "
        "give the name of a map file the parameter inside=true, or the point inside_x_m=X,inside_y_m=Y; of an array "
        "take jexplore.worlds.regions.inside(world)"
    )


@pytest.mark.parametrize("choice", ["inside=true", "inside_x_m=3,inside_y_m=4"])
def test_the_inside_is_all_that_is_left(tmp_path, choice):
    world = load_world(f"{on_paper(tmp_path / 'house.png', house())}:{choice}")
    floor = np.zeros((100, 100), bool)
    floor[FLOOR] = True
    assert np.array_equal(~world.occupied, floor)
    assert world.free_m2 == pytest.approx(2.8 * 5.8)
    assert all(floor[row, col] for row, col, _ in ready_starts(world, "random", 20, seed=0, rules=Rules()))


def test_the_choice_of_a_point_may_be_the_outside():
    world = occupancy_to_world(house(), origin_m=(-1.0, -2.0))
    assert np.array_equal(inside(world, (-0.5, -1.5)).occupied, house() | ~(inside(world).occupied))
    assert np.array_equal(inside(world, (2.0, 2.0)).occupied, inside(world).occupied)


def test_a_gap_that_no_robot_fits_through_keeps_both_apart():
    walls = house()
    walls[59:60, 40:44] = False  # 0.4 m
    left = ~inside(occupancy_to_world(walls)).occupied
    assert left[FLOOR].all()
    assert left.sum() <= left[FLOOR].sum() + 4
    walls[59:60, 40:50] = False  # 1 m
    with pytest.raises(InputError, match=r"no floor is enclosed; a gap wider than 0\.6 m leads from the edge"):
        inside(occupancy_to_world(walls, name="open"))
    world = occupancy_to_world(walls)
    warn_of_floor(world, start_region(world, 0.3), 0.3, drawn=True)  # says nothing


def test_start_and_rooms_stay_where_floor_does():
    rooms = np.where(house(), -1, 3).astype(np.int32)
    world = occupancy_to_world(house()).replace(rooms=rooms, start=(40, 40, 0))
    assert inside(world).start == (40, 40, 0)
    assert np.array_equal(np.asarray(inside(world).rooms) == -1, inside(world).occupied)
    assert inside(world.replace(start=(2, 2, 0))).start is None


@pytest.mark.parametrize(
    ("tail", "line"),
    [
        (":inside=1", "give inside=true, or both"),
        (":inside=false,outside=true", "it takes free, inside, inside_x_m, inside_y_m .did you mean 'inside'"),
        (":inside_x_m=3", "give inside=true, or both inside_x_m and inside_y_m"),
        (":inside=true,inside_x_m=3,inside_y_m=3", "give inside=true, or both"),
        (":inside_x_m=a,inside_y_m=3", "inside_x_m must be a finite number"),
        (":inside_x_m=30,inside_y_m=3", r"\(30, 3\) m: lies outside; x is 0 to 10 m, y 0 to 10 m"),
        (":inside_x_m=2.05,inside_y_m=4", r"\(2.05, 4\) m: lies in a wall, or no robot fits in there"),
    ],
)
def test_a_choice_that_is_none_is_refused(tmp_path, tail, line):
    name = on_paper(tmp_path / "house.png", house())
    refused(line, load_world, name + tail)


def test_a_point_where_no_robot_fits_in_is_refused():
    walls = house()
    walls[5, 5:20] = walls[9, 5:20] = walls[5:10, 5] = walls[5:10, 19] = True  # a slot of 0.3 m
    refused("no robot fits in there", inside, occupancy_to_world(walls), (1.0, 0.7))


def test_a_building_in_its_own_walls_is_no_outside():
    """Neither in a map that ends with the wall, nor in one that the edge cuts off at a corner of the floor."""
    walls = np.pad(np.zeros((60, 60), bool), 1, constant_values=True)
    walls[1:31, 31] = walls[31, 1:31] = True
    open_ = walls.copy()
    open_[31, 10:20] = False
    for world in (occupancy_to_world(open_), occupancy_to_world(open_[1:10, 1:])):
        assert not warn_of_outside(world, start_region(world, 0.3))


def test_columns_and_furniture_in_outline_are_no_inside():
    walls = np.zeros((100, 100), bool)
    walls[10:30, 10:30] = True
    walls[11:29, 11:29] = False  # 1.8 m wide: 1.4 m2 where a robot could stand
    world = occupancy_to_world(walls)
    assert not warn_of_outside(world, start_region(world, 0.3))
    world = occupancy_to_world(house(), name="mine")  # and the outside is no floor of a building that one starts in
    assert ready_starts(world, (40, 40, 0), 1, seed=0, rules=Rules()).tolist() == [[40, 40, 0]]  # warns of nothing


def closed_room():
    """Return 6 x 4 m in walls, a third of them a room without a door."""
    walls = np.pad(np.zeros((40, 60), bool), 1, constant_values=True)
    walls[1:41, 40] = True
    return walls


def test_a_room_without_a_door_is_told():
    text = told(occupancy_to_world(closed_room(), name="flat"))
    assert text == (
        "flat: a robot of 0.3 m clearance reaches 66% of the free floor; no way leads to 5 m2 where it could stand, "
        "such as row 4, col 44"
    )
    assert "reaches 34% of the free floor; no way leads to 11 m2" in told(
        occupancy_to_world(closed_room(), name="flat"), start=(20, 50, 0)
    )
    walls = closed_room()
    walls[10:20, 40] = False
    world = occupancy_to_world(walls, name="flat")
    warn_of_floor(world, start_region(world, 0.3), 0.3, drawn=True)  # says nothing


def test_floor_too_narrow_for_the_robot_is_told():
    walls = np.pad(np.zeros((20, 60), bool), 1, constant_values=True)
    walls[1:21, 20:61:4] = True  # two thirds in slots of 0.3 m
    walls[10, 20:61] = False
    text = told(occupancy_to_world(walls, name="comb"))
    assert text == "comb: a robot of 0.3 m clearance reaches 39% of the free floor"
    assert not start_region(occupancy_to_world(walls), 0.3)[:, 22:].any()


def test_the_start_region_and_draws_are_those_of_the_same_plan_in_walls():
    walls = house((90, 100))
    plain = occupancy_to_world(walls, name="mine")
    walled = occupancy_to_world(np.pad(walls, 1, constant_values=True), name="mine")
    assert np.array_equal(start_region(plain, 0.3), start_region(walled, 0.3)[1:-1, 1:-1])
    assert np.array_equal(draw_starts(plain, 3, 9, 0.3) + np.array([1, 1, 0]), draw_starts(walled, 3, 9, 0.3))
