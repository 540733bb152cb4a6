"""Motion of a differential drive that knows its pose: it follows its route by pure pursuit, and scans by the clock.

It steers to the point of the route that lies `lookahead_m` ahead, on an arc. Where that point lies more than
`TURN_FIRST_RAD` aside, it brakes and turns in place until it looks there. Farther than `tolerance_m` from its route, or
after something has stopped it, it is careful: it brakes, turns in place to the next cell of the route, and drives there
straight. So it can follow every route, however narrow its turns.

Source:
  Coulter 1992, "Implementation of the pure pursuit path tracking algorithm", equation for the curvature: `2 x / l^2`.
"""

import math
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jax import Array, lax

from jexplore.arrays.loops import pick
from jexplore.arrays.poses import wrapped
from jexplore.config import require_number
from jexplore.engine.program import Given
from jexplore.exploration.motion import MOST_MS, SCAN, TURN
from jexplore.exploration.sensing import stacked
from jexplore.exploration.state import State
from jexplore.exploration.uncertain.poses import EIGHTH, Ride, RideNumbers, rounded
from jexplore.planning import is_open
from jexplore.reach import MOTIONS

PARTS = 4  # times that the robot steers in a motion
MOST_S = 0.2  # s, of a motion; it is also at most as long as the robot at full speed stays within a cell's edge
APPROACH_S, CREEP = 1.0, 0.5  # 1/s, cells/s; it comes to a target, and to a careful robot's cell, no faster than this
TURN_FIRST_RAD = math.pi / 3  # an arc to a point farther aside would lead away from the route
AIM_RAD = 0.1  # a robot that has turned in place drives once it looks there this exactly: 1 cm aside over 0.1 m


def ride_numbers(robot: Any, cell_m: float) -> RideNumbers:
    """Return the numbers of a robot in a world, on the host; refuse one that crosses a cell within a millisecond."""
    require_number("robot.speed_m_s", robot.speed_m_s, high=1000 * cell_m)
    tick_ms = max(1, math.floor(min(1000 * MOST_S, 1000 * cell_m / robot.speed_m_s) + 1e-6))
    per_cell = ("speed_m_s", "acceleration_m_s2", "lookahead_m", "tolerance_m")
    in_cells: Any = {name.split("_m")[0]: getattr(robot, name) / cell_m for name in per_cell}
    turns: Any = {"turn": robot.turn_rad_s, "turn_acceleration": robot.turn_acceleration_rad_s2}
    return RideNumbers(tick_ms=tick_ms, step_s=tick_ms / 1000 / PARTS, **in_cells, **turns)  # type: ignore[arg-type]


def _centre(cell: Array) -> Array:
    return cell[::-1] + jnp.float32(0.5)


def _distance(one: Array, other: Array) -> Array:
    return jnp.hypot(*(one - other))


def _off(xy: Array, one: Array, other: Array) -> Array:
    """Return the distance of a point from the way between the centres of two cells."""
    start, way = _centre(one), (other - one)[::-1].astype(jnp.float32)
    share = jnp.clip(jnp.sum((xy - start) * way) / jnp.maximum(jnp.sum(way**2), 1), 0, 1)
    return _distance(xy, start + share * way)


def _walk(after: Callable[[Array], Array], cell: Array, most: Array, add: Callable[[Any, Any], Any], found: Any) -> Any:
    """Go along a route from a cell until more than `most` of its way lies behind, and collect pieces by `add`.

    `add(found, (cell, next cell, way from the first cell to this one))` returns the new `found`.
    """

    def goes_on(state: Any) -> Array:
        cell, way, _ = state
        return (way <= most) & jnp.any(after(cell) != cell)

    def step(state: Any) -> Any:
        cell, way, found = state
        new = after(cell)
        return new, way + _distance(cell, new), add(found, (cell, new, way))

    return lax.while_loop(goes_on, step, (cell, jnp.float32(0), found))[2]


def _progress(own: RideNumbers, after: Callable[[Array], Array], xy: Array, anchor: Array) -> tuple[Array, Array]:
    """Return the cell of the route behind the robot, by the nearest piece not far ahead, and the distance from it."""

    def nearer(found: Any, piece: Any) -> Any:
        off = _off(xy, *piece[:2])
        return jnp.where(off <= found[1], piece[0], found[0]), jnp.minimum(off, found[1])

    last = _off(xy, anchor, after(anchor))
    return _walk(after, anchor, jnp.maximum(own.lookahead, 2), nearer, (anchor, last))  # at least to the next cell


def _look_ahead(own: RideNumbers, after: Callable[[Array], Array], xy: Array, one: Array) -> tuple[Array, Array]:
    """Return the cell of the route to steer to, and the way left, at least as long as the robot needs to brake.

    `one`: the next cell of the route.
    """
    first = _distance(xy, _centre(one))

    def farther(found: Any, piece: Any) -> Any:
        ahead, _ = found
        cell, new, way = piece
        return jnp.where(first + way < own.lookahead, new, ahead), first + way + _distance(cell, new)

    most = jnp.maximum(own.speed**2 / (2 * own.acceleration), own.lookahead) - first
    return _walk(after, one, most, farther, (one, first))


def _clipped(wanted: Array, now: Array, change: Array) -> Array:
    return jnp.clip(wanted, now - change, now + change)


def _steer(own: RideNumbers, state: State, xy: Array, heading: Array, ride: Ride) -> tuple[Array, Array, Ride]:
    """Return speed and turn of the next part of a motion, and the progress along the route: `(v, w, ride)`."""
    target = state.target

    def after(cell: Array) -> Array:
        return jnp.where(jnp.all(cell == target), cell, cell + jnp.asarray(MOTIONS)[state.route[cell[0], cell[1]]])

    anchor, off = _progress(own, after, xy, ride.anchor)
    careful = (off > own.tolerance) | (ride.careful & jnp.all(anchor == ride.anchor))
    one = after(anchor)
    ahead, rest = _look_ahead(own, after, xy, one)
    aim = _centre(jnp.where(careful, one, ahead))
    aside = wrapped(jnp.arctan2(aim[1] - xy[1], aim[0] - xy[0]) - heading)
    rest = jnp.where(careful, _distance(xy, aim), rest)
    bend = 2 * jnp.sin(aside) / jnp.maximum(_distance(xy, aim), 1e-3)
    arrives = jnp.all(jnp.floor(xy)[::-1] == target)
    goes = jnp.abs(aside) < jnp.where(careful | (ride.speed == 0), AIM_RAD, TURN_FIRST_RAD)
    most = jnp.minimum(own.speed, jnp.sqrt(2 * own.acceleration * rest))
    most = jnp.minimum(most, own.turn / jnp.maximum(jnp.abs(bend), 1e-6))
    slowly = careful | jnp.all(aim == _centre(target))
    most = jnp.where(slowly, jnp.minimum(most, _distance(xy, aim) * APPROACH_S + CREEP), most)
    v = _clipped(jnp.where(goes & ~arrives, most, 0), ride.speed, own.acceleration * own.step_s)
    spin = jnp.minimum(own.turn, jnp.sqrt(2 * own.turn_acceleration * jnp.abs(aside)))
    spin = jnp.minimum(spin, jnp.abs(aside) / own.step_s) * jnp.sign(aside)
    w = jnp.where(arrives, 0, jnp.where(goes, v * bend, spin))
    w = jnp.clip(_clipped(w, ride.turn, own.turn_acceleration * own.step_s), -own.turn, own.turn)
    return v, w, ride.replace(anchor=anchor, careful=careful)


def pursue(given: Given, state: State, when: Array) -> tuple[State, Array]:
    """Follow the route for one motion, `when`: `(state, whether something has stopped the robot)`.

    Its centre enters no cell that is occupied in truth or not open on its map: it stops before at once.
    """
    own, belief = given.numbers.unsure.ride, state.belief
    occupied, base = stacked(given, jnp.asarray(given.scenes.occupied))

    def part(_: Array, now: Any) -> Any:
        xy, heading, way, ride, stopped = now
        v, w, ride = _steer(own, state, xy, heading, ride)
        middle = heading + w * own.step_s / 2
        new = xy + v * own.step_s * jnp.stack([jnp.cos(middle), jnp.sin(middle)])
        col, row = jnp.floor(new).astype(jnp.int32)
        blocked = occupied[base + row, col] | ~is_open(belief, row, col)
        lost = jnp.maximum(ride.speed**2 - v**2, 0) + jnp.where(blocked, v**2, 0)
        moved = ride.replace(
            speed=jnp.where(blocked, 0, v),
            turn=jnp.where(blocked, 0, w),
            careful=ride.careful | blocked,
            turned_rad=ride.turned_rad + jnp.abs(w) * own.step_s,
            braked=ride.braked + lost / own.speed**2,
        )
        after = (
            jnp.where(blocked, xy, new),
            heading + w * own.step_s,
            way + jnp.where(blocked, 0, v * own.step_s),
            moved,
        )
        return *pick(stopped, now[:4], after), stopped | blocked

    poses = state.poses
    start = poses.true[:2], poses.true[2] + state.heading * EIGHTH, jnp.float32(0), poses.ride, ~when
    xy, heading, way, ride, stopped = lax.fori_loop(0, PARTS, part, start)
    pose = jnp.append(xy, wrapped(heading - state.heading * EIGHTH))
    lattice, poses = rounded(state.heading, poses.replace(true=pose, estimate=pose))
    poses = poses.replace(way_m=poses.way_m + way * belief.model.cell_m, ride=ride)
    col, row = jnp.floor(xy).astype(jnp.int32)
    belief = belief.replace(row=row, col=col, heading=lattice)
    return state.replace(row=row, col=col, heading=lattice, belief=belief, poses=poses), when & stopped


def look_on(state: State, eighths: Array) -> State:
    """Turn in place by some eighths of a turn, from standing to standing."""
    poses, heading = state.poses, (state.heading + eighths) % 8
    ride = poses.ride.replace(turned_rad=poses.ride.turned_rad + eighths * EIGHTH)
    belief = state.belief.replace(heading=heading)
    return state.replace(heading=heading, belief=belief, poses=poses.replace(ride=ride))


def time_of(given: Given, state: State, goes: Array, eighths: Array) -> dict[str, Array]:
    """Return the clock of a `State` after a motion, as `motion.tick`: along the route, or a look-around's turn."""
    clock, own = jnp.asarray(given.numbers.clock), given.numbers.unsure.ride
    more = jnp.where(goes, own.tick_ms, 0) + jnp.where(eighths > 0, clock[TURN + eighths] + clock[SCAN], 0)
    return {"time_ms": jnp.minimum(state.time_ms + more, MOST_MS)}


def stands(state: State) -> Array:
    """Return whether the robot stands."""
    ride = state.poses.ride
    return (ride.speed == 0) & (ride.turn == 0)


def begin_route(state: State, route: Array) -> State:
    """Begin to follow a new route, which leads on from the robot's cell."""
    poses = state.poses
    ride = poses.ride.replace(anchor=jnp.stack([state.belief.row, state.belief.col]))
    return state.replace(route=route, poses=poses.replace(ride=ride))


def brake(given: Given, state: State, when: Array | bool) -> State:
    """Brake to a stop, `when`: it takes its time, and the energy of the motion; its way is not driven."""
    own, poses = given.numbers.unsure.ride, state.poses
    ride, kept = poses.ride, jnp.where(when, 0, 1)
    stop_ms = jnp.round(1000 * ride.speed / own.acceleration).astype(jnp.int32) * (1 - kept)
    braked = ride.braked + (1 - kept) * ride.speed**2 / own.speed**2
    ride = ride.replace(speed=ride.speed * kept, turn=ride.turn * kept, braked=braked)
    return state.replace(time_ms=jnp.minimum(state.time_ms + stop_ms, MOST_MS), poses=poses.replace(ride=ride))
