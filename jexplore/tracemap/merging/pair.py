"""Two maps by their places and the ways between them: which look alike, and walks through both along the same ways.

A place is a node that robots recognise; terminal nodes, which lie where a run began or ended, are stops on a way.
Likeness is computed for all places of one type and number of ways at a time.
"""

import collections
import dataclasses
import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from jexplore.tracemap.merging.limits import Limits
from jexplore.tracemap.merging.rigid import apart_deg
from jexplore.tracemap.record import NOWHERE, BtmMap, Link, Node, length_of

MAX_ANGLES = 2**20  # that are compared at a time: 8 MiB each array


@dataclasses.dataclass(frozen=True, eq=False)
class PlaceWay:
    """Exit of a place, with the way as far as it has been followed."""

    bearing_deg: float  # direction in which it leaves
    steps: tuple[tuple[Link, bool], ...]  # its links in order, and whether they start where one comes from
    stops: tuple[tuple[int, float], ...]  # terminal nodes on it: id, and how far from the place, metres
    end: int  # place that it leads to; `NOWHERE` where that is not known
    back: int  # index of the way back at that place; -1 without an end
    length_m: float  # as far as it has been followed

    @property
    def is_whole(self) -> bool:
        """Return whether it has been followed to another place."""
        return self.end != NOWHERE

    @property
    def opening_m(self) -> float | None:
        """Return the width of the opening; None if unknown, as where the robot came in."""
        link, forward = self.steps[0]
        return link.opening_m if forward else None

    @property
    def width_m(self) -> float | None:
        """Return the narrowest passage; None if unknown."""
        return least_known(link.min_width_m for link, _ in self.steps)


@dataclasses.dataclass(frozen=True, eq=False)
class Places:
    """A map seen so: nodes by id, and their ways counter-clockwise."""

    nodes: Mapping[int, Node]
    ways: Mapping[int, tuple[PlaceWay, ...]]


def least_known(values: Iterable[float | None]) -> float | None:
    """Return the least known value; None if no value is known."""
    return min((value for value in values if value is not None), default=None)


def most_known(values: Iterable[float | None]) -> float | None:
    """Return the greatest known value; None if no value is known."""
    return max((value for value in values if value is not None), default=None)


def places_of(btm: BtmMap) -> Places:
    """Return the places of a proper map. A link without a length is as long as its nodes are apart."""
    around, nodes = btm.ends, {node.id: node for node in btm.nodes}
    kept = {key: node for key, node in nodes.items() if node.type != "terminal" or len(around[key]) > 2}
    index = {end[1:3]: (key, i) for key in kept for i, end in enumerate(around[key])}
    ways = {key: tuple(_way(end, nodes, around, index) for end in around[key]) for key in kept}
    return Places(kept, ways)


def _way(first, nodes, around, index):
    bearing, _, side, link = first
    steps, stops, length = [], [], 0.0
    end, back = NOWHERE, -1
    while True:
        steps.append((link, side == 0))
        if link.end == NOWHERE:
            break
        length += length_of(link, nodes)
        here = link.start if side else link.end
        if (link.id, 1 - side) in index:
            end, back = index[link.id, 1 - side]
            break
        stops.append((here, length))
        rest = [other for other in around[here] if other[1:3] != (link.id, 1 - side)]
        if not rest:
            break
        _, _, side, link = rest[0]
    return PlaceWay(bearing, tuple(steps), tuple(stops), end, back, length)


@dataclasses.dataclass(frozen=True, slots=True)
class Likeness:
    """Correspondence of two places that look alike."""

    turn_deg: float  # direction in the first map less direction in the second, there, degrees
    ways: tuple[tuple[int, int], ...]  # ways of the first and of the second that leave alike
    lost: int  # ways that only one of them has


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
    """Two maps, and the walks through them.

    Places look alike that have one type and obstacle and ways that leave at the same angles. A way that only one of
    them has, as where a robot took a niche for a passage, is lost; more than `Limits.lost` are too many.
    """

    alike: dict[tuple[int, int, int, int], Likeness]
    """Places that look alike, each entered by one of its ways: `(place, way, place, way)`, of the first map and of the
    second."""

    def __init__(self, one: Places, other: Places, limits: Limits) -> None:
        self.one, self.other, self.limits = one, other, limits
        self.alike = dict(_compared(one, other, limits))
        self._counts: collections.Counter[tuple[int, int, int]] = collections.Counter()
        own = (both for both in _compared(one, one, limits) if both[0][0] != both[0][2])
        for (a, i, *_), alike in itertools.chain(self.alike.items(), own):
            self._counts.update((a, i, lost) for lost in range(alike.lost, limits.lost + 1))

    def others_alike(self, a: int, i: int, b: int, lost: int) -> int:
        """Count the ends of ways of other places of both maps that look like one with at most `lost` ways lost."""
        there = (self.alike.get((a, i, b, j)) for j in range(len(self.other.ways[b])))
        return self._counts[a, i, lost] - sum(alike is not None and alike.lost <= lost for alike in there)

    def guesses(self) -> Iterator[Guess]:
        """Yield all guesses, each once: from every pair of places that look alike, in every turn."""
        seen = set()
        for entry in sorted(self.alike):
            if entry not in seen:
                guess = self.grown(*entry)
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
        alike = self.alike.get((a, i, b, j))
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


def leaving_alike(
    ways: Sequence[PlaceWay], others: Sequence[PlaceWay], turn_deg: float, angle_deg: float
) -> tuple[tuple[tuple[int, int], ...], float]:
    """Return ways of two places that leave alike, with the second turned, and the turn that suits them best."""
    if not (ways and others):
        return (), apart_deg(turn_deg, 0.0)
    one, other = (np.array([way.bearing_deg for way in many]) for many in (ways, others))
    found, middle = _matched(apart_deg(one[:, None], other + turn_deg)[None], angle_deg)
    pairs = tuple(divmod(both, len(others)) for both in found[0].tolist() if both >= 0)
    return pairs, apart_deg(turn_deg + float(middle[0]), 0.0)


def _kinds_of(part):
    """Return the places of a map by `(type, obstacle, number of ways)`, and the bearings of these ways."""
    kinds: dict[tuple, list[int]] = {}
    for a, node in part.nodes.items():
        if part.ways[a]:
            kinds.setdefault((node.type, node.obstacle, len(part.ways[a])), []).append(a)
    return {
        kind: (own, np.array([[way.bearing_deg for way in part.ways[a]] for a in own])) for kind, own in kinds.items()
    }


def _compared(one: Places, other: Places, limits: Limits) -> Iterator[tuple[tuple[int, int, int, int], Likeness]]:
    """Compare the places of two maps, each entered by every one of its ways: yield those that look alike."""
    for (kind, (own, first)), (match, (others, second)) in itertools.product(
        _kinds_of(one).items(), _kinds_of(other).items()
    ):
        n, m = first.shape[1], second.shape[1]
        if kind[:2] != match[:2] or abs(n - m) > limits.lost:
            continue
        shape, step = (len(own), n, len(others), m), max(MAX_ANGLES // (n * m), 1)
        need = -(-(n + m - limits.lost) // 2)
        for begin in range(0, math.prod(shape), step):
            a, i, b, j = np.unravel_index(np.arange(begin, min(begin + step, math.prod(shape))), shape)
            turn = apart_deg(first[a, i], second[b, j])
            off = apart_deg(first[a][:, :, None], second[b][:, None] + turn[:, None, None])
            off[(np.arange(n) == i[:, None])[:, :, None] != (np.arange(m) == j[:, None])[:, None]] = np.inf
            near = np.abs(off) <= 2 * limits.angle_deg
            may = (near.any(axis=2).sum(axis=1) >= need) & (near.any(axis=1).sum(axis=1) >= need)
            a, i, b, j, turn = (each[may] for each in (a, i, b, j, turn))
            found, middle = _matched(off[may], limits.angle_deg)
            lost, turn = n + m - 2 * (found >= 0).sum(axis=1), apart_deg(turn + middle, 0.0)
            for k in np.flatnonzero((found == (i * m + j)[:, None]).any(axis=1) & (lost <= limits.lost)).tolist():
                ways = tuple(divmod(both, m) for both in found[k].tolist() if both >= 0)
                at = own[a[k]], int(i[k]), others[b[k]], int(j[k])
                yield at, Likeness(float(turn[k]), ways, int(lost[k]))


def _matched(off_deg, angle_deg):
    """Match ways that leave alike, the nearest first, by `[K, n, m]`, how far each leaves from each; inf for never.

    Return `[K, min(n, m)]` int, the pairs as way * m + way, -1 in no place in particular; `[K]` their mean, degrees.
    """
    k, n, m = off_deg.shape
    off_deg, rows = off_deg.reshape(k, n * m), np.arange(k)
    size = np.abs(off_deg)
    order = np.argsort(size, axis=1, kind="stable")
    pairs, offs = np.full((k, min(n, m)), -1), np.full((k, min(n, m)), np.inf)
    free, other_free = np.ones((k, n), bool), np.ones((k, m), bool)
    count, total = np.zeros(k, int), np.zeros(k)
    for near in order[:, : (size <= 2 * angle_deg).sum(axis=1).max(initial=0)].T:
        p, q = near // m, near % m
        now = (size[rows, near] <= 2 * angle_deg) & free[rows, p] & other_free[rows, q]
        at, p, q, near = rows[now], p[now], q[now], near[now]
        free[at, p] = other_free[at, q] = False
        pairs[at, count[at]], offs[at, count[at]] = near, off_deg[at, near]
        total[at] += off_deg[at, near]
        count[at] += 1
    middle = total / np.maximum(count, 1)
    return np.where(np.abs(offs - middle[:, None]) <= angle_deg, pairs, -1), middle
