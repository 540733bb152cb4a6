"""The decision alone, for a robot that somebody else drives: a grid as ROS has it and a pose in, a target out."""

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jexplore.arrays.padding import bucket, number
from jexplore.config import InputError, checked_names, require_number, shown
from jexplore.engine.backend import use_compilation_cache
from jexplore.engine.devices import pinned_draws, random_key
from jexplore.engine.runner import find_resources
from jexplore.exploration.site import COARSE_M, drive_for
from jexplore.grid import Grid, centre_of, radius_d2
from jexplore.planning import Belief, MapModel
from jexplore.policies import Policy, Strategy, strategy
from jexplore.policies.closest import is_nearest, nearest_scored
from jexplore.raycast import Beams, beam_table
from jexplore.reach import FAR, HEADING, MOTIONS, NO_MOTION
from jexplore.rules import Lidar, Rules
from jexplore.studies import checks
from jexplore.worlds.poses import SNAP


@dataclasses.dataclass(frozen=True)
class TargetResult:
    """Result of `next_target`. Points are in the frame of the grid's origin."""

    cell: tuple[int, int] | None
    """Row and column of the target in the grid; None: no frontier can be reached, and exploration is over."""
    pose: tuple[float, float, float] | None
    """Centre of that cell and the heading of the arrival: x_m, y_m, heading_rad; None without a target."""
    path: np.ndarray
    """`[n + 1, 2]` float64, x_m and y_m of the centres of cells, the robot's first, the target last; else `[0, 2]`."""
    path_m: float
    """Length of that path, metres; 0 without a target."""
    scores: np.ndarray | None
    """`[H, W]` float32, what the strategy compares, NaN where it has no candidate: minus the path in metres for
    `closest`, the worth of each cluster's nearest cell, a function's own score. None where they were not wanted, and
    for strategies that draw, plan a tour, look at view points one by one, or prefer rooms, or are a `Policy`."""
    memory: Any
    """The strategy's memory, for the next call."""


@checked_names
def next_target(
    occupancy: np.ndarray, pose: Sequence[float], *, cell_m: float, origin_m: Sequence[float] = (0.0, 0.0),
    strategy: checks.StrategyLike = "closest", driven_m: Any = (), exhausted_m: Any = (), memory: Any = None,
    key: Array | None = None, scores: bool = False, lidar: checks.LidarLike = checks.LIDAR,
    rules: checks.RulesLike = checks.RULES,
) -> TargetResult:  # fmt: skip
    """Choose the next target of a robot from its map, as an episode's robot would.

    A pure function: equal arguments give equal results. Grids of similar size share a compiled program.

    Args:
      occupancy: `[H, W]` int8, `nav_msgs/OccupancyGrid.data` as rows, row 0 at the bottom: -1 unknown, 0 to 100 the
        probability that a cell is occupied, per cent. A cell is free up to `rules.p_free`.
      pose: of the robot: x_m, y_m, heading_rad.
      cell_m: edge of a cell, metres: the grid's `resolution`.
      origin_m: x and y of the corner of cell (0, 0), metres; the grid's axes are those of the frame.
      strategy: as in `compare`. A name or a function is taken as it is when it is first given; one that holds arrays
        must be made once by `jx.strategy`.
      driven_m: `[N, 2]`, x and y of places where the robot has been, the first its start: it may drive there whatever
        the map says. Points outside the grid do not count.
      exhausted_m: `[K, 2]`, targets at which the robot looked all round and that showed nothing: never chosen again.
      memory: of the last result, for strategies that remember (`learned`).
      key: of the strategy's draws; by default always the same.
      scores: whether they are wanted: `closest` then looks at all frontier cells, not the nearest alone.
      lidar: the scanner by which strategies estimate gains.
      rules: of these `clearance_m`, `near_m`, `p_free`, `frontier_connectivity`, `min_frontier_cells` and
        `known_outline` count. By default all beyond the grid is unknown.
    """
    scanner, own = checks.ready_settings(lidar, rules)
    asked, grid = _ready(strategy), _checked(occupancy, own.p_free)
    place = _place(grid, pose, cell_m, origin_m, own)
    maps, at = _padded(grid, place, driven_m, exhausted_m)
    beams, model = _prepared(scanner, own, place.cell_m, maps[0].shape)
    policy, key = asked.policy, random_key(0) if key is None else key
    found = _chosen(policy._replace(params=()), scores, key, policy.params, memory, *maps, at, beams, model)
    return _result(found, asked.name, grid.shape, place)


class _Place(NamedTuple):
    """A grid's frame, and the robot in it."""

    cell_m: float
    corner: tuple[float, float]  # x_m, y_m
    ring: int  # cells by which indices in the padded maps are larger: beyond the edge all is unknown
    robot: np.ndarray  # [2] int64, row and col in the grid
    heading_rad: float

    def cells(self, name: str, points_m: Any) -> np.ndarray:
        """Return the cells of points, `[N, 2]` int64, row and column, wherever they lie."""
        points = _numbers(name, points_m, (-1, 2), "[N, 2] finite numbers, x_m and y_m")
        cells = np.floor(np.round((points - self.corner) / self.cell_m, SNAP))
        return np.clip(cells, -1, 2**20)[:, ::-1].astype(np.int64)


def _place(grid: np.ndarray, pose: Any, cell_m: float, origin_m: Any, rules: Rules) -> _Place:
    """Find the robot; refuse a pose outside the grid, or in a cell that is known not to be free."""
    require_number("cell_m", cell_m, low=1e-3, high=100)
    checks.require_clearance(rules, cell_m, "the grid")
    x_m, y_m, heading_rad = _numbers("pose", pose, (3,), "3 finite numbers, x_m, y_m, heading_rad").tolist()
    left_m, bottom_m = _numbers("origin_m", origin_m, (2,), "2 finite numbers, x_m, y_m").tolist()
    ring = 0 if rules.known_outline else 1
    place = _Place(float(cell_m), (left_m, bottom_m), ring, np.zeros(2, np.int64), heading_rad)
    (robot,) = place.cells("pose", [(x_m, y_m)])
    where = f"pose {shown(tuple(pose))}"
    if not ((robot >= 0) & (robot < grid.shape)).all():
        raise InputError(f"{where}: lies outside the grid of {grid.shape[0]} x {grid.shape[1]} cells")
    here = grid[tuple(robot)]
    if here >= 0 and not _is_free(here, rules.p_free):
        told = f"cell ({robot[0]}, {robot[1]}) is {here}, above {100 * rules.p_free:g}"
        raise InputError(f"{where}: lies in a wall: {told}")
    return place._replace(robot=robot)


def _padded(grid: np.ndarray, place: _Place, driven_m: Any, exhausted_m: Any) -> tuple[list[np.ndarray], np.ndarray]:
    """Return the grid, and driven and exhausted cells as masks, padded; and all numbers of the belief, `[8]` int32."""
    ring, robot = place.ring, place.robot
    shape = bucket(grid.shape[0] + 2 * ring), bucket(grid.shape[1] + 2 * ring)
    maps = [np.full(shape, -1, np.int8), np.zeros(shape, bool), np.zeros(shape, bool)]
    maps[0][ring : ring + grid.shape[0], ring : ring + grid.shape[1]] = grid
    driven = place.cells("driven_m", driven_m)
    for mask, points in zip(maps[1:], (np.vstack([driven, robot]), place.cells("exhausted_m", exhausted_m))):
        inside = ((points >= 0) & (points < grid.shape)).all(axis=1)
        mask[tuple((points[inside] + ring).T)] = True
    heading, start = round(place.heading_rad * 4 / math.pi) % 8, driven[0] if len(driven) else robot
    extent = [n + 2 * ring for n in grid.shape]
    return maps, np.array([*(robot + ring), heading, *(start + ring), heading, *extent], np.int32)


def _result(found: tuple[Any, ...], name: str, shape: tuple[int, ...], place: _Place) -> TargetResult:
    """Convert the output of `_chosen` to metres of the grid's frame."""
    row, col, cost, route, scores, memory = *map(np.asarray, found[:4]), *found[4:]
    ring = place.ring
    if scores is not None:
        scores = np.asarray(scores)[ring : ring + shape[0], ring : ring + shape[1]]
    if row < 0:
        return TargetResult(None, None, np.zeros((0, 2)), 0.0, scores, memory)
    cell = int(row) - ring, int(col) - ring
    if cost >= FAR:
        raise InputError(f"{name}: chose the cell {cell}, to which no path leads")
    way, motions = [tuple(place.robot.tolist())], []
    while way[-1] != cell:
        motions.append(int(route[way[-1][0] + ring, way[-1][1] + ring]))
        drow, dcol = MOTIONS[motions[-1]]
        way.append((way[-1][0] + drow, way[-1][1] + dcol))
    x, y = centre_of(*np.array(way).T, cell_m=place.cell_m, origin_m=place.corner)
    heading_rad = HEADING[motions[-1]] * math.pi / 4 if motions else place.heading_rad
    path_m = place.cell_m * sum(math.sqrt(2) if motion >= 4 else 1.0 for motion in motions)
    return TargetResult(cell, (x[-1], y[-1], heading_rad), np.stack([x, y], axis=1), path_m, scores, memory)


def _checked(occupancy: Any, p_free: float) -> np.ndarray:
    """Return the grid; refuse anything else, or one without a free cell."""
    kind = f"{list(np.shape(occupancy))} {getattr(occupancy, 'dtype', type(occupancy).__name__)}"
    if getattr(occupancy, "dtype", None) != np.int8 or occupancy.ndim != 2 or not occupancy.size:
        raise InputError(f"occupancy must be [H, W] int8, -1 unknown and 0 to 100, got {kind}")
    grid = np.asarray(occupancy)
    low, high = int(grid.min()), int(grid.max())
    if low < -1 or high > 100:
        raise InputError(f"occupancy must lie from -1 (unknown) to 100, got {low} to {high}")
    if not _is_free(grid, p_free).any():
        raise InputError(f"occupancy must have a free cell, from 0 to {100 * p_free:g}, got none in {kind}")
    return grid


def _is_free(grid: np.ndarray, p_free: float) -> np.ndarray:
    return (grid >= 0) & (grid <= np.float32(p_free) * np.float32(100))


def _numbers(name: str, values: Any, shape: tuple[int, ...], what: str) -> np.ndarray:
    """Return finite numbers of a shape, in which -1 is any length."""
    try:
        found = np.asarray(values, float)
    except (TypeError, ValueError):
        found = np.asarray(math.nan)
    if found.shape == (0,) and shape[0] < 0:
        found = found.reshape(0, *shape[1:])
    alike = found.ndim == len(shape) and all(n in (-1, own) for n, own in zip(shape, found.shape))
    if not alike or not np.isfinite(found).all():
        raise InputError(f"{name} must be {what}, got {shown(values)}")
    return found


def _ready(asked: Any) -> Strategy:
    """Return the strategy; a name or a function is made one once, so that it is compiled once."""
    if isinstance(asked, Strategy):
        return asked
    try:
        hash(asked)
    except TypeError:
        raise InputError(
            f"strategy must be a name, a function, or made once by jx.strategy, got {shown(asked)}"
        ) from None
    return _made(asked)


@functools.lru_cache(maxsize=64)
def _made(asked: Any) -> Strategy:
    return strategy(asked)


@functools.lru_cache(maxsize=8)
def _prepared(lidar: Lidar, rules: Rules, cell_m: float, shape: tuple[int, int]) -> tuple[Beams, MapModel]:
    """Return the scanner's beams on the device, and the thresholds of a map."""
    use_compilation_cache()
    find_resources()  # starts JAX
    thresholds: Any = [number(value) for value in (rules.p_free, radius_d2(rules.near_m, cell_m), cell_m)]
    model = MapModel(
        *thresholds,
        clearance_d2=radius_d2(rules.clearance_m, cell_m),
        connectivity=rules.frontier_connectivity,
        least=rules.min_frontier_cells,
        known_outline=np.bool_(rules.known_outline),
        coarse=cell_m > COARSE_M,
        native=drive_for(jax.local_devices()[0].platform).name,
    )
    return jax.device_put((beam_table(lidar.without_noise(), cell_m, shape[1]), model))


@pinned_draws()
@functools.partial(jax.jit, static_argnums=(0, 1))
def _chosen(
    policy: Policy, scores: bool, key: Array, params: Any, memory: Any, cells: Array, driven: Array, exhausted: Array,
    at: Array, beams: Beams, model: MapModel,
) -> tuple[Any, ...]:  # fmt: skip
    """Return row, column and cost of the choice, the map of motions, the scores, and the strategy's memory."""
    row, col, heading, *rest = at
    percent = cells.astype(jnp.int32)
    grid = Grid(jnp.maximum(percent, 0), jnp.where(percent < 0, 0, 100 - percent))
    belief = Belief(grid, driven, exhausted, row, col, heading, jnp.stack(rest[:3]), jnp.stack(rest[3:]), model)
    carry = policy.init(params, belief) if memory is None else memory
    route = jnp.full(cells.shape, NO_MOTION, jnp.int8)
    scored = nearest_scored if is_nearest(policy) else getattr(policy.select, "scored", None)
    select = scored if scores and scored is not None else policy.select
    carry, choice, route, *told = select(key, params, carry, belief, beams, route)
    return choice.row, choice.col, choice.cost, route, told[0] if told else None, carry
