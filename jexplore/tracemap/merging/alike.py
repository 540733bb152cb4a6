"""Likeness of the places of two maps, computed for many pairs at a time."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from jexplore.tracemap.merging.rigid import apart_deg
from jexplore.tracemap.merging.ways import Places, PlaceWay

MAX_ANGLES = 2**20  # that are compared at a time: 8 MiB each array


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


class Likenesses:
    """Likeness of places of maps: of one type and obstacle, with ways that leave at the same angles.

    A way that only one of them has, as where a robot took a niche for a passage, is lost; more than `most_lost` are
    too many.
    """

    def __init__(self, angle_deg: float, most_lost: int) -> None:
        """Set the limits: difference of an angle between two maps, degrees; ways that only one of two places has."""
        self.angle_deg, self.most_lost = angle_deg, most_lost
        self._groups, self._tables = {}, {}

    def kinds(self, part: Places) -> dict[tuple, list[int]]:
        """Return the places of a map by `(type, obstacle, number of ways)`."""
        if part not in self._groups:
            groups: dict[tuple, list[int]] = {}
            for a, node in part.nodes.items():
                groups.setdefault((node.type, node.obstacle, len(part.ways[a])), []).append(a)
            at = {a: (kind, k) for kind, own in groups.items() for k, a in enumerate(own)}
            self._groups[part] = groups, at
        return self._groups[part][0]

    def lost(self, part: Places, a: int, other: Places, b: int) -> list[list[int]]:
        """Return how many ways only one of two places has, by the ways they are entered by; -1 where they differ."""
        table, k, m = self._found(part, a, other, b)
        n_ways = len(part.ways[a]), len(other.ways[b])
        return table.lost[k, :, m].tolist() if table else [[-1] * n_ways[1]] * n_ways[0]

    def counts(self, part: Places, a: int, i: int, other: Places) -> list[int]:
        """Count the ends of ways that look like one of a place, without its own, by the number of ways lost."""
        (kind, k), found = self._at(part, a), np.zeros(self.most_lost + 1, np.int64)
        for other_kind in self.kinds(other):
            table = self._table(part, kind, other, other_kind)
            if table:
                lost = table.lost[k, i]
                lost = np.delete(lost, k, axis=0) if part is other and kind == other_kind else lost
                found += np.bincount(lost[lost >= 0], minlength=len(found))
        return found.tolist()

    def likeness(self, part: Places, a: int, i: int, other: Places, b: int, j: int) -> Likeness | None:
        """Compare two places, each entered by one of its ways; None if they do not look alike."""
        table, k, m = self._found(part, a, other, b)
        if table is None or table.lost[k, i, m, j] < 0:
            return None
        n = len(other.ways[b])
        ways = tuple(divmod(both, n) for both in table.ways[k, i, m, j].tolist() if both >= 0)
        return Likeness(float(table.turn_deg[k, i, m, j]), ways, int(table.lost[k, i, m, j]))

    def _at(self, part, a):
        self.kinds(part)
        return self._groups[part][1][a]

    def _found(self, part, a, other, b):
        """Return the table of two places, None where they cannot look alike, and their indices in it."""
        (kind, k), (other_kind, m) = self._at(part, a), self._at(other, b)
        return self._table(part, kind, other, other_kind), k, m

    def _table(self, part, kind, other, other_kind):
        if kind[:2] != other_kind[:2] or abs(kind[2] - other_kind[2]) > self.most_lost or not kind[2] * other_kind[2]:
            return None
        key = part, kind, other, other_kind
        if key not in self._tables:
            bearings = (_bearings(part, self.kinds(part)[kind]), _bearings(other, self.kinds(other)[other_kind]))
            self._tables[key] = _compared(*bearings, self.angle_deg, self.most_lost)
        return self._tables[key]


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
