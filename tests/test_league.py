"""Strategies over many worlds: ratios, ranks and intervals by hand, and the table."""

import json
import math

import numpy as np
import pytest
from ref.refusals import refused
from scipy import stats as scipy_stats
from test_over_worlds import episodes

from jexplore.cli import main
from jexplore.policies import parse_strategy
from jexplore.report.plots.compare import league_figure
from jexplore.studies.statistics.league import LEAGUE_STRATEGIES, league_worlds, standings, standings_table
from jexplore.studies.statistics.over_worlds import kind_of, mean_over_worlds
from jexplore.studies.statistics.paired import holm
from jexplore.worlds import load_world


def test_ratios_and_ranks_by_hand():
    table = standings(
        episodes(
            {
                ("cave#0", "a"): [10.0, 30.0], ("cave#0", "b"): [5.0, 5.0], ("cave#0", "c"): [40.0, 40.0],
                ("maze#1", "a"): [10.0, 10.0], ("maze#1", "b"): [40.0, 40.0], ("maze#1", "c"): [10.0, 10.0],
            }
        )
    ).set_index("strategy")  # fmt: skip
    # a is the reference; b: 1/4 and 4, whose geometric mean is 1; c: 2 and 1.
    assert table.loc["a", "ratio"] == 1
    assert table.loc["b", "ratio"] == pytest.approx(1)
    assert table.loc["c", "ratio"] == pytest.approx(math.sqrt(2))
    assert (table.loc["b", "ratio of cave"], table.loc["b", "ratio of maze"]) == pytest.approx((0.25, 4))
    assert table.loc["a", "rank"] == pytest.approx((2 + 1.5) / 2)  # shared first in the maze
    assert (table.loc["b", "rank"], table.loc["c", "rank"]) == (2, pytest.approx((3 + 1.5) / 2))
    assert table["best"].to_dict() == {"a": 1, "b": 1, "c": 1}
    assert table.index[-1] == "c"
    assert math.isnan(table.loc["a", "ratio_low"])
    # Two worlds of two kinds count as one kind: logarithms of 2 and 1, one degree of freedom.
    error = math.log(2) / 2
    t = scipy_stats.t(1)
    assert table.loc["c", "ratio_high"] == pytest.approx(math.sqrt(2) * math.exp(t.ppf(0.975) * error))
    assert table.loc["c", "p"] == pytest.approx(2 * t.sf(1.0))
    assert table.loc["c", "p_holm"] == pytest.approx(min(1, 2 * 2 * t.sf(1.0)))  # the less likely of two hypotheses


def test_an_episode_that_saw_less_than_others_did_is_no_short_one():
    paths = {(f"cave#{i}", s): [10.0 + i, 12.0] for i in range(4) for s in ("a", "b", "c")}
    table = episodes(paths)
    short = (table["strategy"] == "b").to_numpy()
    table.loc[short, ["path_m", "outcome", "explored_fraction"]] = [1.0, "STEP_LIMIT", 0.3]
    cut = (table["strategy"] == "c").to_numpy()  # hardly anything was left to see, but it takes long
    table.loc[cut, ["path_m", "outcome", "explored_fraction"]] = [9.0, "STEP_LIMIT", 0.995]
    found = standings(table).set_index("strategy")
    assert list(found.index) == ["a", "b", "c"]
    assert found["rank"].tolist() == [1, 2.5, 2.5]
    assert found["failed"].tolist() == [0, 1, 1]
    assert found["complete"].tolist() == [1, 0, 0]
    assert found["ratio"].isna().tolist() == [False, True, True]
    assert found[["worlds", "paired", "best"]].to_numpy().tolist() == [[4, 4, 4], [4, 0, 0], [4, 0, 0]]
    # Where nobody sees all, those that see as much as anybody have not failed.
    table.loc[(table["strategy"] == "a").to_numpy(), ["outcome", "explored_fraction"]] = ["BLOCKED", 1.0]
    found = standings(table).set_index("strategy")
    assert found["failed"].to_dict() == {"a": 0, "b": 1, "c": 0}
    assert found.loc["c", "ratio"] < 1
    assert list(found.index) == ["c", "a", "b"]
    # From half of the starts only: the ratio is over the others.
    table.loc[(table["strategy"] == "a").to_numpy(), "outcome"] = "COMPLETE"
    table.loc[short & (table["episode"] == 0), ["path_m", "outcome", "explored_fraction"]] = [20.0, "COMPLETE", 1.0]
    half = standings(table).set_index("strategy").loc["b"]
    assert (half["failed"], half["paired"]) == (0.5, 4)
    assert half["ratio"] == pytest.approx(np.prod([20 / (10 + i) for i in range(4)]) ** 0.25)


def test_worlds_without_a_ratio_and_tables_without_a_row():
    table = episodes({("v", "a"): [0.0], ("v", "b"): [0.0]})
    found = standings(table)
    assert found["ratio"].isna().all()
    text = standings_table(found)
    assert "nan" not in text
    assert " - " in text
    league_figure(found)


def test_strata():
    """Two kinds that differ much, with worlds of each that differ little: the interval is that of the kinds' mean."""
    values, kinds = [1.0, 1.2, 5.0, 5.4], ["x", "x", "y", "y"]
    mean, low, high, p = mean_over_worlds(values, kinds)
    squares = np.array([np.var([1.0, 1.2], ddof=1), np.var([5.0, 5.4], ddof=1)]) * 2 / 16
    freedom = squares.sum() ** 2 / (squares**2).sum()
    t = scipy_stats.t(freedom)
    assert mean == pytest.approx(3.15)
    assert high - mean == pytest.approx(t.ppf(0.975) * math.sqrt(squares.sum()))
    assert low + high == pytest.approx(2 * mean)
    assert p == pytest.approx(2 * t.sf(mean / math.sqrt(squares.sum())))
    plain = scipy_stats.ttest_1samp(values, 0.0)
    for one in (["x"] * 4, ["x", "x", "x", "y"]):
        assert mean_over_worlds(values, one)[3] == pytest.approx(plain.pvalue)


def test_what_cannot_be_told_from_the_reference_is_called_so():
    rng = np.random.default_rng(1)
    paths = {(f"cave#{i}", "a"): [10.0] for i in range(10)}
    for name, factor in (("short", 0.8), ("long", 1.3), ("alike", 1.0)):
        paths |= {(f"cave#{i}", name): [10 * factor * rng.normal(1, 0.05)] for i in range(10)}
    rows = dict(line.split("|")[1:5:3] for line in standings_table(standings(episodes(paths))).splitlines()[2:])
    told = {name.strip(): text.strip() for name, text in rows.items()}
    assert told == {"a": "-", "short": "shorter", "long": "longer", "alike": "not distinguishable"}


def test_worlds_that_were_seen_from_the_start_do_not_count():
    paths = {("v", "a"): [0.0], ("v", "b"): [1.0], ("w", "a"): [10.0], ("w", "b"): [20.0]}
    table = standings(episodes(paths)).set_index("strategy")
    assert (table.loc["b", "worlds"], table.loc["b", "paired"], table.loc["b", "ratio"]) == (2, 1, pytest.approx(2))


@pytest.mark.jit
def test_the_league_with_worlds_and_strategies_of_ones_own(tmp_path, capsys):
    out = tmp_path / "league"
    worlds = ["cave:width_m=6.4,height_m=6.4", "cave#1:width_m=6.4,height_m=6.4"]
    strategies = ["closest", "closest+recheck"]
    more = ["--worlds", *worlds, "--strategies", *strategies, "--episodes", "2", "--out", str(out)]
    assert main.main(["compare", "--league", *more]) == 0
    pictures = {f"{name}.{kind}" for name in ("coverage", "league") for kind in ("png", "svg")}
    tables = {"details.parquet", "episodes.parquet"}
    assert {p.name for p in out.iterdir()} == pictures | tables | {"report.html", "run.json"}
    record = json.loads((out / "run.json").read_text())
    assert record["configuration"]["worlds"] == worlds
    assert record["standings"][0]["strategy"] in strategies
    assert "mean rank" in capsys.readouterr().out


def test_the_league_has_eight_worlds_of_six_kinds_and_strategies_that_parse():
    worlds = league_worlds()
    assert len(set(worlds)) == 48
    assert league_worlds(0.25) == worlds[:40]
    assert len(league_worlds(seeds=40)) == 240
    assert set(worlds) < set(league_worlds(seeds=40))
    refused("league_seeds must be an integer from 1", league_worlds, seeds=0)
    for name in worlds[-3:]:
        load_world(name, 0.2)
    kinds = [kind_of(w) for w in worlds]
    assert {kind: kinds.count(kind) for kind in kinds} == dict.fromkeys(
        ("cave", "office", "hospital", "maze", "rooms", "furnished"), 8
    )
    assert len({parse_strategy(name).name for name in LEAGUE_STRATEGIES}) == len(LEAGUE_STRATEGIES)


def test_holm_by_hand():
    np.testing.assert_allclose(holm([0.01, 0.04, 0.03, math.nan]), [0.03, 0.06, 0.06, math.nan])
    np.testing.assert_allclose(holm([0.5, 0.6]), [1.0, 1.0])
    assert np.isnan(holm([math.nan])).all()
