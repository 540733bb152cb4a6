"""A program for the engine: fifty random walks of a hundred steps.

    python examples/program.py

A `Program` is `begin(setup, given)`, `advance(setup, given, state)`, `is_done(state)`, `finish(setup, given, state)`
and `detail(state)`. `setup` is hashable and fixed before compiling; `given` holds the run's key, task, shared arrays,
scene and numbers. The engine gives it threads, lanes, progress, Ctrl-C and equal bits.
"""

import jax
import numpy as np

from jexplore.engine.program import Line, Program
from jexplore.engine.runner import find_resources, run_all


def begin(setup, given):
    """Return the state at the start."""
    return {"at": given.task, "n": np.int32(0)}


def advance(setup, given, state):
    """Walk one step to the left or right."""
    key = jax.random.fold_in(given.key, state["n"])
    return {"at": state["at"] + jax.random.rademacher(key, ()), "n": state["n"] + 1}


walk = Program(
    None,
    begin,
    advance,
    lambda state: state["n"] >= 100,
    lambda setup, given, state: state["at"],
    lambda state: state["n"],
)
line = Line(walk, shared=(), scene=np.zeros(1), numbers=(), seed=0, tasks=np.zeros(50, np.int32), which=np.arange(50))

if __name__ == "__main__":
    run_all([line], find_resources())
    print(line.results)
