"""Common code of strategies that choose among frontier clusters: clusters, expected scans, distances between them."""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Self

import jax.numpy as jnp
from flax import struct
from jax import Array, lax

from jexplore.arrays import bits
from jexplore.arrays.loops import repeat
from jexplore.frontier import clear_cells, frontier_clusters, most_cells
from jexplore.gain import seen_within, stops_and_unknown
from jexplore.native import kernels
from jexplore.native.kernels import EVERY
from jexplore.planning import Belief, Choice, Field, cells_of, choose, field, known_of, metres
from jexplore.raycast import Beams
from jexplore.reach import FAR, spread

CLUSTERS = 128  # most clusters that are told apart
COARSEST = 4  # cells a side, of the blocks that paths between clusters are measured in


@struct.dataclass
class Targets:
    """A frontier cell for each cluster, the one with the shortest path. M slots, in the order of lowest flat index."""

    row: Array  # [M] int32; -1 in an unused slot
    col: Array  # [M] int32
    used: Array  # [M] bool
    path_m: Array  # [M] float32, from the robot; inf in an unused slot
    size: Array  # [M] int32, frontier cells; 0 in an unused slot
    overflow: Array  # int32, clusters and frontier cells that did not fit
    replace: ClassVar[Callable[..., Self]]


def targets(belief: Belief, reached: Field) -> Targets:
    """Find the `Targets` of a belief and its `Field`."""
    native = kernels.target_of(belief.model.native)
    if native:
        results = [((3, CLUSTERS), jnp.int32), ((2,), jnp.int32)]
        most = kernels.numbers([most_cells(reached.cost.shape)])
        (row, col, size), told = kernels.call(native, "clusters", results, reached.frontier, reached.cost, most)
        overflow = jnp.maximum(told[0] - CLUSTERS, 0) + told[1]
    else:
        found = frontier_clusters(reached.frontier, reached.cost, max_clusters=CLUSTERS)
        row, col, size, overflow = found.row, found.col, found.size, found.overflow + found.left_out
    used = row >= 0
    cost = reached.cost[jnp.maximum(row, 0), jnp.maximum(col, 0)]
    path_m = jnp.where(used, metres(cost, belief.model.cell_m), jnp.inf)
    return Targets(row, col, used, path_m, size, overflow)


def looks(
    belief: Belief, at: Targets, beams: Beams, radii_m: Sequence[float] = (math.inf,), enough: Array | int = EVERY
) -> Array:
    """Count cells that a look-around at every target would see: `[R + 1, M]` int32, 0 if unused.

    Unknown cells within R distances, then known ones. Native code stops at `enough` unknown cells: their number is
    exact below that, else at least that.
    """
    d2 = (jnp.asarray(radii_m, jnp.float32) / belief.model.cell_m) ** 2
    beams, native = beams.all_round, kernels.target_of(belief.model.native)
    maps = stops_and_unknown(known_of(belief), beams)
    if native:
        where = jnp.stack([at.row, at.col]), jnp.sum(at.used, dtype=jnp.int32), beams
        return kernels.look(native, *maps, *where, d2, enough)
    blank = jnp.zeros((len(radii_m) + 1, *at.row.shape), jnp.int32)
    return at_each(at, lambda row, col: seen_within(*maps, row, col, beams, d2), blank)


def at_each(at: Targets, tell: Callable[[Array, Array], Array], blank: Array) -> Array:
    """Write `tell(row, col)`, `[...]`, of every target into an array, `[..., M]`."""
    n = jnp.sum(at.used, dtype=jnp.int32)  # used slots come first

    def evaluate(state):
        i, told = state
        here = jnp.minimum(i, at.row.shape[0] - 1)
        new = tell(jnp.maximum(at.row[here], 0), jnp.maximum(at.col[here], 0))
        on = i < n
        return i + on, told.at[..., jnp.where(on, i, told.shape[-1])].set(new, mode="drop")

    return repeat(lambda state: state[0] < n, evaluate, (jnp.int32(0), blank))[1]


def block_side(clearance_d2: int) -> int:
    """Return the side of the largest blocks, cells, that count as passable if one of their cells is clear. Static.

    No path through a straight wall arises: the cells around it that are not clear are at least 2 r + 1 cells thick.
    """
    return min(COARSEST, math.isqrt(clearance_d2) + 1)


def paths_apart(belief: Belief, at: Targets) -> Array:
    """Estimate path lengths between all targets: `[M, M]` float32, metres, symmetric.

    0 on the diagonal of used slots; inf where a slot is unused or no path leads. The map is reduced to blocks of up to
    4 x 4 cells, counted from the robot's start, which are passable if they hold a clear cell or one that was driven on.
    Slanting walls and slivers of unknown cells thinner than a block may be crossed.
    """
    side, n = block_side(belief.model.clearance_d2), jnp.sum(at.used, dtype=jnp.int32)
    native = kernels.target_of(belief.model.native)
    if native:
        terms = kernels.numbers([n, side, belief.model.clearance_d2, *(-belief.start[:2] % side)])
        result = [(2 * at.row.shape, jnp.int32)]
        (table,) = kernels.call(native, "apart", result, cells_of(belief), jnp.stack([at.row, at.col]), terms)
    else:
        table = _costs_apart(belief, at, n, side)
    table = jnp.where(at.used[None] & at.used[:, None], table, FAR)
    return jnp.where(table < FAR, metres(table, side * belief.model.cell_m), jnp.inf)


def _costs_apart(belief, at, n, side):
    """Compute `costs_between` of blocks."""
    # Without the traversable cells near the robot: at a thin wall too little would remain.
    clear = clear_cells(belief.grid, p_free=belief.model.p_free, clearance_d2=belief.model.clearance_d2) | belief.driven
    height, width = ((size + side - 1) // side + 1 for size in clear.shape)
    top, left = -belief.start[:2] % side  # the start is the corner of a block, wherever in the map it lies
    cells = lax.dynamic_update_slice(jnp.zeros((height * side, width * side), bool), clear, (top, left))
    blocks = cells.reshape(height, side, width, side).any(axis=(1, 3))
    return costs_between(blocks, (jnp.maximum(at.row, 0) + top) // side, (jnp.maximum(at.col, 0) + left) // side, n)


def costs_between(passable: Array, row: Array, col: Array, n: Array | int) -> Array:
    """Compute costs of the paths between the first n of some cells, `[M]` int32 each, all of them passable.

    Returns `[M, M]` int32, as of `reach.reach`, symmetric; arbitrary where not both are of the first n.
    """
    words, m = bits.pack(passable), row.shape[0]
    blank = jnp.full((bits.WORD * words.shape[0], words.shape[1]), FAR, jnp.int32)

    def measure(state):
        i, table = state
        here = jnp.minimum(i, m - 1)
        cost = spread(words, blank.at[row[here], col[here]].set(0))
        return i + (i < n), table.at[jnp.where(i < n, i, m)].set(cost[row, col], mode="drop")

    return repeat(lambda state: state[0] < n, measure, (jnp.int32(0), jnp.full((m, m), FAR, jnp.int32)))[1]


def go_to(belief: Belief, route: Array, reached: Field, at: Targets, which: Array) -> tuple[Choice, Array]:
    """Make a target the choice: `(choice, route)`. `which`: int32 slot; -1 for none."""
    none = which < 0
    slot = jnp.maximum(which, 0)
    choice, route = choose(belief, route, reached, jnp.where(none, -1, at.row[slot]), jnp.where(none, -1, at.col[slot]))
    return dataclasses.replace(choice, overflow=at.overflow), route


@dataclasses.dataclass(frozen=True)
class Best:
    """The `select` of a strategy that goes to the cluster of greatest worth; equal for the same one: compiled once."""

    judge: Callable[[Any, Belief, Targets, Beams], tuple[Array, Array]]
    """`(params, belief, targets, beams) -> (worth, usable)`: `[M]` float32, and bool as of `best_of`."""

    def __call__(self, *given: Any) -> tuple[Any, Choice, Array]:
        return self.scored(*given)[:3]

    def scored(
        self, key: Array, params: Any, carry: Any, belief: Belief, beams: Beams, route: Array
    ) -> tuple[Any, Choice, Array, Array]:
        """Choose, and return the worths as well: `(carry, choice, route, scores)`, see `at_targets`."""
        reached = field(belief)
        at = targets(belief, reached)
        worth, usable = self.judge(params, belief, at, beams)
        return carry, *go_to(belief, route, reached, at, best_of(at, worth, usable)), at_targets(at, worth, route.shape)


def at_targets(at: Targets, values: Array, shape: tuple[int, ...]) -> Array:
    """Write values `[M]` into the cells of their targets: `[H, W]` float32, NaN elsewhere."""
    return jnp.full(shape, jnp.nan).at[jnp.where(at.used, at.row, shape[0]), at.col].set(values, mode="drop")


def best_of(at: Targets, worth: Array, usable: Array) -> Array:
    """Return the slot of greatest worth among the usable, else that with the shortest path; -1 without targets."""
    usable = usable & at.used
    chosen = jnp.argmax(jnp.where(usable, worth, -jnp.inf))
    nearest = jnp.argmin(at.path_m)
    which = jnp.where(jnp.any(usable), chosen, nearest).astype(jnp.int32)
    return jnp.where(jnp.any(at.used), which, -1)
