"""The lockstep engine: lines that share a compiled program run together, in as many lanes as the memory holds."""

import functools
import math
import time
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jexplore.engine.devices import compiled, on_devices, parted, whole
from jexplore.engine.lanes import Common, Engine, Queue, Table
from jexplore.engine.program import Line, split

LANES = 4096  # most lanes on a device
CPU_LANES = 64  # on a CPU, which lockstep is not made for
MEMORY_SHARE = 0.8  # of the device's free memory that lanes may take
CALL_S = 1.0  # seconds that a call should take: how often progress moves, and how long Ctrl-C waits
FIRST_TURNS = 16  # turns of the first call; later ones follow the clock
GROWTH = 4  # by how much longer a call may be than the one before
COLLECT_S = 20.0  # seconds between two times that results are taken to the host, where somebody waits for them


def run_lines(
    lines: Sequence[Line],
    devices: Sequence[Any],
    n_lanes: int | None,
    costs: Any,
    on_progress: Callable[[int], object],
    collect: bool = False,
) -> None:
    """Makes every run of some lines.

    Args:
      lines: list of `Line`; results are put there as they come.
      devices: list of JAX devices of one kind.
      n_lanes: lanes on every device; None for as many as its memory holds, at most `LANES`.
      costs: `Costs`, added to.
      on_progress: called with the number of runs finished so far.
      collect: whether results are put there every now and then, and not only at the end.

    Raises:
      KeyboardInterrupt: after the call under way has ended; what it found has been kept.
    """
    groups = {}
    for line in lines:
        if len(line.which):
            arrays = [(a.shape, np.asarray(a).tobytes()) for a in split(line.numbers)[1]]
            groups.setdefault((line.kind, id(line.shared), tuple(arrays)), []).append(line)
    done = 0
    for group in groups.values():
        done += _run_group(group, devices, n_lanes, costs, lambda n, done=done: on_progress(done + n), collect)


def _run_group(lines, devices, n_lanes, costs, on_progress, collect):
    """Lines of one kind: how many runs they were. Memory that runs out halves the lanes, once."""
    total = sum(len(line.which) for line in lines)
    group, seen, left = Group(lines, devices), 0, total
    n_lanes = min(n_lanes or group.fitting_lanes(), -(-total // len(devices)))

    def progress(done):
        nonlocal seen
        seen = max(seen, total - left + done)
        on_progress(seen)

    for n in (n_lanes, n_lanes // 2):
        left = sum(len(line.left) for line in lines)
        try:
            group.run(n, costs, progress, collect)
            break
        except jax.errors.JaxRuntimeError as error:
            if "RESOURCE_EXHAUSTED" not in str(error) or n < n_lanes or n < 2:
                raise
        # Out here the lanes that did not fit are forgotten.
        warnings.warn(f"out of device memory with {n} lanes: going on with {n // 2}", stacklevel=2)
    return total


def _rounded(n):
    """The next power of two: what is compiled for so many serves all below."""
    return 1 << max(0, n - 1).bit_length()


class Group:
    """Lines of one kind on some devices: of one program, with equal `shared` and arrays."""

    def __init__(self, lines: Sequence[Line], devices: Sequence[Any]) -> None:
        self.lines = lines
        self.devices = devices
        self.engine: Engine = Engine(lines[0].program, lines[0].numbers)
        scenes = {id(line.scene): line.scene for line in lines}
        place = {key: i for i, key in enumerate(scenes)}
        rows = [*range(len(lines))] + [0] * (_rounded(len(lines)) - len(lines))
        scalars = [split(lines[i].numbers)[0] for i in rows]
        with_slot = [i for i, line in enumerate(lines) if line.keeps >= 0]
        with_slot += [0] * (_rounded(len(with_slot)) - len(with_slot))
        self.slot: dict[int, int] = {i: slot for slot, i in enumerate(with_slot) if lines[i].keeps >= 0}
        # Ignored types: numpy on the host, where the record says what it is on the device.
        table = Table(
            scene=np.array([place[id(lines[i].scene)] for i in rows], np.int32),  # type: ignore[arg-type]
            seed=np.array([lines[i].seed for i in rows], np.uint32),  # type: ignore[arg-type]
            keeps=np.array([lines[i].keeps for i in rows], np.int32),  # type: ignore[arg-type]
            slot=np.array([self.slot.get(i, len(with_slot)) for i in rows], np.int32),  # type: ignore[arg-type]
            slots=np.array(with_slot, np.int32),  # type: ignore[arg-type]
            scalars=[np.stack(values) for values in zip(*scalars)],
        )
        stacked = jax.tree.map(lambda *a: np.stack(a), *scenes.values())
        arrays = split(lines[0].numbers)[1]
        self.common: Common = whole(Common(table, lines[0].shared, stacked, arrays), devices)

    def queue(self) -> Queue:
        """What is left as a `Queue` with a leading axis of the devices, dealt out in turn."""
        left, d = [line.left for line in self.lines], len(self.devices)
        number = np.concatenate(left)
        drawn = np.concatenate([line.draws[which] for line, which in zip(self.lines, left)])
        n, order = (
            _rounded(-(-len(number) // d)),
            np.argsort(drawn, kind="stable"),
        )  # so that what is interrupted has pairs

        def deal(values):
            values = np.asarray(values)[order]
            out = np.zeros((d, n, *values.shape[1:]), values.dtype)
            for i in range(d):
                out[i, : len(values[i::d])] = values[i::d]
            return out

        def of_lines(arrays):
            return deal(np.concatenate([array[which] for array, which in zip(arrays, left)]))

        # Ignored types: numpy on the host, where the record says what it is on the device.
        return Queue(
            line=deal(np.repeat(np.arange(len(left), dtype=np.int32), [len(which) for which in left])),  # type: ignore[arg-type]
            number=deal(number),  # type: ignore[arg-type]
            draw=deal(drawn),  # type: ignore[arg-type]
            task=jax.tree.map(lambda *a: of_lines(a), *(line.tasks for line in self.lines)),
            count=np.array([len(number[i::d]) for i in range(d)], np.int32),  # type: ignore[arg-type]
        )

    def _empty(self, n_lanes):
        return on_devices(functools.partial(self.engine.empty, n_lanes=n_lanes), self.devices, 1)

    def fitting_lanes(self) -> int:
        """Lanes that a device's memory holds: a power of two; fewer if there are not so many runs."""
        queue = self.queue()
        lanes = jax.eval_shape(self._empty(1), queue, self.common)
        most = LANES if self.devices[0].platform != "cpu" else CPU_LANES
        memory = [device.memory_stats() for device in self.devices]
        if all(memory):
            free = min(m["bytes_limit"] - m["bytes_in_use"] for m in memory if m)
            lanes = jax.tree.map(lambda a: a.update(shape=a.shape[1:]), lanes)
            free -= sum(math.prod(a.shape) * a.dtype.itemsize for a in jax.tree.leaves((lanes.results, lanes.kept)))
            most = min(most, int(MEMORY_SHARE * max(free, 0) / self.engine.lane_bytes(lanes, self.common.shared)))
        return min(2 ** max(0, most.bit_length() - 1), int(queue.count.max()))

    def run(self, n_lanes: int, costs: Any, on_progress: Callable[[int], object], collect: bool = False) -> None:
        """Makes what is left in so many lanes; results are taken to the host at the end, and, to `collect`, now and
        then.
        """
        began = time.perf_counter()
        queue, kind, devices = parted(self.queue(), self.devices), self.lines[0].kind, self.devices
        begin, shapes = compiled(self._empty(n_lanes), ("empty", kind, n_lanes), (queue, self.common), devices)
        lanes, turns = begin(queue, self.common), jnp.full(len(devices), FIRST_TURNS, jnp.int32)
        function = on_devices(self.engine.go_on, devices, 3)
        arguments = lanes, queue, parted(turns, devices), self.common
        options = self.engine.program.cpu_options
        step, _ = compiled(function, ("go on", kind), arguments, devices, donate=(0,), cpu_options=options)
        for line in self.lines:
            line.make_room(jax.tree.map(lambda a: jax.ShapeDtypeStruct(a.shape[2:], a.dtype), shapes.results))
        costs.compile_s += time.perf_counter() - began
        costs.lanes = max(costs.lanes, n_lanes)
        count, turns = int(np.asarray(queue.count).sum()), FIRST_TURNS
        began = collected = time.perf_counter()
        try:
            while True:
                called = time.perf_counter()
                how_many = parted(np.full(len(devices), turns, np.int32), devices)
                lanes, usage = step(lanes, queue, how_many, self.common)
                done = int(np.sum(lanes.done))
                seconds = time.perf_counter() - called
                costs.add(usage, n_lanes, self.engine.places(n_lanes))
                if collect and time.perf_counter() - collected > COLLECT_S:
                    self._collect(queue, lanes)
                    collected = time.perf_counter()
                on_progress(done)
                if done == count:
                    break
                turns = max(1, int(turns * min(GROWTH, CALL_S / max(seconds, 1e-3))))
        finally:
            self._collect(queue, lanes)
            costs.run_s += time.perf_counter() - began

    def _collect(self, queue, lanes):
        """Hands the results so far to their lines."""
        if any(a.is_deleted() for a in jax.tree.leaves(lanes)):  # lost in a call that failed
            return
        # All of it to the host before any of it is handed on: an interruption in between must leave no half.
        queue, results, kept, ended = jax.tree.map(np.asarray, (queue, lanes.results, lanes.kept, lanes.ended))
        for device in range(len(self.devices)):
            for i, line in enumerate(self.lines):
                of_line = ended[device] & (queue.line[device] == i)
                of_line[of_line] = ~line.finished[queue.number[device][of_line]]
                which = queue.number[device][of_line]
                if not len(which):
                    continue
                if (which == line.keeps).any():
                    line.kept = jax.tree.map(lambda a, d=device, i=self.slot[i]: a[d, i], kept)
                line.put(which, jax.tree.map(lambda a, d=device, m=of_line: a[d][m], results))
