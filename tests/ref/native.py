"""Episodes in native code compared with those of the JAX program, and with each other."""

import dataclasses
import os
import subprocess

import jax
import numpy as np

from jexplore.engine.runner import on_cores, run_all
from jexplore.exploration.native import NativeRun, native_place, result_of, show_episode
from jexplore.exploration.state import Result
from jexplore.exploration.trail import decode, detail_of
from jexplore.native import build, episodes
from jexplore.policies import parse_strategy
from jexplore.worlds.world import World

from .episodes import CAPACITY


def play(case, loaded=None):
    """A `NativeRun` of one episode: the case of `fuzz`, with the draws of `episodes.key_of`."""
    loaded = loaded or episodes.load_episodes(emulator=True).loaded
    world = World(occupied=case.occupied, rooms=case.rooms, cell_m=case.cell_m, within=case.within, known=case.known)
    limits = {name: getattr(case.rules, name) or CAPACITY for name in ("max_steps", "max_plans")}
    rules, strategy = dataclasses.replace(case.rules, **limits), parse_strategy(case.strategy)
    place = native_place(loaded, world, strategy, case.lidar, rules, case.robot)
    run = NativeRun(place, np.array([case.start]), case.seed, 0, np.zeros(1, int), detailed=0, keep="maps")
    run_all([run], on_cores(1))
    return run


def differences(run, result, state, occupied):
    """List all in which a `NativeRun` of one episode, also as warps play it, differs from JAX's `(Result, State)`."""
    found, final = jax.tree.map(lambda a: a[0], run.results), decode(detail_of(state), result, occupied.shape)
    pairs = {
        field.name: (getattr(found, field.name), getattr(result, field.name)) for field in dataclasses.fields(Result)
    }
    pairs |= {name: (getattr(run.final, name), getattr(final, name)) for name in final._fields if name != "plans"}
    unequal = [f"native {name}: {a}, in JAX {b}" for name, (a, b) in pairs.items() if not np.array_equal(a, b)]
    if final.plans is not None and run.final.plans != final.plans:
        unequal.append("native plans")
    grid = state.belief.grid
    free = grid.hits.astype(np.float32) <= state.belief.model.p_free * (grid.hits + grid.misses).astype(np.float32)
    seen = np.where(grid.hits + grid.misses == 0, 0, np.where(free, 1, 2))[: occupied.shape[0], : occupied.shape[1]]
    if not np.array_equal(run.records[0].state, seen):
        unequal.append("native map")
    return unequal + _differences_by_warps(run)


def _differences_by_warps(run):
    """List results of emulated warps that differ; an episode that they give up is for the CPU."""
    found = {
        "beams": run.place.inner.emulate(run.tasks, views=False),
        "views": run.place.inner.emulate(run.tasks, views=True),
    }
    gave_up = {name for name, table in found.items() if table is None or not result_of(table).outcome[0]}
    return [
        f"a warp's result by {name}" for name in found.keys() - gave_up if not np.array_equal(found[name], run.table)
    ]


def differences_among(case):
    """Play a case without counts, by warps and from its record: `(run, differences from that NativeRun)`."""
    run = play(case)
    unequal, record = _differences_by_warps(run), run.records[0]
    three = run.place.inner.play(np.repeat(run.tasks, 3), np.zeros(1, np.int32), paths=True, states=True, whole=1)
    for results, path, state in zip(three.results, three.paths, three.states):
        if not (np.array_equal(results, run.table[0]) and np.array_equal(path, three.paths[1])):
            unequal.append("one of three episodes")
        if not np.array_equal(state, three.states[1]):
            unequal.append("one of three maps")
    shown, strategy = np.arange(0, len(record.path), max(len(record.path) // 10, 1)), parse_strategy(case.strategy)
    shown = np.unique([*shown, len(record.path) - 1])
    codes, _ = show_episode(run.place.world, strategy, case.lidar, case.rules, case.start, run.final, shown, 4)
    if not np.array_equal(codes[-1] & 3, record.state):
        unequal.append("the last map of a replay")
    return run, unequal


# ---------------------------------------------------------------- sanitizers

# Quick to build: a third of the time that -O2 takes.
SANITIZED = ("-O1", "-fno-inline", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-D_GLIBCXX_ASSERTIONS")


def sanitized_environment():
    """Return the environment of a process that loads libraries built with `SANITIZED`; None: the compiler lacks it."""
    compiler = build.find_compiler()

    def path_of(name):
        asked = [*compiler, f"-print-file-name={name}"]
        found = subprocess.run(asked, capture_output=True, text=True, check=False).stdout.strip() if compiler else ""
        return found if os.path.isabs(found) else None

    libraries = path_of("libasan.so"), path_of("libstdc++.so")  # loaded first: ASan looks for exceptions there
    return (
        None
        if None in libraries
        else os.environ | {"LD_PRELOAD": ":".join(libraries), "ASAN_OPTIONS": "detect_leaks=0"}
    )
