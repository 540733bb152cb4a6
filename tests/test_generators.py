"""World generators: plans of a size to check with a pencil, then measured buildings, laws and bad input."""

import hashlib
import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ref.refusals import refused
from scipy import ndimage

from jexplore.rooms.scores import label_components
from jexplore.worlds import load_world
from jexplore.worlds.bounds import PARAMETERS
from jexplore.worlds.generators.cave import _widen, cave
from jexplore.worlds.generators.course import course
from jexplore.worlds.generators.draft import FloorPlan, passable_cells, wall_span
from jexplore.worlds.generators.furniture import CHECKED_CELLS, _Space
from jexplore.worlds.generators.hospital import hospital
from jexplore.worlds.generators.maze import maze
from jexplore.worlds.generators.office import office
from jexplore.worlds.generators.rooms import rooms
from jexplore.worlds.generators.variants import widen_openings
from jexplore.worlds.starts import clear_of_walls

KINDS = {"cave": cave, "office": office, "hospital": hospital, "maze": maze, "rooms": rooms}
BUILDINGS = {"office": office, "hospital": hospital, "rooms": rooms}
ROBOT_M = 0.30
EIGHT = np.ones((3, 3))


def picture(world):
    """Lines of `#` (wall), `.` (free, no room) and room numbers, the top row first."""
    return [
        "".join("#" if wall else "." if room < 0 else str(room) for wall, room in zip(walls, numbers))
        for walls, numbers in zip(world.occupied[::-1], world.rooms[::-1])
    ]


def doorways(world):
    """Of every doorway `(gap, a, b)`: its width in cells and the rooms it joins; fails where it is no gap in a wall."""
    labels, _ = ndimage.label(~world.occupied & (world.rooms < 0))
    found = []
    for y, x in ndimage.find_objects(labels):
        assert not world.occupied[y, x].any(), "a doorway is a rectangle"
        beside = [world.occupied[y, x.start - 1], world.occupied[y, x.stop]]
        above = [world.occupied[y.start - 1, x], world.occupied[y.stop, x]]
        assert np.all(beside) != np.all(above), "wall on two opposite sides, rooms on the two others"
        around = world.rooms[y.start - 1 : y.stop + 1, x.start - 1 : x.stop + 1]
        joined = np.unique(around[around >= 0])
        assert len(joined) == 2, "a doorway joins two rooms"
        found.append((x.stop - x.start if np.all(beside) else y.stop - y.start, *joined.tolist()))
    return found


def assert_sound(world):
    """Check the laws of every generated world."""
    occupied, free = world.occupied, ~world.occupied
    assert occupied.dtype == bool
    assert occupied[[0, -1], :].all()
    assert occupied[:, [0, -1]].all()
    assert world.start is None
    assert label_components(free).max() == 0, "the free cells hang together"
    clear = clear_of_walls(occupied, ROBOT_M, world.cell_m)
    assert label_components(clear).max() == 0, "a robot reaches every place that it could stand on"
    if world.rooms is None:
        return
    assert world.rooms.dtype == np.int32
    assert world.rooms.shape == occupied.shape
    assert (world.rooms[occupied] == -1).all()
    n = world.rooms.max() + 1
    np.testing.assert_array_equal(np.unique(world.rooms[clear & (world.rooms >= 0)]), np.arange(n))
    spaces = label_components(free & (world.rooms >= 0))  # with every doorway closed
    assert spaces.max() + 1 == n, "closing the doorways parts every room from every other"
    for space in range(n):
        assert len(np.unique(world.rooms[spaces == space])) == 1, "and no space has two numbers"
    for gap, _, _ in doorways(world):
        assert 0.9 - world.cell_m <= gap * world.cell_m + 1e-9
        assert gap * world.cell_m - 1e-9 <= 1.2 + world.cell_m


# Pencil cases


def test_two_rooms_and_a_door():
    plan = FloorPlan("rooms", 0, 4.0, 3.0)
    left, right = plan.room((0.0, 0.0, 2.0, 3.0)), plan.room((2.0, 0.0, 4.0, 3.0))
    plan.door(left, right, 1.0)
    plan.blocks.append((1.0, 0.5, 1.5, 1.0))
    world = plan.render(0.5)
    assert picture(world) == [
        "########",
        "#000#11#",
        "#000.11#",
        "#000.11#",
        "#0#0#11#",
        "########",
    ]
    assert world.cell_m == 0.5
    flipped = plan.render(0.5, (True, True))
    np.testing.assert_array_equal(flipped.occupied, world.occupied[::-1, ::-1])
    np.testing.assert_array_equal(flipped.rooms, world.rooms[::-1, ::-1])


def test_a_door_keeps_jambs_and_lets_a_robot_pass():
    for cell_m, n in ((0.1, 7), (0.05, 13), (0.2, 3), (0.3, 3)):
        assert passable_cells(cell_m) == n
        plan = FloorPlan("rooms", 0, 4.0, 2.0)
        left, right = plan.room((0.0, 0.0, 2.0, 2.0)), plan.room((2.0, 0.0, 4.0, 2.0))
        plan.door(left, right, 0.1, at=1.0)  # too narrow for any robot: widened to what passes
        world = plan.render(cell_m)
        assert doorways(world) == [(n, 0, 1)]
        rows = np.flatnonzero((world.rooms >= 0).any(axis=1))
        gap_rows = np.flatnonzero((~world.occupied & (world.rooms < 0)).any(axis=1))
        assert rows[0] < gap_rows[0] < gap_rows[-1] < rows[-1], "a cell of wall remains on either side"
        clear = clear_of_walls(world.occupied, ROBOT_M, cell_m)
        assert label_components(clear).max() == 0
        plan.doors.clear()
        plan.door(left, right, 9.0)  # wider than the wall: a cell of wall remains on either side
        world = plan.render(cell_m)
        assert (world.rooms >= 0).any(axis=1).sum() - doorways(world)[0][0] == 2


def test_walls_have_one_thickness_wherever_they_stand():
    for cell_m in (0.05, 0.07, 0.1, 0.15, 0.2, 0.3):
        middles = np.linspace(0.5, 9.5, 91)
        spans = [wall_span(middle, 10.0, cell_m) for middle in middles]
        thick = {stop - first for first, stop in spans}
        assert len(thick) == 1
        assert thick.pop() == max(1, math.floor(0.15 / cell_m + 0.5 + 1e-6))
        assert all(abs((first + stop) / 2 * cell_m - m) < 0.51 * cell_m for (first, stop), m in zip(spans, middles))
    assert wall_span(0.0, 10.0, 0.1) == (0, 3)
    assert wall_span(10.0, 10.0, 0.1) == (97, 100)


def two_rooms():
    """A room 4 m wide and one 6 m wide, with two doors between them, 6 m deep."""
    plan = FloorPlan("rooms", 0, 10.0, 6.0)
    left, right = plan.room((0.0, 0.0, 4.0, 6.0)), plan.room((4.0, 0.0, 10.0, 6.0), kind="open")
    for at in (0.0, 1.0):
        plan.door(left, right, 0.9, at)
    return plan


def test_an_opening_fits_between_its_neighbours():
    plan = two_rooms()
    widen_openings(plan, 0.0)
    assert [door.width for door in plan.doors] == [0.9, 0.9]
    widen_openings(plan, 0.5)
    assert sorted(door.width > 1.6 for door in plan.doors) == [False, True]
    widen_openings(plan, 1.0)
    low, high = sorted(plan.doors, key=lambda door: door.middle)
    assert low.width >= 1.6
    assert high.width >= 1.6
    assert high.middle - high.width / 2 - low.middle - low.width / 2 > 0.2
    assert len(doorways(plan.render(0.1))) == 2
    narrow = FloorPlan("rooms", 0, 4.0, 2.0)
    narrow.door(narrow.room((0.0, 0.0, 2.0, 2.0)), narrow.room((2.0, 0.0, 4.0, 2.0)), 0.9)
    widen_openings(narrow, 1.0)
    assert narrow.doors[0].width == 0.9


def test_furniture_that_parts_two_doors_shuts_in_space_or_fills_a_room_does_not_fit():
    plan = two_rooms()
    doors = [door for door in plan.doors if 0 in plan.beside(door)]
    spaces = [_Space(plan.render(cell_m), 0, plan.rooms[0], doors, clear_m) for cell_m, clear_m in CHECKED_CELLS]

    def fits(*blocks):
        return all(space.fits([blocks]) for space in spaces)

    wall, bin_, cell, hall = (0.0, 2.9, 4.0, 3.1), (1.0, 2.9, 1.3, 3.2), (0.9, 2.0, 2.1, 2.1), (0.5, 0.5, 3.0, 5.5)
    assert fits(bin_)
    assert not fits(wall)
    assert not fits(hall)
    box = [cell, (0.9, 3.0, 2.1, 3.1), (0.9, 2.0, 1.0, 3.1), (2.0, 2.0, 2.1, 3.1)]
    assert fits(*box[:3])
    assert not fits(*box)


# Measured worlds


FURNISHED = {"furniture": 0.6, "wide_openings": 0.4, "max_loops": 3.0}
DIGESTS = {
    ("cave", ""): "cdaae284497df867",
    ("maze", ""): "7ba3a95dd8af4c8d",
    ("office", ""): "ff0efe91a49306db",
    ("office", "furnished"): "ce5609101bfdcc07",
    ("hospital", ""): "b01a224ff7ad026b",
    ("hospital", "furnished"): "86989bd17bd75f87",
    ("rooms", ""): "0133ea9de6bdb9a7",
    ("rooms", "furnished"): "d7f52e660afadc7a",
    ("course", ""): "89352cf4301c6bc6",
    ("course", "furnished"): "e15cd56b66a55252",
}


@pytest.mark.parametrize(("kind", "how"), DIGESTS)
def test_worlds_stay_what_they_are_to_the_bit(kind, how):
    """Results of published names must not change; new parameters draw from random streams of their own."""
    found = hashlib.sha256()
    for seed, cell_m in ((np.int64(0), 0.1), (1, 0.1), (2, 0.2)):
        some = {"furniture": True} if kind == "course" else FURNISHED
        world = (KINDS | {"course": course})[kind](seed, cell_m=cell_m, **(some if how else {}))
        found.update(np.packbits(world.occupied).tobytes())
        found.update(b"" if world.rooms is None else world.rooms.astype("<i4").tobytes())
    assert found.hexdigest()[:16] == DIGESTS[kind, how]


def test_rooms_without_extra_doors_are_a_tree():
    for seed in range(5):
        few, some, all_doors = (rooms(seed, extra_doors=extra) for extra in (0.0, 0.3, 1.0))
        n = few.rooms.max() + 1
        assert len(doorways(few)) == n - 1
        assert n - 1 < len(doorways(some)) < len(doorways(all_doors))


def test_there_is_more_of_the_same_furniture():
    plain, half, full = (rooms(1, furniture=furniture) for furniture in (0.0, 0.5, 1.0))
    assert (plain.occupied <= half.occupied).all()
    assert (half.occupied <= full.occupied).all(), "what there is stays where it is"
    assert (half.occupied.sum() - plain.occupied.sum()) * 1.3 < full.occupied.sum() - plain.occupied.sum()
    assert (plain.rooms[~full.occupied] == full.rooms[~full.occupied]).all()


FEW, MANY = [(1, 0.1)], list(itertools.product(range(4), (0.05, 0.1, 0.2)))


@pytest.mark.parametrize("plans", [FEW, pytest.param(MANY, marks=pytest.mark.slow)], ids=["one", "many"])
@pytest.mark.parametrize("kind", BUILDINGS)
def test_a_robot_gets_everywhere_among_furniture(kind, plans):
    full = {"furniture": 1.0, "wide_openings": 0.2, "max_loops": 4.0}
    if kind != "rooms":
        full["corridor_sd_m"] = 0.4
    for seed, cell_m in plans:
        world = BUILDINGS[kind](seed, cell_m=cell_m, **full)
        assert label_components(~world.occupied).max() == 0, "the free cells hang together"
        clear = clear_of_walls(world.occupied, ROBOT_M, cell_m)
        labels = label_components(clear)
        reached = labels == np.argmax(np.bincount(labels[clear]))
        n = world.rooms.max() + 1
        stand, get = (np.bincount(world.rooms[cells & (world.rooms >= 0)], minlength=n) for cells in (clear, reached))
        assert (get > 0.6 * stand).all()
        assert (stand > 0).all()


@pytest.mark.parametrize("kind", BUILDINGS)
def test_fewer_ways_round_and_the_same_rooms(kind):
    for seed in range(2):
        drawn, few, none = (BUILDINGS[kind](seed, max_loops=most) for most in (1000.0, 4.0, 0.0))
        n = drawn.rooms.max() + 1
        assert few.rooms.max() + 1 == none.rooms.max() + 1 == n
        assert len(doorways(none)) == n - 1
        loops = len(doorways(few)) - (n - 1)
        assert 0 < loops <= 4 * few.free_m2 / 1000
        assert len(doorways(drawn)) > len(doorways(few))
        assert (few.occupied <= none.occupied).all()
        assert (drawn.occupied <= few.occupied).all()


@pytest.mark.parametrize("kind", BUILDINGS)
def test_a_share_of_the_doors_becomes_wide_openings(kind):
    plain, some, more = (BUILDINGS[kind](1, cell_m=0.05, wide_openings=share) for share in (0.0, 0.1, 0.2))
    gaps = [np.array([gap for gap, _, _ in doorways(world)]) * 0.05 for world in (plain, some, more)]
    assert [len(gap) for gap in gaps] == [len(gaps[0])] * 3
    wide = [(gap >= 1.6 - 1e-9).sum() for gap in gaps]
    assert wide == [0, round(0.1 * len(gaps[0])), round(0.2 * len(gaps[0]))]
    assert gaps[2].max() <= 2.65
    assert (more.occupied <= some.occupied).all()


@pytest.mark.parametrize("loops", [0.0, 0.1, 0.4])
def test_every_opened_wall_of_a_maze_makes_one_loop(loops):
    # A wall opened beyond the tree closes one way round, and that way runs round one island of wall.
    for seed in range(3):
        world = maze(seed, loops=loops)
        n = int((15 - 0.2 + 1e-6) // 1.4)
        _, walls = ndimage.label(world.occupied, EIGHT)
        assert walls - 1 == round(loops * (2 * n * (n - 1) - (n * n - 1)))
        assert_sound(world)


@pytest.mark.parametrize("passage_m", [1.0, 1.6])
def test_a_disc_as_wide_as_a_passage_touches_every_place_of_a_cave(passage_m):
    for seed in range(2):
        world = cave(seed, passage_m=passage_m)
        radius = passage_m / 2 / world.cell_m
        inside = ndimage.distance_transform_edt(~world.occupied) > radius
        labels = label_components(inside)
        largest = labels == np.argmax(np.bincount(labels[inside]))
        assert (ndimage.distance_transform_edt(~largest)[~world.occupied] <= radius).all()


def test_a_place_behind_a_slot_is_filled_until_no_robot_can_stand_there():
    occupied = np.ones((30, 60), bool)
    occupied[1:29, 1:30] = False
    occupied[1:29, 31:50] = False
    occupied[14:17, 30] = False  # 0.3 m: no robot passes
    filled = _widen(occupied, 0.0, 0.1)
    clear = clear_of_walls(filled, ROBOT_M, 0.1)
    np.testing.assert_array_equal(clear, clear_of_walls(occupied, ROBOT_M, 0.1) & (np.arange(60) < 30))
    assert (filled >= occupied).all()
    disc = _widen(occupied, 3.5, 0.1)  # a wide disc does not pass either
    assert disc[:, 31:].all()


# Laws


@pytest.mark.parametrize("kind", BUILDINGS)
def test_a_seed_is_one_building_at_every_cell(kind):
    fine, *others = (BUILDINGS[kind](0, cell_m=cell_m) for cell_m in (0.05, 0.1, 0.2))
    for world in others:
        assert world.rooms.max() == fine.rooms.max()
        assert len(doorways(world)) == len(doorways(fine))
        assert world.free_m2 == pytest.approx(fine.free_m2, rel=0.05)
        np.testing.assert_allclose(_room_middles(world), _room_middles(fine), atol=0.25)


def _room_middles(world):
    """The middle of every room's bounding box, metres."""
    boxes = ndimage.find_objects(world.rooms + 1)
    return np.array([[(span.start + span.stop) / 2 * world.cell_m for span in box] for box in boxes])


def _sizes(low_w, low_h, high, **others):
    fixed = {"width_m": st.floats(low_w, high), "height_m": st.floats(low_h, high), "cell_m": st.floats(0.08, 0.3)}
    return st.fixed_dictionaries(fixed | others)


UNEVEN = {"corridor_sd_m": st.floats(0, 1), "max_loops": st.floats(0, 20)}
OFFICE = {"corridor_m": st.floats(1.5, 3), "room_m": st.floats(2.6, 6), **UNEVEN}
DRAWN = {
    "cave": _sizes(6, 6, 20, free=st.floats(0.5, 0.9), passage_m=st.floats(0.8, 1.0)),
    "office": _sizes(14, 9, 50, **OFFICE),
    "hospital": _sizes(32, 11, 60, corridor_m=st.floats(1.8, 3.5), room_m=st.floats(3.4, 7), **UNEVEN),
    "maze": _sizes(8, 8, 20, corridor_m=st.floats(1.4, 3), wall_m=st.floats(0.05, 0.6), loops=st.floats(0, 1)),
    "rooms": _sizes(8, 8, 30, room_m=st.floats(2, 4), extra_doors=st.floats(0, 1)),
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_permitted_parameter_makes_a_sound_world(kind):
    @settings(max_examples=2 if kind == "cave" else 5, deadline=None, derandomize=True)
    @given(seed=st.integers(0, 2**32 - 1), parameters=DRAWN[kind])
    def check(seed, parameters):
        assert_sound(KINDS[kind](seed, **parameters))

    check()


# Bad input


WRONG = [("width_m", value) for value in ("nan", -5.0, 1.0, "inf", "wide", 5000.0)]
WRONG += [("cell_m", 0.0), ("cell_m", 0.5), ("cell_m", 0.001), ("seed", -1), ("seed", 1.5)]


@pytest.mark.parametrize("kind", KINDS)
def test_wrong_numbers_are_refused_in_one_line(kind):
    beyond = [
        (key, value) for key, (low, high) in PARAMETERS[kind].items() for value in (low - 0.1, high + 0.1, "much")
    ]
    for key, value in [*WRONG, *beyond]:
        tail = {"seed": f"#{value}", "cell_m": ""}.get(key, f":{key}={value}")
        too_many = value in (0.001, 5000.0)
        refused("cells are more than" if too_many else key, load_world, kind + tail, value if key == "cell_m" else 0.1)


def test_cells_too_large_for_furniture_or_corridors_are_refused():
    refused(r"furniture needs a cell_m of at most 0\.2, got 0\.25", load_world, "office:furniture=0.1", 0.25)
    refused(r"corridor_m = 0\.8 leaves [012] cells of 0\.3 m", load_world, "maze:corridor_m=0.8", 0.3)
