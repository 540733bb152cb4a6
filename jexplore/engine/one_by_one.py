"""One run after the other on each core of a CPU, with true control flow.

Threads share one compiled program.
"""

import functools
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jexplore.arrays.loops import put_one, take_one
from jexplore.engine.devices import Device, compiled, random_key
from jexplore.engine.program import Given, Line, Program
from jexplore.engine.threads import Pieces

CHUNK = 64  # most runs in one call of the compiled program


def run_one(program: Program, given: Given) -> Any:
    """Make one run from its beginning to its end: the state at the end."""

    def advance(state: Any) -> Any:
        return program.advance(program.setup, given, state)

    def decide_and_advance(state: Any) -> Any:
        state = program.decide(program.setup, given, state)
        if program.drive is not None:
            return program.drive(program.setup, given, state)
        return lax.while_loop(program.is_under_way, advance, state)

    state = program.begin(program.setup, given)
    body = advance if program.decide is None else decide_and_advance
    return lax.while_loop(lambda s: ~program.is_done(s), body, state)


def chunk(
    program: Program, draws: Array, tasks: Any, count: Array, seed: Array, scenes: Any, shared: Any, numbers: Any
) -> tuple[Any, Any]:
    """Make `count` runs of one line, one after the other; `draws` and `tasks` have room for C.

    Returns the results with a leading axis C, zeros from `count` on, and the detailed record of the last run made.
    """

    def one(i: Any) -> tuple[Any, Any]:
        key = jax.random.fold_in(random_key(seed), draws[i])
        given = Given(key, shared, scenes, jnp.int32(0), numbers, take_one(tasks, i))
        state = run_one(program, given)
        return program.measure(given, state), program.detail(state)

    def add(i: Any, found: tuple[Any, Any]) -> tuple[Any, Any]:
        result, last = one(i)
        return put_one(found[0], i, result), last

    result, last = jax.eval_shape(one, 0)
    room = jax.tree.map(lambda a: jnp.zeros((draws.shape[0], *a.shape), a.dtype), result)
    return lax.fori_loop(0, count, add, (room, jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), last)))


def compile_chunk(line: Line, device: Device) -> tuple[Callable[..., Any], Any]:
    """Compile the program of a line's kind: `(call, shapes of a result)`.

    `call(draws, tasks, count, seed, scenes, shared, numbers)`.
    """
    task = jax.tree.map(lambda a: np.zeros((CHUNK, *a.shape[1:]), a.dtype), line.tasks)
    blank = np.zeros(CHUNK, np.int32), task, np.int32(0), np.uint32(0)
    arguments, options = (*blank, *_place(line, device), line.numbers), line.program.cpu_options
    function = functools.partial(chunk, line.program)
    call, shapes = compiled(function, (chunk, line.program), arguments, device, cpu_options=options)
    return call, jax.tree.map(lambda a: jax.ShapeDtypeStruct(a.shape[1:], a.dtype), shapes[0])


def _place(line: Line, device: Device) -> Any:
    return jax.device_put((jax.tree.map(lambda a: a[None], line.scene), line.shared), device)


def _pieces(line: Line, call: Callable[..., Any], place: Any) -> Pieces:
    """Divide the runs of a line into `Pieces`; the first comes alone."""
    arguments, size = (np.uint32(line.seed), *place, line.numbers), CHUNK

    def make(first: int, n: int) -> Any:
        which = np.pad(line.which[first : first + n], (0, size - n))
        tasks = jax.tree.map(lambda a: a[which], line.tasks)
        return jax.block_until_ready(call(line.draws[which], tasks, np.int32(n), *arguments))

    def keep(first: int, n: int, found: tuple[Any, Any]) -> None:
        some, (results, last) = line.which[first : first + n], found
        if some[0] == line.detailed:
            line.detail = jax.tree.map(np.asarray, last)
        line.put(some, jax.tree.map(lambda a: np.asarray(a)[:n], results))

    return Pieces(len(line.which), size, make, keep, phase=line.phase)


def pieces_of(lines: Sequence[Line], device: Device, workers: int) -> list[Pieces]:
    """Compile the programs of some lines, and return the `Pieces` of each: their results are put there as they come.

    `workers`: threads, of which each compiles a program at a time.
    """
    kinds = {line.kind: line for line in lines}
    with ThreadPoolExecutor(workers) as pool:
        programs = dict(zip(kinds, pool.map(lambda line: compile_chunk(line, device), kinds.values())))
    places: dict[tuple[int, int], Any] = {}
    found: list[Pieces] = []
    for line in lines:
        key = id(line.scene), id(line.shared)
        if key not in places:
            places[key] = _place(line, device)
        call, shapes = programs[line.kind]
        line.make_room(shapes)
        found.append(_pieces(line, call, places[key]))
    return found
