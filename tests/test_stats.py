"""Statistics: by hand, against scipy, by laws, and on bad input."""

import math

import numpy as np
import pandas as pd
import pytest
from ref.refusals import refused
from scipy import stats as scipy_stats

from jexplore.config import InputError
from jexplore.studies.results.columns import SUMMARY_COLUMNS
from jexplore.studies.statistics import by_world, paired


def table(**columns):
    """Episodes of one world, by default COMPLETE ones of `closest`, numbered from 0; `columns` replace the defaults."""
    n = max(len(value) for value in columns.values() if isinstance(value, (list, np.ndarray)))
    path_m = np.asarray(columns.get("path_m", np.full(n, 10.0)), dtype=np.float64)
    marks = {f"path_m_at_{mark}": path_m * mark / 100 for mark in (50, 90, 95, 99)}
    start = {"seed": 0, "start_row": 3, "start_col": 4, "start_heading_deg": 90}
    counts = {"steps": 100, "scans": 104, "plans": 7, "exhausted": 0}
    counts |= {"turning_rad": 1.5, "time_s": 30.0, "energy_j": 900.0}
    default = {"world": "office#1", "strategy": "closest", "episode": np.arange(n), **start, "path_m": path_m, **counts}
    default |= {"outcome": "COMPLETE", "explored_fraction": 1.0, **marks}
    default |= {"room_entries": pd.array([pd.NA] * n, dtype="Int64")}
    return pd.DataFrame(default | columns)


def both(reference, other, **columns):
    """A reference strategy `closest` and another one, `random`, with the given columns."""
    return pd.concat([table(path_m=reference), table(path_m=other, strategy="random", **columns)], ignore_index=True)


def test_summary_by_hand():
    episodes = both(
        [10.0, 20.0, 30.0], [20.0, 40.0, 60.0], outcome=["COMPLETE", "BLOCKED", "COMPLETE"], plans=[1, 2, 6]
    )
    first, second = by_world.summarise(episodes).itertuples(index=False)
    assert (first.world, first.strategy, first.n, first.mean, first.sd) == ("office#1", "closest", 3, 20.0, 10.0)
    assert first.ratio == 1.0
    assert np.isnan([first.ratio_low, first.ratio_high, first.p, first.room_entries]).all()
    assert (second.mean, second.sd, second.plans, second.scans, second.turning_rad) == (40.0, 20.0, 3.0, 104.0, 1.5)
    assert second.ratio == 2.0
    assert np.isnan([second.ratio_low, second.ratio_high, second.p]).all()  # twice as long in every pair: no spread
    assert (first.outcomes, second.outcomes) == ("COMPLETE 3", "COMPLETE 2, BLOCKED 1")


def test_ratio_by_hand():
    """Means 5 and 4; v / 5 - r / 4 is -0.35, 0.1, 0.25: standard error sqrt(0.0975 / 3), two degrees of freedom."""
    found = paired.paired_ratio([2.0, 6.0, 7.0], [3.0, 4.4, 4.6])
    error = math.sqrt(0.0975 / 3)
    t = scipy_stats.t(2)
    assert (found.ratio, found.n) == (1.25, 3)
    assert found.low == pytest.approx(1.25 * math.exp(-t.ppf(0.975) * error), rel=1e-12)
    assert found.high == pytest.approx(1.25 * math.exp(t.ppf(0.975) * error), rel=1e-12)
    assert found.p == pytest.approx(2 * t.sf(math.log(1.25) / error), rel=1e-12)


def test_equal_pairs_count_as_one_in_the_degrees_of_freedom():
    values, reference = np.array([2.0, 6.0, 7.0, 5.0, 4.0]), np.array([3.0, 4.4, 4.6, 5.0, 4.0])
    found = paired.paired_ratio(values, reference)
    apart = values / values.mean() - reference / reference.mean()
    error = apart.std(ddof=1) / math.sqrt(5)
    t = scipy_stats.t(3).ppf(0.975)  # three pairs that differ and two that do not
    assert found.high / found.ratio == pytest.approx(math.exp(t * error), rel=1e-12)
    assert found.n == 5


def test_one_episode_repeated_is_one_pair():
    found = paired.paired_ratio([40.0] * 20, [50.0] * 20)
    assert (found.ratio, found.n) == (0.8, 1)
    assert np.isnan([found.low, found.high, found.p]).all()
    some = paired.paired_ratio([40.0] * 19 + [41.0], [50.0] * 20)
    assert some.n == 20
    assert some.low < some.ratio < some.high


def test_p_is_below_five_per_cent_just_where_the_interval_leaves_out_one():
    rng = np.random.default_rng(8)
    sides = set()
    for _ in range(200):
        reference = rng.gamma(9.0, 10.0, 8)
        found = paired.paired_ratio(reference * rng.normal(0.93, 0.1, 8), reference)
        assert (found.p < 0.05) == (not found.low <= 1 <= found.high)
        sides.add(found.p < 0.05)
    assert sides == {True, False}


@pytest.mark.parametrize("unit", [1.0, 0.1, 1000.0])
def test_interval_of_a_mean_by_hand_and_in_any_unit(unit):
    values = np.array([1.0] * 15 + [2.0] * 4 + [9.0]) * unit
    low, high = paired.mean_interval(values)
    error = values.std(ddof=1) / values.mean() / math.sqrt(20)
    t = scipy_stats.t(19).ppf(0.975)
    assert (low, high) == pytest.approx((values.mean() * math.exp(-t * error), values.mean() * math.exp(t * error)))
    assert high - values.mean() > values.mean() - low > 0


def test_no_interval_of_one_value_of_equal_values_and_of_zeros():
    for values in ([5.0], [5.0, 5.0, 5.0], [0.0, 0.0]):
        assert np.isnan(paired.mean_interval(values)).all()


@pytest.mark.parametrize("n", [5, 20])
@pytest.mark.parametrize("equal", [0.0, 0.5])
def test_interval_covers_the_ratio_about_as_often_as_promised(n, equal):
    """2,000 samples tell a share of 0.95 to 0.01; wider here, for the interval is only approximate."""
    rng = np.random.default_rng(n)
    hits = 0
    for _ in range(2000):
        reference = rng.gamma(100.0, 0.5, n)
        values = reference * np.where(rng.random(n) < equal, 1.0, rng.normal(0.85, 0.1, n))
        found = paired.paired_ratio(values, reference)
        hits += found.low <= equal + (1 - equal) * 0.85 <= found.high
    assert 0.92 <= hits / 2000 <= 0.985


def test_means_of_zero_and_ratios_without_end():
    none = paired.paired_ratio([0.0, 0.0], [0.0, 0.0])
    without_end = paired.paired_ratio([1.0, 2.0], [0.0, 0.0])
    nothing = paired.paired_ratio([0.0, 0.0], [1.0, 2.0])
    assert math.isnan(none.ratio)
    assert math.isnan(without_end.ratio)
    assert nothing.ratio == 0.0
    assert np.isnan([(found.low, found.high, found.p) for found in (none, without_end, nothing)]).all()
    some = paired.paired_ratio([1.0, 3.0], [0.0, 4.0])
    assert some.ratio == 1.0
    assert some.low < 1 < some.high
    sure = paired.paired_ratio([1.0, 300.0], [290.0, 1.0])
    assert 0 <= sure.low < sure.ratio < sure.high <= math.inf


@pytest.mark.parametrize("values", [[], [1.0, math.nan], 3.0, [-1.0, 2.0]])
def test_bad_vectors(values):
    with pytest.raises(ValueError, match="expected values as a vector"):
        paired.mean_interval(values)
    with pytest.raises(ValueError, match="expected reference as a vector"):
        paired.paired_ratio([1.0, 2.0], values)
    with pytest.raises(ValueError, match="got 2 and 3"):
        paired.paired_ratio([1.0, 2.0], [1.0, 2.0, 3.0])


def test_p_is_corrected_for_the_strategies_of_each_world():
    rng = np.random.default_rng(4)
    a = rng.gamma(9.0, 10.0, 12)
    tables = [
        table(path_m=a * f + rng.normal(0, 3, 12), strategy=name, world=world)
        for world in ("v", "w")
        for name, f in (("first", 1.0), ("alike", 1.01), ("short", 0.8), ("long", 1.05))
    ]
    summary = by_world.summarise(pd.concat(tables, ignore_index=True))
    for _, rows in summary.groupby("world"):
        p, corrected = rows["p"].to_numpy(), rows["p_holm"].to_numpy()
        assert np.isnan([p[0], corrected[0]]).all()
        order = np.argsort(p[1:])
        expected = np.minimum(np.maximum.accumulate(np.sort(p[1:]) * [3, 2, 1]), 1)
        np.testing.assert_allclose(corrected[1:][order], expected)
        assert (corrected[1:] >= p[1:]).all()
    two = summary[summary["strategy"].isin(["first", "short"])]
    text = by_world.markdown_table(two)
    assert text.count("<0.001") == 2


def test_summary_keeps_the_order_given_and_pairs_by_episode():
    rng = np.random.default_rng(4)
    a, b = rng.normal(50.0, 5.0, 8), rng.normal(40.0, 5.0, 8)
    other_world = both(b, a)
    other_world["world"] = "cave#0"
    episodes = pd.concat([both(a, b), other_world], ignore_index=True)
    summary = by_world.summarise(episodes)
    assert list(summary.columns) == list(SUMMARY_COLUMNS)
    assert list(zip(summary["world"], summary["strategy"])) == [
        *(("office#1", "closest"), ("office#1", "random"), ("cave#0", "closest"), ("cave#0", "random"))
    ]
    expected = paired.paired_ratio(b, a)
    assert summary.loc[1, ["ratio", "ratio_low", "ratio_high", "p"]].tolist() == [
        *(expected.ratio, expected.low, expected.high, expected.p)
    ]
    within = np.concatenate([np.arange(8), 8 + rng.permutation(8), 16 + rng.permutation(8), 24 + rng.permutation(8)])
    pd.testing.assert_frame_equal(by_world.summarise(episodes.iloc[within]), summary, rtol=1e-12)


def test_summary_of_nothing():
    empty = table(path_m=[1.0]).iloc[:0]
    assert len(by_world.summarise(empty)) == 0
    assert by_world.warnings_of(empty) == []
    assert by_world.markdown_table(by_world.summarise(empty)).count("\n") == 2


def test_world_without_the_first_strategy():
    episodes = both([10.0, 11.0], [12.0, 15.0])
    episodes.loc[episodes["strategy"] == "random", "world"] = "cave#0"
    assert math.isnan(by_world.summarise(episodes)["ratio"][1])
    assert by_world.warnings_of(episodes) == ["cave#0: no episode of closest, so nothing to compare with"]


def test_only_common_episodes_are_compared():
    episodes = both([11.0, 9.0, 11.0], [5.0, 20.0, 99.0], episode=[1, 2, 3])
    assert by_world.summarise(episodes)["ratio"][1] == 1.25
    assert by_world.warnings_of(episodes) == [
        "office#1: random against closest: 3 and 3 episodes make 2 pairs; only pairs are compared"
    ]
    apart = both([10.0, 11.0], [5.0, 20.0], episode=[7, 8])
    assert math.isnan(by_world.summarise(apart)["ratio"][1])
    assert len(by_world.warnings_of(apart)) == 1


def test_pairs_that_start_differently_and_episodes_that_occur_twice_are_refused():
    with pytest.raises(InputError, match=r"^office#1, random, episode 1: .*start_col is 9, not 4$"):
        by_world.summarise(both([1.0, 2.0], [1.0, 2.0], start_col=[4, 9]))
    refused("episode 5 must occur once", by_world.summarise, table(path_m=[1.0, 2.0], episode=[5, 5]))


def progress(final, metres_a_mark=1.0):
    """Return the progress of an episode with a path per mark, which gets to `final` of 100."""
    marks = np.arange(1, 101)
    return np.where(marks <= final, marks * metres_a_mark, np.nan)


def test_paths_at_equal_coverage_by_hand():
    ours = np.stack([progress(100), progress(60), progress(100), progress(0), progress(1)])
    theirs = np.stack([progress(100, 2.0), progress(100, 2.0), progress(40, 2.0), progress(100, 2.0), progress(1, 2.0)])
    path_m, reference_m = by_world.path_at_equal_coverage(ours, theirs)
    # 95 % of the lesser: marks 95, 57, 38, none, and none below the first mark.
    np.testing.assert_array_equal(path_m, [95, 57, 38, np.nan, np.nan])
    np.testing.assert_array_equal(reference_m, [190, 114, 76, np.nan, np.nan])


def test_repeated_episodes_count_once():
    episodes = both([50.0] * 4, [40.0] * 4)
    first, second = by_world.summarise(episodes).itertuples(index=False)
    assert (first.n, second.n, second.ratio) == (1, 1, 0.8)
    assert np.isnan([first.sd, first.ci_low, second.ci_high, second.ratio_low, second.ratio_high, second.p]).all()
    assert by_world.warnings_of(episodes) == [
        f"office#1: {name}: all 4 episodes are the same one, which counts once" for name in ("closest", "random")
    ]
    other_start = both([50.0] * 4, [40.0] * 4, start_col=[4, 4, 4, 5])
    other_start.loc[3, "start_col"] = 5
    assert by_world.summarise(other_start)["n"].tolist() == [4, 4]


def test_truncated_paths_are_compared_at_equal_coverage():
    episodes = pd.concat(
        [
            table(path_m=[40.0, 42.0, 40.0]),
            table(
                strategy="random",
                path_m=[80.0, 20.0, 84.0],
                explored_fraction=[1.0, 0.55, 1.0],
                outcome=["COMPLETE", "STEP_LIMIT", "COMPLETE"],
            ),
        ],
        ignore_index=True,
    )
    known = {
        ("office#1", "closest"): np.stack([progress(100, 0.4), progress(100, 0.41), progress(100, 0.42)]),
        ("office#1", "random"): np.stack([progress(100, 0.8), progress(60, 0.3), progress(100, 0.9)]),
    }
    line, cut = by_world.warnings_of(episodes, known)
    assert "1 of 3 episodes were cut short" in cut
    equal = (95 * 0.8 + 57 * 0.3 + 95 * 0.9) / (95 * 0.4 + 57 * 0.41 + 95 * 0.42)
    assert "\n" not in line
    assert line.startswith("office#1: random against closest: outcomes differ in 1 of 3 pairs ")
    assert "(COMPLETE 2, STEP_LIMIT 1 against COMPLETE 3)" in line
    assert "explored fractions differ by more than 0.01 in 1 of 3 pairs (mean 0.850 against 1.000)" in line
    assert "path ratio 1.508 [" in line
    assert f"one of each pair knew) {equal:.3f} [" in line
    assert "over 3 pairs; where both" in line
    assert line.endswith("over 2 pairs")
    # The same without what was recorded on the way, and with the rows of a strategy in another order.
    assert "equal coverage" not in by_world.warnings_of(episodes)[0]
    mixed = pd.concat([episodes.iloc[:3], episodes.iloc[[5, 3, 4]]], ignore_index=True)
    known["office#1", "random"] = known["office#1", "random"][[2, 0, 1]]
    assert by_world.warnings_of(mixed, known)[0] == line


def test_complete_pairs_count_only_where_equally_explored():
    (line,) = by_world.warnings_of(both([10.0, 20.0, 30.0], [30.0, 20.0, 30.0], explored_fraction=[0.9, 1.0, 1.0]))
    assert line.startswith("office#1: random against closest: explored fractions differ by more than 0.01 in 1 of 3")
    assert line.endswith("at path_m_at_95, 1.000 over 2 pairs")


def test_a_reference_that_did_not_move_has_no_ratio():
    (line,) = by_world.warnings_of(both([0.0, 0.0], [1.0, 2.0], explored_fraction=[0.2, 0.3], start_col=4))[:1]
    assert "path ratio none, for the reference did not move; " in line


def test_unequal_coverage_without_a_comparable_pair():
    (line,) = by_world.warnings_of(both([10.0, 20.0], [1.0, 2.0], explored_fraction=[0.2, 0.3], outcome="BLOCKED"))
    assert line.endswith("at path_m_at_95, no pair to compare")
    blind = {("office#1", name): np.stack([progress(0), progress(1)]) for name in ("closest", "random")}
    (line,) = by_world.warnings_of(
        both([10.0, 20.0], [1.0, 2.0], explored_fraction=[0.2, 0.3], outcome="BLOCKED"), blind
    )
    assert line.count("no pair to compare") == 2
