"""A program of pure functions over one robot's state, and the runs to make with it.

A program is written for one robot and knows nothing of batches. Many runs are made one after the other on the cores of
a CPU (`one_by_one`), or together in the lanes of an accelerator (`lanes`): episodes with equal bits, trace runs with
results that are equal but for rounding.
"""

import dataclasses
from collections.abc import Callable, Hashable, Iterable
from typing import Any, ClassVar, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import Array

from jexplore.engine.devices import random_key


@struct.dataclass
class Given:
    """Run context: data of a run apart from its state."""

    key: Array  # of the run; its parts draw from streams of their own
    shared: Any  # pytree that all lanes share: beams, tables
    scenes: Any  # pytree with a leading axis of M scenes (worlds, buildings), shared as well
    scene: Array  # int32, the run's own scene
    numbers: Any  # pytree of the line: its scalars may differ between lanes; its arrays (weights) are shared
    task: Any  # pytree of the run: its start, its settings
    replace: ClassVar[Callable[..., Self]]

    @property
    def own_scene(self) -> Any:
        """Return the run's own scene. If there is only one, all lanes share it."""
        if jax.tree.leaves(self.scenes)[0].shape[0] == 1:
            return jax.tree.map(lambda a: a[0], self.scenes)
        return jax.tree.map(lambda a: a[self.scene], self.scenes)


class Program(NamedTuple):
    """Definition of one robot's life as pure functions. Hashable: equal programs share compiled code.

    A run begins, and then decides and advances until it is done. Deciding is what few robots do at a time and costs
    much: in lanes those that must are gathered. There every function is called on runs that it does not concern as
    well, and what it makes of them is left out.
    """

    setup: Hashable  # static config; the first argument of the functions
    begin: Callable[[Any, Given], Any]  # (setup, given) -> state
    advance: Callable[[Any, Given, Any], Any]  # (setup, given, state) -> state
    is_done: Callable[[Any], Any]  # (state) -> bool
    finish: Callable[[Any, Given, Any], Any]  # (setup, given, state) -> result, a pytree of arrays
    detail: Callable[[Any], Any]  # (state) -> pytree of arrays: detailed record, kept of one run of a line
    decide: Callable[[Any, Given, Any], Any] | Any = None  # (setup, given, state) -> state; or None
    must_decide: Callable[[Any], Any] | None = None  # (state) -> bool, for runs that are not done
    # (setup, given, state that has decided) -> state that must decide or is done: the same as `advance` again and
    # again, for one run on a CPU; None: `advance` does
    drive: Callable[[Any, Given, Any], Any] | None = None
    record: Callable[[Any], Any] | None = None  # (state) -> pytree of arrays: record, kept of every run
    cpu_options: tuple[tuple[str, Any], ...] = ()  # pairs of name and value: options of XLA's compiler on a CPU

    def measure(self, given: Given, state: Any) -> tuple[Any, Any]:
        """Return result and record of a finished run: `(result, record)`."""
        return self.finish(self.setup, given, state), () if self.record is None else self.record(state)

    def waits(self, state: Any) -> Array | bool:
        """Return whether a run that is not done must decide: bool."""
        return False if self.must_decide is None else self.must_decide(state)

    def is_under_way(self, state: Any) -> Array:
        """Return whether a run is to advance: bool."""
        return ~(self.is_done(state) | self.waits(state))


class Runs:
    """Runs that are wanted, and which of them have come back."""

    which: np.ndarray  # [n] int32, numbers of the runs that are to be made here; ascending
    finished: np.ndarray  # [N] bool

    @property
    def n_finished(self) -> int:
        """Return how many runs have come back."""
        return int(self.finished.sum())

    @property
    def is_finished(self) -> bool:
        """Return whether all runs that are wanted here have come back."""
        return bool(self.finished[self.which].all())


@dataclasses.dataclass
class Line(Runs):
    """Runs of one program in one scene that are wanted here, and what has come back."""

    program: Program
    shared: Any
    scene: Any
    numbers: Any
    seed: int
    tasks: Any  # pytree of `[N, ...]` numpy arrays
    which: np.ndarray
    detailed: int = 0  # number of the run of which the detailed record is kept; where it is made, it is the first
    draws: Any = None  # [N] int32, what makes a run's key, with the seed; by default its number
    phase: int = 0  # lines of a later phase are begun when all of this one have been, where runs come one by one
    trim: Callable[[Any, Any], Any] | None = None  # (result, record), numpy -> record of a run on the host
    records: dict[int, Any] = dataclasses.field(default_factory=dict[int, Any], init=False)  # number -> `trim`'s result
    results: Any = dataclasses.field(default=None, init=False)  # pytree of `[N, ...]` numpy arrays; zeros where unknown
    finished: np.ndarray = dataclasses.field(init=False)
    detail: Any = dataclasses.field(default=None, init=False)  # of run `detailed`, numpy; None before

    def __post_init__(self) -> None:
        self.finished = np.zeros(len(jax.tree.leaves(self.tasks)[0]), bool)
        self.which = np.asarray(self.which, np.int32)
        self.draws = np.arange(len(self.finished), dtype=np.int32) if self.draws is None else self.draws

    def make_room(self, shapes: Any) -> None:
        """Allocate results with the shapes of `Program.measure`, if not done."""
        if self.results is None:
            self.results = jax.tree.map(lambda a: np.zeros((len(self.finished), *a.shape), a.dtype), shapes[0])

    def put(self, which: np.ndarray, found: tuple[Any, Any]) -> None:
        """Store results of `Program.measure`: `[k]` numbers of runs, a pytree of `[k, ...]`."""
        jax.tree.map(lambda all_, new: all_.__setitem__(which, new), self.results, found[0])
        if self.trim is not None:
            for i, number in enumerate(which):
                self.records[int(number)] = self.trim(*jax.tree.map(lambda a, i=i: a[i], found))
        self.finished[which] = True

    @property
    def kind(self) -> Hashable:
        """Return the key that two lines must share for a common compiled program. Hashable."""
        task = jax.tree.map(lambda a: a[0], self.tasks)
        leaves, tree = jax.tree.flatten((self.scene, self.shared, self.numbers, task))
        return self.program, tree, tuple((np.shape(a), np.asarray(a).dtype) for a in leaves)

    def shapes(self) -> tuple[Any, Any]:
        """Return the shapes of `Program.measure`, `(result, record)`: pytrees."""
        given = given_of(self)

        return jax.eval_shape(lambda: self.program.measure(given, self.program.begin(self.program.setup, given)))


def given_of(line: Line, number: int = 0) -> Given:
    """Make the `Given` of one of a line's runs."""
    # Ignored types: numpy on the host, where the record says what it is on the device.
    return Given(
        key=jax.random.fold_in(random_key(np.uint32(line.seed)), line.draws[number]),
        shared=line.shared,
        scenes=jax.tree.map(lambda a: a[None], line.scene),
        scene=np.int32(0),  # type: ignore[arg-type]
        numbers=line.numbers,
        task=jax.tree.map(lambda a: a[number], line.tasks),
    )


def split(numbers: Any) -> tuple[list[Any], list[Any], Callable[[Iterable[Any], Iterable[Any]], Any]]:
    """Split a pytree into scalars and arrays, two lists, and a function that joins them: `(scalars, arrays, join)`."""
    leaves, tree = jax.tree.flatten(numbers)
    is_scalar = [jnp.ndim(leaf) == 0 for leaf in leaves]

    def join(scalars: Iterable[Any], arrays: Iterable[Any]) -> Any:
        scalars, arrays = iter(scalars), iter(arrays)
        return jax.tree.unflatten(tree, [next(scalars) if own else next(arrays) for own in is_scalar])

    return [a for a, own in zip(leaves, is_scalar) if own], [a for a, own in zip(leaves, is_scalar) if not own], join
