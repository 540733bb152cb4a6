"""Whole episodes beside the plain-numpy simulator: same counts, same way, same map, same outcome."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref import maps, plans, simulator
from scipy import ndimage

from jexplore.config import Lidar, Rules
from jexplore.engine.program import Given
from jexplore.engine.serial import run_one
from jexplore.exploration.episode import program_of
from jexplore.exploration.state import Numbers, Outcome, Setup, Stream, Truth
from jexplore.exploration.trail import decode, kept
from jexplore.grid import in_cells, radius_d2
from jexplore.planning import MapModel
from jexplore.policies import parse_strategy
from jexplore.raycast import Beams, beam_table, by_beam, disturb, scan, scans_all_round

CAPACITY = 20_000


def truth_of(occupied, rooms, shape):
    """One world as an episode takes it, padded to `shape`."""
    grow = [(0, full - n) for full, n in zip(shape, occupied.shape)]
    rooms = np.full(occupied.shape, -1, np.int32) if rooms is None else rooms
    return Truth(
        occupied=np.pad(occupied, grow, constant_values=True)[None],
        rooms=np.pad(rooms, grow, constant_values=-1)[None],
        region=np.pad(ndimage.label(~occupied)[0].astype(np.int32), grow)[None],
        extent=np.asarray([occupied.shape], np.int32),
    )


def numbers_of(strategy, lidar, rules, cell_m):
    return Numbers(
        model=MapModel(
            p_free=np.float32(rules.p_free),
            near_d2=np.int32(radius_d2(rules.near_m, cell_m)),
            cell_m=np.float32(cell_m),
            clearance_d2=radius_d2(rules.clearance_m, cell_m),
        ),
        look_around=np.bool_(rules.look_around),
        recheck=np.bool_(strategy.recheck),
        max_steps=np.int32(rules.max_steps or CAPACITY),
        max_plans=np.int32(rules.max_plans or CAPACITY),
        sigma_cells=np.float32(lidar.sigma_m / cell_m),
        dropout=np.float32(lidar.dropout),
        params=strategy.policy.params,
    )


def window_of(lidar, cell_m):
    """Half the width of the square that a scan can change, cells."""
    return math.ceil(in_cells(lidar.range_m, cell_m)) + 1


@functools.partial(jax.jit, static_argnames="static")
def compiled(static, key, first_scans, truth, beams, numbers, start):
    """`static` is a `Setup` but for the scans all round at the start, which may vary: fewer programs to compile."""
    program = program_of(static._replace(first_scans=first_scans))
    given = Given(key, beams, truth, jnp.int32(0), numbers, start)
    state = run_one(program, given)
    return program.finish(program.setup, given, state), state


def with_idle_beams(beams, n_steps, n_beams):
    """The same beams in larger arrays: beams of no length, which see nothing, so that scanners share a program."""
    steps, count = (full - n for full, n in zip((n_steps, n_beams), beams.offset.shape[1:]))
    grow = ((0, 0), (0, steps), (0, count))
    offset, drow, dcol = (np.pad(a, grow) for a in (beams.offset, beams.drow, beams.dcol))
    return Beams(
        offset=offset,
        by_beam=by_beam(offset),
        drow=drow,
        dcol=dcol,
        entry=np.pad(beams.entry, grow, constant_values=np.inf),
        length=np.pad(beams.length, ((0, 0), (0, count))),
        reach=beams.reach,
    )


def play(
    occupied, start, strategy, lidar, rules, *, cell_m, rooms=None, shape=None, seed=0, window=None, beams_as=None
):
    """`(Result, State)` of the kernel, of numpy arrays."""
    strategy = parse_strategy(strategy)
    shape = shape or occupied.shape
    beams = beam_table(lidar, cell_m, shape[1])
    static = Setup(
        strategy.policy._replace(params=()),
        0,
        window_of(lidar, cell_m) if window is None else window,
        lidar.sigma_m > 0 or lidar.dropout > 0,
        CAPACITY,
    )
    return jax.tree.map(
        np.asarray,
        compiled(
            static,
            jax.random.key(seed),
            jnp.int32(scans_all_round(lidar.fov_deg)),
            jax.device_put(truth_of(occupied, rooms, shape)),
            jax.device_put(with_idle_beams(beams, *beams_as) if beams_as else beams),
            numbers_of(strategy, lidar, rules, cell_m),
            jnp.asarray([start[0], start[1], start[2] // 45], jnp.int32),
        ),
    )


def replay(occupied, start, strategy, lidar, rules, *, cell_m, rooms=None, choose=None, sense=None):
    """The simulator's `Result`."""
    return simulator.simulate(
        occupied,
        *start,
        recheck="recheck" in strategy,
        choose=choose,
        cell_m=cell_m,
        n_beams=lidar.n_beams,
        fov_deg=lidar.fov_deg,
        range_m=lidar.range_m,
        clearance_m=rules.clearance_m,
        near_m=rules.near_m,
        p_free=rules.p_free,
        max_steps=rules.max_steps,
        max_plans=rules.max_plans,
        rooms=rooms,
        look_around=rules.look_around,
        sense=sense,
    )


def assert_equal_episodes(result, state, want, *, cell_m, rooms=None):
    """Everything that both of them measure."""
    for name in ("straight", "diagonal", "turns", "scans", "plans", "exhausted", "refused"):
        assert int(getattr(result, name)) == getattr(want, name), name
    assert Outcome(int(result.outcome)).name == want.outcome
    height, width = want.hits.shape
    n = want.steps + 1
    final = decode(kept(state), result, want.hits.shape)
    assert list(zip(final.rows.tolist(), final.cols.tolist())) == want.visited
    for got, expected in ((state.belief.grid.hits, want.hits), (state.belief.grid.misses, want.misses)):
        np.testing.assert_array_equal(got[:height, :width], expected)
        assert not got[height:].any()
        assert not got[:, width:].any()

    known = (want.hits + want.misses) > 0
    assert int(result.known) == known.sum()
    last_known = dict(want.known_after_scan)  # by the number of steps made: the last scan made there counts
    assert final.known.tolist() == [last_known.get(i, 0) for i in range(n)]
    assert [plan.target for plan in final.plans] == [plan.target for plan in want.log]
    assert sum(len(plan.motions) for plan in final.plans) == want.steps + want.refused
    assert (state.row, state.col, state.heading) == (state.belief.row, state.belief.col, state.belief.heading)

    assert float(result.explored) == pytest.approx(want.explored_fraction * max(int(result.explorable), 1))
    lengths = (result.straight_at + math.sqrt(2) * result.diagonal_at) * cell_m
    np.testing.assert_allclose(lengths, list(want.path_m_at_any_scan.values()), rtol=1e-12, atol=1e-12)
    if rooms is not None:
        assert int(result.room_entries) == want.room_entries
    assert int(result.saturated) == 0


def assert_same(occupied, start, strategy, lidar, rules, *, cell_m, rooms=None, **how):
    """Plays and replays an episode; returns the kernel's result."""
    result, state = play(occupied, start, strategy, lidar, rules, cell_m=cell_m, rooms=rooms, **how)
    want = replay(occupied, start, strategy, lidar, rules, cell_m=cell_m, rooms=rooms)
    assert_equal_episodes(result, state, want, cell_m=cell_m, rooms=rooms)
    return result


# ---------------------------------------------------------------- by hand, without jit


ONE_CELL = Rules(clearance_m=0.0, near_m=0.0)
CROSS = Lidar(n_beams=4, fov_deg=360, range_m=2.0)  # in cells of one metre: ahead, back, left, right, 2 cells far


def test_a_corridor_by_hand():
    """Two cells seen ahead, then a step to the frontier, and the end of the corridor comes into view."""
    occupied = maps.walls("""
        #######
        #.....#
        #######
    """)
    result, state = play(occupied, (1, 1, 0), "closest", CROSS, ONE_CELL, cell_m=1.0)
    # The start is beside no unknown cell but (0, 2) and (2, 2) above and below the next one: it is a frontier itself.
    want = replay(occupied, (1, 1, 0), "closest", CROSS, ONE_CELL, cell_m=1.0)
    assert Outcome(int(result.outcome)) == Outcome.COMPLETE
    assert_equal_episodes(result, state, want, cell_m=1.0)
    row = state.belief.grid.hits[1].tolist(), (state.belief.grid.misses[1] > 0).tolist()
    assert row[0][0] > 0
    assert row[0][6] > 0
    assert row[1] == [False, True, True, True, True, True, False]


PENCIL = {
    "corridor": ("####### #S....# #######", CROSS, ONE_CELL),
    "bend": ("##### #...# #.#.# #S#.# #####", CROSS, ONE_CELL),
    "narrow view": ("##### #S..# #...# #####", Lidar(n_beams=1, fov_deg=40, range_m=1.6), ONE_CELL),
    "no look around": ("##### #S..# #...# #####", CROSS, Rules(clearance_m=0.0, near_m=1.0, look_around=False)),
    "step limit": ("####### #S....# #######", CROSS, Rules(clearance_m=0.0, near_m=0.0, max_steps=1)),
    "plan limit": ("####### #S....# #######", CROSS, Rules(clearance_m=0.0, near_m=0.0, max_plans=2)),
    "stuck": ("##### #S#.# #####", CROSS, ONE_CELL),
    "in a wall": ("##### #.#S# #####", CROSS, ONE_CELL),
}


@pytest.mark.parametrize("name", PENCIL)
def test_tiny_worlds_without_jit(name):
    text, lidar, rules = PENCIL[name]
    occupied = maps.walls(text) if name != "in a wall" else maps.walls(text.replace("S", "#"))
    start = (*maps.one(text, "S"), 0)
    result = assert_same(occupied, start, "closest+recheck", lidar, rules, cell_m=1.0)
    ends = {"step limit": "STEP_LIMIT", "plan limit": "PLAN_LIMIT", "stuck": "STUCK", "in a wall": "STUCK"}
    if name in ends:
        assert Outcome(int(result.outcome)).name == ends[name]


# ---------------------------------------------------------------- random worlds, with jit


SHAPE = (64, 64)  # every world is padded to it, and every scanner to these sizes: one program for all
BEAMS_AS = (120, 181)
WIDE = 82  # half a window that covers the map


def a_start(seed, occupied, rules, cell_m=0.1):
    """A clear cell of the largest clear region, and a heading."""
    clear = plans.clear(~occupied, occupied, plans.radius2(rules.clearance_m, cell_m))
    regions, _ = ndimage.label(clear)
    cells = np.argwhere(regions == 1 + np.argmax(np.bincount(regions[clear])[1:]))
    draw = np.random.default_rng(seed)
    row, col = cells[draw.integers(len(cells))]
    return int(row), int(col), 45 * int(draw.integers(8))


WORLDS = [
    (0, (40, 52), "closest", Lidar(), Rules()),
    (1, (40, 52), "closest+recheck", Lidar(), Rules()),
    (2, (36, 60), "closest", Lidar(range_m=1.0), Rules()),
    (3, (60, 36), "closest+recheck", Lidar(range_m=1.0, n_beams=45), Rules()),
    (4, (44, 44), "closest+recheck", Lidar(range_m=2.0, n_beams=30, fov_deg=90), Rules()),
    (5, (31, 58), "closest", Lidar(range_m=3.0, n_beams=24, fov_deg=360), Rules(near_m=0.2)),
    (6, (50, 40), "closest+recheck", Lidar(range_m=2.5, n_beams=19, fov_deg=270), Rules(look_around=False)),
    (7, (50, 40), "closest", Lidar(range_m=1.5, n_beams=9, fov_deg=360), Rules(look_around=False, p_free=0.5)),
    (8, (64, 64), "closest+recheck", Lidar(range_m=2.0), Rules(max_steps=60)),
    (9, (64, 64), "closest", Lidar(range_m=2.0), Rules(max_plans=7)),
    (10, (45, 33), "closest+recheck", Lidar(range_m=4.0, n_beams=12, fov_deg=30), Rules(near_m=0.0)),
    (11, (48, 48), "closest", Lidar(range_m=0.55, n_beams=37), Rules(near_m=1.0)),
]


@pytest.mark.jit
@pytest.mark.parametrize(("seed", "shape", "strategy", "lidar", "rules"), WORLDS)
def test_random_worlds_replay(seed, shape, strategy, lidar, rules):
    occupied, rooms = maps.cluttered(seed, *shape)
    result = assert_same(
        occupied, a_start(seed, occupied, rules), strategy, lidar, rules,
        cell_m=0.1, rooms=rooms, shape=SHAPE, window=WIDE, beams_as=BEAMS_AS,
    )  # fmt: skip
    limits = {8: Outcome.STEP_LIMIT, 9: Outcome.PLAN_LIMIT}
    if seed in limits:
        assert Outcome(int(result.outcome)) == limits[seed]


@pytest.mark.jit
@pytest.mark.parametrize("seed", [20, 21, 22])
def test_worlds_of_single_cell_clearance_replay(seed):
    """Cells of 0.3 m, clearance of one cell, and the window that such a scanner needs: much smaller than the map."""
    lidar, rules = Lidar(range_m=2.4, n_beams=37), Rules()
    occupied, rooms = maps.cluttered(seed, 60, 60)
    start = a_start(seed, occupied, rules, 0.3)
    assert_same(occupied, start, "closest+recheck", lidar, rules, cell_m=0.3, rooms=rooms, shape=SHAPE)


@pytest.mark.jit
def test_known_cells_are_counted_in_every_corner_of_the_map():
    """The count follows the square that a scan can change; here the square is small and cut off by the map's edge."""
    lidar, rules = Lidar(range_m=2.4, n_beams=37), Rules(max_plans=1)
    occupied = np.pad(np.zeros((58, 58), bool), 1, constant_values=True)
    for row, col in ((2, 2), (2, 57), (57, 2), (57, 57), (30, 30)):
        result, state = play(occupied, (row, col, 0), "closest+recheck", lidar, rules, cell_m=0.3, shape=SHAPE)
        assert int(result.known) == ((state.belief.grid.hits + state.belief.grid.misses) > 0).sum()


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
    """In the doorway both rooms are connected by what is near the start, which no plan from afar may use."""
    rules, outcomes = Rules(near_m=0.4), set()
    lidar = Lidar(range_m=0.7, n_beams=11, fov_deg=90)
    occupied = np.repeat(np.repeat(maps.walls(BLOCKED), 3, axis=0), 3, axis=1)
    for start in ((16, 16, 90), (16, 16, 0), (6, 16, 270), (1, 1, 45)):
        for strategy in ("closest", "closest+recheck"):
            result = assert_same(
                occupied, start, strategy, lidar, rules, cell_m=0.1, shape=SHAPE, window=WIDE, beams_as=BEAMS_AS
            )
            outcomes.add(Outcome(int(result.outcome)).name)
    occupied[:, :] = True
    occupied[5, 5:7] = False
    result = assert_same(
        occupied, (5, 5, 0), "closest", lidar, rules, cell_m=0.1, shape=SHAPE, window=WIDE, beams_as=BEAMS_AS
    )
    outcomes.add(Outcome(int(result.outcome)).name)
    assert outcomes >= {"BLOCKED", "STUCK"}


# ---------------------------------------------------------------- random targets


@pytest.mark.jit
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("strategy", ["random", "random+recheck"])
def test_random_targets_replay(seed, strategy):
    """The simulator makes the same draws among its own candidates and must go the same way."""
    occupied, rooms = maps.cluttered(30 + seed, 40, 44)
    lidar, rules, start = Lidar(range_m=2.0, n_beams=37), Rules(max_plans=40), a_start(seed, occupied, Rules())
    result, state = play(
        occupied, start, strategy, lidar, rules, cell_m=0.1, rooms=rooms, shape=SHAPE, window=WIDE, beams_as=BEAMS_AS,
        seed=seed,
    )  # fmt: skip
    key = jax.random.fold_in(jax.random.key(seed), Stream.POLICY)

    def choose(candidates, costs, number):
        k = int(jax.random.randint(jax.random.fold_in(key, number), (), 0, len(candidates)))
        return candidates[k]

    want = replay(occupied, start, strategy, lidar, rules, cell_m=0.1, rooms=rooms, choose=choose)
    assert_equal_episodes(result, state, want, cell_m=0.1, rooms=rooms)


# ---------------------------------------------------------------- view points

PASSAGE = "############## #S...........# ##############"
VIEWS = "decision-theoretic{}:samples=40,lam=0,spread_m=0,min_gain=2"


@pytest.mark.jit
def test_a_view_point_is_given_up_when_it_shows_too_little_only_with_rechecking():
    """Three cells ahead are seen at the start, up to column 4, from where three more would be. Two steps on the view
    point in column 4 still shows two new cells, three steps on only one: with rechecking the next one is chosen there,
    in column 6, and so on; without, the robot drives on to every view point.
    """
    occupied, lidar = maps.walls(PASSAGE), Lidar(n_beams=4, fov_deg=360, range_m=3.0)
    how = {"lidar": lidar, "rules": ONE_CELL, "cell_m": 1.0}
    targets = {}
    for modifier in ("", "+recheck"):
        result, state = play(occupied, (1, 1, 0), VIEWS.format(modifier), **how)
        assert Outcome(int(result.outcome)) == Outcome.COMPLETE
        final = decode(kept(state), result, occupied.shape)
        heads = [plan.target[1] for plan in final.plans if plan.target for _ in plan.motions]
        targets[modifier] = list(zip(final.cols[1:].tolist(), heads))
    # The first plan, to the cell; and then on.
    assert targets[""][:3] == [(2, 4), (3, 4), (4, 4)]
    assert targets["+recheck"][:2] == [(2, 4), (3, 4)]
    assert targets["+recheck"][2] == (4, 6)


# ---------------------------------------------------------------- noise


@pytest.mark.jit
@pytest.mark.parametrize(("seed", "p_free"), [(0, 0.125), (1, 0.5), (2, 0.25)])
def test_noisy_episodes_replay_with_the_kernels_own_readings(seed, p_free):
    """The simulator gets the noisy scans of the same stream; all the rest, refused steps among it, is its own."""
    occupied, _ = maps.cluttered(40 + seed, 40, 44)
    lidar = Lidar(range_m=2.0, n_beams=37, sigma_m=0.3, dropout=0.1)
    rules = Rules(clearance_m=0.0, near_m=0.0, p_free=p_free, max_steps=150, max_plans=60)
    start = a_start(seed, occupied, rules)
    beams = beam_table(lidar, 0.1, SHAPE[1])
    walled = jnp.asarray(np.pad(occupied, [(0, 64 - n) for n in occupied.shape], constant_values=True))
    key, scans = jax.random.fold_in(jax.random.key(seed), Stream.SENSOR), []

    @jax.jit
    def reading(key, row, col, heading):
        where = row, col, heading
        noise = {"sigma_cells": jnp.float32(3.0), "dropout": jnp.float32(0.1)}
        return disturb(key, scan(walled, *where, beams), *where, beams, jnp.asarray(occupied.shape), **noise)

    def sense(row, col, heading_deg):
        heading = heading_deg // 45
        seen = jax.tree.map(np.asarray, reading(jax.random.fold_in(key, len(scans)), row, col, heading))
        scans.append(seen)
        lines = []
        for b in range(lidar.n_beams):
            cells = list(zip(row + beams.drow[heading, :, b], col + beams.dcol[heading, :, b]))
            lines.append((cells[: seen.end[b]], cells[seen.end[b]] if seen.hit[b] else None))
        return lines

    result, state = play(occupied, start, "closest", lidar, rules, cell_m=0.1, shape=SHAPE, window=22, seed=seed)
    want = replay(occupied, start, "closest", lidar, rules, cell_m=0.1, sense=sense)
    assert_equal_episodes(result, state, want, cell_m=0.1)
    assert len(scans) == int(result.scans)
    assert int(result.refused) > 0


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


@pytest.mark.jit
def test_jit_changes_nothing():
    text, lidar, rules = PENCIL["bend"]
    start = (*maps.one(text, "S"), 90)
    fast = play(maps.walls(text), start, "closest", lidar, rules, cell_m=1.0)
    with jax.disable_jit():
        slow = play(maps.walls(text), start, "closest", lidar, rules, cell_m=1.0)
    jax.tree.map(np.testing.assert_array_equal, fast, slow)


def test_outcomes_and_streams_keep_their_numbers():
    """They stand in stored results and fix every draw."""
    assert {o.name: o.value for o in Outcome} == {
        "RUNNING": 0, "COMPLETE": 1, "BLOCKED": 2, "STEP_LIMIT": 3, "PLAN_LIMIT": 4, "STUCK": 5, "BAD_TARGET": 6
    }  # fmt: skip
    assert {s.name: s.value for s in Stream} == {"SENSOR": 0, "POLICY": 1}
