"""A team as it is asked for: how many robots, how they coordinate, whom they hear, where they start."""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, TypeAlias

from jexplore.config import InputError, require_number, require_whole, shown, unknown
from jexplore.exploration.motion import LENGTHS
from jexplore.exploration.team.coordination import COORDINATIONS, Coordination
from jexplore.grid import radius_d2
from jexplore.rules import Lidar
from jexplore.users import name_of

MOST_ROBOTS = 16
NOBODY, EVERYBODY = -1, 2**30
"""Squared distances in cells within which robots hear each other: none, and any."""
SIGHT = "line-of-sight"
CONTACTS = "all", "none", "range", SIGHT
MOST_DELAY = 100_000  # ticks, times of a straight step
MOST_PACE = 8  # clocks of the slowest robots fit int32 up to 460,000 steps
STARTS = "together", "apart"
INDEPENDENT = "independent"
Starts: TypeAlias = str | tuple[tuple[int, int, int], ...]


class Member(NamedTuple):
    """A robot of a team."""

    pace: int = 1  # ticks that a straight step takes; turns and scans take as many times their time
    range_m: float | None = None  # range of its scanner; None: the team's


class Team(NamedTuple):
    """A team."""

    robots: int = 1
    coordination: Coordination | None = None  # None: every robot asks its own strategy
    contact: str = "all"
    starts: Starts = "together"  # or row, col, heading_deg of every robot, the first one's with them
    members: tuple[Member, ...] = ()  # of each robot; (): all are alike

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
    rendezvous: Any = 0  # int32, how long a robot explores without having heard all others, as `delay`; 0: for ever

    @property
    def is_always(self) -> Any:
        """Return whether all robots always hear each other: bool."""
        return (self.d2 >= EVERYBODY) & ~self.in_sight & (self.delay <= 0) & (self.loss <= 0)


def read_contact(contact: str, cell_m: float) -> Contact:
    """Return the `Contact` of a text such as all, none, range:4, line-of-sight, range:4,delay=10,loss=0.2.

    Raises:
      InputError: the text says something else; a distance, delay, loss or rendezvous that cannot be.
    """
    first, *more = str(contact).split(",")
    word, colon, metres = first.partition(":")
    given = {name: value for name, _, value in (part.partition("=") for part in more)}
    known = word in CONTACTS and bool(metres) == bool(colon) and {*given} <= {"delay", "loss", "rendezvous"}
    known &= len(given) == len(more) and (bool(colon) if word == "range" else word == SIGHT or not colon)
    try:
        reach_m, delay, loss = float(metres or "inf"), int(given.get("delay", "0")), float(given.get("loss", "0"))
        meets = int(given.get("rendezvous", "1"))
    except ValueError:
        reach_m, delay, loss, meets = -1.0, 0, 0.0, 1
    can_be = reach_m >= 0 and (not colon or math.isfinite(reach_m)) and 0 <= delay <= MOST_DELAY and 0 <= loss <= 1
    can_be &= 1 <= meets <= MOST_DELAY
    if not (can_be and known):
        raise InputError(
            "contact must be all, none, range:METRES or line-of-sight[:METRES], with ,delay=TICKS (up to "
            f"{MOST_DELAY:,}), ,rendezvous=TICKS and ,loss=P (0 to 1) if wanted, got {shown(contact)}"
        )
    d2 = NOBODY if word == "none" else min(radius_d2(min(reach_m, EVERYBODY * cell_m), cell_m), EVERYBODY)
    if "rendezvous" in given and (d2 < 1 or loss == 1):
        raise InputError(f"contact {shown(contact)}: robots that never hear each other cannot meet")
    return Contact(d2, word == SIGHT, delay * LENGTHS[0], loss, meets * LENGTHS[0] * ("rendezvous" in given))


def read_members(given: str | Sequence[str], lidar: Lidar) -> tuple[Member, ...]:
    """Return robots of texts such as pace=2, range=3, pace=2,range=3, or of one text that holds them all.

    Raises:
      InputError: a text says something else; a pace or range that cannot be, a range longer than the scanner's.
    """
    given = given.split() if isinstance(given, str) else given
    if not isinstance(given, list | tuple):
        raise InputError(f"members must be a list of texts such as pace=2,range=3, got {shown(given)}")
    made = []
    for text in given:
        parts = [part.partition("=") for part in str(text).split(",")]
        own = {name: value for name, _, value in parts}
        form = f"members must be such as pace=2, range=3 or pace=2,range=3, got {shown(text)}"
        if not {*own} <= {"pace", "range"} or len(own) < len(parts):
            raise InputError(form)
        try:
            pace, range_m = int(own.get("pace", "1")), float(own["range"]) if "range" in own else None
        except ValueError:
            raise InputError(form) from None
        require_whole("members: pace", pace, 1, MOST_PACE)
        if range_m is not None:
            require_number("members: range", range_m, low=lidar.min_range_m, low_open=True, high=lidar.range_m)
        made.append(Member(pace, range_m))
    return tuple(made)


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
