"""Parts of a trace map that a robot may use, limited by its width, its step height and its slope.

Plain Python: importing this loads no jax.
"""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any, Protocol

from jexplore.tracemap.record import NOWHERE, Link, Node

BLOCKED, BLOCKED_FOR, FOUND_BY = "blocked", "blocked_for", "found_by"
"""Attributes of a link that could not be passed: true; the robot for which, with its measures; its name alone."""
CONFLICTS = "conflicts"
"""Attribute of what maps say different things about: `{attribute: [{"from": [names], "value": value}, ...]}`."""
_MEASURES, _MOST = ("width_m", "max_step_m", "max_slope_deg"), 1e6
SLACK = 1e-6  # share of a limit by which a measure may lie beyond it: maps hold single precision


class RobotBody(Protocol):
    """Dimensions of a robot that decide where it passes, such as a `jx.btm.Robot`."""

    @property
    def name(self) -> str: ...
    @property
    def width_m(self) -> float: ...
    @property
    def max_step_m(self) -> float: ...
    @property
    def max_slope_deg(self) -> float: ...


@dataclasses.dataclass(frozen=True)
class Blockage:
    """That a link could not be passed, and by whom."""

    words: str
    width_m: float | None  # of the robot that could not, as the other measures; all None where the map does not say
    max_step_m: float | None
    max_slope_deg: float | None

    def holds_for(self, robot: RobotBody) -> bool:
        """Return whether a robot is no narrower and climbs no more than the one that could not pass."""
        if self.width_m is None or self.max_step_m is None or self.max_slope_deg is None:
            return True
        is_narrower = robot.width_m < self.width_m * (1 - SLACK)
        climbs = (robot.max_step_m, self.max_step_m), (robot.max_slope_deg, self.max_slope_deg)
        return not (is_narrower or any(own > other * (1 + SLACK) for own, other in climbs))


def blocked_for(robot: RobotBody) -> dict[str, Any]:
    """Return the attributes of a link that a robot could not pass."""
    measures = {name: getattr(robot, name) for name in _MEASURES}
    return {BLOCKED: True, BLOCKED_FOR: {"name": robot.name, **measures}}


def blockages_of(link: Link) -> tuple[Blockage, ...]:
    """Return the robots that could not pass a link; none if the map does not say so, or its sources differ."""
    if link.attributes.keys().isdisjoint((BLOCKED, CONFLICTS)):  # as most links: quickly
        return ()
    yes, no = _said(link)
    if not yes or no:
        return ()
    told = [value for _, value in _told_of(link, BLOCKED_FOR)] or [None]
    return tuple(dict.fromkeys(_block(link, value) for value in told))


def _block(link, told):
    if isinstance(told, Mapping) and isinstance(told.get("name"), str):
        values: list[Any] = [told.get(name) for name in _MEASURES]
        if all(type(value) in (int, float) and 0 <= value < _MOST for value in values):
            return Blockage(f"blocked for {told['name']}", *map(float, values))
    who = link.attributes.get(FOUND_BY)
    by = f"blocked, found by {who}" if isinstance(who, str) else "blocked"
    return Blockage(f"{by}: no measures of who could not pass; {BLOCKED} set to false lifts it", None, None, None)


def _said(link):
    """Return the sources that say that a link is blocked, and that it is not: texts, possibly empty."""
    told = list(_told_of(link, BLOCKED))
    return tuple(", ".join(names for names, value in told if bool(value) is wanted) for wanted in (True, False))


def _told_of(link, name) -> Iterator[tuple[str, Any]]:
    """Return an attribute of a link with its source; without one, the values on which maps differ."""
    conflicts = link.attributes.get(CONFLICTS)
    told = conflicts.get(name) if isinstance(conflicts, Mapping) else None
    if name in link.attributes:
        yield "the map", link.attributes[name]
    elif isinstance(told, list):
        for one in told:
            if isinstance(one, Mapping) and isinstance(one.get("from"), list):
                yield ", ".join(map(str, one["from"])) or "a map", one.get("value")


def step_of(link: Link, nodes: Mapping[int, Node]) -> float | None:
    """Return the highest step along a link, metres: as measured, else, between nodes of stairs, the lower of theirs."""
    return link.max_step_m if link.max_step_m is not None else _between(link, nodes, "stairs", "step_m")


def inclination_of(link: Link, nodes: Mapping[int, Node]) -> float | None:
    """Return the largest inclination along a link, degrees: the robot's, else, on a slope, the lower of its nodes'."""
    return link.posture_deg if link.posture_deg is not None else _between(link, nodes, "slope", "inclination_deg")


def width_of(link: Link) -> float | None:
    """Return the narrowest known width of a link, the opening at its first node included, metres."""
    return min((width for width in (link.min_width_m, link.opening_m) if width is not None), default=None)


def refusals(link: Link, nodes: Mapping[int, Node], robot: RobotBody, *, known_only: bool = False) -> tuple[str, ...]:
    """List why a robot may not use a link, such as `step 0.15 m > 0.03 m`: all reasons, none if it may.

    A link is as good either way: the map does not say which way is up. The inclination of the body that wrote the map,
    and its roll, are held against the steepest ground that the robot climbs. Of an un-searched link only its opening is
    measured; the first node lies before it, so one that cannot be passed refuses it. What one robot could not pass is
    refused to all but those that are narrower or climb more, or to all where the map does not say which robot it was;
    where maps differ about that, it is a doubt.

    With `known_only` a measure of a searched link that the map does not have is a reason, too.
    """
    steep = robot.max_slope_deg
    found = [
        _beyond("width", link.min_width_m, robot.width_m, sign="<"),
        _beyond("opening", link.opening_m, robot.width_m, sign="<"),
        _beyond("step", step_of(link, nodes), robot.max_step_m),
        _beyond("inclination", inclination_of(link, nodes), steep, "deg"),
        _beyond("roll", link.max_roll_deg, steep, "deg"),
        *(block.words for block in blockages_of(link) if block.holds_for(robot)),
    ]
    if link.end == NOWHERE:
        found += hindrances(nodes[link.start], robot, known_only=known_only)
    elif known_only:
        found += unknowns(link, nodes)
    return tuple(dict.fromkeys(reason for reason in found if reason is not None))


def hindrances(node: Node, robot: RobotBody, *, known_only: bool = False) -> tuple[str, ...]:
    """List why a robot may not pass a node, though it may come to it: all reasons, none if it may.

    An obstacle node is where the ground changes: a single step, or the first of stairs or of a slope. Who goes on by
    another link goes over it.
    """
    found = [
        _beyond("step", node.step_m, robot.max_step_m),
        _beyond("inclination", node.inclination_deg, robot.max_slope_deg, "deg"),
    ]
    found += unknowns_at(node) if known_only else ()
    return tuple(reason for reason in found if reason is not None)


def unknowns(link: Link, nodes: Mapping[int, Node]) -> tuple[str, ...]:
    """List measures that decide for a robot and that the map lacks for a link, as texts.

    That another robot could not pass the link, if this one may, counts, and that maps disagree about a blocked link.
    """
    yes, no = _said(link)
    blocked = tuple(block.words for block in blockages_of(link) if block.width_m is not None)
    if yes and no:
        blocked = (f"blocked in {yes}, not in {no}",)
    if link.end == NOWHERE:
        return (("opening unknown",) if link.opening_m is None else ()) + blocked
    measures: dict[str, Any] = {
        "width": link.min_width_m,
        "step": step_of(link, nodes),
        "inclination": inclination_of(link, nodes),
        "roll": link.max_roll_deg,
    }
    return tuple(f"{name} unknown" for name, value in measures.items() if value is None) + blocked


def unknowns_at(node: Node) -> tuple[str, ...]:
    """List the same of a node that is passed: stairs without a step, a slope without an inclination."""
    if node.type != "obstacle" or node.step_m is not None or node.inclination_deg is not None:
        return ()
    return ({"stairs": "step unknown", "slope": "inclination unknown"}.get(node.obstacle or "", "obstacle unknown"),)


def link_name(link: Link) -> str:
    """Name a link in a sentence: `link 3 (nodes 4 to 5)`."""
    if link.end == NOWHERE:
        return f"link {link.id} (node {link.start}, un-searched)"
    return f"link {link.id} (nodes {link.start} to {link.end})"


def _between(link, nodes, obstacle, measure):
    """Return the lower of the measures of both ends, if both are of an obstacle; a landing has its higher side's."""
    ends = [nodes[end] for end in (link.start, link.end) if end != NOWHERE]
    values = [getattr(node, measure) for node in ends if node.obstacle == obstacle]
    return min(values) if len(values) == 2 and None not in values else None


def _beyond(name, value, limit, unit="m", sign=">"):
    """Say that a value lies beyond a limit, with as many digits as distinguish them, three or more; else None."""
    if value is None or (value <= limit * (1 + SLACK) if sign == ">" else value >= limit * (1 - SLACK)):
        return None
    pairs = ((f"{value:.{digits}g}", f"{limit:.{digits}g}") for digits in range(3, 18))
    left, right = next(pair for pair in pairs if pair[0] != pair[1])
    return f"{name} {left} {unit} {sign} {right} {unit}"
