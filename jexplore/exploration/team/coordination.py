"""Coordinations: which frontier cell a robot goes to, given what it knows of the others.

A coordination is a pure function of a `JointView` and returns a score for every cell, as a user's strategy does: the
robot that plans goes to the reachable frontier cell with the highest one, of equal ones to the first in (row, col)
order; NaN is never chosen; without a finite score it goes to the nearest.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar, Self

import jax.numpy as jnp
from flax import struct
from jax import Array, lax
from optax.assignment import hungarian_algorithm

from jexplore.arrays.loops import run_if
from jexplore.config import checked_names
from jexplore.frontier import frontier_clusters
from jexplore.grid import is_free
from jexplore.planning import Belief, Choice, Field, field
from jexplore.policies.catalogue.adapt import choose_highest
from jexplore.policies.clusters import CLUSTERS
from jexplore.raycast import Beams
from jexplore.reach import FAR, STRAIGHT
from jexplore.segment import PROMINENCE_M, criteria, form_for, segment
from jexplore.users import call_user, described

ASSIGNED = STRAIGHT // 8
"""Unit of costs in an assignment: an eighth of a straight step, so that a float32 holds sums of them exactly."""
MOST_COST = 2**22  # in an assignment, of a label that a robot does not reach


@checked_names
@struct.dataclass
class JointView:
    """A team as the robot that plans knows it. Robots that it does not hear, and those that have ended, are not there.

    All costs are those of its own map.
    """

    robot: Array  # int32, number of the robot that plans
    there: Array  # [N] bool, robots that explore and that it hears, itself included
    cells: Array  # [N, 2] int32, row and col of every robot
    targets: Array  # [N, 2] int32, row and col of the others' targets; -1 for none, and of robots that are not there
    cost: Array  # [H, W] int32, of its own path to every cell (see `reach`); FAR where none leads
    costs: Array  # [N, H, W] int32, the same of every robot; FAR of robots that are not there
    frontier: Array  # [H, W] bool, frontier cells that it can reach and that are not exhausted
    belief: Belief  # of the robot that plans
    range_cells: Array  # float32, range of the scanner
    replace: ClassVar[Callable[..., Self]]


@dataclasses.dataclass(frozen=True)
class Coordination:
    """A coordination by name; equal ones share compiled code."""

    name: str
    function: Callable[[JointView], Any]

    def __call__(self, view: JointView, reached: Field, route: Array) -> tuple[Choice, Array]:
        """Choose a target and lay the way there: `(choice, route)`."""
        what = described(self.function)
        return choose_highest(what, call_user(self.function, what, view), view.belief, reached, route)[:2]


def joint_view(
    belief: Belief, beams: Beams, robot: Array, there: Array, cells: Array, aims: Array
) -> tuple[JointView, Field]:
    """Return the `JointView` of a robot, and its reachability map; arguments as the view's fields."""
    reached = field(belief)

    def costs_of(j: Array) -> Array:
        none = jnp.full_like(reached.cost, FAR)
        at = belief.replace(row=cells[j, 0], col=cells[j, 1])
        return run_if(there[j], lambda _: field(at).cost, none)

    costs = lax.map(costs_of, lax.iota(jnp.int32, there.shape[0]))
    view = JointView(robot, there, cells, aims, reached.cost, costs, reached.frontier, belief, beams.reach)
    return view, reached


def _rank(view: JointView, costs: Array, own: Array) -> Array:
    """Return how many other robots are nearer to some places, of equal ones those with a lower number: int32.

    `costs`: int32 with a leading axis N, of the robots' paths to the places; `own`: those of the robot that plans.
    """
    number = lax.iota(jnp.int32, view.there.shape[0]).reshape(-1, *[1] * own.ndim)
    nearer = (costs < own) | ((costs == own) & (number < view.robot))
    return jnp.sum(nearer & (costs < FAR) & (number != view.robot), axis=0, dtype=jnp.int32)


def _clusters(view: JointView) -> Array:
    """Return the frontier cluster of every cell: `[H, W]` int32, -1 for none."""
    return frontier_clusters(view.frontier, max_clusters=CLUSTERS).label


def _costs_to(view: JointView, label: Array, n: int, costs: Array | None = None) -> Array:
    """Return robots' path costs to the nearest frontier cell of each label: `[N, n]` int32, FAR where none leads."""
    at = jnp.where(view.frontier & (label >= 0), label, n).ravel()
    costs = view.costs if costs is None else costs
    nearest = jnp.full((costs.shape[0], n), FAR, jnp.int32)
    return nearest.at[:, at].min(costs.reshape(costs.shape[0], -1), mode="drop")


def _assigned(view: JointView, costs: Array) -> Array:
    """Return the label that every robot gets when labels are assigned at the least sum of costs: `[N]` int32.

    `costs`: `[N, n]` int32. A robot that gets none, or is not there, has n or more.
    """
    n = view.there.shape[0]
    costs = jnp.where((costs < FAR) & view.there[:, None], jnp.minimum(costs // ASSIGNED, MOST_COST // 2), MOST_COST)
    # A robot that is not there takes a column of no label for nothing.
    spare = jnp.where(view.there[:, None], MOST_COST - 1, 0) + jnp.zeros((1, n), jnp.int32)
    robot, chosen = hungarian_algorithm(jnp.concatenate([costs, spare], axis=1).astype(jnp.float32))
    return jnp.zeros(n, jnp.int32).at[robot].set(chosen.astype(jnp.int32))


def _nearest_of(view: JointView, mine: Array) -> Array:
    """Score the robot's own cells by path, all cells if there are none."""
    return jnp.where(mine | ~jnp.any(mine), -view.cost, -FAR)


def minpos(view: JointView) -> Array:
    """Score frontier clusters by rank, then path: the robot goes where the fewest others are nearer than it.

    Source:
      Bautin, Simonin, Charpillet 2012, MinPos.
    """
    label = _clusters(view)
    costs = _costs_to(view, label, CLUSTERS)
    own = costs[view.robot]
    rank = jnp.where(own < FAR, _rank(view, costs, own), view.there.shape[0])
    chosen = (label >= 0) & (rank == jnp.min(rank))[jnp.maximum(label, 0)]
    return jnp.where(chosen, -view.cost, -FAR)


def voronoi(view: JointView) -> Array:
    """Score frontier cells of the robot's own part by path: those that no other robot is nearer to; else all."""
    return _nearest_of(view, view.frontier & (_rank(view, view.costs, view.cost) == 0))


def greedy(view: JointView) -> Array:
    """Score cells by their utility less what the way costs; utility falls near the targets of others.

    U(t) = 1 - the sum over others' targets t' of max(0, 1 - |t - t'| / range); the way counts in ranges.

    Source:
      Burgard, Moors, Stachniss, Schneider 2005, Algorithm 1 with P(d) of equation 9, for one robot that plans while the
        others keep their targets. Changed: walls between targets are not looked at.
    """
    rows, cols = (lax.broadcasted_iota(jnp.float32, view.cost.shape, axis) for axis in (0, 1))

    def seen_from(aim: Array) -> Array:
        away = jnp.hypot(rows - aim[0], cols - aim[1])
        return jnp.where(aim[0] < 0, 0.0, jnp.maximum(0.0, 1 - away / view.range_cells))

    seen = sum(seen_from(aim) for aim in view.targets)
    return 1 - seen - view.cost / (STRAIGHT * view.range_cells)


def hungarian(view: JointView) -> Array:
    """Score the frontier cluster that the robot gets when all robots and clusters are assigned at the least cost.

    Where there are more robots than clusters some get none, and go to the nearest.
    """
    label = _clusters(view)
    return _nearest_of(view, (label >= 0) & (label == _assigned(view, _costs_to(view, label, CLUSTERS))[view.robot]))


def segments(view: JointView) -> Array:
    """Score the frontier cluster that the robot gets in the segment that it gets, both by assignments.

    A robot in a segment with frontier cells gets it at no cost. Where there are more robots than such segments, some
    may go to clusters of all segments.

    Source:
      Wurm, Stachniss, Burgard 2008, Algorithm 3, by the segments of Holz et al. Changed: a robot's own segment costs
        nothing instead of less; a segment is assigned once.
    """
    model = view.belief.model
    form = form_for(view.cost.shape, coarse=model.coarse)
    parts = segment(
        is_free(view.belief.grid, model.p_free), criteria(prominence=PROMINENCE_M / model.cell_m), form=form
    )
    n = parts.group.shape[0] + 1
    label = jnp.where(parts.label < 0, n - 1, parts.label)  # cells in no segment make one more
    costs = _costs_to(view, label, n)
    is_in = lax.iota(jnp.int32, n) == label[view.cells[:, 0], view.cells[:, 1]][:, None]
    own = _assigned(view, jnp.where(is_in & (costs < FAR), 0, costs))[:, None, None]
    allowed, cluster = (own >= n) | (label == own), _clusters(view)
    costs = _costs_to(view, cluster, CLUSTERS, jnp.where(allowed, view.costs, FAR))
    return _nearest_of(view, (cluster >= 0) & (cluster == _assigned(view, costs)[view.robot]) & allowed[view.robot])


COORDINATIONS: dict[str, Callable[[JointView], Array]] = {
    "greedy": greedy,
    "hungarian": hungarian,
    "minpos": minpos,
    "voronoi": voronoi,
    "segments": segments,
}
"""Name -> coordination, but for `independent`."""
