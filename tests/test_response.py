"""Paths as functions of settings: means and paired ratios by hand, bins of many values, and bad input."""

import math

import numpy as np
import pandas as pd
import pytest
from ref.refusals import refused

from jexplore.config import InputError
from jexplore.studies.statistics.over_worlds import ALL_WORLDS, mean_over_worlds
from jexplore.studies.statistics.paired import mean_interval, paired_ratio
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


def test_ratios_are_paired_within_a_setting():
    table = sweep(clearances=(0.2, 0.3)).sample(frac=1, random_state=1)
    first = table["strategy"].iloc[0]
    found = response(table, [RANGE, CLEARANCE], ratio=True)
    for row in found[found["strategy"] != first].to_dict("records"):
        own = table[(table[RANGE] == row[RANGE]) & (table[CLEARANCE] == row[CLEARANCE])]
        paths = own.pivot(index="episode", columns="strategy", values="path_m")
        versus = paired_ratio(paths[row["strategy"]], paths[first])
        assert (row["n"], row["estimate"]) == (4, pytest.approx(versus.ratio))
        assert (row["low"], row["high"]) == pytest.approx((versus.low, versus.high))
    reference = found[found["strategy"] == first]
    assert (reference["estimate"] == 1).all()
    assert reference["low"].isna().all()


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
    found = response(table, RANGE, ratio=True)
    assert set(found["world"]) == {ALL_WORLDS}
    assert found["n"].tolist() == [8] * 4
    own = table[table[RANGE] == 4.0].groupby(["world", "strategy"], sort=False)["path_m"].mean().unstack()
    logs = np.log(own["b"] / own["a"])
    mean, low, high, _ = mean_over_worlds(logs, ["cave"] * 4 + ["maze"] * 4)
    row = found.iloc[3]
    assert (row["estimate"], row["low"], row["high"]) == pytest.approx(tuple(np.exp([mean, low, high])))
    each = response(table, RANGE, over_worlds=False)
    assert list(dict.fromkeys(each["world"])) == worlds
    means = response(table, RANGE, over_worlds=True)
    assert means["estimate"][0] == pytest.approx(
        each[(each["strategy"] == "a") & (each[RANGE] == 2)]["estimate"].mean()
    )


def test_settings_of_another_strategy_are_not_paired():
    """A parameter that the reference does not have: each of its values is compared with the same reference."""
    table = sweep(strategies=("a",), ranges=(2.0,))
    more = [table.assign(strategy="b", path_m=table["path_m"] * f, **{"b.weight": w}) for w, f in ((0.5, 2), (1.0, 3))]
    found = response(pd.concat([table, *more], ignore_index=True), "b.weight", ratio=True)
    assert found[["strategy", "b.weight", "estimate"]].to_numpy().tolist() == [["b", 0.5, 2.0], ["b", 1.0, 3.0]]


def test_many_values_are_cut_into_parts_of_equally_many():
    rng = np.random.default_rng(0)
    draws = [sweep(ranges=(r,), clearances=(c,)) for r, c in rng.uniform([1, 0.1], [8, 0.6], (100, 2))]
    table = pd.concat(draws, ignore_index=True)
    found = response(table, RANGE)
    assert found[RANGE].nunique() == BINS
    assert found["n"].tolist() == [4] * 2 * BINS
    assert response(table, RANGE, bins=5)[RANGE].nunique() == 5
    both = response(table, [RANGE, CLEARANCE])
    assert both[RANGE].nunique() == both[CLEARANCE].nunique() == 5  # about four draws in each of 25
    grid = response(sweep(ranges=np.linspace(1, 8, 11), clearances=(0.2, 0.3)), [RANGE, CLEARANCE])
    assert grid[RANGE].nunique() == 11
    diagonal = pd.concat([sweep(ranges=(r,), clearances=(r / 10,)) for r in (1.0, 2.0, 3.0, 4.0, 5.0)])
    assert response(diagonal, [RANGE, CLEARANCE])[RANGE].nunique() == 5
    near = table.assign(**{RANGE: 1000 + table[RANGE] / 100})
    assert response(near, RANGE)[RANGE].nunique() == BINS  # told apart, however near


def test_rows_without_a_value_are_left_out():
    table = sweep()
    table["path_m_at_95"] = table["path_m"].where(table["episode"] > 0)
    assert response(table, RANGE, value="path_m_at_95")["n"].tolist() == [3] * 4
    assert response(table, RANGE, value="path_m_at_95", ratio=True)["n"].tolist() == [3] * 4


@pytest.mark.parametrize(
    ("settings", "how", "message"),
    [
        ("lidar.range", {}, r"setting must be a column of the episodes, such as lidar.range_m, got 'lidar.range'"),
        (RANGE, {"value": "pathm"}, r"value must be a column of the episodes, such as path_m, got 'pathm'"),
        (RANGE, {"value": "outcome"}, "value must be a column of numbers, got 'outcome'"),
        ("b.weight", {}, "b.weight must be set in some episodes that have a path_m, got none"),
    ],
)
def test_wrong_columns_are_refused(settings, how, message):
    table = sweep().assign(**{"b.weight": math.nan})
    refused(message, response, table, settings, **how)


def test_an_episode_of_the_reference_that_occurs_twice_is_refused():
    table = sweep()
    with pytest.raises(InputError, match="a must have an episode once in each setting, got it more than once at world"):
        response(pd.concat([table, table]), RANGE, ratio=True)
    refused("got none", response, table.iloc[:0], RANGE)
