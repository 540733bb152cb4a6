"""Paths as functions of settings: means by hand, bins of many values, and bad input."""

import math

import numpy as np
import pandas as pd
import pytest
from ref.refusals import refused

from jexplore.studies.statistics.over_worlds import ALL_WORLDS, mean_over_worlds
from jexplore.studies.statistics.paired import mean_interval
from jexplore.studies.statistics.response import BINS, response

RANGE, CLEARANCE = "lidar.range_m", "rules.clearance_m"


def sweep(worlds=("cave#0",), strategies=("a", "b"), ranges=(2.0, 4.0), clearances=(0.3,), n=4, seed=0):
    """Episodes of a product of settings, with path lengths drawn at random."""
    rng = np.random.default_rng(seed)
    rows = [
        {"world": world, "strategy": strategy, "episode": i, "seed": 0, "path_m": rng.gamma(9, 4 / r + 1),
         "explored_fraction": 1.0, "outcome": "COMPLETE", RANGE: r, CLEARANCE: c}
        for world in worlds for strategy in strategies for r in ranges for c in clearances for i in range(n)
    ]  # fmt: skip
    return pd.DataFrame(rows)


def test_means_of_one_setting_by_hand():
    table = sweep()
    found = response(table, RANGE)
    assert list(found.columns) == ["world", "strategy", RANGE, "n", "estimate", "low", "high"]
    assert found[["world", "strategy", RANGE, "n"]].to_numpy().tolist() == [
        ["cave#0", "a", 2.0, 4], ["cave#0", "a", 4.0, 4], ["cave#0", "b", 2.0, 4], ["cave#0", "b", 4.0, 4]
    ]  # fmt: skip
    for i, (name, r) in enumerate(found[["strategy", RANGE]].to_numpy()):
        paths = table[(table["strategy"] == name) & (table[RANGE] == r)]["path_m"]
        assert found["estimate"][i] == pytest.approx(paths.mean())
        assert (found["low"][i], found["high"][i]) == pytest.approx(mean_interval(paths))


def test_other_settings_do_not_make_more_starts():
    """An episode at three clearances counts as a single start, with its mean over them: not three."""
    table = sweep(clearances=(0.2, 0.3, 0.4))
    found = response(table, RANGE)
    assert found["n"].tolist() == [4] * 4
    starts = table[(table["strategy"] == "a") & (table[RANGE] == 2.0)].groupby("episode")["path_m"].mean()
    assert (found["low"][0], found["high"][0]) == pytest.approx(mean_interval(starts))
    seeds = response(pd.concat([table, table.assign(seed=1)]), RANGE)
    assert seeds["n"].tolist() == [8] * 4


def test_many_worlds_are_the_sample():
    worlds = [f"cave#{i}" for i in range(4)] + [f"maze#{i}" for i in range(4)]
    table = sweep(worlds=worlds)
    found = response(table, RANGE)
    assert set(found["world"]) == {ALL_WORLDS}
    assert found["n"].tolist() == [8] * 4
    own = table[(table[RANGE] == 4.0) & (table["strategy"] == "b")].groupby("world", sort=False)["path_m"].mean()
    row = found.iloc[3]
    want = mean_over_worlds(own, ["cave"] * 4 + ["maze"] * 4)[:3]
    assert (row["estimate"], row["low"], row["high"]) == pytest.approx(want)
    each = response(table, RANGE, over_worlds=False)
    assert list(dict.fromkeys(each["world"])) == worlds
    assert found["estimate"][0] == pytest.approx(
        each[(each["strategy"] == "a") & (each[RANGE] == 2)]["estimate"].mean()
    )


def test_many_values_are_cut_into_parts_of_equally_many():
    rng = np.random.default_rng(0)
    draws = [sweep(ranges=(r,), clearances=(c,)) for r, c in rng.uniform([1, 0.1], [8, 0.6], (100, 2))]
    table = pd.concat(draws, ignore_index=True)
    found = response(table, RANGE)
    assert found[RANGE].nunique() == BINS
    assert found["n"].tolist() == [4] * 2 * BINS
    near = table.assign(**{RANGE: 1000 + table[RANGE] / 100})
    assert response(near, RANGE)[RANGE].nunique() == BINS  # told apart, however near


def test_wrong_settings_are_refused():
    table = sweep().assign(**{"b.weight": math.nan})
    refused(
        "unknown column of the episodes: 'lidar.range'.* did you mean 'lidar.range_m'", response, table, "lidar.range"
    )
    refused("b.weight must be set in some episodes, got none", response, table, "b.weight")
    refused("got none", response, table.iloc[:0], RANGE)
