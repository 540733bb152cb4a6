"""Comparisons: the table, its order and pairing, effects of a larger or smaller run, and refusals."""

import dataclasses
import math

import numpy as np
import pytest
from matplotlib.figure import Figure
from ref.refusals import refused
from ref.results import result
from ref.worlds import two_rooms

from jexplore.config import InputError
from jexplore.engine.runner import Costs
from jexplore.exploration import batch
from jexplore.exploration.trail import Final
from jexplore.rules import Lidar, Rules
from jexplore.studies import checks
from jexplore.studies.checks import prepare_jobs
from jexplore.studies.comparison import compare
from jexplore.studies.results import comparison
from jexplore.studies.results.columns import COLUMNS
from jexplore.studies.results.comparison import assemble
from jexplore.studies.results.units import Block, Ran, block_table
from jexplore.studies.statistics import by_world, coverage, league

LIDAR = Lidar(n_beams=37, range_m=1.0)


SMALL = "cave:width_m=6,height_m=6"


def room_world(**fields):
    world = two_rooms("with rooms/two rooms", door=7)
    rooms = np.where(world.occupied, -1, np.arange(world.shape[1])[None] > 17).astype(np.int32)
    return world.replace(rooms=rooms, **fields)


@pytest.fixture(scope="module")
def found(jit_on):
    progress = []
    with jit_on():
        comparison = compare(
            [two_rooms(), room_world(start=(5, 5, 90))],
            ["closest", "random", "closest+recheck"],
            episodes=4,
            seed=3,
            lidar=LIDAR,
            on_progress=progress.append,
        )
    assert progress[-1] == 24
    return comparison


def test_rows_are_ordered_and_paired(found):
    table = found.to_pandas()
    assert list(table.columns) == list(COLUMNS)
    assert table["world"].tolist() == ["two rooms"] * 12 + ["with rooms/two rooms"] * 12
    assert table["strategy"].tolist() == (["closest"] * 4 + ["random"] * 4 + ["closest+recheck"] * 4) * 2
    assert table["episode"].tolist() == [0, 1, 2, 3] * 6
    assert set(table["seed"]) == {3}
    starts = table[["start_row", "start_col", "start_heading_deg"]].to_numpy().reshape(2, 3, 4, 3)
    assert (starts == starts[:, :1]).all()
    assert len({tuple(start) for start in starts[0, 0]}) == 4


def test_room_entries_are_null_without_rooms(found):
    table = found.to_pandas()
    assert str(table["room_entries"].dtype) == "Int64"
    assert table["room_entries"][:12].isna().all()
    assert (table["room_entries"][12:] >= 2).all()


@pytest.mark.jit
def test_the_same_plan_with_and_without_labels_is_explored_alike(found):
    """From the same starts: folders do not count in what a world is called."""
    labelled = room_world(occupied=two_rooms().occupied)
    other = compare(labelled, "closest", episodes=4, seed=3, lidar=LIDAR).to_pandas()
    own = found.to_pandas()[:4]
    assert other.drop(columns=["world", "room_entries"]).equals(own.drop(columns=["world", "room_entries"]))


def test_summary_markdown_and_warnings(found):
    more = coverage.coverage_text(found.at_coverage)
    assert found.to_markdown() == found._repr_markdown_()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(comparison, "MIN_PAIRS", 2)  # of worlds, before anything is said of all of them
        text = found.to_markdown()
    assert text.endswith(f"\nIn each world:\n\n{by_world.markdown_table(found.summary)}\n{more}")
    assert text.startswith("Over 2 worlds, ")
    assert league.standings_table(found.standings) in text
    assert found.warnings == by_world.warnings_of(found.episodes, found.progress)
    assert found.episodes_per_s == pytest.approx(24 / found.run_s)
    assert "3 strategies in 2 worlds, 24 episodes" in repr(found)


def test_figures(found):
    ax = Figure().add_subplot()
    assert found.plot(ax, "with rooms/two rooms") is ax
    bars = ax.containers
    assert [bar.lines[0].get_xdata().item() for bar in bars] == found.summary["mean"][3:].tolist()
    assert found.plot().containers[0].lines[0].get_xdata().item() == found.summary["mean"][0]
    assert len(found.compare_figure().axes) == 4  # of each world paths and ratios
    assert len(found.coverage_figure().axes) == 2
    assert len(found.paths_figure().axes) == 7  # two worlds of three strategies, and the colour bar
    refused(r"unknown world of this comparison: 'x' \(there are: two rooms, with", found.plot, ax, "x")


def test_the_picture_of_a_path_is_that_of_episode_0(found):
    for world, panels in found.first.items():
        for seen in panels:
            table = found.episodes
            row = table[
                (table["world"] == world) & (table["strategy"] == seen.strategy) & (table["episode"] == 0)
            ].iloc[0]
            assert (seen.rows[0], seen.cols[0]) == (row["start_row"], row["start_col"])
            assert len(seen.rows) == row["steps"] + 1
            assert seen.path_m == row["path_m"]
            steps = np.hypot(np.diff(seen.rows), np.diff(seen.cols))
            assert steps.sum() * seen.cell_m == pytest.approx(row["path_m"])


@pytest.mark.jit
def test_start_of_the_world(found):
    table = compare(room_world(start=(5, 5, 90)), "random", episodes=2, start="world", lidar=LIDAR).to_pandas()
    assert table[["start_row", "start_col", "start_heading_deg"]].to_numpy().tolist() == [[5, 5, 90]] * 2
    assert table["path_m"][0] != table["path_m"][1]  # equal starts, different draws


def stub(outcomes, missing=([], []), **fields):
    """A comparison of two strategies whose episodes are written by hand; some are missing of each."""
    world = two_rooms("stub", 4, 6, 0)
    jobs = prepare_jobs(
        world,
        ["closest", "random"],
        episodes=2,
        seed=0,
        cell_m=1,
        start="random",
        lidar=LIDAR,
        rules=Rules(clearance_m=0),
    )
    final = Final(*(np.zeros(world.shape, np.int32) for _ in range(2)), *(np.zeros(1, np.int32) for _ in range(4)), [])
    made = [batch.Outcomes(result(2, outcome=outcome, **fields), final) for outcome in outcomes]
    tables = [block_table(Block(i, 0, 2), job, one) for i, (job, one) in enumerate(zip(jobs, made))]
    tables = [table.drop(index=late) for table, late in zip(tables, missing)]
    return assemble(jobs, Ran(tables, Costs(compile_s=1.0, run_s=2.0), 0))


def test_a_comparison_by_hand(tmp_path):
    found = stub([[1, 1], [1, 1]], straight=[10, 20])
    refused(r"only what jx\.compare or jx\.load returned can be saved", found.save, tmp_path)
    assert found.to_pandas()["path_m"].tolist() == pytest.approx([1.0, 2.0, 1.0, 2.0])
    assert found.summary["mean"].tolist() == pytest.approx([1.5, 1.5])
    assert found.episodes_per_s == 2.0
    assert found.compile_s == 1.0


def test_of_an_interrupted_run_the_pairs_are_kept():
    found = stub([[1, 1], [1, 1]], [[1], []], straight=[10, 20])
    assert found.to_pandas()[["strategy", "episode"]].to_numpy().tolist() == [["closest", 0], ["random", 0]]
    assert found.interrupted == 2
    assert found.warnings == ["interrupted: 2 episodes are missing"]
    assert [seen.strategy for seen in found.first["stub"]] == ["closest", "random"]
    late = stub([[1, 1], [1, 1]], [[0], []])  # episode 0 is missing: no map to show
    assert (late.to_pandas()["episode"].tolist(), late.first) == ([1, 1], {})
    with pytest.raises(KeyboardInterrupt):
        stub([[1, 1], [1, 1]], [[0], [1]])


@pytest.mark.parametrize(
    ("worlds", "strategies", "options", "message"),
    [
        ([], "closest", {}, "worlds must name at least one"),
        ("cave", [], {}, "strategies must name at least one"),
        ([SMALL, SMALL.replace("cave", "cave#0")], "closest", {}, "'cave:.*' and 'cave#0:.*' are the same building"),
        ([two_rooms(), room_world().replace(occupied=two_rooms().occupied)], "closest", {}, "are the same building"),
        ("cave", "closest", {"episodes": 2.5}, "episodes must be an integer from 1"),
        ("cave", "closest", {"episodes": True}, "episodes must be an integer from 1"),
        ("cave", "closest", {"seed": 2**32}, "seed must be an integer from 0"),
        ("cave", "closest", {"cell_m": math.nan}, "cell_m must be a number"),
        ("cave", "closest", {"rules": Rules(clearance_m=2.9)}, "clearance"),
        (two_rooms(name=""), "closest", {}, "needs a name"),
        (room_world(start=(0, 5, 0)), "closest", {"start": "world"}, "lies in a wall"),
        (room_world(start=(5, 5, 30)), "closest", {"start": "world"}, "multiple of 45"),
    ],
)
def test_what_is_refused(worlds, strategies, options, message, monkeypatch):
    monkeypatch.setattr(batch, "run_jobs", lambda *_, **__: pytest.fail("ran"))
    refused(message, compare, worlds, strategies, **options)


def test_a_building_in_other_cells_or_on_other_ground_is_another():
    world = two_rooms()
    slope = np.tile(np.arange(world.shape[1], dtype=np.float32), (world.shape[0], 1))
    coarse, steep = world.replace(name="coarse", cell_m=0.2), world.replace(name="steep", elevation=slope)
    checks.require_different_buildings([world, coarse, steep])
    with pytest.raises(InputError, match="'coarse' and 'again' are the same building, which would count twice"):
        checks.require_different_buildings([world, coarse, coarse.replace(name="again")])


def test_what_does_not_fit_into_memory_is_refused(monkeypatch):
    world, rules = two_rooms(), Rules()
    need = checks.memory_needed(world, LIDAR, rules, 1)
    # Padded to 64 x 64, 20,000 steps; 8 headings of 37 beams of 24 steps.
    assert need == 120 * 64 * 64 + 32 * 20_000 + 64 * 8 * 37 * 24
    assert checks.memory_needed(world, LIDAR, rules, 2) > 1.5 * need
    assert checks.memory_needed(world, LIDAR, dataclasses.replace(rules, max_steps=2**24), 1) > 10 * need
    assert checks.memory_needed(world, Lidar(n_beams=4096, range_m=1000), rules, 1) > 2**30
    monkeypatch.setattr(checks, "_memory", lambda: need)
    refused("'two rooms': 24 x 36 cells and 37 beams of 1 m need about", compare, world, "closest", lidar=LIDAR)
    monkeypatch.setattr(checks, "_memory", lambda: None)
    checks.require_memory(world, LIDAR, rules)


def test_a_container_has_the_memory_of_its_limit(monkeypatch, tmp_path):
    (tmp_path / "memory.max").write_text("max\n")
    monkeypatch.setattr(checks, "LIMITS", (str(tmp_path / "memory.max"), str(tmp_path / "absent")))
    whole = checks._memory()
    (tmp_path / "memory.max").write_text("1000000\n")
    assert checks._memory() == 1_000_000 < whole
