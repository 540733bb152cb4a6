"""Programs compiled for a device."""

import contextlib
import dataclasses
import functools
from collections.abc import Callable, Generator, Hashable
from typing import Any, Protocol

import jax
import numpy as np
from jax import Array

from jexplore.config import GENERATOR


def random_key(seed: Any) -> Array:
    """Return a key of `GENERATOR`. `seed`: uint32, or a whole number."""
    return jax.random.key(seed, impl=GENERATOR)


@contextlib.contextmanager
def pinned_draws() -> Generator[None]:
    """Trace with JAX's default generators within the block, or the function that this decorates.

    `JAX_DEFAULT_PRNG_IMPL` and `JAX_THREEFRY_PARTITIONABLE` name others for keys without a generator of their own, as a
    user's strategy may make them, and for the order in which a key's numbers come.
    """
    with jax.default_prng_impl(GENERATOR), jax.threefry_partitionable(True):
        yield


PROGRAMS = 32  # compiled programs that are kept in a process
CONFIGURATION = ("jax_default_device", "jax_enable_x64")


class Device(Protocol):
    """A device of JAX's."""

    platform: str

    def memory_stats(self) -> dict[str, int] | None:
        """Return bytes in use and at most; None where a device does not say."""
        ...


@dataclasses.dataclass(frozen=True)
class _Function:
    """A function that is told from others by its name only: what it is made from, hashable."""

    function: Callable[..., Any] = dataclasses.field(compare=False)
    name: Hashable


def compiled(
    function: Callable[..., Any],
    name: Hashable,
    arguments: tuple[Any, ...],
    device: Device,
    *,
    donate: tuple[int, ...] = (),
    cpu_options: tuple[tuple[str, Any], ...] = (),
) -> tuple[Callable[..., Any], Any]:
    """Compile a function, once in a process for equal names and shapes: `(call, shapes of its result)`.

    Args:
      name: what the function is made from, hashable: with the arguments' shapes it tells it from other functions.
      arguments: pytrees of arrays, or of their shapes.
      donate: numbers of the arguments whose memory may be used again.
      cpu_options: options of XLA on a CPU; one that this version does not have is left out.
    """
    leaves, tree = jax.tree.flatten(arguments)
    leaves = tuple(jax.ShapeDtypeStruct(np.shape(a), a.dtype, sharding=getattr(a, "sharding", None)) for a in leaves)
    options = tuple(filter(_is_option, cpu_options)) if device.platform == "cpu" else ()
    configuration = tuple(str(jax.config.values[option]) for option in CONFIGURATION)
    return _compiled(_Function(function, name), tree, leaves, device, donate, options, configuration)


@functools.cache
def _is_option(option: tuple[str, Any]) -> bool:
    """Return whether this version of XLA knows an option, a pair of name and value."""
    try:
        with jax.default_device(jax.local_devices(backend="cpu")[0]):
            jax.jit(lambda: 0).lower().compile(compiler_options=dict([option]))
    except jax.errors.JaxRuntimeError as error:
        if "No such compile option" not in str(error):
            raise
        return False
    return True


@functools.lru_cache(maxsize=PROGRAMS)
def _compiled(
    made: _Function,
    tree: Any,
    leaves: tuple[jax.ShapeDtypeStruct, ...],
    device: Device,
    donate: tuple[int, ...],
    options: tuple[tuple[str, Any], ...],
    configuration: tuple[str, ...],
) -> tuple[Callable[..., Any], Any]:
    del configuration  # it only tells programs apart
    other = device.platform != jax.default_backend()  # a CPU in addition to an accelerator
    with pinned_draws(), jax.default_device(device) if other else contextlib.nullcontext():
        lowered = jax.jit(made.function, donate_argnums=donate).lower(*jax.tree.unflatten(tree, leaves))
    return lowered.compile(compiler_options=dict(options)), lowered.out_info
