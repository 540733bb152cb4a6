"""Robots that follow routes over a Behavioral Trace Map in the true building, and what they find otherwise there."""

import dataclasses
import math
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

from jexplore.config import MAX_SEED, InputError, as_record, checked_names, require_whole
from jexplore.driving import vehicle
from jexplore.driving.batch import MAX_STEPS, building_of, pose_in, settings_arrays, why_unfit
from jexplore.driving.local.batch import make_all, tasks_of
from jexplore.driving.local.follow import Follower, Stop, is_new
from jexplore.driving.records import Building
from jexplore.driving.settings import Noise, Robot, Tuning, for_world, require_tuning
from jexplore.studies import checks
from jexplore.studies.traces import routes
from jexplore.studies.traces.job import MAX_TRACE_STEPS
from jexplore.tracemap.passable import BLOCKED, BLOCKED_FOR, CONFLICTS, FOUND_BY, blocked_for
from jexplore.tracemap.record import NOWHERE, STATUS, BtmMap, Link
from jexplore.tracemap.route import MapIndex, Route
from jexplore.worlds.world import World, with_ring

CLEAR_M = 1.5, 1.0, 2.0, 0.6, 3.0, 0.3  # m; starts along a link: the first where the robot can turn, or that is free
START_OFFSETS_M = 0.0, 0.3, -0.3, 0.6, -0.6  # m; offsets from the link where the robot cannot turn anywhere on it
TURNING_MARGIN_M = 0.05  # m; margin of a robot that turns at its start
STEPS_M = 60  # steps that a robot has for each metre of its route
STRAIGHT_SHARE = 0.8  # of its length lie the ends of a link apart at least, if its middle is known
ON_IT_M = 1.0  # a robot so near to the middle of a link is on it


@checked_names
@dataclasses.dataclass(frozen=True)
class FollowResult:
    """Result of `follow`."""

    table: Any
    """pandas DataFrame, a row a route: from, to, outcome (ARRIVED, LOST, BLOCKED, ...), length_m by the map, path_m,
    off_m from where the map has its end, places on it, missed and extra ones, refused_links: on how many straight links
    that the map refuses to the robot it has been, steps, contacts, refused steps, drift_m of its pose."""
    map: BtmMap
    """The map with what was found otherwise: ways that it did not have, as un-searched links; links that could not be
    passed, with the attributes `blocked` and `blocked_for`; each with `found_by`."""
    changes: tuple[str, ...]
    """The same in sentences."""


@checked_names
def follow(
    world: str | os.PathLike[str] | World, btm: BtmMap, found: Sequence[Route], robot: str | Robot, *,
    noise: Noise | Mapping[str, Any] | None = None, tuning: Tuning | Mapping[str, Any] | None = None,
    seed: int = 0, cell_m: float = 0.1,
    workers: int | None = None, on_progress: Callable[[int], Any] | None = None,
) -> FollowResult:  # fmt: skip
    """Let a robot follow routes in the true building.

    It starts on the first link of a route, a little beyond the node. By its local map it plans to the next node of the
    route, seen from the last divergence that it has recognised, and leaves every node by the exit of the route. See
    `driving.local.follow`.

    Args:
      world: name or `World`: the building of the map, in whose frame this must be.
      btm: the map of the routes.
      found: routes of one link or more, from `jx.btm.route` or `jx.btm.routes`.
      robot: name or `Robot`.
      noise, tuning: `Noise`, `Tuning`, or mappings of some of their fields.
      seed: of the noise: route i draws as run i does.
      cell_m: edge of a cell of the world, metres.
      workers: see `runner.find_resources`.
      on_progress: called with the number of finished routes.
    """
    world = with_ring(*checks.ready_worlds([world], cell_m))
    body, tuning, noise = _checked(world, btm, found, robot, tuning, noise)
    seed = require_whole("seed", seed, 0, MAX_SEED)
    building = building_of(world, marks_m=_refused_places(btm, found))
    begun = [start_of(world, building, body, btm, route) for route in found]
    n, longest = len(found), max(route.length_m for route in found)
    max_steps = int(min(max(MAX_STEPS, STEPS_M * longest), MAX_TRACE_STEPS))
    settings = settings_arrays(body, n), settings_arrays(tuning, n), settings_arrays(noise, n)
    starts = np.stack([pose for pose, *_ in begun])
    tasks = tasks_of(building, *settings, starts, seed, np.arange(n), max_steps)

    def run_one(i, watch):
        follower = _follower(world, btm, found[i], tasks[i], begun[i][2], watch)
        return follower.drive(), follower

    runs, _ = make_all(n, run_one, workers, on_progress)
    changed, told = _changed(btm, found, runs, body)
    return FollowResult(_table(world, btm, found, runs, building), changed, tuple(told))


def _follower(world, btm, route, task, beside, watch):
    """Make the follower of a route; `beside` is its start's offset from the link."""
    nodes, origin = {node.id: node for node in btm.nodes}, np.asarray(world.origin_m)

    def at(node):
        return np.array([node.x_m, node.y_m]) - origin

    stops = []
    for step, on in zip(route.steps, [*route.steps[1:], None]):
        out = math.radians(on.bearing_deg) if on else math.nan
        exits = [math.radians(bearing) for bearing in btm.bearings_deg(step.end)]
        stops.append(Stop(at(nodes[step.end]), nodes[step.end].type == "divergence", exits, out))
    return Follower(
        task,
        stops,
        begin=at(nodes[route.start]) + beside,
        length_m=route.length_m,
        places=np.reshape([at(node) for node in btm.nodes if node.type == "divergence"], (-1, 2)),
        on_step=watch,
    )


def _refused_places(btm, found):
    """Return the middles of straight links that are refused to a route's robot: `[K, 3]`, as for `building_of`."""
    index, places = MapIndex(btm), []
    refused = {own for route in found for own, _ in route.refused}
    for own, length_m in index.length_m.items():
        a, b = (index.nodes[end] for end in (index.links[own].start, index.links[own].end))
        if own in refused and math.hypot(b.x_m - a.x_m, b.y_m - a.y_m) > STRAIGHT_SHARE * length_m:
            places.append(((a.x_m + b.x_m) / 2, (a.y_m + b.y_m) / 2, ON_IT_M))
    return np.reshape(places, (-1, 3))


def _checked(world, btm, found, robot, tuning, noise):
    """Check and return `(Robot, Tuning, Noise)`."""
    btm = routes.checked_map(btm)
    body = routes.checked_robot(robot)
    tuning = for_world(as_record("tuning", tuning or {}, Tuning), is_course=world.course is not None)
    noise = as_record("noise", noise or {}, Noise)
    require_tuning(tuning)
    if isinstance(found, (str, Route)) or not found or not all(isinstance(route, Route) for route in found):
        raise InputError("routes to follow must be a list of one jx.btm.Route or more, such as jx.btm.routes(...)[0]")
    nodes, links = {node.id for node in btm.nodes}, {link.id for link in btm.links}
    for route in found:
        if not (route.links and nodes.issuperset(route.nodes) and links.issuperset(route.links)):
            raise InputError(f"a route to follow must be one of this map with a link or more, got {route!r}")
        if route.robot != body.name:
            raise InputError(f"{body.name} cannot follow a route of {route.robot}: ask for one of its own")
    return body, tuning, noise


def start_of(
    world: World, building: Building, robot: Robot, btm: BtmMap, route: Route
) -> tuple[np.ndarray, float, tuple[float, float]]:
    """Find the start of a robot that follows a route: on its first link, or near it; where it can turn, if possible.

    Returns `(start, from_m, beside_m)`: `[3]` float32, from `pose_in`; distance from the node; x, y, offset from the
    link. A map is off by as much as the odometry of the robot that wrote it.
    """
    step = route.steps[0]
    node = next(node for node in btm.nodes if node.id == step.start)
    angle = math.radians(step.bearing_deg)
    device, fits = jax.tree.map(jnp.asarray, building), []
    for aside in START_OFFSETS_M:
        beside = -aside * math.sin(angle), aside * math.cos(angle)
        for metres in (m for m in CLEAR_M if m <= max((step.length_m or 0) / 2, CLEAR_M[-1])):
            x_m, y_m = node.x_m + metres * math.cos(angle), node.y_m + metres * math.sin(angle)
            pose = pose_in(world, (x_m + beside[0], y_m + beside[1], step.bearing_deg))
            if not why_unfit(world, device, robot, pose):
                fits.append((pose, metres, beside))
                if not bool(vehicle.touches(device, _turning(robot), jnp.asarray(pose))):
                    return fits[-1]
    if fits:
        return fits[0]
    place = f"node {step.start}, ({node.x_m:.1f}, {node.y_m:.1f}) m"
    raise InputError(
        f"{robot.name} does not fit on link {step.link} at {place} of {world.name or 'world'!r}: is the map of "
        "this building, in its frame?"
    )


def _turning(robot):
    """Return a square in which a robot can turn, with some room."""
    side_m = math.hypot(robot.length_m, robot.width_m) + 2 * TURNING_MARGIN_M
    return dataclasses.replace(robot, length_m=side_m, width_m=side_m)


def _table(world, btm, found, runs, building):
    nodes = {node.id: node for node in btm.nodes}
    marks = building.marks[: len(_refused_places(btm, found))]
    rows = []
    for route, (outcome, run) in zip(found, runs):
        now, way = run.pilot.now, np.array([truth[:2] for _, truth, _ in run.pilot.way])
        near = (marks[:, 2] > np.hypot(*(way[:, None] - marks[:, :2]).T).T).any(0)
        end, places = nodes[route.end], sum(nodes[i].type == "divergence" for i in route.nodes[1:])
        off_m = math.dist(now.truth[:2] + np.asarray(world.origin_m), (end.x_m, end.y_m))
        row = {"from": route.start, "to": route.end, "outcome": outcome, "length_m": route.length_m}
        row |= {"path_m": now.path_m, "off_m": off_m, "places": places, "missed": run.missed}
        row |= {"extra": len(run.extra), "refused_links": int(near.sum()), "steps": len(way)}
        row |= {"contacts": now.contacts, "refused": now.refused, "drift_m": math.dist(now.truth[:2], now.pose[:2])}
        rows.append(row)
    return pd.DataFrame(rows)


def _changed(btm, found, runs, robot):
    """Return the map with the differences found, and sentences."""
    links = {link.id: link for link in btm.links}
    told, count = [], max(links, default=-1) + 1
    for route, (outcome, run) in zip(found, runs):
        if outcome == "BLOCKED":
            link = links[route.links[run.next]]
            links[link.id] = _blocked(link, robot, walled=run.walled)
            if links[link.id] != link:
                told.append(f"link {link.id} could not be passed by {robot.name}")
        ways = ((route.steps[i].end, math.degrees(bearing) % 360.0) for i, own in run.found.items() for bearing in own)
        for node, bearing in ways:
            ends = [(link.start, link.start_bearing_deg) for link in links.values()]
            ends += [(link.end, link.end_bearing_deg) for link in links.values() if link.start != link.end]
            there = [math.radians(own) for end, own in ends if end == node and own is not None]
            if is_new(math.radians(bearing), there):
                links[count] = Link(count, node, NOWHERE, STATUS[0], bearing, attributes={FOUND_BY: robot.name})
                told.append(f"node {node} has a way at {bearing:.0f} degrees that the map did not have")
                count += 1
    return dataclasses.replace(btm, links=tuple(links.values())), told


def _blocked(link, robot, *, walled):
    """Mark the link as blocked, for all robots if by a wall, and drop earlier statements about that.

    What a wall blocks stays blocked for all.
    """
    if link.attributes.get(BLOCKED) is True and BLOCKED_FOR not in link.attributes:
        return link
    own = {name: value for name, value in link.attributes.items() if name != BLOCKED_FOR}
    if isinstance(own.get(CONFLICTS), Mapping):
        own[CONFLICTS] = {name: told for name, told in own[CONFLICTS].items() if name not in (BLOCKED, BLOCKED_FOR)}
    own |= {BLOCKED: True} if walled else blocked_for(robot)
    return dataclasses.replace(link, attributes={**own, FOUND_BY: robot.name})
