"""A team as it is asked for: how many robots, how they coordinate, whom they hear, where they start."""

import math
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, TypeAlias

from jexplore.config import InputError, require_whole, shown, unknown
from jexplore.exploration.team.coordination import COORDINATIONS, Coordination
from jexplore.grid import radius_d2
from jexplore.users import name_of

MOST_ROBOTS = 16
NOBODY, EVERYBODY = -1, 2**30
"""Squared distances in cells within which robots hear each other: none, and any."""
STARTS = "together", "apart"
INDEPENDENT = "independent"
Starts: TypeAlias = str | tuple[tuple[int, int, int], ...]


class Team(NamedTuple):
    """A team."""

    robots: int = 1
    coordination: Coordination | None = None  # None: every robot asks its own strategy
    contact: str = "all"
    starts: Starts = "together"  # or row, col, heading_deg of every robot, the first one's with them

    @property
    def coordinates(self) -> str:
        """Return the name of the coordination."""
        return INDEPENDENT if self.coordination is None else self.coordination.name

    def label(self, strategy: str) -> str:
        """Return what tables call a strategy of this team."""
        return f"{self.robots} x {strategy}" + (f", {self.coordinates}" if self.robots > 1 else "")


def contact_d2(contact: str, cell_m: float) -> int:
    """Return the largest squared distance of robots that hear each other, cells^2.

    Raises:
      InputError: `contact` is not all, none, or range and a number of metres.
    """
    if contact in ("all", "none"):
        return EVERYBODY if contact == "all" else NOBODY
    word, _, text = str(contact).partition(":")
    try:
        metres = float(text) if word == "range" else -1.0
    except ValueError:
        metres = -1.0
    if not (metres >= 0 and math.isfinite(metres)):
        raise InputError(f"contact must be all, none or range:METRES such as range:4, got {shown(contact)}")
    return min(radius_d2(metres, cell_m), EVERYBODY)


def read_coordination(given: str | Callable[..., Any]) -> Coordination | None:
    """Return a coordination by its name, or of a user's function of a `JointView`; None for `independent`.

    Raises:
      InputError: no coordination has that name; a user's function has the name of one.
    """
    if given == INDEPENDENT:
        return None
    if callable(given):
        name = name_of(given) or "own"
        if name == INDEPENDENT or COORDINATIONS.get(name, given) is not given:
            raise InputError(f"coordination {name} is built in: give your function another name")
        return Coordination(name, given)
    names = [INDEPENDENT, *COORDINATIONS]
    if given not in names:
        raise unknown("coordination", str(given), names)
    return Coordination(given, COORDINATIONS[given])


def read_robots(given: int | Iterable[int]) -> list[int]:
    """Return sizes of teams, in order and different.

    Raises:
      InputError: not whole numbers from 1 to `MOST_ROBOTS`, or one of them twice.
    """
    sizes = list(given) if isinstance(given, Iterable) else [given]
    sizes = [require_whole("robots", size, 1, MOST_ROBOTS) for size in sizes]
    if not sizes or len(set(sizes)) < len(sizes):
        raise InputError(f"robots must be one or several different sizes of a team, got {shown(given)}")
    return sizes
