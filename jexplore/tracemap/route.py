"""A route over a Behavioral Trace Map as a document: links in order, and by which way to leave each node.

Plain Python: importing this loads no jax.
"""

import dataclasses
import functools
from collections.abc import Sequence

from jexplore.config import checked_names
from jexplore.tracemap.passable import inclination_of, link_name, step_of, unknowns, unknowns_at, width_of
from jexplore.tracemap.record import NOWHERE, BtmMap, Link, Node, connected_parts, length_of

SAME_BEARING_DEG = 1e-6  # bearings nearer than this are one
LENGTH_UNIT_M = 0.001  # lengths are compared in whole units


@dataclasses.dataclass(frozen=True)
class Step:
    """Link of a route in the direction in which it is followed. Values missing in the map are None."""

    link: int  # id
    start: int  # node that it leaves
    end: int  # node that it leads to; `NOWHERE` (-1) for an un-searched one
    bearing_deg: float  # direction in which it leaves, degrees in [0, 360), counter-clockwise from the map's +x
    turn_deg: float | None
    """That direction counter-clockwise from the link by which one came, degrees in (0, 360]: 180 is straight on, less
    is to the right; None where the route begins."""
    way: int | None
    """Number of the link at the node, counter-clockwise from the one of arrival: 1 is the first to the right."""
    ways: int  # number of links to count, un-searched and refused ones included
    length_m: float | None
    width_m: float | None  # the narrowest, the opening included
    step_m: float | None
    posture_deg: float | None
    roll_deg: float | None


@checked_names
@dataclasses.dataclass(frozen=True)
class Route:
    """Shortest way of a robot from node to node, or the reason for having none."""

    robot: str
    start: int
    end: int | None  # the requested node; with `unsearched` the one that the un-searched link leaves, None without one
    nodes: tuple[int, ...]  # ids, one more than links; empty where there is no route
    links: tuple[int, ...]
    length_m: float  # infinite where there is no route
    steps: tuple[Step, ...]
    onward: Step | None  # the un-searched link that was asked for
    refused: tuple[tuple[int, tuple[str, ...]], ...]
    """Id of every link that the robot may not use, and all reasons; un-searched links only where one was asked for."""
    barriers: tuple[tuple[int, tuple[str, ...]], ...]  # the same of nodes that it may come to, but not pass
    unknown: tuple[str, ...]  # facts about the links and nodes of the route that the map lacks: sentences
    trouble: str  # reason for having no route; else empty

    @property
    def is_found(self) -> bool:
        return bool(self.nodes)

    def __repr__(self) -> str:
        if not self.is_found:
            return f"<Route of {self.robot}: none, {self.trouble}>"
        way = " - ".join(map(str, self.nodes)) + ("" if self.onward is None else " - ?")
        count = f"{len(self.links)} link" + "s" * (len(self.links) != 1)
        doubt = f", {len(self.unknown)} unknown" if self.unknown else ""
        return f"<Route of {self.robot}: {way}, {count}, {self.length_m:.2f} m{doubt}>"


class MapIndex:
    """A proper map by ids, and the texts of routes over it, each made once: many routes share their ways."""

    def __init__(self, btm: BtmMap) -> None:
        self.nodes: dict[int, Node] = {node.id: node for node in btm.nodes}
        self.links: dict[int, Link] = {link.id: link for link in btm.links}
        self.length_m = {link.id: length_of(link, self.nodes) for link in btm.links if link.end != NOWHERE}
        """Link -> its length; un-searched ones left out."""
        # Node -> its ends of links, by `(id, whether it is the link's first end)` -> bearing in which the link leaves.
        self._ends = {
            own: {(link, side == 0): bearing for bearing, link, side, _ in btm.ends[own]} for own in self.nodes
        }
        self.doubts = functools.cache(self._doubts)
        self._step = functools.cache(self._made_step)

    def _doubts(self, own: int) -> tuple[str, ...]:
        """List facts about a link of a route that the map lacks: texts."""
        link = self.links[own]
        found = unknowns(link, self.nodes)
        if link.end == NOWHERE or link.length_m is not None:
            return found
        return (*found, f"length unknown, {self.length_m[own]:.2f} m in a straight line")

    @functools.cached_property
    def part(self) -> dict[int, int]:
        """Return node -> a node of its connected part, one for all of the part."""
        return connected_parts(self.nodes, self.links.values())

    @functools.cached_property
    def parts_with_stubs(self) -> frozenset[int]:
        """Return parts, as of `part`, with an un-searched link."""
        return frozenset(self.part[link.start] for link in self.links.values() if link.end == NOWHERE)

    def steps(self, nodes: Sequence[int], links: Sequence[int]) -> tuple[Step, ...]:
        """Make the steps of a way: ids of nodes, and of the links that leave them; an un-searched one is the last."""
        return tuple(map(self._step, (NOWHERE, *links), links, nodes))

    def unknown(self, links: Sequence[int], passed: Sequence[int]) -> tuple[str, ...]:
        """List facts that the map lacks about the links of a route and the nodes it passes: sentences."""
        of_links = [(link_name(self.links[own]), self.doubts(own)) for own in links]
        of_nodes = [(f"node {own}", unknowns_at(self.nodes[own])) for own in passed]
        return tuple(f"{name}: {', '.join(found)}" for name, found in of_links + of_nodes if found)

    def _made_step(self, before, own, start):
        link = self.links[own]
        forward, ends = link.start == start, self._ends[start]
        came = None if before == NOWHERE else (before, self.links[before].end != start)
        way, ways, turn = _counted(ends, (own, forward), came)
        return Step(
            link=own,
            start=start,
            end=link.end if forward else link.start,
            bearing_deg=ends[own, forward],
            turn_deg=turn,
            way=way,
            ways=ways,
            length_m=self.length_m.get(own),
            width_m=width_of(link),
            step_m=step_of(link, self.nodes),
            posture_deg=inclination_of(link, self.nodes),
            roll_deg=link.max_roll_deg,
        )


def _counted(ends, leaves, came):
    """Return `(way, ways, turn_deg)` of a `Step` by the ends of links at a node, and two of its keys."""
    if came is None:
        return None, len(ends), None
    back = ends[came]

    def angle(end):
        turned = (ends[end] - back) % 360.0
        return 360.0 if turned <= SAME_BEARING_DEG else turned

    order = sorted((end for end in ends if end != came), key=lambda end: (angle(end), end[0], not end[1]))
    return order.index(leaves) + 1, len(order), angle(leaves)
