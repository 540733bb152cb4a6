"""A strategy with a state: to the nearest frontier cell, every third time to the farthest.

    python examples/policy.py

A strategy that remembers, draws, looks ahead or drives to view points is a `jx.Policy(init, select, params, live)`.
`belief` holds the map (`grid.hits`, `grid.misses`), the path, the pose and the `start`; `beams` are the scanner's.
`policies.clusters` and `policies.views` help to choose among frontier clusters or sampled view points. A target that is
no frontier cell is a view point (`choice.is_view`); `live(params, belief, beams, row, col)` tells whether it is live.
"""

import jax
import jax.numpy as jnp

import jexplore as jx


def restless(every: int = 3) -> jx.Policy:
    """Make the strategy; keyword arguments are its parameters."""

    def init(params, belief):
        return jnp.int32(0)

    def select(key, params, plans, belief, beams, route):
        reached = jx.field(belief)  # cost, traversable cells, frontier cells that can be reached
        far = jnp.where(reached.frontier, reached.cost, -1)
        row, col = jnp.unravel_index(jnp.argmax(far), far.shape)
        row, col = (jnp.where(jnp.any(reached.frontier), at, -1) for at in (row, col))  # -1: there is no target
        choices = jx.choose(belief, route, reached, row, col), jx.nearest_frontier(belief, route)
        choice, route = jax.tree.map(lambda a, b: jnp.where(plans % params == params - 1, a, b), *choices)
        return plans + 1, choice, route

    return jx.Policy(init, select, every)


if __name__ == "__main__":
    world = "maze:width_m=6,height_m=6"
    print(jx.compare(world, ["closest", restless, jx.strategy(restless, every=2)], episodes=2).to_markdown())
