"""The serial engine: a CPU core runs one episode after the other, with true control flow.

Threads share one compiled program; several devices each run a part of every call.
"""

import dataclasses
import functools
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np

from jexplore.engine import threads
from jexplore.engine.devices import on_devices, whole
from jexplore.exploration import episode
from jexplore.exploration.site import Line

CHUNK = 64  # most episodes in one call of the compiled program on one device


def chunk(setup, which, starts, count, seed, truth, beams, numbers):
    """Up to C episodes of one world and strategy, one after the other.

    Args:
      setup: `Setup`. Static.
      which: `[C]` int32, number of each episode; with the seed it makes the episode's key.
      starts: `[C, 3]` int32, row, col, heading (units of 45 degrees).
      count: int32, episodes to run; the rest of the C are left alone.
      seed: uint32.
      truth, beams, numbers: `Truth` of one world, `Beams`, `Numbers`.

    Returns:
      `Result` with a leading axis C, zeros from `count` on; and grid and trail of the last episode run.
    """

    def episode_of(i):
        key = jax.random.fold_in(jax.random.key(seed), which[i])
        result, final = episode.run(key, setup, truth, beams, numbers, jnp.int32(0), starts[i])
        return result, (final.belief.grid, final.trail)

    return threads.in_turn(episode_of, starts.shape[0], count)


run_chunk = jax.jit(chunk, static_argnames=("setup",))


@dataclasses.dataclass(kw_only=True)
class _Line(threads.Work):
    """One line on its way."""

    line: Line
    program: Callable
    arguments: tuple

    def call(self, first, n):
        d, which = self.n_devices, self.line.which[first : first + n]
        # Device i takes episodes i, i + d, ...: episode 0 comes alone on device 0 in the first call.
        numbers, starts = np.zeros((d, CHUNK), np.int32), np.zeros((d, CHUNK, 3), np.int32)
        count = np.array([len(which[i::d]) for i in range(d)], np.int32)
        for i in range(d):
            numbers[i, : count[i]], starts[i, : count[i]] = which[i::d], self.line.starts[which[i::d]]
        began = time.perf_counter()
        results, last = jax.block_until_ready(self.program(numbers, starts, count, *self.arguments))
        seconds = time.perf_counter() - began
        return (results, last), seconds

    def keep(self, first, n, found):
        d, which = self.n_devices, self.line.which[first : first + n]
        results, last = found
        if which[0] == 0:
            grid, trail = jax.tree.map(lambda a: np.asarray(a)[0], last)
            self.line.first = grid.hits, grid.misses, trail
        results = jax.tree.map(np.asarray, results)
        for i in range(d):
            self.line.put(which[i::d], jax.tree.map(lambda a, i=i: a[i, : len(which[i::d])], results))


def run(lines, devices, workers, tally, on_progress):
    """Runs every episode of some lines.

    Args:
      lines: list of `Line`; results are put there as they come.
      devices: list of JAX devices of one kind.
      workers: threads; 1 where there are several devices.
      tally: object whose `compile_s` and `run_s` are added to.
      on_progress: called with the number of episodes finished so far, from the calling thread.

    Raises:
      KeyboardInterrupt: after the calls under way have ended; what they found has been kept.
    """
    began = time.perf_counter()
    works = _compile(lines, devices, workers)
    tally.compile_s += time.perf_counter() - began
    began = time.perf_counter()
    try:
        threads.run(works, workers, on_progress)
    finally:
        tally.run_s += time.perf_counter() - began


def _compile(lines, devices, workers):
    """A `Work` for every line. Lines that differ in numbers only share a program."""
    placed, programs, tasks = {}, {}, []
    for line in lines:
        site = line.site
        if id(site) not in placed:
            placed[id(site)] = whole((site.truth, site.beams), devices)
        arguments = np.uint32(line.seed), *placed[id(site)], line.numbers
        programs.setdefault(line.kind, (line.setup, arguments))
        tasks.append((line, line.kind, arguments))
    d = len(devices)
    blank = np.zeros((d, CHUNK), np.int32), np.zeros((d, CHUNK, 3), np.int32), np.zeros(d, np.int32)

    def compile_one(kind):
        setup, arguments = programs[kind]
        function = on_devices(functools.partial(chunk, setup), devices, 3)
        return kind, jax.jit(function).lower(*blank, *arguments).compile()

    with ThreadPoolExecutor(workers) as pool:
        compiled = dict(pool.map(compile_one, programs))
    return [
        _Line(pieces=len(line.which), most=CHUNK, n_devices=d, line=line, program=compiled[kind], arguments=arguments)
        for line, kind, arguments in tasks
    ]
