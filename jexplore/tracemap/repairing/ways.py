"""Searched links as they are followed from one of their ends, and what it takes to make two nodes one."""

import dataclasses
import math
from collections.abc import Iterator
from typing import NamedTuple

from jexplore.tracemap.merging.rigid import Move, apart_deg
from jexplore.tracemap.record import NOWHERE, BtmMap, Link

TWINS_DEG = 30.0  # two ways of a node no farther apart leave by one opening
CLOSE = 0.6, 0.1  # m, share of the way: ends of two ways within this are one place
OPENING_DEG = 50.0  # a way beyond it leaves by an un-searched opening that lies no farther from where it leads
STRAIGHT = 1.05, 0.3  # ratio, m: a way no longer than its displacement by this goes round no corner


class Way(NamedTuple):
    """A searched link as it is followed from one of its ends."""

    link: Link
    to: int  # node
    bearing_deg: float  # there
    back_deg: float  # of the other end
    move: Move  # the frame of the other node in that of this one


def ways_of(btm: BtmMap, node: int) -> Iterator[Way]:
    """Yield searched links of a node whose move is known; both ways of one that leads back to it."""
    for link in btm.links:
        moved = link.attributes.get("moved")
        if link.end == NOWHERE or link.end_bearing_deg is None or moved is None:
            continue
        there = Move(moved[0], moved[1], sum(moved[2:]))
        if link.start == node:
            yield Way(link, link.end, link.start_bearing_deg, link.end_bearing_deg, there)
        if link.end == node:
            yield Way(link, link.start, link.end_bearing_deg, link.start_bearing_deg, inverse(there))


def inverse(move: Move) -> Move:
    """Return the move back."""
    x_m, y_m = Move(turn_deg=-move.turn_deg).place(-move.x_m, -move.y_m)
    return Move(x_m, y_m, -move.turn_deg)


def within_m(link: Link) -> float:
    """Return the tolerance for the position of a place at the end of a link."""
    return CLOSE[0] + CLOSE[1] * (link.length_m or 0.0)


def are_close(one: Move, other: Move, limit_m: float) -> bool:
    """Return whether two moves lead to places less than this apart."""
    return math.hypot(one.x_m - other.x_m, one.y_m - other.y_m) < limit_m


def are_near(bearing_deg: float | None, other_deg: float | None) -> bool:
    """Return whether two ends of links of a node leave by one opening."""
    return bearing_deg is not None and other_deg is not None and abs(apart_deg(bearing_deg, other_deg)) < TWINS_DEG


def joined(btm: BtmMap, kept: int, gone: int, turn_deg: float) -> BtmMap | None:
    """Merge two nodes, keeping the links of both; None if their types differ.

    Un-searched links go that leave by an opening by which another one leaves.

    Args:
      btm: the map.
      kept, gone: ids of the nodes.
      turn_deg: how far the frame of the second is turned against that of the first.
    """
    nodes = {node.id: node for node in btm.nodes}
    if (nodes[kept].type, nodes[kept].obstacle) != (nodes[gone].type, nodes[gone].obstacle):
        return None
    moved = [_moved_to(link, kept, gone, turn_deg) for link in btm.links]
    links = [link for link in moved if link.start != kept or link.end != NOWHERE or not _is_double(link, moved)]
    return dataclasses.replace(btm, nodes=tuple(n for n in btm.nodes if n.id != gone), links=tuple(links))


def without(btm: BtmMap, link: Link) -> BtmMap:
    """Remove a link."""
    return dataclasses.replace(btm, links=tuple(other for other in btm.links if other.id != link.id))


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
        near = [node == stub.start and are_near(bearing_deg, stub.start_bearing_deg) for node, bearing_deg in ends]
        if any(near) and (link.end != NOWHERE or link.id < stub.id):
            return True
    return False
