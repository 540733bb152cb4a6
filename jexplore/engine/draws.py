"""Random numbers: the generator that every draw comes from, whatever JAX's own settings say."""

import contextlib
from collections.abc import Generator
from typing import Any

import jax
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
