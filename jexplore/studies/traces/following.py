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
from jexplore.driving.batch import MAX_STEPS, building_of, outcome_names, pose_in, run_missions, settings_arrays
from jexplore.driving.guiding.guide import OFF_ROUTE_PLACES, guide_of
from jexplore.driving.params.tree import P
from jexplore.driving.records import Building, Guide
from jexplore.driving.settings import Noise, Robot, Tuning, for_world, require_tuning
from jexplore.studies import checks
from jexplore.studies.traces import routes
from jexplore.studies.traces.job import MAX_TRACE_STEPS
from jexplore.tracemap.merging.rigid import apart_deg
from jexplore.tracemap.passable import BLOCKED, BLOCKED_FOR, CONFLICTS, FOUND_BY, blocked_for
from jexplore.tracemap.record import NOWHERE, STATUS, BtmMap, Link
from jexplore.tracemap.route import MapIndex, Route
from jexplore.worlds.world import World, with_ring

FOLLOWER_SIZE = 32, 64  # most nodes and links of the map that a robot writes on its way
PLACES = 8  # a guide has room for places in multiples of this
CLEAR_M = 1.5, 1.0, 2.0, 0.6, 3.0, 0.3  # m; starts along a link: the first where the robot can turn, or that is free
START_OFFSETS_M = 0.0, 0.3, -0.3, 0.6, -0.6  # m; offsets from the link where the robot cannot turn anywhere on it
TURNING_MARGIN_M = 0.05  # m; margin of a robot that turns at its start
SAME_EXIT_DEG = 40.0  # ways that lie no farther apart are one
ONE_DEG = 20.0  # links of a node that leave it no farther apart are one way: two nodes of a passage
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
    that the map refuses to the robot it has been, steps, contacts, refused steps, help by the operator."""
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

    It starts on the first link of a route, a little beyond the node. From there on it knows of the map only the
    positions of the next divergences relative to the last recognised one, the bearings of their exits, the exit to
    take, and the places nearby. It drives like an exploring robot; where no passage leads it, it steers for the next
    place. A route ends where the map has its last node, seen from the last divergence before it.

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

    Returns:
      `FollowResult`.

    Raises:
      InputError: no route, one without a link or of another map, or a start where the robot does not fit.
    """
    world = with_ring(*checks.ready_worlds([world], cell_m))
    body, tuning, noise = _checked(world, btm, found, robot, tuning, noise)
    seed = require_whole("seed", seed, 0, MAX_SEED)
    building = building_of(world, marks_m=_refused_places(btm, found))
    begun = [start_of(world, building, body, btm, route) for route in found]
    n, longest = len(found), max(route.length_m for route in found)
    result = run_missions(
        *(building, settings_arrays(body, n), settings_arrays(tuning, n), settings_arrays(noise, n)),
        *(np.stack([pose for pose, *_ in begun]), seed, np.arange(n)),
        _guides(world, btm, found, [start[1:] for start in begun]),
        max_steps=int(min(max(MAX_STEPS, STEPS_M * longest), MAX_TRACE_STEPS)),
        size=FOLLOWER_SIZE,
        workers=workers,
        on_progress=on_progress,
    ).result
    changed, told = _changed(btm, found, result, body)
    return FollowResult(_table(world, btm, found, result), changed, tuple(told))


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
            if _is_free(world, pose) and not bool(vehicle.touches(device, robot, jnp.asarray(pose))):
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


def _is_free(world, pose):
    """Return whether a pose from `pose_in` lies in a free cell."""
    row, col = (int(v // world.cell_m) for v in (pose[1], pose[0]))
    rows, cols = world.shape
    return 0 <= row < rows and 0 <= col < cols and not world.occupied[row, col]


def _guides(world, btm, found, begun):
    """Make `Guide`s, arrays with one a route; `begun` holds distances from the node and offsets, see `start_of`."""
    nodes = {node.id: node for node in btm.nodes}
    made = []
    for route, (start_m, beside) in zip(found, begun):
        at = nodes[route.nodes[0]]
        node_xy = at.x_m + beside[0] - world.origin_m[0], at.y_m + beside[1] - world.origin_m[1]
        out, ways, leg, length_m, others, gone = [], [], [], [], [], 0.0
        elsewhere = [node for node in btm.nodes if node.type == "divergence" and node.id not in route.nodes]
        for step, on in zip(route.steps, [*route.steps[1:], None]):
            gone += step.length_m
            node = nodes[step.end]
            if node.type == "divergence":
                out.append(math.radians(on.bearing_deg if on else 0.0))
                ways.append(_ways(btm, step.end))
                leg.append((node.x_m - at.x_m, node.y_m - at.y_m))
                length_m.append(gone)
                others.append(_nearest(node, elsewhere))
                at, gone = node, 0.0
        end = nodes[route.nodes[-1]]
        ends = {"tail_m": gone, "end_leg": (end.x_m - at.x_m, end.y_m - at.y_m), "others": others}
        made.append((out, ways, leg, length_m, {**ends, "node_xy": node_xy, "start_m": start_m}))
    size = max(-(-max(len(out) for out, *_ in made) // PLACES), 1) * PLACES
    return jax.tree.map(lambda *a: np.stack(a), *(guide_of(*of, **more, size=size) for *of, more in made))


def _nearest(node, others):
    """Return the nearest of other nodes relative to one: pairs of metres."""
    legs = ((other.x_m - node.x_m, other.y_m - node.y_m) for other in others)
    return sorted(legs, key=lambda leg: math.hypot(*leg))[:OFF_ROUTE_PLACES]


def _ways(btm, node):
    """Return bearings of the exits of a node, radians."""
    found = []
    for bearing in btm.bearings_deg(node):
        if all(abs(apart_deg(bearing, other)) > ONE_DEG for other in found):
            found.append(bearing)
    return [math.radians(bearing) for bearing in found]


def _table(world, btm, found, result):
    places = {node.id: (node.x_m, node.y_m) for node in btm.nodes}
    ends = np.array([places[route.end] for route in found])
    off_m = np.hypot(*(result.end[:, :2] + np.asarray(world.origin_m) - ends).T)
    guide: Guide = result.guide
    outcomes = zip(outcome_names(result), guide.blocked | guide.walled)
    return pd.DataFrame(
        {
            "from": [route.start for route in found],
            "to": [route.end for route in found],
            "outcome": ["BLOCKED" if shut else name for name, shut in outcomes],
            "length_m": [route.length_m for route in found],
            "path_m": result.path_m,
            "off_m": off_m,
            "places": guide.count,
            "missed": guide.missed,
            "extra": guide.extra,
            "refused_links": result.met[:, : len(_refused_places(btm, found))].sum(axis=1),
            **{name: getattr(result, name) for name in ("steps", "contacts", "refused", "interventions", "drift_m")},
        }
    )


def _changed(btm, found, result, robot):
    """Return the map with the differences found, and sentences."""
    links = {link.id: link for link in btm.links}
    told, count = [], max(links, default=-1) + 1
    for i, route in enumerate(found):
        if link := _blocked_link(btm, route, jax.tree.map(lambda a, i=i: a[i], result), robot):
            links[link.id] = _blocked(links[link.id], robot, walled=bool(result.guide.walled[i]))
            told.append(f"link {link.id} could not be passed by {robot.name}")
        ways = zip(_places(btm, route), result.guide.seen[i])
        for node, bearing in [(step.end, math.degrees(b) % 360.0) for step, own in ways for b in own[np.isfinite(own)]]:
            ends = [(link.start, link.start_bearing_deg) for link in links.values()]
            ends += [(link.end, link.end_bearing_deg) for link in links.values() if link.start != link.end]
            there = [own for end, own in ends if end == node and own is not None]
            if all(abs(apart_deg(bearing, own)) > SAME_EXIT_DEG for own in there):
                links[count] = Link(count, node, NOWHERE, STATUS[0], bearing, attributes={FOUND_BY: robot.name})
                told.append(f"node {node} has a way at {bearing:.0f} degrees that the map did not have")
                count += 1
    return dataclasses.replace(btm, links=tuple(links.values())), told


def _places(btm, route):
    """Return the divergences on a route, with the step that leads to each: a list."""
    types = {node.id: node.type for node in btm.nodes}
    return [step for step in route.steps if types[step.end] == "divergence"]


def _blocked_link(btm, route, result, robot):
    """Return the link on which a robot's front met an obstacle; None if none, or its last place is not on the map."""
    guide = result.guide
    if not (guide.blocked | guide.walled) or (guide.strays and not guide.walled):
        return None
    places, at = [*_places(btm, route), route.steps[-1]], int(guide.at)
    first = route.steps.index(places[at - 1]) + 1 if at else 0
    steps = route.steps[first : route.steps.index(places[at]) + 1] or route.steps[-1:]
    ends_m = np.cumsum([step.length_m for step in steps])
    gone_m = result.path_m - guide.from_m + robot.length_m / 2 + P.ground.look_m
    step = steps[min(int(np.searchsorted(ends_m, gone_m)), len(steps) - 1)]
    return next(link for link in btm.links if link.id == step.link)


def _blocked(link, robot, *, walled):
    """Mark the link as blocked, for all robots if by a wall, and drop earlier statements about that."""
    own = {name: value for name, value in link.attributes.items() if name != BLOCKED_FOR}
    if isinstance(own.get(CONFLICTS), Mapping):
        own[CONFLICTS] = {name: told for name, told in own[CONFLICTS].items() if name not in (BLOCKED, BLOCKED_FOR)}
    own |= {BLOCKED: True} if walled else blocked_for(robot)
    return dataclasses.replace(link, attributes={**own, FOUND_BY: robot.name})
