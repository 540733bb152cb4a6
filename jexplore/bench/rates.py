"""Peak rates of the machine, from which a kernel's floor is computed."""

import functools
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import lax

from jexplore.bench.timing import interleaved, speed_clock, timed

TURN_S = 0.01  # seconds that one timed call should last
CELLS = 2**12  # elements of the arrays that operations are timed on: they stay in the nearest cache
TURNS = 5


class Effort(NamedTuple):
    """Least work of a kernel, a unit."""

    bytes: float = 0  # of its input and its output, each touched once
    ops: float = 0  # cells visited, one minimum and one addition each
    gathers: float = 0  # cells read one by one
    scatters: float = 0  # cells counted up one by one


def _seconds(body, state):
    """Return the seconds of one round of a loop in a compiled program: the least of some turns."""
    program = jax.jit(lambda n, state: lax.fori_loop(0, n, lambda _, s: body(s), state))
    state = jax.device_put(state)
    jax.block_until_ready(program(np.int32(1), state))
    _, once = timed(lambda: jax.block_until_ready(program(np.int32(8), state)))
    n = np.int32(min(2**30, max(16, 8 * TURN_S / max(once.wall, 1e-7))))
    runs = interleaved({"": lambda: jax.block_until_ready(program(n, state))}, TURNS)
    return min(getattr(took, speed_clock()) for _, took in runs[""]) / int(n)


@functools.cache
def _copy_s(exponent):
    """Return the seconds to touch 2**exponent bytes, half of them read and half written, again and again."""
    return _seconds(lambda x: x + 1, np.zeros(max(1, 2**exponent // 8), np.int32))


def copy_s(n_bytes: float) -> float:
    """Return the seconds to touch a number of bytes, by the speed of a copy of as many (up to a factor of 2)."""
    exponent = min(30, max(10, round(np.log2(max(n_bytes, 1)))))
    return _copy_s(exponent) * n_bytes / 2**exponent


@functools.cache
def op_s() -> float:
    """Return the seconds of one minimum and one addition on an element of a small array."""
    return _seconds(lambda x: lax.min(x + 1, np.int32(2**30)), np.zeros(CELLS, np.int32)) / CELLS


@functools.cache
def gather_s() -> float:
    """Return the seconds to read one element of a small array at a place that no other reading depends on."""
    table = np.random.default_rng(0).permutation(CELLS).astype(np.int32)
    return _seconds(lambda s: (s[0], s[0].at[s[1]].get(mode="clip")), (table, table)) / CELLS


@functools.cache
def scatter_s() -> float:
    """Return the seconds to count up one element of a small array."""
    at = np.random.default_rng(0).permutation(CELLS).astype(np.int32)
    return _seconds(lambda s: (s[0].at[s[1]].add(1, mode="drop"), s[1]), (np.zeros(CELLS, np.int32), at)) / CELLS


def floor_s(work: Effort) -> float:
    """Return the least time of a unit of `Effort`: that of its bytes or that of its operations."""
    ops = ((work.ops, op_s), (work.gathers, gather_s), (work.scatters, scatter_s))
    return max(copy_s(work.bytes) if work.bytes else 0.0, sum(n * rate() for n, rate in ops if n))


def rates() -> dict[str, Any]:
    """Return the rates, as a dict."""
    return {
        "copy_bytes_per_s": {str(2**e): 2**e / _copy_s(e) for e in (14, 18, 22, 26)},
        "ops_per_s": 1 / op_s(),
        "gathers_per_s": 1 / gather_s(),
        "scatters_per_s": 1 / scatter_s(),
    }
