"""Chances of a shorter path, interquartile means: by hand, against scipy, by laws."""

import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ref.refusals import refused
from scipy import stats as scipy_stats

from jexplore.studies.statistics import aggregate, league
from jexplore.studies.statistics.aggregate import improvement, interquartile_mean, scores_of
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


def test_chance_by_hand():
    """Shorter, equal, longer, shorter: 1 + 1/2 + 0 + 1 of 4."""
    found = improvement([1.0, 2.0, 3.0, 4.0], [2.0, 2.0, 2.0, 5.0])
    assert (found.value, found.n) == (0.625, 4)
    both = improvement([2.0, 2.0, 2.0, 5.0], [1.0, 2.0, 3.0, 4.0])
    assert (both.value, both.p) == (0.375, pytest.approx(found.p))
    assert (1 - both.high, 1 - both.low) == pytest.approx((found.low, found.high))


def test_chance_over_worlds_counts_worlds_the_same():
    """Three starts in one world, all shorter, and one in another, longer: 1/2, and the sample are two worlds."""
    found = improvement([1.0, 1.0, 1.0, 9.0], [2.0] * 4, ["cave#0"] * 3 + ["cave#1"])
    assert (found.value, found.n, found.p) == (0.5, 2, pytest.approx(1.0))


def test_failures_are_longer_and_equal_to_each_other():
    found = improvement([math.inf, math.inf, 1.0], [1.0, math.inf, math.inf])
    assert found.value == 0.5


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
    assert interquartile_mean([]).n == 0
    one = improvement([1.0], [2.0])
    assert (one.value, one.n) == (1.0, 1)
    assert np.isnan([one.low, one.high, one.p]).all()


def test_middle_by_hand():
    """Of 1, 2, 3, 4, 5, 6 the middle half is half of 2, 3, 4, half of 5: 10.5 / 3; one far away changes nothing."""
    assert interquartile_mean([6.0, 1.0, 5.0, 2.0, 4.0, 3.0]).value == pytest.approx(3.5)
    assert interquartile_mean([1e9, 1.0, 5.0, 2.0, 4.0, 3.0]).value == pytest.approx(3.5)
    assert interquartile_mean([math.inf, 1.0, 5.0, 2.0, 4.0, 3.0]).value == pytest.approx(3.5)


def test_middle_agrees_with_scipy():
    rng = np.random.default_rng(0)
    for n in (4, 8, 40, 100):
        scores = rng.gamma(3.0, 1.0, n)
        assert interquartile_mean(scores).value == pytest.approx(scipy_stats.trim_mean(scores, 0.25), rel=1e-12)


def test_middle_of_unequal_worlds_is_as_if_each_was_repeated():
    few, many = [1.0, 2.0], [3.0, 5.0, 4.0, 9.0, 1.5, 0.5]
    found = interquartile_mean([*few, *many], ["cave#0"] * 2 + ["cave#1"] * 6)
    again = interquartile_mean([*few * 3, *many], ["cave#0"] * 6 + ["cave#1"] * 6)
    assert found.value == pytest.approx(again.value)
    assert (found.low, found.high, found.n) == (pytest.approx(again.low), pytest.approx(again.high), 2)


def test_interval_of_the_middle_by_hand():
    """Of 1, 2, 3, 4: mean 2.5; pulled in to 1 (a quarter lies there) and 3: 1, 2, 3, 3, of standard error 0.4787."""
    found = interquartile_mean([1.0, 2.0, 3.0, 4.0])
    error = np.std([1, 2, 3, 3], ddof=1) / 2 / (0.5 * 2.5)
    t = scipy_stats.t(3)
    assert found.value == 2.5
    assert (found.low, found.high) == pytest.approx(tuple(2.5 * np.exp(np.array([-1, 1]) * t.ppf(0.975) * error)))
    assert found.p == pytest.approx(2 * t.sf(math.log(2.5) / error))


@pytest.mark.parametrize("scores", [[2.0], [3.0] * 5, [math.inf] * 4, [0.0, 0.0], [1.0, math.inf, math.inf, math.inf]])
def test_middles_without_an_interval(scores):
    found = interquartile_mean(scores)
    assert np.isnan([found.low, found.high, found.p]).all()
    assert found.value == (scores[0] if len(set(scores)) == 1 else math.inf)


@pytest.mark.parametrize(
    ("values", "worlds", "message"),
    [
        ([1.0, math.nan], None, "numbers from 0, inf for a failure"),
        ([1.0, -1.0], None, "numbers from 0"),
        ([[1.0]], None, "a vector"),
        ([1.0, 2.0], ["a"], "worlds must be as many as the"),
    ],
)
def test_wrong_values_are_refused(values, worlds, message):
    refused(message, interquartile_mean, values, worlds)
    refused(message, improvement, values, [1.0, 2.0], worlds)


def test_other_wrong_input_is_refused():
    refused("reference must be as many as the values, 2, got 1", improvement, [1.0, 2.0], [1.0])
    table = episodes({("w", "a"): [1.0], ("w", "b"): [2.0]})
    refused("w, a: episode 0 must occur once", comparable_paths, pd.concat([table, table]))


def test_scores_by_hand():
    table = episodes({("w", "a"): [10, 0, 0, 10, 10], ("w", "b"): [5, 0, 2, 10, 10], ("w", "c"): [20, 0, 0, 10, 10]})
    fail(fail(table, "c", 3), "a", 4)
    fail(table, "b", 4)
    first = scores_of(table)
    assert first.columns.tolist() == ["a", "b", "c"]
    np.testing.assert_array_equal(first.T, [[1, 1, 1, 1, np.nan], [0.5, 1, np.inf, 1, np.nan], [2, 1, 1, np.inf, 0]])


def test_paths_keep_the_order_of_worlds_and_leave_out_what_one_lacks():
    table = episodes({("z", "a"): [1, 2], ("z", "b"): [3], ("m", "a"): [4], ("m", "b"): [5]})
    paths = comparable_paths(table)
    assert paths.index.tolist() == [("z", 0), ("m", 0)]
    np.testing.assert_array_equal(paths, [[1, 3], [4, 5]])
    assert comparable_paths(table.iloc[:0]).shape == (0, 0)
    assert len(aggregate.aggregates(table.iloc[:0])) == 0


def test_strategies_without_a_common_start():
    table = episodes({("w", "a"): [1.0, 2.0], ("w", "b"): [3.0, 4.0]})
    table.loc[table["strategy"] == "b", "episode"] += 7
    assert comparable_paths(table).shape == (0, 2)
    found = league.standings(table)
    assert found["worlds"].tolist() == [0, 0]
    assert found[["ratio", "shorter", "iqm", "rank"]].isna().all(axis=None)
    assert "nan" not in league.over_worlds_text(found)


def test_aggregates_by_hand():
    paths = {("cave#0", "a"): [10, 10], ("cave#1", "a"): [10, 10], ("cave#0", "b"): [5, 10], ("cave#1", "b"): [20, 5]}
    first, second = aggregate.aggregates(episodes(paths)).itertuples(index=False)
    assert (first.strategy, first.units, first.iqm) == ("a", 2, 1.0)
    assert np.isnan([first.shorter, first.shorter_p, first.iqm_low]).all()
    assert (second.shorter, second.iqm) == (0.625, 0.75)  # 3/4 and 1/2; 1/2 1/2 1 2
    one = aggregate.aggregates(episodes({key: value for key, value in paths.items() if key[0] == "cave#0"}))
    assert one["units"].tolist() == [2, 2]


def test_standings_hold_the_aggregates():
    rng = np.random.default_rng(0)
    paths = {(f"cave#{i}", name): rng.gamma(9, f, 4) for i in range(6) for f, name in ((9, "a"), (8, "b"), (12, "c"))}
    table = episodes(paths)
    found, more = league.standings(table).set_index("strategy"), aggregate.aggregates(table).set_index("strategy")
    for key in ("shorter", "shorter_low", "shorter_high", "iqm", "iqm_low", "iqm_high"):
        np.testing.assert_array_equal(found[key].reindex(more.index), more[key])
    text = league.over_worlds_text(league.standings(table))
    assert text.startswith("Over 6 worlds, which count the same")
    assert league.standings_table(league.standings(table)) in text
    assert "nan" not in text
