"""Any program one by one and in lanes: walks of random steps that stop to decide, in scenes, with shared weights."""

import re
import runpy
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct
from jax import Array

from jexplore.engine.lanes import Group
from jexplore.engine.program import Line, Program, given_of
from jexplore.engine.runner import find_resources, run_all

pytestmark = pytest.mark.jit

ROOM = 2000  # a large array


class Setup(NamedTuple):
    stride: int


@struct.dataclass
class Walk:
    at: Array
    n: Array
    left: Array  # steps until it must decide
    decisions: Array
    way: Array  # [ROOM], the place after every step


def begin(setup, given):
    zero = jnp.int32(0)
    return Walk(given.task, zero, zero, zero, jnp.zeros(ROOM, jnp.int32))


def advance(setup, given, state):
    key = jax.random.fold_in(given.key, state.n)
    walls = given.own_scene
    at = jnp.clip(state.at + setup.stride * jax.random.rademacher(key, (), jnp.int32), walls[0], walls[1])
    done = is_done(state) | must_decide(state)
    way = state.way.at[jnp.where(done, ROOM, state.n)].set(at, mode="drop")
    return state.replace(at=at, n=state.n + 1, left=state.left - 1, way=way)


def decide(setup, given, state):
    drawn = jax.random.randint(jax.random.fold_in(given.key, 10_000 + state.n), (), 1, 9)
    more = given.numbers["weights"][state.at % 4] + given.numbers["bonus"]
    return state.replace(left=drawn + more, decisions=state.decisions + 1)


def is_done(state):
    return state.n >= 40 + state.decisions


def must_decide(state):
    return state.left <= 0


def finish(setup, given, state):
    return {"at": state.at, "n": state.n, "decisions": state.decisions}


LANES = {"engine": "jax", "in_lanes": True}
WALKS = Program(Setup(2), begin, advance, is_done, finish, lambda state: state.way, decide, must_decide)


def some_lines(program=WALKS):
    """Two scenes, two bonuses, and one line with other weights."""
    shared, lines = {"unused": np.zeros(3, np.float32)}, []
    scenes = [np.array([-50, 50], np.int32), np.array([-4, 4], np.int32)]
    for i, (scene, bonus, weights) in enumerate([(0, 0, [1, 2, 3, 4]), (1, 5, [1, 2, 3, 4]), (0, 0, [7, 7, 7, 7])]):
        numbers = {"weights": np.array(weights, np.int32), "bonus": np.int32(bonus)}
        tasks = np.arange(10, dtype=np.int32)
        lines.append(Line(program, shared, scenes[scene], numbers, 3 + i, tasks, np.arange(10)))
    return lines


def run(program=WALKS, **how):
    lines = some_lines(program)
    return lines, run_all(lines, find_resources(**how))


def by_hand(line, number):
    """A run in plain Python."""
    given = given_of(line, number)
    state = begin(WALKS.setup, given)
    while not is_done(state):
        state = decide(WALKS.setup, given, state) if must_decide(state) else advance(WALKS.setup, given, state)
    return state


@pytest.mark.parametrize("how", [{"workers": 1}, {"workers": 2}, LANES | {"lanes": 4}, LANES | {"lanes": 64}])
def test_runs_are_those_that_a_loop_makes(how):
    lines, _ = run(**how)
    for line in lines:
        assert line.finished.all()
        for number in (0, 7):
            state = by_hand(line, number)
            assert {name: int(a[number]) for name, a in line.results.items()} == {
                name: int(a) for name, a in finish(WALKS.setup, None, state).items()
            }
            if number == 0:
                n = int(state.n)
                np.testing.assert_array_equal(line.detail[:n], state.way[:n])
    assert len({tuple(line.results["at"].tolist()) for line in lines}) == 3


def test_arrays_of_a_run_that_is_done_are_kept():
    """Whatever `advance` would make of them. A run ends in every turn, and waits for another."""
    program = Program(
        None,
        lambda setup, given: {"left": given.task, "log": jnp.zeros(ROOM, jnp.int32)},
        lambda setup, given, state: {"left": state["left"] - 1, "log": state["log"] + 1},
        lambda state: state["left"] <= 0,
        lambda setup, given, state: {"least": state["log"].min(), "most": state["log"].max()},
        lambda state: state["log"],
    )
    tasks = np.random.default_rng(0).permutation(32).astype(np.int32)
    for how in ({"workers": 1}, LANES | {"lanes": 32}):
        line = Line(program, (), np.zeros(1), (), 0, tasks, np.arange(len(tasks)))
        run_all([line], find_resources(**how))
        for found in line.results.values():
            assert (found == tasks).all()
        assert (line.detail == tasks[0]).all()


def test_what_lanes_share_is_not_gathered():
    lines = some_lines()[:2]
    with jax.disable_jit(False):
        group = Group(lines, jax.local_devices()[0])
        lanes = jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), group._shapes(8))
        runs = jax.tree.map(lambda a: a[:1], group.runs)
        text = str(
            jax.make_jaxpr(lambda lanes: group.step(lanes, np.zeros(1, int), runs, True, 9, group.common))(lanes)
        )
    assert not re.search(r"i32\[[128],4\]", text)  # the weights of some lanes, or of all


def test_the_program_of_the_examples_runs_on_cores_and_in_lanes():
    line = runpy.run_path(str(Path(__file__).resolve().parents[1] / "examples" / "program.py"))["line"]
    run_all([line], find_resources())
    results, line.results = line.results, None
    line.finished[:] = False
    run_all([line], find_resources(**LANES, lanes=7))
    np.testing.assert_array_equal(line.results, results)
    assert len(set(results.tolist())) > 5
