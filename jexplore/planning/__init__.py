"""Queries of a strategy to the robot's belief: frontiers, their cost, and the path to one of them.

`nearest_frontier` searches growing windows round the robot and computes the whole map only if these do not decide; its
answer always equals that of the whole map. `field` is the whole map at once, for strategies that compare all
candidates.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Self

import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import Array, lax

from jexplore.arrays import bits
from jexplore.arrays.loops import one_kernel, run_if, stored
from jexplore.config import checked_names
from jexplore.frontier import Masks, disc, large_groups, plan_masks
from jexplore.gain import Known
from jexplore.grid import Grid, count, is_free, is_known, is_occupied, lowest
from jexplore.native import kernels
from jexplore.planning.readout import lay_route
from jexplore.reach import DIAGONAL, FAR, MOTIONS, STRAIGHT, saturated, spread

# Longest side of a map, at least -> sides of the windows that are searched first, cells. In the largest they must hold
# what a scanner sees of a long corridor, at whose end the next frontier lies.
WINDOWS = {0: (64, 128), 1024: (64, 256), 2048: (64, 256, 512)}


@struct.dataclass
class MapModel:
    """Thresholds by which a robot tells from counts which cells are free, clear and near."""

    p_free: Array  # float32, largest reflection probability of a free cell
    near_d2: Array  # int32, cells^2, free cells this near to the robot are traversable
    cell_m: Array  # float32, edge of a cell, metres
    clearance_d2: int = struct.field(pytree_node=False)  # cells^2, a clear cell has no occupied one this near
    known_outline: Any = np.bool_(False)  # bool, whether expected gains end at the world's outermost cells
    connectivity: int = struct.field(pytree_node=False, default=8)  # of frontier and unknown cells: 8, or 4
    least: int = struct.field(pytree_node=False, default=1)  # cells of the smallest group that is a frontier
    coarse: bool = struct.field(pytree_node=False, default=False)  # whether corridors may be only a few cells wide
    native: str | None = struct.field(pytree_node=False, default=None)  # `native.kernels` that plan; None: JAX does


@checked_names
@struct.dataclass
class Belief:
    """Belief of the robot: its map and estimated pose."""

    grid: Grid  # [H, W]
    driven: Array  # [H, W] bool, cells stood on, and the orthogonal neighbours of each diagonal step
    exhausted: Array  # [H, W] bool, targets that stayed live however much they were looked at
    row: Array  # int32, the robot's cell, as estimated
    col: Array  # int32
    heading: Array  # int32, units of 45 degrees, estimated
    start: Array  # [3] int32, row, col and heading at the beginning
    extent: Array  # [2] int32, height and width of the world without padding
    model: MapModel
    within: Array | None = None  # [H, W] bool, where the robot may be and what it is to know; None: everywhere
    replace: ClassVar[Callable[..., Self]]


@checked_names
@struct.dataclass
class Choice:
    """A target and what it costs to get there. One of a cost of FAR is refused."""

    row: Array  # int32; -1: there is no target
    col: Array  # int32; -1: there is no target
    cost: Array  # int32, see `reach`; FAR: there is no target, or no path leads to it
    saturated: Any = np.int32(0)  # int32, without a target: cells whose cost does not fit (`reach.saturated`)
    is_view: Any = np.bool_(False)  # bool, whether it is a view point: live while `Policy.live` says so
    overflow: Any = np.int32(
        0
    )  # int32, things that the strategy had no room for (frontier clusters, Voronoi nodes, ...)
    replace: ClassVar[Callable[..., Self]]


@checked_names
@struct.dataclass
class Field:
    """The reachability map of a belief, and its frontier."""

    traversable: Array  # [H, W] bool
    cost: Array  # [H, W] int32
    frontier: Array  # [H, W] bool, reachable frontier cells that are not exhausted
    replace: ClassVar[Callable[..., Self]]


@checked_names
@struct.dataclass
class View:
    """View of a belief for a strategy.

    `path_m` is infinite where no path leads: a gradient through it must mask these cells before it computes with them.
    """

    cost: Array  # [H, W] int32, of the shortest path to every cell (see `reach`); FAR where none leads
    path_m: Array  # [H, W] float32, the same in metres; inf where none leads
    frontier: Array  # [H, W] bool, frontier cells that can be reached and are not exhausted
    belief: Belief
    replace: ClassVar[Callable[..., Self]]


@checked_names
def metres(cost: Array, cell_m: Array | float) -> Array:
    """Convert a path's cost (see `reach`) to a length, metres: float32."""
    return cost.astype(jnp.float32) * (cell_m / STRAIGHT)


def view_of(belief: Belief, reached: Field) -> View:
    """Return the `View` of a belief, from its `Field`."""
    path_m = jnp.where(reached.cost < FAR, metres(reached.cost, belief.model.cell_m), jnp.inf)
    return View(reached.cost, path_m, reached.frontier, belief)


def known_of(belief: Belief) -> Known:
    """Return what expected gains are computed from."""
    model = belief.model
    return Known(belief.grid, model.p_free, belief.within, belief.extent * model.known_outline)


def is_open(belief: Belief, row: Array | int, col: Array | int) -> Array:
    """Return whether a robot would step into a cell inside the map: it is free by the map, or was driven on: bool."""
    here = Grid(belief.grid.hits[row, col], belief.grid.misses[row, col])
    is_open = is_free(here, belief.model.p_free) | belief.driven[row, col]
    return is_open if belief.within is None else is_open & belief.within[row, col]


def is_live(belief: Belief, row: Array | int, col: Array | int) -> Array:
    """Return whether a cell is adjacent, as a frontier cell is, to a cell that is unknown and of interest: bool."""
    height, width = belief.driven.shape
    beside = jnp.asarray(MOTIONS[: belief.model.connectivity], jnp.int32)
    r, c = row + beside[:, 0], col + beside[:, 1]
    inside = (r >= 0) & (r < belief.extent[0]) & (c >= 0) & (c < belief.extent[1])
    r, c = jnp.clip(r, 0, height - 1), jnp.clip(c, 0, width - 1)
    if belief.within is not None:
        inside &= belief.within[r, c]
    return jnp.any(inside & ((belief.grid.hits[r, c] | belief.grid.misses[r, c]) == 0))


def masks_of(belief: Belief, origin: tuple[Array | int, ...] = (0, 0)) -> Masks:
    """Compute `frontier.Masks` of a belief, or of its window that begins at `origin`."""
    rows = lax.broadcasted_iota(jnp.int32, belief.driven.shape, 0) + origin[0]
    cols = lax.broadcasted_iota(jnp.int32, belief.driven.shape, 1) + origin[1]
    inside = (rows < belief.extent[0]) & (cols < belief.extent[1])
    if belief.within is not None:
        inside &= belief.within
    model, row, col = belief.model, belief.row - origin[0], belief.col - origin[1]

    def judge(grid, driven, exhausted, inside, row, col, p_free, near_d2):
        numbers = {"p_free": p_free, "near_d2": near_d2, "clearance_d2": model.clearance_d2}
        numbers |= {"stays_inside": belief.within is not None, "connectivity": model.connectivity}
        return plan_masks(grid, driven, exhausted, inside, row, col, **numbers)

    arguments = belief.grid, belief.driven, belief.exhausted, inside, row, col, model.p_free, model.near_d2
    return one_kernel(judge, *arguments)


def cells_of(belief: Belief) -> Array:
    """Return what native planning is told of every cell, `[H, W]` uint8: the bits of `Plan` in native/plan.h."""
    grid, model, shape = belief.grid, belief.model, belief.driven.shape
    rows, cols = (lax.broadcasted_iota(jnp.int32, shape, axis) for axis in (0, 1))
    inside = (rows < belief.extent[0]) & (cols < belief.extent[1])
    outside = False
    if belief.within is not None:
        inside &= belief.within
        outside = ~inside
    free, near = is_free(grid, model.p_free), disc(shape, belief.row, belief.col, model.near_d2)
    flags = (
        free, free & near, belief.driven, belief.exhausted, is_occupied(grid, model.p_free), inside & ~is_known(grid),
        outside,
    )  # fmt: skip
    return sum((jnp.asarray(flag, jnp.uint8) << i for i, flag in enumerate(flags)), jnp.zeros(shape, jnp.uint8))


@checked_names
def field(belief: Belief, *, nearest_only: bool = False) -> Field:
    """Compute costs of the whole map and the reachable frontier cells.

    With `nearest_only`, static, only the cheapest candidates are wanted; costs above theirs may not be final.

    Source:
      Holz et al. 2010, Figure 3, steps 1 to 4.
    """
    native, height = kernels.target_of(belief.model.native), belief.driven.shape[0]
    if native:
        model, cells = belief.model, cells_of(belief)
        results = [(cells.shape, kind) for kind in (bool, jnp.int32, bool)]
        rules = model.clearance_d2, nearest_only, model.connectivity, model.least
        terms = kernels.numbers([belief.row, belief.col, *rules])
        return Field(*kernels.call(native, "field", results, cells, terms))
    masks = masks_of(belief)
    traversable, frontier = bits.unpack(masks.traversable), bits.unpack(masks.frontier)
    frontier = large_groups(frontier, belief.model.least)
    goals = frontier if nearest_only else None
    cost = spread(masks.traversable, at=(belief.row, belief.col), goals=goals)
    return Field(traversable[:height], cost[:height], (frontier & (cost < FAR))[:height])


def first_at(mask: Array) -> tuple[Array, Array]:
    """Return row and column of the first True cell in (row, col) order; arbitrary without one."""
    height, width = mask.shape
    index = lax.broadcasted_iota(jnp.int32, mask.shape, 0) * width + lax.broadcasted_iota(jnp.int32, mask.shape, 1)
    at = jnp.minimum(lowest(jnp.where(mask, index, height * width)), height * width - 1)
    return at // width, at % width


@checked_names
def choose(belief: Belief, route: Array, reached: Field, row: Array, col: Array) -> tuple[Choice, Array]:
    """Make a cell of a `Field` of the belief the target and lay the route to it: `(choice, route)`.

    Args:
      route: `[H, W]` int8, see `readout`.
      row, col: int32, a cell with a finite cost; -1 for none.
    """
    none = row < 0
    start = (belief.row, belief.col)
    target = (jnp.where(none, belief.row, row), jnp.where(none, belief.col, col))
    native = kernels.target_of(belief.model.native)
    if native:
        maps, terms = (route, reached.cost, reached.traversable), kernels.numbers([*start, *target])
        (route,) = kernels.call(native, "lay", [(route.shape, jnp.int8)], *maps, terms, in_place=1)
    else:
        route = lay_route(route, reached.cost, reached.traversable, start, target, (0, 0))
    cost = jnp.where(none, FAR, reached.cost[target])

    # Only cells whose cost hardly fits can have neighbours whose cost does not.
    dear = lowest(jnp.where(reached.cost < FAR, -reached.cost, 0)) <= DIAGONAL - FAR
    out_of_reach = run_if(none & dear, lambda _: saturated(reached.cost, reached.traversable), jnp.int32(0))
    return Choice(row, col, cost, out_of_reach), route


def nearest_of(reached: Field) -> tuple[Array, Array]:
    """Return row and column of the cheapest candidate, of equal ones the first in (row, col) order; -1 for none."""
    best = lowest(jnp.where(reached.frontier, reached.cost, FAR))
    row, col = first_at(reached.frontier & (reached.cost == best))
    none = best >= FAR
    return jnp.where(none, -1, row), jnp.where(none, -1, col)


def _nearest_in_map(belief, route):
    """Find the nearest frontier of the whole map: `(choice, route)`."""
    reached = field(belief, nearest_only=True)
    return choose(belief, route, reached, *nearest_of(reached))


def windows(shape: Sequence[int], clearance_d2: int) -> list[int]:
    """Return sides of the windows that are searched first, in maps of a shape `(H, W)`.

    A window must be larger than the clearance, and pays only where the whole map is much more work.
    """
    sides = WINDOWS[max(least for least in WINDOWS if least <= max(shape))]
    return [side for side in sides if 4 * math.isqrt(clearance_d2) < side <= max(shape) // 2]


def corner_of(belief: Belief, side: int) -> tuple[tuple[Array, Array], tuple[int, int]]:
    """Return begin, `(row, col)` int32, and shape of the window with a side round the robot."""
    full = belief.driven.shape
    height, width = (min(n, side) for n in full)
    row = jnp.clip(belief.row - side // 2, 0, full[0] - height)
    return (row, jnp.clip(belief.col - side // 2, 0, full[1] - width)), (height, width)


def cut_out(belief: Belief, origin: tuple[Array, ...], shape: tuple[int, ...]) -> Belief:
    """Cut the maps of a belief down to a window; the robot's cell stays as it is in the whole map."""

    def cut(array):
        return lax.dynamic_slice(array, origin, shape)

    return belief.replace(
        grid=Grid(cut(belief.grid.hits), cut(belief.grid.misses)),
        driven=cut(belief.driven),
        exhausted=cut(belief.exhausted),
        within=None if belief.within is None else cut(belief.within),
    )


def nearest_in_window(belief: Belief, route: Array, side: int) -> tuple[Array, Choice, Array]:
    """Find the nearest frontier if a window with a side of `windows` settles it: `(undecided, choice, route)`.

    Windows are as wide as a power of two, because flat indices are then cheap to take apart.
    """
    # What decides about a cell of the window may lie outside it, as far as an occupied cell counts, and one more: up to
    # this cost a window decides, for every path that leaves it costs more.
    radius = side // 2 - math.isqrt(belief.model.clearance_d2) - 2
    bound = radius * STRAIGHT
    origin, shape = corner_of(belief, side)
    window = cut_out(belief, origin, shape)
    row, col = belief.row - origin[0], belief.col - origin[1]
    rows, cols = (jnp.abs(lax.broadcasted_iota(jnp.int32, shape, axis) - at) for axis, at in ((0, row), (1, col)))
    masks = masks_of(window, origin)
    central = stored(row >= 0, lambda: bits.pack((rows <= radius) & (cols <= radius)))
    words, frontier = masks.traversable & central, bits.unpack(masks.frontier & central)
    limit = jnp.where(count((masks.frontier & central) != 0) > 0, bound, -1)  # nothing to look for: not at all
    cost = spread(words, at=(row, col), goals=frontier, limit=limit)
    best = lowest(jnp.where(frontier, cost, FAR))
    decided = best <= bound
    at_row, at_col = first_at(frontier & (cost == best))
    target = (jnp.where(decided, at_row + origin[0], belief.row), jnp.where(decided, at_col + origin[1], belief.col))
    start = (belief.row, belief.col)
    route = lay_route(route, cost, bits.unpack(words), start, target, origin)
    return ~decided, Choice(target[0], target[1], best, jnp.int32(0)), route


@checked_names
def nearest_frontier(belief: Belief, route: Array) -> tuple[Choice, Array]:
    """Find the frontier cell with the shortest path, and the route to it: `(choice, route)`.

    Equal costs go to the lowest flat index; `choice.row` is -1 if no frontier can be reached. `route` is `[H, W]` int8,
    see `readout`.

    Source:
      Holz et al. 2010, equation 3. Changed: windows first.
    """
    if kernels.target_of(belief.model.native) or belief.model.least > 1:  # groups may reach beyond a window
        return _nearest_in_map(belief, route)
    none = jnp.int32(-1)
    state = (jnp.bool_(True), Choice(none, none, jnp.int32(FAR), jnp.int32(0)), route)
    for side in windows(route.shape, belief.model.clearance_d2):

        def search(state, side=side):
            return nearest_in_window(belief, state[2], side)

        state = run_if(state[0], search, state)
    _, choice, route = run_if(state[0], lambda state: (False, *_nearest_in_map(belief, state[2])), state)
    return choice, route
