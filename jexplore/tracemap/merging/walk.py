"""Walks through two maps at once: what else must be one place if this one is."""

import dataclasses
import itertools
from collections.abc import Iterator

from jexplore.tracemap.merging.alike import Likeness, Likenesses
from jexplore.tracemap.merging.limits import Limits
from jexplore.tracemap.merging.rigid import apart_deg
from jexplore.tracemap.merging.ways import Places, PlaceWay


@dataclasses.dataclass(slots=True)
class Guess:
    """Correspondence of places of two maps."""

    places: dict[int, int] = dataclasses.field(default_factory=dict)  # of the first map -> of the second
    others: dict[int, int] = dataclasses.field(default_factory=dict)  # of the second map -> of the first
    alike: dict[int, Likeness] = dataclasses.field(default_factory=dict)  # by places of the first map
    entries: list[tuple[int, int, int, int]] = dataclasses.field(default_factory=list)
    """Places in order, each with the way by which it was entered: `(place, way, place, way)`."""
    ways: list[tuple[PlaceWay, PlaceWay]] = dataclasses.field(default_factory=list)
    """Those that are the same, each told once, and seen from the same side."""
    contradictions: list[tuple[PlaceWay, PlaceWay]] = dataclasses.field(default_factory=list)
    """Ways that leave one place alike and go on otherwise."""


class Pair:
    """Two maps, and the walks through them."""

    def __init__(self, one: Places, other: Places, limits: Limits) -> None:
        self.one, self.other, self.limits = one, other, limits
        self.likenesses = Likenesses(limits.angle_deg, limits.lost)

    def guesses(self) -> Iterator[Guess]:
        """Yield all guesses, each once: from every pair of places that look alike, in every turn."""
        seen = set()
        for a, b in itertools.product(self.one.ways, self.other.ways):
            for i, row in enumerate(self.likenesses.lost(self.one, a, self.other, b)):
                for j, lost in enumerate(row):
                    if lost >= 0 and (a, i, b, j) not in seen:
                        guess = self.grown(a, i, b, j)
                        seen.update((p, m, q, n) for p, q in guess.places.items() for m, n in guess.alike[p].ways)
                        yield guess

    def grown(self, a: int, i: int, b: int, j: int) -> Guess:
        """Grow a guess from place a = place b, with way i of the one equal to way j of the other.

        Both maps are walked along the same ways. A way followed in one map only gives no evidence; two that end in
        different places contradict, and the walk stops there.

        Source:
          Huang and Beevers 2005, Topological map merging.
        """
        guess, told = Guess(), set()
        self._enter(guess, a, i, b, j)
        for a, _, b, _ in guess.entries:  # grows on the way
            for m, n in guess.alike[a].ways:
                if ((a, m), (b, n)) in told:
                    continue
                way, match = self.one.ways[a][m], self.other.ways[b][n]
                told |= {((a, m), (b, n)), ((way.end, way.back), (match.end, match.back))}
                is_same = self.lengths_agree(way, match) and self._goes_on(guess, a, way, match)
                (guess.ways if is_same else guess.contradictions).append((way, match))
        return guess

    def _enter(self, guess, a, i, b, j, turn_deg=0.0, limit_deg=180.0):
        """Match two places if they look alike, with the second turned by `turn_deg`; return whether they do."""
        alike = self.likenesses.likeness(self.one, a, i, self.other, b, j)
        if alike is None or abs(apart_deg(alike.turn_deg, turn_deg)) > limit_deg:
            return False
        guess.places[a], guess.others[b], guess.alike[a] = b, a, alike
        guess.entries.append((a, i, b, j))
        return True

    def lengths_agree(self, way: PlaceWay, match: PlaceWay) -> bool:
        """Return whether two ways may be equal in length. A way not followed to its end may be longer than recorded."""
        off, limit = way.length_m - match.length_m, self.limits.length(way.length_m, match.length_m)
        return (not way.is_whole or off >= -limit) and (not match.is_whole or off <= limit)

    def _goes_on(self, guess, a, way, match):
        """Enter the place at the end of two ways; return whether they may lead to the same one."""
        if not (way.is_whole and match.is_whole):
            return True
        p, q = way.end, match.end
        if p in guess.places or q in guess.others:
            return guess.places.get(p) == q and (way.back, match.back) in guess.alike[p].ways
        limit_deg = self.limits.turn(way.length_m)
        return self._enter(guess, p, way.back, q, match.back, guess.alike[a].turn_deg, limit_deg)
