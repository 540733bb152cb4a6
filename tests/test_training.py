"""Training: a toy whose answer is known, stored rounds, wrong input."""

import json
import re

import jax
import numpy as np
import pandas as pd
import pytest
from ref.refusals import refused

import jexplore as jx
from jexplore.cli import main
from jexplore.learn import bank, es, ppo, training
from jexplore.learn.settings import TRAINER_SETTINGS
from jexplore.policies import parse_strategy
from jexplore.policies.learned import model
from jexplore.rules import Lidar, Rules
from jexplore.worlds.world import World

pytestmark = pytest.mark.jit

SMALL = ["rooms#1000:width_m=6,height_m=6", "maze#1000:width_m=6,height_m=6"]
WATCHED = ["rooms#2000:width_m=6,height_m=6"]
NEAR = Lidar(n_beams=61, range_m=1.5)
QUICK = {"pairs": 2, "episodes": 2}


def toy():
    """A corridor, its near end on one side, a long way on the other; frontiers as far. The near end first is best, and
    `closest` takes the other, whose cells come first.
    """
    walls = np.ones((15, 160), bool)
    walls[4:11, 4:140] = False
    return World(occupied=walls, cell_m=0.1, name="toy", start=(7, 118, 0))


@pytest.mark.parametrize(
    ("algo", "rounds", "settings"),
    [
        ("es", 12, {"pairs": 4, "episodes": 1, "rate": 0.1, "sigma": 0.3}),
        pytest.param(
            *("ppo", 2, {"decisions": 512, "lanes": 8, "starts": 1, "unroll": 8, "rate": 0.01, "minibatches": 2}),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_the_near_end_is_found(algo, rounds, settings):
    own = bank.prepare_bank(toy(), lidar=NEAR, start="world")
    other = bank.prepare_bank(toy().replace(name="toy again"), lidar=NEAR, start="world")
    plan = training.prepare_training(
        algo, "linear", own, other, settings, rounds=rounds, check_every=rounds // 2, starts=1, seed=0
    )
    found = training.run_training(plan)
    assert found.curve["ratio"].iloc[1:].notna().all()
    assert found.curve["round"][found.curve["validation"].notna()].tolist() == [0, rounds // 2, rounds]
    assert found.curve["validation"].iloc[0] == 1.0
    assert found.curve["validation"].min() < 0.9


def quick_plan(rounds=4, **changes):
    options = {"rounds": rounds, "check_every": 2, "starts": 1, "seed": 0} | changes
    banks = (bank.prepare_bank(worlds, lidar=NEAR) for worlds in (SMALL, WATCHED))
    return training.prepare_training("es", "linear", *banks, QUICK, **options)


@pytest.mark.slow
def test_the_command_interrupted_goes_on_where_it_was(tmp_path, monkeypatch, capsys):
    out, whole = tmp_path / "run", tmp_path / "whole"
    command = ["train", "--worlds", *SMALL, "--validation", *WATCHED, "--rounds", "4", "--check-every", "1", "--set"]
    command += ["pairs=2", "episodes=2", "--lidar.n-beams", "61", "--lidar.range-m", "1.5", "--out"]
    assert main.main([*command, str(whole)]) == 0
    make_round, made = es.make_round, []

    def until_the_third(*args):
        made.append(args)
        if len(made) == 3:
            raise KeyboardInterrupt
        return make_round(*args)

    monkeypatch.setattr(es, "make_round", until_the_third)
    assert main.main([*command, str(out)]) == 130
    assert "units are kept" in capsys.readouterr().err
    assert main.main([*command, str(out), "--resume"]) == 0
    assert len(made) == 5  # two were made, one was cut short, two more
    assert (out / "model.msgpack").read_bytes() == (whole / "model.msgpack").read_bytes()
    pd.testing.assert_frame_equal(pd.read_parquet(out / "curve.parquet"), pd.read_parquet(whole / "curve.parquet"))
    assert json.loads((out / "model.json").read_text())["command"][:2] == ["jexplore", "train"]
    assert (out / "curve.png").stat().st_size > 1000
    assert parse_strategy(f"learned+recheck:path={out / 'model.msgpack'}").recheck
    assert main.main([*command, str(out), "--resume"]) == 0
    assert "nothing was left to do" in capsys.readouterr().out
    assert main.main([*command, str(out), "--resume", "--seed", "1"]) == 2
    assert "its seed is 0, not 1" in capsys.readouterr().err


@pytest.mark.slow
def test_weights_that_are_no_numbers_end_training_with_the_best_before(monkeypatch):
    make_round = es.make_round

    def broken(state, *args):
        new, ratio = make_round(state, *args)
        spoilt = jax.tree.map(lambda leaf: leaf * np.float32("nan"), new.weights)
        bad = new._replace(weights=spoilt) if new.generation > 2 else new
        return bad, ratio

    monkeypatch.setattr(es, "make_round", broken)
    found = training.run_training(quick_plan())
    assert found.ended == "not finite"
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found.model.weights))
    refused("before the first check", training.run_training, quick_plan(check_every=4))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--algo", "sac"], "unknown algorithm 'sac' .*es"),
        (["--network", "deep"], "unknown network 'deep'"),
        (["--rounds", "7"], "rounds must be a multiple of check_every, 5, got 7"),
        (["--algo", "ppo", "--set", "pairs=3"], "unknown setting of 'ppo': 'pairs'"),
        (["--set", "pairs=0"], "pairs must be an integer from 1 to 10000, got 0"),
        (["--set", "sigma"], "expected NAME=NUMBER once"),
        (["--measure", "path"], "unknown measure 'path'.*path_m"),
        (["--algo", "ppo", "--measure", "time_s"], "ppo trains for path_m, its reward, got 'time_s'"),
        (["--validation", SMALL[0]], "is in both the training and the validation worlds"),
    ],
)
def test_wrong_input(options, message, tmp_path, capsys):
    command = ["train", "--out", str(tmp_path / "run"), *options]
    for name, worlds in (("--worlds", SMALL), ("--validation", WATCHED)):
        command += [] if name in options else [name, *worlds]
    assert main.main(command) == 2
    assert re.search(message, capsys.readouterr().err)
    assert not (tmp_path / "run").exists()


def test_episodes_that_fail_count_as_long_ones():
    logs = bank.log_ratio(np.asarray([[np.inf, 2.0, np.inf]]), np.asarray([1.0, 1.0, np.inf]))
    np.testing.assert_allclose(logs, [[np.log(bank.FAILED), np.log(2), 0.0]])


def test_a_reference_may_fail_in_some_worlds(monkeypatch):
    values = np.array([[1.0, np.inf], [2.0, 3.0]])
    monkeypatch.setattr(bank.Bank, "values", lambda *_, **__: values)
    found = bank.prepare_bank(SMALL[0], lidar=NEAR).log_ratios([], [0, 0], 0)
    np.testing.assert_allclose(found, bank.log_ratio(values[1:], values[0]))


def test_a_reference_that_finishes_nothing_is_refused():
    own = bank.prepare_bank(SMALL[0], lidar=NEAR, rules=Rules(max_steps=5))
    refused("finishes no episode in rooms#1000", own.log_ratios, [parse_strategy("closest")], [0, 0], 0)


def test_episodes_that_saw_as_much_as_they_were_to_count():
    own = bank.prepare_bank(SMALL[0], lidar=NEAR, rules=Rules(stop_at=0.5))
    assert np.isfinite(own.values([parse_strategy("closest")], [0, 0], 0)).all()


@pytest.mark.parametrize("measure", ["path_m", "path_m_at_95", "time_s"])
def test_ratios_are_those_of_a_comparison(measure):
    own = bank.prepare_bank(SMALL, lidar=NEAR, measure=measure)
    logs = own.log_ratios([parse_strategy("closest"), parse_strategy("random")], [1, 0, 1], 5)
    for number, places in ((0, [1]), (1, [0, 2])):
        names = [bank.REFERENCE, "closest", "random"]
        table = jx.compare(SMALL[number], names, episodes=len(places), seed=5, lidar=NEAR).to_pandas()
        paths = table.pivot(index="episode", columns="strategy", values=measure)
        for i, name in enumerate(names[1:]):
            want = np.log(paths[name] / paths[bank.REFERENCE])
            np.testing.assert_allclose(logs[i, places], want)


@pytest.mark.slow
def test_training_as_a_function(tmp_path):
    options = {"worlds": SMALL, "validation": WATCHED, "lidar": NEAR, "rounds": 1, "settings": QUICK}
    found = jx.train(**options)
    file = found.save(tmp_path / "mine")
    table = jx.compare(WATCHED, ["closest+recheck", found.strategy(), f"learned+recheck:path={file}"], lidar=NEAR)
    paths = table.to_pandas().pivot(index="episode", columns="strategy", values="path_m")
    np.testing.assert_array_equal(paths["learned+recheck"], paths[f"learned+recheck:path={file}"])
    # Training goes on where a model is, also with another network, which begins at its weighted sum.
    plan = training.prepare_training(
        "es", "attention", *(bank.prepare_bank(worlds, lidar=NEAR) for worlds in (SMALL, WATCHED)), QUICK,
        rounds=1, check_every=1, starts=1, seed=0, model=model.load_model(file),
    )  # fmt: skip
    np.testing.assert_array_equal(plan.begins.weights["plain"], found.model.weights["weights"])
    again = jx.train(model=file, **options | {"rounds": 2, "check_every": 2})
    assert again.curve["validation"].iloc[0] == found.curve["validation"].min()
    wide = found.model._replace(network="attention", weights=plan.begins.weights)
    refused("training of 'linear' cannot begin at a model of 'attention'", jx.train, model=wide, **options)


def test_models_that_training_cannot_begin_at(tmp_path):
    banks = [bank.prepare_bank(worlds, lidar=NEAR) for worlds in (SMALL, WATCHED)]
    options = {"rounds": 1, "check_every": 1, "starts": 1, "seed": 0}
    bad = model.Model("linear", {"weights": np.zeros(3, np.float32)})
    refused("have other names or shapes", training.prepare_training, "es", "linear", *banks, {}, model=bad, **options)
    refused("model must be a Model or the path of one, got int", jx.train, model=3, worlds=SMALL, validation=WATCHED)
    one = training.TrainingResult(model.load_model(model.SHIPPED), pd.DataFrame(), 0, "rounds")
    assert one.save(tmp_path / "linear-0.15").name == "linear-0.15.msgpack"
    refused("there is no folder", one.save, tmp_path / "none" / "linear")


def test_lanes_and_worlds_that_ppo_cannot_have():
    mixed = bank.prepare_bank([jx.load_world(SMALL[0]), jx.load_world(SMALL[1], cell_m=0.2)])
    settings = TRAINER_SETTINGS["ppo"]()
    refused(r"cells of one size, got 0\.1 and 0\.2 m", ppo.require_trainable, mixed, settings)
