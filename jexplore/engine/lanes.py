"""Runs in lockstep: L lanes that advance together, as an accelerator wants it.

No lane waits for the slowest. All lanes advance in every turn; those that must decide wait until there are enough of
them for a group, which is gathered and decides on its own; those whose run is done are measured, and filled again
from the queue, in groups as well. Results are written by their place in the queue.
"""

import math
from collections.abc import Callable, Iterable
from typing import Any, ClassVar, Self

import jax
import jax.numpy as jnp
from flax import struct
from jax import Array, lax

from jexplore.arrays.loops import first_lanes, put, put_together, take
from jexplore.engine import thoughts
from jexplore.engine.draws import random_key
from jexplore.engine.program import Given, Program, split

DECIDERS = 8  # one lane in so many decides at a time, and at most so large a share of the runs under way waits
STARTERS = 16  # one lane in so many is measured and started at a time
SPAN = 4  # turns between two looks at which lanes are to be filled, where deciding goes in pieces


@struct.dataclass
class Table:
    """J lines that share a compiled program."""

    scene: Array  # [J] int32, which of the M scenes
    seed: Array  # [J] uint32
    keeps: Array  # [J] int32, number of the run of which more than the result is kept
    slot: Array  # [J] int32, where that is kept; K where there is no such run
    slots: Array  # [K] int32, the line of each
    scalars: Any  # list of `[J]`, the scalars among the lines' numbers


@struct.dataclass
class Queue:
    """The runs to be made: N, of which the first `count` are real."""

    line: Array  # [N] int32
    number: Array  # [N] int32, number of the run in its line
    draw: Array  # [N] int32, with its line's seed it makes the run's key
    task: Any  # pytree of `[N, ...]`
    count: Array  # int32


@struct.dataclass
class Common:
    """What all lanes share."""

    table: Table
    shared: Any
    scenes: Any  # [M, ...]
    arrays: Any  # list, the arrays among the lines' numbers


@struct.dataclass
class Usage:
    """How much of the work was useful."""

    turns: Array  # int32
    advanced: Array  # int32, lanes that advanced in these turns
    groups: Array  # int32, groups that decided; in pieces, of a first glance, or without glances of slots
    decided: Array  # int32, lanes in these groups
    replace: ClassVar[Callable[..., Self]]


@struct.dataclass
class Lanes:
    """Lanes under way and what they have found."""

    at: Array  # [L] int32, place in the queue; -1: none
    state: Any  # [L, ...]
    next: Array  # int32, place in the queue of the next run to be started
    done: Array  # int32, runs that are done
    ended: Array  # [N] bool, runs that have a result
    results: Any  # [N, ...]
    kept: Any  # [K, ...], what is kept of one run of each line that has such a run
    thoughts: Any = ()  # `thoughts.Thoughts`, where deciding goes in pieces
    replace: ClassVar[Callable[..., Self]]


def enough(alive: Any) -> Any:
    """How many lanes must wait for a group to decide: an eighth of those that hold a run that is not done.

    Of all lanes would be too many: when the queue is empty and lanes fall empty, the rest would wait for each other.

    Args:
      alive: how many these are, int or array.
    """
    return -(-alive // DECIDERS)


class Engine:
    """The turns of the lanes of one program, all of it pure functions of arrays."""

    def __init__(self, program: Program, numbers: Any) -> None:
        """`numbers`: a line's, for what of them is an array."""
        self.program = program
        self.join: Callable[[Iterable[Any], Iterable[Any]], Any] = split(numbers)[2]

    def _given(self, common, queue, at, scalars, task):
        """`Given` of one lane."""
        line = queue.line[at]
        key = jax.random.fold_in(random_key(common.table.seed[line]), queue.draw[at])
        numbers = self.join(scalars, common.arrays)
        return Given(key, common.shared, common.scenes, common.table.scene[line], numbers, task)

    def _on_lanes(self, common, queue, at, function, *own):
        """`function(given, *own)` of some lanes, at `at` in the queue; what they share is not copied."""
        scalars, task = take(common.table.scalars, queue.line[at]), take(queue.task, at)

        def one(at, scalars, task, *own):
            return function(self._given(common, queue, at, scalars, task), *own)

        return jax.vmap(one)(at, scalars, task, *own)

    def _begin(self, given):
        return self.program.begin(self.program.setup, given)

    def _finish(self, given, state):
        return self.program.measure(given, state), self.program.keep(state)

    def empty(self, queue: Queue, common: Common, n_lanes: int) -> Lanes:
        """`Lanes` that have done nothing yet.

        Args:
          queue, common: `Queue`, `Common`.
          n_lanes: L. Static.
        """
        zero, pieces = jnp.int32(0), self.program.pieces

        def one():
            task = jax.tree.map(lambda a: a[0], queue.task)
            given = self._given(common, queue, zero, [a[0] for a in common.table.scalars], task)
            state, seen = self._begin(given), [()]
            if pieces is None:
                return state, *self._finish(given, state), (), ()
            for glance in pieces.glances:
                seen.append(glance(self.program.setup, given, state, seen[-1])[3])
            search = pieces.begin(self.program.setup, given, state, seen[-1])
            return state, *self._finish(given, state), search, tuple(seen[1:])

        def blank(tree, n):
            return jax.tree.map(lambda x: jnp.zeros((n, *x.shape), x.dtype), tree)

        state, result, kept, search, seen = jax.eval_shape(one)
        n = queue.line.shape[0]
        return Lanes(
            at=jnp.full((n_lanes,), -1, jnp.int32),
            state=blank(state, n_lanes),
            next=zero,
            done=zero,
            ended=jnp.zeros(n, bool),
            results=blank(result, n),
            kept=blank(kept, common.table.slots.shape[0]),
            thoughts=() if pieces is None else thoughts.blank(pieces, search, seen, n_lanes),
        )

    def lane_bytes(self, lanes: Lanes, shared: Any) -> int:
        """An estimate of what one lane needs on an accelerator, with its share of what deciding, starting and advancing
        need in between: one after the other, so that the most counts.

        Args:
          lanes: `Lanes`, or their shapes.
          shared: as in `Given`.
        """
        n_lanes = lanes.at.shape[0]
        own = _bytes(lanes.state) // n_lanes
        one = jax.tree.map(lambda a: jax.ShapeDtypeStruct(a.shape[1:], a.dtype), lanes.state)
        deciding, advancing = self.program.scratch(shared, one)
        groups = (own + deciding) // DECIDERS if self.program.decide is not None else 0
        if self.program.pieces is not None:  # searches, and once more what one piece makes of them
            search = _bytes(lanes.thoughts.searches) // lanes.thoughts.lane.shape[0]  # a lane has a share of a slot
            own += 2 * search // thoughts.seekers(len(self.program.pieces.glances))
            own += _bytes(lanes.thoughts.seen) // n_lanes
        return own + max(groups, 2 * own // STARTERS, advancing)

    def places(self, n_lanes: int) -> int:
        """Places in one of the groups that `Usage` counts."""
        pieces = self.program.pieces
        return -(-n_lanes // DECIDERS) if pieces is None else thoughts.sizes(n_lanes, len(pieces.glances)).counted

    def _done(self, lanes):
        return (lanes.at >= 0) & jax.vmap(self.program.is_done)(lanes.state)

    def _must_decide(self, lanes):
        if self.program.must_decide is None:
            return jnp.zeros(lanes.at.shape, bool)
        waits = jax.vmap(self.program.must_decide)(lanes.state)
        return (lanes.at >= 0) & waits & ~jax.vmap(self.program.is_done)(lanes.state)

    def _under_way(self, lanes):
        return (lanes.at >= 0) & jax.vmap(self.program.is_under_way)(lanes.state)

    def _measure(self, queue, common, lanes, m):
        """Writes the results of up to m lanes whose run is done, and frees the lanes."""
        n = queue.line.shape[0]
        which = first_lanes(self._done(lanes), m)
        real = which < lanes.at.shape[0]
        at = jnp.maximum(take(lanes.at, which), 0)
        result, kept = self._on_lanes(common, queue, at, self._finish, take(lanes.state, which))
        table, line = common.table, queue.line[at]
        slot = jnp.where(real & (queue.number[at] == table.keeps[line]), table.slot[line], table.slots.shape[0])
        at = jnp.where(real, at, n)
        return lanes.replace(
            at=put(lanes.at, which, jnp.full(m, -1, jnp.int32)),
            done=lanes.done + _count(real),
            ended=put(lanes.ended, at, jnp.ones(m, bool)),
            results=put(lanes.results, at, result),
            kept=put(lanes.kept, slot, kept),
        )

    def _start(self, queue, common, lanes, m):
        """Starts up to m runs in free lanes."""
        which = first_lanes(lanes.at < 0, m)
        at = lanes.next + lax.iota(jnp.int32, m)
        real = (which < lanes.at.shape[0]) & (at < queue.count)
        at = jnp.where(real, at, 0)
        state = self._on_lanes(common, queue, at, self._begin)
        which = jnp.where(real, which, lanes.at.shape[0])
        return lanes.replace(
            at=put(lanes.at, which, at),
            state=put(lanes.state, which, state),
            next=lanes.next + _count(real),
        )

    def _decide(self, queue, common, lanes, m):
        """Up to m lanes decide: `(lanes, how many)`."""
        which = first_lanes(self._must_decide(lanes), m)

        def decide(given, state):
            return True, self.program.decide(self.program.setup, given, state)

        return self._changed(queue, common, lanes, which, decide)[0], _count(which < lanes.at.shape[0])

    def _changed(self, queue, common, lanes, which, function, *own):
        """`(lanes, settled, more)`: some lanes as `function(given, state, *own)` makes them, which returns
        `(settled, state, *more)`, where it is settled. Arrays that it hands on are left where they are.
        """
        leaves, tree = jax.tree.flatten(lanes.state)
        changed, n = [], len(leaves)

        def change(given, *both):
            state, own = both[:n], both[n:]
            settled, new, *more = function(given, jax.tree.unflatten(tree, state), *own)
            new = jax.tree.leaves(new)
            changed[:] = [i for i, (a, b) in enumerate(zip(state, new)) if a is not b]
            return jnp.asarray(settled), [new[i] for i in changed], more

        at = jnp.maximum(take(lanes.at, which), 0)
        settled, new, more = self._on_lanes(common, queue, at, change, *take(leaves, which), *own)
        where = jnp.where(settled, which, lanes.at.shape[0])
        for i, leaf in zip(changed, put_together([leaves[i] for i in changed], where, new)):
            leaves[i] = leaf
        return lanes.replace(state=jax.tree.unflatten(tree, leaves)), settled, more

    def _written(self, lanes, which, notes):
        """With what some lanes have noted; what is beyond the last lane is nobody's, and no lane comes twice."""
        n = lanes.at.shape[0]
        which = jnp.where(which < n, which, n + lax.iota(jnp.int32, which.shape[0]))
        return lanes.replace(state=self.program.pieces.write(lanes.state, which, notes))

    def _glance(self, queue, common, lanes, i, m):
        """Up to m lanes are given glance i: `(lanes, how many)`."""
        which = first_lanes(self._must_decide(lanes) & (lanes.thoughts.stage == i), m)

        def glance(given, state, seen):
            return self.program.pieces.glances[i](self.program.setup, given, state, seen)

        before = thoughts.seen_before(lanes.thoughts, i, which)
        lanes, settled, (notes, seen) = self._changed(queue, common, lanes, which, glance, before)
        lanes = self._written(lanes, jnp.where(settled, which, lanes.at.size), notes)
        own = thoughts.glanced(lanes.thoughts, i, which, settled, seen)
        return lanes.replace(thoughts=own), _count(which < lanes.at.size)

    def _search(self, queue, common, lanes, m):
        """Up to m lanes get a slot, all searches go on, and up to m of them end: `(lanes, how many were taken)`."""
        pieces, setup, own = self.program.pieces, self.program.setup, lanes.thoughts
        slot, lane = thoughts.taken(own, self._must_decide(lanes) & (own.stage == len(pieces.glances)), m)
        at = jnp.maximum(take(lanes.at, lane), 0)
        with jax.named_scope("begin"):
            seen = thoughts.seen_before(own, len(pieces.glances), lane)
            new = self._on_lanes(
                common, queue, at, lambda given, *own: pieces.begin(setup, given, *own), take(lanes.state, lane), seen
            )
        own = own.replace(lane=put(own.lane, slot, lane), searches=put(own.searches, slot, new))
        n, (searches, notes) = _count(own.lane < lanes.at.size), jax.vmap(pieces.go_on)(own.searches)
        lanes, own = self._written(lanes, own.lane, notes), own.replace(searches=searches)
        slot, lane = thoughts.found(pieces, own, m)

        def conclude(given, state, search):
            return True, *pieces.conclude(setup, given, state, search)

        lanes, _, (notes,) = self._changed(queue, common, lanes, lane, conclude, take(own.searches, slot))
        lanes = self._written(lanes, lane, notes)
        return lanes.replace(thoughts=thoughts.given_back(own, slot, lane)), n

    def _think(self, queue, common, lanes, usage):
        """The deciding of a turn, in pieces: `(lanes, usage)`."""
        size, counts = thoughts.sizes(lanes.at.size, len(self.program.pieces.glances)), []
        for i, m in enumerate(size.glances):
            with jax.named_scope(f"glance{i}"):
                lanes, n = self._glance(queue, common, lanes, i, m)
            counts.append(n)
        with jax.named_scope("search"):
            lanes, n = self._search(queue, common, lanes, size.newcomers)
        return lanes, usage.replace(groups=usage.groups + 1, decided=usage.decided + (counts[0] if counts else n))

    def _advance(self, queue, common, lanes, under_way):
        """All lanes that are under way advance; small arrays of the others are kept, large ones are left alone."""

        def advance(given, state):
            return self.program.advance(self.program.setup, given, state)

        new = self._on_lanes(common, queue, jnp.maximum(lanes.at, 0), advance, lanes.state)

        def keep(new, old):
            mask = under_way.reshape(-1, *[1] * (new.ndim - 1))
            is_small = math.prod(new.shape[1:]) <= self.program.small
            return jnp.where(mask, new, old) if is_small else new

        return lanes.replace(state=jax.tree.map(keep, new, lanes.state))

    def go_on(self, lanes: Lanes, queue: Queue, turns: Array, common: Common) -> tuple[Lanes, Usage]:
        """Some turns, or as many as it takes until the queue is done.

        Args:
          lanes, queue, common: `Lanes`, `Queue`, `Common`.
          turns: int32.

        Returns:
          `(Lanes, Usage)`.
        """
        n_lanes = lanes.at.shape[0]
        deciders, starters = -(-n_lanes // DECIDERS), -(-n_lanes // STARTERS)

        def change(lanes):
            """Whether lanes are to be measured or started now: enough for a group, or nothing else to do."""
            free, left = _count(lanes.at < 0), queue.count - lanes.next
            done = self._done(lanes)
            ended, startable = _count(done), jnp.minimum(free, left)
            idle = ~jnp.any((lanes.at >= 0) & ~done)
            return (ended >= starters) | (startable >= starters) | (idle & ((ended > 0) | (startable > 0)))

        def changed(lanes):
            return self._start(queue, common, self._measure(queue, common, lanes, starters), starters)

        def must_decide(state):
            waiting, under_way = _count(self._must_decide(state[0])), _count(self._under_way(state[0]))
            return (waiting > 0) & (waiting >= enough(waiting + under_way))

        def decided(state):
            lanes, usage = state
            lanes, n = self._decide(queue, common, lanes, deciders)
            return lanes, usage.replace(groups=usage.groups + 1, decided=usage.decided + n)

        def fill(lanes):
            with jax.named_scope("fill"):
                return lax.while_loop(change, changed, lanes)

        def turn(state):
            lanes, usage = state
            with jax.named_scope("decide"):
                if self.program.pieces is not None:
                    lanes, usage = self._think(queue, common, lanes, usage)
                elif self.program.decide is not None:
                    lanes, usage = lax.while_loop(must_decide, decided, (lanes, usage))
            under_way = self._under_way(lanes)
            with jax.named_scope("advance"):
                lanes = self._advance(queue, common, lanes, under_way)
            return lanes, usage.replace(turns=usage.turns + 1, advanced=usage.advanced + _count(under_way))

        def turns_on(state):
            lanes, usage = state
            n = 1 if self.program.pieces is None else SPAN
            return lax.fori_loop(0, n, lambda _, state: turn(state), (fill(lanes), usage))

        def goes_on(state):
            lanes, usage = state
            return (usage.turns < turns) & (lanes.done < queue.count)

        zero = jnp.int32(0)
        return lax.while_loop(goes_on, turns_on, (lanes, Usage(turns=zero, advanced=zero, groups=zero, decided=zero)))


def _bytes(tree):
    return sum(math.prod(a.shape) * a.dtype.itemsize for a in jax.tree.leaves(tree))


def _count(mask):
    # A sum over lanes is one block of threads on an accelerator: what the mask is made from, and what else is, must not
    # become part of it.
    return jnp.sum(lax.optimization_barrier(mask), dtype=jnp.int32)
