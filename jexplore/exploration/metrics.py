"""Users' metrics: pure functions of an episode's state, compiled with the rest, one number an episode."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Self

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import Array

from jexplore.arrays.loops import run_if, stored
from jexplore.config import InputError, checked_names, unknown
from jexplore.engine.program import Given
from jexplore.exploration.state import Setup, State, StepCounts
from jexplore.planning import Belief
from jexplore.policies.catalogue.adapt import Theirs, computation_digest, expecting
from jexplore.users import call_user

INT32 = np.iinfo(np.int32)


def _sum(so_far: Array, new: Array) -> Array:
    """Add; an int32 that would wrap stays at its limit, which `reached_limit` finds."""
    found = so_far + new
    if found.dtype != jnp.int32:
        return found
    found = jnp.where((found < so_far) == (new < 0), found, jnp.where(new < 0, INT32.min, INT32.max))
    return jnp.where((so_far == INT32.min) | (so_far == INT32.max), so_far, found)


def reached_limit(values: np.ndarray) -> bool:
    """Return whether one of several sums would have wrapped."""
    return values.dtype == np.int32 and bool(np.isin(values, (INT32.min, INT32.max)).any())


REDUCTIONS: dict[str, Callable[[Any, Any], Any]] = {
    "mean": jnp.add,
    "sum": _sum,
    "max": jnp.maximum,
    "min": jnp.minimum,
    "last": lambda so_far, new: new,
}
"""Ways to make one value of those after every motion: name -> function of the old and the new one."""


@checked_names
@struct.dataclass
class EpisodeView(StepCounts):
    """An episode as a metric sees it. Maps have padding, in which cells are occupied; `belief.extent` is without it."""

    belief: Belief  # the robot's map, pose and start
    occupied: Array  # [H, W] bool, the true world
    rooms: Array  # [H, W] int32, true rooms; -1 outside rooms
    straight: Array  # int32, straight steps
    diagonal: Array  # int32, diagonal steps
    turns: Array  # int32, 45-degree turns
    scans: Array  # int32
    plans: Array  # int32
    n_known: Array  # int32, known cells among those that are to be known
    outcome: Array  # int32, `Outcome`; RUNNING before the end
    poses: Any = None  # `Poses`: true and estimated pose, an exact map; None where the pose is given
    replace: ClassVar[Callable[..., Self]]


COUNTS = [field.name for field in dataclasses.fields(EpisodeView)][3:-1]


@dataclasses.dataclass(frozen=True, repr=False)
class Metric(Theirs):
    """A user's metric."""

    reduce: str | None = None  # how its values after every motion become one; None: it is taken at the end alone

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise InputError(f"{self.what} is no metric: expected a function of an EpisodeView")
        super().__post_init__()

    def __repr__(self) -> str:
        return f"<Metric {self.what}, {self.reduce or 'at the end'}>"

    def __call__(self, view: EpisodeView) -> Array:
        found = call_user(self.function, self.what, view)
        with expecting(self.what, "one bool, int32 or float32", found):
            value = jnp.asarray(found)
            if getattr(found, "dtype", value.dtype) != value.dtype:  # of 64 bits, which JAX would cut
                raise TypeError
            if value.shape != () or value.dtype not in (jnp.bool_, jnp.int32, jnp.float32):
                raise TypeError
        return value.astype(jnp.float32 if self.reduce == "mean" else jnp.promote_types(value.dtype, jnp.int32))


@functools.lru_cache(maxsize=256)
def _digest(metric: Metric, tree: Any, shapes: tuple[Any, ...]) -> str | None:
    view = jax.tree.unflatten(tree, shapes)
    try:
        with jax.disable_jit(False), jax.checking_leaks():
            found = [computation_digest(jax.make_jaxpr(lambda view: metric(view))(view)) for _ in range(2)]
    except InputError:
        raise
    except Exception as error:
        if not str(error).startswith("Leaked"):
            raise
        raise InputError(f"{metric.what} is not pure: it keeps an array that JAX is tracing") from None
    if found[0] != found[1]:
        raise InputError(f"{metric.what} is not pure: two calls with the same state compute different things")
    return found[0]


@checked_names
def metric(function: Any = None, *, reduce: str = "mean") -> Any:
    """Make a metric that is taken after every motion; a bare function is taken at the end.

    It is taken after the scans at the start, and after every motion with the scan that belongs to it.

    Args:
      function: of an `EpisodeView`, pure; returns one bool, int32 or float32. Without it, a decorator.
      reduce: how the values become one, of `REDUCTIONS`: "mean", "sum", "max", "min" or "last". Sums are int32 or
        float32; one that would leave int32 stays at its limit, with a warning in tables.

    Raises:
      InputError: no function, or a reduction that does not exist.
    """
    if reduce not in list(REDUCTIONS):  # a list: no hash is needed
        raise unknown("reduction", str(reduce), list(REDUCTIONS))
    if function is None:
        return functools.partial(metric, reduce=reduce)
    return Metric(function, reduce=reduce)


def episode_view(given: Given, state: Any) -> EpisodeView:
    """Return what a metric sees of a `State`."""
    truth = given.own_scene
    counts = (getattr(state, name) for name in COUNTS)
    return EpisodeView(state.belief, truth.occupied, truth.rooms, *counts, poses=state.poses)


def take_stock(setup: Setup, given: Given, state: State, when: Array) -> State:
    """Count the present values of the metrics that are taken after every motion, where `when`."""
    own = [one for one in setup.metrics if one.reduce]
    if not own:
        return state

    def counted(so_far: Any) -> Any:
        n, old = so_far
        new = [one(episode_view(given, state)) for one in own]
        both = [REDUCTIONS[one.reduce](*values) for one, *values in zip(own, old, new)]
        return n + 1, tuple(jnp.where(n == 0, *values) for values in zip(new, both))

    blank = jnp.int32(0), tuple(jnp.zeros((), jax.eval_shape(one, episode_view(given, state)).dtype) for one in own)
    return state.replace(metrics=run_if(when, counted, state.metrics or blank))


def values_of(setup: Setup, given: Given, state: State) -> tuple[Array, ...]:
    """Return the present values of all metrics, in order."""
    n, values = state.metrics or (jnp.int32(0), ())
    noted, seen = iter(values), episode_view(given, state)

    def now(one: Metric) -> Array:
        return stored(state.row >= 0, lambda: one(seen))

    found = [next(noted) if one.reduce else now(one) for one in setup.metrics]
    return tuple(value / n if one.reduce == "mean" else value for one, value in zip(setup.metrics, found))


def traced_metrics(metrics: Sequence[Metric], given: Given, belief: Any, poses: Any) -> tuple[Metric, ...]:
    """Identify metrics by what they compute, as `adapt.traced_policy` does strategies; the others are of a site.

    Raises:
      InputError: one raises, returns no number, or is not pure: one line that names it.
    """
    counts = dict.fromkeys(COUNTS, jax.ShapeDtypeStruct((), jnp.int32))
    truth = jax.eval_shape(lambda: given.own_scene)
    view = EpisodeView(belief, truth.occupied, truth.rooms, **counts, poses=poses)  # type: ignore[arg-type]
    leaves, tree = jax.tree.flatten(view)
    return tuple(one.anew(_digest(one, tree, tuple(leaves))) for one in metrics)
