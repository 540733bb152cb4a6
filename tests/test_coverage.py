"""Ratios at equal coverage, in one world and over many."""

import math

import numpy as np
import pandas as pd
import pytest

from jexplore.studies.statistics.coverage import MEASURES, at_coverage
from jexplore.studies.statistics.league import standings
from jexplore.studies.statistics.over_worlds import ALL_WORLDS
from jexplore.studies.statistics.paired import paired_ratio

SHARES = [share for measure, share in MEASURES if measure == "path"]


def episodes(worlds, n=4):
    """`near` sees half of a world in half of the way of `far`, and the rest in twice that way; noise by the episode."""
    rows = []
    for k, world in enumerate(worlds):
        for name, factors in (("far", (1, 1, 1)), ("near", (0.5, 2, 1.25))):
            for i in range(n):
                early, late, area = (f * (1 + 0.1 * (k + i * f) % 0.5) for f in factors)
                own = {"path_m_at_50": early, "path_m": 10 * late, "area_m": area, "energy_j": late}
                own |= {column: late for column in MEASURES.values() if column not in own}
                rows.append({"world": world, "strategy": name, "episode": i, "outcome": "COMPLETE", **own})
    return pd.DataFrame(rows).assign(explored_fraction=1.0)


def row(table, share, strategy="near", measure="path", world=ALL_WORLDS):
    where = (table["measure"] == measure) & (table["share"] == share) & (table["world"] == world)
    (found,) = table[where & (table["strategy"] == strategy)].itertuples()
    return found


def test_in_each_world_pairs_are_compared():
    table = episodes(["cave#0", "maze#1"])
    found = at_coverage(table)
    assert len(found) == len(MEASURES) * 2 * 2
    for share in SHARES:
        values = table[table["world"] == "maze#1"].pivot(
            index="episode", columns="strategy", values=MEASURES["path", share]
        )
        want, own = paired_ratio(values["near"], values["far"]), row(found, share, world="maze#1")
        assert (own.ratio, own.low, own.high, own.p, own.n) == tuple(want)
        assert row(found, share, "far", world="maze#1").ratio == 1
    assert row(found, "50 %", world="cave#0").ratio < 1 < row(found, "100 %", world="cave#0").ratio


def test_over_many_worlds_they_count_the_same():
    table = episodes([f"cave#{k}" for k in range(6)])
    found = at_coverage(table)
    assert set(found["world"]) == {ALL_WORLDS}
    means = table.groupby(["world", "strategy"])["area_m"].mean().unstack()
    want = math.exp(np.log(means["near"] / means["far"]).mean())
    own = row(found, "area")
    assert (own.ratio, own.n) == (pytest.approx(want), 6)
    assert own.low < own.ratio < own.high
    # At 100 % the table of standings says the same.
    by_path = standings(table).set_index("strategy").loc["near"]
    whole = row(found, "100 %")
    assert (whole.ratio, whole.low, whole.high) == pytest.approx((by_path.ratio, by_path.ratio_low, by_path.ratio_high))


def test_failed_episodes_are_left_out():
    table = episodes(["cave#0"])
    first = (table["strategy"] == "near") & (table["episode"] == 0)
    table.loc[first, ["outcome", "explored_fraction"]] = ["STEP_LIMIT", 0.2]
    assert row(at_coverage(table), "90 %", world="cave#0").n == 3
    table.loc[table["strategy"] == "near", ["outcome", "explored_fraction"]] = ["STEP_LIMIT", 0.2]
    assert math.isnan(row(at_coverage(table), "90 %", world="cave#0").ratio)
