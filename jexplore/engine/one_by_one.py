"""One run after the other on each core of a CPU, with true control flow.

Threads share one compiled program; several devices each run a part of every call.
"""

import functools
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jexplore.engine.devices import compiled, on_devices, whole
from jexplore.engine.draws import random_key
from jexplore.engine.program import Given, Line, Program
from jexplore.engine.threads import Pace, Pieces, share_out

CHUNK = 64  # most runs in one call of the compiled program on one device


def run_one(program: Program, given: Given) -> Any:
    """Make one run from its beginning to its end: the state at the end."""

    def advance(state):
        return program.advance(program.setup, given, state)

    def turn(state):
        state = program.decide(program.setup, given, state)
        if program.drive is not None:
            return program.drive(program.setup, given, state)
        return lax.while_loop(program.is_under_way, advance, state)

    state = program.begin(program.setup, given)
    return lax.while_loop(lambda s: ~program.is_done(s), advance if program.decide is None else turn, state)


def chunk(
    program: Program, draws: Array, tasks: Any, count: Array, seed: Array, scenes: Any, shared: Any, numbers: Any
) -> tuple[Any, Any]:
    """Make up to C runs of one line, one after the other.

    Args:
      program: `Program`. Static.
      draws: `[C]` int32, with the seed it makes the run's key.
      tasks: pytree of `[C, ...]`.
      count: int32, runs to make; the rest of the C are left alone.
      seed: uint32.
      scenes, shared, numbers: as in `Given`.

    Returns:
      results with a leading axis C, zeros from `count` on; and the record of the last run made.
    """

    def one(i):
        key = jax.random.fold_in(random_key(seed), draws[i])
        task = jax.tree.map(lambda a: lax.dynamic_index_in_dim(a, i, 0, False, allow_negative_indices=False), tasks)
        given = Given(key, shared, scenes, jnp.int32(0), numbers, task)
        state = run_one(program, given)
        return program.measure(given, state), program.keep(state)

    def put(i, found):
        result, last = one(i)
        return jax.tree.map(lambda all_, new: _with(all_, i, new), found[0], result), last

    result, last = jax.eval_shape(one, 0)
    room = jax.tree.map(lambda a: jnp.zeros((draws.shape[0], *a.shape), a.dtype), result)
    return lax.fori_loop(0, count, put, (room, jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), last)))


def _with(all_, i, new):
    """Replace entry i of an array. A scatter, one for every part of a result, would take longer to compile."""
    return lax.dynamic_update_index_in_dim(all_, jnp.asarray(new, all_.dtype), i, 0, allow_negative_indices=False)


def compile_chunk(line: Line, devices: Sequence[Any]) -> tuple[Callable[..., Any], Any]:
    """Compile the program of a line's kind: `(call, shapes of a result)`.

    `call(draws, tasks, count, seed, scenes, shared, numbers)`, the first three with a leading axis of the devices.
    """
    d, size = len(devices), CHUNK
    task = jax.tree.map(lambda a: np.zeros((d, size, *a.shape[1:]), a.dtype), line.tasks)
    function = on_devices(functools.partial(chunk, line.program), devices, 3)
    blank = np.zeros((d, size), np.int32), task, np.zeros(d, np.int32)
    place = whole((jax.tree.map(lambda a: a[None], line.scene), line.shared), devices)
    arguments, options = (*blank, np.uint32(0), *place, line.numbers), line.program.cpu_options
    call, shapes = compiled(function, (chunk, line.program), arguments, devices, cpu_options=options)
    return call, jax.tree.map(lambda a: jax.ShapeDtypeStruct(a.shape[2:], a.dtype), shapes[0])


def _pieces(line, call, place, d, pace):
    """Divide the runs of a line into `Pieces`: device i takes runs i, i + d, ...; the first comes alone on device 0."""
    arguments, size = (np.uint32(line.seed), *place, line.numbers), CHUNK

    def parts(first, n):
        some = line.which[first : first + n]
        return [some[i::d] for i in range(d)]

    def make(first, n):
        mine = parts(first, n)
        which = np.stack([np.pad(some, (0, size - len(some))) for some in mine])
        tasks = jax.tree.map(lambda a: a[which], line.tasks)
        count = np.array([len(some) for some in mine], np.int32)
        began = time.perf_counter()
        found = jax.block_until_ready(call(line.draws[which], tasks, count, *arguments))
        return found, time.perf_counter() - began

    def keep(first, n, found):
        mine, (results, last) = parts(first, n), found
        if mine[0][0] == line.keeps:
            line.kept = jax.tree.map(lambda a: np.asarray(a)[0], last)
        results = jax.tree.map(np.asarray, results)
        for i, some in enumerate(mine):
            line.put(some, jax.tree.map(lambda a, i=i, some=some: a[i, : len(some)], results))

    return Pieces(
        total=len(line.which),
        most=size,
        call=make,
        keep=keep,
        n_devices=d,
        turn=line.turn,
        pace=pace,
        first_alone=line.keeps >= 0,
    )


def run_one_by_one(
    lines: Sequence[Line],
    devices: Sequence[Any],
    workers: int,
    costs: Any,
    on_progress: Callable[[int], object],
) -> None:
    """Make every run of some lines.

    Args:
      lines: list of `Line`; results are put there as they come.
      devices: list of JAX devices of one kind.
      workers: threads; 1 where there are several devices.
      costs: `Costs`, added to.
      on_progress: called with the number of finished runs, from the calling thread.

    Raises:
      KeyboardInterrupt: after running calls have ended; their results are kept.
    """
    began = time.perf_counter()
    kinds, places = {line.kind: line for line in lines}, {}
    with ThreadPoolExecutor(workers) as pool:
        programs = dict(zip(kinds, pool.map(lambda line: compile_chunk(line, devices), kinds.values())))
    work, paces = [], {}
    for line in lines:
        place = id(line.scene), id(line.shared)
        if place not in places:
            places[place] = whole((jax.tree.map(lambda a: a[None], line.scene), line.shared), devices)
        call, shapes = programs[line.kind]
        line.make_room(shapes)
        pace = paces.setdefault((line.kind, id(line.scene), id(line.numbers)), Pace())
        work.append(_pieces(line, call, places[place], len(devices), pace))
    costs.compile_s += time.perf_counter() - began
    began = time.perf_counter()
    try:
        share_out(work, workers, on_progress)
    finally:
        costs.run_s += time.perf_counter() - began
