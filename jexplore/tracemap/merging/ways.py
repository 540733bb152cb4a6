"""A Behavioral Trace Map as places and the ways between them: what maps of other robots can agree about.

Where a robot starts or ends it writes a terminal node, which may lie in the middle of a passage that another robot has
gone through without a stop. So a terminal node with one or two links is no place here, but a stop on a way.
"""

import dataclasses
from collections.abc import Iterable, Mapping

from jexplore.tracemap.record import NOWHERE, BtmMap, Link, Node, length_of
from jexplore.tracemap.similarity import ends_around


@dataclasses.dataclass(frozen=True, eq=False)
class PlaceWay:
    """Exit of a place, with the way as far as it has been followed."""

    bearing_deg: float  # direction in which it leaves
    steps: tuple[tuple[Link, bool], ...]  # its links in order, and whether they start where one comes from
    stops: tuple[tuple[int, float], ...]  # terminal nodes on it: id, and how far from the place, metres
    end: int  # place that it leads to; `NOWHERE` where that is not known
    back: int  # index of the way back at that place; -1 without an end
    length_m: float  # as far as it has been followed

    @property
    def is_whole(self) -> bool:
        """Return whether it has been followed to another place."""
        return self.end != NOWHERE

    @property
    def opening_m(self) -> float | None:
        """Return the width of the opening; None if unknown, as where the robot came in."""
        link, forward = self.steps[0]
        return link.opening_m if forward else None

    @property
    def width_m(self) -> float | None:
        """Return the narrowest passage; None if unknown."""
        return least_known(link.min_width_m for link, _ in self.steps)


@dataclasses.dataclass(frozen=True, eq=False)
class Places:
    """A map seen so: nodes by id, and their ways counter-clockwise."""

    nodes: Mapping[int, Node]
    ways: Mapping[int, tuple[PlaceWay, ...]]


def least_known(values: Iterable[float | None]) -> float | None:
    """Return the least known value; None if no value is known."""
    return min((value for value in values if value is not None), default=None)


def most_known(values: Iterable[float | None]) -> float | None:
    """Return the greatest known value; None if no value is known."""
    return max((value for value in values if value is not None), default=None)


def places_of(btm: BtmMap) -> Places:
    """Return the places of a proper map. A link without a length is as long as its nodes are apart."""
    around, nodes = ends_around(btm), {node.id: node for node in btm.nodes}
    kept = {key: node for key, node in nodes.items() if node.type != "terminal" or len(around[key]) > 2}
    index = {end[1:3]: (key, i) for key in kept for i, end in enumerate(around[key])}
    ways = {key: tuple(_way(end, nodes, around, index) for end in around[key]) for key in kept}
    return Places(kept, ways)


def _way(first, nodes, around, index):
    bearing, _, side, link = first
    steps, stops, length = [], [], 0.0
    end, back = NOWHERE, -1
    while True:
        steps.append((link, side == 0))
        if link.end == NOWHERE:
            break
        length += length_of(link, nodes)
        here = link.start if side else link.end
        if (link.id, 1 - side) in index:
            end, back = index[link.id, 1 - side]
            break
        stops.append((here, length))
        rest = [other for other in around[here] if other[1:3] != (link.id, 1 - side)]
        if not rest:
            break
        _, _, side, link = rest[0]
    return PlaceWay(bearing, tuple(steps), tuple(stops), end, back, length)
