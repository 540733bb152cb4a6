"""Worlds of a user's: registered or named `module:function`, and refused in one line where they are none."""

import itertools

import jax
import numpy as np
import pytest
from ref.refusals import refused

import jexplore as jx
from jexplore import worlds

CODE = """
import numpy as np
import jexplore as jx

def plan(seed, *, cell_m, width_m=4.0, doors=1):
    occupied = np.zeros((round(3 / cell_m), round(width_m / cell_m)), bool)
    occupied[10 + seed % 10, : -6 * doors] = True
    return jx.World(occupied, cell_m=cell_m)
"""


@pytest.fixture
def desk(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(worlds, "_OWN", {})
    (tmp_path / "mine_of_tests.py").write_text(CODE)
    return tmp_path


def hall(seed, length=40):
    occupied = np.zeros((30, length), bool)
    occupied[15, 5 + seed :] = True
    return jx.World(occupied, cell_m=0.2)


def test_a_module_in_the_current_folder_names_a_world(desk):
    world = jx.load_world("mine_of_tests:plan#3:width_m=5,doors=2", cell_m=0.1)
    assert (world.name, world.shape) == ("mine_of_tests:plan#3:width_m=5,doors=2", (30, 50))
    assert world.occupied[13, :38].all()
    assert not world.occupied[13, 38:].any()
    assert jx.load_world("mine_of_tests:plan").occupied[10, 0]
    for wrong, line in (
        ("mine_of_tests:plan:door=2", "there is no parameter 'door'; it takes width_m, doors"),
        ("mine_of_tests:plan:doors=few", "doors must be an integer"),
        ("mine_of_tests:plam", "has no 'plam'"),
        ("nowhere_of_tests:plan", "no module 'nowhere_of_tests'"),
        ("cave:plan", "parameters are written key=value"),
    ):
        refused(line, jx.load_world, wrong)


def test_a_registered_world_is_one_like_the_others(desk, printed):
    jx.register_world("hall", hall)
    world = jx.load_world("hall#4:length=50")
    assert (world.name, world.shape, world.cell_m) == ("hall#4:length=50", (30, 50), 0.2)
    assert world.occupied[15, 9]
    assert not world.occupied[15, 8]
    assert [row[2] for row in jx.worlds().rows if row[0].startswith("hall")] == ["length=40"]
    assert "hall" in printed(["worlds", "hall", "mine_of_tests:plan#1"]).out
    jx.register_world("hall", lambda seed: hall(seed, 60))
    assert jx.load_world("hall").shape == (30, 60)


@pytest.mark.parametrize(
    ("name", "function", "line"),
    [
        ("cave", hall, "the name of a world must be letters, digits, _ and -, and none of cave, "),
        ("a:b", hall, "the name of a world must be"),
        ("hall", 3, r"int \(.*\) is no world: expected a function of a seed.*got 3"),
        ("hall", lambda: hall(0), "is no world: expected a function of a seed"),
        ("hall", lambda seed, size: hall(seed), "others? parameters have defaults, got size"),
        ("hall", lambda seed, **more: hall(seed), r"parameters have defaults, got \*\*more"),
    ],
)
def test_what_is_no_world_function_is_not_registered(desk, name, function, line):
    refused(line, jx.register_world, name, function)
    assert worlds._OWN == {}


def leaking(seed):
    leaked = []
    jax.make_jaxpr(lambda a: leaked.append(a) or a)(np.zeros((9, 9), bool))
    return hall(seed).replace(within=leaked[0])


CALLS = itertools.count()


@pytest.mark.parametrize(
    ("function", "line"),
    [
        (lambda seed: np.zeros((9, 9), bool), "must return a jx.World, got array"),
        (lambda seed: None, "must return a jx.World, got None"),
        (lambda seed: 1 / 0, "raised ZeroDivisionError at .*test_own_worlds.py:"),
        (lambda seed: jx.World(np.ones((9, 9), bool)), "no cell is free"),
        (lambda seed: hall(seed).replace(cell_m=-1.0), "cell_m must be"),
        (lambda seed: hall(next(CALLS)), "two calls with seed 7 differ in occupied$"),
        (lambda seed: hall(seed).replace(cell_m=1.0 + next(CALLS)), "two calls with seed 7 differ in cell_m$"),
        (leaking, "must return a jx.World of arrays: within is a .*Tracer"),
    ],
)
def test_a_wrong_world_is_told_in_one_line_with_its_function(desk, function, line):
    jx.register_world("wrong", function)
    assert "test_own_worlds.py:" in refused(line, jx.compare, "wrong#7", "closest", episodes=1)


@pytest.mark.jit
def test_a_comparison_in_a_world_of_ones_own(desk):
    found = jx.compare("mine_of_tests:plan#2", "closest", episodes=3)
    assert found.episodes["outcome"].tolist() == ["COMPLETE"] * 3
    assert found.episodes["world"].unique().tolist() == ["mine_of_tests:plan#2"]
