"""One exploration episode: a robot in an unknown world, from its first scan to a named outcome."""

import enum
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import Array, lax

from jexplore.arrays import bits
from jexplore.arrays.loops import run_if, stored
from jexplore.distance import within_packed
from jexplore.exploration.motion import motion_step, turn_between
from jexplore.frontier import disc
from jexplore.grid import count, empty_grid, is_known
from jexplore.planning import Belief
from jexplore.raycast import disturb, fold, scan
from jexplore.reach import NO_MOTION, flood

PERCENTILES = (50, 90, 95, 99)
STRIDE = 16  # cells by which the square moves in which known cells are counted
LOOK_AROUND = 3  # scans after a turn in place, 90 degrees apart


class Outcome(enum.IntEnum):
    """How an episode ended."""

    RUNNING = 0
    COMPLETE = 1  # no frontier left, and every cell that is clear and connected to the start is known
    BLOCKED = 2  # no frontier left, but such a cell is unknown
    STEP_LIMIT = 3
    PLAN_LIMIT = 4
    STUCK = 5  # the start is enclosed: no clear cell can be reached


class Stream(enum.IntEnum):
    """Independent streams of random numbers within one episode."""

    SENSOR = 0
    POLICY = 1


@struct.dataclass
class Truth:
    """M worlds of one padded size on the device, one above the other, with what results are measured against."""

    occupied: Array  # [M * H, W] bool; True in padding
    rooms: Array  # [M * H, W] int32; -1 outside rooms and in padding
    region: Array  # [M * H, W] int32, number of each 4-connected region of free cells
    extent: Array  # [M, 2] int32, height and width without padding


@struct.dataclass
class Numbers:
    """The numbers of an episode that may be swept without compiling anew."""

    p_free: Array  # float32
    near_d2: Array  # int32, cells^2
    cell_m: Array  # float32, edge of a cell, metres
    look_around: Array  # bool
    recheck: Array  # bool
    max_steps: Array  # int32
    max_plans: Array  # int32
    sigma_cells: Array  # float32
    dropout: Array  # float32
    params: Any  # `Policy.params`


@struct.dataclass
class Result:
    """What an episode measured: integers, so that equal results are equal bits. Metres and radians are made on
    the host.
    """

    straight: Array  # int32, straight steps
    diagonal: Array  # int32, diagonal steps
    turns: Array  # int32, 45-degree turns, those in place included
    scans: Array  # int32
    plans: Array  # int32, the last one, that found nothing, included
    exhausted: Array  # int32, targets that stayed live
    outcome: Array  # int32, `Outcome`
    known: Array  # int32, known cells
    explored: Array  # int32, known cells among `explorable`
    explorable: Array  # int32, free cells 4-connected to the start in the true world
    room_entries: Array  # int32
    straight_at: Array  # [4] int32, straight steps when 50, 90, 95, 99 % of `known` were known
    diagonal_at: Array  # [4] int32, likewise
    saturated: Array  # int32, cells out of reach at the end because their cost does not fit (see `reach.saturated`)
    refused: Array  # int32, steps refused because the cell ahead was not free
    overflow: Array  # int32, things that the strategy had no room for, all plans together


def no_results(n):
    """`Result` of zeros, `[n]`, numpy: outcome RUNNING."""
    at = ("straight_at", "diagonal_at")
    shapes = {name: (n, len(PERCENTILES)) if name in at else (n,) for name in Result.__dataclass_fields__}
    zeros: dict[str, Any] = {name: np.zeros(shape, np.int32) for name, shape in shapes.items()}
    return Result(**zeros)


class Track(enum.IntEnum):
    """Columns of a trail: one row for the start and one for every step, after the last scan made there."""

    SPOT = 0  # 4 * flat index (row * W + col) of the robot's cell + scans made in place there before going on, 0 to 3
    TARGET = 1  # flat index of the target it was heading for; -1 for none
    KNOWN = 2  # known cells


class Setup(NamedTuple):
    """What is fixed before an episode is compiled. Hashable."""

    init: Callable  # `Policy.init`
    select: Callable  # `Policy.select`
    live: Callable | None  # `Policy.live`
    clearance_d2: int  # cells^2
    first_scans: int  # scans all round at the start: 1, 2, 4 or 8
    window: int  # half width of the square that one scan can change, cells
    noisy: bool  # whether the scanner's noise is simulated
    capacity: int  # T, steps that the trail has room for; at least max_steps
    reach: str = "sweeps"  # one of `reach.METHODS`
    scan: str = "blocks"  # one of `raycast.METHODS`


@struct.dataclass
class State:
    """An episode under way."""

    belief: Belief
    base: Array  # int32, row of its world's first row in `Truth`
    goal: Array  # [ceil(H / 32), W] uint32, packed: cells that are known when the episode is complete
    route: Array  # [H, W] int8, see `reach.lay_route`
    trail: Array  # [T + 1, 3] int32, see `Track`
    carry: Any  # the policy's
    target: Array  # [2] int32, row and col; -1 for none
    is_view: Array  # bool, whether it is a view point
    looking: Array  # int32, scans in place still to be made
    looked: Array  # int32, scans in place made since the last step
    walking: Array  # bool, whether the plan is still being carried out
    bumped: Array  # bool, whether the last step was refused
    came_from: Array  # [2] int32, row and col before the last motion
    known: Array  # int32, known cells
    corner: Array  # [2] int32, row and col of the square in which known cells are counted, see `_square`
    outside: Array  # int32, known cells outside it
    room: Array  # int32, the last room stood in; -1 for none yet
    straight: Array  # int32, and so on as in `Result`
    diagonal: Array
    turns: Array
    scans: Array
    plans: Array
    exhausted: Array
    outcome: Array
    room_entries: Array
    saturated: Array
    refused: Array
    overflow: Array


def _square(row, col, shape, window):
    """The corner of a square that holds every cell that a scan can change, and its shape: `((row, col), (h, w))`.

    It moves by `STRIDE` cells at a time, so that its known cells need not be counted anew for every scan.
    """
    size = tuple(min(n, 2 * window + STRIDE) for n in shape)
    corner = [jnp.clip((at - window) // STRIDE * STRIDE, 0, n - m) for at, n, m in zip((row, col), shape, size)]
    return jnp.stack(corner), size


def _known_in(grid, corner, size):
    """Known cells in a square: int32."""
    hits, misses = (lax.dynamic_slice(a, corner, size) for a in (grid.hits, grid.misses))
    return count((hits | misses) != 0)


def _sense(key, setup, truth, beams, numbers, state, when):
    """One scan where the robot stands, counted into its map, or nothing."""
    belief = state.belief
    where = belief.row, belief.col
    seen = scan(truth.occupied, state.base + belief.row, belief.col, belief.heading, beams, method=setup.scan)
    if setup.noisy:
        key = jax.random.fold_in(jax.random.fold_in(key, Stream.SENSOR), state.scans)
        noise = {"sigma_cells": numbers.sigma_cells, "dropout": numbers.dropout}
        seen = disturb(key, seen, *where, belief.heading, beams, belief.extent, **noise)
    corner, size = _square(*where, belief.driven.shape, setup.window)
    # Known cells outside the square, counted before the update. The number is added where it changes nothing (it is
    # never negative), so that it is made first, and the update can then be made in place.
    outside = run_if(
        jnp.any(corner != state.corner), lambda _: state.known - _known_in(belief.grid, corner, size), state.outside
    )
    row = belief.row + jnp.minimum(outside, 0)
    grid = fold(belief.grid, row, belief.col, belief.heading, seen, beams, when=when, method=setup.scan)
    known = outside + _known_in(grid, corner, size)
    state = state.replace(corner=corner, outside=outside, scans=state.scans + when, known=known)
    return state.replace(belief=belief.replace(grid=grid))


def _is_live(belief, row, col):
    """Whether a cell is 8-adjacent to an unknown cell: bool."""
    height, width = belief.driven.shape
    r = row + jnp.asarray([-1, -1, -1, 0, 0, 1, 1, 1], jnp.int32)
    c = col + jnp.asarray([-1, 0, 1, -1, 1, -1, 0, 1], jnp.int32)
    inside = (r >= 0) & (r < belief.extent[0]) & (c >= 0) & (c < belief.extent[1])
    r, c = jnp.clip(r, 0, height - 1), jnp.clip(c, 0, width - 1)
    return jnp.any(inside & ((belief.grid.hits[r, c] | belief.grid.misses[r, c]) == 0))


def _mark(mask, rows, cols, when=True):
    """The mask with some cells set where `when`; a scatter, because it updates the mask in place."""
    outside = mask.shape[0]  # a row that is not there: dropped
    return mask.at[jnp.where(when, rows, outside), cols].set(True, mode="drop")


def _record(state, when=True):
    """Writes the trail's entry for the present step, or nothing."""
    width = state.belief.driven.shape[1]
    row, col = state.target
    target = jnp.where(row < 0, -1, row * width + col)
    cell = state.belief.row * width + state.belief.col
    entry = jnp.stack([4 * cell + state.looked, target, state.known])
    step = jnp.where(when, state.straight + state.diagonal, state.trail.shape[0])
    return state.replace(trail=state.trail.at[step].set(entry, mode="drop"))


def _move(truth, numbers, state):
    """The next motion of a plan under way, before its scan: a step along the route, or 90 degrees in place.

    A step into a cell that is not free is refused: the robot only turns towards it. A plan whose next step would be one
    too many ends the episode. Does nothing once the plan is done.
    """
    belief = state.belief
    looking = state.walking & (state.looking > 0)
    at_limit = state.walking & ~looking & (state.straight + state.diagonal >= numbers.max_steps)
    drow, dcol, heading = motion_step(state.route[belief.row, belief.col])
    row, col = belief.row + drow, belief.col + dcol
    hits, misses = belief.grid.hits[row, col], belief.grid.misses[row, col]
    free = (hits + misses > 0) & (hits.astype(jnp.float32) <= belief.p_free * (hits + misses).astype(jnp.float32))
    blocked = truth.occupied[state.base + row, col] | ~(free | belief.driven[row, col])
    ahead = state.walking & ~looking & ~at_limit
    steps, refused = ahead & ~blocked, ahead & blocked
    diagonal = steps & (drow != 0) & (dcol != 0)
    heading = jnp.where(looking, (belief.heading + 2) % 8, jnp.where(ahead, heading, belief.heading))
    row, col = jnp.where(steps, row, belief.row), jnp.where(steps, col, belief.col)
    room = truth.rooms[state.base + row, col]
    entered = (room >= 0) & (room != state.room)
    return state.replace(
        belief=belief.replace(row=row, col=col, heading=heading),
        came_from=jnp.stack([belief.row, belief.col]),
        looking=state.looking - looking,
        looked=jnp.where(steps, 0, state.looked + looking),
        bumped=refused,
        walking=state.walking & ~at_limit,
        outcome=jnp.where(at_limit, Outcome.STEP_LIMIT, state.outcome),
        turns=state.turns + turn_between(belief.heading, heading),
        straight=state.straight + (steps & ~diagonal),
        diagonal=state.diagonal + diagonal,
        room=jnp.where(entered, room, state.room),
        room_entries=state.room_entries + entered,
        refused=state.refused + refused,
    )


def _arrive(state, arrived, live, numbers):
    """What follows on arrival: a look around if the target is live and the rules say so; else the plan is done.

    A target that is live after that is exhausted.
    """
    looks = arrived & live & numbers.look_around & (state.looked < LOOK_AROUND)
    spent = arrived & live & ~looks
    return state.replace(
        belief=state.belief.replace(exhausted=_mark(state.belief.exhausted, state.target[0], state.target[1], spent)),
        looking=jnp.where(looks, LOOK_AROUND, state.looking),
        exhausted=state.exhausted + spent,
        walking=jnp.where(arrived, looks, state.walking),
    )


def advance(key, setup, truth, beams, numbers, state):
    """One scan of a plan under way, what it means for the plan, and the next motion if it goes on.

    Scan first, motion last: everything that is read from the map is then read after its update, which can so be made
    in place. Does nothing to the maps, the trail and what is counted once the plan is done.

    Args:
      key: as for `begin`.
      setup, truth, beams, numbers: as for `begin`.
      state: `State`.

    Returns:
      `State`.
    """
    belief, walking = state.belief, state.walking
    # Both cells beside a diagonal step belong to the way driven; for a straight step they are its ends.
    beside = (
        jnp.stack([belief.row, belief.row, state.came_from[0]]),
        jnp.stack([belief.col, state.came_from[1], belief.col]),
    )
    state = state.replace(belief=belief.replace(driven=_mark(belief.driven, *beside, walking)))
    state = _record(_sense(key, setup, truth, beams, numbers, state, walking), walking)
    here = (belief.row == state.target[0]) & (belief.col == state.target[1])
    live = _is_live(state.belief, *state.target)
    if setup.live is not None:
        asked = state.is_view & state.walking & (numbers.recheck | here)
        live = run_if(asked, lambda _: setup.live(numbers.params, state.belief, beams, *state.target), live)
    given_up = state.bumped | (numbers.recheck & ~live & ~here)
    state = state.replace(walking=walking & ~given_up)
    state = _arrive(state, walking & here & ~state.bumped & (state.looking == 0), live, numbers)
    return _move(truth, numbers, state)


def plan(key, setup, truth, beams, numbers, state):
    """Asks the strategy for a target and makes the first motion; no target ends the episode as complete, as far
    as is known here.

    Args:
      key: as for `begin`.
      setup, truth, beams, numbers: as for `begin`.
      state: `State` of a running episode that carries out no plan.

    Returns:
      `State`.
    """
    key = jax.random.fold_in(jax.random.fold_in(key, Stream.POLICY), state.plans)
    carry, choice, route = setup.select(key, numbers.params, state.carry, state.belief, beams, state.route)
    none = choice.row < 0
    state = state.replace(
        carry=carry,
        route=route,
        target=jnp.stack([choice.row, choice.col]),
        is_view=jnp.asarray(choice.is_view),
        overflow=state.overflow + choice.overflow,
        plans=state.plans + 1,
        saturated=choice.saturated,
        walking=~none,
        outcome=jnp.where(none, Outcome.COMPLETE, state.outcome),
    )
    # A path of length 0 is an arrival, at a target that is live or would not have been chosen.
    here = (state.belief.row == choice.row) & (state.belief.col == choice.col)
    return _move(truth, numbers, _arrive(state, here, True, numbers))


def limit_plans(numbers, state):
    """Ends an episode whose plan is done and that may make no other."""
    spent = (state.outcome == Outcome.RUNNING) & ~state.walking & (state.plans >= numbers.max_plans)
    return state.replace(outcome=jnp.where(spent, Outcome.PLAN_LIMIT, state.outcome))


def begin(key, setup, truth, beams, numbers, world, start):
    """An episode that has made its first scans.

    Args:
      key: of the episode; consumed by all of its parts together, each drawing from streams of its own.
      setup: `Setup`. Static.
      truth: `Truth`.
      beams: `Beams` with 8 headings.
      numbers: `Numbers`.
      world: int32, which of the M worlds.
      start: `[3]` int32, row, col and heading (units of 45 degrees).

    Returns:
      `State`.
    """
    row, col, heading = start
    shape = truth.occupied.shape[0] // truth.extent.shape[0], truth.occupied.shape[1]
    base = world * shape[0]
    occupied = lax.dynamic_slice(truth.occupied, (base, jnp.int32(0)), shape)
    flags = jnp.zeros(shape, bool)
    free, walls, near = stored(
        row >= 0, lambda: [bits.pack(m) for m in (~occupied, occupied, disc(shape, row, col, numbers.near_d2))]
    )
    clear = free & ~within_packed(walls, setup.clearance_d2)
    goal = clear & flood(clear | (free & near), row, col)
    rows, cols = (lax.broadcasted_iota(jnp.int32, shape, axis) for axis in (0, 1))
    stuck = occupied[row, col] | ~jnp.any(goal & bits.pack((rows != row) | (cols != col)))

    zero = jnp.int32(0)
    belief = Belief(
        grid=empty_grid(shape),
        driven=_mark(flags, row, col),
        exhausted=flags,
        row=row,
        col=col,
        heading=heading,
        extent=truth.extent[world],
        p_free=numbers.p_free,
        near_d2=numbers.near_d2,
        cell_m=numbers.cell_m,
        clearance_d2=setup.clearance_d2,
        reach=setup.reach,
        scan=setup.scan,
    )
    room = truth.rooms[base + row, col]
    state = State(
        belief=belief,
        base=base,
        goal=goal,
        route=jnp.full(shape, NO_MOTION, jnp.int8),
        trail=jnp.zeros((setup.capacity + 1, len(Track)), jnp.int32),
        carry=setup.init(numbers.params, belief),
        target=jnp.full((2,), -1, jnp.int32),
        is_view=jnp.bool_(False),
        looking=zero,
        looked=zero,
        walking=jnp.bool_(False),
        bumped=jnp.bool_(False),
        came_from=jnp.stack([row, col]),
        known=zero,
        corner=_square(row, col, shape, setup.window)[0],
        outside=zero,
        room=room,
        straight=zero,
        diagonal=zero,
        turns=zero,
        scans=zero,
        plans=zero,
        exhausted=zero,
        outcome=jnp.where(stuck, Outcome.STUCK, Outcome.RUNNING).astype(jnp.int32),
        room_entries=(room >= 0).astype(jnp.int32),
        saturated=zero,
        refused=zero,
        overflow=zero,
    )

    def look_round(_, state):
        state = _sense(key, setup, truth, beams, numbers, state, ~stuck)
        belief = state.belief
        return state.replace(belief=belief.replace(heading=(belief.heading + 8 // setup.first_scans) % 8))

    return _record(lax.fori_loop(0, setup.first_scans, look_round, state))


def run(key, setup, truth, beams, numbers, world, start):
    """One exploration episode.

    Args: as for `begin`.

    Returns:
      `(Result, State)`: what was measured, and the state at the end with the map and the trail.

    Source:
      Holz et al. 2010, Figure 3 and section 2.3.
    """

    def episode_step(state):
        state = plan(key, setup, truth, beams, numbers, state)
        state = lax.while_loop(lambda s: s.walking, lambda s: advance(key, setup, truth, beams, numbers, s), state)
        return limit_plans(numbers, state)

    state = begin(key, setup, truth, beams, numbers, world, start)
    state = lax.while_loop(lambda s: s.outcome == Outcome.RUNNING, episode_step, state)
    return finish(truth, state), state


def finish(truth, state):
    """The `Result` of an episode that has ended.

    Args:
      truth: `Truth`.
      state: `State`.
    """
    shape = state.belief.driven.shape
    occupied, region = (lax.dynamic_slice(a, (state.base, jnp.int32(0)), shape) for a in (truth.occupied, truth.region))
    known = is_known(state.belief.grid)
    missed = (state.outcome == Outcome.COMPLETE) & jnp.any(state.goal & ~bits.pack(known))
    cell = state.trail[:, Track.SPOT] // 4
    explorable = (region == region[cell[0] // shape[1], cell[0] % shape[1]]) & ~occupied
    steps = state.straight + state.diagonal
    entry = lax.iota(jnp.int32, state.trail.shape[0])
    # In whole numbers: 100 * known reaches q * final. Entries beyond the last step count as the last.
    reached = [(100 * state.trail[:, Track.KNOWN] >= q * state.known) & (entry < steps) for q in PERCENTILES]
    at = jnp.stack([jnp.min(jnp.where(r, entry, steps)) for r in reached])
    # A step to the next column or the next row is straight.
    jump = jnp.abs(cell[1:] - cell[:-1])
    is_diagonal = (jump != 1) & (jump != shape[1])
    diagonal_at = jnp.stack([jnp.sum(is_diagonal & (entry[:-1] < n), dtype=jnp.int32) for n in at])
    return Result(
        straight=state.straight,
        diagonal=state.diagonal,
        turns=state.turns,
        scans=state.scans,
        plans=state.plans,
        exhausted=state.exhausted,
        outcome=jnp.where(missed, Outcome.BLOCKED, state.outcome),
        known=state.known,
        explored=jnp.sum(explorable & known, dtype=jnp.int32),
        explorable=jnp.sum(explorable, dtype=jnp.int32),
        room_entries=state.room_entries,
        straight_at=at - diagonal_at,
        diagonal_at=diagonal_at,
        saturated=state.saturated,
        refused=state.refused,
        overflow=state.overflow,
    )
