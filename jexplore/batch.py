"""Many episodes: compiled once per map size and strategy, one after the other on every core.

An episode is serial and full of decisions, so a CPU core runs episodes one at a time with true control flow (a batched
`while_loop` would run each to the slowest lane). Threads share one compiled program; XLA releases the interpreter lock.
"""

import contextlib
import functools
import math
import os
import time
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jexplore import episode
from jexplore.bits import WORD
from jexplore.episode import Numbers, Result, Setup, Track, Truth
from jexplore.grid import Grid, in_cells, radius_d2
from jexplore.policies import Strategy
from jexplore.raycast import beam_table
from jexplore.robot import scans_all_round
from jexplore.world import World

CHUNK = 64  # most episodes in one call of the compiled program
CHUNK_S = 1.0  # seconds that a call should take: how often progress moves, and how long Ctrl-C waits
LEAST_LIMIT = 20_000  # default bound of steps and plans on small maps


class Prepared(NamedTuple):
    """A world, a scanner and rules on the device, ready for episodes."""

    truth: Truth
    beams: object  # `raycast.Beams`
    clearance_d2: int
    first_scans: int
    window: int
    noisy: bool
    capacity: int
    near_d2: int
    max_steps: int
    max_plans: int
    sigma_cells: float
    dropout: float
    p_free: float
    look_around: bool


class Final(NamedTuple):
    """An episode's last map and its way there, on the host, without padding."""

    hits: np.ndarray  # [H, W] int32
    misses: np.ndarray  # [H, W] int32
    rows: np.ndarray  # [n + 1] int32, the robot's cell at the start and after each of n steps
    cols: np.ndarray  # [n + 1] int32
    target_rows: np.ndarray  # [n + 1] int32; -1 for none
    target_cols: np.ndarray  # [n + 1] int32; -1 for none
    looked: np.ndarray  # [n + 1] int32, scans made in place there
    known: np.ndarray  # [n + 1] int32, known cells then


def bucket(n):
    """The size to which a side of n cells is padded: of 4, 5, 6 or 7 times a power of two the next, in multiples of 32.

    So that maps of similar size share a compiled program, at the price of at most a quarter more rows and columns.
    """
    step = max(WORD, 2 ** (math.ceil(math.log2(max(n, 1))) - 3))
    return max(2 * WORD, math.ceil(n / step) * step)


def prepare(world, lidar, rules):
    """Pads a world, traces the scanner's beams and moves both to the device.

    Args:
      world: `World`.
      lidar: `Lidar`.
      rules: `Rules`.

    Returns:
      `Prepared`.
    """
    from scipy import ndimage

    height, width = world.shape
    shape = bucket(height), bucket(width)
    pad = [(0, full - n) for full, n in zip(shape, world.shape)]
    rooms = world.rooms if world.rooms is not None else np.full(world.shape, -1, np.int32)
    region = ndimage.label(~world.occupied)[0].astype(np.int32)  # type: ignore[index]
    truth = Truth(
        occupied=np.pad(world.occupied, pad, constant_values=True),  # type: ignore[arg-type]
        rooms=np.pad(rooms, pad, constant_values=-1),  # type: ignore[arg-type]
        region=np.pad(region, pad),  # type: ignore[arg-type]
        extent=np.asarray(world.shape, np.int32),  # type: ignore[arg-type]
    )
    limit = max(LEAST_LIMIT, height * width)
    max_steps = rules.max_steps or limit
    return Prepared(
        truth=jax.device_put(truth),
        beams=jax.device_put(beam_table(lidar, world.cell_m, shape[1])),
        clearance_d2=radius_d2(rules.clearance_m, world.cell_m),
        first_scans=scans_all_round(lidar.fov_deg),
        window=math.ceil(in_cells(lidar.range_m + 4 * lidar.sigma_m, world.cell_m)) + 1,
        noisy=lidar.sigma_m > 0 or lidar.dropout > 0,
        capacity=max(LEAST_LIMIT, shape[0] * shape[1]) if max_steps <= limit else max_steps,
        near_d2=radius_d2(rules.near_m, world.cell_m),
        max_steps=max_steps,
        max_plans=rules.max_plans or limit,
        sigma_cells=lidar.sigma_m / world.cell_m,
        dropout=lidar.dropout,
        p_free=rules.p_free,
        look_around=rules.look_around,
    )


def _setup(prepared, strategy):
    return Setup(
        init=strategy.policy.init,
        select=strategy.policy.select,
        clearance_d2=prepared.clearance_d2,
        first_scans=prepared.first_scans,
        window=prepared.window,
        noisy=prepared.noisy,
        capacity=prepared.capacity,
    )


def _numbers(prepared, strategy):
    return Numbers(
        p_free=np.float32(prepared.p_free),  # type: ignore[arg-type]
        near_d2=np.int32(prepared.near_d2),  # type: ignore[arg-type]
        look_around=np.bool_(prepared.look_around),  # type: ignore[arg-type]
        recheck=np.bool_(strategy.recheck),  # type: ignore[arg-type]
        max_steps=np.int32(prepared.max_steps),  # type: ignore[arg-type]
        max_plans=np.int32(prepared.max_plans),  # type: ignore[arg-type]
        sigma_cells=np.float32(prepared.sigma_cells),  # type: ignore[arg-type]
        dropout=np.float32(prepared.dropout),  # type: ignore[arg-type]
        params=strategy.policy.params,
    )


@functools.partial(jax.jit, static_argnames=("setup",))
def run_chunk(setup, seed, numbers_of, starts, count, truth, beams, numbers):
    """Up to C episodes of one world and strategy, one after the other.

    Args:
      setup: `Setup`. Static.
      seed: uint32.
      numbers_of: `[C]` int32, number of each episode; with the seed it makes the episode's key.
      starts: `[C, 3]` int32, row, col, heading (units of 45 degrees).
      count: int32, episodes to run; the rest of the C are left alone.
      truth, beams, numbers: `Truth`, `Beams`, `Numbers`.

    Returns:
      `Result` with a leading axis C, zeros from `count` on; and grid and trail of the last episode run.
    """
    shape = truth.occupied.shape

    def one(i, state):
        results, _ = state
        key = jax.random.fold_in(jax.random.key(seed), numbers_of[i])
        result, final = episode.run(key, setup, truth, beams, numbers, starts[i])
        results = jax.tree.map(lambda all_, new: all_.at[i].set(new), results, result)
        return results, (final.belief.grid, final.trail)

    blank = jax.eval_shape(
        lambda: episode.run(jax.random.key(0), setup, truth, beams, numbers, jnp.zeros(3, jnp.int32))
    )
    results = jax.tree.map(lambda x: jnp.zeros((starts.shape[0], *x.shape), x.dtype), blank[0])
    last = Grid(jnp.zeros(shape, jnp.int32), jnp.zeros(shape, jnp.int32)), jnp.zeros(blank[1].trail.shape, jnp.int32)
    return lax.fori_loop(0, count, one, (results, last))


class Job(NamedTuple):
    """Episodes of one strategy in one world."""

    world: World
    strategy: Strategy
    starts: np.ndarray  # [N, 3] int, row, col, heading_deg (multiples of 45)
    seed: int = 0  # with the number of the episode (its place in `starts`) it fixes every draw


class Outcomes(NamedTuple):
    """What `run` returns for one job."""

    result: Result  # numpy, with a leading axis N
    first: Final  # the map and the way of episode 0


class Report(NamedTuple):
    """What `run` returns."""

    outcomes: list[Outcomes]  # in the order of the jobs
    compile_s: float  # seconds spent compiling, or loading compiled programs
    run_s: float  # seconds in which compiled programs ran


def start_backend(workers):
    """Starts JAX with as many threads as there are to be workers.

    XLA runs programs on a pool of its own, which must have a thread for every worker. It also splits operations of a
    few thousand elements over the threads of that pool, which costs a lone worker more than it gains (measured: a tenth
    of an episode's time on a quiet machine, a third beside other work): so one worker gets one thread. The size of the
    pool is read from the variable NPROC when JAX starts; this must come before JAX is first used, and changes nothing
    later, as in a notebook that has used JAX before: that costs speed, never results.

    Args:
      workers: threads that will call compiled programs at the same time.
    """
    before = os.environ.get("NPROC")
    os.environ["NPROC"] = str(workers)
    try:
        jax.local_devices()
    finally:
        if before is None:
            del os.environ["NPROC"]
        else:
            os.environ["NPROC"] = before


def use_compilation_cache():
    """Keeps compiled programs on disk, so that a later process need not compile them again.

    In `$JAX_COMPILATION_CACHE_DIR` if that is set, else in `$XDG_CACHE_HOME/jexplore` (`~/.cache/jexplore`). A folder
    that cannot be written means no cache.
    """
    if jax.config.values["jax_compilation_cache_dir"] is None:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jexplore"
        with contextlib.suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


def _final(grid, trail, steps, world):
    """The host's view of the last map and trail."""
    height, width = world.shape
    hits, misses, trail = np.asarray(grid.hits), np.asarray(grid.misses), np.asarray(trail[: steps + 1])
    row, col = np.divmod(trail[:, Track.SPOT] // 4, hits.shape[1])
    target = trail[:, Track.TARGET]
    target_row, target_col = np.where(target < 0, -1, np.divmod(target, hits.shape[1]))
    return Final(
        hits=hits[:height, :width],
        misses=misses[:height, :width],
        rows=row,
        cols=col,
        target_rows=target_row,
        target_cols=target_col,
        looked=trail[:, Track.SPOT] % 4,
        known=trail[:, Track.KNOWN],
    )


class _Line:
    """One job on its way: what is left to do, how long an episode takes, what came back."""

    def __init__(self, job, program, arguments):
        self.job, self.program, self.arguments = job, program, arguments
        self.next, self.episode_s, self.pieces, self.first = 0, None, [], None

    def take(self, workers):
        """The next chunk, `(first episode, number)`: the first episode alone, then as many as take about a second."""
        left = len(self.job.starts) - self.next
        n = 1 if self.episode_s is None else int(CHUNK_S / max(self.episode_s, 1e-6))
        n = max(1, min(n, CHUNK, -(-left // workers)))
        chunk = self.next, n
        self.next += n
        return chunk

    def call(self, first, n):
        """Runs a chunk: `(first, results [n], seconds)`."""
        starts = np.zeros((CHUNK, 3), np.int32)
        starts[:n] = self.job.starts[first : first + n]
        starts[:n, 2] //= 45
        numbers = np.arange(first, first + CHUNK, dtype=np.int32)
        began = time.perf_counter()
        out = self.program(np.uint32(self.job.seed), numbers, starts, np.int32(n), *self.arguments)
        results, last = jax.block_until_ready(out)
        seconds = time.perf_counter() - began
        results = jax.tree.map(lambda a: np.asarray(a)[:n], results)
        if first == 0:
            grid, trail = last
            self.first = _final(grid, trail, int(results.straight[-1] + results.diagonal[-1]), self.job.world)
        return first, results, seconds


def _compile(jobs, lidar, rules, workers):
    """A line for every job. Jobs that differ in numbers only share a program."""
    prepared, programs, lines = {}, {}, []
    for job in jobs:
        key = id(job.world)
        if key not in prepared:
            prepared[key] = prepare(job.world, lidar, rules)
        site = prepared[key]
        arguments = site.truth, site.beams, _numbers(site, job.strategy)
        setup, shape = _setup(site, job.strategy), site.truth.occupied.shape
        kind = setup, shape, jax.tree.map(jnp.shape, arguments)
        programs.setdefault(str(kind), (setup, arguments))
        lines.append((job, str(kind), arguments))
    blank = np.uint32(0), np.zeros(CHUNK, np.int32), np.zeros((CHUNK, 3), np.int32), np.int32(0)

    def compile_one(kind):
        setup, arguments = programs[kind]
        return kind, run_chunk.lower(setup, *blank, *arguments).compile()

    with ThreadPoolExecutor(workers) as pool:
        compiled = dict(pool.map(compile_one, programs))
    return [_Line(job, compiled[kind], arguments) for job, kind, arguments in lines]


def run(jobs, lidar, rules, *, workers=None, on_progress=None):
    """Runs every episode of every job.

    An episode's result depends on its world, start, strategy, seed and number, not on what else runs, nor on how many
    cores.

    Args:
      jobs: list of `Job`, each with at least one start.
      lidar: `Lidar`.
      rules: `Rules`.
      workers: threads; default the number of CPU cores this process may use, and 1 on an accelerator.
      on_progress: called with the number of episodes finished so far, now and then, from the calling thread.

    Returns:
      `Report`.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    start_backend(workers or cores)  # before anything else asks JAX for its devices
    if workers is None:
        workers = cores if jax.default_backend() == "cpu" else 1
    began = time.perf_counter()
    lines = _compile(jobs, lidar, rules, workers)
    compile_s, began = time.perf_counter() - began, time.perf_counter()
    waiting, running, done = list(lines), {}, 0
    pool = ThreadPoolExecutor(workers)
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                line = waiting[0]
                running[pool.submit(line.call, *line.take(workers))] = line
                if line.next >= len(line.job.starts):
                    waiting.remove(line)
                elif line.episode_s is None:  # let the others begin until this one's pace is known
                    waiting.append(waiting.pop(0))
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                line = running.pop(future)
                first, results, seconds = future.result()
                n = len(results.outcome)
                line.episode_s = seconds / n
                line.pieces.append((first, results))
                done += n
            if on_progress is not None:
                on_progress(done)
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    run_s = time.perf_counter() - began
    outcomes = []
    for line in lines:
        assert line.first is not None  # the chunk with episode 0 has run
        pieces = [results for _, results in sorted(line.pieces, key=lambda piece: piece[0])]
        outcomes.append(Outcomes(jax.tree.map(lambda *a: np.concatenate(a), *pieces), line.first))
    return Report(outcomes, compile_s, run_s)
