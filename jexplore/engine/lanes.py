"""Runs of one program in lanes that advance together, as an accelerator wants it.

A `vmap` of lanes. In every iteration those advance that are under way; those that must decide wait until they are an
eighth of all and then decide together. When enough runs are done they are measured and their lanes filled again.
"""

import functools
import math
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jexplore.arrays.loops import SHARE, put, run_if, take
from jexplore.engine.devices import Device, compiled, random_key
from jexplore.engine.program import Given, Line, split

LANES = 4096  # most lanes
CPU_LANES = 64  # on a CPU, which lanes are not made for
FILLED = 16  # one lane of this number is measured and filled at a time
MEMORY_SHARE = 0.8  # of the device's free memory that lanes may take
COPIES = 4  # of a lane's state that there may be at a time; an estimate
CALL_S = 1.0  # seconds that a call should take: how often progress moves, and how long Ctrl-C waits
FIRST_ITERATIONS = 16  # of the first call; later ones follow the clock
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
    """Lines of one kind: of one program, with equal `shared` and arrays."""

    def __init__(self, lines: Sequence[Line], device: Device) -> None:
        self.lines, self.device, self.program = lines, device, lines[0].program
        scenes = {id(line.scene): line.scene for line in lines}
        place = {key: i for i, key in enumerate(scenes)}
        _, arrays, self._join = split(lines[0].numbers)
        stacked = jax.tree.map(lambda *a: np.stack(a), *scenes.values())
        self.common: Any = jax.device_put((lines[0].shared, stacked, arrays), device)
        # The queue, sorted by draws, so that an interrupted comparison has pairs: of each run its line and number.
        draw = np.concatenate([line.draws[line.which] for line in lines])
        order = np.argsort(draw, kind="stable")
        self.line = np.repeat(np.arange(len(lines)), [len(line.which) for line in lines])[order]
        self.number = np.concatenate([line.which for line in lines])[order]
        seed = np.array([line.seed for line in lines], np.uint32)[self.line]
        scene = np.array([place[id(line.scene)] for line in lines], np.int32)[self.line]
        scalars = [np.array(values)[self.line] for values in zip(*(split(line.numbers)[0] for line in lines))]
        tasks = [jax.tree.map(lambda a, line=line: a[line.which], line.tasks) for line in lines]
        task = jax.tree.map(lambda *a: np.concatenate(a)[order], *tasks)
        self.runs = Runs(seed, draw[order], scene, scalars, task)

    # ---- on a device: pure functions

    def _each(self, function: Callable[..., Any], common: Any, runs: Runs, *own: Any) -> Any:
        """Call `function(given, *own)` for some runs; their `common` data are not copied."""
        shared, scenes, arrays = common

        def one(run: Runs, *own: Any) -> Any:
            key = jax.random.fold_in(random_key(run.seed), run.draw)
            return function(Given(key, shared, scenes, run.scene, self._join(run.scalars, arrays), run.task), *own)

        return jax.vmap(one)(runs, *own)

    def _begun(self, common: Any, runs: Runs) -> Any:
        return self._each(functools.partial(self.program.begin, self.program.setup), common, runs)

    def _done(self, lanes: Lanes) -> Array:
        return lanes.busy & jax.vmap(self.program.is_done)(lanes.state)

    def _fill(self, lanes: Lanes, which: Array, runs: Runs, real: Array, common: Any) -> tuple[Lanes, Any]:
        """Measure the runs in some lanes, and begin others there: `(lanes, found)`, as for `step`."""
        state = take(lanes.state, which)
        found = self._each(self.program.measure, common, take(lanes.runs, which), state)
        detail, begins = jax.vmap(self.program.detail)(state), jnp.where(real, which, lanes.busy.size)
        state = put(lanes.state, begins, self._begun(common, runs))
        return Lanes(put(lanes.runs, begins, runs), put(lanes.busy, which, real), state), (found, detail)

    def _advance(self, lanes: Lanes, common: Any) -> Lanes:
        """Let those decide that must, if they are enough, and advance the others."""
        program, setup, state = self.program, self.program.setup, lanes.state
        if program.decide is not None:
            alive = lanes.busy & ~self._done(lanes)
            waits = alive & jax.vmap(program.waits)(state)
            waits &= SHARE * _count(waits) >= _count(alive)

            def decide(given: Given, state: Any, waits: Array) -> Any:
                return run_if(waits, functools.partial(program.decide, setup, given), state)

            state = self._each(decide, common, lanes.runs, state, waits)
        goes = lanes.busy & jax.vmap(program.is_under_way)(state)
        new = self._each(functools.partial(program.advance, setup), common, lanes.runs, state)
        choose = jax.vmap(lambda goes, new, old: jax.tree.map(lambda a, b: jnp.where(goes, a, b), new, old))
        return lanes._replace(state=choose(goes, new, state))

    def step(
        self, lanes: Lanes, which: Array, runs: Runs, real: Array, iterations: Array, common: Any
    ) -> tuple[Lanes, Any, Array, Array]:
        """Measure the runs in lanes `which`, `[m]` int32, begin `runs` there where they are `real`, and advance all.

        All advance by a number of iterations, or until as many runs are done as are measured at a time, or all. Returns
        `(lanes, found, done, n)`: of the m lanes what `Program.measure` and `detail` return, something where there was
        no run; `[L]` bool, a lane's run is done; int32, iterations.
        """
        lanes, found = self._fill(lanes, which, runs, real, common)
        enough = jnp.minimum(_count(lanes.busy), which.shape[0])

        def goes_on(state: tuple[Lanes, Array]) -> Array:
            return (state[1] < iterations) & (_count(self._done(state[0])) < enough)

        def advance(state: tuple[Lanes, Array]) -> tuple[Lanes, Array]:
            return self._advance(state[0], common), state[1] + 1

        lanes, n = lax.while_loop(goes_on, advance, (lanes, jnp.int32(0)))
        return lanes, found, self._done(lanes), n

    # ---- on the host

    def _shapes(self, n: int) -> Any:
        """Return the shapes of `Lanes`, `[n, ...]`."""
        shapes: Any = self.runs, np.zeros(1, bool), jax.eval_shape(self._begun, self.common, self.runs)
        return jax.tree.map(lambda a: jax.ShapeDtypeStruct((n, *a.shape[1:]), a.dtype), Lanes(*shapes))

    def fitting_lanes(self) -> int:
        """Return the number of lanes that the device's memory holds: a power of two; fewer for fewer runs."""
        most = LANES if self.device.platform != "cpu" else CPU_LANES
        if memory := self.device.memory_stats():
            free = memory["bytes_limit"] - memory["bytes_in_use"]
            bytes_each = sum(math.prod(a.shape) * a.dtype.itemsize for a in jax.tree.leaves(self._shapes(1)))
            most = min(most, int(MEMORY_SHARE * max(free, 0)) // (COPIES * bytes_each))
        return min(2 ** max(0, most.bit_length() - 1), len(self.line))

    def run(self, n_lanes: int, costs: Any, tell: Callable[[], object]) -> None:
        """Make the runs in `n_lanes` lanes; `costs` are added to, `tell` is called after every call."""
        began = time.perf_counter()
        total = len(self.line)
        lanes: Any = jax.tree.map(
            lambda a: jnp.zeros(a.shape, a.dtype, device=self.device),  # type: ignore[arg-type]
            self._shapes(n_lanes),
        )

        def inputs(which: np.ndarray, new: np.ndarray, iterations: int) -> Any:
            own = jax.tree.map(lambda a: a[new], self.runs)
            return jax.device_put(
                (np.where(which < 0, n_lanes, which), own, new >= 0, np.int32(iterations)), self.device
            )

        none = np.full(-(-n_lanes // FILLED), -1)
        arguments, name = (lanes, *inputs(none, none, 0), self.common), ("lanes", self.lines[0].kind)
        options: dict[str, Any] = {"donate": (0,), "cpu_options": self.program.cpu_options}
        call, shapes = compiled(self.step, name, arguments, self.device, **options)
        results = jax.tree.map(lambda a: jax.ShapeDtypeStruct(a.shape[1:], a.dtype), shapes[1][0])
        for line in self.lines:
            line.make_room(results)
        costs.compile_s += time.perf_counter() - began
        costs.lanes, began = max(costs.lanes, n_lanes), time.perf_counter()
        at = np.full(n_lanes, -1)  # place in the queue of each lane's run; -1: none
        done, iterations, first, finished = np.zeros(at.shape, bool), FIRST_ITERATIONS, 0, 0
        try:
            while finished < total:
                which, new = _to_fill(at, done, first, total)
                lane, place = which[which >= 0], np.where(which < 0, -1, at[which])
                at[lane], done[lane] = new[which >= 0], False
                first = max(first, int(new.max()) + 1)
                is_full = (_to_fill(at, done, first, total)[0] < 0).all()  # else others are measured and begun first
                called = time.perf_counter()
                lanes, found, done, n = call(lanes, *inputs(which, new, iterations if is_full else 0), self.common)
                self._collect(place, *found)
                done, finished = np.array(done), finished + int((place >= 0).sum())
                if is_full:
                    rate = int(n) / max(time.perf_counter() - called, 1e-3)
                    iterations = max(1, int(min(GROWTH * iterations, CALL_S * rate)))
                tell()
        finally:
            costs.run_s += time.perf_counter() - began

    def _collect(self, place: np.ndarray, found: Any, detail: Any) -> None:
        """Hand results to their lines: of runs with these places in the queue, `[m]`, -1 where there was none."""
        found = jax.tree.map(np.asarray, found)
        slot = np.flatnonzero(place >= 0)
        runs = place[slot]
        for i in np.unique(self.line[runs]):
            own, line = self.line[runs] == i, self.lines[i]
            where, numbers = slot[own], self.number[runs[own]]
            for lane in where[numbers == line.detailed]:
                line.detail = jax.tree.map(lambda a, lane=lane: np.asarray(a[lane]), detail)
            line.put(numbers, jax.tree.map(lambda a, where=where: a[where], found))


def _to_fill(at: np.ndarray, done: np.ndarray, first: int, total: int) -> tuple[np.ndarray, np.ndarray]:
    """Choose the lanes to be measured or filled next, those with finished runs first, and the runs to begin there.

    `at`, `done`: `[L]`, of each lane the place of its run in the queue, -1 for none, and whether that is done;
    `first`: place of the next run to begin, of `total`. Returns `[m]` int each, -1 for no lane, and for no run.
    """
    which, new = np.full((2, -(-len(at) // FILLED)), -1)
    lanes = np.concatenate([np.flatnonzero(done), np.flatnonzero(at < 0)[: total - first]])[: len(which)]
    n = min(len(lanes), total - first)
    which[: len(lanes)], new[:n] = lanes, first + np.arange(n)
    return which, new


def _count(mask: Array) -> Array:
    return jnp.sum(mask, dtype=jnp.int32)


def run_in_lanes(
    lines: Sequence[Line], device: Device, n_lanes: int | None, costs: Any, tell: Callable[[], object]
) -> None:
    """Make every run of some lines, `n_lanes` at a time, by default as many as the device's memory holds.

    `tell` is called, from the calling thread, when some have come. Ctrl-C keeps the results of earlier calls.
    """
    groups: dict[Any, list[Line]] = {}
    for line in lines:
        if len(line.which):
            arrays = [(a.shape, np.asarray(a).tobytes()) for a in split(line.numbers)[1]]
            groups.setdefault((line.kind, id(line.shared), tuple(arrays)), []).append(line)
    for own in groups.values():
        group = Group(own, device)
        group.run(min(n_lanes or group.fitting_lanes(), len(group.line)), costs, tell)
