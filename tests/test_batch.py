"""Many episodes: a result depends neither on what else runs, nor on order, number of cores and padding."""

import threading

import jax
import numpy as np
import pytest
from ref import maps, simulator
from ref.refusals import refused
from ref.worlds import with_walls
from scipy import ndimage

from jexplore.arrays.padding import bucket
from jexplore.exploration.batch import Job, run_jobs
from jexplore.exploration.results import length_along_m, progress_m
from jexplore.exploration.site import prepare_site
from jexplore.exploration.state import Outcome
from jexplore.native.build import find_compiler
from jexplore.policies import parse_strategy
from jexplore.rules import Lidar, Rules
from jexplore.worlds.starts import draw_starts
from jexplore.worlds.world import World

LIDAR, RULES = Lidar(range_m=2.0, n_beams=37), Rules(max_plans=30)


@pytest.mark.parametrize(
    ("n", "padded"),
    [(1, 64), (64, 64), (65, 96), (96, 96), (97, 128), (128, 128), (129, 160), (256, 256), (257, 320), (1000, 1024),
     (1025, 1280), (4096, 4096)],
)  # fmt: skip
def test_buckets_by_hand(n, padded):
    assert bucket(n) == padded


def test_a_world_is_padded_with_walls():
    occupied, rooms = maps.cluttered(1, 40, 70)
    site = prepare_site(World(occupied=occupied, rooms=rooms), LIDAR, Rules(near_m=0.4, max_steps=9))
    assert site.truth.occupied.shape == (64, 96)
    np.testing.assert_array_equal(site.truth.occupied[:40, :70], occupied)
    assert site.truth.occupied[40:].all()
    assert site.truth.occupied[:, 70:].all()
    assert (np.asarray(site.truth.rooms)[40:] == -1).all()
    np.testing.assert_array_equal(site.truth.rooms[:40, :70], rooms)
    assert site.truth.extent.tolist() == [40, 70]
    assert (
        site.numbers.model.clearance_d2,
        site.numbers.model.near_d2,
        site.setup.first_scans,
        site.numbers.max_steps,
        site.numbers.max_plans,
    ) == (9, 16, 2, 9, 20000)
    assert not site.setup.noisy
    assert site.setup.capacity >= site.numbers.max_steps
    region, n = ndimage.label(~occupied)
    pairs = set(zip(region.ravel().tolist(), np.asarray(site.truth.region)[:40, :70].ravel().tolist()))
    assert len(pairs) == n + 1  # one number for each region


def test_the_trail_has_room_for_as_many_steps_as_are_asked_for():
    world = World(occupied=maps.walls("### #.# ###"))
    assert prepare_site(world, LIDAR, Rules(max_steps=30_000)).setup.capacity >= 30_000
    assert prepare_site(world, LIDAR, Rules()).setup.capacity >= 20_000


@pytest.fixture(scope="module")
def jobs():
    """Two worlds, of one padded size, and three strategies."""
    worlds = []
    for seed, shape in ((1, (40, 44)), (2, (50, 36))):
        occupied, rooms = maps.cluttered(seed, *shape)
        worlds.append(World(occupied=occupied, rooms=rooms, name=f"cluttered {seed}"))
    strategies = [parse_strategy(name) for name in ("closest", "closest+recheck", "random+recheck")]
    return [
        Job(world, strategy, draw_starts(world, 5, 4, RULES.clearance_m), seed=7)
        for world in worlds
        for strategy in strategies
    ]


@pytest.fixture(scope="module")
def one_worker(jobs, jit_on):
    with jit_on():
        return run_jobs(jobs, LIDAR, RULES, workers=1).outcomes


def assert_equal(got, want):
    """Results and first maps, bit by bit."""
    jax.tree.map(np.testing.assert_array_equal, got.result, want.result)
    for a, b in zip(got.first._replace(plans=None), want.first._replace(plans=None)):
        np.testing.assert_array_equal(a, b)
    assert got.first.plans == want.first.plans


@pytest.mark.jit
@pytest.mark.skipif(not find_compiler(), reason="no C++ compiler")
def test_two_workers_and_another_order_give_the_same(jobs, one_worker):
    report = run_jobs(jobs[::-1], LIDAR, RULES, workers=2)
    for got, want in zip(report.outcomes[::-1], one_worker):
        assert_equal(got, want)
    assert report.costs.run_s > 0
    for name, levels in report.costs.levels.items():
        assert levels == ["native on a CPU" if name.split("+")[0] in ("closest", "random") else "native driving"]
    assert sorted(report.costs.levels) == sorted({job.strategy.name for job in jobs})
    assert report.costs.why_not == []


@pytest.mark.jit
def test_fewer_episodes_of_a_job_are_its_first_ones(jobs, one_worker):
    (few,) = run_jobs([jobs[5]._replace(starts=jobs[5].starts[:2])], LIDAR, RULES, workers=2).outcomes
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(a, b[:2]), few.result, one_worker[5].result)


@pytest.mark.jit
def test_padding_changes_nothing(jobs, one_worker):
    """A world with walls added above and on the right falls into another bucket; draws do not depend on it."""
    larger = [jobs[i]._replace(world=with_walls(jobs[i].world, (60, 70))) for i in (1, 2)]
    for got, i in zip(run_jobs(larger, LIDAR, RULES, workers=1).outcomes, (1, 2)):
        height, width = jobs[i].world.shape
        got = got._replace(first=got.first._replace(
            hits=got.first.hits[:height, :width], misses=got.first.misses[:height, :width]
        ))  # fmt: skip
        assert_equal(got, one_worker[i])


@pytest.mark.jit
def test_results_are_in_the_order_of_starts_and_are_the_simulators(jobs, one_worker):
    job, (result, first, _) = jobs[1], one_worker[1]
    for i, start in enumerate(job.starts):
        want = simulator.simulate(
            job.world.occupied, *map(int, start), recheck=True, n_beams=37, range_m=2.0, max_plans=30,
            rooms=job.world.rooms,
        )  # fmt: skip
        got = [int(getattr(result, name)[i]) for name in ("straight", "diagonal", "turns", "scans", "plans", "n_known")]
        known = int((want.hits + want.misses > 0).sum())
        assert got == [want.straight, want.diagonal, want.turns, want.scans, want.plans, known]
        assert Outcome(int(result.outcome[i])).name == want.outcome
        assert int(result.room_entries[i]) == want.room_entries
        if i == 0:
            assert list(zip(first.rows.tolist(), first.cols.tolist())) == want.visited
            np.testing.assert_array_equal(first.hits, want.hits)
            np.testing.assert_array_equal(first.misses, want.misses)
            assert [plan.target for plan in first.plans] == [plan.target for plan in want.log]
            assert first.n_known[-1] == known
            assert int(first.looked.sum()) == want.scans - 2 - want.steps


@pytest.mark.jit
def test_paths_at_marks_are_those_of_the_trail(jobs, one_worker):
    """The first step after which a share of the cells was known, by the episode's record; knowable cells by hand."""
    found = run_jobs(jobs[:3], LIDAR, RULES, keep="paths").outcomes
    assert found[0].records[0].state is None
    for job, same, (result, _, records) in zip(jobs[:3], one_worker, found):
        jax.tree.map(np.testing.assert_array_equal, result, same.result)
        free = ~job.world.occupied
        regions, _ = ndimage.label(free)
        cross = ndimage.generate_binary_structure(2, 1)
        metres = progress_m(result, job.world.cell_m)
        assert metres.shape == (len(job.starts), 100)
        for i, (row, col, _) in enumerate(job.starts):
            knowable = ndimage.binary_dilation(regions == regions[row, col], cross).sum()
            path = records[i].path
            way = length_along_m(path[:, 0], path[:, 1], job.world.cell_m)
            for k in range(1, 101):
                reached = 100 * path[:, 2] >= k * knowable
                want = way[reached.argmax()] if reached.any() else np.nan
                assert metres[i, k - 1] == pytest.approx(want, nan_ok=True), (i, k)
            assert int(result.n_known[i]) <= knowable


def test_starts_and_seeds_that_cannot_be_used(jobs):
    job = jobs[0]
    row, col, heading = map(int, job.starts[0])
    height, width = job.world.shape
    bad = {
        "starts must be": [[[row, col, 0.0]], [], [[row, col]], [row, col, heading]],
        "lies outside": [[[-1, col, 0]], [[height, col, 0]], [[row, width, 0]], [[row, col, 0], [row, 2**31, 0]]],
        "no multiple of 45": [[[row, col, 30]], [[row, col, -1]]],
    }
    for message, all_starts in bad.items():
        for starts in all_starts:
            refused(message, run_jobs, [job._replace(starts=np.array(starts))], LIDAR, RULES)
    for seed in (-1, 2**32, 0.5):
        refused("seed must be an integer from 0 to 4294967295", run_jobs, [job._replace(seed=seed)], LIDAR, RULES)


@pytest.mark.jit
def test_an_interrupt_leaves_no_thread_behind(jobs):
    def interrupt(done):
        raise KeyboardInterrupt

    before = set(threading.enumerate())
    assert run_jobs(jobs[:2], LIDAR, RULES, workers=2, on_progress=interrupt).costs.interrupted
    assert set(threading.enumerate()) <= before
