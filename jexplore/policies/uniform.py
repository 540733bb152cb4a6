"""Random frontier: go to a frontier cell drawn uniformly from all that can be reached.

The baseline of Holz et al. 2010, section 3.2.
"""

import jax
import jax.numpy as jnp
from jax import Array

from jexplore.planning import choose, field
from jexplore.policies.policy import Policy, no_carry


def kth_true(mask: Array, k: Array | int) -> tuple[Array, Array]:
    """Return row and column of the k-th True cell in (row, col) order, from 0; k is less than their number."""
    per_row = jnp.sum(mask, axis=1, dtype=jnp.int32)
    until = jnp.cumsum(per_row)
    row = jnp.sum(until <= k, dtype=jnp.int32)
    in_row = k - (until[row] - per_row[row])
    col = jnp.sum(jnp.cumsum(mask[row], dtype=jnp.int32) <= in_row, dtype=jnp.int32)
    return row, col


def _select(key, params, carry, belief, beams, route):
    reached = field(belief)
    n = jnp.sum(reached.frontier, dtype=jnp.int32)
    # Drawn as a number below n, never over the padded map: the draw does not depend on the map's padding.
    row, col = kth_true(reached.frontier, jax.random.randint(key, (), 0, jnp.maximum(n, 1)))
    none = n == 0
    return carry, *choose(belief, route, reached, jnp.where(none, -1, row), jnp.where(none, -1, col))


def uniform() -> Policy:
    """Return the policy. Carry: `()`. Parameters: none."""
    return Policy(no_carry, _select)
