"""World: the ring, clearance, components, starts."""

import math

import jax
import jax.numpy as jnp
import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from ref.maps import walls
from ref.refusals import refused
from ref.worlds import with_walls

from jexplore.config import InputError
from jexplore.rooms.scores import label_components
from jexplore.worlds import load_world
from jexplore.worlds.bounds import MAX_SIDE
from jexplore.worlds.starts import check_start, clear_of_walls, draw_starts, start_region
from jexplore.worlds.world import World, occupancy_to_world, require_world, with_ring

masks = hnp.arrays(bool, st.tuples(st.integers(1, 12), st.integers(1, 12)))


def room(rows, cols, **fields):
    """Return an empty room with a number of free cells inside its ring."""
    return with_ring(World(occupied=np.zeros((rows, cols), bool), **fields))


# --- ring


def test_ring_is_added_and_everything_moves_along():
    world = World(walls(".. .#"), start=(0, 1, 90), rooms=np.array([[0, 1], [2, -1]], np.int32), cell_m=0.5)
    ringed = with_ring(world)
    assert ringed.occupied.tolist() == [[1, 1, 1, 1], [1, 0, 1, 1], [1, 0, 0, 1], [1, 1, 1, 1]]
    assert ringed.rooms.tolist() == [[-1, -1, -1, -1], [-1, 0, 1, -1], [-1, 2, -1, -1], [-1, -1, -1, -1]]
    assert ringed.start == (1, 2, 90)
    assert ringed.origin_m == (-0.5, -0.5)
    assert ringed.free_m2 == world.free_m2 == 0.75


def test_the_ground_goes_along_and_is_level_beyond_the_edge():
    world = World(walls(".. .."), elevation=np.array([[0, 1], [2, 3]], np.float32))
    assert with_ring(world).elevation.tolist() == [[0, 0, 1, 1], [0, 0, 1, 1], [2, 2, 3, 3], [2, 2, 3, 3]]
    assert with_ring(world).elevation.dtype == np.float32
    assert require_world(World(walls(".."), elevation=np.array([[0.5, 1.0]]))).elevation.dtype == np.float32


@pytest.mark.parametrize(
    ("elevation", "line"),
    [
        (np.zeros((2, 3), np.float32), r"elevation must be floats of shape \(2, 2\), got \(2, 3\) float32"),
        (np.zeros((2, 2), int), r"elevation must be floats of shape \(2, 2\), got \(2, 2\) int64"),
        (np.array([[0, np.nan], [0, 0]]), "elevation must be finite"),
    ],
)
def test_wrong_ground_is_refused(elevation, line):
    refused(line, require_world, World(walls(".. .."), elevation=elevation))


def test_a_world_of_lists_is_one_of_arrays():
    world = require_world(World(occupied=[[True, False, True], [True, False, True]], rooms=[[-1, 0, -1], [-1, 0, -1]]))
    assert world.occupied.tolist() == [[1, 0, 1], [1, 0, 1]]
    assert world.occupied.dtype == bool
    assert world.rooms.dtype.kind == "i"
    assert World(occupied=[[True, False]], cell_m=0.5).free_m2 == 0.25


@pytest.mark.parametrize(
    ("occupied", "line"),
    [
        (np.eye(3, dtype=int), "'mine': occupied must be .* got int64; write array == 1 for a mask of 0 and 1, and "),
        ([[0, 100]], "occupied must be .* jx.occupancy_to_world.array. for 0 .free. to 100 .occupied."),
        (np.zeros((2, 2)), "got float64"),
        ([[True], [True, False]], "rows of different lengths"),
    ],
)
def test_a_world_of_numbers_is_refused_when_it_is_made(occupied, line):
    """Free cells are `~occupied`: of the integers 0 and 1 that would be -1 and -2, everywhere and without a word."""
    refused(line, World, occupied=occupied, name="mine")


def test_a_world_may_hold_other_things_on_its_way_through_jax():
    world = World(occupied=np.eye(2, dtype=bool))
    assert jax.tree.map(np.shape, world).occupied == (2, 2)
    assert jax.tree.map(jnp.asarray, world).occupied.shape == (2, 2)
    refused("occupied must be", require_world, world.replace(occupied=jnp.eye(2)))


@pytest.mark.parametrize("hole", [(0, 1), (2, 1), (1, 0), (1, 2)])
def test_ring_is_added_for_one_hole_on_any_side_and_only_then(hole):
    closed = World(walls("### #.# ###"))
    assert with_ring(closed) is closed
    occupied = closed.occupied.copy()
    occupied[hole] = False
    assert with_ring(World(occupied=occupied)).shape == (5, 5)


def test_ring_of_the_smallest_worlds():
    for shape in ((1, 1), (1, 4), (4, 1)):
        assert with_ring(World(occupied=np.zeros(shape, bool))).shape == (shape[0] + 2, shape[1] + 2)
        assert with_ring(World(occupied=np.ones(shape, bool))).shape == shape


def test_ring_refuses_to_exceed_the_limit():
    at_limit = World(occupied=np.zeros((1, MAX_SIDE - 2), bool))
    assert with_ring(at_limit).shape == (3, MAX_SIDE)
    refused(
        "4097 cells are more than 4096", require_world, World(occupied=np.zeros((1, MAX_SIDE - 1), bool), name="long")
    )


# --- occupancy arrays


def test_occupancy_follows_ros_and_unknown_is_occupied():
    world = occupancy_to_world(np.array([[-1, 0, 25], [26, 100, 0]], np.int8), cell_m=0.2, origin_m=(1.0, 2.0))
    assert world.occupied.tolist() == [[1, 0, 0], [1, 1, 0]]
    assert world.cell_m == 0.2
    assert world.origin_m == (1.0, 2.0)
    assert occupancy_to_world([[30, 60]], free_max=50).occupied.tolist() == [[False, True]]


def test_occupancy_takes_bool_and_does_not_share_memory():
    occupied = np.pad(np.zeros((1, 2), bool), 1, constant_values=True)
    world = occupancy_to_world(occupied)
    occupied[:] = True
    assert world.occupied.tolist() == [[1] * 4, [1, 0, 0, 1], [1] * 4]


@pytest.mark.parametrize(
    ("occupancy", "line"),
    [
        (np.zeros((2, 2)), "got float64 of shape"),
        (np.zeros((0, 3), int), r"shape \(0, 3\)"),
        ([["a"]], "must be a matrix"),
        ([[0, 101]], "got 0 to 101"),
        ([[-2, 0]], "got -2 to 0"),
        ([[-1, 100]], "no cell is free"),
        (np.zeros((1, 4097), np.int8), "more than 4096 a side; use a larger cell_m, at least 0.11, or cut"),
        ([[0, 1], [1, 0]], "integers of 0 and 1 alone would have no wall, .* use bool, or 0..100: write array == 1"),
        (
            [[0, 1, 2]],
            "integers up to 2 would have no wall, .* array == N, .* or give a free_max below the walls' values",
        ),
        ([[0, 1], [0]], "rows of different lengths"),
    ],
)
def test_bad_occupancy_is_refused(occupancy, line):
    assert "'mine'" in refused(line, occupancy_to_world, occupancy, name="mine")


@pytest.mark.parametrize("cell_m", [0, float("nan"), "a"])
def test_bad_cell_is_refused(cell_m):
    refused("cell_m must be a number above 0", occupancy_to_world, [[0]], cell_m=cell_m)


# --- clearance


@settings(deadline=None, max_examples=25)
@given(masks, st.sampled_from([0, 0.05, 0.1, 0.15, 0.3, 0.5, 3.0]))
def test_clearance_is_that_of_every_pair_of_cells(occupied, radius_m):
    at, walls = np.argwhere(occupied | True), np.argwhere(occupied)
    d2 = ((at[:, None] - walls) ** 2).sum(-1).min(axis=1, initial=10**6).reshape(occupied.shape)
    expected = d2 > np.floor((radius_m / 0.1) ** 2 + 1e-3)
    assert np.array_equal(clear_of_walls(occupied, radius_m, 0.1), expected)


# --- components


@settings(deadline=None, max_examples=20)
@given(masks)
def test_components_are_what_the_robot_reaches_in_eight_directions(mask):
    graph = nx.Graph()
    cells = {(int(r), int(c)) for r, c in np.argwhere(mask)}
    graph.add_nodes_from(cells)
    for r, c in cells:
        for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
            beside = {(r + dr, c), (r, c + dc)} - {(r, c)}
            if (r + dr, c + dc) in cells and beside <= cells:
                graph.add_edge((r, c), (r + dr, c + dc))
    labels = label_components(mask)
    expected = np.full(mask.shape, -1, np.int32)
    for number, component in enumerate(sorted(nx.connected_components(graph), key=min)):
        expected[tuple(np.array(list(component)).T)] = number
    np.testing.assert_array_equal(labels, expected, strict=True)


# --- starts


def test_start_region_is_the_largest_and_of_equals_the_first():
    world = World(walls("######## #..#...# ########"))
    assert np.argwhere(start_region(world, 0))[:, 1].tolist() == [4, 5, 6]
    world = World(walls("####### #..#..# #######"))
    assert np.argwhere(start_region(world, 0))[:, 1].tolist() == [1, 2]
    world = World(walls("#### #.## ##.# ####"))  # corner to corner is no way
    assert np.argwhere(start_region(world, 0)).tolist() == [[1, 2]]


def test_a_start_depends_on_seed_and_number_alone():
    world = room(6, 9)
    starts = draw_starts(world, 7, 12, 0.1)
    assert starts.dtype == np.int32
    assert starts.shape == (12, 3)
    assert np.array_equal(draw_starts(world, 7, 5, 0.1), starts[:5])
    assert np.array_equal(draw_starts(with_walls(world, (40, 50)), 7, 12, 0.1), starts)
    assert not np.array_equal(draw_starts(world, 8, 12, 0.1), starts)
    assert draw_starts(world, 7, 0, 0.1).shape == (0, 3)


@pytest.mark.parametrize(
    ("name", "same", "other"),
    [
        ("cave", "cave#0", "cave#1"),
        ("cave:width_m=9", "cave#0:width_m=9", "cave:width_m=8"),
        ("a.png@0.05", "/some/where/a.png@0.05", "a.png@0.1"),
        ("maps/plan.json", "C:\\maps\\plan.json", "maps/plans.json"),
    ],
)
def test_one_world_has_one_name_as_far_as_starts_go(name, same, other):
    first, again, apart = (draw_starts(room(9, 9, name=name), 3, 20, 0) for name in (name, same, other))
    np.testing.assert_array_equal(first, again)
    assert (first != apart).any()


def test_drawn_starts_are_uniform_over_cells_and_headings():
    world = room(2, 3)
    starts = draw_starts(world, 0, 2400, 0)
    cells, counts = np.unique(starts[:, :2], axis=0, return_counts=True)
    assert cells.tolist() == [[r, c] for r in (1, 2) for c in (1, 2, 3)]
    assert abs(counts - 400).max() < 80  # 4 sigma is 73
    headings, counts = np.unique(starts[:, 2], return_counts=True)
    assert headings.tolist() == [0, 45, 90, 135, 180, 225, 270, 315]
    assert abs(counts - 300).max() < 70


def test_drawing_without_room_or_with_a_bad_seed_is_refused():
    refused(r"'closet': no cell has more than 0.3 m of clearance", draw_starts, room(5, 5, name="closet"), 0, 1, 0.3)
    refused("at least 0, got -1", draw_starts, room(5, 5), -1, 1, 0)


def test_a_given_start_is_made_plain():
    assert check_start(room(9, 9), (np.int32(5), np.int64(5), -45), 0.3) == (5, 5, 315)
    assert check_start(room(9, 9), [5, 5, 720], 0.3) == (5, 5, 0)


@pytest.mark.parametrize(
    ("start", "line"),
    [
        ((11, 5, 0), r"lies outside; rows are 0 to 10, columns 0 to 10"),
        ((5, -1, 0), "lies outside"),
        ((0, 5, 0), "lies in a wall"),
        ((5, 5, 30), "multiple of 45 degrees, got 30"),
        ((5, 5), "three integers"),
        ((5.5, 5, 0), "three integers"),
        (7, "three integers"),
    ],
)
def test_a_bad_start_is_refused(start, line):
    refused(line, check_start, room(9, 9, name="hall"), start, 0.3)


def test_a_start_beside_a_wall_may_leave_over_near_cells_only():
    world = room(9, 30)  # clear at 0.3 m: rows 4 to 6, columns 4 to 27
    assert check_start(world, (1, 1, 0), 0.3, near_m=0.5) == (1, 1, 0)  # (4, 4) lies 0.42 m away
    refused(r"is enclosed; no cell with more than 0.3 m", check_start, world, (1, 1, 0), 0.3, near_m=0.2)


def test_a_start_behind_a_wall_is_enclosed_however_near_clear_cells_are():
    world = World(walls("""
        #########
        #.#.....#
        #.#.....#
        ###.....#
        #########
    """))  # fmt: skip
    assert check_start(world, (2, 4, 0), 0) == (2, 4, 0)
    assert check_start(world, (2, 1, 0), 0) == (2, 1, 0)  # the other cell of the closet is clear at radius 0
    for place, clearance_m in ((world, 0.1), (World(walls("#### #### #.## ####")), 0)):  # no clear cell but its own
        refused("is enclosed", check_start, place, (2, 1, 0) if place is world else (1, 1, 0), clearance_m)


def _pencil_world():
    occupied = np.ones((5, 7), bool)
    occupied[1:4, 1:6] = False
    occupied[2, 3] = True
    return World(occupied, cell_m=0.1, name="pencil_$1", origin_m=(-14.3, 2.7), start=(1, 1, 90))


def test_a_world_is_its_occupied_cells_to_numpy():
    world = _pencil_world()
    assert np.asarray(world).dtype == bool
    assert np.asarray(world) is world.occupied
    np.testing.assert_array_equal(np.asarray(world, dtype=np.int8), world.occupied.astype(np.int8))
    copied = np.array(world)
    copied[:] = False
    assert world.occupied.sum() == 21
    with pytest.raises(ValueError, match="copy"):
        np.asarray(world, dtype=float, copy=False)


@pytest.mark.parametrize("origin_m", [(-14.3, 2.7), (-1 / 3, 1e5)])
def test_a_world_that_is_saved_is_read_back_equal(tmp_path, origin_m):
    world = _pencil_world().replace(origin_m=origin_m)
    path = world.save(tmp_path / "new" / "map.yaml")
    read = load_world(path, cell_m=world.cell_m)
    np.testing.assert_array_equal(read.occupied, world.occupied)
    assert read.origin_m == pytest.approx(origin_m, abs=1e-9)


def test_what_is_no_yaml_file_is_not_saved(tmp_path):
    refused(r"must end in \.yaml", _pencil_world().save, tmp_path / "map.png")
    (tmp_path / "file").write_text("")
    refused("must be a folder", _pencil_world().save, tmp_path / "file" / "map.yaml")


@pytest.mark.parametrize("free_max", [math.nan, -1, 100, 2.5, True])
def test_the_bound_of_free_cells_is_a_whole_number_of_per_cent(free_max):
    with pytest.raises(InputError, match=r"^free_max must be an integer from 0 to 99, got"):
        occupancy_to_world(np.array([[0, 100]]), free_max=free_max)


def test_masked_cells_are_not_taken_for_free():
    with pytest.raises(InputError, match=r"write array.filled\(-1\) for masked cells"):
        occupancy_to_world(np.ma.masked_array(np.zeros((3, 3), int), mask=np.eye(3, dtype=bool)))
