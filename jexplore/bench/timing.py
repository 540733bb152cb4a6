"""Timing on a noisy machine: turns, one core, and what the machine is."""

import contextlib
import math
import os
import platform
import statistics
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import jax

from jexplore.engine.runner import own_cores
from jexplore.report import store

_T = TypeVar("_T")
_K = TypeVar("_K")


class Seconds(NamedTuple):
    """One measurement."""

    wall: float  # by the clock on the wall
    cpu: float  # of processor time, all threads of this process together


def timed(function: Callable[[], _T]) -> tuple[_T, Seconds]:
    """Call a function: `(what it returned, Seconds)`."""
    wall, cpu = time.perf_counter(), time.process_time()
    out = function()
    return out, Seconds(time.perf_counter() - wall, time.process_time() - cpu)


def interleaved(functions: dict[_K, Any], repeat: int) -> dict[_K, list[tuple[Any, Seconds]]]:
    """Time functions in turn, so that a slow spell of the machine meets all; every other turn backwards.

    On one core, where there is a CPU only. Returns `{name: [(what it returned, Seconds), ...]}`, one entry a turn.
    """
    found = {name: [] for name in functions}
    with one_core():
        for turn in range(repeat):
            names = list(functions) if turn % 2 == 0 else list(reversed(functions))
            for name in names:
                found[name].append(timed(functions[name]))
    return found


def median_and_min(values: Collection[float]) -> dict[str, float]:
    """Return median and least of some numbers, as a dict."""
    return {"median": statistics.median(values), "min": min(values)}


def mean_and_se(values: Iterable[float]) -> dict[str, float | None]:
    """Return the mean and its standard error (None for one value), as a dict."""
    values = [float(v) for v in values]
    se = statistics.stdev(values) / math.sqrt(len(values)) if len(values) > 1 else None
    return {"mean": statistics.fmean(values), "se": se}


def speed_clock() -> str:
    """Return the field of `Seconds` for speed: processor time on a CPU, which may be shared, else wall time."""
    return "cpu" if jax.default_backend() == "cpu" else "wall"


def _threads():
    """Return the ids of this process's threads; 0, the calling one, if the system does not list them."""
    with contextlib.suppress(OSError):
        return [int(name) for name in os.listdir("/proc/self/task")]
    return [0]


@contextlib.contextmanager
def one_core() -> Iterator[bool]:
    """Keep every thread that this process has on one core, where JAX computes on a CPU and the system can do that.

    Yields whether it does.
    """
    if not hasattr(os, "sched_setaffinity") or jax.default_backend() != "cpu":
        yield False
        return
    before = os.sched_getaffinity(0)

    def pin(cpus):
        for thread in _threads():
            with contextlib.suppress(ProcessLookupError):  # it has ended
                os.sched_setaffinity(thread, cpus)

    pin({max(before)})
    try:
        yield True
    finally:
        pin(before)


def _cpu_model():
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or None


def surroundings() -> dict[str, Any]:
    """Describe versions, device, processor, and how busy the machine is: a dict."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return {
        **store.environment(),
        "cpu": _cpu_model(),
        "cores": own_cores(),
        "load_1min": load,
    }
