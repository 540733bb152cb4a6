"""Whole episodes in native code: as a GPU runs them, replays, broken builds; `test_fuzz` has their bits."""

import ctypes
import dataclasses
import subprocess
import sys
import threading
import types
from pathlib import Path

import jax
import numpy as np
import pytest
from ref import fuzz, native

import jexplore as jx
from jexplore.config import InputWarning
from jexplore.engine.runner import on_cores, run_all
from jexplore.exploration import native as runs
from jexplore.exploration.batch import Job, run_jobs
from jexplore.native import build, episodes, gpu
from jexplore.policies import parse_strategy
from jexplore.rules import Lidar, Rules
from jexplore.studies import replays
from jexplore.worlds.starts import draw_starts
from jexplore.worlds.world import World

needs_compiler = pytest.mark.skipif(not build.find_compiler(), reason="no C++ compiler")
LIDAR, RULES = Lidar(n_beams=37, range_m=2.0), Rules()
ROOMS = "rooms:width_m=6,height_m=5"


def job_of(name, n=4, world=ROOMS, seed=3):
    world = jx.load_world(world) if isinstance(world, str) else world
    return Job(world, parse_strategy(name), draw_starts(world, 5, n, RULES.clearance_m), seed=seed)


def assert_equal(one, other):
    jax.tree.map(np.testing.assert_array_equal, one, other)


@needs_compiler
@pytest.mark.parametrize("name", ["closest", "random"])
def test_waves_of_an_open_map_find_room_beyond_shared_memory(name):
    occupied = np.pad(np.zeros((500, 500), bool), 1, constant_values=True)
    world, strategy = World(occupied=occupied, cell_m=0.05, name="hall"), parse_strategy(name)
    place = runs.native_place(episodes.load_episodes(emulator=True).loaded, world, strategy, Lidar(), Rules())
    run = runs.NativeRun(place, np.array([[250, 250, 0]]), 1, 0, np.zeros(1, int))
    run_all([run], on_cores(1))
    np.testing.assert_array_equal(place.inner.emulate(run.tasks, views=False), run.table)


@needs_compiler
def test_a_map_from_the_beginning_is_for_a_cpu():
    world = jx.load_world(ROOMS)
    known = np.where(np.arange(world.shape[1]) < 5, world.occupied, -1).astype(np.int8)
    loaded, world = episodes.load_episodes(emulator=True).loaded, world.replace(known=known)
    place = runs.native_place(loaded, world, parse_strategy("closest"), LIDAR, RULES).inner
    tasks = place.tasks(np.array([[3, 3, 0]]), 0, np.zeros(1, np.int32))
    assert place.emulate(tasks, views=False) is None


@pytest.mark.slow
@needs_compiler
@pytest.mark.jit
def test_a_gpu_runs_what_it_can_and_the_cpu_the_rest(monkeypatch):
    """The GPU by emulation, which gives up one episode; episode 0 is kept whole, by the CPU."""
    asked = []

    def play(loaded, spec, given, tasks, stop):
        place = episodes.World(episodes.load_episodes(emulator=True).loaded, spec, given)
        own = np.concatenate([place.tasks(t["start"][None], t["seed"], t["draw"][None]) for t in tasks])
        results = place.emulate(own, views=False)
        results[2] = 0
        asked.append(len(tasks))
        return gpu.Played(results, gpu.Measured())

    job = job_of("random", 12)
    monkeypatch.setattr(runs, "GPU_FROM", 10)
    monkeypatch.setattr(gpu, "device_count", lambda: 1)
    monkeypatch.setattr(gpu, "load_gpu", lambda: build.Library(ctypes.CDLL(None)))
    monkeypatch.setattr(gpu, "play", play)
    report = run_jobs([job], LIDAR, RULES)
    ours = report.outcomes[0]
    assert asked == [11]
    assert report.costs.levels == {"random": ["native on a CPU", "native on a GPU"]}
    theirs = run_jobs([job], LIDAR, RULES, engine="jax").outcomes[0]
    assert_equal(dataclasses.asdict(ours.result), dataclasses.asdict(theirs.result))
    np.testing.assert_array_equal(ours.first.hits, theirs.first.hits)


def test_a_gpu_that_jax_is_not_to_use_is_not_used(monkeypatch):
    def count(n):
        n._obj.value = 2
        return 0

    driver = types.SimpleNamespace(cuInit=lambda _: 0, cuDeviceGetCount=count)
    monkeypatch.setattr(gpu.ctypes, "CDLL", lambda _: driver)
    for platforms, n in ((None, 2), ("cpu", 0), ("cuda,cpu", 2), ("cpu,gpu", 2)):
        with monkeypatch.context() as patch:
            patch.setattr(gpu.jax, "config", types.SimpleNamespace(values={"jax_platforms": platforms}))
            found = gpu.device_count()
        assert found == n


@pytest.mark.slow
@needs_compiler
@pytest.mark.skipif(not native.sanitized_environment(), reason="the compiler has no libasan.so and libstdc++.so")
def test_sanitizers_find_nothing():
    """Twice each kind of case: counting and not, by warps, shown once more."""
    fuzz_py = Path(__file__).parents[1] / "benchmarks" / "fuzz.py"
    options = f"--alone --sanitize --seed 7 --cases {2 * len(fuzz.EXACT)}"
    command = [sys.executable, str(fuzz_py), *options.split()]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr


# ---------------------------------------------------------------- replays


@needs_compiler
@pytest.mark.jit
@pytest.mark.parametrize(
    "name", ["closest+recheck", pytest.param("gain-rate+recheck:samples=60", marks=pytest.mark.slow), "random"]
)
def test_a_replay_shows_what_jax_does(name, monkeypatch):
    """Of a strategy with view points as well, whose choices are on the record."""
    job = job_of(name, 1)
    final = run_jobs([job], LIDAR, RULES).outcomes[0].first
    how = {"start": tuple(job.starts[0].tolist()), "seed": job.seed, "number": 0, "lidar": LIDAR, "rules": RULES}
    ours = replays.replay_data(job.world, job.strategy, final, **how)
    monkeypatch.setattr(replays, "show_episode", lambda *args: pytest.fail("native code was called"))
    theirs = replays.replay_data(job.world, job.strategy, final, **how, engine="jax")
    assert_equal(*(jax.tree.leaves(data.changes) for data in (ours, theirs)))
    np.testing.assert_array_equal(ours.heading_deg, theirs.heading_deg)


# ---------------------------------------------------------------- building, interrupting


@pytest.mark.slow
@pytest.mark.usefixtures("forgetful")
@pytest.mark.jit
def test_without_a_compiler_jax_runs_and_says_so_once(monkeypatch, tmp_path):
    job = job_of("closest", 2)
    want = run_jobs([job], LIDAR, RULES, engine="jax").outcomes[0].result
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CXX", raising=False)
    build.told.cache_clear()
    with pytest.warns(InputWarning, match=r"^no C\+\+ compiler was found") as told:
        report = run_jobs([job], LIDAR, RULES)
    assert len(told) == 1
    assert report.costs.levels == {"closest": ["JAX"]}
    assert [line.partition(":")[0] for line in report.costs.why_not] == ["no C++ compiler was found"]
    assert_equal(dataclasses.asdict(report.outcomes[0].result), dataclasses.asdict(want))


@needs_compiler
@pytest.mark.jit
def test_an_interruption_keeps_what_has_ended(monkeypatch):
    """Ctrl-C while native code runs: the calls under way return at once, and what had ended is there."""
    job, interrupted = job_of("random", 2000, world="office"), threading.Event()

    def on_progress(done):
        if done > 3 and not interrupted.is_set():
            interrupted.set()
            raise KeyboardInterrupt

    found = run_jobs([job], Lidar(), RULES, workers=1, on_progress=on_progress)
    assert found.costs.interrupted
    ended = found.outcomes[0].result.outcome != 0
    assert 3 < ended.sum() < 2000
    again = run_jobs([job._replace(starts=job.starts[:1])], Lidar(), RULES).outcomes[0].result
    assert again.n_known[0] == found.outcomes[0].result.n_known[0]


def test_a_strategy_or_scanner_of_which_there_is_none():
    assert runs.is_native(parse_strategy("closest"), LIDAR, Rules())
    assert not runs.is_native(parse_strategy("gain-rate"), LIDAR, Rules())
    assert not runs.is_native(parse_strategy("closest+segment"), LIDAR, Rules())
    assert not runs.is_native(parse_strategy("closest"), dataclasses.replace(LIDAR, dropout=0.1), Rules())
    assert not runs.is_native(parse_strategy("closest"), LIDAR, Rules(pose="icp"))
