"""Bounds: the exact search is brute force's, no episode is shorter than a lower bound, walks see everything."""

import math

import numpy as np
import pandas as pd
import pytest
from ref import bounds as ref
from ref.refusals import refused
from scipy import ndimage

import jexplore as jx
from jexplore.cli import main
from jexplore.reach import FAR
from jexplore.rules import Lidar, Rules
from jexplore.studies.bounds import beside, scene, search
from jexplore.studies.bounds import bound as study
from jexplore.studies.bounds.floor import walk_cost
from jexplore.studies.bounds.scene import Coverage
from jexplore.studies.checks import ready_starts
from jexplore.worlds.world import World

pytestmark = pytest.mark.jit
LIDAR, RULES = Lidar(n_beams=31, range_m=0.35), Rules(clearance_m=0.1, near_m=0.2)
ROOMS = "rooms:width_m=5,height_m=5"
NEAR = Lidar(n_beams=61, range_m=1.5)


def random_world(seed, side=9, share=0.22):
    """A pencil-sized map, and a start on it."""
    rng = np.random.default_rng(seed)
    occupied = rng.random((side, side)) < share
    occupied[[0, -1]] = occupied[:, [0, -1]] = True
    labels, _ = ndimage.label(~occupied)
    largest = np.argwhere(labels == 1 + np.argmax(np.bincount(labels[labels > 0])[1:]))
    row, col = largest[rng.integers(len(largest))].tolist()
    return World(occupied=occupied, cell_m=0.1, name=f"random {seed}"), (row, col, 45 * int(rng.integers(8)))


def ready(world, start, lidar=LIDAR, rules=RULES):
    return scene.prepare_scene(world, start, lidar, rules, 2)


def flat_of(made, row, col):
    return (row + made.pad) * made.width + col + made.pad


def seen_from(made, cells):
    """Return the cells seen by robots on some cells: a mask of the padded map."""
    found = np.zeros(len(made.occupied), bool)
    for cell in cells:
        found[made.sights.seen(int(cell))] = True
    return found


def as_map(made, flat):
    """A mask of the padded map, cut to the world."""
    return flat.reshape(-1, made.width)[made.pad : -made.pad, made.pad : -made.pad]


@pytest.mark.parametrize("seed", range(6))
def test_what_is_to_be_seen_and_from_where_is_the_episodes(seed):
    world, start = random_world(seed)
    rules = Rules(clearance_m=0.0, near_m=0.2) if seed % 2 else RULES
    made = ready(world, start, rules=rules)
    if made is None:
        pytest.skip("an enclosed start")
    goal, known = ref.begun(world, start, LIDAR, rules)
    np.testing.assert_array_equal(as_map(made, made.must_see), goal & ~known)
    look = ref.seen_all_round(world.occupied, LIDAR, world.cell_m)
    labels, _ = ndimage.label(~world.occupied)
    np.testing.assert_array_equal(as_map(made, made.any), labels == labels[start[:2]])
    free = np.argwhere(labels == labels[start[:2]])
    seen = {tuple(cell): look(*cell) for cell in free.tolist()}
    for cell, known in seen.items():
        mine = as_map(made, seen_from(made, [flat_of(made, *cell)]))
        np.testing.assert_array_equal(mine & ~world.occupied, known & ~world.occupied)
    for cell in free[:: max(1, len(free) // 6)].tolist():
        rows, cols = made.cells(made.region(int(flat_of(made, *cell))))
        assert sorted(zip(rows.tolist(), cols.tolist())) == [own for own in seen if seen[own][tuple(cell)]]


@pytest.mark.parametrize(
    ("seed", "side", "share", "rules"),
    [
        *((seed, 8 + seed % 3, 0.22, Rules(clearance_m=0.0, near_m=0.2)) for seed in range(1, 20, 2)),
        *((seed, 10, 0.12, RULES) for seed in (0, 3, 4, 5, 6, 10, 12, 14)),
    ],
)
def test_the_exact_search_is_brute_force(seed, side, share, rules):
    """Without clearance, where every robot stands on the same cells, and with it, where the reference does not."""
    world, start = random_world(seed, side=side, share=share)
    made = ready(world, start, rules=rules)
    assert made is not None
    assert made.must_see.any()
    assert np.array_equal(made.any, made.clear) == (rules.clearance_m == 0)
    found = search.search(made, search.Budget(None, 4000))
    look = ref.seen_all_round(world.occupied, LIDAR, world.cell_m)
    left = as_map(made, made.must_see)
    clear, wide = (ref.shortest(as_map(made, stand), start[:2], left, look) for stand in (made.clear, made.any))
    assert found.optimal
    assert found.high == found.low == clear == walk_cost(found.walk, made.width)
    assert found.low_any <= wide <= clear
    assert found.low_any == found.low or not np.array_equal(made.any, made.clear)
    budget = search.Budget(None, 4000)
    coverage = Coverage(made.sights, made.must_see)
    exact, walk = search.Search(made, made.any, budget, coverage).shortest(1.0, FAR)
    assert walk is not None
    assert exact.low == wide


@pytest.mark.slow
def test_the_walk_sees_everything_and_keeps_to_the_corner_rule():
    world = jx.load_world("cave:width_m=6,height_m=6", cell_m=0.1)
    found = jx.bound(world, starts=2, lidar=NEAR, max_floods=400)
    for number, row in enumerate(found.table.to_dict("records")):
        start = int(row["start_row"]), int(row["start_col"]), int(row["start_heading_deg"])
        walk = found.walks[found.walks["start"] == number][["row", "col"]].to_numpy()
        assert tuple(walk[0]) == start[:2]
        goal, known = ref.begun(world, start, NEAR, Rules())
        look = ref.seen_all_round(world.occupied, NEAR, world.cell_m)
        seen = np.any([look(*cell) for cell in walk.tolist()], axis=0)
        assert not (goal & ~known & ~seen).any()
        for one, other in zip(walk[:-1].tolist(), walk[1:].tolist()):
            assert tuple(other) in [cell for cell, _ in ref.neighbours(~world.occupied, one)]
        steps = np.abs(np.diff(walk, axis=0)).sum(axis=1)
        assert row["high_m"] == pytest.approx(0.1 * ((steps == 1).sum() + math.sqrt(2) * (steps == 2).sum()))
        assert row["low_any_m"] <= row["low_m"] <= row["high_m"]
        assert row["low_any_m"] > 0.5 * row["high_m"]


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "floods"), [("rooms", 600), pytest.param("cave", 1200, marks=pytest.mark.slow)])
def test_no_episode_is_shorter_than_the_bound_of_any_robot(kind, floods):
    world = jx.load_world(f"{kind}:width_m=7,height_m=7", cell_m=0.1)
    episodes = jx.compare(world, ["closest", "closest+recheck", "random"], episodes=3, lidar=NEAR).to_pandas()
    table = jx.bound(world, starts=3, lidar=NEAR, max_floods=floods).table
    np.testing.assert_array_equal(table[["start_row", "start_col"]], episodes[["start_row", "start_col"]][:3])
    done = episodes[episodes["outcome"] == "COMPLETE"]
    assert len(done) > 6
    low = done["episode"].map(table["low_any_m"])
    assert (low <= done["path_m"] + 1e-9).all()
    assert (table["low_any_m"] > 0.3 * table["high_m"]).all()


def test_a_range_shorter_than_a_cell_or_two():
    world, start = random_world(1, side=6)
    for range_m in (0.05, 0.1, 0.15):
        made = ready(world, start, Lidar(n_beams=8, fov_deg=360, range_m=range_m), Rules(clearance_m=0.0, near_m=0.0))
        assert made is not None
        assert search.search(made, search.Budget(None, 3000)).high < FAR


def test_metres_are_rounded_down():
    assert study.low_metres(65536 * 10, 0.1) == 0.999  # ten diagonal steps would cost more than they measure
    assert study.low_metres(0, 0.1) == 0.0
    assert study.low_metres(92682 * 1000, 0.1) <= 100 * math.sqrt(2)


def test_the_same_twice_under_max_floods():
    one, two = (jx.bound(ROOMS, starts=1, lidar=NEAR, max_floods=150) for _ in range(2))
    pd.testing.assert_frame_equal(one.table.drop(columns="seconds"), two.table.drop(columns="seconds"))
    pd.testing.assert_frame_equal(one.walks, two.walks)
    assert repr(one) == "<Bounds of 1 starts in 1 worlds>"


def test_an_enclosed_start_and_nothing_to_see():
    for half, status in ((0, study.STUCK), (1, study.STUCK), (3, study.OPTIMAL)):  # of 1: one clear cell, the start's
        occupied = np.ones((11, 11), bool)
        occupied[5 - half : 6 + half, 5 - half : 6 + half] = False
        world = World(occupied=occupied, cell_m=0.1, name="hall")
        lidar = Lidar(n_beams=181, range_m=2.0)
        row = study.solve(study.BoundTask(world, (5, 5, 0), lidar, RULES, 1.0, None)).iloc[0]
        assert (row["status"], row["low_m"], row["low_any_m"]) == (status, 0.0, 0.0)
    assert row["high_m"] == 0.0


def test_no_time_for_a_walk_leaves_a_weak_bound():
    world = jx.load_world("office", cell_m=0.1)
    start = tuple(int(v) for v in ready_starts(world, "random", 1, seed=0, rules=Rules())[0])
    found = study.solve(study.BoundTask(world, start, Lidar(), Rules(), None, 3)).iloc[0]
    assert found["status"] == study.WEAK
    assert math.isnan(found["high_m"])
    assert 0 < found["low_any_m"] <= found["low_m"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seconds": 0}, "seconds must be"),
        ({"lidar": Lidar(dropout=0.1)}, "without noise"),
        ({"lidar": Lidar(no_echo="unknown")}, "no_echo must be free"),
        ({"lidar": Lidar(left_m=0.1)}, "sees all from the robot's centre"),
        ({"max_floods": 0}, "max_floods must be"),
        ({"start": "world"}, "has no start of its own"),
    ],
)
def test_what_cannot_be_bounded(options, message):
    refused(message, jx.bound, ROOMS, **options)


def test_the_command(tmp_path, printed):
    out = tmp_path / "run"
    command = ["bound", ROOMS, "--starts", "2", "--max-floods", "200", "--lidar.range-m", "1.5", "--workers", "1"]
    command += ["--out", str(out)]
    said = printed(command).out
    assert said.splitlines()[-1].startswith("wrote bounds.parquet, walks.parquet, run.json, bounds.png")
    table = jx.load(out)
    assert list(table.columns) == list(study.BOUND_COLUMNS)
    assert len(table) == 2
    assert (table["high_m"] >= table["low_m"]).all()
    assert "nothing was left to do" in printed([*command, "--resume"]).out
    assert "holds another run" in printed([*command, "--resume", "--seed", "1"], 2).err
    assert "expected worlds" in printed(["bound", "--out", str(out)], 2).err


@pytest.mark.slow
def test_a_comparison_beside_its_bounds(tmp_path, printed):
    out, floods = tmp_path / "run", {"max_floods": 300}
    command = ["compare", "--worlds", ROOMS, "--strategies", "closest", "random", "--episodes", "2", "--no-report"]
    command += ["--lidar.n-beams", "61", "--lidar.range-m", "1.5", "--out", str(out)]
    assert "path / low any" in printed([*command, "--bounds", "--bound-seconds", "1"]).out
    episodes = jx.load(out).to_pandas()
    assert (episodes["path_over_low_any"] >= 1).all()
    assert not (episodes["path_over_low_any"] < episodes["path_over_high"] - 1e-9).any()  # a slow machine has no walk
    assert len(pd.read_parquet(out / "bounds.parquet")) == 2
    assert "nothing was left to do" in printed([*command, "--bounds", "--bound-seconds", "1", "--resume"]).out
    assert "its bound_seconds is 1" in printed([*command, "--bounds", "--bound-seconds", "2", "--resume"], 2).err
    assert main.main([*command, "--overwrite", "--bounds", "--bound-seconds", "0"]) == 2
    assert "without noise" in printed([*command, "--overwrite", "--bounds", "--lidar.sigma-m", "0.1"], 2).err
    found = jx.bound(ROOMS, starts=1, lidar=NEAR, **floods)
    compared = jx.compare(ROOMS, "closest", episodes=2, lidar=NEAR)
    table = found.beside(compared)
    assert np.isnan(table["path_over_high"][1])
    assert table["path_over_low_any"][0] == table["path_m"][0] / found.table["low_any_m"][0]
    other = compared.worlds[0].replace(occupied=compared.worlds[0].occupied | (np.arange(50) == 20))
    refused("another world of that name", found.beside, jx.compare(other, "closest", episodes=1, lidar=NEAR))
    refused("have none of them", found.beside, jx.compare(ROOMS, "closest", episodes=1, seed=5, lidar=NEAR))


def test_ratios_over_worlds_by_hand():
    """Each world counts once, however many starts it has, and ratios are averaged as logarithms."""
    rows = [("cave#0", 2.0), ("cave#0", 8.0), ("cave#1", 1.0), ("maze#0", 0.5), ("maze#1", 2.0), ("maze#1", math.nan)]
    table = pd.DataFrame(rows, columns=["world", "path_over_high"]).assign(strategy="closest", path_over_low_any=2.0)
    head, _, line = (text.strip("|").split("|") for text in beside.beside_table(table, ["strategy"]).splitlines())
    found = {name.strip(): value.strip() for name, value in zip(head, line)}
    assert found["n"] == "6"
    assert found["path / high"].startswith("1.414 [")  # (4 * 1 * 0.5 * 2) ** (1 / 4)
    assert (found["cave"], found["maze"]) == ("2.000", "1.000")
    assert (found["worst / high"], found["below 1"]) == ("8.000", "1")
    assert found["path / low any"].split()[0] == "2.000"
    by_world = beside.beside_table(table)
    assert "maze#1" in by_world
    assert "cave |" not in by_world.splitlines()[0]
