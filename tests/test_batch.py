"""Many episodes: a result depends neither on what else runs, nor on order, number of cores and padding."""

import threading

import jax
import numpy as np
import pytest
from ref import maps, simulator
from ref.jobs import assert_equal, some_jobs
from scipy import ndimage

from jexplore.arrays.padding import bucket
from jexplore.exploration.batch import run_jobs
from jexplore.exploration.site import prepare_site
from jexplore.exploration.state import Outcome
from jexplore.native.build import find_compiler
from jexplore.rules import Lidar, Rules
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
    return some_jobs(("closest", "closest+recheck", "random+recheck"))


@pytest.fixture(scope="module")
def one_worker(jobs, jit_on):
    with jit_on():
        return run_jobs(jobs, LIDAR, RULES, workers=1).outcomes


@pytest.mark.jit
@pytest.mark.skipif(not find_compiler(), reason="no C++ compiler")
def test_two_workers_and_another_order_give_the_same(jobs, one_worker):
    report = run_jobs(jobs[::-1], LIDAR, RULES, workers=2)
    assert_equal(report.outcomes[::-1], one_worker)
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
def test_results_are_in_the_order_of_starts_and_are_the_simulators(jobs, one_worker):
    job, (result, *_) = jobs[1], one_worker[1]
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


@pytest.mark.jit
def test_an_interrupt_leaves_no_thread_behind(jobs):
    def interrupt(done):
        raise KeyboardInterrupt

    before = set(threading.enumerate())
    assert run_jobs(jobs[:2], LIDAR, RULES, workers=2, on_progress=interrupt).costs.interrupted
    assert set(threading.enumerate()) <= before
