"""Several devices, each of which works on its own part without a word to the others; programs compiled for them."""

import contextlib
import functools
from collections.abc import Callable, Hashable, Sequence
from typing import Any, Protocol

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jexplore.engine.draws import pinned_draws

AXIS = "device"
PROGRAMS = 32  # compiled programs that are kept in a process
CONFIGURATION = ("jax_default_device", "jax_enable_x64")


class Device(Protocol):
    """A device of JAX's."""

    platform: str

    def memory_stats(self) -> dict[str, int] | None:
        """Return bytes in use and at most; None where a device does not say."""
        ...


def _sharding(devices: Sequence[Device], spec: PartitionSpec) -> Device | NamedSharding:
    return devices[0] if len(devices) == 1 else NamedSharding(_mesh(devices), spec)


def _mesh(devices: Sequence[Device]) -> Mesh:
    return Mesh(np.array(devices), (AXIS,))


def part_sharding(devices: Sequence[Device]) -> Device | NamedSharding:
    """Return where arrays with a leading axis of the devices lie, each part on its device."""
    return _sharding(devices, PartitionSpec(AXIS))


def on_devices(function: Callable[..., Any], devices: Sequence[Device], n_own: int) -> Callable[..., Any]:
    """Turn a function into one whose first `n_own` arguments, and results, have a leading axis of the devices.

    Nothing is exchanged: automatically split loops would put an exchange into every iteration.
    """

    def local(*args: Any) -> Any:
        own = [jax.tree.map(lambda a: a[0], arg) for arg in args[:n_own]]
        return jax.tree.map(lambda a: a[None], function(*own, *args[n_own:]))

    if len(devices) == 1:
        return local

    def call(*args: Any) -> Any:
        specs = tuple(PartitionSpec(AXIS) if i < n_own else PartitionSpec() for i in range(len(args)))
        return jax.shard_map(
            local, mesh=_mesh(devices), in_specs=specs, out_specs=PartitionSpec(AXIS), check_vma=False
        )(*args)

    return call


def whole(tree: Any, devices: Sequence[Device]) -> Any:
    """Put a pytree of arrays on every device, unsplit."""
    return jax.device_put(tree, _sharding(devices, PartitionSpec()))


def parted(tree: Any, devices: Sequence[Device]) -> Any:
    """Put a pytree of arrays with a leading axis of the devices on them, each part on its device."""
    return jax.device_put(tree, part_sharding(devices))


class _Function:
    """A function that is told from others by its name only: what it is made from, hashable."""

    def __init__(self, function: Callable[..., Any], name: Hashable) -> None:
        self.function, self.name = function, name

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Function) and self.name == other.name

    def __hash__(self) -> int:
        return hash(self.name)


def compiled(
    function: Callable[..., Any],
    name: Hashable,
    arguments: tuple[Any, ...],
    devices: Sequence[Device],
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
    options = tuple(filter(_is_option, cpu_options)) if devices[0].platform == "cpu" else ()
    configuration = tuple(str(jax.config.values[option]) for option in CONFIGURATION)
    return _compiled(_Function(function, name), tree, leaves, tuple(devices), donate, options, configuration)


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
    devices: tuple[Device, ...],
    donate: tuple[int, ...],
    options: tuple[tuple[str, Any], ...],
    configuration: tuple[str, ...],
) -> tuple[Callable[..., Any], Any]:
    del configuration  # it only tells programs apart
    other = devices[0].platform != jax.default_backend()  # a CPU in addition to an accelerator
    with pinned_draws(), jax.default_device(devices[0]) if other else contextlib.nullcontext():
        lowered = jax.jit(made.function, donate_argnums=donate).lower(*jax.tree.unflatten(tree, leaves))
    return lowered.compile(compiler_options=dict(options)), lowered.out_info
