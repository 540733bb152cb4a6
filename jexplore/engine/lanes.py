"""Runs of one program in lanes that advance together, as an accelerator wants it.

A `vmap` of lanes. In every turn those advance that are under way; those that must decide wait until they are an eighth
of all and then decide together. When enough runs are done they are measured and their lanes filled again.
"""

import functools
import math
import time
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jexplore.arrays.loops import SHARE, put, run_if, take
from jexplore.engine.devices import compiled, on_devices, parted, whole
from jexplore.engine.draws import random_key
from jexplore.engine.program import Given, Line, split

LANES = 4096  # most lanes on a device
CPU_LANES = 64  # on a CPU, which lanes are not made for
FILLED = 16  # one lane of this number is measured and filled at a time
MEMORY_SHARE = 0.8  # of the device's free memory that lanes may take
COPIES = 4  # of a lane's state that there may be at a time; an estimate
CALL_S = 1.0  # seconds that a call should take: how often progress moves, and how long Ctrl-C waits
FIRST_TURNS = 16  # turns of the first call; later ones follow the clock
GROWTH = 4  # by how much longer a call may be than the one before


class Runs(NamedTuple):
    """Inputs that differ between runs: of N runs, or of those in L lanes."""

    seed: Any  # [N] uint32
    draw: Any  # [N] int32, with the seed it makes the run's key
    scene: Any  # [N] int32, which of the M scenes
    scalars: Any  # list of `[N]`, the scalars among the numbers
    task: Any  # pytree of `[N, ...]`


class Lanes(NamedTuple):
    """L lanes."""

    runs: Runs
    busy: Array  # [L] bool, whether there is a run
    state: Any  # [L, ...]


class Group:
    """Lines of one kind on some devices: of one program, with equal `shared` and arrays."""

    def __init__(self, lines: Sequence[Line], devices: Sequence[Any]) -> None:
        self.lines, self.devices, self.program = lines, devices, lines[0].program
        scenes = {id(line.scene): line.scene for line in lines}
        self._place = {key: i for i, key in enumerate(scenes)}
        _, arrays, self._join = split(lines[0].numbers)
        stacked = jax.tree.map(lambda *a: np.stack(a), *scenes.values())
        self.common: Any = whole((lines[0].shared, stacked, arrays), devices)

    # ---- on a device: pure functions

    def _each(self, function, common, runs, *own):
        """Call `function(given, *own)` for some runs; their `common` data are not copied."""
        shared, scenes, arrays = common

        def one(run, *own):
            key = jax.random.fold_in(random_key(run.seed), run.draw)
            return function(Given(key, shared, scenes, run.scene, self._join(run.scalars, arrays), run.task), *own)

        return jax.vmap(one)(runs, *own)

    def _begun(self, common, runs):
        return self._each(functools.partial(self.program.begin, self.program.setup), common, runs)

    def _done(self, lanes):
        return lanes.busy & jax.vmap(self.program.is_done)(lanes.state)

    def empty(self, runs: Runs, common: Any, n_lanes: int) -> Lanes:
        """Return `n_lanes` `Lanes` without a run; `runs` gives shapes only."""
        shapes = runs, jax.eval_shape(self._begun, common, runs)
        runs, state = jax.tree.map(lambda a: jnp.zeros((n_lanes, *a.shape[1:]), a.dtype), shapes)
        return Lanes(runs, jnp.zeros(n_lanes, bool), state)

    def fill(self, lanes: Lanes, which: Array, runs: Runs, real: Array, common: Any) -> tuple[Lanes, Any]:
        """Measure the runs in lanes `which`, `[m]` int32, and begin `runs` there where they are `real`, `[m]` bool.

        Returns:
          `(lanes, found)`: of the m lanes what `Program.measure` and `keep` return; something where there is no run.
        """
        state = take(lanes.state, which)
        found = self._each(self.program.measure, common, take(lanes.runs, which), state)
        kept, begins = jax.vmap(self.program.keep)(state), jnp.where(real, which, lanes.busy.size)
        state = put(lanes.state, begins, self._begun(common, runs))
        return Lanes(put(lanes.runs, begins, runs), put(lanes.busy, which, real), state), (found, kept)

    def _turn(self, common, lanes):
        """Advance all lanes by a turn: `(lanes, how many advanced)`."""
        program, setup, state = self.program, self.program.setup, lanes.state
        if program.decide is not None:
            alive = lanes.busy & ~self._done(lanes)
            must_decide: Any = program.must_decide
            waits = alive & jax.vmap(must_decide)(state)
            waits &= SHARE * _count(waits) >= _count(alive)

            def decide(given, state, waits):
                return run_if(waits, functools.partial(program.decide, setup, given), state)

            state = self._each(decide, common, lanes.runs, state, waits)
        goes = lanes.busy & jax.vmap(program.is_under_way)(state)
        new = self._each(functools.partial(program.advance, setup), common, lanes.runs, state)
        keep = jax.vmap(lambda goes, new, old: jax.tree.map(lambda a, b: jnp.where(goes, a, b), new, old))
        return lanes._replace(state=keep(goes, new, state)), _count(goes)

    def go_on(self, lanes: Lanes, turns: Array, common: Any) -> tuple[Lanes, Array, Array]:
        """Advance by a number of turns, int32, or until enough runs are done, or all.

        Returns:
          `(lanes, done, use)`: `[L]` bool, a lane's run is done; `[2]` int32, turns, and lanes that advanced.
        """

        def goes_on(state):
            n, n_busy = _count(self._done(state[0])), _count(state[0].busy)
            return (state[1][0] < turns) & (n < jnp.minimum(n_busy, _part(lanes.busy.size)))

        def turn(state):
            lanes, n = self._turn(common, state[0])
            return lanes, state[1] + jnp.stack([jnp.int32(1), n])

        lanes, use = lax.while_loop(goes_on, turn, (lanes, jnp.zeros(2, jnp.int32)))
        return lanes, self._done(lanes), use

    # ---- on the host

    def queue(self) -> tuple[np.ndarray, np.ndarray, Runs]:
        """Return the remaining runs: `[N]` int, the line of each run, its number there, and `Runs` of numpy arrays.

        Sorted by draws, so that an interrupted comparison has pairs.
        """
        left = [line.left for line in self.lines]
        draw = np.concatenate([line.draws[which] for line, which in zip(self.lines, left)])
        order = np.argsort(draw, kind="stable")
        line = np.repeat(np.arange(len(left)), [len(which) for which in left])[order]
        seed, scene = zip(*((one.seed, self._place[id(one.scene)]) for one in self.lines))
        scalars = [np.array(values)[line] for values in zip(*(split(one.numbers)[0] for one in self.lines))]
        task = jax.tree.map(
            lambda *a: np.concatenate([some[which] for some, which in zip(a, left)])[order],
            *(one.tasks for one in self.lines),
        )
        runs = Runs(np.array(seed, np.uint32)[line], draw[order], np.array(scene, np.int32)[line], scalars, task)
        return line, np.concatenate(left)[order], runs

    def lane_bytes(self) -> int:
        """Estimate the bytes that a lane needs on a device."""
        lanes = jax.eval_shape(functools.partial(self.empty, n_lanes=1), self.queue()[2], self.common)
        return COPIES * sum(math.prod(a.shape) * a.dtype.itemsize for a in jax.tree.leaves(lanes))

    def fitting_lanes(self) -> int:
        """Return the number of lanes that a device's memory holds: a power of two; fewer for fewer runs."""
        most = LANES if self.devices[0].platform != "cpu" else CPU_LANES
        memory = [device.memory_stats() for device in self.devices]
        if all(memory):
            free = min(m["bytes_limit"] - m["bytes_in_use"] for m in memory if m)
            most = min(most, int(MEMORY_SHARE * max(free, 0)) // self.lane_bytes())
        left = sum(len(line.left) for line in self.lines)
        return min(2 ** max(0, most.bit_length() - 1), -(-left // len(self.devices)))

    def compile(self, n_lanes: int, compiled: Callable[..., tuple[Any, Any]] = compiled) -> tuple[Any, ...]:
        """Compile for a number of lanes on each device.

        `compiled`: as `devices.compiled`.

        Returns:
          `(make, fill, go_on, found)`: makers of `empty` lanes, `fill` and `go_on`; and the shapes of the results of
            `fill`.
        """
        kind, devices, options = self.lines[0].kind, self.devices, self.program.cpu_options
        d, m = len(devices), _part(n_lanes)
        some = jax.tree.map(lambda a: np.zeros((d, m, *a.shape[1:]), a.dtype), self.queue()[2])
        runs, which, real = parted((some, np.zeros((d, m), np.int32), np.zeros((d, m), bool)), devices)
        empty = on_devices(functools.partial(self.empty, n_lanes=n_lanes), devices, 1)
        make, _ = compiled(empty, ("empty", kind, n_lanes), (runs, self.common), devices)
        lanes = make(runs, self.common)
        made = []
        for function, own in (
            (self.fill, (which, runs, real)),
            (self.go_on, (parted(np.zeros(d, np.int32), devices),)),
        ):
            arguments, name = (lanes, *own, self.common), (function.__name__, kind)
            local = on_devices(function, devices, 1 + len(own))
            made.append(compiled(local, name, arguments, devices, donate=(0,), cpu_options=options))
        found = jax.tree.map(lambda a: jax.ShapeDtypeStruct(a.shape[2:], a.dtype), made[0][1][1])
        return functools.partial(make, runs, self.common), made[0][0], made[1][0], found

    def run(
        self, n_lanes: int, costs: Any, on_progress: Callable[[int], object], programs: tuple[Any, ...] | None = None
    ) -> None:
        """Make the remaining runs in `n_lanes` lanes on each device, by the programs of `compile`."""
        began = time.perf_counter()
        make, fill, go_on, shapes = programs or self.compile(n_lanes)
        for one in self.lines:
            one.make_room(shapes[0])
        costs.compile_s += time.perf_counter() - began
        costs.lanes, began = max(costs.lanes, n_lanes), time.perf_counter()
        (line, number, runs), lanes, turns, first, finished = self.queue(), make(), FIRST_TURNS, 0, 0
        at = np.full((len(self.devices), n_lanes), -1)  # place in the queue of each lane's run; -1: none
        done = np.zeros(at.shape, bool)
        try:
            while True:
                while True:
                    which, new = _to_fill(at, done, first, len(line))
                    if (which < 0).all():
                        break
                    ended = (which >= 0) & (np.take_along_axis(at, which, 1) >= 0)
                    place = np.take_along_axis(at, which, 1)[ended]
                    own = jax.tree.map(lambda a, new=new: a[new], runs)
                    arguments = parted((np.where(which < 0, n_lanes, which), own, new >= 0), self.devices)
                    lanes, found = fill(lanes, *arguments, self.common)
                    self._collect(line[place], number[place], ended, found)
                    for d, lane in enumerate(which):
                        at[d, lane[lane >= 0]], done[d, lane[lane >= 0]] = new[d, lane >= 0], False
                    first, finished = max(first, int(new.max()) + 1), finished + len(place)
                on_progress(finished)
                if finished == len(line):
                    return
                called = time.perf_counter()
                lanes, done, use = go_on(lanes, parted(np.full(len(at), turns, np.int32), self.devices), self.common)
                done, use = np.array(done), np.asarray(use)
                rate = int(use[:, 0].max()) / max(time.perf_counter() - called, 1e-3)
                turns = max(1, int(min(GROWTH * turns, CALL_S * rate)))
                costs.advanced += int(use[:, 1].sum())
                costs.room += int(use[:, 0].sum()) * n_lanes
        finally:
            costs.run_s += time.perf_counter() - began

    def _collect(self, line, number, ended, found):
        """Hand results to their lines, for runs with these lines and numbers, at `ended` among `[D, m]`."""
        found, kept = jax.tree.map(np.asarray, found[0]), found[1]
        where = np.argwhere(ended)
        for i in np.unique(line):
            own, mine = line == i, self.lines[i]
            for d, j in where[own & (number == mine.keeps)]:
                mine.kept = jax.tree.map(lambda a, d=d, j=j: np.asarray(a[d, j]), kept)
            mine.put(number[own], jax.tree.map(lambda a, own=own: a[ended][own], found))


def _to_fill(at, done, first, total):
    """Choose the lanes to be measured or filled next, those with finished runs first, and the runs to begin there.

    Args:
      at, done: `[D, L]`, of each lane the place of its run in the queue, -1 for none, and whether that is done.
      first: place of the next run to begin, of `total`.

    Returns:
      `(which, new)`: `[D, m]` int each; -1 for no lane, and for no run.
    """
    which, new = np.full((2, len(at), _part(at.shape[1])), -1)
    for d in range(len(at)):
        idle = np.flatnonzero(at[d] < 0)[: total - first]
        lanes = np.concatenate([np.flatnonzero(done[d]), idle])[: which.shape[1]]
        n = min(len(lanes), total - first)
        which[d, : len(lanes)], new[d, :n] = lanes, first + np.arange(n)
        first += n
    return which, new


def _part(n_lanes):
    return -(-n_lanes // FILLED)


def _count(mask):
    return jnp.sum(mask, dtype=jnp.int32)


def run_in_lanes(
    lines: Sequence[Line],
    devices: Sequence[Any],
    n_lanes: int | None,
    costs: Any,
    on_progress: Callable[[int], object],
) -> None:
    """Make every run of some lines.

    Args:
      lines: list of `Line`; results are put there as they come.
      devices: list of JAX devices of one kind.
      n_lanes: lanes on every device; None for as many as its memory holds, at most `LANES`.
      costs: `Costs`, added to.
      on_progress: called with the number of finished runs.

    Raises:
      KeyboardInterrupt: results of earlier calls are kept.
    """
    groups = {}
    for line in lines:
        if len(line.which):
            arrays = [(a.shape, np.asarray(a).tobytes()) for a in split(line.numbers)[1]]
            groups.setdefault((line.kind, id(line.shared), tuple(arrays)), []).append(line)
    before = 0
    for group in groups.values():
        before += _run_group(group, devices, n_lanes, costs, lambda n, before=before: on_progress(before + n))


def _run_group(lines, devices, n_lanes, costs, on_progress):
    """Run lines of one kind: how many runs they were. Memory that runs out halves the lanes, once."""
    group, total = Group(lines, devices), sum(len(line.which) for line in lines)
    n_lanes = min(n_lanes or group.fitting_lanes(), -(-total // len(devices)))
    for n in (n_lanes, n_lanes // 2):
        before = total - sum(len(line.left) for line in lines)
        try:
            group.run(n, costs, lambda done, before=before: on_progress(before + done))
            break
        except jax.errors.JaxRuntimeError as error:
            if "RESOURCE_EXHAUSTED" not in str(error) or n < n_lanes or n < 2:
                raise
        # Out here the lanes that did not fit are forgotten.
        warnings.warn(f"out of device memory with {n} lanes: going on with {n // 2}", stacklevel=2)
    return total
