"""Short walks in the rough: an order of witnesses, and for each a stop, one of a few places that see it.

How far the stops are apart is known, so that hundreds of orders can be tried a second: some witnesses are taken out and
put in again where they cost least, parts are turned round, and for an order the best stops are found exactly. What a
walk really costs in an order, with every place that sees a witness, `floor.Tour` says.
"""

import itertools
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from jexplore.studies.bounds.floor import Floor, edge_of

STOPS = 10  # of a witness, at most, to begin with
WORSE = 0.005  # by how much, relative, an order may become longer for a while
GONE = 10  # witnesses taken out at once, at most


class Stops:
    """Witnesses, places that see them, and how far these are apart."""

    inside: dict[int, np.ndarray]
    """Witness -> `[n]` bool, the floor's places that see it."""
    own: dict[int, np.ndarray]
    """Witness -> `[k]` int, numbers of its stops."""
    from_start: np.ndarray
    """`[K]` int64, costs from the start to each stop."""
    places: np.ndarray
    """`[K]` int, the floor's place of each stop."""

    def __init__(self, floor: Floor) -> None:
        self._floor = floor
        self.inside, self.own, self._number = {}, {}, {}
        self.from_start, self.places = np.zeros(0, np.int64), np.zeros(0, np.int64)
        self._apart = np.zeros((64, 64), np.int64)

    @property
    def apart(self) -> np.ndarray:
        """Return the costs between stops: `[K, K]` int64."""
        return self._apart[: len(self.places), : len(self.places)]

    def add(self, cell: int) -> None:
        """Add a witness with stops all along the edge of its region."""
        if cell in self.own:
            return
        region = self._floor.region(cell)
        edge = edge_of(self._floor, region)
        edge = edge if len(edge) else region
        self.inside[cell] = np.zeros(len(self._floor.cells), bool)
        self.inside[cell][region] = True
        rows, cols = self._floor.scene.cells(self._floor.cells[edge])
        chosen = [int(np.argmin(self._floor.from_start[edge]))]
        away = np.full(len(edge), np.iinfo(np.int64).max)
        while len(chosen) < STOPS:  # the farthest from those that there are
            away = np.minimum(away, np.maximum(np.abs(rows - rows[chosen[-1]]), np.abs(cols - cols[chosen[-1]])))
            if away.max() <= 1:
                break
            chosen.append(int(np.argmax(away)))
        self.own[cell] = np.array([self._stop(int(edge[i])) for i in chosen])

    def touch(self, cell: int, place: int) -> None:
        """Give a witness one more stop."""
        stop = self._stop(place)
        if stop not in self.own[cell]:
            self.own[cell] = np.append(self.own[cell], stop)

    def _stop(self, place):
        """Return the number of the stop at a place, new or not."""
        if place not in self._number:
            away, n = self._floor.away_from(np.array([place]))[self.places], len(self.places)
            if n == len(self._apart):
                self._apart = np.pad(self._apart, (0, n))
            self._apart[n, :n] = self._apart[:n, n] = away
            self.from_start = np.append(self.from_start, self._floor.from_start[place])
            self.places = np.append(self.places, place)
            self._number[place] = n
        return self._number[place]


class StopOrder:
    """Witnesses in an order, a stop for each."""

    def __init__(self, stops: Stops, pairs: Iterable[tuple[int, int]] = ()) -> None:
        self._stops, self.pairs = stops, list(pairs)

    @property
    def witnesses(self) -> list[int]:
        return [cell for cell, _ in self.pairs]

    def _numbers(self):
        return np.array([stop for _, stop in self.pairs], int)

    def _legs(self):
        """Return costs from the start to the first stop, from there to the second, ...: `[n]` int64."""
        numbers = self._numbers()
        between = self._stops.apart[numbers[:-1], numbers[1:]]
        return np.concatenate([self._stops.from_start[numbers[:1]], between])

    @property
    def cost(self) -> int:
        """Return the cost of a walk from stop to stop."""
        return int(self._legs().sum())

    def insertion(self, cell: int, noise: np.ndarray | float = 1.0) -> tuple[int, int, int]:
        """Find where one more witness costs least, times `noise`: `(cost, place in the order, stop)`."""
        made, own, numbers = self._stops, self._stops.own[cell], self._numbers()
        there = np.flatnonzero(made.inside[cell][made.places[numbers]]) if len(numbers) else numbers
        if len(there):  # a stop that there is sees it
            return 0, int(there[0]) + 1, int(numbers[there[0]])
        way = made.apart[numbers[:, None], own]
        before = np.vstack([made.from_start[own][None], way])
        after = np.vstack([way, np.zeros((1, len(own)), np.int64)])
        extra = before + after - np.append(self._legs(), 0)[:, None]
        at, which = divmod(int(np.argmin(extra * noise)), len(own))
        return int(extra[at, which]), at, int(own[which])

    def insert(self, cell: int, noise: np.ndarray | float = 1.0) -> None:
        """Put a witness where it costs least."""
        _, at, stop = self.insertion(cell, noise)
        self.pairs.insert(at, (cell, stop))

    def settle(self) -> None:
        """Take the best stops for the order, and reverse parts while that makes it shorter."""
        self._best_stops()
        if self._turned():
            self._best_stops()

    def _best_stops(self):
        if not self.pairs:
            return
        made, apart, choices = self._stops, self._stops.apart, []
        for cell in self.witnesses:  # a stop of the one before may see it as well: then the robot stays
            own = made.own[cell]
            if choices:
                before = choices[-1]
                own = np.concatenate([own, before[made.inside[cell][made.places[before]]]])
            choices.append(own)
        cost, ways = made.from_start[choices[0]], []
        for before, now in itertools.pairwise(choices):
            through = cost[:, None] + apart[before[:, None], now]
            ways.append(np.argmin(through, axis=0))
            cost = through[ways[-1], np.arange(len(now))]
        which = [int(np.argmin(cost))]
        for way in ways[::-1]:
            which.append(int(way[which[-1]]))
        found = [int(own[i]) for own, i in zip(choices, which[::-1])]
        self.pairs = list(zip(self.witnesses, found))

    def _turned(self):
        """Reverse parts, the best one first; return whether any was."""
        turned, n = False, len(self.pairs)
        while n > 1:
            numbers, legs = self._numbers(), self._legs()
            apart = self._stops.apart[numbers[:, None], numbers]
            before = np.concatenate([self._stops.from_start[numbers][None], apart[:-1]])  # the last is to come first
            after = np.concatenate([apart[:, 1:], np.zeros((n, 1), np.int64)], axis=1)  # the first is to come last
            gain = np.triu(before + after - legs[:, None] - np.append(legs[1:], 0)[None], 1)
            first, last = divmod(int(np.argmin(gain)), n)
            if gain[first, last] >= 0:
                break
            self.pairs[first : last + 1] = self.pairs[first : last + 1][::-1]
            turned = True
        return turned


def new_order(stops: Stops, cells: Sequence[int]) -> StopOrder:
    """Build a `StopOrder` of witnesses that are put in one after the other."""
    order = StopOrder(stops)
    for cell in cells:
        order.insert(cell)
    order.settle()
    return order


def improved_order(
    order: StopOrder, rng: np.random.Generator, tries: int, most: int = GONE, over: Callable[[], bool] = lambda: False
) -> StopOrder:
    """Return a shorter order, found by taking out up to `most` witnesses and putting them in again, `tries` times."""
    best = now = order
    least = cost = best.cost
    for number in range(tries):
        if len(now.pairs) < 2 or (number % 8 == 7 and over()):
            break
        other = _renewed(now, rng, most)
        new = other.cost
        if other.witnesses == now.witnesses:
            continue
        if new < cost * (1 + WORSE / 2):
            other.settle()
            new = other.cost
        if new < cost or (new < cost * (1 + WORSE * (1 - number / tries)) and rng.random() < 0.5):
            now, cost = other, new
            if cost < least:
                best, least = now, cost
    return best


def _renewed(order, rng, most):
    """Remove some witnesses, neighbours in an order or on the map, and insert them again."""
    made, n = order._stops, len(order.pairs)
    first, size = int(rng.integers(n)), int(rng.integers(1, min(n, most) + 1))
    if rng.random() < 0.5:
        gone = set(range(first, min(n, first + size)))
    else:
        numbers = order._numbers()
        gone = set(np.argsort(made.apart[numbers[first], numbers], kind="stable")[:size].tolist())
    cells = [order.pairs[i][0] for i in sorted(gone)]
    other = StopOrder(made, (pair for i, pair in enumerate(order.pairs) if i not in gone))
    if rng.random() < 0.33:  # the farthest from the start first, else in any order
        cells.sort(key=lambda cell: -int(made.from_start[made.own[cell]].min()))
    else:
        cells = [cells[i] for i in rng.permutation(len(cells))]
    noisy = rng.random() < 0.3
    for cell in cells:
        shape = len(other.pairs) + 1, len(made.own[cell])
        other.insert(cell, 1 + 0.1 * rng.random(shape) if noisy else 1.0)
    return other


def telling(
    stops: Stops, cells: Sequence[int], most: int, rng: np.random.Generator, over: Callable[[], bool]
) -> list[int]:
    """Choose up to `most` witnesses that together make a walk long, the most important first; fewer once `over`.

    Each next one makes the short walk that sees those before longest.
    """
    order, chosen, left = StopOrder(stops), [], list(cells)
    while left and len(chosen) < most and not over():
        left.sort(key=lambda cell: -order.insertion(cell)[0])
        tried = []
        for cell in left[:2]:
            grown = StopOrder(stops, order.pairs)
            grown.insert(cell)
            grown.settle()
            mixed = [*chosen, cell]
            fresh = new_order(stops, [mixed[i] for i in rng.permutation(len(mixed))])
            pair = [improved_order(one, rng, 10, 6) for one in (grown, fresh)]
            tried.append((cell, min(pair, key=lambda one: one.cost)))
        cell, order = max(tried, key=lambda one: one[1].cost)
        chosen.append(cell)
        left.remove(cell)
    return chosen
