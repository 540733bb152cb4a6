"""Steering of a robot that follows a route: towards the next place, and at the end."""

import jax.numpy as jnp
from jax import Array

from jexplore import btm
from jexplore.arrays.loops import pick
from jexplore.driving import behaviour
from jexplore.driving.guiding.guide import NEXT_PLACES, next_stop
from jexplore.driving.params.tree import P
from jexplore.driving.records import Drive, Guide, Latch, RunMode, State, Track, Writer
from jexplore.driving.sensing import surround
from jexplore.driving.settings import Robot, Tuning
from jexplore.driving.vehicle import towards


def update_progress(
    guide: Guide, odometer_m: Array, estimate: Array, ways_m: Array, is_blocked: Array, robot: Robot
) -> Guide:
    """Check whether the route's end has been reached, or the robot is lost.

    The end is reached where it lies, with a free way there: a robot that has gone as far as the map says may have gone
    another way, through a room above all.
    """
    gone_m, left = odometer_m - guide.from_m, guide.count - guide.at
    place = jnp.minimum(guide.at + jnp.arange(NEXT_PLACES), guide.out.shape[0] - 1)
    end, _, length_m, is_end = next_stop(guide)
    off_m, _, sees = _sight(end, estimate, ways_m, robot)
    within_m = jnp.clip(P.route.end_m[0] + P.route.end_m[1] * (gone_m - length_m), P.route.end_m[0], P.route.end_m[2])
    arrived = guide.arrived | (is_end & sees & (off_m < within_m))
    length_m = jnp.sum(jnp.where(jnp.arange(NEXT_PLACES) < left, guide.length_m[place], 0))
    length_m += jnp.where(left < NEXT_PLACES, guide.tail_m, 0)
    blocked = guide.blocked | (is_blocked & ~arrived)
    too_far = gone_m > P.route.lost_bound[0] * length_m + P.route.lost_bound[1]
    return guide.replace(arrived=arrived, lost=guide.lost | (~arrived & too_far) | blocked, blocked=blocked)


def _sight(place, estimate, ways_m, robot):
    """Return the position of a place relative to the robot. Returns `(off_m, bearing, sees)`: metres; radians, in the
    robot's frame; bool, the way there is free."""
    off = place - estimate[:2]
    off_m, bearing = jnp.hypot(*off), btm.wrapped(jnp.arctan2(off[1], off[0]) - estimate[2])
    at = jnp.argmin(jnp.abs(btm.wrapped(surround.DIRECTION - bearing)))
    sees = (ways_m[at] + robot.length_m / 2 > off_m - P.route.sight_slack_m) & (off_m < P.route.known_way_m)
    return off_m, bearing, sees


def steer_along_route(
    state: State,
    writer: Writer,
    drive: Drive,
    track: Track,
    estimate: Array,
    ways_m: Array,
    is_blocked: Array,
    tuning: Tuning,
    robot: Robot,
) -> tuple[Writer, Drive, Track]:
    """Steer a robot that follows a route.

    Where no passage leads the robot, it steers for the next place of the route or for its end: in a room, at a place
    missing in the map, at its start, and when the target is in sight, it drives along the free way that bears nearest
    to it. Near a place that it has not recognised it goes to the mapped position and looks round; in free space, where
    no place can be seen, coming near is arriving.
    """
    guide = update_progress(writer.guide, state.odometer_m, estimate, ways_m, is_blocked, robot)  # type: ignore[arg-type]
    nodes = jnp.stack([writer.map.x_m, writer.map.y_m], axis=1)
    nodes = jnp.where((writer.map.kind == btm.DIVERGENCE)[:, None], nodes, jnp.inf)
    looked = jnp.stack([writer.passed[:2], nodes[writer.node]])
    steered = _steered(state, guide, drive, track, estimate, ways_m, (nodes, looked), tuning, robot)
    return writer.replace(guide=steered[0]), *steered[1:]


def _steered(state, guide, drive, track, estimate, ways_m, places, tuning, robot):
    """Return `(guide, drive, track)`; `places`: nodes, and where the robot has just looked round: pair of `[P, 2]`."""
    place, leg_m, length_m, is_end = next_stop(guide)
    off_m, bearing, sees = _sight(place, estimate, ways_m, robot)
    gone_m, leaves = state.odometer_m - guide.from_m, drive.latch == Latch.LEAVE
    is_near = sees & (off_m < P.route.sight_m)
    is_free = (drive.latch == Latch.FREE) | (leaves & (guide.steers | is_near | (is_end & sees)))
    # A place where it has been before is no help, unless it is the one that it looks for.
    is_old = jnp.any(jnp.hypot(*(places[0] - track.centre).T) < P.route.at_mapped_m) & guide.strays
    is_old &= jnp.hypot(*(track.centre - place)) > P.route.at_mapped_m
    is_believed = behaviour.is_believed(track, tuning.votes) & ~(is_end & sees) & ~is_old
    is_straight = length_m < P.route.straight_link[0] * leg_m + P.route.straight_link[1]
    limit_m = P.route.steer_bound[0] * jnp.where(is_straight, length_m, leg_m) + P.route.steer_bound[1]
    may = is_free & ~is_believed & ~guide.arrived & (gone_m < limit_m)
    has_looked = jnp.any(jnp.hypot(*(places[1] - place).T) < P.route.at_mapped_m)
    looks = may & ~is_end & sees & (off_m < P.route.next_place_m) & ~has_looked & ~state.inside
    meets = may & ~is_end & sees & (off_m < P.route.at_mapped_unseen_m) & state.inside
    is_open = ways_m > jnp.minimum(P.route.hop_m, off_m)
    off = jnp.abs(btm.wrapped(surround.DIRECTION - bearing))
    before = jnp.where(guide.steers & leaves, btm.wrapped(drive.out - estimate[2]), 0.0)
    turns = jnp.abs(btm.wrapped(surround.DIRECTION - before))
    cost = jnp.where(is_open & (off < P.route.towards_rad), off + P.route.keep_course_weight * turns, jnp.inf)
    best = jnp.where(sees, bearing, jnp.asarray(surround.DIRECTION)[jnp.argmin(cost)]) + estimate[2]
    wants = guide.strays | (guide.at == 0) | is_end | is_near
    wants |= ((state.mode != RunMode.CENTRAL) & (state.mode != RunMode.BRANCH_SELECTION)) | guide.steers
    steers = may & ~looks & wants & (sees | jnp.any(jnp.isfinite(cost)))
    steers &= (is_end | ~has_looked) & ~meets
    hop = estimate[:2] + jnp.minimum(off_m, P.route.hop_m) * towards(best)
    out = guide.out[jnp.minimum(guide.at, guide.out.shape[0] - 1)] - guide.turned
    beyond = place + P.route.hop_m * towards(out)
    frees = guide.steers & leaves & ~steers & ~looks & ~meets
    latch = jnp.where(frees, Latch.FREE, jnp.where(steers | meets, Latch.LEAVE, drive.latch))
    latch = jnp.where(looks, Latch.APPROACH, latch)
    there = behaviour.certain_track(place, 1.0)
    drive = drive.replace(
        latch=latch.astype(jnp.int32),
        target=jnp.where(steers, hop, jnp.where(looks, place, jnp.where(meets, beyond, drive.target))),
        since=jnp.where(looks | frees | meets | (steers & ~guide.steers), 0, drive.since),
        out=jnp.where(steers, best, jnp.where(looks, estimate[2], jnp.where(meets, out, drive.out))),
    )
    track = pick(looks, there, track)
    after = guide.replace(
        steers=steers,
        at=guide.at + meets,
        from_xy=jnp.where(meets, place, guide.from_xy),
        from_m=jnp.where(meets, state.odometer_m, guide.from_m),
        missed=guide.missed + meets,
        strays=guide.strays & ~meets,
    )
    return after, drive, track
