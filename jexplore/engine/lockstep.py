"""The lockstep engine: lines that share a compiled program run together, in as many lanes as the memory holds."""

import dataclasses
import functools
import time
import warnings

import jax
import jax.numpy as jnp
import numpy as np

from jexplore.engine import lanes
from jexplore.engine.devices import on_devices, parted, whole
from jexplore.exploration.episode import Outcome

LANES = 4096  # most lanes on a device
CPU_LANES = 64  # on a CPU, which lockstep is not made for
MEMORY_SHARE = 0.8  # of the device's free memory that lanes may take
CALL_S = 1.0  # seconds that a call should take: how often progress moves, and how long Ctrl-C waits
FIRST_TURNS = 16  # turns of the first call; later ones follow the clock
GROWTH = 4  # by how much longer a call may be than the one before


@dataclasses.dataclass
class Tally:
    """What a run cost, and how well its lanes were used."""

    compile_s: float = 0.0
    run_s: float = 0.0
    lanes: int = 1
    walked: int = 0  # lanes that made a step, over all turns
    room: int = 0  # lanes that could have
    planned: int = 0  # lanes in planning groups
    plan_room: int = 0  # places in these groups

    @property
    def useful(self):
        """Share of the lanes that made a step; None if none could."""
        return self.walked / self.room if self.room else None

    @property
    def useful_plans(self):
        """Share of the places in planning groups that were taken; None if there was none."""
        return self.planned / self.plan_room if self.plan_room else None


def run(lines, devices, n_lanes, tally, on_progress):
    """Runs every episode of some lines.

    Args:
      lines: list of `Line`; results are put there as they come.
      devices: list of JAX devices of one kind.
      n_lanes: lanes on every device; None for as many as its memory holds, at most `LANES`.
      tally: `Tally`, added to.
      on_progress: called with the number of episodes finished so far.

    Raises:
      KeyboardInterrupt: after the call under way has ended; what it found has been kept.
    """
    groups = {}
    for line in lines:
        if len(line.which):
            groups.setdefault(line.kind, []).append(line)
    done = 0
    for group in groups.values():
        done = _run_group(group, devices, n_lanes, tally, lambda n, done=done: on_progress(done + n))


def _run_group(lines, devices, n_lanes, tally, on_progress):
    """Lines of one kind: how many episodes they were. Memory that runs out halves the lanes, once."""
    total = sum(len(line.which) for line in lines)
    group, seen, left = _Group(lines, devices), 0, total
    n_lanes = min(n_lanes or group.fitting_lanes(), -(-total // len(devices)))

    def progress(done):
        nonlocal seen
        seen = max(seen, total - left + done)
        on_progress(seen)

    for n in (n_lanes, n_lanes // 2):
        left = sum(len(line.left) for line in lines)
        try:
            group.run(n, tally, progress)
            break
        except jax.errors.JaxRuntimeError as error:
            if "RESOURCE_EXHAUSTED" not in str(error) or n < n_lanes or n < 2:
                raise
        # Out here the lanes that did not fit are forgotten.
        warnings.warn(f"out of device memory with {n} lanes: going on with {n // 2}", stacklevel=2)
    return total


class _Group:
    """Lines of one kind on some devices."""

    def __init__(self, lines, devices):
        self.lines, self.devices, self.setup = lines, devices, lines[0].setup
        sites = {id(line.site): line.site for line in lines}
        place = {key: i for i, key in enumerate(sites)}
        truths = [site.truth for site in sites.values()]
        truth = jax.tree.map(lambda *a: np.concatenate(a), *truths)
        table = lanes.Lines(
            world=np.array([place[id(line.site)] for line in lines], np.int32),  # type: ignore[arg-type]
            seed=np.array([line.seed for line in lines], np.uint32),  # type: ignore[arg-type]
            numbers=jax.tree.map(lambda *a: np.stack(a), *(line.numbers for line in lines)),
        )
        self.shared = whole((table, truth, lines[0].site.beams), devices)

    def queue(self):
        """What is left as a `Queue` with a leading axis of the devices, dealt out in turn."""
        left, d = [line.left for line in self.lines], len(self.devices)
        line = np.concatenate([np.full(len(which), i, np.int32) for i, which in enumerate(left)])
        number = np.concatenate(left)
        start = np.concatenate([line.starts[which] for line, which in zip(self.lines, left)])
        n, order = -(-len(number) // d), np.argsort(number, kind="stable")  # so that what is interrupted has pairs

        def deal(values):
            values = values[order]
            out = np.zeros((d, n, *values.shape[1:]), np.int32)
            for i in range(d):
                out[i, : len(values[i::d])] = values[i::d]
            return out

        count = np.array([len(number[i::d]) for i in range(d)], np.int32)
        return lanes.Queue(line=deal(line), number=deal(number), start=deal(start), count=count)  # type: ignore[arg-type]

    def _empty(self, n_lanes):
        function = functools.partial(lanes.empty, self.setup, n_lanes=n_lanes)
        return on_devices(function, self.devices, 1)

    def fitting_lanes(self):
        """Lanes that a device's memory holds: a power of two; fewer if there are not so many episodes."""
        queue = self.queue()
        work = jax.eval_shape(self._empty(1), queue, *self.shared)
        most = LANES if self.devices[0].platform != "cpu" else CPU_LANES
        memory = [device.memory_stats() for device in self.devices]
        if all(memory):
            free = min(m["bytes_limit"] - m["bytes_in_use"] for m in memory if m)
            one = lanes.lane_bytes(jax.tree.map(lambda a: a.update(shape=a.shape[1:]), work), self.shared[2])
            most = min(most, int(MEMORY_SHARE * free / one))
        return min(2 ** max(0, most.bit_length() - 1), queue.line.shape[1])

    def run(self, n_lanes, tally, on_progress):
        """Runs what is left in so many lanes."""
        began = time.perf_counter()
        queue = parted(self.queue(), self.devices)
        program = on_devices(functools.partial(lanes.go_on, self.setup), self.devices, 3)
        begin = jax.jit(self._empty(n_lanes)).lower(queue, *self.shared).compile()
        work = begin(queue, *self.shared)
        turns = jnp.full(len(self.devices), FIRST_TURNS, jnp.int32)
        step = jax.jit(program, donate_argnums=0).lower(work, queue, turns, *self.shared).compile()
        tally.compile_s += time.perf_counter() - began
        tally.lanes = max(tally.lanes, n_lanes)
        count, turns = int(queue.count.sum()), FIRST_TURNS
        began = time.perf_counter()
        try:
            while True:
                called = time.perf_counter()
                how_many = parted(np.full(len(self.devices), turns, np.int32), self.devices)
                work, use = step(work, queue, how_many, *self.shared)
                done = int(np.sum(work.done))
                seconds = time.perf_counter() - called
                self._add(use, n_lanes, tally)
                on_progress(done)
                if done == count:
                    break
                turns = max(1, int(turns * min(GROWTH, CALL_S / max(seconds, 1e-3))))
        finally:
            self._collect(queue, work)
            tally.run_s += time.perf_counter() - began

    def _add(self, use, n_lanes, tally):
        turns, groups = int(np.sum(use.turns)), int(np.sum(use.groups))
        tally.walked += int(np.sum(use.walked))
        tally.planned += int(np.sum(use.planned))
        tally.room += turns * n_lanes
        tally.plan_room += groups * -(-n_lanes // lanes.PLANNERS)

    def _collect(self, queue, work):
        """Hands the results so far to their lines."""
        if any(a.is_deleted() for a in jax.tree.leaves(work)):  # lost in a call that failed
            return
        # All of it to the host before any of it is handed on: an interruption in between must leave no half.
        queue, results = jax.tree.map(np.asarray, (queue, work.results))
        grids, trails = jax.tree.map(np.asarray, (work.grids, work.trails))
        for device in range(len(self.devices)):
            ended = np.arange(queue.line.shape[1]) < queue.count[device]
            ended &= results.outcome[device] != Outcome.RUNNING
            for i, line in enumerate(self.lines):
                of_line = ended & (queue.line[device] == i)
                which = queue.number[device][of_line]
                if (which == 0).any():
                    line.first = grids.hits[device, i], grids.misses[device, i], trails[device, i]
                line.put(which, jax.tree.map(lambda a, d=device, m=of_line: a[d][m], results))
