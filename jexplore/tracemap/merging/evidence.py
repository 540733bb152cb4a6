"""Evidence for a guess about two maps: log likelihood of one place against two that look alike."""

import math
from collections.abc import Callable, Iterable

from jexplore.tracemap.merging.pair import Guess, Pair

PRIOR = 4.0  # prior beliefs about buildings weigh as much as this many nodes or links of the two maps
ALIKE_CHANCE = 0.15  # chance that two places look alike, in buildings at large
LENGTH_M, SPREAD = 5.0, 0.7  # lengths of ways in buildings at large: median, standard deviation of the logarithm
WIDTH_M = 0.1  # standard deviation of a width between two maps
MAX_PASSAGE_M = 3.0  # widths of passages at large lie between 0 and this
INCLINATION_DEG = 1.0
STEEP_DEG = 30.0
STRAY = 0.1  # probability that a width or an inclination is an error of one map
LOST_LINK_NATS = 2.5  # nats: what a link takes away that only one map has at a node
MAX_SPREADS = 40.0  # standard deviations, as good as never
CONTRADICTION = 5.0  # nats: what a contradiction takes away


class Evidence:
    """Weights of guesses about two maps: a common corner says little where corners are many."""

    def __init__(self, pair: Pair) -> None:
        self.pair = pair
        both, limits = (pair.one, pair.other), pair.limits
        self._noise2, self._scale2 = (limits.length_m / 2) ** 2 + 1e-6, limits.length_share**2 * 2 / 3
        ends = [(a, i, way) for part in both for a, own in part.ways.items() for i, way in enumerate(own)]
        ways = [way for a, i, way in ends if way.is_whole and (a, i) < (way.end, way.back)]  # each once
        self._ends = len(ends)
        self._long = _Usual([way.length_m for way in ways], self._as_long)
        slopes = [node.inclination_deg for part in both for node in part.nodes.values()]
        self._wide = _Usual([way.width_m for way in ways], lambda one, other: _bell(one - other, WIDTH_M))
        self._open = _Usual([way.opening_m for *_, way in ends], self._wide.bell)
        self._steep = _Usual(slopes, lambda one, other: _bell(one - other, INCLINATION_DEG))

    @property
    def tries(self) -> float:
        """Return the logarithm of the number of ways to lay one map on the other."""
        first = sum(map(len, self.pair.one.ways.values()))
        return math.log(max(first * len(self.pair.other.ways), 1))

    def gain(self, guess: Guess) -> float:
        """Return the log likelihood ratio, nats: nodes, lengths, widths, inclinations, less contradictions."""
        whole = [(way, match) for way, match in guess.ways if way.is_whole and match.is_whole]
        total = sum(self._node(*entry) for entry in guess.entries) + self._lengths(whole)
        measured = set()
        for a, b in guess.places.items():
            for m, n in guess.alike[a].ways:
                way, match = self.pair.one.ways[a][m], self.pair.other.ways[b][n]
                if way.opening_m is not None and match.opening_m is not None:
                    measured.add(id(way.steps[0][0]))
                    total += _ratio(way.opening_m, match.opening_m, self._open, MAX_PASSAGE_M)
        for way, match in whole:
            if not {id(way.steps[0][0]), id(way.steps[-1][0])} & measured:  # a passage is as wide as its opening
                total += _ratio(way.width_m, match.width_m, self._wide, MAX_PASSAGE_M)
        for a, b in guess.places.items():
            one, other = self.pair.one.nodes[a].inclination_deg, self.pair.other.nodes[b].inclination_deg
            total += _ratio(one, other, self._steep, STEEP_DEG)
        return total - CONTRADICTION * len(guess.contradictions)

    def _node(self, a, i, b, j):
        """Return the evidence of a node that looks alike, by how many others would as well."""
        lost = self.pair.alike[a, i, b, j].lost
        alike = self.pair.others_alike(a, i, b, lost)
        others = self._ends - len(self.pair.one.ways[a]) - len(self.pair.other.ways[b])
        return -math.log((PRIOR * ALIKE_CHANCE + alike) / (PRIOR + others)) - LOST_LINK_NATS * lost

    def _as_long(self, length, other):
        return _bell(length - other, math.sqrt(self._noise2 + self._scale2 * other**2))

    def _lengths(self, pairs):
        """Return the evidence of lengths, all wrong by one unknown factor and each by a small error."""
        noise2, scale2 = self._noise2, self._scale2
        off = [match.length_m - way.length_m for way, match in pairs]
        square = sum(way.length_m**2 for way, _ in pairs) / noise2 * scale2
        along = sum(way.length_m * one for (way, _), one in zip(pairs, off)) / noise2
        misfit = sum(one * one for one in off) / noise2 - along**2 * scale2 / (1 + square)
        total = -0.5 * (misfit + len(pairs) * math.log(2 * math.pi * noise2) + math.log1p(square))
        for way, match in pairs:
            about = math.log(max(match.length_m, 0.1) / LENGTH_M) / SPREAD
            at_large = math.exp(-0.5 * about**2) / (max(match.length_m, 0.1) * SPREAD * math.sqrt(2 * math.pi))
            total -= math.log(self._long.density(match.length_m, way.length_m, at_large))
        return total


class _Usual:
    """Frequency of a value in both maps and in buildings at large."""

    def __init__(self, values: Iterable[float | None], bell: Callable[[float, float], float]) -> None:
        self._values, self.bell, self._sums = [value for value in values if value is not None], bell, {}

    def density(self, value: float, match: float, at_large: float) -> float:
        """Return the density of a value, without counting it and the matched one."""
        if value not in self._sums:
            self._sums[value] = sum(self.bell(value, other) for other in self._values)
        others = max(self._sums[value] - self.bell(value, value) - self.bell(value, match), 0.0)
        return (PRIOR * at_large + others) / (PRIOR + len(self._values) - 2)


def _ratio(one, other, usual: _Usual, span):
    """Return the evidence of two values that should be equal; 0 if one is unknown."""
    if one is None or other is None:
        return 0.0
    return math.log((1 - STRAY) * usual.bell(other, one) / usual.density(other, one, 1 / span) + STRAY)


def _bell(off, spread):
    off = min(abs(off / spread), MAX_SPREADS)
    return math.exp(-0.5 * off * off) / (spread * math.sqrt(2 * math.pi))
