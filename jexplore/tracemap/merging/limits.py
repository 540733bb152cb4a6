"""Tolerances of merging. Plain Python: importing this loads neither jax nor numpy."""

import dataclasses
import math

from jexplore.config import checked_names, require_number, require_whole
from jexplore.rules import Settings


@checked_names
@dataclasses.dataclass(frozen=True)
class Limits(Settings):
    """Tolerances for one place in two maps."""

    angle_deg: float = 15.0
    """Of an angle between two links, from what the other map says, degrees."""
    length_share: float = 0.05
    """Share of a length, in each map: a constant scale error of the encoders."""
    length_m: float = 0.3
    """Of a length, besides, metres."""
    lost: int = 1
    """Links that one map may lack at a node that the other has there."""
    heading_deg: float = 2.0
    """Standard deviation of the heading after 1 m, degrees; it grows with the root of the way."""

    def __post_init__(self):
        for name, high in {"angle_deg": 90.0, "length_share": 0.5, "length_m": math.inf, "heading_deg": 90.0}.items():
            require_number(f"limits: {name}", getattr(self, name), low=0.0, high=high)
        require_whole("limits: lost", self.lost, 0, 100)

    def length(self, one_m: float, other_m: float) -> float:
        """Return the tolerance of two lengths, metres."""
        return self.length_m + self.length_share * (one_m + other_m)

    def turn(self, way_m: float) -> float:
        """Return the tolerance of the turn of a way, degrees."""
        return self.angle_deg + 2 * math.sqrt(2 * way_m) * self.heading_deg


@checked_names
@dataclasses.dataclass(frozen=True)
class TeamLimits(Limits):
    """Tolerances for maps of robots in one building at the same time: wider ones take a room for its neighbour."""

    length_share: float = 0.02
    """Share of a length, in each map: a constant scale error of the encoders."""
    heading_deg: float = 0.5
    """Standard deviation of the heading after 1 m, degrees; it grows with the root of the way."""
