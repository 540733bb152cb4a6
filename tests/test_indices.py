"""Cells that go in and come out are those of the array that was given, whether its edge is walled or not."""

import jax
import numpy as np
import pytest

import jexplore as jx
from jexplore.rules import Lidar
from jexplore.studies.bounds.scene import prepare_scene
from jexplore.studies.explore import explore
from jexplore.studies.room_variants import RoomSettings, divided
from jexplore.worlds.world import occupancy_to_world

pytestmark = pytest.mark.jit

LIDAR = Lidar(n_beams=37, range_m=1.0)
START = 20, 12, 90


def plan():
    """An array of one's own that ends in free cells: 3 x 2.4 m, a wall in it."""
    walls = np.zeros((30, 24), bool)
    walls[14:16, 6:] = True
    return walls


PLAIN = occupancy_to_world(plan(), name="mine")
WALLED = occupancy_to_world(np.pad(plan(), 1, constant_values=True), name="mine", origin_m=(-0.1, -0.1))


def test_the_array_that_was_given_is_the_world():
    assert np.array_equal(PLAIN.occupied, plan())
    assert PLAIN.origin_m == (0.0, 0.0)


@pytest.fixture(scope="module")
def both(jit_on):
    with jit_on():
        walled = START[0] + 1, START[1] + 1, START[2]
        return [explore(world, "closest", start=at, lidar=LIDAR) for world, at in ((PLAIN, START), (WALLED, walled))]


def test_an_episode_begins_where_it_was_told_to_and_keeps_its_cells(both):
    one, other = both
    assert one.start == START
    assert (one.final.rows[0], one.final.cols[0]) == START[:2]
    assert [one.measures[f"start_{name}"] for name in ("row", "col", "heading_deg")] == list(START)
    assert one.final.hits.shape == plan().shape
    assert not (plan() & (one.final.misses > 0)).any()  # no beam passes a wall
    assert np.array_equal(one.final.hits, other.final.hits[1:-1, 1:-1])
    assert np.array_equal(one.final.rows + 1, other.final.rows)
    assert np.array_equal(one.final.cols + 1, other.final.cols)
    targets = [[plan.target for plan in made.final.plans if plan.target] for made in both]
    assert np.array_equal(np.array(targets[0]) + 1, targets[1])
    same = {name for name in one.measures if not name.startswith("start_")}
    assert {name: one.measures[name] for name in same} == {name: other.measures[name] for name in same}


def test_so_do_paths_and_maps_of_a_comparison():
    found = [jx.compare(world, "closest", episodes=2, lidar=LIDAR, keep="maps") for world in (PLAIN, WALLED)]
    key = "mine", "closest"
    starts = found[0].episodes[["start_row", "start_col"]].to_numpy()
    assert [path[0, :2].tolist() for path in found[0].paths[key]] == starts.tolist()
    for one, other in zip(found[0].paths[key], found[1].paths[key]):
        assert np.array_equal(one + np.array([1, 1, 0]), other)
    assert np.array_equal(found[0].maps[key], found[1].maps[key][:, 1:-1, 1:-1])


@pytest.mark.slow
def test_so_do_views_actions_and_paths_of_an_environment():
    envs = [jx.Environment(world, lidar=LIDAR, paths=True) for world in (PLAIN, WALLED)]
    start, key = np.array(START, np.int32), jax.random.key(0)
    (state, view), (other, their) = envs[0].reset(key, start), envs[1].reset(key, start + np.array([1, 1, 0], np.int32))
    rows, cols = plan().shape
    for _ in range(2):
        assert np.array_equal(view.cost[:rows, :cols], their.cost[1 : rows + 1, 1 : cols + 1])
        assert np.array_equal(view.belief.grid.hits[:rows, :cols], their.belief.grid.hits[1 : rows + 1, 1 : cols + 1])
        assert (int(view.belief.row) + 1, int(view.belief.col) + 1) == (int(their.belief.row), int(their.belief.col))
        assert view.belief.extent.tolist() == [rows, cols]
        target = np.argwhere(np.asarray(view.frontier))[0].astype(np.int32)
        state, view, reward, _, info = envs[0].step(key, state, target)
        other, their, same, *_ = envs[1].step(key, other, target + 1)
        assert bool(info["valid"])
        assert float(reward) == float(same)
    assert view.belief.start.tolist() == [START[0], START[1], START[2] // 45]
    assert envs[0].path(state)[0].tolist() == list(START[:2])
    assert np.array_equal(envs[0].path(state) + 1, envs[1].path(other))


@pytest.mark.parametrize("variant", ["voronoi", "distance", "wurm"])
def test_rooms_are_those_of_the_same_plan_in_walls(variant):
    made = [
        divided(~world.occupied, np.zeros_like(world.occupied), variant, RoomSettings(), 0.1)
        for world in (PLAIN, WALLED)
    ]
    assert np.array_equal(made[0].label, made[1].label[1:-1, 1:-1])
    cells = [np.stack(np.divmod(one.lines, world.shape[1])) for one, world in zip(made, (PLAIN, WALLED))]
    assert np.array_equal(cells[0] + 1, cells[1])


def test_bounds_see_the_same_cells():
    scenes = [
        prepare_scene(world, start, LIDAR, jx.Rules(), 2)
        for world, start in ((PLAIN, START), (WALLED, (START[0] + 1, START[1] + 1, START[2])))
    ]
    cells = [np.array(scene.cells(np.flatnonzero(scene.must_see))) for scene in scenes if scene is not None]
    assert np.array_equal(cells[0] + 1, cells[1])
