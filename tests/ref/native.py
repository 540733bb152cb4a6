"""Episodes in native code compared with those of the JAX program, number by number."""

import dataclasses

import jax
import numpy as np

from jexplore.exploration.native import NativeRun, chooser_of, parts_of, play_all
from jexplore.exploration.state import Result
from jexplore.exploration.trail import decode, kept
from jexplore.native import episodes
from jexplore.policies import parse_strategy
from jexplore.worlds.world import World

from .episodes import CAPACITY


def play(case, loaded=None):
    """A `NativeRun` of one episode: the case of `fuzz`, with the draws of `episodes.key_of`."""
    loaded = loaded or episodes.load().loaded
    world = World(occupied=case.occupied, rooms=case.rooms, cell_m=case.cell_m, within=case.within, known=case.known)
    limits = {name: getattr(case.rules, name) or CAPACITY for name in ("max_steps", "max_plans")}
    rules, strategy = dataclasses.replace(case.rules, **limits), parse_strategy(case.strategy)
    chooser = chooser_of(strategy)
    parts = parts_of(world, chooser, case.lidar, rules, recheck=strategy.recheck)
    run = NativeRun(
        episodes.World(loaded, *parts),
        parts,
        world,
        np.array([case.start]),
        case.seed,
        0,
        np.zeros(1, np.int32),
        0,
        "maps",
    )
    play_all([run], 1, lambda _: None)
    return run


def differences(run, result, state, occupied):
    """Everything in which a `NativeRun` of one episode differs from `(Result, State)` of the JAX program."""
    found, final = jax.tree.map(lambda a: a[0], run.results), decode(kept(state), result, occupied.shape)
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
    return unequal
