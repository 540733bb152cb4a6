"""Random tree: the first node of the best branch of a tree that grows at random from the robot.

Bircher, Kamel, Alexis, Oleynikova, Siegwart, "Receding Horizon 'Next-Best-View' Planner for 3D Exploration", ICRA 2016,
Algorithm 1, as in their package nbvplanner, rrt.cpp, whose values are the defaults: `Gain(n_k) = Gain(n_{k-1}) +
Visible(M, xi_k) exp(-lambda c)`, c the length of the branch up to the node. A tree grows from its node nearest to a
drawn point, up to `edge_m` (and `LONGEST` cells) towards that, where the way is free; on beyond `nodes` nodes while
none shows anything. Of the best branch only the first edge is driven; the others are tried first in the next tree.
Changed: points are drawn from the cells that can be reached, not from a given box; without gain in a full tree the
robot does not stop but goes to the nearest frontier. Left out: yaw (a scan is all round on arrival).
"""

import dataclasses
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jexplore.arrays import bits
from jexplore.arrays.loops import repeat
from jexplore.config import require_number, require_whole
from jexplore.gain import look, prospect
from jexplore.native import kernels
from jexplore.planning import Belief, Choice, Field, choose, field, known_of, nearest_of
from jexplore.policies.policy import MinGain, Policy, Span
from jexplore.policies.views import live
from jexplore.raycast import Beams
from jexplore.reach import FAR

MOST = 200  # largest tree, nodes; as in the package
DRAWS = 1024  # points that are drawn for it at most
REST = 32  # nodes of a branch that are kept at most
LONGEST = 64  # cells of the longest edge


class Params(NamedTuple):
    """Parameters."""

    nodes: int  # of a tree that has found a gain
    lam: float  # 1/m
    edge_m: float
    min_gain: int  # unknown cells that a node must show to count


class Tree(NamedTuple):
    """A tree. Slot 0 is the robot's cell."""

    n: Array  # int32, nodes
    row: Array  # [MOST] int32
    col: Array  # [MOST] int32
    parent: Array  # [MOST] int32
    length_m: Array  # [MOST] float32, of the branch up to the node
    gain: Array  # [MOST] float32, unknown cells, discounted, summed along the branch


def _extend(params: Params, traversable: Array, cell_m: Array, tree: Tree, row: Array, col: Array) -> tuple[Array, ...]:
    """Return the node that a point leads to: `(is free, nearest node, row, col, length of the edge in metres)`."""
    drow, dcol = row - tree.row, col - tree.col
    d2 = jnp.where(lax.iota(jnp.int32, MOST) < tree.n, drow * drow + dcol * dcol, jnp.iinfo(jnp.int32).max)
    near = jnp.argmin(d2).astype(jnp.int32)
    most = jnp.minimum(params.edge_m / cell_m, LONGEST)
    share = jnp.minimum(most / jnp.sqrt(jnp.maximum(d2[near], 1).astype(jnp.float32)), 1.0)
    step = [jnp.round(share * one[near]).astype(jnp.int32) for one in (drow, dcol)]
    # Cells of the edge, and where it steps across a corner both cells next to the step.
    n = jnp.maximum(*map(jnp.abs, step))
    i = jnp.minimum(jnp.arange(LONGEST + 1), n)
    rows, cols = (from_[near] + (2 * i * one + n) // jnp.maximum(2 * n, 1) for from_, one in zip(tree[1:3], step))
    ways = traversable[rows, cols], traversable[rows[1:], cols[:-1]], traversable[rows[:-1], cols[1:]]
    free = (n > 0) & jnp.all(ways[0]) & jnp.all(ways[1] & ways[2])
    return free, near, tree.row[near] + step[0], tree.col[near] + step[1], jnp.hypot(*step) * cell_m


def grown(params: Params, belief: Belief, reached: Field, beams: Beams, row: Array, col: Array) -> Tree:
    """Grow a tree towards `[N]` points, one after the other; row -1: none."""
    beams, native = beams.all_round, kernels.target_of(belief.model.native)
    ahead, cell_m = prospect(known_of(belief), beams), belief.model.cell_m

    def going(state):
        i, tree = state
        wanted = (tree.n <= params.nodes) | (jnp.max(tree.gain) == 0)
        return (i < row.shape[0]) & (tree.n < MOST) & wanted

    def grow(state):
        i, tree = state
        at = jnp.minimum(i, row.shape[0] - 1)
        free, near, node_row, node_col, edge_m = _extend(params, reached.traversable, cell_m, tree, row[at], col[at])
        on = going(state) & free & (row[at] >= 0)
        seen = look(ahead, node_row, node_col, beams, native=native).unknown
        seen = jnp.where((seen >= params.min_gain) & ~belief.exhausted[node_row, node_col], seen, 0)
        length_m = tree.length_m[near] + edge_m
        new = node_row, node_col, near, length_m, tree.gain[near] + seen * jnp.exp(-params.lam * length_m)
        slot = jnp.where(on, tree.n, MOST)
        arrays = (array.at[slot].set(value, mode="drop") for array, value in zip(tree[1:], new))
        return i + going(state), Tree(tree.n + on, *arrays)

    none, zero = jnp.zeros(MOST, jnp.int32), jnp.zeros(MOST, jnp.float32)
    root = Tree(jnp.int32(1), none.at[0].set(belief.row), none.at[0].set(belief.col), none, zero, zero)
    return repeat(going, grow, (jnp.int32(0), root))[1]


def best_branch(tree: Tree) -> tuple[Array, Array]:
    """Return the first node of the branch of most gain, and those after it: int32, `[REST]` int32, -1 for none."""

    def descend(state):
        node, rest = state
        on = tree.parent[node] > 0
        rest = jnp.where(on, jnp.roll(rest, 1).at[0].set(node), rest)
        return jnp.where(on, tree.parent[node], node), rest

    best = jnp.argmax(tree.gain).astype(jnp.int32)
    return repeat(lambda state: tree.parent[state[0]] > 0, descend, (best, jnp.full(REST, -1, jnp.int32)))


def init(params: Any, belief: Belief) -> Array:
    """Return the `init`. Carry: `[2, REST]` int32, row and col of the nodes of the last branch not driven to; -1."""
    return jnp.full((2, REST), -1, jnp.int32)


def _select(
    key: Array, params: Params, carry: Array, belief: Belief, beams: Beams, route: Array
) -> tuple[Array, Choice, Array]:
    reached = field(belief)
    height, width = reached.cost.shape
    cells = reached.cost < FAR
    drawn = jax.random.randint(key, (DRAWS,), 0, jnp.maximum(jnp.sum(cells, dtype=jnp.int32), 1))
    at = bits.nth_cells(bits.pack(cells), drawn)
    points = jnp.where(at < height * width, jnp.stack([at // width, at % width]), -1)
    tree = grown(params, belief, reached, beams, *jnp.concatenate([carry, points], axis=1))
    first, rest = best_branch(tree)
    row, col = nearest_of(reached)
    is_view = (first > 0) & (row >= 0)
    row, col = (jnp.where(is_view, own[first], other) for own, other in ((tree.row, row), (tree.col, col)))
    kept = jnp.where(is_view & (rest >= 0), jnp.stack([tree.row[rest], tree.col[rest]]), -1)
    choice, route = choose(belief, route, reached, row, col)
    return kept, dataclasses.replace(choice, is_view=is_view), route


def random_tree(
    nodes: Annotated[int, Span(10, 100, is_log=True)] = 30,
    lam: Annotated[float, Span(0.01, 5.0, is_log=True)] = 0.5,
    edge_m: Annotated[float, Span(0.3, 3.0)] = 1.0,
    min_gain: MinGain = 10,
) -> Policy:
    """Return the policy. Parameters: `Params`; `min_gain` as of `decision-theoretic`."""
    params = Params(
        require_whole("nodes", nodes, low=1, high=MOST - 1),
        require_number("lam", lam, high=1e6),
        require_number("edge_m", edge_m, low_open=True, high=100),
        require_whole("min_gain", min_gain, low=1, high=2**20),
    )
    return Policy(init, _select, params, live)
