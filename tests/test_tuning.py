"""Tuning: budgets and choices by hand, draws within their bounds, settings of a file."""

import json
import re
from types import SimpleNamespace
from typing import Annotated

import numpy as np
import pandas as pd
import pytest
from ref.refusals import refused

import jexplore as jx
from jexplore.cli import main
from jexplore.config import InputError, InputWarning
from jexplore.learn import tuning
from jexplore.policies import Policy, Span, parse_strategy, search_space
from jexplore.policies.catalogue import entries
from jexplore.studies.statistics.league import LEAGUE_STRATEGIES, league_worlds


def test_a_round_has_twice_the_worlds_and_half_the_trials():
    assert tuning.halvings(16, 4) == [(1, 16), (2, 8), (4, 4)]
    assert tuning.halvings(2, 10) == [(5, 2), (10, 1)]
    assert tuning.halvings(5, 9) == [(2, 5), (4, 3), (9, 2)]
    assert tuning.halvings(1, 3) == [(3, 1)]
    assert tuning.halvings(9, 1) == [(1, 9)]
    # Of six kinds: one world of each with 16 trials, the defaults and the reference, and so on.
    assert tuning.episodes_needed(2, 24, 16, 4) == 6 * (1 + 2 * 17) + 6 * (1 + 2 * 9) + 12 * (1 + 2 * 5)


@pytest.mark.parametrize("name", [name for name in LEAGUE_STRATEGIES if search_space(name)])
def test_defaults_and_draws_lie_within_the_bounds(name):
    space = search_space(name)
    drawn = tuning.drawn_settings(name, 8, seed=3)
    assert drawn == tuning.drawn_settings(name, 8, seed=3) != tuning.drawn_settings(name, 8, seed=4)
    assert drawn[:5] == tuning.drawn_settings(name, 5, seed=3)
    for values in ({key: default for key, (_, default) in space.items()}, *drawn):
        assert list(values) == list(space)
        for key, (span, default) in space.items():
            assert span.low <= values[key] <= span.high
            assert type(values[key]) is type(default)
        parse_strategy(tuning.with_values(name, values))


def test_what_is_given_is_not_tuned():
    assert list(search_space("small-first+recheck:weight=1")) == ["side_weight", "min_gain"]
    assert list(search_space("closest+segment=rooms")) == ["ratio", "smallest_m2", "clutter_m", "door_m", "room_m2"]
    assert search_space("closest+recheck") == search_space("learned+recheck") == {}
    assert tuning.with_values("utility:beta=2.0", {"min_gain": 3}) == "utility:beta=2.0,min_gain=3"


def test_a_strategy_of_a_user_is_tuned_by_its_annotations(monkeypatch):
    monkeypatch.setattr(entries, "STRATEGIES", dict(entries.STRATEGIES))

    @jx.register("mine-tuned")
    def score(view, push: Annotated[float, Span(1.0, 2.0)] = 1.5, fixed=3):
        return -view.cost

    @jx.register("mine-refused")
    def none(push: Annotated[float, Span(1.0, 2.0)] = 1.5) -> Policy:
        raise InputError("never")

    assert search_space("mine-tuned+recheck") == {"push": (Span(1.0, 2.0), 1.5)}
    assert all(1 <= one["push"] <= 2 for one in tuning.drawn_settings("mine-tuned+recheck", 20, 0))
    with pytest.raises(InputError, match=re.escape("'mine-refused': 0 of 1000 settings within their bounds")):
        tuning.drawn_settings("mine-refused", 1, 0)


class Told(SimpleNamespace):
    """Worlds in which a strategy's logarithm is its min_gain, unless `told` has another."""

    def log_ratios(self, strategies, which, seed, *, workers, on_progress):
        on_progress(len(which) * (1 + len(strategies)))
        self.asked.append(([one.name for one in strategies], which))
        own = [self.told.get(one.policy.params.min_gain, one.policy.params.min_gain) for one in strategies]
        return np.array([[value + place / 100 for place in which] for value in own], float)


def test_the_better_half_goes_on_and_the_defaults_always(monkeypatch):
    gains = [7, 3, 9, 4]
    monkeypatch.setattr(tuning, "drawn_settings", lambda *_: [{"min_gain": gain} for gain in gains])
    bank = Told(worlds=range(8), asked=[], told={1: 50.0})  # two kinds of four worlds
    how, moved = {"seeds": 4, "trials": 4, "seed": 0}, []
    (found,) = tuning.search(["tour"], bank, **how, on_progress=moved.append)
    assert moved[-1] == tuning.episodes_needed(1, 8, 4, 4)
    assert bank.asked == [
        (["tour", *(f"tour:min_gain={gain}" for gain in gains)], [0, 4]),
        (["tour", "tour:min_gain=3", "tour:min_gain=4"], [1, 5]),
        (["tour", "tour:min_gain=3"], [2, 3, 6, 7]),
    ]
    assert found.best == 2
    assert tuning.chosen_settings([found]) == {"tour": {"min_gain": 3}}
    assert np.isfinite(found.log_ratio).sum(axis=1).tolist() == [8, 2, 8, 2, 4]
    table = tuning.trials_table([found])
    assert table["worlds"].tolist() == [8, 2, 8, 2, 4]
    assert table["ratio"][2] == pytest.approx(np.exp(3 + 0.28 / 8))
    bank.told[1] = -1.0
    assert tuning.chosen_settings(tuning.search(["tour"], bank, **how)) == {"tour": {}}
    text = tuning.tuning_table([found], [f"{kind}#{i}" for kind in ("cave", "maze") for i in range(4)])
    assert "| tour" in text
    assert "min_gain 3" in text


def test_settings_of_a_file(tmp_path):
    file = tmp_path / "tuned.json"
    file.write_text(json.dumps({"settings": {"tour+recheck": {"min_gain": 4}, "mcdm": {}}}))
    names = ["closest", "tour", "tour+recheck", "mcdm"]
    with pytest.warns(InputWarning, match="has no settings of tour, which keep their defaults"):
        assert tuning.with_settings(names, file) == ["closest", "tour", "tour+recheck:min_gain=4", "mcdm"]
    file.write_text('{"settings": {"tour": {"min_gain": [1, 2]}}}')
    refused("settings must be numbers", tuning.with_settings, names, file)
    for text in ("{}", "[]", '{"settings": {"tour": 3}}'):
        file.write_text(text)
        refused("must be a file of settings as `jexplore tune` writes", tuning.with_settings, names, file)


def test_shipped_settings_are_of_strategies_of_the_league():
    with pytest.warns(InputWarning, match="shipped: has no settings of .*small-first, .* keep their defaults"):
        given = tuning.with_settings(LEAGUE_STRATEGIES, "shipped")
    assert len(set(given) - set(LEAGUE_STRATEGIES)) > 5
    for name in given:
        parse_strategy(name)
    assert not set(league_worlds(0.1, 4, tuning.FIRST_SEED)) & set(league_worlds(0.1, 1000))


@pytest.mark.slow
@pytest.mark.jit
def test_the_command(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("jexplore.studies.statistics.league.LEAGUE_KINDS", ("maze", "rooms"))
    words = "tune --strategies tour+recheck --trials 2 --world-seeds 2 --cell-m 0.25 --out"
    for name in ("a", "b"):
        assert main.main([*words.split(), str(tmp_path / name)]) == 0
    assert "| tour+recheck" in capsys.readouterr().out
    one, other = (json.loads((tmp_path / name / "tuned.json").read_text())["settings"] for name in ("a", "b"))
    assert one == other
    assert len(pd.read_parquet(tmp_path / "a" / "trials.parquet")) == 3
