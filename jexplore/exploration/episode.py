"""An exploration episode as a program of the engine: from the first scan to a named outcome, and what it measured."""

import jax.numpy as jnp
from jax import Array

from jexplore.engine.program import Given, Program
from jexplore.exploration import environment, metrics
from jexplore.exploration.motion import tick
from jexplore.exploration.sensing import explorable_and_knowable, first_known
from jexplore.exploration.state import Outcome, Result, Setup, State
from jexplore.exploration.trail import LOOKS, RECORDS, Trail, detail_of
from jexplore.exploration.uncertain.pursuit import brake
from jexplore.grid import is_known

# A tenth of the time of compiling, and nothing gained by it: loops here store what they would compute anew.
CPU_OPTIONS = (("xla_disable_hlo_passes", "while-loop-invariant-code-motion"),)

KEPT = "straight diagonal turns scans plans exhausted n_known room_entries saturated refused"  # of a state, in a result


def plan(setup: Setup, given: Given, state: State) -> State:
    """Run `environment.decide` and `commit`: a `State` with the next plan under way, or the episode's end."""
    carry, choice, route = environment.decide(setup, given, state)
    return environment.commit(setup, given, state.replace(carry=carry), choice, route)


def finish(setup: Setup, given: Given, state: State) -> Result:
    """Return the `Result` of an episode that has ended."""
    shape, ride = state.shape, None
    if setup.rides:
        state = brake(given, state, True)
        ride = jnp.stack([state.poses.ride.turned_rad, state.poses.ride.braked])
    known = is_known(state.seen)
    cell = state.trail[:, Trail.SPOT] // LOOKS
    start = cell[0] // shape[1], cell[0] % shape[1]
    explorable, knowable = explorable_and_knowable(given, *start, state.belief.within)
    outcome = environment.outcome_of(state)
    at, along, reached = first_known(state.trail[:, Trail.KNOWN], state.steps, state.n_known, knowable)
    # A step to the next column or the next row is straight.
    jump = jnp.abs(cell[1:] - cell[:-1])
    is_diagonal = (jump != 1) & (jump != shape[1])
    n_diagonal = jnp.concatenate([jnp.zeros(1, jnp.int32), jnp.cumsum(is_diagonal, dtype=jnp.int32)])
    diagonal_at = n_diagonal[at]
    # In the end the robot brakes.
    end = tick(given.numbers.clock, state, state.heading, jnp.bool_(False), jnp.bool_(True), 0)
    return Result(
        **{name: getattr(state, name) for name in KEPT.split()},
        outcome=outcome,
        explored=jnp.sum(explorable & known, dtype=jnp.int32),
        explorable=jnp.sum(explorable, dtype=jnp.int32),
        straight_at=at - diagonal_at,
        diagonal_at=diagonal_at,
        straight_along=jnp.where(reached, along - n_diagonal[along], -1),
        diagonal_along=jnp.where(reached, n_diagonal[along], -1),
        time_ms=end["time_ms"],
        starts=end["starts"],
        time_at=state.trail[at, Trail.TIME],
        time_along=jnp.where(reached, state.trail[along, Trail.TIME], -1),
        overflow=state.overflow + _left_out(state),
        ride=ride,
        way_m=_ways(state, at, jnp.where(reached, along, -1)),
        metrics=metrics.values_of(setup, given, state.replace(outcome=outcome)),
    )


def _left_out(state: State) -> Array | int:
    """Count what the robot's record of scans, if any, had no room for: points, key scans and loops."""
    poses = state.poses
    if poses is None or poses.mapping is None:
        return 0
    mapping = poses.mapping
    left_out = mapping.points.overflow + mapping.overflow
    if poses.key_of is None:
        return left_out
    loops = jnp.maximum(mapping.n_loops - len(mapping.loops.ends), 0)
    return left_out + loops + jnp.maximum(mapping.n_keys - len(mapping.pose_of), 0)


def _ways(state: State, at: Array, along: Array) -> Array | None:
    """Return `Result.way_m`; `at`, `along`: int32, numbers of steps, -1: never."""
    if state.poses is None:
        return None
    way_m = state.poses.trail[:, 0]
    return jnp.concatenate([state.poses.way_m[None], way_m[at], jnp.where(along < 0, jnp.nan, way_m[along])])


def _is_done(state: State) -> Array:
    return state.outcome != Outcome.RUNNING


def _must_plan(state: State) -> Array:
    return ~state.plan_active


def program_of(setup: Setup, keep: str | None = None) -> Program:
    """Return exploration as a `Program`; `keep`: the record of every episode, one of `trail.RECORDS`, None: none.

    Source:
      Holz et al. 2010, Figure 3 and section 2.3.
    """
    return Program(
        setup=setup,
        begin=environment.begin,
        advance=environment.advance,
        is_done=_is_done,
        finish=finish,
        detail=detail_of,
        decide=plan,
        must_decide=_must_plan,
        drive=None if setup.native is None else environment.drive,
        record=None if keep is None else RECORDS[keep],
        cpu_options=CPU_OPTIONS,
    )
