"""A team as it is asked for: how many robots, how they coordinate, whom they hear, where they start."""

import math
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, TypeAlias

from jexplore.config import InputError, require_whole, shown, unknown
from jexplore.exploration.motion import LENGTHS
from jexplore.exploration.team.coordination import COORDINATIONS, Coordination
from jexplore.grid import radius_d2
from jexplore.users import name_of

MOST_ROBOTS = 16
NOBODY, EVERYBODY = -1, 2**30
"""Squared distances in cells within which robots hear each other: none, and any."""
SIGHT = "line-of-sight"
CONTACTS = "all", "none", "range", SIGHT
MOST_DELAY = 100_000  # ticks, times of a straight step
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


class Contact(NamedTuple):
    """Whom robots hear directly, numbers or arrays of one shape."""

    d2: Any  # int32, cells^2, largest squared distance
    in_sight: Any  # bool, whether no wall may be between
    delay: Any  # int32, how long a link must hold before it carries anything, in units of `motion.LENGTHS`
    loss: Any  # float32, probability that a link fails, each time that a robot acts


def read_contact(contact: str, cell_m: float) -> Contact:
    """Return the `Contact` of a text such as all, none, range:4, line-of-sight, range:4,delay=10,loss=0.2.

    Raises:
      InputError: the text says something else; a distance, delay or loss that cannot be.
    """
    first, *more = str(contact).split(",")
    word, colon, metres = first.partition(":")
    given = {name: value for name, _, value in (part.partition("=") for part in more)}
    known = word in CONTACTS and bool(metres) == bool(colon) and {*given} <= {"delay", "loss"}
    known &= len(given) == len(more) and (bool(colon) if word == "range" else word == SIGHT or not colon)
    try:
        reach_m, delay, loss = float(metres or "inf"), int(given.get("delay", "0")), float(given.get("loss", "0"))
    except ValueError:
        reach_m, delay, loss = -1.0, 0, 0.0
    can_be = reach_m >= 0 and (not colon or math.isfinite(reach_m)) and 0 <= delay <= MOST_DELAY and 0 <= loss <= 1
    if not (can_be and known):
        raise InputError(
            "contact must be all, none, range:METRES or line-of-sight[:METRES], with ,delay=TICKS (up to "
            f"{MOST_DELAY:,}) and ,loss=P (0 to 1) if wanted, got {shown(contact)}"
        )
    d2 = NOBODY if word == "none" else min(radius_d2(min(reach_m, EVERYBODY * cell_m), cell_m), EVERYBODY)
    return Contact(d2, word == SIGHT, delay * LENGTHS[0], loss)


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
