"""Driving until the strategy must be asked, as one call of native code inside a program of JAX's: for one robot, or the
robots of a team, on a CPU whose scanners are without noise. What it does is what `exploration.environment.advance` and
`team.environment.advance` do, bit by bit.
"""

import enum
from importlib.metadata import version
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jexplore.native.build import FOLDER, Library, load_library
from jexplore.native.kernels import KERNELS, call, numbers

SOURCES = tuple(
    FOLDER / name for name in ("drive.cc", "sweep.h", "plan.h", "counts.h", "paths.h", "world.h", "rules.h")
)
CHANGED = (
    "row", "col", "heading", "looking", "looked", "plan_active", "bumped", "since_scan", "n_known", "room", "straight",
    "diagonal", "turns", "scans", "exhausted", "outcome", "room_entries", "refused",
    "time_ms", "run", "starts", "homing",
)  # fmt: skip
"""Numbers of a state that driving changes, in the order of `Changed` in drive.cc."""

MEMBER = ("clock", "waits", "in_a_row", "hemmed")
TALLY = ("n_known", "n_log", "last", "links")
"""Numbers of a team that driving changes: of each robot, and of all; in the order of `Member` and `Tally`."""


class Stage(enum.IntEnum):
    """Stage at which driving sets in."""

    FIRST_SCANS = 0  # with those at the start, and no other
    NEXT_SCAN = 1  # with that which belongs to the last motion
    ANSWERED = 2  # after it: the strategy has said whether its target is live


_registered: set[str | None] = set()  # names of libraries


def load_driving() -> Library:
    """Return the library, built if need be; its name is a target of JAX's FFI."""
    flags = f"-I{jax.ffi.include_dir()}", f'-DJAXLIB="{version("jaxlib")}"'
    found = load_library(SOURCES, flags)
    if found.loaded is None or found.name in _registered:
        return found
    try:
        for kernel in KERNELS:
            handler = jax.ffi.pycapsule(getattr(found.loaded, f"jexplore_{kernel}"))
            jax.ffi.register_ffi_target(f"{found.name}_{kernel}", handler, platform="cpu")
    except AttributeError as error:
        return Library(None, f"{SOURCES[0].name} could not be loaded: {error}")
    _registered.add(found.name)
    return found


def drive(setup: Any, given: Any, state: Any, stage: Stage, live: Array | bool = False) -> tuple[Any, Array]:
    """Drive a robot until its plan is done or its strategy must be asked: `(state, asks)`.

    Maps and trail change in place where they are used no more. `live`: bool, what the strategy has said; `asks`: bool,
    whether it must say whether its target is live before the robot goes on.
    """
    belief, truth, beams = state.belief, given.scenes, given.shared
    own = numbers([getattr(state, name) for name in CHANGED])
    changed = jnp.concatenate([own, state.came_from, jnp.zeros(1, jnp.int32)])
    within = jnp.zeros((1, 1), bool) if belief.within is None else belief.within
    maps = belief.grid.hits, belief.grid.misses, belief.driven, belief.exhausted, state.trail
    places = state.route, truth.occupied, truth.rooms, within, beams.by_beam, beams.length, beams.blind
    given_up = *maps, changed
    p_free = jnp.asarray(belief.model.p_free, jnp.float32)
    *maps, new = call(
        setup.native, "drive", [(a.shape, a.dtype) for a in given_up], *given_up, *places,
        _terms(setup, given, state, stage, live), p_free, given.numbers.clock, in_place=len(given_up),
    )  # fmt: skip
    *own, row, col, asks = jnp.unstack(new)
    state = state.replace(**dict(zip(CHANGED, own)), came_from=jnp.stack([row, col]), trail=maps.pop())
    hits, misses, driven, exhausted = maps
    where = {"row": state.row, "col": state.col, "heading": state.heading}
    grid = belief.grid.replace(hits=hits, misses=misses)
    belief = belief.replace(grid=grid, driven=driven, exhausted=exhausted, **where)
    return state.replace(belief=belief, plan_active=state.plan_active != 0), asks != 0


def _terms(setup, given, state, stage, live):
    """Return the numbers that driving reads, in the order of `Terms` in drive.cc."""
    rules = given.numbers
    return numbers(
        [
            *state.target, state.is_view, state.plans, stage, live, given.scene, *state.belief.extent,
            setup.first_scans, rules.arrival_d2, rules.scan_every, rules.max_steps, rules.max_plans, rules.look_around,
            rules.recheck, rules.no_echo_is_free, setup.policy.live is not None, state.belief.model.connectivity,
            *state.belief.start[:2], state.enough, rules.return_home, rules.max_path, rules.max_ms,
        ]
    )  # fmt: skip


def take_turns(setup: Any, given: Any, own: Any, team: Any, *turn: Array | bool) -> Any:
    """Have a robot of a `TeamState` make its scan and the next motion.

    Args:
      own: given the number of a robot, returns its run context.
      turn: the robot's number; how many it hears, itself included; whether others act after it, until one must plan,
        which is right where all always hear each other.
    """
    robots, truth, beams = team.robots, given.scenes, given.shared
    belief, grid = robots.belief, robots.belief.grid
    own_numbers = [getattr(robots, name) for name in CHANGED] + [*robots.came_from.T, jnp.zeros_like(robots.row)]
    members = numbers([*own_numbers, *(getattr(team, name) for name in MEMBER)]).T
    tally = numbers([*(getattr(team, name) for name in TALLY), *turn])
    terms = jax.vmap(lambda i, state: _terms(setup.robot, own(i), state, Stage.NEXT_SCAN, False))
    within = jnp.zeros((1, 1, 1), bool) if belief.within is None else belief.within
    length = beams.length.reshape(-1, *beams.length.shape[-2:])
    given_up = grid.hits, grid.misses, belief.driven, belief.exhausted, members, team.seen_at, team.log, team.way, tally
    hits, misses, driven, exhausted, members, seen_at, log, way, tally = call(
        setup.native, "turns", [(a.shape, a.dtype) for a in given_up], *given_up, robots.route, truth.occupied,
        truth.rooms, within, beams.by_beam, length, beams.blind, terms(jnp.arange(setup.n), robots), given.task.paces,
        jnp.asarray(given.numbers.model.p_free, jnp.float32), given.numbers.clock, in_place=len(given_up),
    )  # fmt: skip
    n, grid = len(CHANGED), grid.replace(hits=hits, misses=misses)
    changed, kept = (dict(zip(names, part.T)) for names, part in ((CHANGED, members), (MEMBER, members[:, n + 3 :])))
    where = {name: changed[name] for name in ("row", "col", "heading")}
    belief = belief.replace(grid=grid, driven=driven, exhausted=exhausted, **where)
    changed |= {"plan_active": changed["plan_active"] != 0, "came_from": members[:, n : n + 2], "belief": belief}
    kept |= {"hemmed": kept["hemmed"] != 0, "robots": robots.replace(**changed)}
    return team.replace(**kept, **dict(zip(TALLY, jnp.unstack(tally))), seen_at=seen_at, log=log, way=way)
