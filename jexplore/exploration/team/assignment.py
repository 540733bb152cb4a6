"""The assignment problem: each row gets a column of its own, at the least total cost."""

import jax
import jax.numpy as jnp
from jax import Array, lax

MOST_COST = 2**22
"""Largest cost: with up to 16 rows no sum of costs leaves int32."""


@jax.jit
def assign(cost: Array) -> Array:
    """Return the column of every row in an assignment of least total cost.

    Args:
      cost: `[R, M]` int32, 0 to `MOST_COST`; R at most M, and at most 16.

    Returns:
      `[R]` int32, all different. Of equally good assignments it is some one, the same for the same costs.

    Source:
      Jonker and Volgenant 1987, its shortest augmenting paths: rows are added one at a time.
    """
    n, m = cost.shape
    none = jnp.int32(2**30)

    def add_row(new: Array, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        """Assign one more row; column m stands for the row that is added."""
        u, v, row_of = state

        def extend(search: tuple[Array, ...]) -> tuple[Array, ...]:
            u, v, at, used, least, came_from = search
            used = used.at[at].set(True)
            row = row_of.at[m].set(new)[at]
            reduced = cost[row] - u[row] - v[:m]
            closer = ~used[:m] & (reduced < least)
            least, came_from = jnp.where(closer, reduced, least), jnp.where(closer, at, came_from)
            step, to = jnp.min(jnp.where(used[:m], none, least)), jnp.argmin(jnp.where(used[:m], none, least))
            rows = jnp.where(used, row_of.at[m].set(new), n)
            u = u.at[rows].add(step, mode="drop")
            v = jnp.where(used, v - step, v)
            return u, v, to.astype(jnp.int32), used, jnp.where(used[:m], least, least - step), came_from

        search = u, v, jnp.int32(m), jnp.zeros(m + 1, bool), jnp.full(m, none), jnp.full(m, m, jnp.int32)
        search = lax.while_loop(lambda s: (s[2] == m) | (row_of[s[2]] >= 0), extend, search)
        u, v, at, _, _, came_from = search
        full = row_of.at[m].set(new)

        def shift(both: tuple[Array, Array]) -> tuple[Array, Array]:
            at, rows = both
            return came_from[at], rows.at[at].set(rows[came_from[at]])

        _, rows = lax.while_loop(lambda both: both[0] != m, shift, (at, full))
        return u, v, rows.at[m].set(-1)

    state = jnp.zeros(n, jnp.int32), jnp.zeros(m + 1, jnp.int32), jnp.full(m + 1, -1, jnp.int32)
    row_of = lax.fori_loop(0, n, add_row, state)[2][:m]
    return jnp.full(n, -1, jnp.int32).at[jnp.where(row_of >= 0, row_of, n)].set(lax.iota(jnp.int32, m), mode="drop")
