"""Comparisons that end when they are decided."""

import math

import numpy as np
import pandas as pd
import pytest
from ref.refusals import refused

import jexplore as jx
from jexplore.studies.statistics import sequential
from jexplore.studies.statistics.paired import paired_ratio

ROOMS = "rooms#{}:width_m=8,height_m=6"


def test_the_boundary_by_hand():
    """At 30 values, where it is tightest: rho^2 n is 2 ln 20 + ln(1 + 2 ln 20)."""
    rho2 = 2 * math.log(20) + math.log(1 + 2 * math.log(20))
    wanted = math.sqrt(2 * (rho2 + 1) / rho2 * math.log(math.sqrt(rho2 + 1) / 0.05))
    assert sequential.boundary(30) == pytest.approx(wanted)
    widths = [sequential.boundary(n) / math.sqrt(n) for n in range(1, 500)]
    assert widths == sorted(widths, reverse=True)
    assert all(sequential.boundary(30) <= sequential.boundary(n) for n in (10, 20, 40, 100))
    assert sequential.boundary(30, 0.01) > sequential.boundary(30)


def test_the_interval_is_wider_than_that_of_a_fixed_number():
    draw = np.random.default_rng(0)
    reference = draw.uniform(50, 100, 40)
    values = reference * draw.uniform(0.8, 1.1, 40)
    found, fixed = sequential.anytime_ratio(values, reference), paired_ratio(values, reference)
    assert found.ratio == fixed.ratio
    assert found.low < fixed.low < fixed.high < found.high
    assert math.log(found.high / found.ratio) == pytest.approx(math.log(found.ratio / found.low))
    assert math.isnan(sequential.anytime_ratio([1.0, 1.0], [1.0, 1.0]).low)
    assert math.isnan(sequential.anytime_ratio([1.0], [2.0]).low)


@pytest.mark.parametrize(
    ("low", "high", "verdict"),
    [(0.8, 0.99, "shorter"), (1.01, 1.2, "longer"), (0.9, 1.1, "undecided"), (0.985, 1.02, "known to 2 %")],
)
def test_verdicts(low, high, verdict):
    found = paired_ratio([1.0, 2.0], [2.0, 3.0])._replace(low=low, high=high)
    assert sequential.verdict_of(found) == verdict
    assert sequential.verdict_of(found._replace(low=math.nan, high=math.nan)) == "undecided"


def table(world, strategy, paths):
    return pd.DataFrame({"world": world, "strategy": strategy, "episode": range(len(paths)), "path_m": paths})


def test_a_world_is_settled_once_all_its_strategies_are():
    draw = np.random.default_rng(1)
    long = draw.uniform(90, 110, 60)
    factors = {"first": 1.0, "half": draw.uniform(0.4, 0.6, 60), "same": draw.uniform(0.97, 1.03, 60)}
    near = [table("a", name, long * factor) for name, factor in factors.items()]
    assert sequential.decided_worlds([*factors])(near[:2]) == set()
    assert sequential.decided_worlds([*factors][:2])(near[:2]) == {"a"}
    assert sequential.decided_worlds([*factors])([one.head(9) for one in near]) == set()
    # A unit that is half done does not change the reference, and its episodes do not count.
    late = sequential.decisions(pd.concat([near[1], near[2], near[0].head(40)]), [*factors])
    assert late[["strategy", "n"]].to_numpy().tolist() == [["half", 40], ["same", 40]]
    found = sequential.decisions(pd.concat(near)).set_index("strategy")
    assert found["verdict"].to_dict() == {"half": "shorter", "same": "known to 2 %"}
    text = sequential.decisions_text(pd.concat(near), 1000)
    assert text.startswith("\nDecided after 180 of 1000 episodes, 820 spared.")


@pytest.mark.jit
def test_a_comparison_ends_when_it_is_decided(tmp_path):
    """The episodes that it makes are the first of those of a whole one."""
    worlds, strategies = [ROOMS.format(i) for i in (1, 2)], ["closest+recheck", "random"]
    found = jx.compare(worlds, strategies, episodes=200, until="decided", out=tmp_path / "run")
    n = found.decisions.set_index("world")["n"]
    assert n.min() < 200
    assert n[found.decisions.set_index("world")["verdict"] == "undecided"].eq(200).all()
    assert found.spared + len(found.episodes) == 800
    assert found.spared == 800 - 2 * n.sum()
    assert found.interrupted == 0
    whole = jx.compare(worlds, strategies, episodes=int(n.max()))
    both = whole.episodes.merge(found.episodes, on=["world", "strategy", "episode"])
    assert len(both) == len(found.episodes)
    np.testing.assert_array_equal(both["path_m_x"], both["path_m_y"])
    again = jx.compare(worlds, strategies, episodes=200, until="decided", out=tmp_path / "run", resume=True)
    pd.testing.assert_frame_equal(again.episodes, found.episodes)


@pytest.mark.jit
def test_the_command_says_what_was_spared(tmp_path, printed):
    command = ["compare", "--worlds", ROOMS.format(1), "--strategies", "closest", "random", "--episodes", "100"]
    command += ["--until", "decided", "--out", str(tmp_path / "run"), "--no-report"]
    first = printed(command).out
    assert "episodes, " in first
    assert "spared. Intervals (95 % for each world) hold although" in first
    assert first.split("Decided after")[1].split("\n\n")[0] in printed([*command, "--resume"]).out


def test_other_ends_are_refused():
    refused(r"^until must be None or 'decided', got 'bored'$", jx.compare, "cave", "closest", until="bored")
    refused(r"^until must be None or 'decided'", sequential.require_until, np.array([1, 2]))
