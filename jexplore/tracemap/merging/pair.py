"""Two maps by their places and the ways between them: which look alike, and walks through both along the same ways.

A place is a node that robots recognise; terminal nodes, which lie where a run began or ended, are stops on a way.
Likeness is computed for all places of one type and number of ways at a time.
"""

import dataclasses
import itertools
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


@dataclasses.dataclass(frozen=True, eq=False)
class _Table:
    """N places with n ways and M with m, of one type and obstacle, each entered by every one of its ways."""

    lost: np.ndarray  # `[N, n, M, m]` int16, see `Likeness`; -1 where they do not look alike
    turn_deg: np.ndarray  # `[N, n, M, m]` float64, see `Likeness`
    ways: np.ndarray
    """`[N, n, M, m, min(n, m)]` int32, ways that leave alike, the nearest first, as way * m + way; -1 for none."""


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

    def __init__(self, one: Places, other: Places, limits: Limits) -> None:
        self.one, self.other, self.limits = one, other, limits
        self._kinds = {part: _kinds_of(part) for part in (one, other)}
        self._rows = {  # map -> place -> its kind and its row in tables of that kind
            part: {a: (kind, row) for kind, own in kinds.items() for row, a in enumerate(own)}
            for part, kinds in self._kinds.items()
        }
        self._tables: dict[tuple, _Table | None] = {}

    def lost(self, a: int, b: int) -> list[list[int]]:
        """Return how many ways only one of two places has, by the ways they are entered by; -1 where they differ."""
        table, row, column = self._found(a, b)
        shape = len(self.one.ways[a]), len(self.other.ways[b])
        return table.lost[row, :, column].tolist() if table else [[-1] * shape[1]] * shape[0]

    def counts(self, a: int, i: int) -> list[int]:
        """Count the ends of ways of both maps that look like one of the first map, by the number of ways lost.

        Those of its own place do not count.
        """
        (kind, row), found = self._rows[self.one][a], np.zeros(self.limits.lost + 1, np.int64)
        for part in (self.one, self.other):
            for other_kind in self._kinds[part]:
                if table := self._table(kind, part, other_kind):
                    lost = table.lost[row, i]
                    lost = np.delete(lost, row, axis=0) if part is self.one and kind == other_kind else lost
                    found += np.bincount(lost[lost >= 0], minlength=len(found))
        return found.tolist()

    def likeness(self, a: int, i: int, b: int, j: int) -> Likeness | None:
        """Compare two places, each entered by one of its ways; None if they do not look alike."""
        table, row, column = self._found(a, b)
        if table is None or table.lost[row, i, column, j] < 0:
            return None
        n, at = len(self.other.ways[b]), (row, i, column, j)
        ways = tuple(divmod(both, n) for both in table.ways[at].tolist() if both >= 0)
        return Likeness(float(table.turn_deg[at]), ways, int(table.lost[at]))

    def _found(self, a, b):
        """Return the table of two places, None where they cannot look alike, and their indices in it."""
        (kind, row), (other_kind, column) = self._rows[self.one][a], self._rows[self.other][b]
        return self._table(kind, self.other, other_kind), row, column

    def _table(self, kind, part, other_kind):
        """Compare the places of a kind of the first map with those of a kind of either map, once."""
        key, most_lost = (kind, part, other_kind), self.limits.lost
        if key not in self._tables:
            n, m = kind[2], other_kind[2]
            is_possible = kind[:2] == other_kind[:2] and abs(n - m) <= most_lost and n * m
            first = _bearings(self.one, self._kinds[self.one][kind])
            second = _bearings(part, self._kinds[part][other_kind])
            self._tables[key] = _compared(first, second, self.limits.angle_deg, most_lost) if is_possible else None
        return self._tables[key]

    def guesses(self) -> Iterator[Guess]:
        """Yield all guesses, each once: from every pair of places that look alike, in every turn."""
        seen = set()
        for a, b in itertools.product(self.one.ways, self.other.ways):
            for i, row in enumerate(self.lost(a, b)):
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
        alike = self.likeness(a, i, b, j)
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
    """Return the places of a map by `(type, obstacle, number of ways)`."""
    kinds: dict[tuple, list[int]] = {}
    for a, node in part.nodes.items():
        kinds.setdefault((node.type, node.obstacle, len(part.ways[a])), []).append(a)
    return kinds


def _bearings(part, places):
    return np.array([[way.bearing_deg for way in part.ways[a]] for a in places])


def _compared(first, second, angle_deg, most_lost):
    """Return the `_Table` of places with these bearings, `[N, n]` and `[M, m]`."""
    n, m = first.shape[1], second.shape[1]
    shape = len(first), n, len(second), m
    lost, turn_deg = np.full(shape, -1, np.int16), np.empty(shape)
    ways = np.full((*shape, min(n, m)), -1, np.int32)
    need, flat = -(-(n + m - most_lost) // 2), (lost.reshape(-1), turn_deg.reshape(-1), ways.reshape(-1, min(n, m)))
    step = max(MAX_ANGLES // (n * m), 1)
    for begin in range(0, lost.size, step):
        here = np.arange(begin, min(begin + step, lost.size))
        a, i, b, j = np.unravel_index(here, shape)
        turn = apart_deg(first[a, i], second[b, j])
        off = apart_deg(first[a][:, :, None], second[b][:, None] + turn[:, None, None])
        off[(np.arange(n) == i[:, None])[:, :, None] != (np.arange(m) == j[:, None])[:, None]] = np.inf
        near = np.abs(off) <= 2 * angle_deg
        may = (near.any(axis=2).sum(axis=1) >= need) & (near.any(axis=1).sum(axis=1) >= need)
        here, i, j, turn = here[may], i[may], j[may], turn[may]
        found, middle = _matched(off[may], angle_deg)
        own = n + m - 2 * (found >= 0).sum(axis=1)
        alike = (found == (i * m + j)[:, None]).any(axis=1) & (own <= most_lost)
        here = here[alike]
        flat[0][here], flat[1][here], flat[2][here] = own[alike], apart_deg(turn + middle, 0.0)[alike], found[alike]
    return _Table(lost, turn_deg, ways)


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
