"""Statistics: by hand, against scipy, by laws, and on bad input."""

import math
import sys
import warnings

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats as scipy_stats

from jexplore.config import InputError
from jexplore.studies import stats

QUICK = {"n_resamples": 499}
VECTORS = st.lists(st.floats(0.5, 1000.0), min_size=2, max_size=12)


def table(**columns):
    """Episodes of one world, by default COMPLETE ones of `closest`, numbered from 0; `columns` replace the defaults."""
    n = max(len(value) for value in columns.values() if isinstance(value, (list, np.ndarray)))
    path_m = np.asarray(columns.get("path_m", np.full(n, 10.0)), dtype=np.float64)
    marks = {f"path_m_at_{mark}": path_m * mark / 100 for mark in (50, 90, 95, 99)}
    start = {"seed": 0, "start_row": 3, "start_col": 4, "start_heading_deg": 90}
    counts = {"turning_rad": 1.5, "steps": 100, "scans": 104, "plans": 7, "exhausted": 0}
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
    first, second = stats.summarise(episodes).itertuples(index=False)
    assert (first.world, first.strategy, first.n, first.mean, first.sd) == ("office#1", "closest", 3, 20.0, 10.0)
    assert first.ratio == 1.0
    assert np.isnan([first.ratio_low, first.ratio_high, first.p, first.room_entries]).all()
    assert (second.mean, second.sd, second.plans, second.scans, second.turning_rad) == (40.0, 20.0, 3.0, 104.0, 1.5)
    assert (second.ratio, second.ratio_low, second.ratio_high) == (2.0, 2.0, 2.0)  # twice as long in every pair
    assert second.p == 0.25  # three differences of one sign: 2 / 2^3
    assert (first.outcomes, second.outcomes) == ("COMPLETE 3", "COMPLETE 2, BLOCKED 1")


def test_interval_of_two_values_is_their_range():
    assert stats.bootstrap_ci([4.0, 8.0]) == (4.0, 8.0)


def test_interval_of_one_value_and_of_equal_values():
    assert np.isnan(stats.bootstrap_ci([5.0])).all()
    assert stats.bootstrap_ci([5.0, 5.0, 5.0]) == (5.0, 5.0)


def test_interval_is_that_of_scipy():
    values = np.sort(np.random.default_rng(1).gamma(2.0, 10.0, 25))
    expected = scipy_stats.bootstrap(
        (values,), np.mean, n_resamples=999, rng=np.random.default_rng(7)
    ).confidence_interval
    assert stats.bootstrap_ci(values, n_resamples=999, seed=7) == pytest.approx(tuple(expected), rel=1e-9)


def test_interval_leans_to_the_long_tail():
    values = np.array([1.0] * 15 + [2.0] * 4 + [9.0])
    low, high = stats.bootstrap_ci(values)
    assert high - values.mean() > 1.5 * (values.mean() - low)


def test_p_is_that_of_scipy():
    rng = np.random.default_rng(2)
    a, b = rng.normal(10.0, 1.0, 30), rng.normal(10.5, 1.0, 30)
    assert stats.paired_ratio(a, b, **QUICK).p == pytest.approx(scipy_stats.wilcoxon(a, b).pvalue, rel=1e-12)


def test_equal_pairs_speak_against_a_difference():
    a, b = np.arange(1.0, 9.0), np.arange(1.0, 9.0)
    a[:5] += [1.0, 2.0, 3.0, 4.0, -5.0]
    with_zeros = stats.paired_ratio(a, b, **QUICK).p
    assert with_zeros == pytest.approx(scipy_stats.wilcoxon(a - b, zero_method="pratt").pvalue)
    assert with_zeros != scipy_stats.wilcoxon(a - b, zero_method="wilcox").pvalue


def test_rounding_does_not_break_ties():
    b = np.array([0.1, 0.7, 1.3, 2.9, 4.1, 5.3])
    a = b + np.array([0.2, 0.2, 0.2, -0.2, -0.2, -0.2])  # equal sizes up to rounding: no evidence at all
    assert len(set(np.abs(a - b))) > 1
    assert stats.paired_ratio(a, b, **QUICK).p == 1.0


def test_interval_covers_the_mean_about_as_often_as_promised():
    rng = np.random.default_rng(0)
    hits = 0
    for _ in range(120):
        low, high = stats.bootstrap_ci(rng.exponential(1.0, 30), n_resamples=399, confidence=0.9)
        hits += low <= 1.0 <= high
    assert 0.80 <= hits / 120 <= 0.97


def test_ratio_interval_covers_the_ratio_and_gains_from_pairing():
    rng = np.random.default_rng(3)
    hits, widths, unpaired = 0, [], []
    for _ in range(60):
        b = rng.gamma(9.0, 10.0, 25)
        a = 0.8 * b + rng.normal(0.0, 3.0, 25)
        found = stats.paired_ratio(a, b, n_resamples=399)
        hits += found.low <= 0.8 <= found.high
        widths.append(found.high - found.low)
        shuffled = stats.paired_ratio(a, rng.permutation(b), n_resamples=399)
        unpaired.append(shuffled.high - shuffled.low)
    assert hits >= 51
    assert np.mean(widths) < 0.5 * np.mean(unpaired)


@settings(max_examples=40, deadline=None)
@given(VECTORS)
def test_interval_holds_the_mean_within_the_range(values):
    low, high = stats.bootstrap_ci(values, **QUICK)
    slack = 1e-9 * max(values)
    assert min(values) - slack <= low <= np.mean(values) + slack
    assert np.mean(values) - slack <= high <= max(values) + slack


@settings(max_examples=30, deadline=None)
@given(VECTORS, st.randoms(use_true_random=False), st.floats(0.1, 10.0))
def test_order_and_unit_do_not_matter(values, random, factor):
    values = np.asarray(values)
    order = np.array(random.sample(range(len(values)), len(values)))
    reference = values[::-1] + 1.0
    assert stats.bootstrap_ci(values[order], **QUICK) == stats.bootstrap_ci(values, **QUICK)
    found = stats.paired_ratio(values, reference, **QUICK)
    assert stats.paired_ratio(values[order], reference[order], **QUICK) == found
    scaled = stats.paired_ratio(values * factor, reference * factor, **QUICK)
    assert (scaled.ratio, scaled.low, scaled.high) == pytest.approx((found.ratio, found.low, found.high), rel=1e-6)
    assert found.low <= found.ratio <= found.high


@settings(max_examples=30, deadline=None)
@given(VECTORS)
def test_a_sample_against_itself(values):
    found = stats.paired_ratio(values, values, **QUICK)
    assert (found.ratio, found.low, found.high, found.p) == (1.0, 1.0, 1.0, 1.0)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(0.5, 1000.0), min_size=2, max_size=7))
def test_p_does_not_depend_on_which_is_the_reference(values):
    other = np.roll(values, 1)
    assert stats.paired_ratio(values, other, **QUICK).p == pytest.approx(stats.paired_ratio(other, values, **QUICK).p)


def test_one_and_two_pairs():
    one = stats.paired_ratio([3.0], [4.0])
    assert (one.ratio, one.n) == (0.75, 1)
    assert np.isnan([one.low, one.high, one.p]).all()
    two = stats.paired_ratio([2.0, 6.0], [4.0, 4.0])
    assert (two.ratio, two.low, two.high, two.p) == (1.0, 0.5, 1.5, 1.0)


def test_reference_of_zeros():
    none = stats.paired_ratio([0.0, 0.0], [0.0, 0.0])
    assert np.isnan([none.ratio, none.low, none.high]).all()
    assert none.p == 1.0
    some = stats.paired_ratio([1.0, 3.0], [0.0, 4.0])  # a quarter of the resamples divides by zero
    assert some.ratio == 1.0
    assert np.isnan([some.low, some.high]).all()


def test_no_warning_escapes():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for n in (1, 2, 3, 15):
            for values in (np.zeros(n), np.ones(n), np.arange(n), np.arange(n) % 2):
                stats.paired_ratio(values, np.arange(n)[::-1], **QUICK)
                stats.bootstrap_ci(values, **QUICK)
    assert caught == []


@pytest.mark.parametrize("values", [[], [1.0, math.nan], [[1.0, 2.0]], [math.inf, 1.0], 3.0])
def test_bad_vectors(values):
    with pytest.raises(ValueError, match="expected values as a vector"):
        stats.bootstrap_ci(values)
    with pytest.raises(ValueError, match="expected reference as a vector"):
        stats.paired_ratio([1.0, 2.0], values)


def test_bad_lengths_and_confidence():
    with pytest.raises(ValueError, match="got 2 and 3"):
        stats.paired_ratio([1.0, 2.0], [1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match="confidence"):
        stats.bootstrap_ci([1.0, 2.0], confidence=95)


def test_summary_keeps_the_order_given_and_pairs_by_episode():
    rng = np.random.default_rng(4)
    a, b = rng.normal(50.0, 5.0, 8), rng.normal(40.0, 5.0, 8)
    other_world = both(b, a)
    other_world["world"] = "cave#0"
    episodes = pd.concat([both(a, b), other_world], ignore_index=True)
    summary = stats.summarise(episodes, **QUICK)
    assert list(summary.columns) == list(stats.SUMMARY_COLUMNS)
    assert list(zip(summary["world"], summary["strategy"])) == [
        *(("office#1", "closest"), ("office#1", "random"), ("cave#0", "closest"), ("cave#0", "random"))
    ]
    expected = stats.paired_ratio(b, a, **QUICK)
    assert summary.loc[1, ["ratio", "ratio_low", "ratio_high", "p"]].tolist() == [
        *(expected.ratio, expected.low, expected.high, expected.p)
    ]
    within = np.concatenate([np.arange(8), 8 + rng.permutation(8), 16 + rng.permutation(8), 24 + rng.permutation(8)])
    pd.testing.assert_frame_equal(stats.summarise(episodes.iloc[within], **QUICK), summary, rtol=1e-12)


def test_summary_of_one_episode_one_strategy():
    row = next(stats.summarise(table(path_m=[12.5])).itertuples(index=False))
    assert (row.n, row.mean, row.ratio) == (1, 12.5, 1.0)
    assert np.isnan([row.sd, row.ci_low, row.ci_high, row.p]).all()


def test_summary_of_nothing():
    empty = table(path_m=[1.0]).iloc[:0]
    assert len(stats.summarise(empty)) == 0
    assert stats.warnings_of(empty) == []
    assert stats.markdown_table(stats.summarise(empty)).count("\n") == 2


def test_room_entries_average_over_known_ones():
    episodes = table(path_m=[1.0, 2.0, 3.0], room_entries=pd.array([4, pd.NA, 8], dtype="Int64"))
    assert stats.summarise(episodes)["room_entries"].tolist() == [6.0]


def test_world_without_the_first_strategy():
    episodes = both([10.0, 11.0], [12.0, 15.0])
    episodes.loc[episodes["strategy"] == "random", "world"] = "cave#0"
    assert math.isnan(stats.summarise(episodes)["ratio"][1])
    assert stats.warnings_of(episodes) == ["cave#0: no episode of closest, so nothing to compare with"]


def test_only_common_episodes_are_compared():
    episodes = both([10.0, 10.0, 10.0], [5.0, 20.0, 99.0], episode=[1, 2, 3])
    assert stats.summarise(episodes)["ratio"][1] == 1.25
    assert stats.warnings_of(episodes) == [
        "office#1: random against closest: 3 and 3 episodes make 2 pairs; only pairs are compared"
    ]
    apart = both([10.0, 10.0], [5.0, 20.0], episode=[7, 8])
    assert math.isnan(stats.summarise(apart)["ratio"][1])
    assert len(stats.warnings_of(apart)) == 1


def test_pairs_that_start_differently_are_refused():
    with pytest.raises(InputError, match=r"^office#1, random, episode 1: .*start_col is 9, not 4$"):
        stats.summarise(both([1.0, 2.0], [1.0, 2.0], start_col=[4, 9]))


def test_an_episode_that_occurs_twice_is_refused():
    with pytest.raises(InputError, match="episode 5 must occur once"):
        stats.summarise(table(path_m=[1.0, 2.0], episode=[5, 5]))


def test_markdown_whole():
    episodes = both([10.0, 20.0, 30.0], [20.0, 40.0, 60.0])
    text = stats.markdown_table(stats.summarise(episodes))
    lines = text.splitlines()
    assert len({len(line) for line in lines}) == 1
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    assert cells[0][:7] == ["world", "strategy", "n", "path m", "95 % interval", "ratio to the first", "p"]
    assert cells[2] == [
        *("office#1", "closest", "3", "20.00 ± 10.00", "[10.0, 30.0]", "1.000", "-"),
        *("7.0", "104.0", "1.5", "1.000", "0.0", "-", "COMPLETE 3"),
    ]
    assert cells[3][3:7] == ["40.00 ± 20.00", "[20.0, 60.0]", "2.000 [2.000, 2.000]", "0.250"]
    assert set(lines[1]) == set("|-: ")


def test_markdown_small_p_missing_sd_and_bars_in_names():
    rng = np.random.default_rng(5)
    a = rng.normal(100.0, 0.1, 20)
    summary = stats.summarise(both(a, a * 1.5 + rng.normal(0, 0.1, 20)).assign(world="a|b"), **QUICK)
    text = stats.markdown_table(summary, confidence=0.9)
    assert "<0.001" in text
    assert "a\\|b" in text
    assert "90 % interval" in text
    assert "[99.9" in text  # narrow intervals have two decimals
    assert "nan" not in stats.markdown_table(stats.summarise(table(path_m=[12.5])))


def test_path_at_fraction_by_hand():
    episodes = table(
        path_m=[100.0] * 5,
        explored_fraction=[1.0, 0.5, 1.0, 0.0, 0.4],
        **{"path_m_at_50": 10.0, "path_m_at_90": 50.0, "path_m_at_95": 70.0, "path_m_at_99": 90.0},
    )
    got = stats.path_at_fraction(episodes, np.array([0.70, 0.475, 0.49, 0.1, 0.4]))
    np.testing.assert_allclose(got, [30.0, 70.0, np.nan, np.nan, np.nan], rtol=1e-12)


def test_no_warning_where_all_ended_alike():
    assert stats.warnings_of(both([10.0, 20.0], [12.0, 30.0], explored_fraction=[1.0, 0.995])) == []


def test_truncated_paths_are_compared_at_equal_coverage():
    # `random` stops at half the coverage of episode 1 after 20 m; `closest` knew as much after 6 m.
    episodes = pd.concat(
        [
            table(path_m=[40.0, 40.0, 40.0], path_m_at_50=5.0, path_m_at_90=21.0, path_m_at_95=23.0),
            table(
                strategy="random",
                path_m=[80.0, 20.0, 80.0],
                explored_fraction=[1.0, 0.55, 1.0],
                outcome=["COMPLETE", "STEP_LIMIT", "COMPLETE"],
                path_m_at_95=[46.0, 18.0, 46.0],
            ),
        ],
        ignore_index=True,
    )
    line, cut = stats.warnings_of(episodes)
    assert "1 of 3 episodes were cut short" in cut
    level = 0.95 * 0.55
    at_level = 5.0 + (level - 0.5) / 0.4 * 16.0
    equal = (46 + 18 + 46) / (23 + at_level + 23)
    assert "\n" not in line
    assert line.startswith("office#1: random against closest: outcomes differ in 1 of 3 pairs ")
    assert "(COMPLETE 2, STEP_LIMIT 1 against COMPLETE 3)" in line
    assert "explored fractions differ by more than 0.01 in 1 of 3 pairs (mean 0.850 against 1.000)" in line
    assert "path ratio 1.500 [" in line
    assert f"of each pair) {equal:.3f} [" in line
    assert line.endswith("at path_m_at_95, 2.000 [2.000, 2.000] over 2 pairs")


def test_complete_pairs_count_only_where_equally_explored():
    (line,) = stats.warnings_of(both([10.0, 20.0, 30.0], [30.0, 20.0, 30.0], explored_fraction=[0.9, 1.0, 1.0]))
    assert line.startswith("office#1: random against closest: explored fractions differ by more than 0.01 in 1 of 3")
    assert line.endswith("at path_m_at_95, 1.000 [1.000, 1.000] over 2 pairs")


def test_unequal_coverage_without_a_comparable_pair():
    (line,) = stats.warnings_of(both([10.0, 20.0], [1.0, 2.0], explored_fraction=[0.2, 0.3], outcome="BLOCKED"))
    assert line.count("no pair to compare") == 2


def test_import_is_light():
    import subprocess

    code = "import sys, jexplore.studies.stats; print(sorted({'pandas', 'scipy.stats', 'jax'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
