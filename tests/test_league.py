"""Strategies over many worlds: ratios, ranks and intervals by hand, and the table."""

import json
import math

import numpy as np
import pandas as pd
import pytest

from jexplore.cli import main
from jexplore.policies import parse_strategy
from jexplore.report import plot_league
from jexplore.studies.league import LEAGUE_STRATEGIES, kind_of, league_worlds, standings, standings_table


def episodes(paths):
    """A table of episodes: `{(world, strategy): path lengths}`."""
    rows = [
        {"world": world, "strategy": strategy, "episode": i, "path_m": path, "outcome": "COMPLETE"}
        for (world, strategy), all_ in paths.items()
        for i, path in enumerate(all_)
    ]
    return pd.DataFrame(rows)


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
    assert table.loc["c", "ratio_low"] >= 1


def test_starts_that_only_one_has_do_not_count():
    table = standings(episodes({("w", "a"): [10.0, 99.0], ("w", "b"): [20.0]})).set_index("strategy")
    assert table.loc["b", "ratio"] == pytest.approx(2)


def test_worlds_that_were_seen_from_the_start_do_not_count():
    paths = {("v", "a"): [0.0], ("v", "b"): [1.0], ("w", "a"): [10.0], ("w", "b"): [20.0]}
    table = standings(episodes(paths)).set_index("strategy")
    assert (table.loc["b", "worlds"], table.loc["b", "ratio"]) == (1, pytest.approx(2))
    nothing = standings(episodes({("v", "a"): [0.0], ("v", "b"): [0.0]}))
    assert nothing["ratio"].isna().all()
    assert "- " in standings_table(nothing)
    plot_league.figure(nothing)


@pytest.mark.jit
def test_the_league_with_worlds_and_strategies_of_ones_own(tmp_path, capsys):
    out = tmp_path / "league"
    worlds = ["cave:width_m=6.4,height_m=6.4", "cave#1:width_m=6.4,height_m=6.4"]
    strategies = ["closest", "closest+recheck"]
    more = ["--worlds", *worlds, "--strategies", *strategies, "--episodes", "2", "--out", str(out)]
    assert main.main(["compare", "--league", *more]) == 0
    assert {p.name for p in out.iterdir()} == {"episodes.parquet", "league.png", "run.json"}
    record = json.loads((out / "run.json").read_text())
    assert record["configuration"]["worlds"] == worlds
    assert set(record["plan_ms"]) == set(strategies)
    assert record["standings"][0]["strategy"] in strategies
    assert "ms a plan" in capsys.readouterr().out


def test_the_interval_holds_the_ratio_and_does_not_depend_on_the_order_of_worlds():
    rng = np.random.default_rng(0)
    paths = {(f"cave#{i}", s): rng.uniform(10, 20, 3) * f for i in range(12) for s, f in (("a", 1), ("b", 0.8))}
    table = standings(episodes(paths)).set_index("strategy")
    row = table.loc["b"]
    assert row["ratio_low"] < row["ratio"] < row["ratio_high"] < 1
    again = standings(episodes(dict(reversed(list(paths.items()))))).set_index("strategy")
    assert again.loc["a", "ratio"] == pytest.approx(1 / row["ratio"])


@pytest.mark.parametrize(
    ("world", "kind"),
    [("cave", "cave"), ("cave#3", "cave"), ("office:width_m=4", "office"), ("maps/a.png@0.05", "maps/a.png@0.05")],
)
def test_kinds(world, kind):
    assert kind_of(world) == kind


def test_the_league_has_eight_worlds_of_five_kinds_and_strategies_that_parse():
    worlds = league_worlds()
    assert len(set(worlds)) == 40
    assert {kind_of(w) for w in worlds} == {"cave", "office", "hospital", "maze", "rooms"}
    assert len({parse_strategy(name).name for name in LEAGUE_STRATEGIES}) == len(LEAGUE_STRATEGIES)


def test_the_table_and_the_picture():
    table = standings(episodes({("cave#0", "a"): [10.0, 30.0], ("cave#0", "b+c"): [5.0, 5.0]}))
    text = standings_table(table, {"a": 1.5})
    assert "| b+c" in text
    assert "1.50" in text
    assert "1 of 1" in text
    assert "ms a plan" not in standings_table(table)
    page = plot_league.figure(table)
    assert [t.get_text() for t in page.axes[0].get_yticklabels()] == ["b+c", "a"]
