"""What contradicts itself in a finished map: two ways that leave a node by one opening and lead to different places.

A robot that goes by a junction without seeing it takes the way to the next one for the way from the one before. Once it
knows the junction from another side, two links leave by one opening, and the longer of them leads through a node. A
robot that takes a place for a new one has it twice: then both links are as long.
"""

import dataclasses
import math
from collections.abc import Iterator
from typing import NamedTuple

from jexplore.tracemap.merging.rigid import Move, apart_deg
from jexplore.tracemap.record import NOWHERE, STATUS, BtmMap, Link, check, parts_of

TWINS_DEG = 30.0  # two ways of a node no farther apart leave by one opening
CLOSE = 0.6, 0.1  # where two ways lead is one place no farther apart than this: metres, and so much of the way besides
LONGER_M = 0.5  # at least, than the way to the node by which it goes
MOST = 10_000  # ways that are tried to explain one
OPENING_DEG = 50.0  # a way beyond it leaves by an un-searched opening that lies no farther from where it leads


class Repaired(NamedTuple):
    """A map without contradictions that could be explained."""

    map: BtmMap
    closings: int  # ways round: searched links beyond those that it takes to reach every node
    contradicted: int  # links that were there twice or led through a node: taken out, or begun there
    left: int  # pairs of ways by one opening for which there was no explanation


class _Way(NamedTuple):
    """A searched link as it is followed from one of its ends."""

    link: Link
    to: int  # node
    bearing_deg: float  # there
    back_deg: float  # of the other end
    move: Move  # the frame of the other node in that of this one


def repaired(btm: BtmMap) -> Repaired:
    """The map without links that lead through a node unseen, and without nodes that are there twice.

    Two ways that leave a node by one opening are one if they are as long as each other and lead to one place: the
    longer goes, and two nodes of one type at their ends are one, the one with the lower id, with the links of both.
    Else the longer leads through the node where the other ends, if known links lead on from there to where it ends,
    over as much way and to that place; then it goes. Or it is the way out of an un-searched opening there: then it
    begins there. What nothing explains is left as it is, and counted.

    Args:
      btm: a map of a run, whose links have the attribute `moved`; those without are left alone.

    Returns:
      `Repaired`.

    Raises:
      InputError: not a proper map.
    """
    btm, contradicted = check(btm), 0
    for _ in btm.links:  # each time one link less is doubtful
        found = next(filter(None, (_explained(btm, *twins) for twins in _twins(btm))), None)
        if found is None:
            break
        btm, contradicted = found, contradicted + 1
    return Repaired(btm, closings_of(btm), contradicted, sum(1 for _ in _twins(btm)))


def closings_of(btm: BtmMap) -> int:
    """How many ways round a map has: searched links beyond those that it takes to reach every node."""
    parts = set(parts_of((node.id for node in btm.nodes), btm.links).values())
    return sum(link.end != NOWHERE for link in btm.links) - len(btm.nodes) + len(parts)


def _ways(btm: BtmMap, node: int) -> Iterator[_Way]:
    """Searched links of a node whose move is known."""
    for link in btm.links:
        moved = link.attributes.get("moved")
        if link.end == NOWHERE or link.end_bearing_deg is None or moved is None:
            continue
        there = Move(moved[0], moved[1], sum(moved[2:]))
        if link.start == node:
            yield _Way(link, link.end, link.start_bearing_deg, link.end_bearing_deg, there)
        if link.end == node:
            yield _Way(link, link.start, link.end_bearing_deg, link.start_bearing_deg, _inverse(there))


def _twins(btm: BtmMap) -> Iterator[tuple[_Way, _Way]]:
    """Pairs of ways of a node that leave by one opening: `(shorter, longer)`."""
    for node in btm.nodes:
        ways = sorted(_ways(btm, node.id), key=lambda way: way.link.length_m or 0.0)
        for i, short in enumerate(ways):
            for long in ways[i + 1 :]:
                if long.link.id != short.link.id and abs(apart_deg(long.bearing_deg, short.bearing_deg)) < TWINS_DEG:
                    yield short, long


def _explained(btm: BtmMap, short: _Way, long: _Way) -> BtmMap | None:
    """The map once the longer of two ways is explained by the shorter, None where it is not."""
    length_m = (long.link.length_m or 0.0) - (short.link.length_m or 0.0)
    rest = _inverse(short.move).after(long.move)
    others = [link for link in btm.links if link.id != long.link.id]
    within_m = CLOSE[0] + CLOSE[1] * (long.link.length_m or 0.0)
    if length_m < within_m and math.hypot(rest.x_m, rest.y_m) < within_m:
        return dataclasses.replace(btm, links=tuple(others)) if short.to == long.to else _joined(btm, short, long)
    if length_m < LONGER_M:
        return None
    for gone_m, place in _reached(
        dataclasses.replace(btm, links=tuple(others)), short.to, long.to, length_m + within_m
    ):
        if abs(gone_m - length_m) < within_m and math.hypot(place.x_m - rest.x_m, place.y_m - rest.y_m) < within_m:
            return dataclasses.replace(btm, links=tuple(others))
    return _begun(btm, others, short, long, rest, length_m)


def _joined(btm: BtmMap, short: _Way, long: _Way) -> BtmMap | None:
    """The map where the ends of two ways are one node; None where they are of two types, or one is where they begin."""
    nodes = {node.id: node for node in btm.nodes}
    first, second = (short, long) if short.to < long.to else (long, short)
    kept, gone = nodes[first.to], nodes[second.to]
    begin = second.link.start if second.link.end == gone.id else second.link.end
    if (kept.type, kept.obstacle) != (gone.type, gone.obstacle) or begin in (kept.id, gone.id):
        return None
    turn_deg = apart_deg(first.back_deg, second.back_deg)
    moved = [_moved_to(link, kept.id, gone.id, turn_deg) for link in btm.links if link.id != second.link.id]
    links = [link for link in moved if link.start != kept.id or link.end != NOWHERE or not _is_double(link, moved)]
    return dataclasses.replace(btm, nodes=tuple(n for n in btm.nodes if n is not gone), links=tuple(links))


def _moved_to(link, kept, gone, turn_deg):
    """A link with its ends at a node moved to another one, whose frame is turned so far against that."""
    starts, ends = link.start == gone, link.end == gone
    if not (starts or ends):
        return link
    changed, attributes = {}, dict(link.attributes)
    if starts:
        changed |= {"start": kept, "start_bearing_deg": apart_deg(link.start_bearing_deg + turn_deg, 0)}
    if ends:
        changed |= {"end": kept, "end_bearing_deg": apart_deg(link.end_bearing_deg + turn_deg, 0)}
    if "moved" in attributes:
        x_m, y_m, *turn = attributes["moved"]
        x_m, y_m = Move(turn_deg=turn_deg * starts).place(x_m, y_m)
        attributes["moved"] = [x_m, y_m, *(value + turn_deg * (starts - ends) for value in turn)]
    return dataclasses.replace(link, **changed, attributes=attributes)


def _is_double(stub, links):
    """Whether an un-searched link leaves by an opening by which a searched one of its node does, or one before it."""
    for link in links:
        ends = [(link.start, link.start_bearing_deg), (link.end, link.end_bearing_deg)]
        near = [node == stub.start and _are_near(bearing_deg, stub.start_bearing_deg) for node, bearing_deg in ends]
        if any(near) and (link.end != NOWHERE or link.id < stub.id):
            return True
    return False


def _are_near(bearing_deg, other_deg):
    return bearing_deg is not None and abs(apart_deg(bearing_deg, other_deg)) < TWINS_DEG


def _begun(btm, others, short, long, rest, length_m):
    """The map where the longer way begins at an un-searched opening of the node it leads past; None: there is none."""
    ahead_deg = math.degrees(math.atan2(rest.y_m, rest.x_m))
    waiting = [link for link in others if link.start == short.to and link.end == NOWHERE]
    waiting.sort(key=lambda link: abs(apart_deg(link.start_bearing_deg, ahead_deg)))
    if not waiting or abs(apart_deg(waiting[0].start_bearing_deg, ahead_deg)) > OPENING_DEG:
        return None
    attributes = {key: value for key, value in waiting[0].attributes.items() if key != "blocked"}
    begun = dataclasses.replace(
        long.link,
        id=waiting[0].id,
        start=short.to,
        end=long.to,
        status=STATUS[1],
        start_bearing_deg=waiting[0].start_bearing_deg,
        end_bearing_deg=long.back_deg,
        length_m=length_m,
        opening_m=waiting[0].opening_m,
        attributes={**attributes, "moved": [rest.x_m, rest.y_m, apart_deg(rest.turn_deg, 0)]},
    )
    links = (begun if link.id == begun.id else link for link in others)
    return dataclasses.replace(btm, links=tuple(links))


def _reached(btm, node, goal, most_m):
    """Ways along known links from a node to another, no link twice: `(metres, the goal's frame in the node's)`."""
    pending = [(node, 0.0, Move(), frozenset())]
    for _ in range(MOST):
        if not pending:
            return
        here, gone_m, move, used = pending.pop()
        if here == goal:
            yield gone_m, move
        for way in _ways(btm, here):
            further_m = gone_m + (way.link.length_m or 0.0)
            if way.link.id not in used and further_m <= most_m:
                pending.append((way.to, further_m, move.after(way.move), used | {way.link.id}))


def _inverse(move):
    x_m, y_m = Move(turn_deg=-move.turn_deg).place(-move.x_m, -move.y_m)
    return Move(x_m, y_m, -move.turn_deg)
