"""Pictures of comparisons: what the artists hold, and that no two texts collide or leave the page."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from ref.figures import check_texts, shown
from ref.refusals import refused
from test_over_worlds import episodes, fail
from test_response import sweep

from jexplore.report.plots import compare, curves, looks
from jexplore.studies.statistics import by_world, figures, league

LONG = "decision-theoretic+recheck+segment:samples=500,lam=0.2"


@pytest.fixture
def ax():
    return Figure(figsize=(5, 4)).add_subplot()


def drawn(worlds, strategies, n=4, seed=0):
    rng = np.random.default_rng(seed)
    return episodes({(w, s): rng.gamma(9, 9 + k, n) for w in worlds for k, s in enumerate(strategies)})


def test_ratios_by_hand(ax):
    estimates = compare.Estimates(np.array([1.0, 0.8]), np.array([np.nan, 1e-6]), np.array([np.nan, 0.9]))
    reference, other = compare.draw_ratios(ax, estimates, list(looks.looks_of("ab").values()), [[], []])
    assert reference.lines[0].get_xydata().tolist() == [[1.0, 0.0]]
    assert not reference.lines[2]
    assert other.lines[0].get_xydata().tolist() == [[0.8, 1.0]]
    assert ax.get_xscale() == "log"
    (arrow,) = [line for line in ax.lines if line.get_marker() == "<"]  # the interval goes on beyond the axis
    assert arrow.get_xydata().tolist() == [[ax.get_xlim()[0], 1.0]]


def test_compare_figure_of_one_world():
    table = fail(drawn(["w"], ["z", "a", "m"]), "a", 1)
    figure = figures.compare_figure(table)
    left, right = shown(figure)
    assert left.get_title(loc="left") == "w"
    assert [label.get_text() for label in left.get_yticklabels()] == ["z", "a", "m"]
    assert right.get_xlabel() == "ratio to z"
    summary = by_world.summarise(table)
    for ax, key in ((left, "mean"), (right, "ratio")):
        assert [bar.lines[0].get_xdata().item() for bar in ax.containers] == pytest.approx(summary[key].tolist())
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert texts == ["an episode", "one that is not COMPLETE", "mean or ratio, 95 % interval"]
    assert [line.get_xdata().tolist() for line in left.lines if line.get_marker() == "x"] == [[], [1.0], []]
    check_texts(figure)


def test_compare_figure_has_all_worlds_first():
    worlds = ["cave#0", "cave#1", "maze", "maze#1", "maze#2", "maze#3"]
    table = drawn(worlds, ["z", "a"])
    figure = figures.compare_figure(table)
    axes = shown(figure)
    assert [ax.get_title(loc="left") for ax in axes[::2]] == [
        "over 6 worlds, which count the same", *worlds
    ]  # fmt: skip
    standings = league.standings(table).set_index("strategy")
    (better,) = axes[0].containers
    assert better.lines[0].get_xdata().item() == pytest.approx(100 * standings["shorter"]["a"])
    assert axes[1].containers[1].lines[0].get_xdata().item() == pytest.approx(standings["ratio"]["a"])
    assert [text.get_text() for text in axes[0].texts] == ["the reference"]
    dots = [line for line in axes[1].lines if line.get_marker() == "o" and len(line.get_xdata()) == 6]
    ratios = league.paths_by_world(table)
    np.testing.assert_allclose(dots[0].get_xdata(), np.exp(ratios["log_ratio"][ratios["strategy"] == "a"]))
    assert figure.legends[0].get_texts()[0].get_text() == "an episode or a world"
    check_texts(figure)


def test_a_strategy_that_did_not_run_in_a_world_leaves_its_row_empty():
    table = drawn(["v", "w"], ["z", "a", "m"])
    table = table[~((table["world"] == "w") & (table["strategy"] == "a"))]
    *_, left, right = shown(figures.compare_figure(table))
    assert [text.get_text() for text in left.texts] == ["no data"]
    assert len(left.containers) == len(right.containers) == 2


@pytest.mark.parametrize("length", [0.0, 1e5])
def test_compare_figure_of_odd_lengths_and_names(length):
    odd = "maps/$a_b$/an_extremely_long_folder_name_without_any_break/avz5floor_closed.yaml"
    table = episodes({(w, s): [length] * 3 for w in (odd, "x" * 90) for s in ("s" * 80, LONG, "$c$")})
    figure = figures.compare_figure(table)
    check_texts(figure)
    assert "$" in shown(figure)[0].get_title(loc="left")


def test_nothing_to_draw_is_refused():
    table = drawn(["w"], ["a"])
    refused("episodes must be one or more", figures.compare_figure, table.iloc[:0])
    refused("one world or more", figures.coverage_figure, {})


def test_progress_by_hand(ax):
    progress = np.array([[1.0, 2, 5, np.nan], [2.0, 4, np.nan, np.nan], [3.0, 6, 7, np.nan]])
    line = curves.draw_progress(ax, progress, looks.looks_of("a")["a"])
    np.testing.assert_array_equal(line.get_xydata(), [[2, 25], [4, 50], [7, 75], [np.nan, 100]])
    (band,) = ax.collections
    corners = {tuple(point) for point in band.get_paths()[0].vertices.tolist()}
    assert corners == {(1, 25), (2, 50), (6, 50), (3, 25)}  # a quarter never knew 75 %


def steps(strategies, n=5, seed=0, share=1.0):
    rng = np.random.default_rng(seed)
    found = {name: np.cumsum(rng.gamma(2, 1, (n, 100)), axis=1) for name in strategies}
    for progress in found.values():
        progress[:, int(100 * share) :] = np.nan
    return found


def test_coverage_figure():
    known = {("v", "a"): steps("a")["a"], ("v", "b"): steps("b", seed=1, share=0.5)["b"], ("w", "b"): steps("b")["b"]}
    figure = figures.coverage_figure(known)
    left, right = shown(figure)
    assert (left.get_title(), right.get_title()) == ("v", "w")
    assert len(left.lines) == 2
    np.testing.assert_allclose(left.lines[0].get_xdata(), np.median(known["v", "a"], axis=0))
    assert np.isfinite(left.lines[1].get_xdata()).sum() == 50
    assert left.lines[1].get_color() == right.lines[0].get_color()
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["a", "b"]
    check_texts(figure)


def test_coverage_of_what_was_known_at_the_start_and_of_nothing():
    known = {("v", "a"): np.zeros((3, 100)), ("w", "a"): np.full((3, 100), np.nan)}
    figure = figures.coverage_figure(known)
    assert [ax.texts[0].get_text() for ax in shown(figure)] == ["all was known at the start", "no data"]
    check_texts(figure)


def test_wrong_settings_are_refused():
    table = sweep()
    refused(r"unknown column of the episodes: .*lidar\.range_m", figures.response_figure, table, "lidar.rang_m")
