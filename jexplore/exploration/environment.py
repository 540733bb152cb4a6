"""The rules of exploration, one motion at a time: begin, decide, commit, advance.

`decide` asks the strategy, `commit` makes its choice the plan and makes the first motion, `advance` makes the scan that
belongs to a motion, judges what it means for the plan, and makes the next one. An episode, a replay and whoever steps
by hand all call these. `drive` advances until a plan is done, in native code where there is some: the same bits.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax

from jexplore.arrays import bits
from jexplore.arrays.loops import run_if
from jexplore.engine.program import Given
from jexplore.exploration import metrics, trail
from jexplore.exploration.motion import LENGTHS, PLAN, SCAN, STEP, motion_step, tick, turn_between
from jexplore.exploration.sensing import (
    blank_grid,
    connected,
    enough_cells,
    find_goal,
    known_cells,
    sense,
    stacked,
)
from jexplore.exploration.state import NEVER, Numbers, Outcome, Setup, State, Stream, no_counts
from jexplore.exploration.uncertain.looking import look
from jexplore.exploration.uncertain.moving import mark_bump, turn_and_go
from jexplore.exploration.uncertain.poses import blank_poses
from jexplore.exploration.uncertain.pursuit import begin_route, brake, look_on, pursue, stands, time_of
from jexplore.grid import is_free, is_known, is_occupied
from jexplore.native.drive import Stage
from jexplore.native.drive import drive as drive_natively
from jexplore.native.kernels import target_of
from jexplore.planning import Belief, Choice, choose, field, is_live, is_open
from jexplore.reach import DIAGONAL, FAR, NO_MOTION, STRAIGHT

BAD_TARGETS = 3  # targets in a row that no path leads to, and an episode ends
LOOK_AROUND = 4  # looks, at least, with which a robot looks all round on arrival, the one on arrival included


def _mark(mask: Array, rows: Array, cols: Array, when: Array | bool = True) -> Array:
    """Set some cells of a mask where `when`, none of them twice; a scatter, because it updates the mask in place.

    Skipped cells go to rows beyond the last, each to its own: an accelerator serialises writes that may meet in a cell.
    """
    rows, cols = jnp.atleast_1d(rows), jnp.atleast_1d(cols)
    outside = mask.shape[0] + lax.iota(jnp.int32, rows.shape[0])
    return mask.at[jnp.where(when, rows, outside), cols].set(True, mode="drop", unique_indices=True)


def _n_looks(setup: Setup) -> Array:
    """Return the number of scans of a look-around on arrival: enough to see all round, at least `LOOK_AROUND`."""
    return jnp.maximum(setup.first_scans, LOOK_AROUND)


def _place(
    setup: Setup, given: Given, state: State, motion: Array, looking: Array, ahead: Array
) -> tuple[State, Array, Array]:
    """Return a robot after its next motion, whether that was a step, and whether it was a refused one."""
    belief = state.belief
    drow, dcol, heading = motion_step(motion)
    is_clear = is_open(belief, belief.row + drow, belief.col + dcol)

    def turned(old: Array) -> Array:
        return jnp.where(looking, (old + 8 // _n_looks(setup)) % 8, jnp.where(ahead, heading, old))

    if setup.rides:
        state, stopped = pursue(given, look_on(state, looking * (8 // _n_looks(setup))), ahead)
        return state, ahead, stopped
    if setup.unsure is not None:
        goes = ahead & is_clear
        state, bumped = turn_and_go(given, state, turned(belief.heading), goes, looking | ahead)
        return mark_bump(state, belief.row + drow, belief.col + dcol, bumped), goes & ~bumped, ahead & ~(goes & ~bumped)
    occupied, base = stacked(given, given.scenes.occupied)
    blocked = occupied[base + state.row + drow, state.col + dcol] | ~is_clear
    steps = ahead & ~blocked
    drow, dcol = jnp.where(steps, drow, 0), jnp.where(steps, dcol, 0)
    belief = belief.replace(row=belief.row + drow, col=belief.col + dcol, heading=turned(belief.heading))
    row, col = state.row + drow, state.col + dcol
    return state.replace(row=row, col=col, heading=turned(state.heading), belief=belief), steps, ahead & blocked


def _move(setup: Setup, given: Given, state: State, motion: Array, held: Array | None) -> State:
    """Return the next motion of a plan under way, before its scan: a step along the route, or a turn in place.

    A step into a cell that is not free is refused: the robot only turns towards it. A plan whose next step would be one
    too many ends the episode. Does nothing once the plan is done. `motion` is the route's in the robot's cell. A robot
    that is `held` stands for as long as a straight step takes, instead of a step.
    """
    numbers, looking = given.numbers, state.plan_active & (state.looking > 0)
    limit = jnp.where(state.time_ms >= numbers.max_ms, Outcome.TIME_LIMIT, Outcome.RUNNING)
    motion = jnp.int32(0) if setup.rides else motion  # then it tells no more than that something stopped the robot
    is_diagonal = motion >= 4
    length = LENGTHS[0] * (state.straight + ~is_diagonal) + LENGTHS[1] * (state.diagonal + is_diagonal)
    if setup.rides:
        length = LENGTHS[0] * (state.poses.way_m / state.belief.model.cell_m + 1)
    limit = jnp.where(~looking & (length > numbers.max_path), Outcome.PATH_LIMIT, limit)
    limit = jnp.where(~looking & (state.steps >= numbers.max_steps), Outcome.STEP_LIMIT, limit)
    at_limit = state.plan_active & (limit != Outcome.RUNNING)
    looking &= ~at_limit
    ahead, stands, wait_ms = state.plan_active & ~looking & ~at_limit, looking, numbers.clock[SCAN]
    if held is not None:
        stands, wait_ms = looking | (ahead & held), jnp.where(ahead & held, numbers.clock[STEP], wait_ms)
        ahead &= ~held
    moved, steps, refused = _place(setup, given, state, motion, looking, ahead)
    diagonal = steps & is_diagonal
    if setup.rides:
        since = steps * numbers.unsure.ride.tick_ms
        time = time_of(given, state, ahead, looking * (8 // _n_looks(setup)))
    else:
        since = steps * jnp.where(diagonal, DIAGONAL, STRAIGHT)
        time = tick(numbers.clock, state, moved.heading, steps, stands | refused, wait_ms)
    rooms, base = stacked(given, given.scenes.rooms)
    room = rooms[base + moved.row, moved.col]
    entered = (room >= 0) & (room != state.room)
    return moved.replace(
        came_from=jnp.stack([state.belief.row, state.belief.col]),
        looking=state.looking - looking,
        looked=jnp.where(steps, 0, state.looked + looking),
        bumped=jnp.where(state.plan_active, jnp.where(refused, motion, NO_MOTION), state.bumped).astype(jnp.int32),
        plan_active=state.plan_active & ~at_limit,
        outcome=jnp.where(at_limit, limit, state.outcome),
        since_scan=state.since_scan + since,
        turns=state.turns + turn_between(state.heading, moved.heading),
        straight=state.straight + (steps & ~diagonal),
        diagonal=state.diagonal + diagonal,
        room=jnp.where(entered, room, state.room),
        room_entries=state.room_entries + entered,
        refused=state.refused + refused,
        **time,
    )


def _arrive(setup: Setup, state: State, arrived: Array, live: Array | bool, numbers: Numbers) -> tuple[State, Array]:
    """Handle an arrival by a look-around if the target is live and the rules say so: `(state, exhausted)`."""
    looks = arrived & live & numbers.look_around & (state.looked < _n_looks(setup) - 1)
    spent = arrived & live & ~looks
    state = state.replace(
        looking=jnp.where(looks, _n_looks(setup) - 1, state.looking),
        exhausted=state.exhausted + spent,
        plan_active=jnp.where(arrived, looks, state.plan_active),
    )
    return state, spent


def _mark_exhausted(state: State, spent: Array) -> State:
    exhausted = _mark(state.belief.exhausted, state.target[0], state.target[1], spent)
    return state.replace(belief=state.belief.replace(exhausted=exhausted))


def limit_plans(numbers: Numbers, state: State) -> State:
    """End an episode whose plan is done and that may make no other."""
    spent = (state.outcome == Outcome.RUNNING) & ~state.plan_active & (state.plans >= numbers.max_plans)
    return state.replace(outcome=jnp.where(spent, Outcome.PLAN_LIMIT, state.outcome))


def _over(setup: Setup, numbers: Numbers, state: State, outcome: Outcome, when: Array) -> State:
    """End an episode as `outcome`, `when`: at once, or once the robot is back home, or finds no way there."""
    if not setup.ends:
        return state.replace(outcome=jnp.where(when, outcome, state.outcome))
    belief, is_homing = state.belief, state.homing > 0
    away = (belief.row != belief.start[0]) | (belief.col != belief.start[1])
    goes = when & numbers.return_home & away & ~is_homing
    now = jnp.where(when & ~goes, jnp.where(is_homing, state.homing, outcome), state.outcome)
    return state.replace(homing=jnp.where(goes, outcome, state.homing), outcome=now)


def _stop(setup: Setup, numbers: Numbers, state: State, when: Array) -> tuple[State, Array | bool]:
    """End an episode in which enough is known, `when`, and a look-around: `(state, whether that is so)`."""
    if not setup.ends:
        return state, False
    done = when & (state.n_known >= state.enough) & (state.homing == 0) & (state.outcome == Outcome.RUNNING)
    state = state.replace(looking=jnp.where(done, 0, state.looking))
    return _over(setup, numbers, state, Outcome.EXPLORED, done), done


def advance(setup: Setup, given: Given, state: State, held: Array | None = None) -> State:
    """Make one scan of a plan under way, update the plan, and make the next motion if it goes on.

    Scan first, motion last: everything is then read from the map after its update, which can so be made in place. Once
    the plan is done, maps, trail and counters stay the same. `held`: bool, whether another robot is in the way.
    """
    belief, plan_active, numbers = state.belief, state.plan_active, given.numbers
    # Both orthogonal neighbours of a diagonal step belong to the driven way.
    (row, col), (row_before, col_before) = (belief.row, belief.col), state.came_from
    diagonal = (row != row_before) & (col != col_before)
    if setup.unsure is not None:  # it may be taken to be anywhere after a correction
        diagonal &= (jnp.abs(row - row_before) == 1) & (jnp.abs(col - col_before) == 1)
    beside = jnp.stack([row, row, row_before]), jnp.stack([col, col_before, col])
    marked = plan_active & jnp.stack([jnp.bool_(True), diagonal, diagonal])
    if setup.rides:  # it has passed one of the two, and the other may be a wall
        marked &= is_open(belief, *beside)
    state = state.replace(belief=belief.replace(driven=_mark(belief.driven, *beside, marked)))
    row, col = state.target[0] - belief.row, state.target[1] - belief.col
    here = (row == 0) & (col == 0) & (stands(state) if setup.rides else True)
    near = row * row + col * col <= numbers.arrival_d2
    due = plan_active & (here | (state.bumped >= 0) | (state.since_scan >= numbers.scan_every))
    state = state.replace(since_scan=jnp.where(due, 0, state.since_scan))
    state = metrics.take_stock(setup, given, trail.note_step(_scan(setup, given, state, due), plan_active), plan_active)
    live = is_live(state.belief, *state.target)
    if setup.policy.live is not None:
        asked = state.is_view & state.plan_active & (numbers.recheck | near) & (state.homing == 0)

        def look(_: Array) -> Array:
            return setup.policy.live(numbers.params, state.belief, given.shared, *state.target)

        live = run_if(asked, look, live)
    state, enough = _stop(setup, numbers, state, plan_active)
    bumped = (state.bumped >= 0) | enough
    if state.poses is not None:
        bumped |= state.poses.strayed | (state.outcome != Outcome.RUNNING)  # off its route it plans anew; or it is lost
    is_homing = state.homing > 0
    given_up = bumped | ((numbers.recheck | near) & ~live & ~here & ~is_homing)
    state = state.replace(plan_active=plan_active & ~given_up)
    if setup.ends:
        live &= ~is_homing
        home = is_homing & plan_active & here & ~bumped
        state = state.replace(outcome=jnp.where(home, state.homing, state.outcome))
    state, spent = _arrive(setup, state, plan_active & here & ~bumped & (state.looking == 0), live, numbers)
    state = _mark_exhausted(state, spent)
    motion = state.route[state.belief.row, state.belief.col]
    return limit_plans(numbers, _move(setup, given, state, motion, held))


def _scan(setup: Setup, given: Given, state: State, when: Array) -> State:
    """Make one scan and count it into the map, if `when`."""
    return sense(setup, given, state, when) if setup.unsure is None else look(setup, given, state, when)


def drive(setup: Setup, given: Given, state: State) -> State:
    """Advance until the plan under way is done."""
    if target_of(setup.native) is None:
        return lax.while_loop(lambda state: state.plan_active, lambda state: advance(setup, given, state), state)
    state, asks = drive_natively(setup, given, state, Stage.NEXT_SCAN)
    if setup.policy.live is None:
        return state

    def answer(both: tuple[State, Array]) -> tuple[State, Array]:
        state, _ = both
        live = setup.policy.live(given.numbers.params, state.belief, given.shared, *state.target)
        return drive_natively(setup, given, state, Stage.ANSWERED, live)

    return lax.while_loop(lambda both: both[1], answer, (state, asks))[0]


def decide(setup: Setup, given: Given, state: State) -> tuple[Any, Choice, Array]:
    """Ask the strategy for a target, in a running episode that carries out no plan: `(carry, choice, route)`.

    The target of a robot that returns is its start; it counts as a view point.
    """
    belief = state.belief

    def ask(asked: Any) -> Any:
        key = jax.random.fold_in(jax.random.fold_in(given.key, Stream.POLICY), state.plans)
        return setup.policy.select(key, given.numbers.params, asked[0], belief, given.shared, asked[2])

    def go_home(asked: Any) -> Any:
        choice, route, is_open = go_to(belief, asked[2], *belief.start[:2])
        return asked[0], choice.replace(is_view=is_open), route

    zero, none = jnp.int32(0), jnp.int32(-1)
    asked = state.carry, Choice(none, none, jnp.int32(FAR), zero, jnp.bool_(False), zero), state.route
    if not setup.ends:
        return ask(asked)
    return run_if(state.homing > 0, go_home, run_if(state.homing == 0, ask, asked))


def go_to(belief: Belief, route: Array, row: Array, col: Array) -> tuple[Choice, Array, Array]:
    """Choose a cell, if a way leads there: `(choice, route, whether one does)`."""
    reached = field(belief)
    is_open = reached.cost[row, col] < FAR
    choice, route = choose(belief, route, reached, jnp.where(is_open, row, -1), jnp.where(is_open, col, -1))
    return choice.replace(overflow=jnp.int32(0)), route, is_open


def commit(
    setup: Setup, given: Given, state: State, choice: Choice, route: Array, live: Array | bool = True, held: Any = None
) -> State:
    """Turn a choice into the plan and make its first motion; none ends the episode as complete, as far as is known.

    A target that no path leads to is refused: the strategy is asked again, and the third in a row ends the episode.
    `route`: `[H, W]` int8, motions to the target (`planning.readout.lay_route`); `live`: bool, whether a look from the
    target is worth while: of a strategy's target it always is; `held` as for `advance`.
    """
    none = choice.row < 0
    bad = ~none & (choice.cost >= FAR)
    bad_targets = jnp.where(bad, state.bad_targets + 1, 0)
    plan, entry = state.plans, trail.choice_of(state, choice, bad)
    clock = given.numbers.clock
    time = tick(clock, state, state.heading, jnp.bool_(False), clock[PLAN] > 0, clock[PLAN])
    state = state.replace(
        target=jnp.stack([choice.row, choice.col]),
        is_view=jnp.asarray(choice.is_view),
        overflow=state.overflow + choice.overflow,
        plans=state.plans + 1,
        saturated=choice.saturated,
        bad_targets=bad_targets,
        plan_active=~none & ~bad,
        bumped=jnp.int32(NO_MOTION),
        outcome=jnp.where(bad_targets >= BAD_TARGETS, Outcome.BAD_TARGET, state.outcome),
        **time,
    )
    if setup.rides:
        state = begin_route(brake(given, state, clock[PLAN] > 0), route)
    state = _over(setup, given.numbers, state, Outcome.COMPLETE, none)
    # A path of length 0 is an arrival.
    here = (state.belief.row == choice.row) & (state.belief.col == choice.col)
    here &= ~bad & (stands(state) if setup.rides else True)
    state, spent = _arrive(setup, state, here, live, given.numbers)
    state = limit_plans(given.numbers, _move(setup, given, state, route[state.belief.row, state.belief.col], held))
    return _mark_exhausted(state, spent).replace(route=route, choices=state.choices.at[plan].set(entry, mode="drop"))


def blank_belief(given: Given) -> Belief:
    """Return the `Belief` of a robot that has seen nothing yet; `given` as for `begin`."""
    truth, (row, col, heading) = given.scenes, given.task
    flags = jnp.zeros(truth.occupied.shape[1:], bool)
    return Belief(
        grid=blank_grid(given),
        driven=_mark(flags, row, col),
        exhausted=flags,
        row=row,
        col=col,
        heading=heading,
        start=jnp.stack([row, col, heading]),
        extent=truth.extent[given.scene],
        model=given.numbers.model,
        within=None if truth.within is None else truth.within[given.scene],
    )


def outcome_of(state: State) -> Array:
    """Return the outcome of an episode: `COMPLETE` becomes `BLOCKED` if a cell of the goal is unknown. int32.

    If the pose is not given, a cell counts as known once it has been seen in truth.
    """
    missed = (state.outcome == Outcome.COMPLETE) & jnp.any(state.goal & ~bits.pack(is_known(state.seen)))
    outcome = jnp.where(missed, Outcome.BLOCKED, state.outcome)
    if state.poses is None or state.poses.seen is None:
        return outcome
    belief = state.belief
    free, walls = is_free(belief.grid, belief.model.p_free), is_occupied(belief.grid, belief.model.p_free)
    _, enclosed = connected(belief.model, free, walls, belief.row, belief.col)
    return jnp.where(missed & enclosed, Outcome.INCONSISTENT, outcome)


def begin(setup: Setup, given: Given) -> State:
    """Return the state of an episode that has made its first scans.

    `given`: key of the episode, consumed by all of its parts together, each drawing from streams of its own; `Beams`
    with 8 headings shared; `Truth` of M worlds; `Numbers`; the task is the start, `[3]` int32, row, col and heading.
    """
    truth, (row, col, _) = given.scenes, given.task
    shape = truth.occupied.shape[1:]
    goal, stuck = find_goal(given, row, col)
    belief = blank_belief(given)
    n_known = jnp.int32(0) if truth.prior is None else known_cells(belief.grid, belief.within)
    rooms, base = stacked(given, truth.rooms)
    room = rooms[base + row, col]
    steps, choices = trail.blank(setup.capacity)
    state = State(
        row=row,
        col=col,
        heading=belief.heading,
        belief=belief,
        goal=goal,
        route=jnp.full(shape, NO_MOTION, jnp.int8),
        trail=steps,
        choices=choices,
        carry=setup.policy.init(given.numbers.params, belief),
        target=jnp.full((2,), -1, jnp.int32),
        is_view=jnp.bool_(False),
        plan_active=jnp.bool_(False),
        bumped=jnp.int32(NO_MOTION),
        came_from=jnp.stack([row, col]),
        room=room,
        outcome=jnp.where(stuck, Outcome.STUCK, Outcome.RUNNING).astype(jnp.int32),
        room_entries=(room >= 0).astype(jnp.int32),
        poses=setup.unsure and blank_poses(setup.unsure, belief.grid, setup.capacity, given.task, belief.model.cell_m),
        enough=enough_cells(given, row, col, belief.within) if setup.ends else jnp.int32(NEVER),
        **no_counts() | {"n_known": n_known},
    )

    if target_of(setup.native) is not None:
        return drive_natively(setup, given, state, Stage.FIRST_SCANS)[0]

    def look_round(_: Array, state: State) -> State:
        state, belief = _scan(setup, given, state, ~stuck), state.belief
        turned = (belief.heading + 8 // setup.first_scans) % 8
        if setup.unsure is not None and not setup.rides:
            return turn_and_go(given, state, turned, jnp.bool_(False), ~stuck)[0]
        return state.replace(heading=turned, belief=state.belief.replace(heading=turned))

    state = trail.note_step(lax.fori_loop(0, setup.first_scans, look_round, state))
    state, _ = _stop(setup, given.numbers, state, ~stuck)
    return metrics.take_stock(setup, given, state, state.row >= 0)
