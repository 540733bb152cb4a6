"""Several devices, each of which works on its own part without a word to the others."""

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

AXIS = "device"


def _mesh(devices):
    return Mesh(np.array(devices), (AXIS,))


def on_devices(function, devices, n_own):
    """A function of arrays as one of arrays with a leading axis of D devices, one part for each.

    Nothing is exchanged: automatically split loops would put an exchange into every iteration.

    Args:
      function: of `n_own` pytrees that differ between devices, then some that do not.
      devices: list of D JAX devices.
      n_own: how many of the arguments have the leading axis.

    Returns:
      function; what it returns has the leading axis as well.
    """

    def local(*args):
        own = [jax.tree.map(lambda a: a[0], arg) for arg in args[:n_own]]
        return jax.tree.map(lambda a: a[None], function(*own, *args[n_own:]))

    if len(devices) == 1:
        return local

    def call(*args):
        specs = tuple(PartitionSpec(AXIS) if i < n_own else PartitionSpec() for i in range(len(args)))
        return jax.shard_map(
            local, mesh=_mesh(devices), in_specs=specs, out_specs=PartitionSpec(AXIS), check_vma=False
        )(*args)

    return call


def whole(tree, devices):
    """A pytree of arrays, all of it on every device."""
    return jax.device_put(tree, devices[0] if len(devices) == 1 else NamedSharding(_mesh(devices), PartitionSpec()))


def parted(tree, devices):
    """A pytree of arrays with a leading axis of the devices, each part on its device."""
    return jax.device_put(tree, devices[0] if len(devices) == 1 else NamedSharding(_mesh(devices), PartitionSpec(AXIS)))
