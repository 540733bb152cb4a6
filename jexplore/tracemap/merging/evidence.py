"""What a guess about two maps is worth: how much likelier they are as maps of one place than of two that look alike."""

import math
from collections.abc import Sequence

from jexplore.tracemap.merging.walk import Guess, Pair
from jexplore.tracemap.merging.ways import Places, Way

PRIOR = 4.0  # what is believed about buildings counts as much as so many nodes or links of the two maps
ALIKE = 0.15  # chance that two places look alike, in buildings at large
LENGTH_M, SPREAD = 5.0, 0.7  # lengths of ways in buildings at large: median, standard deviation of the logarithm
WIDTH_M = 0.1  # standard deviation of a width between two maps
WIDE_M = 3.0  # widths of passages at large lie between 0 and this
INCLINATION_DEG = 1.0
STEEP_DEG = 30.0
STRAY = 0.1  # chance that a width or an inclination is one map's mistake
LOST = 2.5  # nats: what a link takes away that only one map has at a node
FAR = 40.0  # standard deviations, as good as never
CONTRADICTION = 5.0  # nats: what a contradiction takes away


class Evidence:
    """Weighs guesses about two maps by what is common in them: a corner says little where there are many."""

    def __init__(self, pair: Pair) -> None:
        self.pair = pair
        self._darts = [
            (part, a, i) for part in (pair.one, pair.other) for a in part.ways for i in range(len(part.ways[a]))
        ]
        self._ways = [way for part in (pair.one, pair.other) for way in whole_ways(part)]
        self._openings = [part.ways[a][i].opening_m for part, a, i in self._darts]
        self._inclined = [n.inclination_deg for part in (pair.one, pair.other) for n in part.nodes.values()]
        self._cache = {}

    @property
    def tries(self) -> float:
        """Logarithm of how many ways there are to lay one map on the other."""
        first = sum(part is self.pair.one for part, _, _ in self._darts)
        return math.log(max(first * len(self.pair.other.ways), 1))

    def gain(self, guess: Guess) -> float:
        """Logarithm of the likelihood ratio, nats: nodes, lengths, widths, inclinations, less contradictions."""
        whole = [(way, match) for way, match in guess.ways if way.is_whole and match.is_whole]
        total = sum(self._node(*entry) for entry in guess.entries) + self._lengths(whole)
        measured = set()
        for a, b in guess.places.items():
            for m, n in guess.alike[a].ways:
                way, match = self.pair.one.ways[a][m], self.pair.other.ways[b][n]
                if way.opening_m is not None and match.opening_m is not None:
                    measured.add(id(way.steps[0][0]))
                    others = _without(self._openings, way.opening_m, match.opening_m)
                    total += _ratio(way.opening_m, match.opening_m, WIDTH_M, WIDE_M, others)
        for way, match in whole:
            if not {id(way.steps[0][0]), id(way.steps[-1][0])} & measured:  # a passage is as wide as its opening
                others = [one.width_m for one in self._other_ways(way, match)]
                total += _ratio(way.width_m, match.width_m, WIDTH_M, WIDE_M, others)
        for a, b in guess.places.items():
            one, other = self.pair.one.nodes[a].inclination_deg, self.pair.other.nodes[b].inclination_deg
            total += _ratio(one, other, INCLINATION_DEG, STEEP_DEG, _without(self._inclined, one, other))
        return total - CONTRADICTION * len(guess.contradictions)

    def _node(self, a, i, b, j):
        """A node that looks alike, by how many others would as well."""
        if (a, i, b, j) not in self._cache:
            pair = self.pair
            others = [dart for dart in self._darts if dart[:2] not in ((pair.one, a), (pair.other, b))]
            likeness = pair.alike((pair.one, a, i), (pair.other, b, j))
            lost = likeness.lost if likeness else 0
            found = [pair.alike((pair.one, a, i), dart) for dart in others]
            alike = sum(one is not None and one.lost <= lost for one in found)
            self._cache[a, i, b, j] = -math.log((PRIOR * ALIKE + alike) / (PRIOR + len(others))) - LOST * lost
        return self._cache[a, i, b, j]

    def _other_ways(self, way, match):
        own = {id(link) for link, _ in (*way.steps, *match.steps)}
        return [one for one in self._ways if id(one.steps[0][0]) not in own]

    def _lengths(self, pairs):
        """Lengths, all wrong by one factor that is not known and each a little besides."""
        limits = self.pair.limits
        noise2, scale2 = (limits.length_m / 2) ** 2 + 1e-6, limits.length_share**2 * 2 / 3
        off = [match.length_m - way.length_m for way, match in pairs]
        square = sum(way.length_m**2 for way, _ in pairs) / noise2 * scale2
        along = sum(way.length_m * one for (way, _), one in zip(pairs, off)) / noise2
        misfit = sum(one * one for one in off) / noise2 - along**2 * scale2 / (1 + square)
        total = -0.5 * (misfit + len(pairs) * math.log(2 * math.pi * noise2) + math.log1p(square))
        for way, match in pairs:
            others = [one.length_m for one in self._other_ways(way, match)]
            total -= math.log(_usual(match.length_m, others, noise2, scale2))
        return total


def whole_ways(part: Places) -> list[Way]:
    """Ways between places, each once."""
    found = []
    for a, ways in part.ways.items():
        found += [way for i, way in enumerate(ways) if way.is_whole and (a, i) < (way.end, way.back)]
    return found


def _usual(length, others, noise2, scale2):
    """Density of lengths in buildings like these."""
    about = math.log(max(length, 0.1) / LENGTH_M) / SPREAD
    total = PRIOR * math.exp(-0.5 * about**2) / (max(length, 0.1) * SPREAD * math.sqrt(2 * math.pi))
    for other in others:
        total += _bell(length - other, math.sqrt(noise2 + scale2 * other**2))
    return total / (PRIOR + len(others))


def _ratio(one, other, spread, span, others: Sequence[float | None]):
    """What two values are worth that should be equal; nothing where one is not known."""
    if one is None or other is None:
        return 0.0
    known = [value for value in others if value is not None]
    usual = (PRIOR / span + sum(_bell(other - value, spread) for value in known)) / (PRIOR + len(known))
    return math.log((1 - STRAY) * _bell(other - one, spread) / usual + STRAY)


def _without(values, *taken):
    left = list(values)
    for value in taken:
        left.remove(value)
    return left


def _bell(off, spread):
    off = min(abs(off / spread), FAR)
    return math.exp(-0.5 * off * off) / (spread * math.sqrt(2 * math.pi))
