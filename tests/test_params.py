"""The robot's numbers as one tree: constants by default, leaves of a program where a sweep varies any."""

import dataclasses
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import jaxpr_as_fun
from ref.refusals import refused

from jexplore.driving.params.groups import Params, default_numbers
from jexplore.driving.params.tree import P, params_with, using
from jexplore.studies.traces import job
from jexplore.studies.traces.options import swept_values


def changed(**numbers):
    return Params().replace(graph=Params().graph.replace(**numbers))


def test_code_reads_the_tree_in_scope():
    assert P.graph.search_every_steps == 3
    with using(changed(search_every_steps=5)):
        assert P.graph.search_every_steps == 5
        with using(None):
            assert P.graph.search_every_steps == 3
    assert P.graph.search_every_steps == 3


def test_a_leaf_is_no_constant_of_the_program():
    def read(params):
        with using(params):
            return jnp.float32(P.graph.same_node_m) + P.graph.search_every_steps

    assert read(None) == pytest.approx(4.0)
    program = jaxpr_as_fun(jax.make_jaxpr(read)(Params()))
    found = [
        program(*jax.tree.leaves(changed(same_node_m=m, search_every_steps=n)))[0] for m, n in ((0.5, 3), (1.0, 4))
    ]
    assert [float(m) for m in found] == [3.5, 5.0]


def test_numbers_are_told_by_their_names():
    numbers = default_numbers()
    assert numbers["graph.search_every_steps"] == 3
    assert [numbers[f"graph.beyond_opening_m.{i}"] for i in (0, 1)] == [0.05, 1.0]
    assert list(numbers.values()) == jax.tree.leaves(Params())
    assert params_with({}, 2) is None
    found = params_with(
        {"graph.beyond_opening_m.1": np.array([1.0, 2.0]), "graph.search_every_steps": np.array([1.0, 4.0])}, 2
    )
    assert found.graph.beyond_opening_m[1].tolist() == [1, 2]
    assert (found.graph.search_every_steps.tolist(), found.graph.search_every_steps.dtype) == ([1, 4], np.int32)
    assert found.graph.blind_steps.tolist() == [20, 20]
    for leaf, number in zip(jax.tree.leaves(found), numbers.values()):
        assert leaf.dtype == (np.int32 if isinstance(number, int) else np.float32)


def test_a_sweep_names_numbers():
    assert swept_values(["graph.search_every_steps=1,3"], 1, 0)["graph.search_every_steps"].tolist() == [1, 3]
    assert swept_values(["graph.search_every_steps=1:6"], 4, 0)["graph.search_every_steps"].tolist() == [1, 4, 3, 6]
    plan = job.prepare_trace("course", sweep=["graph.search_every_steps=1,3", "votes=3"])
    settings = plan.settings_of(np.arange(2)), plan.params_of(np.arange(2))
    assert (settings[0][1].votes.tolist(), settings[1].graph.search_every_steps.tolist()) == ([3, 3], [1, 3])
    assert dataclasses.replace(plan, swept={}).params_of(np.arange(2)) is None


@pytest.mark.parametrize(
    ("sweep", "says"),
    [
        ("graph.max_trys=1", "there are .* the numbers of jx.btm.Params"),
        (
            "graph.search_every_steps=0",
            "sweep of graph.search_every_steps must be a number at least 1 and at most 300, got 0",
        ),
        ("graph.search_every_steps=1.5", "graph.search_every_steps must be integers"),
        ("graph.same_node_m=-1", "sweep of graph.same_node_m must be a number at least 0 and at most 100"),
        ("graph.same_node_m=nan,1", "sweep of graph.same_node_m must be"),
        ("graph.same_node_m=0:inf", "sweep of graph.same_node_m must be"),
    ],
)
def test_numbers_that_no_robot_has_are_refused(sweep, says):
    refused(says, swept_values, [sweep], 4, 0)


def test_every_number_is_read():
    driving = Path(__file__).resolve().parents[1] / "jexplore" / "driving"
    read = set(re.findall(r"\bP\.(\w+\.\w+)", "".join(path.read_text() for path in driving.rglob("*.py"))))
    assert read == {re.match(r"\w+\.\w+", name)[0] for name in default_numbers()}  # type: ignore[index]
