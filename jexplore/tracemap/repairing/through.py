"""Two ways that leave a node by one opening and lead to different places.

A robot that goes by a junction without seeing it takes the way to the next one for the way from the one before. Once it
knows the junction from another side, two links leave by one opening, and the longer of them leads through a node. A
robot that takes a place for a new one has it twice: then both links are as long.
"""

import dataclasses
import math
from collections.abc import Iterator

from jexplore.tracemap.merging.rigid import Move, apart_deg
from jexplore.tracemap.passable import BLOCKED, BLOCKED_FOR
from jexplore.tracemap.record import NOWHERE, STATUS, BtmMap
from jexplore.tracemap.repairing.ways import (
    OPENING_DEG,
    TWINS_DEG,
    Way,
    are_close,
    are_near,
    inverse,
    joined,
    ways_of,
    within_m,
    without,
)

LONGER_M = 0.5  # at least, than the way to the node by which it goes
MOST = 10_000  # ways that are tried to explain one


def twins(btm: BtmMap) -> Iterator[tuple[Way, Way]]:
    """Yield pairs of ways of a node that leave by one opening: `(shorter, longer)`."""
    for node in btm.nodes:
        ways = sorted(ways_of(btm, node.id), key=lambda way: way.link.length_m or 0.0)
        for i, short in enumerate(ways):
            for long in ways[i + 1 :]:
                if long.link.id != short.link.id and abs(apart_deg(long.bearing_deg, short.bearing_deg)) < TWINS_DEG:
                    yield short, long


def explained(btm: BtmMap, short: Way, long: Way, deep: bool = True) -> BtmMap | None:
    """Return the map once the longer of two ways is explained by the shorter; None if it is not.

    Two ways are one if they are as long as each other and lead to one place: the longer goes, and two nodes of one type
    at their ends are one, the one with the lower id. Else the longer leads through the node where the other ends, if
    known links lead on from there to where it ends, to that place, and over as much way or to the opening by which it
    ends; then it goes. Or it is the way out of an un-searched opening there: then it begins there. Or, if `deep`, the
    way out of an opening by which a known link leads through its end in turn.
    """
    length_m = (long.link.length_m or 0.0) - (short.link.length_m or 0.0)
    rest, rest_btm = inverse(short.move).after(long.move), without(btm, long.link)
    limit_m = within_m(long.link)
    if length_m < limit_m and are_close(rest, Move(), limit_m):
        return rest_btm if short.to == long.to else _one_end(btm, short, long)
    if length_m < LONGER_M or math.hypot(rest.x_m, rest.y_m) > length_m + limit_m:
        return None
    for gone_m, last in _reached(rest_btm, short.to, long.to, length_m + limit_m):
        same_end = are_near(last.back_deg, long.back_deg) or _is_dead_end(rest_btm, last)
        if (same_end or abs(gone_m - length_m) < limit_m) and are_close(last.move, rest, limit_m):
            return rest_btm
    begun = _begun(rest_btm, short, long, rest, length_m)
    return begun or (_begun_on_known(rest_btm, short, long, rest, length_m) if deep else None)


def _is_dead_end(btm, last):
    """Return whether a node has no opening but that of a link that leads there."""
    return all(are_near(bearing_deg, last.back_deg) for bearing_deg in btm.bearings_deg(last.to))


def _one_end(btm: BtmMap, short: Way, long: Way) -> BtmMap | None:
    """Merge the ends of two ways; None if their types differ, or one is where the ways begin."""
    first, second = (short, long) if short.to < long.to else (long, short)
    begin = second.link.start if second.link.end == second.to else second.link.end
    if begin in (first.to, second.to):
        return None
    turn_deg = apart_deg(first.back_deg, second.back_deg)
    return joined(without(btm, second.link), first.to, second.to, turn_deg)


def _begun(btm, short, long, rest, length_m):
    """Return the map where the longer way begins at an un-searched opening of the node it passes; None without one."""
    ahead_deg = math.degrees(math.atan2(rest.y_m, rest.x_m))
    waiting = [link for link in btm.links if link.start == short.to and link.end == NOWHERE]
    waiting.sort(key=lambda link: abs(apart_deg(link.start_bearing_deg, ahead_deg)))
    if not waiting or abs(apart_deg(waiting[0].start_bearing_deg, ahead_deg)) > OPENING_DEG:
        return None
    begun = _rest_of(long, short.to, waiting[0].start_bearing_deg, rest, length_m)
    attributes = {key: value for key, value in waiting[0].attributes.items() if key not in (BLOCKED, BLOCKED_FOR)}
    attributes |= begun.attributes
    begun = dataclasses.replace(begun, id=waiting[0].id, opening_m=waiting[0].opening_m, attributes=attributes)
    return dataclasses.replace(btm, links=tuple(begun if link.id == begun.id else link for link in btm.links))


def _begun_on_known(btm, short, long, rest, length_m):
    """Return the same if a known link leaves by that opening and passes the end of the short way; None otherwise.

    Both are then explained.
    """
    ahead_deg = math.degrees(math.atan2(rest.y_m, rest.x_m))
    for way in ways_of(btm, short.to):
        if abs(apart_deg(way.bearing_deg, ahead_deg)) < OPENING_DEG and way.to != long.to:
            begun = _rest_of(long, short.to, way.bearing_deg, rest, length_m)
            own = Way(begun, begun.end, begun.start_bearing_deg, long.back_deg, rest)
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
    """Yield ways along known links from a node to another, no link twice.

    Each is `(metres, the last link, whose move is that from the first node)`. A link on which the robot has gone to and
    fro counts by its displacement.
    """
    pending: list[tuple[int, float, float, Way | None, Move, frozenset[int]]]
    pending = [(node, 0.0, 0.0, None, Move(), frozenset())]
    for _ in range(MOST):
        if not pending:
            return
        here, gone_m, least_m, last, move, used = pending.pop()
        if here == goal and last is not None:
            yield gone_m, last._replace(move=move)
        for way in ways_of(btm, here):
            length_m = way.link.length_m or 0.0
            further_m = least_m + min(length_m, math.hypot(way.move.x_m, way.move.y_m))
            if way.link.id not in used and further_m <= most_m:
                moved = move.after(way.move)
                pending.append((way.to, gone_m + length_m, further_m, way, moved, used | {way.link.id}))
