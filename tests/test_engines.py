"""One result, whichever way episodes run: one by one or in lanes, batch sizes; early ends."""

import dataclasses
from typing import Any

import jax
import numpy as np
import pytest
from ref.jobs import LIDAR, RULES, assert_equal, some_jobs
from ref.refusals import refused

import jexplore as jx
from jexplore.config import InputError
from jexplore.engine import lanes, one_by_one, runner
from jexplore.exploration.batch import run_jobs
from jexplore.exploration.site import line_of, prepare_site
from jexplore.exploration.state import Outcome

WAYS: dict[str, dict[str, Any]] = {"one by one": {}, "lanes": {"in_lanes": True, "lanes": 7}}


@pytest.fixture(scope="module")
def want(jit_on):
    """The jobs, one after the other, with the record of every episode."""
    with jit_on():
        return run_jobs(some_jobs(), LIDAR, RULES, engine="jax", workers=1, keep="maps")


@pytest.mark.slow
@pytest.mark.jit
def test_what_is_compared_says_something(want):
    assert {int(o) for outcomes in want.outcomes for o in outcomes.result.outcome} >= {1, 4}
    paths = np.concatenate([outcomes.result.straight for outcomes in want.outcomes])
    assert len(set(paths.tolist())) > 10


@pytest.mark.jit
@pytest.mark.slow
def test_lanes_give_what_one_after_the_other_does(want):
    report = run_jobs(some_jobs(), LIDAR, RULES, engine="jax", in_lanes=True, lanes=7, keep="maps")
    assert_equal(report.outcomes, want.outcomes)
    for job, ours, theirs in zip(some_jobs(), report.outcomes, want.outcomes):
        assert sorted(ours.records) == list(range(5))
        jax.tree.map(np.testing.assert_array_equal, ours.records, theirs.records)
        first, final = ours.records[0], ours.first
        np.testing.assert_array_equal(first.path, np.stack([final.rows, final.cols, final.n_known], axis=1))
        assert first.state.shape == job.world.shape
        np.testing.assert_array_equal(first.state > 0, final.hits + final.misses > 0)
    costs = report.costs
    assert (costs.engine, costs.lanes) == ("jax", 7)
    assert costs.levels == {"closest": ["JAX in lanes"], "closest+recheck": ["JAX in lanes"]}


@pytest.mark.slow
@pytest.mark.jit
def test_programs_that_differ_in_what_is_fixed_are_told_apart_in_one_process(want):
    """Clearance is no array: in one process, lanes must be compiled anew for each."""
    narrow = dataclasses.replace(RULES, clearance_m=0.1)
    assert_equal(run_jobs(some_jobs(), LIDAR, RULES, engine="jax", **WAYS["lanes"]).outcomes, want.outcomes)
    one, lanes = (run_jobs(some_jobs(), LIDAR, narrow, engine="jax", **how) for how in WAYS.values())
    assert_equal(lanes.outcomes, one.outcomes)
    assert one.outcomes[0].result.n_known.tolist() != want.outcomes[0].result.n_known.tolist()


# ---------------------------------------------------------------- runs that end early


@pytest.mark.slow
@pytest.mark.jit
@pytest.mark.parametrize("how", WAYS.values(), ids=WAYS)
def test_a_run_stopped_half_way_keeps_what_is_finished(want, how, monkeypatch):
    monkeypatch.setattr(one_by_one, "CHUNK", 2)
    monkeypatch.setattr(lanes, "FIRST_ITERATIONS", 40)
    monkeypatch.setattr(lanes, "GROWTH", 1)
    seen = []

    def stop(done):
        seen.append(done)
        if done >= 7:
            raise KeyboardInterrupt

    report = run_jobs(some_jobs(), LIDAR, RULES, engine="jax", **how, workers=1, on_progress=stop)
    assert report.costs.interrupted
    assert not want.costs.interrupted
    finished = 0
    for got, whole in zip(report.outcomes, want.outcomes):
        ended = got.result.outcome != Outcome.RUNNING
        finished += int(ended.sum())
        jax.tree.map(lambda a, b, m=ended: np.testing.assert_array_equal(a[m], b[m]), got.result, whole.result)
        assert (got.first is None) == (not ended[0])
        if ended[0]:
            for a, b in zip(got.first._replace(plans=None), whole.first._replace(plans=None)):
                np.testing.assert_array_equal(a, b)
    assert finished >= seen[-1] >= 7
    assert finished < 20


@pytest.mark.jit
@pytest.mark.parametrize("how", WAYS.values(), ids=WAYS)
def test_a_run_stopped_before_anything_is_finished_says_so(how, monkeypatch):
    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(one_by_one, "compile_chunk", stop)
    monkeypatch.setattr(lanes.Group, "run", stop)
    with pytest.raises(KeyboardInterrupt):
        run_jobs(some_jobs(), LIDAR, RULES, engine="jax", **how)


@pytest.mark.jit
def test_memory_that_runs_out_is_an_error_of_its_own(monkeypatch):
    def run(self, n_lanes, costs, tell):
        raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory while trying to allocate 1 bytes.")

    monkeypatch.setattr(lanes.Group, "run", run)
    with pytest.raises(MemoryError, match=r"RESOURCE_EXHAUSTED.*\(fewer lanes need less\)"):
        run_jobs(some_jobs(), LIDAR, RULES, engine="jax", in_lanes=True, lanes=14)


@pytest.mark.jit
def test_lanes_fit_the_memory(monkeypatch):
    job = some_jobs()[0]
    site = prepare_site(job.world, LIDAR, RULES)
    line = line_of(site, site.with_strategy(job.strategy), np.zeros((9999, 3)), 0, np.arange(9999))
    group = lanes.Group([line], jax.local_devices()[0])

    class Device:
        platform = "gpu"

        def __init__(self, free):
            self.free = free

        def memory_stats(self):
            return {"bytes_limit": self.free + 5, "bytes_in_use": 5}

    def fitting(free):
        group.device = Device(free)
        return group.fitting_lanes()

    few, many = fitting(2**30), fitting(2**40)
    assert many == lanes.LANES
    assert 100 < few < many
    assert few & (few - 1) == 0
    line.which = line.which[:20]
    group = lanes.Group([line], jax.local_devices()[0])
    assert fitting(2**40) == 20


class Accelerator:
    platform = "gpu"


def test_beside_an_accelerator_auto_has_the_cpu_and_jax_has_lanes(monkeypatch):
    found = jax.local_devices
    monkeypatch.setattr(jax, "local_devices", lambda backend=None: found(backend="cpu") if backend else [Accelerator()])
    monkeypatch.setattr(runner, "own_cores", lambda: 2)
    for how in ({"engine": "jax"}, {"engine": "jax", "lanes": 1}, {"in_lanes": True}):
        resources = runner.find_resources(**how)
        assert resources.in_lanes
        assert isinstance(resources.device, Accelerator)
    for how in ({}, {"workers": 2}, {"in_lanes": False}, {"engine": "jax", "in_lanes": False}):
        resources = runner.find_resources(**how)
        assert (resources.in_lanes, resources.device) == (False, found(backend="cpu")[0])


def test_where_jax_has_no_cpu_all_runs_are_in_lanes(monkeypatch):
    """As with JAX_PLATFORMS=cuda."""

    def devices_of(backend=None):
        if backend:
            raise RuntimeError(f"Unknown backend {backend}")
        return [Accelerator()]

    monkeypatch.setattr(jax, "local_devices", devices_of)
    for how in ({}, {"workers": 96}, {"engine": "jax"}):
        assert runner.find_resources(**how).in_lanes
    with pytest.raises(
        InputError, match=r"^JAX_PLATFORMS must list cpu, where runs are made one after the other, got "
    ):
        runner.find_resources(in_lanes=False)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"engine": "warp"}, "engine must be one of auto, jax, got 'warp'"),
        ({"engine": None}, "engine must be one of auto, jax, got None"),
        ({"lanes": 4}, "lanes are for the engine jax, got 4 for auto"),
        ({"engine": "jax", "lanes": 4}, "lanes are for a GPU, got 4 on a CPU"),
        ({"lanes": 0}, "lanes must be an integer from 1 to 1048576, got 0"),
        ({"workers": -1}, "workers must be an integer from 1 to 1024, got -1"),
    ],
)
def test_engines_that_do_not_exist_are_refused(options, says):
    refused(says, run_jobs, some_jobs(), LIDAR, RULES, **options)


@pytest.mark.parametrize(
    "ask",
    [
        lambda how: jx.compare("nowhere", ["closest"], **how),
        lambda how: jx.sweep("nowhere.yaml", **how),
        lambda how: jx.reproduce("holz2010", maps="nowhere", **how),
        lambda how: jx.btm.trace("nowhere", **how),
    ],
)
def test_engines_are_checked_before_anything_is_read(ask):
    for name in ("serial", "lockstep", "native"):
        refused(rf"^engine must be one of auto, jax, got '{name}'$", ask, {"engine": name})
    refused(r"^lanes are for the engine jax, got 4 for auto$", ask, {"lanes": 4})
