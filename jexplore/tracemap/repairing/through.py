"""Two ways that leave a node by one opening and lead to different places.

A robot that goes by a junction without seeing it takes the way to the next one for the way from the one before. Once it
knows the junction from another side, two links leave by one opening, and the longer of them leads through a node. A
robot that takes a place for a new one has it twice: then both links are as long.
"""

import dataclasses
import math
from collections.abc import Iterator
from typing import NamedTuple

from jexplore.tracemap.merging.rigid import Move, apart_deg
from jexplore.tracemap.passable import BLOCKED, BLOCKED_FOR
from jexplore.tracemap.record import NOWHERE, STATUS, BtmMap, Link

TWINS_DEG = 30.0  # two ways of a node no farther apart leave by one opening
CLOSE_M, CLOSE_SHARE = 0.6, 0.1  # ends of two ways within this, plus a share of the way, are one place
OPENING_DEG = 50.0  # a way beyond it leaves by an un-searched opening that lies no farther from where it leads
LONGER_M = 0.5  # at least, than the way to the node by which it goes
MAX_WAYS_TRIED = 10_000  # to explain one


class LinkWay(NamedTuple):
    """A searched link as it is followed from one of its ends."""

    link: Link
    to: int  # node
    bearing_deg: float  # there
    back_deg: float  # of the other end
    move: Move  # the frame of the other node in that of this one

    @property
    def length_m(self) -> float:
        return self.link.length_m or 0.0

    @property
    def toward_deg(self) -> float:
        """Return the direction in which the other node lies."""
        return math.degrees(math.atan2(self.move.y_m, self.move.x_m))


def ways_of(btm: BtmMap, node: int) -> Iterator[LinkWay]:
    """Yield searched links of a node whose move is known; both ways of one that leads back to it."""
    for link in btm.links:
        moved = link.attributes.get("moved")
        if link.end == NOWHERE or link.end_bearing_deg is None or moved is None:
            continue
        there = Move(moved[0], moved[1], sum(moved[2:]))
        if link.start == node:
            yield LinkWay(link, link.end, link.start_bearing_deg, link.end_bearing_deg, there)
        if link.end == node:
            yield LinkWay(link, link.start, link.end_bearing_deg, link.start_bearing_deg, _inverse(there))


def _inverse(move: Move) -> Move:
    x_m, y_m = Move(turn_deg=-move.turn_deg).place(-move.x_m, -move.y_m)
    return Move(x_m, y_m, -move.turn_deg)


def within_m(link: Link) -> float:
    """Return the tolerance for the position of a place at the end of a link."""
    return CLOSE_M + CLOSE_SHARE * (link.length_m or 0.0)


def are_close(one: Move, other: Move, limit_m: float) -> bool:
    """Return whether two moves lead to places less than this apart."""
    return math.hypot(one.x_m - other.x_m, one.y_m - other.y_m) < limit_m


def are_near(bearing_deg: float | None, other_deg: float | None, limit_deg: float = TWINS_DEG) -> bool:
    """Return whether two ends of links of a node leave by one opening."""
    return bearing_deg is not None and other_deg is not None and abs(apart_deg(bearing_deg, other_deg)) < limit_deg


def without(btm: BtmMap, link: Link) -> BtmMap:
    """Remove a link."""
    return dataclasses.replace(btm, links=tuple(other for other in btm.links if other.id != link.id))


def with_link(btm: BtmMap, old: Link, new: Link) -> BtmMap:
    """Replace a link."""
    return dataclasses.replace(btm, links=tuple(new if link is old else link for link in btm.links))


def with_nodes_joined(btm: BtmMap, kept: int, gone: int, turn_deg: float) -> BtmMap | None:
    """Merge two nodes, the frame of the second turned by `turn_deg`, keeping all links; None if their types differ.

    Un-searched links go that leave by an opening by which another one leaves.
    """
    nodes = {node.id: node for node in btm.nodes}
    if (nodes[kept].type, nodes[kept].obstacle) != (nodes[gone].type, nodes[gone].obstacle):
        return None
    moved = [_moved_to(link, kept, gone, turn_deg) for link in btm.links]
    links = [link for link in moved if link.start != kept or link.end != NOWHERE or not _is_double(link, moved)]
    return dataclasses.replace(btm, nodes=tuple(n for n in btm.nodes if n.id != gone), links=tuple(links))


def _moved_to(link, kept, gone, turn_deg):
    """Move a link's ends from one node to another, whose frame is turned by `turn_deg` against it."""
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
    """Return whether an un-searched link leaves by the opening of a searched one of its node, or before it."""
    for link in links:
        ends = [(link.start, link.start_bearing_deg), (link.end, link.end_bearing_deg)]
        near = any(node == stub.start and are_near(bearing_deg, stub.start_bearing_deg) for node, bearing_deg in ends)
        if near and (link.end != NOWHERE or link.id < stub.id):
            return True
    return False


def twins(btm: BtmMap) -> Iterator[tuple[LinkWay, LinkWay]]:
    """Yield pairs of ways of a node that leave by one opening: `(shorter, longer)`."""
    for node in btm.nodes:
        ways = sorted(ways_of(btm, node.id), key=lambda way: way.length_m)
        for i, short in enumerate(ways):
            for long in ways[i + 1 :]:
                if long.link.id != short.link.id and are_near(long.bearing_deg, short.bearing_deg):
                    yield short, long


def explained(btm: BtmMap, short: LinkWay, long: LinkWay, deep: bool = True) -> BtmMap | None:
    """Return the map once the longer of two ways is explained by the shorter; None if it is not.

    Two ways are one if they are as long as each other and lead to one place: the longer goes, and two nodes of one type
    at their ends are one, the one with the lower id. Else the longer leads through the node where the other ends, if
    known links lead on from there to where it ends, to that place, and over as much way or to the opening by which it
    ends; then it goes. Or it is the way out of an un-searched opening there: then it begins there. Or, if `deep`, the
    way out of an opening by which a known link leads through its end in turn.
    """
    length_m = long.length_m - short.length_m
    rest, rest_btm = _inverse(short.move).after(long.move), without(btm, long.link)
    limit_m = within_m(long.link)
    if length_m < limit_m and are_close(rest, Move(), limit_m):
        return rest_btm if short.to == long.to else _one_end(btm, short, long)
    if length_m < LONGER_M or math.hypot(rest.x_m, rest.y_m) > length_m + limit_m:
        return None
    for gone_m, last in _reached(rest_btm, short.to, long.to, length_m + limit_m):
        # It ends by the same opening, or at a node that has no other one.
        same_end = are_near(last.back_deg, long.back_deg) or all(
            are_near(bearing_deg, last.back_deg) for bearing_deg in rest_btm.bearings_deg(last.to)
        )
        if (same_end or abs(gone_m - length_m) < limit_m) and are_close(last.move, rest, limit_m):
            return rest_btm
    begun = _begun(rest_btm, short, long, rest, length_m)
    return begun or (_begun_on_known(rest_btm, short, long, rest, length_m) if deep else None)


def _one_end(btm: BtmMap, short: LinkWay, long: LinkWay) -> BtmMap | None:
    """Merge the ends of two ways; None if their types differ, or one is where the ways begin."""
    first, second = (short, long) if short.to < long.to else (long, short)
    begin = second.link.start if second.link.end == second.to else second.link.end
    if begin in (first.to, second.to):
        return None
    turn_deg = apart_deg(first.back_deg, second.back_deg)
    return with_nodes_joined(without(btm, second.link), first.to, second.to, turn_deg)


def _begun(btm, short, long, rest, length_m):
    """Return the map where the longer way begins at an un-searched opening of the node it passes; None without one."""
    ahead_deg = math.degrees(math.atan2(rest.y_m, rest.x_m))
    waiting = [link for link in btm.links if link.start == short.to and link.end == NOWHERE]
    stub = min(waiting, key=lambda link: abs(apart_deg(link.start_bearing_deg, ahead_deg)), default=None)
    if stub is None or abs(apart_deg(stub.start_bearing_deg, ahead_deg)) > OPENING_DEG:
        return None
    begun = _rest_of(long, short.to, stub.start_bearing_deg, rest, length_m)
    attributes = {key: value for key, value in stub.attributes.items() if key not in (BLOCKED, BLOCKED_FOR)}
    attributes |= begun.attributes
    return with_link(btm, stub, dataclasses.replace(begun, id=stub.id, opening_m=stub.opening_m, attributes=attributes))


def _begun_on_known(btm, short, long, rest, length_m):
    """Return the same if a known link leaves by that opening and passes the end of the short way; None otherwise."""
    ahead_deg = math.degrees(math.atan2(rest.y_m, rest.x_m))
    for way in ways_of(btm, short.to):
        if are_near(way.bearing_deg, ahead_deg, OPENING_DEG) and way.to != long.to:
            begun = _rest_of(long, short.to, way.bearing_deg, rest, length_m)
            own = LinkWay(begun, begun.end, begun.start_bearing_deg, long.back_deg, rest)
            found = explained(dataclasses.replace(btm, links=(*btm.links, begun)), own, way, deep=False)
            if found is not None:
                return found
    return None


def _rest_of(long, start, bearing_deg, rest, length_m):
    """Return the rest of a way once it begins at a node on it."""
    return dataclasses.replace(
        long.link,
        start=start,
        end=long.to,
        status=STATUS[1],
        start_bearing_deg=bearing_deg,
        end_bearing_deg=long.back_deg,
        length_m=length_m,
        opening_m=None,
        attributes={"moved": [rest.x_m, rest.y_m, apart_deg(rest.turn_deg, 0)]},
    )


def _reached(btm, node, goal, most_m):
    """Yield ways along known links from a node to another, no link twice, as `(metres, last link with the whole move)`.

    A link on which the robot has gone to and fro counts by its displacement.
    """
    pending: list[tuple[int, float, float, LinkWay | None, Move, frozenset[int]]]
    pending = [(node, 0.0, 0.0, None, Move(), frozenset())]
    for _ in range(MAX_WAYS_TRIED):
        if not pending:
            return
        here, gone_m, least_m, last, move, used = pending.pop()
        if here == goal and last is not None:
            yield gone_m, last._replace(move=move)
        for way in ways_of(btm, here):
            further_m = least_m + min(way.length_m, math.hypot(way.move.x_m, way.move.y_m))
            if way.link.id not in used and further_m <= most_m:
                moved = move.after(way.move)
                pending.append((way.to, gone_m + way.length_m, further_m, way, moved, used | {way.link.id}))
