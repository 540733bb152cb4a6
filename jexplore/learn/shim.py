"""Shim for brax 0.14.2: a function that newer versions of JAX lack, and silence.

Remove it once brax works without.
"""

import contextlib
import io
import warnings
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

NAME = "device_put_replicated"


def replicated(tree: Any, devices: Any) -> Any:
    """Copy a pytree to each device, with a leading axis of the devices on every leaf."""
    each = NamedSharding(Mesh(np.asarray(devices), ("device",)), PartitionSpec("device"))
    return jax.tree.map(lambda leaf: jax.device_put(jnp.stack([jnp.asarray(leaf)] * len(devices)), each), tree)


@contextlib.contextmanager
def quietly() -> Iterator[None]:
    """Silence brax and its imports, which warn of physics engines that are not installed."""
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        yield


@contextlib.contextmanager
def device_put_replicated() -> Iterator[None]:
    """Provide `jax.device_put_replicated` for the block.

    JAX 0.10 took it out, and `brax.training` calls it (github.com/google/brax/issues/671).
    """
    if hasattr(jax, NAME):
        yield
        return
    setattr(jax, NAME, replicated)
    try:
        yield
    finally:
        delattr(jax, NAME)
