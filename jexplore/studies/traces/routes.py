"""Routes over a Behavioral Trace Map for robots other than the one that wrote it: one, or many at a time."""

import contextlib
import dataclasses
import functools
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from jexplore.config import InputError, checked_names, require_number, shown
from jexplore.driving.settings import Robot, require_robot
from jexplore.studies.traces.job import robot_of
from jexplore.studies.traces.options import floats_of
from jexplore.tracemap.passable import hindrances, refusals
from jexplore.tracemap.record import NOWHERE, BtmMap, Link, check_map
from jexplore.tracemap.route import MapIndex, Route
from jexplore.tracemap.shortest import Problem, WalkGraph

RoutePlace = int | str | tuple[float, float]
UNSEARCHED = "unsearched"
"""The place to go to that is the nearest un-searched link."""
WITHIN_M = 2.0
MAX_LISTED_IDS = 12  # ids of nodes that a message lists


@checked_names
def route(
    btm: BtmMap, robot: str | Robot, start: RoutePlace, end: RoutePlace, *, known_only: bool = False,
    within_m: float = WITHIN_M,
) -> Route:  # fmt: skip
    """Find the shortest way over links that a robot may use.

    Args:
      btm: the map, such as `jx.btm.read_btm("btm.json")`.
      robot: name, also with other measures: `wheeled`, `kamui:width_m=0.6`; or `Robot`.
      start: a node's id, or `(x, y)`, metres, for the nearest node; both also as text, `"4"` and `"12.5,4"`.
      end: the same; or `"unsearched"`, the un-searched link that is nearest to go to.
      known_only: whether links with unknown measures are refused; else they are told in `Route.unknown`.
      within_m: farthest that a node may lie from a place.

    Returns:
      `Route`; of equal lengths, in whole millimetres, the one with the fewest links, then with the lowest ids in order.
    """
    return routes(btm, [robot], [(start, end)], known_only=known_only, within_m=within_m)[0][0]


@checked_names
def routes(
    btm: BtmMap, robots: Sequence[str | Robot], pairs: Iterable[tuple[RoutePlace, RoutePlace]], *,
    known_only: bool = False, within_m: float = WITHIN_M,
) -> list[list[Route]]:  # fmt: skip
    """Find the routes of many robots between many pairs of places, side by side.

    Robots that may use the same of the map are one problem.

    Args:
      btm: the map.
      robots: names or `Robot`s.
      pairs: of places, as of `route`.
      known_only, within_m: as of `route`.

    Returns:
      A list for every robot, of a `Route` for every pair.
    """
    btm = checked_map(btm)
    require_number("within_m", within_m)
    if isinstance(robots, (str, Robot)):
        raise InputError(f"robots must be a list, got {shown(robots)}")
    bodies = [checked_robot(robot) for robot in robots]
    pairs = list(pairs)
    if not all(isinstance(pair, (tuple, list)) and len(pair) == 2 for pair in pairs):
        raise InputError(f"pairs must be pairs of places, (start, end), got {shown(pairs)}")
    index = MapIndex(btm)
    asked: Any = [(_node(index, a, "from", within_m), _node(index, b, "to", within_m)) for a, b in pairs]
    graph, uses = WalkGraph(index), [_use_of(index, body, known_only) for body in bodies]
    walks = functools.cache(lambda problem: graph.walks(problem, asked))
    return [[_made(index, use, *both) for both in zip(asked, walks(use.problem))] for use in uses]


def checked_map(btm: BtmMap) -> BtmMap:
    """Check the map, which must have a node."""
    if not isinstance(btm, BtmMap):
        raise InputError(f'btm must be a jx.btm.BtmMap, such as jx.btm.read_btm("btm.json"), got {shown(btm)}')
    btm = check_map(btm)
    if not btm.nodes:
        raise InputError("the map has no node: there is nowhere to go")
    return btm


@dataclasses.dataclass(frozen=True)
class _Use:
    """Usable part of a map for a robot."""

    robot: Robot
    refused: tuple[tuple[int, tuple[str, ...]], ...]  # links with reasons, by id, un-searched ones included
    refused_ways: tuple[tuple[int, tuple[str, ...]], ...]  # searched ones only
    barriers: tuple[tuple[int, tuple[str, ...]], ...]  # nodes with reasons
    open: dict[int, Link]  # node -> the first un-searched link there that it may follow, by id
    problem: Problem


def _use_of(index, robot, known_only):
    links = [index.links[own] for own in sorted(index.links)]
    why = {link.id: refusals(link, index.nodes, robot, known_only=known_only) for link in links}
    at = {own: hindrances(index.nodes[own], robot, known_only=known_only) for own in sorted(index.nodes)}
    refused, barriers = (tuple((own, reasons) for own, reasons in of.items() if reasons) for of in (why, at))
    ways = tuple(one for one in refused if index.links[one[0]].end != NOWHERE)
    stubs = {link.start: link for link in reversed(links) if link.end == NOWHERE and not why[link.id]}
    problem = Problem(frozenset(dict(ways)), frozenset(dict(barriers)), frozenset(stubs))
    return _Use(robot, refused, ways, barriers, stubs, problem)


def checked_robot(robot: str | Robot) -> Robot:
    """Return the robot of a name, or the `Robot`, checked."""
    if isinstance(robot, str):
        return robot_of(robot)
    if not isinstance(robot, Robot):
        raise InputError(f"robot must be a name such as wheeled, or a jx.btm.Robot, got {shown(robot)}")
    require_robot(robot)
    return robot


def _node(index: MapIndex, place: RoutePlace, name: str, within_m: float) -> int | None:
    """Find the id of the requested node; None for the nearest un-searched link to go to."""
    if name == "to" and isinstance(place, str) and place == UNSEARCHED:
        return None
    ids, numbers = index.nodes, _numbers(place)
    if not numbers:
        also = f", or {UNSEARCHED}" if name == "to" else ""
        raise InputError(f"{name} must be a node's id or X,Y in metres{also}, got {shown(place)}")
    if len(numbers) == 1:
        if numbers[0] not in ids:
            raise InputError(f"{name}: there is no node {numbers[0]}: the map has {_named(sorted(ids))}")
        return int(numbers[0])
    away, nearest = min((math.dist(numbers, (node.x_m, node.y_m)), node.id) for node in ids.values())
    if away > within_m:
        at = ",".join(f"{number:g}" for number in numbers)
        raise InputError(f"{name}: the node nearest to {at} is {nearest}, {away:.2f} m away, more than {within_m:g} m")
    return nearest


def _named(ids):
    """Format ids of nodes in a sentence."""
    if len(ids) <= MAX_LISTED_IDS:
        return f"node{'s' * (len(ids) > 1)} {', '.join(map(str, ids))}"
    return f"{len(ids)} nodes, with ids from {ids[0]} to {ids[-1]}"


def _numbers(place):
    """Convert a place to a tuple of one whole number or two numbers; () for anything else."""
    with contextlib.suppress(ValueError, TypeError, OverflowError):
        if isinstance(place, (str, int, np.integer)) and not isinstance(place, bool):
            return (int(place),)
    found = floats_of(place)
    return found if len(found) == 2 else ()


def _made(index, use, pair, walk):
    """Make the `Route` of a robot, from its way or None."""
    (start, goal), seeks = pair, pair[1] is None
    about = {"robot": use.robot.name, "start": start, "barriers": use.barriers}
    about["refused"] = use.refused if seeks else use.refused_ways
    if walk is None:
        none = {"nodes": (), "links": (), "steps": (), "onward": None, "unknown": (), "length_m": math.inf}
        return Route(end=goal, trouble=_trouble(index, use.robot.name, start, goal), **none, **about)
    nodes, links = walk
    last = (use.open[nodes[-1]].id,) if seeks else ()
    steps = index.steps(nodes, (*links, *last))
    return Route(
        end=nodes[-1],
        nodes=nodes,
        links=links,
        length_m=math.fsum(map(index.length_m.__getitem__, links)),
        steps=steps[: len(links)],
        onward=steps[-1] if last else None,
        unknown=index.unknown((*links, *last), nodes[1:] if last else nodes[1:-1]),
        trouble="",
        **about,
    )


def _trouble(index, robot, start, goal):
    """Explain why there is no way: a sentence."""
    part = index.part
    if goal is not None and part[goal] == part[start]:
        return f"{robot} cannot get from node {start} to node {goal}"
    if goal is not None:
        return f"nodes {start} and {goal} lie in parts of the map that no link joins"
    if part[start] in index.parts_with_stubs:
        return f"{robot} can get from node {start} to no un-searched link"
    apart = f"node {start} and the un-searched links lie in parts of the map that no link joins"
    return apart if index.parts_with_stubs else "the map has no un-searched link"
