"""Turning and shifting a map into the frame of another one."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

from jexplore.tracemap.record import BtmMap, direction_deg


@dataclasses.dataclass(frozen=True)
class Move:
    """A rigid transform: first the turn about the origin, then the shift."""

    x_m: float = 0.0
    y_m: float = 0.0
    turn_deg: float = 0.0

    def place(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Transform a point."""
        cos, sin = math.cos(math.radians(self.turn_deg)), math.sin(math.radians(self.turn_deg))
        return cos * x_m - sin * y_m + self.x_m, sin * x_m + cos * y_m + self.y_m

    def after(self, first: "Move") -> "Move":
        """Return this move as the second of two."""
        x_m, y_m = self.place(first.x_m, first.y_m)
        return Move(x_m, y_m, direction_deg(self.turn_deg + first.turn_deg))


def apart_deg(a: Any, b: Any) -> Any:
    """Return the angle from bearing `b` to bearing `a`, numbers or arrays, degrees in [-180, 180)."""
    return (a - b + 180.0) % 360.0 - 180.0


def mean_deg(bearings: Sequence[float], weights: Sequence[float] | None = None) -> float:
    """Average bearings that are less than half a turn apart."""
    weights = weights or [1.0] * len(bearings)
    off = sum(weight * apart_deg(bearing, bearings[0]) for weight, bearing in zip(weights, bearings))
    return direction_deg(bearings[0] + off / sum(weights))


def fit(points: Sequence[tuple[float, float]], onto: Sequence[tuple[float, float]], turn_deg: float) -> Move:
    """Fit the rigid transform that takes points nearest to others, by least squares.

    `turn_deg` is the turn where the points say nothing about it: all lie within 1 cm.

    Source:
      Umeyama 1991, Least-squares estimation of transformation parameters between two point patterns; in the plane.
    """
    n = len(points)
    (px, py), (qx, qy) = ((sum(p[0] for p in many) / n, sum(p[1] for p in many) / n) for many in (points, onto))
    dot = sum((p[0] - px) * (q[0] - qx) + (p[1] - py) * (q[1] - qy) for p, q in zip(points, onto))
    cross = sum((p[0] - px) * (q[1] - qy) - (p[1] - py) * (q[0] - qx) for p, q in zip(points, onto))
    if math.hypot(dot, cross) > 1e-4 * n:
        turn_deg = math.degrees(math.atan2(cross, dot))
    x_m, y_m = Move(turn_deg=turn_deg).place(px, py)
    return Move(qx - x_m, qy - y_m, direction_deg(turn_deg))


def moved_map(btm: BtmMap, move: Move) -> BtmMap:
    """Transform the map to another frame."""
    return _mapped(btm, move.place, lambda bearing_deg: bearing_deg + move.turn_deg)


def mirrored(btm: BtmMap) -> BtmMap:
    """Mirror the map at its y axis: links go round nodes the other way."""
    return _mapped(btm, lambda x_m, y_m: (-x_m, y_m), lambda bearing_deg: 180.0 - bearing_deg)


def _mapped(btm, place, bearing):
    def turned(link):
        ends = {"start_bearing_deg": link.start_bearing_deg, "end_bearing_deg": link.end_bearing_deg}
        own = {name: direction_deg(bearing(end)) for name, end in ends.items() if end is not None}
        return dataclasses.replace(link, **own)

    places = (dict(zip(("x_m", "y_m"), place(node.x_m, node.y_m))) for node in btm.nodes)
    nodes = (dataclasses.replace(node, **own) for node, own in zip(btm.nodes, places))
    return BtmMap(tuple(nodes), tuple(map(turned, btm.links)), btm.attributes)
