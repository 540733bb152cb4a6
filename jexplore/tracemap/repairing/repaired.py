"""Repair of contradictions in a finished map, as far as they can be explained.

There may be a way that was followed from both of its ends, a place to which the robot turned back, or one that is there
twice.
"""

import dataclasses
import heapq
import math
from collections.abc import Iterator
from typing import NamedTuple

from jexplore.tracemap.merging.rigid import Move, apart_deg
from jexplore.tracemap.record import NOWHERE, STATUS, BtmMap, Link, check_map, connected_parts
from jexplore.tracemap.repairing.through import (
    CLOSE_M,
    CLOSE_SHARE,
    OPENING_DEG,
    LinkWay,
    are_close,
    are_near,
    explained,
    twins,
    ways_of,
    with_link,
    with_nodes_joined,
    within_m,
    without,
)

TINY_LOOP_M = 3.0  # a link that leads back to its node is a way round if it is longer
DOUBLES_M = 4.0  # nodes that are one lie no farther apart, nor than `CLOSE_M` and `CLOSE_SHARE` of the way between them
STRAIGHT_RATIO, STRAIGHT_M = 1.05, 0.3  # a way no longer than its displacement by this goes round no corner
TURNED_M = 1.0, 8.0  # m; additional way of a robot that turns back before the next node
TURNED_BACK_M = 2.0  # who has turned back seems no farther from where it left, however long the link
FEWEST, OPENINGS = 3, 3  # pairs of junctions that are one, each linked with the next alike; openings of a junction


class Repaired(NamedTuple):
    """A map without contradictions that could be explained."""

    map: BtmMap
    closings: int  # ways round: searched links beyond those that it takes to reach every node
    contradicted: int  # what was there twice, led through a node or ended by a wrong opening
    left: int  # pairs of ways by one opening for which there was no explanation


def repaired(btm: BtmMap) -> Repaired:
    """Repair a map: no links that pass a node unnoticed, and no duplicate nodes and links.

    In this order: links on which the robot has turned back; ways that were followed from both ends; links that end by
    an opening that is another's; pairs of ways by one opening, see `through.explained`; sets of nodes that are there
    twice; links that end where the robot strayed to. What nothing explains is left as it is, and counted.

    Links without the attribute `moved`, which those of a run have, are left alone.
    """
    btm, contradicted = check_map(btm), 0
    for _ in btm.links:  # each time one link less is doubtful
        found = next(_mended(btm), None)
        if found is None:
            break
        btm, contradicted = found, contradicted + 1
    return Repaired(btm, closings_of(btm), contradicted, sum(1 for _ in twins(btm)))


def _mended(btm: BtmMap) -> Iterator[BtmMap]:
    """Yield the map with one contradiction less."""
    yield from _turned_back(btm)
    yield from _both_ways(btm)
    yield from _misled(btm)
    yield from _explanations(btm)
    yield from _doubled(btm)
    for other in _strayed(btm):  # only where another link is known then to lead there
        waiting = {link.id for link in other.links if link.end == NOWHERE}
        for found in _explanations(other):
            if len(waiting & {link.id for link in found.links if link.end == NOWHERE}) < len(waiting):
                yield found


def _explanations(btm):
    return filter(None, (explained(btm, *pair) for pair in twins(btm)))


def closings_of(btm: BtmMap) -> int:
    """Count the cycles of a map: searched links beyond those of a spanning tree."""
    parts = set(connected_parts((node.id for node in btm.nodes), btm.links).values())
    return sum(link.end != NOWHERE for link in btm.links) - len(btm.nodes) + len(parts)


def _turned_back(btm: BtmMap) -> Iterator[BtmMap]:
    """Yield the map without a link on which the robot has turned back to where it left, by the same opening.

    The node that it took there for another one of that type is the one that it left, if it lies no farther off than the
    odometry can be on the shortest known way between both. A tiny link does not lead back to its node either, nor does
    one whose ends lie in one place and that leaves or ends by another one's opening. If nothing else leaves by the
    opening by which it has left, that becomes un-searched.
    """
    for link in btm.links:
        for way in ways_of(btm, link.start):
            if way.link is link and way.to == link.end and _returns(btm, way):
                kept, gone = sorted((link.start, link.end))
                turn_deg = way.move.turn_deg if kept == link.start else -way.move.turn_deg
                rest, may = _opened(btm, way), kept == gone or _is_in_reach(btm, kept, gone)
                found = rest if kept == gone else with_nodes_joined(rest, kept, gone, turn_deg) if may else None
                if found is not None:
                    yield found
                break


def _returns(btm: BtmMap, way: LinkWay) -> bool:
    is_own, is_tiny = way.to == way.link.start == way.link.end, way.length_m < TINY_LOOP_M
    if not are_close(way.move, Move(), min(within_m(way.link), TURNED_BACK_M)):
        return is_own and is_tiny
    others = _others(btm, way)
    is_shared = _is_shared(others, way.bearing_deg) or _is_shared(others, way.back_deg)
    return are_near(way.bearing_deg, way.back_deg + way.move.turn_deg) or (is_own and (is_tiny or is_shared))


def _others(btm: BtmMap, way: LinkWay) -> list[LinkWay]:
    """Return the other ways of the node where a link begins."""
    return [one for one in ways_of(btm, way.link.start) if one.link.id != way.link.id]


def _is_shared(others, bearing_deg):
    """Return whether a way of a node leaves by an opening that others use."""
    return any(are_near(one.bearing_deg, bearing_deg) for one in others)


def _opened(btm: BtmMap, way: LinkWay) -> BtmMap:
    """Return the map with a link un-searched; without it if another one leaves by its opening."""
    link = way.link
    if _is_shared(_others(btm, way), way.bearing_deg):
        return without(btm, link)
    stub = Link(link.id, link.start, NOWHERE, STATUS[0], link.start_bearing_deg, opening_m=link.opening_m)
    return with_link(btm, link, stub)


def _both_ways(btm: BtmMap) -> Iterator[BtmMap]:
    """Yield the map without the second of two links between two nodes that are one way, straight and as long.

    One was followed there and one back. Each tells the opening by which it begins, and that lies toward the other node.
    """
    links = [link for link in btm.links if link.end not in (NOWHERE, link.start)]
    for i, first in enumerate(links):
        for second in links[i + 1 :]:
            if (first.start, first.end) == (second.end, second.start) and _are_one(btm, first, second):
                one = dataclasses.replace(first, end_bearing_deg=second.start_bearing_deg)
                yield with_link(without(btm, second), first, one)


def _are_one(btm, first, second):
    there, back = (
        next((way for way in ways_of(btm, first.start) if way.link is link and way.to == first.end), None)
        for link in (first, second)
    )
    if there is None or back is None:
        return False
    apart_m = abs((first.length_m or 0.0) - (second.length_m or 0.0))
    is_one = apart_m < within_m(first) and are_close(there.move, back.move, within_m(first))
    begun = there, next(way for way in ways_of(btm, second.start) if way.link is second)
    return is_one and all(_is_straight(way) and are_near(way.bearing_deg, way.toward_deg) for way in begun)


def _is_straight(way):
    return way.length_m < STRAIGHT_RATIO * math.hypot(way.move.x_m, way.move.y_m) + STRAIGHT_M


def _doubled(btm: BtmMap) -> Iterator[BtmMap]:
    """Yield the map with some nodes merged with others.

    They are a set of pairs of one type and with equal openings, each linked with the next by links that leave alike,
    are as long and lead to one place; no pair contradicts the rest. `FEWEST` at least are junctions: slopes may lie
    alike in two passages side by side. Both of a pair lie no farther apart than the odometry can be off on the shortest
    known way from one to the other.

    Source:
      Choset and Nagatani 2001, Topological simultaneous localization and mapping, for hypotheses that the next nodes
      decide; pairs are held against each other as in pairwise consistent sets (Mangelson et al. 2018).
    """
    nodes = btm.nodes
    for i, first in enumerate(nodes):
        for second in nodes[i + 1 :]:
            alike = (first.type, first.obstacle) == (second.type, second.obstacle)
            if alike and math.hypot(first.x_m - second.x_m, first.y_m - second.y_m) < DOUBLES_M:
                pairs = _pairs_from(btm, first.id, second.id)
                if _junctions(btm, pairs) >= FEWEST and all(
                    _may_be_one(btm, pair, turn_deg) for pair, turn_deg in pairs.items()
                ):
                    found = btm
                    for (one, other), turn_deg in pairs.items():
                        kept, gone = sorted((one, other))
                        found = found and with_nodes_joined(found, kept, gone, turn_deg if kept == one else -turn_deg)
                    if found is not None:
                        yield found


def _junctions(btm, pairs):
    """Count the pairs of nodes that are divergences with enough openings to be distinctive."""
    types = {node.id: node.type for node in btm.nodes}
    return sum(types[one] == "divergence" and len(btm.bearings_deg(one)) >= OPENINGS for one, _ in pairs)


def _may_be_one(btm, pair, turn_deg):
    """Return whether two nodes have equal openings and lie no farther apart than the way between them allows."""
    one, other = pair
    ends = btm.bearings_deg(one), [bearing_deg + turn_deg for bearing_deg in btm.bearings_deg(other)]
    alike = all(any(are_near(a, b) for b in there) for here, there in (ends, ends[::-1]) for a in here)
    return alike and _is_in_reach(btm, one, other)


def _is_in_reach(btm, one, other):
    """Return whether two nodes lie within the odometry's error on the shortest known way between them."""
    nodes = {node.id: node for node in btm.nodes}
    apart_m = math.hypot(nodes[one].x_m - nodes[other].x_m, nodes[one].y_m - nodes[other].y_m)
    return apart_m < CLOSE_M + CLOSE_SHARE * _way_m(btm, one, other)


def _way_m(btm, start, goal):
    """Return the length of the shortest way along known links between two nodes; inf without one."""
    queue, reached = [(0.0, start)], set()
    while queue:
        gone_m, here = heapq.heappop(queue)
        if here == goal:
            return gone_m
        if here not in reached:
            reached.add(here)
            for way in ways_of(btm, here):
                heapq.heappush(queue, (gone_m + way.length_m, way.to))
    return math.inf


def _pairs_from(btm, first, second):
    """Return pairs of nodes that are one if two are, with the turn of the second's frame; none if they contradict."""
    types = {node.id: (node.type, node.obstacle) for node in btm.nodes}
    pairs, pending = {(first, second): 0.0}, [(first, second)]
    while pending:
        pair = pending.pop()
        turn_deg = pairs[pair]
        for one in ways_of(btm, pair[0]):
            for other in ways_of(btm, pair[1]):
                move = Move(turn_deg=turn_deg).after(other.move)
                is_one = are_near(one.bearing_deg, other.bearing_deg + turn_deg) and one.link.id != other.link.id
                if not is_one or one.to == other.to or not are_close(one.move, move, within_m(one.link)):
                    continue
                if types[one.to] != types[other.to]:
                    return {}
                if (one.to, other.to) not in pairs:
                    pairs[one.to, other.to] = apart_deg(move.turn_deg, one.move.turn_deg)
                    pending.append((one.to, other.to))
    apart = {node for pair in pairs for node in pair}
    return pairs if len(apart) == 2 * len(pairs) else {}


def _strayed(btm: BtmMap) -> Iterator[BtmMap]:
    """Yield the map with a link un-searched on which the robot turned back, passed its node and took another way.

    It leads where a shorter one does, and ends by the same opening.
    """
    for link in btm.links:
        for long in ways_of(btm, link.start):
            if long.link is link and long.to == link.end != link.start and _is_other_way(btm, long):
                yield _opened(btm, long)


def _is_other_way(btm, long):
    others = _others(btm, long)
    if _is_shared(others, long.bearing_deg):
        return False
    return any(
        way.to == long.to
        and are_near(way.back_deg, long.back_deg)
        and TURNED_M[0] < long.length_m - way.length_m < TURNED_M[1]
        and are_close(way.move, long.move, within_m(way.link))
        for way in others
    )


def _misled(btm: BtmMap) -> Iterator[BtmMap]:
    """Yield the map with the end of a link moved to the opening that lies toward where it comes from.

    The link has led to a known node, by an opening by which another link leaves, or by none that was known if it is
    straight. That opening is un-searched; or a known link leaves by it that then can be explained.
    """
    for node in btm.nodes:
        ways = list(ways_of(btm, node.id))
        stubs = [link for link in btm.links if link.start == node.id and link.end == NOWHERE]
        made_from = min((way.to for way in ways if way.link.end == node.id), default=node.id)
        for way in ways:
            toward_deg = way.toward_deg
            is_aside = abs(apart_deg(way.bearing_deg, toward_deg)) > OPENING_DEG
            if way.link.end != node.id or way.to == made_from or not is_aside:
                continue
            others = [other for other in ways if other.link.id != way.link.id]
            if _is_straight(way) or _is_shared(others, way.bearing_deg):
                for stub in stubs:
                    if are_near(stub.start_bearing_deg, toward_deg, OPENING_DEG):
                        yield _leaving(without(btm, stub), way, node.id, stub.start_bearing_deg)
            if _is_straight(way):
                near = [one for one in others if are_near(one.bearing_deg, toward_deg, OPENING_DEG)]
                yield from filter(None, (_explained_at(btm, way, node.id, other) for other in near))


def _explained_at(btm, way, node, other):
    """Return the map where a way leaves a node by another one's opening and the longer is explained, else None."""
    changed = _leaving(btm, way, node, other.bearing_deg)
    pair = [one for one in ways_of(changed, node) if one.link.id in (way.link.id, other.link.id)]
    if len(pair) != 2:
        return None
    short, long = sorted(pair, key=lambda one: one.length_m)
    return explained(changed, short, long)


def _leaving(btm: BtmMap, way: LinkWay, node: int, bearing_deg: float) -> BtmMap:
    """Return the map where a link leaves a node by another opening."""
    end = "start_bearing_deg" if way.link.start == node else "end_bearing_deg"
    changed = dataclasses.replace(way.link, **{end: bearing_deg})
    return with_link(btm, way.link, changed)
