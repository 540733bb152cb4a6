"""One result, whichever way episodes run: engines, batch sizes, kernels, devices, processes; runs that end early."""

import hashlib
import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref import maps

from jexplore.config import InputError, Lidar, Rules
from jexplore.engine import lanes, lockstep, serial
from jexplore.exploration import batch
from jexplore.exploration.batch import Job
from jexplore.exploration.episode import Outcome
from jexplore.exploration.site import Kernels, line_of, prepare
from jexplore.policies import parse_strategy
from jexplore.worlds.world import World, draw_starts

RULES = Rules(max_plans=12)
LIDAR = Lidar(n_beams=37, range_m=2.0, sigma_m=0.03, dropout=0.02)
LANES = {"serial": None, "lockstep": 3}
TESTS = Path(__file__).resolve().parent


def some_jobs(strategies=("closest", "closest+recheck")):
    """Two worlds of one padded size, five starts each, a noisy scanner."""
    jobs = []
    for seed, shape in ((1, (40, 44)), (2, (50, 36))):
        occupied, rooms = maps.cluttered(seed, *shape)
        world = World(occupied=occupied, rooms=rooms, name=f"cluttered {seed}")
        starts = draw_starts(world, 5, 5, RULES.clearance_m)
        jobs += [Job(world, parse_strategy(name), starts, seed=7) for name in strategies]
    return jobs


def digest(report):
    """A number that differs if any bit of any result, last map or way does."""
    arrays = [a for o in report.outcomes for a in (*jax.tree.leaves(o.result), *o.first)]
    return hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in arrays)).hexdigest()


def assert_equal(got, want):
    for ours, theirs in zip(got.outcomes, want.outcomes, strict=True):
        jax.tree.map(np.testing.assert_array_equal, ours.result, theirs.result)
        for a, b in zip(ours.first, theirs.first, strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.fixture(scope="module")
def want(jit_on):
    """The jobs, one after the other."""
    with jit_on():
        return batch.run(some_jobs(), LIDAR, RULES, engine="serial", workers=1)


@pytest.mark.jit
def test_what_is_compared_says_something(want):
    assert {int(o) for outcomes in want.outcomes for o in outcomes.result.outcome} >= {1, 4}
    paths = np.concatenate([outcomes.result.straight for outcomes in want.outcomes])
    assert len(set(paths.tolist())) > 10


@pytest.mark.jit
@pytest.mark.parametrize("n_lanes", [7, 64])
def test_lanes_in_lockstep_give_what_one_after_the_other_does(want, n_lanes):
    report = batch.run(some_jobs(), LIDAR, RULES, engine="lockstep", lanes=n_lanes)
    assert_equal(report, want)
    assert (report.engine, report.devices, report.lanes) == ("lockstep", 1, min(n_lanes, 20))
    assert 0 < report.useful <= 1
    assert 0 < report.useful_plans <= 1
    if n_lanes == 1:
        assert report.useful_plans == 1


@pytest.mark.jit
@pytest.mark.parametrize("size", [7])
def test_calls_of_any_size_give_the_same(want, size, monkeypatch):
    monkeypatch.setattr(serial, "CHUNK", size)
    assert_equal(batch.run(some_jobs(), LIDAR, RULES, engine="serial", workers=2), want)


@pytest.mark.jit
@pytest.mark.parametrize(
    ("engine", "kernels"), [("serial", Kernels("wave", "whole")), ("lockstep", Kernels("sweeps", "blocks"))]
)
def test_kernels_give_the_same_in_either_engine(want, engine, kernels):
    assert_equal(batch.run(some_jobs(), LIDAR, RULES, engine=engine, kernels=kernels), want)


@pytest.mark.jit
def test_a_strategy_that_draws_looks_ahead_and_divides_the_map_gives_the_same_in_both_engines():
    occupied, rooms = maps.cluttered(1, 32, 36)
    world = World(occupied=occupied, rooms=rooms, name="cluttered")
    strategy = parse_strategy("decision-theoretic+recheck+segment=auto:samples=20")
    jobs = [Job(world, strategy, draw_starts(world, 4, 5, RULES.clearance_m), seed=7)]
    both = [batch.run(jobs, LIDAR, RULES, engine=engine) for engine in ("serial", "lockstep")]
    assert_equal(*both)
    assert both[0].outcomes[0].result.plans.max() > 1


# ---------------------------------------------------------------- devices and processes

CHILD = """
import sys
import jax
setting = sys.argv[2]
if setting.startswith("devices"):
    jax.config.update("jax_num_cpu_devices", int(setting[7:]))
else:
    port, process = setting.split(",")
    jax.distributed.initialize(f"127.0.0.1:{port}", 2, int(process))
sys.path.insert(0, sys.argv[1])
import json
import test_engines as t
found = []
for engine in sys.argv[3:]:
    report = t.batch.run(t.some_jobs(), t.LIDAR, t.RULES, engine=engine, lanes=3 if engine == "lockstep" else None)
    found.append([engine, report.devices, t.digest(report)])
print(json.dumps(found))
"""


def child(setting, *engines):
    return subprocess.Popen(
        [sys.executable, "-c", CHILD, str(TESTS), setting, *engines],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ, "JAX_PLATFORMS": "cpu"},
    )  # fmt: skip


def answer(process):
    out, err = process.communicate(timeout=600)
    assert process.returncode == 0, err
    return json.loads(out.splitlines()[-1])


@pytest.mark.jit
@pytest.mark.parametrize("n", [4])
def test_devices_share_the_work_and_change_nothing(want, n):
    found = answer(child(f"devices{n}", "serial", "lockstep"))
    assert found == [["serial", n, digest(want)], ["lockstep", n, digest(want)]]


@pytest.mark.jit
def test_processes_share_the_work_and_all_have_all_of_it(want):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    both = [child(f"{port},{i}", "serial") for i in range(2)]
    assert [answer(process) for process in both] == [[["serial", 2, digest(want)]]] * 2


# ---------------------------------------------------------------- runs that end early


@pytest.mark.jit
@pytest.mark.parametrize("engine", ["serial", "lockstep"])
def test_a_run_stopped_half_way_keeps_what_is_finished(want, engine, monkeypatch):
    monkeypatch.setattr(serial, "CHUNK", 2)
    monkeypatch.setattr(lockstep, "FIRST_TURNS", 40)
    monkeypatch.setattr(lockstep, "GROWTH", 1)
    seen = []

    def stop(done):
        seen.append(done)
        if done >= 7:
            raise KeyboardInterrupt

    report = batch.run(some_jobs(), LIDAR, RULES, engine=engine, lanes=LANES[engine], workers=1, on_progress=stop)
    assert report.interrupted
    assert not want.interrupted
    finished = 0
    for got, whole in zip(report.outcomes, want.outcomes):
        ended = got.result.outcome != Outcome.RUNNING
        finished += int(ended.sum())
        jax.tree.map(lambda a, b, m=ended: np.testing.assert_array_equal(a[m], b[m]), got.result, whole.result)
        assert (got.first is None) == (not ended[0])
        if ended[0]:
            for a, b in zip(got.first, whole.first):
                np.testing.assert_array_equal(a, b)
    assert finished >= seen[-1] >= 7
    assert finished < 20


@pytest.mark.jit
@pytest.mark.parametrize("engine", ["serial", "lockstep"])
def test_a_run_stopped_before_anything_is_finished_says_so(engine, monkeypatch):
    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(serial, "_compile", stop)
    monkeypatch.setattr(lockstep._Group, "run", stop)
    with pytest.raises(KeyboardInterrupt):
        batch.run(some_jobs(), LIDAR, RULES, engine=engine)


@pytest.mark.jit
def test_memory_that_runs_out_halves_the_lanes_once(want, monkeypatch):
    whole_run, tried = lockstep._Group.run, []

    def run(self, n_lanes, tally, on_progress):
        tried.append(n_lanes)
        if n_lanes > 7:
            raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory while trying to allocate 1 bytes.")
        return whole_run(self, n_lanes, tally, on_progress)

    monkeypatch.setattr(lockstep._Group, "run", run)
    with pytest.warns(UserWarning, match="out of device memory with 14 lanes: going on with 7"):
        report = batch.run(some_jobs(), LIDAR, RULES, engine="lockstep", lanes=14)
    assert tried == [14, 7]
    assert_equal(report, want)
    with (
        pytest.warns(UserWarning, match="going on with 9"),
        pytest.raises(MemoryError, match="RESOURCE_EXHAUSTED"),
    ):
        batch.run(some_jobs(), LIDAR, RULES, engine="lockstep", lanes=18)


@pytest.mark.jit
def test_memory_that_runs_out_half_way_costs_nothing_that_was_finished(want, monkeypatch):
    """The call fails after some have succeeded; their results are kept, the rest is run again in fewer lanes."""
    monkeypatch.setattr(lockstep, "FIRST_TURNS", 40)
    monkeypatch.setattr(lockstep, "GROWTH", 1)
    progress = []

    def fail(done):
        progress.append(done)
        if len(progress) == 4:
            raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory")

    with pytest.warns(UserWarning, match="going on with 3"):
        report = batch.run(some_jobs(), LIDAR, RULES, engine="lockstep", lanes=7, on_progress=fail)
    assert_equal(report, want)
    assert progress == sorted(progress)
    assert progress[3] > 0
    assert progress[-1] == 20


@pytest.mark.jit
def test_lanes_fit_the_memory(monkeypatch):
    line = line_of(prepare(some_jobs()[0].world, LIDAR, RULES), parse_strategy("closest"), np.zeros((9999, 3)), 0,
                   Kernels("wave", "whole"), np.arange(9999))  # fmt: skip

    class Device:
        platform = "gpu"

        def __init__(self, free):
            self.free = free

        def memory_stats(self):
            return {"bytes_limit": self.free + 5, "bytes_in_use": 5}

    def fitting(free):
        group = object.__new__(lockstep._Group)
        truth = jax.tree.map(jnp.asarray, line.site.truth)
        table = lanes.Lines(
            np.zeros(1, np.int32), np.zeros(1, np.uint32), jax.tree.map(lambda a: a[None], line.numbers)
        )
        group.lines, group.devices, group.setup = [line], [Device(free)], line.setup
        group.shared = (table, truth, line.site.beams)
        return group.fitting_lanes()

    few, many = fitting(2**30), fitting(2**40)
    assert many == lockstep.LANES
    assert 100 < few < many
    assert few & (few - 1) == 0
    line.which = line.which[:20]
    assert fitting(2**40) == 20


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"engine": "warp"}, "engine must be one of serial, lockstep, got 'warp'"),
        ({"engine": "serial", "lanes": 4}, "lanes are for the engine lockstep, got 4 for serial"),
        ({"lanes": 0}, "lanes must be at least 1, got 0"),
        ({"workers": -1}, "workers must be at least 1, got -1"),
    ],
)
def test_engines_that_do_not_exist_are_refused(options, says):
    with pytest.raises(InputError, match=says):
        batch.run(some_jobs(), LIDAR, RULES, **options)


def test_kernels_that_do_not_exist_are_refused():
    with pytest.raises(InputError, match="kernel reach must be one of sweeps, wave, got 'dijkstra'"):
        Kernels(reach="dijkstra")
    with pytest.raises(InputError, match="kernel scan must be one of blocks, whole, got 'x'"):
        Kernels(scan="x")
