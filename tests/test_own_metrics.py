"""Metrics that a user brings: by hand, equal to columns and between engines, refused in one line, resumed."""

import functools
import itertools
import json
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from ref import maps
from ref.refusals import refused
from ref.worlds import two_rooms

import jexplore as jx
from jexplore.cli.main import main
from jexplore.config import InputError
from jexplore.engine.one_by_one import run_one
from jexplore.engine.program import given_of
from jexplore.exploration import batch, metrics
from jexplore.exploration.results import path_m
from jexplore.exploration.site import line_of, prepare_site
from jexplore.policies import strategy
from jexplore.rules import Lidar, Rules
from jexplore.studies.metrics import TAKEN, ready_metrics

LIDAR = Lidar(n_beams=37, range_m=1.0)
MODULE = "def steps(view):\n    return view.steps\n\ndef far(view):\n    return view.path_m\n"


def by_hand(reduce):
    """Columns driven from the start, taken after every motion."""
    return jx.metric(lambda view: view.belief.col - view.belief.start[1], reduce=reduce)


BY_HAND = {
    "moves": jx.metric(lambda view: 1, reduce="sum"),
    **{f"at_{reduce}": by_hand(reduce) for reduce in metrics.REDUCTIONS},
    "unseen": lambda view: jnp.sum(~view.occupied & (view.belief.grid.hits + view.belief.grid.misses == 0)),
    "is_complete": lambda view: view.outcome == jx.Outcome.COMPLETE,
    "rooms": lambda view: jnp.max(view.rooms),
    "metres": lambda view: view.path_m,
}


@pytest.mark.jit
def test_metrics_of_a_corridor_by_hand():
    """Five cells in a row: the robot sees two ahead, drives to the second, and then sees the last."""
    world = jx.World(occupied=maps.walls("#######\n#.....#\n#######"), cell_m=1.0, name="corridor")
    lidar, rules = Lidar(n_beams=4, range_m=2.0), Rules(clearance_m=0.0, near_m=0.0, look_around=False)
    site = prepare_site(world, lidar, rules, world.shape, metrics=tuple(ready_metrics(BY_HAND).values()))
    line = line_of(site, site.with_strategy(strategy("closest+recheck")), [(1, 1, 0)], 0, [0])
    given = jax.tree.map(jnp.asarray, given_of(line))

    @jax.jit
    def ended(given):
        return line.program.finish(line.program.setup, given, run_one(line.program, given))

    result = ended(given)
    cols = np.cumsum([0, *[1] * int(result.straight)])
    assert len(cols) > 2
    want = {"moves": len(cols), "at_mean": np.float32(cols.sum()) / np.float32(len(cols)), "at_sum": cols.sum()}
    want |= {"at_max": cols[-1], "at_min": 0, "at_last": cols[-1]}
    want |= {"unseen": 0, "is_complete": 1, "rooms": -1, "metres": cols[-1]}
    assert {name: value.item() for name, value in zip(BY_HAND, result.metrics)} == want


MEASURED = {
    "straight": lambda view: view.straight,
    "diagonal": lambda view: view.diagonal,
    "own_scans": lambda view: view.scans,
    "own_plans": lambda view: view.plans,
    "metres": lambda view: view.path_m,
    "crowded": jx.metric(lambda view: jnp.mean(view.belief.driven.astype(jnp.float32)), reduce="max"),
    "seen": jx.metric(lambda view: view.n_known, reduce="mean"),
}


@pytest.mark.slow
@pytest.mark.jit
def test_columns_batches_lanes_and_environment_agree_to_the_bit(monkeypatch):
    world, how = two_rooms(), {"seed": 2, "lidar": LIDAR, "metrics": MEASURED}
    found = jx.compare(world, ["closest", "random"], episodes=4, **how)
    table, record = found.episodes, found.record
    assert table["path_m"].tolist() == path_m(table["straight"], table["diagonal"], world.cell_m).tolist()
    np.testing.assert_allclose(table["metres"], table["path_m"], rtol=1e-6)
    assert table["own_scans"].equals(table["scans"])
    assert table["own_plans"].equals(table["plans"])
    assert record["levels"] == {"closest": ["JAX"], "random": ["JAX"]}
    assert record["why_not_native"] == [
        "JAX makes episodes with metrics: straight, diagonal, own_scans, own_plans, metres",
        "JAX drives, for metrics after every motion: crowded, seen",
    ]
    plain = jx.compare(world, ["closest", "random"], episodes=4, seed=2, lidar=LIDAR)
    pd.testing.assert_frame_equal(plain.episodes, table.drop(columns=list(MEASURED)))  # native, with a compiler
    at_end = {name: MEASURED[name] for name in ("straight", "metres")}
    driven = jx.compare(world, ["closest", "random"], episodes=4, **how | {"metrics": at_end})
    assert driven.episodes.equals(table[driven.episodes.columns])
    with monkeypatch.context() as patch:
        patch.setattr(batch, "find_resources", functools.partial(batch.find_resources, in_lanes=True))
        assert jx.compare(world, ["closest", "random"], episodes=4, **how).episodes.equals(table)
    env, closest = jx.Environment(world, lidar=LIDAR, metrics=MEASURED), table[table["strategy"] == "closest"]

    def episode(key, start):
        def decide(carry, _):
            state, view = carry
            cost = jnp.where(view.frontier, view.cost, jnp.iinfo(jnp.int32).max)
            action = jnp.stack(jnp.unravel_index(jnp.argmin(cost), cost.shape))
            state, view, _, _, info = env.step(key, state, action)
            return (state, view), {name: info[name] for name in MEASURED}

        return jax.lax.scan(decide, env.reset(key, start), length=int(closest["plans"].max()))[1]

    keys = jax.vmap(lambda i: jax.random.fold_in(jax.random.key(2), i))(jnp.arange(4))
    starts = jnp.asarray(closest[["start_row", "start_col", "start_heading_deg"]].to_numpy(np.int32))
    info = jax.vmap(episode)(keys, starts)
    for name in MEASURED:
        assert np.asarray(info[name])[:, -1].astype(float).tolist() == closest[name].astype(float).tolist(), name


calls = itertools.count()
kept = []
BAD = {
    "is no metric: expected a function": 5,
    "must return one bool, int32 or float32, got \\[\\d+, \\d+\\] bool": lambda view: view.occupied,
    "must return one bool, int32 or float32, got .* complex64": jx.metric(lambda view: view.path_m * 1j, reduce="max"),
    "must return one bool, int32 or float32, got None": lambda view: None,
    "must return one bool, int32 or float32, got .*int64": lambda view: np.int64(3),
    "is not pure: two calls": lambda view: view.path_m + next(calls),
    "is not pure: it keeps an array": jx.metric(lambda view: kept.append(view.path_m) or view.path_m, reduce="max"),
    "raised AttributeError .*it has belief, occupied, .*, outcome, poses, steps, path_m; the robot": lambda view: (
        view.row
    ),
    "raised TracerBoolConversionError .*jnp.where instead of if": lambda view: 1 if view.path_m > 2 else 0,
}


@pytest.mark.parametrize("says", BAD)
def test_a_bad_metric_is_refused_by_one_line_that_names_it(says, monkeypatch):
    monkeypatch.setattr(batch, "run_all", None)  # nothing runs
    said = refused(says, jx.compare, two_rooms(), "closest", episodes=1, metrics={"mine": BAD[says]})
    assert "<lambda> (" in said or says == "is no metric: expected a function"


def test_a_sum_that_leaves_int32_stays_at_its_limit():
    add, (low, high) = metrics.REDUCTIONS["sum"], (metrics.INT32.min, metrics.INT32.max)
    so_far = jnp.array([high - 1, high - 1, low + 1, 5, high, low], jnp.int32)
    found = add(so_far, jnp.array([1, 9, -2, -7, -3, 4], jnp.int32))
    assert found.tolist() == [high, high, low, -2, high, low]
    assert [metrics.reached_limit(np.asarray(some)) for some in (found, found[3:4])] == [True, False]
    assert add(jnp.float32(3e38), jnp.float32(3e38)) == np.inf


@pytest.mark.slow
@pytest.mark.jit
def test_a_callback_that_raises_is_one_line():
    def fails(x):
        raise ValueError("no such number\nat all")

    def mine(view):
        return jax.pure_callback(fails, jax.ShapeDtypeStruct((), jnp.float32), view.path_m)

    with pytest.raises(InputError, match=r"JAX calls back raised ValueError: no such number at .*metrics\.py:\d+$"):
        jx.compare(two_rooms(), "closest", episodes=1, lidar=LIDAR, metrics={"mine": mine})


def length(view):
    return view.path_m


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"path_m": length}, r"metric length \(.*\): its name must be new, and 'path_m' is in the tables"),
        ({"2nd": jx.metric(length)}, r"metric length \(.*\): its name must be an identifier such as .*, got '2nd'"),
        ({"class": length}, "must be an identifier"),
        ({"_own": length}, "must be an identifier"),
        ([length], "metrics must be a mapping of names to functions"),
        (length, "metrics must be a mapping of names to functions"),
        ("of_tests", "metric 'of_tests' must be module:function, got 'of_tests'"),
        (["json:dumps", "dumps=json:loads"], "metrics must differ, got 'dumps' more than once; name=module:function"),
        ({"mine": "json:nothing"}, "module 'json' has no 'nothing'"),
        ({"mine": "json:decoder"}, "metric 'mine': json:decoder is no function"),
        ({"mine": 3}, "metric 'mine': 3 is no metric: expected a function or module:function"),
    ],
)
def test_names_of_metrics(given, says):
    for read in (
        lambda: jx.compare(two_rooms(), "closest", episodes=1, metrics=given),
        lambda: jx.sweep({"worlds": ["cave"], "metrics": given}),
        lambda: jx.Environment(two_rooms(), metrics=given),
    ):
        refused(says, read)
    assert {"path_m", "mean", "valid"} < TAKEN


def test_words_of_a_metric():
    refused("did you mean 'mean'", jx.metric, length, reduce="men")
    assert jx.metric(reduce="max")(length).reduce == "max"


@pytest.fixture
def module(tmp_path, monkeypatch):
    """A folder with a module of metrics, in which we are."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "metrics_of_tests.py").write_text(MODULE)
    yield tmp_path
    sys.modules.pop("metrics_of_tests", None)


@pytest.mark.slow
@pytest.mark.jit
def test_the_command_a_changed_function_and_more_episodes(module, printed):
    command = ["compare", "--worlds", "rooms:width_m=6,height_m=5", "--strategies", "closest", "random", "--out", "run"]
    command += ["--metric", "metrics_of_tests:steps", "metres=metrics_of_tests:far", "--resume", "--episodes"]
    refused("'steps' is in the tables", jx.compare, "cave", "closest", metrics="metrics_of_tests:steps")
    command[command.index("metrics_of_tests:steps")] = "moves=metrics_of_tests:steps"
    assert " moves " in printed([*command, "2"]).out
    first = jx.load("run")
    assert first.metrics == ("moves", "metres")
    assert first.episodes["moves"].tolist() == first.episodes["steps"].tolist()
    (module / "metrics_of_tests.py").write_text(MODULE.replace("view.path_m", "view.path_m + 1"))
    assert "holds another run: its metric 'metres' computes something else now" in printed([*command, "3"], 2).err
    (module / "metrics_of_tests.py").write_text(MODULE + "# the same\n")
    assert main([*command, "3"]) == 0
    grown = jx.load("run")
    assert grown.episodes["moves"].tolist() == grown.episodes["steps"].tolist()
    assert json.loads((module / "run" / "run.json").read_text())["resumed"] == 4
    assert "moves" in (module / "run" / "report.html").read_text()
    command[command.index("moves=metrics_of_tests:steps")] = "turns=metrics_of_tests:steps"
    assert 'holds another run: its metrics, turns: is null, not "end"' in printed([*command, "3"], 2).err


@pytest.mark.slow
@pytest.mark.jit
def test_a_sweep_has_metrics_in_python_and_from_a_file(module):
    spec = {"worlds": ["rooms:width_m=6,height_m=5"], "strategies": ["closest", "random"], "episodes": 2}
    spec |= {"rules": {"clearance_m": [0.15, 0.2]}, "metrics": {"moves": "metrics_of_tests:steps"}}
    (module / "spec.yaml").write_text(json.dumps(spec))
    assert main(["sweep", "spec.yaml", "--out", "swept", "--no-report"]) == 0
    found = jx.load("swept")
    assert found.episodes["moves"].tolist() == found.episodes["steps"].tolist()
    assert " moves " in found.to_markdown()
    again = jx.sweep(spec | {"metrics": {"moves": lambda view: view.straight + view.diagonal}})
    pd.testing.assert_frame_equal(again.episodes, found.episodes)
