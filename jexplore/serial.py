"""The serial engine: a CPU core runs one episode after the other, with true control flow.

Threads share one compiled program; several devices each run a part of every call.
"""

import dataclasses
import functools
import time
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jexplore import episode
from jexplore.mesh import on_devices, whole
from jexplore.site import Line

CHUNK = 64  # most episodes in one call of the compiled program on one device
CHUNK_S = 1.0  # seconds that a call should take: how often progress moves, and how long Ctrl-C waits


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

    def one(i, state):
        result, last = episode_of(i)
        return jax.tree.map(lambda all_, new: all_.at[i].set(new), state[0], result), last

    result, last = jax.eval_shape(episode_of, 0)
    results = jax.tree.map(lambda x: jnp.zeros((starts.shape[0], *x.shape), x.dtype), result)
    return lax.fori_loop(0, count, one, (results, jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), last)))


run_chunk = jax.jit(chunk, static_argnames=("setup",))


@dataclasses.dataclass
class _Task:
    """One line on its way: what is left to do, and how long an episode takes."""

    line: Line
    program: Callable
    arguments: tuple
    n_devices: int
    next: int = 0
    episode_s: float | None = None

    def take(self, workers):
        """The next episodes, `(first, number)`: one a device at first, then as many as take about a second."""
        left, d = len(self.line.which) - self.next, self.n_devices
        n = 1 if self.episode_s is None else int(CHUNK_S / max(self.episode_s, 1e-6))
        n = min(left, d * max(1, min(n, CHUNK, -(-left // (workers * d)))))
        first = self.next
        self.next += n
        return first, n

    def call(self, first, n):
        """Runs some episodes and keeps their results: how many, and the seconds it took."""
        d, which = self.n_devices, self.line.which[first : first + n]
        # Device i takes episodes i, i + d, ...: episode 0 comes alone on device 0 in the first call.
        numbers, starts = np.zeros((d, CHUNK), np.int32), np.zeros((d, CHUNK, 3), np.int32)
        count = np.array([len(which[i::d]) for i in range(d)], np.int32)
        for i in range(d):
            numbers[i, : count[i]], starts[i, : count[i]] = which[i::d], self.line.starts[which[i::d]]
        began = time.perf_counter()
        results, last = jax.block_until_ready(self.program(numbers, starts, count, *self.arguments))
        seconds = time.perf_counter() - began
        if which[0] == 0:
            grid, trail = jax.tree.map(lambda a: np.asarray(a)[0], last)
            self.line.first = grid.hits, grid.misses, trail
        results = jax.tree.map(np.asarray, results)
        for i in range(d):
            self.line.put(which[i::d], jax.tree.map(lambda a, i=i: a[i, : count[i]], results))
        return n, seconds


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
    tasks = _compile(lines, devices, workers)
    tally.compile_s += time.perf_counter() - began
    began = time.perf_counter()
    waiting, running, done = [task for task in tasks if len(task.line.which)], {}, 0
    pool = ThreadPoolExecutor(workers)
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                task = waiting[0]
                running[pool.submit(task.call, *task.take(workers))] = task
                waiting.pop(0)
                if task.next < len(task.line.which):  # all lines in turn, so that what is interrupted has pairs
                    waiting.append(task)
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                task = running.pop(future)
                n, seconds = future.result()
                task.episode_s = seconds * len(devices) / n
                done += n
            on_progress(done)
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        tally.run_s += time.perf_counter() - began


def _compile(lines, devices, workers):
    """A task for every line. Lines that differ in numbers only share a program."""
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
    return [_Task(line, compiled[kind], arguments, d) for line, kind, arguments in tasks]
