"""Whole episodes compared with the plain-numpy simulator: same counts, same way, same map, same outcome."""

import jax
import numpy as np
import pytest
from ref import maps
from ref.episodes import clear_cells, compared, play

from jexplore.exploration.state import Outcome, Stream
from jexplore.exploration.trail import decode, detail_of
from jexplore.grid import radius_d2
from jexplore.rules import Lidar, Rules

# ---------------------------------------------------------------- by hand, without jit


ONE_CELL = Rules(clearance_m=0.0, near_m=0.0)
CROSS = Lidar(n_beams=4, fov_deg=360, range_m=2.0)  # in cells of one metre: ahead, back, left, right, 2 cells far
PENCIL_SHAPE = 5, 9  # each world is padded to it: a shape of its own compiles hundreds of operations


def test_a_corridor_by_hand():
    """Two cells seen ahead, then a step to the frontier, and the end of the corridor comes into view."""
    occupied = maps.walls("""
        #######
        #.....#
        #######
    """)
    # The start is next to no unknown cell but (0, 2) and (2, 2) above and below the next one: it is a frontier itself.
    result, state, _ = compared(occupied, (1, 1, 0), "closest", CROSS, ONE_CELL, cell_m=1.0, shape=PENCIL_SHAPE)
    assert Outcome(int(result.outcome)) == Outcome.COMPLETE
    row = state.belief.grid.hits[1].tolist(), (state.belief.grid.misses[1] > 0).tolist()
    assert row[0][0] > 0
    assert row[0][6] > 0
    assert row[1] == [False, True, True, True, True, True, *[False] * 3]  # the last two are padding


PENCIL = {
    "bend": ("##### #...# #.#.# #S#.# #####", CROSS, ONE_CELL),
    "narrow view": ("##### #S..# #...# #####", Lidar(n_beams=1, fov_deg=40, range_m=1.6), ONE_CELL),
    "no look around": ("##### #S..# #...# #####", CROSS, Rules(clearance_m=0.0, near_m=1.0, look_around=False)),
    "scans now and then": (
        "######### #S......# #########",
        CROSS,
        Rules(clearance_m=0.0, near_m=1.0, scan_every_m=2.5),
    ),
    "step limit": ("####### #S....# #######", CROSS, Rules(clearance_m=0.0, near_m=0.0, max_steps=1)),
    "plan limit": ("####### #S....# #######", CROSS, Rules(clearance_m=0.0, near_m=0.0, max_plans=2)),
    "stuck": ("##### #S#.# #####", CROSS, ONE_CELL),
    "in a wall": ("##### #.#S# #####", CROSS, ONE_CELL),
}


WITHOUT_JIT = "no look around", "plan limit", "stuck", "in a wall"  # the others take 4 s or more without


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in WITHOUT_JIT else pytest.mark.jit) for name in PENCIL]
)
def test_tiny_worlds(name):
    text, lidar, rules = PENCIL[name]
    occupied = maps.walls(text) if name != "in a wall" else maps.walls(text.replace("S", "#"))
    start = (*maps.one(text, "S"), 0)
    result, *_ = compared(occupied, start, "closest+recheck", lidar, rules, cell_m=1.0, shape=PENCIL_SHAPE)
    ends = {"step limit": "STEP_LIMIT", "plan limit": "PLAN_LIMIT", "stuck": "STUCK", "in a wall": "STUCK"}
    if name in ends:
        assert Outcome(int(result.outcome)).name == ends[name]


# ---------------------------------------------------------------- random worlds, with jit


SHAPE = (64, 64)  # every world is padded to it, and every scanner to these sizes: one program for all
BEAMS_AS = (120, 181)


def a_start(seed, occupied, rules, cell_m=0.1):
    """A clear cell of the largest clear region, and a heading."""
    cells = clear_cells(occupied, radius_d2(rules.clearance_m, cell_m))
    draw = np.random.default_rng(seed)
    row, col = cells[draw.integers(len(cells))]
    return int(row), int(col), 45 * int(draw.integers(8))


@pytest.mark.jit
def test_known_cells_are_counted_in_every_corner_of_the_map():
    """The count follows the square that a scan can change; here the square is small and cut off by the map's edge."""
    lidar, rules = Lidar(range_m=2.4, n_beams=37), Rules(max_plans=1)
    occupied = np.pad(np.zeros((58, 58), bool), 1, constant_values=True)
    for row, col in ((2, 2), (2, 57), (57, 2), (57, 57), (30, 30)):
        result, state = play(occupied, (row, col, 0), "closest+recheck", lidar, rules, cell_m=0.3, shape=SHAPE)
        assert int(result.n_known) == ((state.belief.grid.hits + state.belief.grid.misses) > 0).sum()


BLOCKED = """
    ############
    #..........#
    #..........#
    #..........#
    #..........#
    #####.######
    #..........#
    #..........#
    #..........#
    #..........#
    ############
"""


@pytest.mark.jit
def test_a_start_near_walls_can_end_blocked_or_stuck():
    """In the doorway both rooms are connected by cells near the start, which no plan from afar may use."""
    rules, outcomes = Rules(near_m=0.4), set()
    lidar, how = Lidar(range_m=0.7, n_beams=11, fov_deg=90), {"cell_m": 0.1, "shape": SHAPE, "beams_as": BEAMS_AS}
    occupied = np.repeat(np.repeat(maps.walls(BLOCKED), 3, axis=0), 3, axis=1)
    for start in ((16, 16, 90), (16, 16, 0), (6, 16, 270), (1, 1, 45)):
        for strategy in ("closest", "closest+recheck"):
            result, *_ = compared(occupied, start, strategy, lidar, rules, **how)
            outcomes.add(Outcome(int(result.outcome)).name)
    occupied[:, :] = True
    occupied[5, 5:7] = False
    result, *_ = compared(occupied, (5, 5, 0), "closest", lidar, rules, **how)
    outcomes.add(Outcome(int(result.outcome)).name)
    assert outcomes >= {"BLOCKED", "STUCK"}


# ---------------------------------------------------------------- view points

PASSAGE = "############## #S...........# ##############"
VIEWS = "decision-theoretic{}:samples=40,lam=0,spread_m=0,min_gain=2"


@pytest.mark.slow
@pytest.mark.jit
def test_a_view_point_is_given_up_when_it_shows_too_little_only_with_rechecking():
    """Three cells ahead are seen at the start, up to column 4, from where three more would be."""
    occupied, lidar = maps.walls(PASSAGE), Lidar(n_beams=4, fov_deg=360, range_m=3.0)
    how = {"lidar": lidar, "rules": ONE_CELL.replace(known_outline=True), "cell_m": 1.0}
    targets = {}
    for modifier in ("", "+recheck"):
        result, state = play(occupied, (1, 1, 0), VIEWS.format(modifier), **how)
        assert Outcome(int(result.outcome)) == Outcome.COMPLETE
        final = decode(detail_of(state), result, occupied.shape)
        heads = [plan.target[1] for plan in final.plans if plan.target for _ in plan.motions]
        targets[modifier] = list(zip(final.cols[1:].tolist(), heads))
    # The first plan, to the cell; and then on.
    assert targets[""][:3] == [(2, 4), (3, 4), (4, 4)]
    assert targets["+recheck"][:2] == [(2, 4), (3, 4)]
    assert targets["+recheck"][2] == (4, 6)


# ---------------------------------------------------------------- laws


@pytest.mark.jit
def test_padding_changes_nothing_and_neither_does_the_window():
    occupied, rooms = maps.cluttered(22, 60, 60)
    lidar, rules = Lidar(range_m=2.4, n_beams=37), Rules()
    start = a_start(22, occupied, rules, 0.3)
    how = {"cell_m": 0.3, "rooms": rooms}
    small, small_state = play(occupied, start, "closest+recheck", lidar, rules, shape=SHAPE, **how)
    large, large_state = play(occupied, start, "closest+recheck", lidar, rules, shape=(72, 96), window=20, **how)
    jax.tree.map(np.testing.assert_array_equal, small, large)
    np.testing.assert_array_equal(small_state.belief.grid.hits[:60, :60], large_state.belief.grid.hits[:60, :60])


def test_outcomes_and_streams_keep_their_numbers():
    """They stand in stored results and fix every draw."""
    assert {o.name: o.value for o in Outcome} == {
        "RUNNING": 0, "COMPLETE": 1, "BLOCKED": 2, "STEP_LIMIT": 3, "PLAN_LIMIT": 4, "STUCK": 5, "BAD_TARGET": 6,
        "BAD_START": 7, "LOST": 8, "INCONSISTENT": 9, "EXPLORED": 10, "PATH_LIMIT": 11, "TIME_LIMIT": 12,
    }  # fmt: skip
    assert {s.name: s.value for s in Stream} == {"SENSOR": 0, "POLICY": 1, "ODOMETRY": 4, "ROBOT": 5, "CONTACT": 6}
