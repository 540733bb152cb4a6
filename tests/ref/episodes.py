"""Whole episodes by the engine and by the oracle, and what differs between the two."""

import dataclasses
import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
from scipy import ndimage

from jexplore.arrays.padding import number
from jexplore.engine.one_by_one import run_one
from jexplore.engine.program import Given
from jexplore.exploration.episode import program_of
from jexplore.exploration.motion import clock_table
from jexplore.exploration.results import progress_m
from jexplore.exploration.site import rule_numbers
from jexplore.exploration.state import Numbers, Outcome, Setup, Stream, Truth
from jexplore.exploration.trail import decode, detail_of
from jexplore.native.drive import load_driving
from jexplore.planning import MapModel
from jexplore.policies import parse_strategy
from jexplore.raycast import Beams, beam_table, by_beam, disturb, scan, scans_all_round
from jexplore.rules import Robot
from jexplore.worlds.world import World

from . import clock, plans, simulator

CAPACITY = 20_000
ROBOT = Robot()
RULES = "clearance_m", "near_m", "p_free", "max_steps", "max_plans", "look_around", "scan_every_m", "arrival_m"
ENDS = "frontier_connectivity", "min_frontier_cells", "stop_at", "return_home", "max_path_m", "max_time_s"
COUNTS = ("straight", "diagonal", "turns", "scans", "plans", "exhausted", "refused")


def clear_cells(occupied, clearance_d2):
    """`[N, 2]`, row and column of the cells of the largest clear region; N = 0 where nothing is clear."""
    clear = plans.clear(~occupied, occupied, clearance_d2)
    regions, _ = ndimage.label(clear)
    return np.argwhere(clear & (regions == 1 + np.argmax(np.bincount(regions[clear], minlength=2)[1:])))


# ---------------------------------------------------------------- by the engine


def truth_of(occupied, rooms, shape, within=None, known=None):
    """One world as an episode takes it, padded to `shape`."""
    grow = [(0, full - n) for full, n in zip(shape, occupied.shape)]
    rooms = np.full(occupied.shape, -1, np.int32) if rooms is None else rooms
    return Truth(
        occupied=np.pad(occupied, grow, constant_values=True)[None],
        rooms=np.pad(rooms, grow, constant_values=-1)[None],
        region=np.pad(ndimage.label(~occupied if within is None else ~occupied & within)[0].astype(np.int32), grow)[
            None
        ],
        extent=np.asarray([occupied.shape], np.int32),
        within=None if within is None else np.pad(within, grow)[None],
        prior=None if known is None else np.pad(known, grow, constant_values=-1)[None],
    )


def numbers_of(strategy, lidar, rules, cell_m, longest, robot):
    """`Numbers` of an episode in a world of at most `longest` cells a side, as the engine makes them."""
    limits = {name: getattr(rules, name) or CAPACITY for name in ("max_steps", "max_plans")}
    own = rule_numbers(World(np.ones((longest, longest), bool), cell_m=cell_m), lidar, rules.replace(**limits))
    model = {name: own.pop(name) for name in ("p_free", "near_d2", "clearance_d2", "connectivity", "least")}
    numbers = Numbers(
        model=MapModel(cell_m=cell_m, known_outline=rules.known_outline, **model),
        sigma_cells=lidar.sigma_m / cell_m,
        dropout=lidar.dropout,
        recheck=strategy.recheck,
        clock=clock_table(robot, cell_m, longest),
        params=(),
        **own,
    )
    return jax.tree.map(number, numbers).replace(params=strategy.policy.params)


def key_of(seed):
    """The key of the first episode of a run."""
    return jax.random.fold_in(jax.random.key(seed), 0)


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
        blind=np.pad(beams.blind, ((0, 0), (0, count))),
        reach=beams.reach,
    )


def beams_of(lidar, cell_m, width, beams_as):
    """`Beams` of numpy arrays; `beams_as`: their steps and beams with the idle ones, None for none of these."""
    beams = beam_table(lidar, cell_m, width)
    return with_idle_beams(beams, *beams_as) if beams_as else beams


def play(
    occupied,
    start,
    strategy,
    lidar,
    rules,
    *,
    cell_m,
    rooms=None,
    within=None,
    known=None,
    shape=None,
    seed=0,
    beams_as=None,
    window=0,
    native=False,
    robot=ROBOT,
):
    """`(Result, State)` of the kernel, of numpy arrays; `native`: whether native code drives, where it can be built."""
    strategy = parse_strategy(strategy)
    shape = shape or occupied.shape
    static = Setup(
        strategy.policy._replace(params=()),
        0,
        lidar.sigma_m > 0 or lidar.dropout > 0,
        CAPACITY,
        window,
        load_driving().name if native else None,
        ends=rules.stop_at is not None or rules.return_home,
    )
    numbers = numbers_of(strategy, lidar, rules, cell_m, max(shape), robot)
    numbers = numbers.replace(model=dataclasses.replace(numbers.model, native=static.native))
    return jax.tree.map(
        np.asarray,
        compiled(
            static,
            key_of(seed),
            jnp.int32(scans_all_round(lidar)),
            jax.device_put(truth_of(occupied, rooms, shape, within, known)),
            jax.device_put(beams_of(lidar, cell_m, shape[1], beams_as)),
            numbers,
            jnp.asarray([start[0], start[1], start[2] // 45], jnp.int32),
        ),
    )


# ---------------------------------------------------------------- by the oracle


@jax.jit
def _candidate(key, number, n):
    return jax.random.randint(jax.random.fold_in(key, number), (), 0, n)


def choice_of(seed):
    """The simulator's `choose`: the draws of `random` among the simulator's own candidates."""
    key = jax.random.fold_in(key_of(seed), Stream.POLICY)
    return lambda candidates, costs, number: candidates[int(_candidate(key, number, len(candidates)))]


@jax.jit
def _reading(key, number, walled, row, col, heading, beams, extent, sigma_cells, dropout):
    key, where = jax.random.fold_in(key, number), (row, col, heading)
    seen = scan(walled, *where, beams)
    return disturb(key, seen, *where, beams, extent, sigma_cells=sigma_cells, dropout=dropout)


def readings_of(occupied, lidar, *, cell_m, shape, seed, beams_as=None):
    """The simulator's `sense`: the kernel's own noisy scans, of the same stream, as beams of the simulator."""
    beams = beams_of(lidar, cell_m, shape[1], beams_as)
    grow = [(0, full - n) for full, n in zip(shape, occupied.shape)]
    walled, beams_there = jax.device_put((np.pad(occupied, grow, constant_values=True), beams))
    key, extent = jax.random.fold_in(key_of(seed), Stream.SENSOR), jnp.asarray(occupied.shape)
    noise = np.float32(lidar.sigma_m / cell_m), np.float32(lidar.dropout)
    count = iter(range(CAPACITY))

    def sense(row, col, heading_deg):
        k = heading_deg // 45
        seen = _reading(key, next(count), walled, row, col, k, beams_there, extent, *noise)
        lines = []
        for b, (end, hit) in enumerate(zip(*(np.asarray(a)[: lidar.n_beams].tolist() for a in (seen.end, seen.hit)))):
            drow, dcol = (a[k, : end + 1, b].tolist() for a in (beams.drow, beams.dcol))
            cells = [(row + r, col + c) for r, c in zip(drow, dcol)]
            lines.append((cells[:end], cells[end] if hit else None))
        return lines

    return sense


def replay(
    occupied,
    start,
    strategy,
    lidar,
    rules,
    *,
    cell_m,
    rooms=None,
    within=None,
    known=None,
    choose=None,
    sense=None,
    robot=ROBOT,
):
    """The simulator's `Result`."""
    return simulator.simulate(
        occupied,
        *start,
        recheck="recheck" in strategy,
        choose=choose,
        cell_m=cell_m,
        rooms=rooms,
        within=within,
        known=known,
        sense=sense,
        robot_times=robot,
        **{name: getattr(lidar, name) for name in ("n_beams", "fov_deg", "range_m", "no_echo")},
        **{name: getattr(rules, name) for name in (*RULES, *ENDS)},
    )


# ---------------------------------------------------------------- compared with each other


def _first_difference(got, want):
    """Describe the first difference of two lists or arrays; empty if they are equal."""
    got, want = (a.tolist() if isinstance(a, np.ndarray) else a for a in (got, want))
    if isinstance(got, list) and isinstance(want, list):
        for i, (a, b) in enumerate(zip(got, want)):
            if a != b:
                return f"[{i}]{_first_difference(a, b)}"
        return "" if len(got) == len(want) else f" has {len(got)} entries, expected {len(want)}"
    return "" if got == want else f" {got}, expected {want}"


def differences(result, state, want, *, cell_m, rooms=None, within=None, known=None, robot=ROBOT):
    """Everything that the kernel and the simulator measure and that differs: one text for each; none if all is equal.

    Args:
      result, state: what `play` gave.
      want: what `replay` gave.
      cell_m: edge of a cell, metres.
      rooms, within, known: as both of them were given.
    """
    height, width = want.hits.shape
    at_start = 0 if known is None else int(((known >= 0) & (True if within is None else within)).sum())
    final = decode(detail_of(state), result, want.hits.shape)
    known = (want.hits + want.misses > 0) & (True if within is None else within)
    last_known = dict(want.known_after_scan)  # by the number of steps made: the last scan made there counts
    after_step = []
    for i in range(want.steps + 1):  # a step without a scan leaves the known cells
        after_step.append(last_known.get(i, after_step[-1] if after_step else at_start))
    lengths = (result.straight_at + math.sqrt(2) * result.diagonal_at) * cell_m
    along = progress_m(result, cell_m)
    times, end, starts, _ = clock.play(want.events, robot, cell_m)
    outside = np.ones(state.shape, bool)
    outside[:height, :width] = False
    pairs = {
        "outcome": (Outcome(int(result.outcome)).name, want.outcome),
        **{name: (int(getattr(result, name)), getattr(want, name)) for name in COUNTS},
        "visited": (list(zip(final.rows.tolist(), final.cols.tolist())), want.visited),
        "hits": (state.belief.grid.hits[:height, :width], want.hits),
        "misses": (state.belief.grid.misses[:height, :width], want.misses),
        "counts in padding": (int((state.belief.grid.hits + state.belief.grid.misses)[outside].sum()), 0),
        "known": (int(result.n_known), int(known.sum())),
        "known after a step": (final.n_known.tolist(), after_step),
        "target": ([plan.target for plan in final.plans or ()], [plan.target for plan in want.log]),
        "motions": (sum(len(plan.motions) for plan in final.plans or ()), want.steps + want.refused),
        "believed pose": (
            [int(v) for v in (state.belief.row, state.belief.col, state.belief.heading)],
            [int(v) for v in (state.row, state.col, state.heading)],
        ),
        "explored": (int(result.explored) / max(int(result.explorable), 1), want.explored_fraction),
        "path_m_at": (lengths, list(want.path_m_at.values())),
        "path_m_along": (*(np.nan_to_num(metres, nan=-1.0) for metres in (along, want.path_m_along)),),
        "time": ((int(result.time_ms), int(result.starts)), (end, starts)),
        "time_at": (result.time_at, [times[step] for step in want.steps_at]),
        "time_along": (result.time_along, [-1 if step is None else times[step] for step in want.steps_along]),
        "saturated": (int(result.saturated), 0),
    }
    if rooms is not None:
        pairs["room_entries"] = int(result.room_entries), want.room_entries
    return [name + text for name, (got, expected) in pairs.items() if (text := _first_difference(got, expected))]


def compared(*episode, shape=None, beams_as=None, native=False, **world):
    """Play an episode by both, and assert that nothing they measure differs: what `play` gave and `replay` gave."""
    result, state = play(*episode, shape=shape, beams_as=beams_as, native=native, **world)
    want = replay(*episode, **world)
    assert differences(result, state, want, **world) == []
    return result, state, want
