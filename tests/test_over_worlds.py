"""Shares of shorter paths over worlds: by hand, against scipy, by laws."""

import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ref.refusals import refused
from scipy import stats as scipy_stats

from jexplore.studies.statistics import league
from jexplore.studies.statistics.over_worlds import comparable_paths, share_over_worlds

START = {"start_row": 3, "start_col": 4, "start_heading_deg": 90}
REST = {"turning_rad": 1.0, "time_s": 2.0, "energy_j": 5.0, "scans": 9, "plans": 3, "exhausted": 0}
REST["room_entries"] = pd.NA


def episodes(paths, **columns):
    """A table of episodes, COMPLETE by default: `{(world, strategy): path lengths}`."""
    rows = [
        {"world": world, "strategy": strategy, "episode": i, "path_m": float(path), "outcome": "COMPLETE",
         "explored_fraction": 1.0, **START, **REST, **columns}
        for (world, strategy), all_ in paths.items()
        for i, path in enumerate(all_)
    ]  # fmt: skip
    return pd.DataFrame(rows)


def fail(table, strategy, number, world="w"):
    """Makes one episode one that a limit ended."""
    row = (table["strategy"] == strategy) & (table["episode"] == number) & (table["world"] == world)
    assert row.sum() == 1
    table.loc[row, ["path_m", "outcome", "explored_fraction"]] = [1.0, "STEP_LIMIT", 0.3]
    return table


def shorter(table, name):
    """Share of starts with a shorter path, low, high, from standings."""
    found = league.standings(table).set_index("strategy")
    return found.loc[name, ["shorter", "shorter_low", "shorter_high"]].tolist()


def test_share_by_hand():
    """Shorter, equal, longer, shorter: 1 + 1/2 + 0 + 1 of 4."""
    one, other = [1.0, 2.0, 3.0, 4.0], [2.0, 2.0, 2.0, 5.0]
    value, low, high = shorter(episodes({("w", "a"): other, ("w", "b"): one}), "b")
    assert value == 0.625
    again, *ends = shorter(episodes({("w", "a"): one, ("w", "b"): other}), "b")
    assert (again, 1 - ends[1], 1 - ends[0]) == pytest.approx((0.375, low, high))


def test_share_over_worlds_counts_worlds_the_same():
    """Three starts in one world, all shorter, and one in another, longer: 1/2."""
    paths = {("cave#0", "a"): [2.0] * 3, ("cave#1", "a"): [2.0], ("cave#0", "b"): [1.0] * 3, ("cave#1", "b"): [9.0]}
    assert shorter(episodes(paths), "b")[0] == 0.5


def test_failures_are_longer_and_equal_to_each_other():
    table = episodes({("w", name): [1.0] * 3 for name in "abc"})
    for name, number in (("b", 0), ("b", 1), ("a", 1), ("a", 2)):
        fail(table, name, number)
    assert shorter(table, "b")[0] == 0.5  # longer, equal, shorter


def test_interval_of_a_share_is_wilsons():
    """k of n single starts have n - 1 effective answers: Wilson's interval of those, with Student's t."""
    for k, n in ((3, 9), (0, 8), (8, 8), (20, 40)):
        wins = np.arange(n) < k
        mean, low, high, p = share_over_worlds(wins.astype(float), ["x"] * n)
        share, t = k / n, scipy_stats.t(n - 1)
        number = n - 1 if 0 < k < n else n
        z = t.ppf(0.975)
        roots = np.roots([1 + z**2 / number, -2 * share - z**2 / number, share**2])
        np.testing.assert_allclose(np.sort(roots), [low, high], atol=1e-7)
        assert mean == share
        assert p == pytest.approx(2 * t.sf(abs(share - 0.5) * 2 * math.sqrt(number)))


@given(st.lists(st.sampled_from([0.0, 0.25, 0.5, 0.75, 1.0]), min_size=2, max_size=30))
def test_interval_of_a_share_holds_it_and_agrees_with_its_p(values):
    kinds = [str(i % 3) for i in range(len(values))]
    mean, low, high, p = share_over_worlds(values, kinds)
    assert 0 <= low <= mean <= high <= 1
    assert low < high
    assert (p < 0.05) == (not low <= 0.5 <= high) or min(abs(low - 0.5), abs(high - 0.5)) < 1e-9
    again = share_over_worlds(1 - np.array(values), kinds)
    assert again == pytest.approx((1 - mean, 1 - high, 1 - low, p), abs=1e-9)


def test_worlds_of_one_kind_that_agree_make_it_narrow():
    """Differences between kinds do not make it wide."""
    shares = [0.9, 0.8, 0.9, 0.2, 0.3, 0.2]
    _, low, high, _ = share_over_worlds(shares, ["a"] * 3 + ["b"] * 3)
    _, wide_low, wide_high, _ = share_over_worlds(shares, ["a"] * 6)
    assert high - low < 0.5 * (wide_high - wide_low)


def test_one_world_or_none_has_no_interval():
    assert share_over_worlds([0.7], ["x"])[0] == 0.7
    assert np.isnan(share_over_worlds([0.7], ["x"])[1:]).all()
    assert np.isnan(share_over_worlds([], [])).all()


def test_an_episode_that_occurs_twice_is_refused():
    table = episodes({("w", "a"): [1.0], ("w", "b"): [2.0]})
    refused("w, a: episode 0 must occur once", comparable_paths, pd.concat([table, table]))


def test_paths_keep_the_order_of_worlds_and_leave_out_what_one_lacks():
    table = episodes({("z", "a"): [1, 2], ("z", "b"): [3], ("m", "a"): [4], ("m", "b"): [5]})
    paths = comparable_paths(table)
    assert paths.index.tolist() == [("z", 0), ("m", 0)]
    np.testing.assert_array_equal(paths, [[1, 3], [4, 5]])
    assert comparable_paths(table.iloc[:0]).shape == (0, 0)


def test_strategies_without_a_common_start():
    table = episodes({("w", "a"): [1.0, 2.0], ("w", "b"): [3.0, 4.0]})
    table.loc[table["strategy"] == "b", "episode"] += 7
    assert comparable_paths(table).shape == (0, 2)
    found = league.standings(table)
    assert found["worlds"].tolist() == [0, 0]
    assert found[["ratio", "shorter", "rank"]].isna().all(axis=None)
    assert "nan" not in league.over_worlds_text(found)
