"""A region to stay in and a partial map to go on from: by hand, by whole episodes, bad input."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref import maps
from ref.refusals import refused

import jexplore as jx
from jexplore.config import InputError
from jexplore.grid import Grid
from jexplore.rules import Lidar
from jexplore.studies import checks
from jexplore.studies.results import provenance
from jexplore.worlds.poses import read_polygon
from jexplore.worlds.readers.ros import write_ros
from jexplore.worlds.readers.scans import ScanMap
from jexplore.worlds.restrict import stay_within, with_known
from jexplore.worlds.starts import check_start, draw_starts, start_region

ROOM = jx.occupancy_to_world(
    maps.walls("""
    ########
    #......#
    #......#
    #......#
    ########
"""),
    cell_m=1.0,
    name="room",
)
LIDAR = Lidar(n_beams=37, range_m=1.5)
ROOMS = "rooms:width_m=6,height_m=5"


def test_a_triangle_by_hand():
    """Cells whose centres lie within; those on the edge's left are outside."""
    within = stay_within(ROOM, [(1, 1), (7, 1), (1, 4)]).within
    assert maps.picture(within, 1) == ["........", ".#......", ".###....", ".#####..", "........"]


@pytest.mark.parametrize("turned", [False, True])
def test_corners_may_go_round_either_way(turned):
    corners = [(2, 0), (5, 0), (5, 3), (2, 3)]
    within = stay_within(ROOM, corners[::-1] if turned else corners).within
    assert maps.picture(within, 1) == ["........", "........", "..###...", "..###...", "..###..."]


def test_a_polygon_of_text():
    assert read_polygon(" 0,0 5,0.5  -5,4e0") == [(0, 0), (5, 0.5), (-5, 4)]
    for text in ("0,0 5", "0,0,0 1,1,1 2,2,2", "a,b", "0;0"):
        refused(r"^within must be three or more corners .* as '0,0 5,0 5,4', got", read_polygon, text)


@pytest.mark.parametrize(
    "corners", [[], [(0, 0), (1, 1)], [(0, 0), (1, 1), (2, np.nan)], 3, [(0, 0, 0)] * 3, "0,0 1,1"]
)
def test_what_is_no_polygon_is_refused(corners):
    refused(r"^within must be three or more corners \(x, y\) in metres", stay_within, ROOM, corners)


def test_a_region_without_floor_is_refused():
    with pytest.raises(
        InputError, match=r"^'room': no free cell lies within 20,20 to 21,21; the world spans 0.5,0.5 to"
    ):
        stay_within(ROOM, [(20, 20), (21, 20), (21, 21)])


def test_starts_lie_within_and_where_the_map_is_known():
    left = stay_within(ROOM, [(0, 0), (4, 0), (4, 5), (0, 5)])
    assert maps.picture(start_region(left, 0.0), 1) == ["........", ".###....", ".###....", ".###....", "........"]
    known = np.full(ROOM.shape, -1)
    known[1:3] = 0
    assert maps.picture(start_region(with_known(left, known), 0.0), 1) == [
        *["........"] * 2,
        ".###....",
        ".###....",
        "........",
    ]
    refused(r"lies outside the region that the robot is to stay in$", check_start, left, (1, 6, 0), 0.0)


def test_a_partial_map_is_laid_over_the_world(tmp_path):
    """A file of other extents: it begins two cells to the right and a cell lower, and is cut at the world's edge."""
    occupancy = np.full((4, 9), -1)
    occupancy[1:3, 1:3], occupancy[3, 1], occupancy[1, 4] = 0, 100, 40
    write_ros(occupancy, tmp_path / "part.yaml", cell_m=1.0, origin_m=(2.0, -1.0))
    known = with_known(ROOM, tmp_path / "part.yaml").known
    expected = np.full(ROOM.shape, -1)
    expected[0:2, 3:5], expected[2, 3] = 0, 1
    np.testing.assert_array_equal(known, expected)


def test_a_map_that_does_not_fit_is_refused(tmp_path):
    write_ros(np.zeros((4, 4), int), tmp_path / "fine.yaml", cell_m=0.5)
    refused(r"has cells of 0.5 m, 'room' of 1 m; make them equal$", with_known, ROOM, tmp_path / "fine.yaml")
    write_ros(np.zeros((4, 4), int), tmp_path / "far.yaml", cell_m=1.0, origin_m=(50.0, 50.0))
    with pytest.raises(InputError, match=r"none of its free cells is free in 'room'; is it a map of this building"):
        with_known(ROOM, tmp_path / "far.yaml")
    with pytest.raises(InputError, match=r"^the map must be integers \[5, 8\], .* got float64 of shape \[5, 8\]$"):
        with_known(ROOM, np.zeros(ROOM.shape))


def test_a_map_of_scans_says_what_most_of_them_do():
    scans = Grid(np.where(ROOM.occupied, 3, 1), np.where(ROOM.occupied, 1, 9))
    known = with_known(ROOM, ScanMap(scans, 1.0, ROOM.origin_m, (1, 1, 0))).known
    assert (known == ROOM.occupied).all()


@pytest.mark.parametrize(
    ("field", "array"), [("within", np.ones((2, 2), bool)), ("within", np.ones((5, 8))), ("known", np.ones((5, 8)))]
)
def test_arrays_of_a_world_are_checked(field, array):
    refused(f"^'room': {field} must be ", jx.explore, ROOM.replace(**{field: array}), "closest")


@pytest.mark.jit
@pytest.mark.parametrize("strategy", ["closest", pytest.param("distance-advantage+recheck", marks=pytest.mark.slow)])
def test_a_robot_stays_within_and_ends_when_it_knows_that(strategy):
    world = stay_within(jx.load_world(ROOMS), "0,0 3.2,0 3.2,5 0,5")
    episode = jx.explore(world, strategy, lidar=LIDAR)
    assert world.within[episode.final.rows, episode.final.cols].all()
    assert episode.measures["outcome"] == "COMPLETE"
    assert episode.measures["steps"] > 10
    known = episode.final.hits + episode.final.misses > 0
    assert (known & ~world.within).any()  # it sees beyond
    assert episode.final.n_known[-1] == (known & world.within).sum()


@pytest.mark.jit
def test_going_on_from_the_end_of_an_episode_there_is_nothing_left(tmp_path):
    world = jx.load_world(ROOMS)
    whole = jx.explore(world, "closest", lidar=LIDAR)
    hits, misses = whole.final.hits, whole.final.misses
    whole_map = np.where(hits > misses, 100, np.where(misses > 0, 0, -1))
    write_ros(whole_map, tmp_path / "explored.yaml", cell_m=world.cell_m, origin_m=world.origin_m)
    again = jx.explore(with_known(world, tmp_path / "explored.yaml"), "closest", lidar=LIDAR)
    assert (again.measures["steps"], again.measures["plans"], again.measures["outcome"]) == (0, 1, "COMPLETE")
    half_map = np.where(np.arange(world.shape[1]) < world.shape[1] // 2, whole_map, -1)
    half = jx.explore(with_known(world, half_map), "closest", lidar=LIDAR)
    assert half_map[half.final.rows[0], half.final.cols[0]] == 0
    assert half.final.n_known[0] >= (half_map >= 0).sum()
    assert 0 < half.measures["steps"] < whole.measures["steps"]


def test_both_are_arguments_of_functions_and_part_of_what_is_asked(tmp_path, monkeypatch):
    """A run of another region or map is another run."""
    monkeypatch.chdir(tmp_path)
    write_ros(np.where(ROOM.occupied, 100, 0), "known.yaml", cell_m=1.0)
    how = {"episodes": 1, "seed": 0, "cell_m": 1.0, "start": "random", "lidar": LIDAR, "rules": jx.Rules(clearance_m=0)}
    asked = []
    for limits in ({}, {"within": "0,0 4,0 4,5 0,5"}, {"from_map": "known.yaml"}):
        jobs = checks.prepare_jobs(ROOM, ["closest"], **how, **limits)
        assert (jobs[0].world.within is None, jobs[0].world.known is None) == (
            "within" not in limits,
            "from_map" not in limits,
        )
        asked.append(provenance.world_digest(jobs[0].world))
    assert len(set(asked)) == 3


@pytest.mark.slow
@pytest.mark.jit
def test_an_environment_holds_restricted_worlds_beside_others():
    plain = jx.load_world(ROOMS).replace(name="plain")
    within = stay_within(plain, "0,0 3.2,0 3.2,5 0,5").replace(name="within")
    key, start = jax.random.key(0), jnp.asarray(draw_starts(within, 0, 1, 0.3)[0])
    both, alone = jx.Environment([plain, within], lidar=LIDAR), jx.Environment(within, lidar=LIDAR)
    (_, view), (_, own) = both.reset(key, start, jnp.int32(1)), alone.reset(key, start, jnp.int32(0))
    np.testing.assert_array_equal(view.frontier, own.frontier)
    assert (np.asarray(both.reset(key, start, jnp.int32(0))[1].frontier) != np.asarray(view.frontier)).any()


def test_bounds_are_of_worlds_without_restrictions():
    with pytest.raises(InputError, match=r"^'room': bounds are of whole worlds, of which nothing is known beforehand"):
        jx.bound(stay_within(ROOM, "0,0 4,0 4,5 0,5"), rules=jx.Rules(clearance_m=0), seconds=1)
