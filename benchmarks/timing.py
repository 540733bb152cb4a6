"""What both benchmarks need: timing on a noisy machine, one core, tables and files."""

import argparse
import contextlib
import hashlib
import importlib.util
import math
import os
import platform
import statistics
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from jexplore.config import InputError


class Seconds(NamedTuple):
    """One measurement."""

    wall: float  # by the clock on the wall
    cpu: float  # of processor time, all threads of this process together


def timed(function):
    """Calls a function: `(what it returned, Seconds)`."""
    wall, cpu = time.perf_counter(), time.process_time()
    out = function()
    return out, Seconds(time.perf_counter() - wall, time.process_time() - cpu)


def interleaved(functions, repeat):
    """Times functions in turn, so that a slow spell of the machine meets all of them; every other turn backwards.

    Args:
      functions: `{name: function of no arguments}`.
      repeat: turns.

    Returns:
      `{name: [(what it returned, Seconds), ...]}`, one entry a turn.
    """
    found = {name: [] for name in functions}
    for turn in range(repeat):
        names = list(functions) if turn % 2 == 0 else list(reversed(functions))
        for name in names:
            found[name].append(timed(functions[name]))
    return found


def spread(values):
    """Median and least of some numbers, as a dict."""
    return {"median": statistics.median(values), "min": min(values)}


def ratio(numerators, denominators):
    """Median of the turn-by-turn ratios."""
    return statistics.median(a / b for a, b in zip(numerators, denominators))


def mean_and_se(values):
    """Mean and its standard error (None for one value), as a dict."""
    values = [float(v) for v in values]
    se = statistics.stdev(values) / math.sqrt(len(values)) if len(values) > 1 else None
    return {"mean": statistics.fmean(values), "se": se}


def cores():
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def control(workers, mib=48):
    """Work that needs nothing but processors: hashes the same amount on any number of threads.

    Its speed-up with more threads is what the machine had to give to anyone just then.
    """
    block = bytes(2**20)

    def some(n):
        digest = hashlib.sha256()
        for _ in range(n):
            digest.update(block)  # releases the interpreter lock

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(some, [mib // (4 * workers)] * (4 * workers)))


def _threads():
    """Ids of this process's threads; 0, the calling one, where the system does not list them."""
    with contextlib.suppress(OSError):
        return [int(name) for name in os.listdir("/proc/self/task")]
    return [0]


def _thread_cpu_s():
    """Processor time of every thread of this process: `{id: seconds}`; empty where the system does not tell."""
    found = {}
    for thread in _threads():
        with contextlib.suppress(OSError, ValueError, IndexError):
            found[thread] = int(Path(f"/proc/self/task/{thread}/schedstat").read_text().split()[0]) / 1e9
    return found


def busiest(function):
    """Calls a function that leaves its threads alive: `(what it returned, processor time of the busiest thread)`.

    However busy the machine, work cannot end sooner than its busiest thread. The time is None where the system does
    not tell it.
    """
    before = _thread_cpu_s()
    out = function()
    return out, max((s - before.get(thread, 0.0) for thread, s in _thread_cpu_s().items()), default=None)


@contextlib.contextmanager
def one_core():
    """Keeps every thread that this process has on one core, where the system can: yields whether it does."""
    if not hasattr(os, "sched_setaffinity"):
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


def surroundings():
    """Versions, device, processor, and how busy the machine is: a dict."""
    from jexplore import store

    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return {
        **store.environment(),
        "numba": version("numba") if importlib.util.find_spec("numba") else None,
        "cpu": _cpu_model(),
        "cores": cores(),
        "load_1min": load,
    }


def markdown(header, rows):
    """A Markdown table.

    Args:
      header: column names.
      rows: lists of text and numbers; None becomes a dash, a float three significant digits.
    """

    def text(value):
        if value is None:
            return "–"
        if not isinstance(value, float):
            return str(value)
        return f"{value:.0f}" if abs(value) >= 100 else f"{value:#.3g}".rstrip(".")

    lines = [header, ["---"] * len(header), *([text(value) for value in row] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def at_least_one(text):
    """A number on the command line: an integer from 1."""
    with contextlib.suppress(ValueError):
        if (number := int(text)) >= 1:
            return number
    raise argparse.ArgumentTypeError(f"expected an integer from 1, got {text!r}")


def finish(report, out):
    """Writes the report as JSON, if a file was asked for."""
    if out is not None:
        from jexplore import store

        store.write_json(report, out)
        print(f"\nWritten: {out}")


def check_out(path):
    """Refuse an output file whose folder is not there, before anything is measured."""
    if path is not None and not Path(path).resolve().parent.is_dir():
        raise InputError(f"--out {path}: its folder must exist")


def guarded(main):
    """Runs a script; wrong input is one line on stderr and exit status 2."""
    try:
        main()
    except InputError as error:
        print(f"{Path(sys.argv[0]).name}: error: {error}", file=sys.stderr)
        sys.exit(2)
