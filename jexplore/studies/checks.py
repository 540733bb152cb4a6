"""Checks, loading and drawing before anything is compiled: worlds, strategies, starts, memory."""

import contextlib
import hashlib
import os
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from scipy import ndimage

from jexplore.arrays.bits import WORD
from jexplore.arrays.padding import bucket
from jexplore.config import InputError, InputWarning, as_record, require_different, require_setting, shown
from jexplore.exploration.batch import Job
from jexplore.exploration.metrics import Metric
from jexplore.exploration.site import LEAST_LIMIT, ROBOT
from jexplore.exploration.team.jobs import team_jobs
from jexplore.exploration.uncertain.measures import MEASURES
from jexplore.grid import radius_d2
from jexplore.policies import Policy, Strategy, strategy
from jexplore.raycast import HEADINGS, farthest, n_steps
from jexplore.rules import Lidar, Odometry, Robot, Rules
from jexplore.studies.metrics import MetricsLike, ready_metrics
from jexplore.worlds import load_world
from jexplore.worlds.poses import Pose, cell_of, read_start
from jexplore.worlds.regions import warn_of_floor
from jexplore.worlds.restrict import KnownMap, Polygon, restricted
from jexplore.worlds.starts import check_start, draw_starts, reached_from, start_region
from jexplore.worlds.world import World, require_world, ring_of, ringed_shape, with_ring

WorldLike: TypeAlias = str | os.PathLike[str] | World
"""A world, or the name or file of one."""
StrategyLike: TypeAlias = str | Policy | Strategy | Callable[..., Any]
"""Input of `policies.strategy`."""
LidarLike: TypeAlias = Lidar | Mapping[str, Any]
"""A scanner, or a mapping of those of its fields that are not the defaults."""
RulesLike: TypeAlias = Rules | Mapping[str, Any]
"""`Rules`, or a mapping of some of its fields."""
OdometryLike: TypeAlias = Odometry | Mapping[str, Any] | None
"""`Odometry`, or a mapping of some of its fields; None: that of the rules."""
RobotLike: TypeAlias = Robot | Mapping[str, Any]
"""`Robot`, or a mapping of some of its fields."""
StartLike: TypeAlias = str | tuple[int, int, int] | Pose
"""Start of episodes: see `poses.read_start`."""
LIDAR, RULES = Lidar(), Rules()  # the defaults
CELL_BYTES = 120  # of one episode under way and of the world itself, measured on a CPU; a cell of the padded map
TRAIL_BYTES = 32  # a step
BEAM_BYTES = 64  # a step of a beam, while the table is made
RUN_MEMORY_SHARE = 0.8  # of the machine's memory that a run may be expected to need
LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")  # of a container: cgroup 2 and 1


def list_of(kind: str, items: Any) -> list[Any]:
    """Make a list of one or more different items; a single one may stand for itself."""
    if isinstance(items, (str, os.PathLike, World)):
        items = [items]
    # Of a set it is chance which strategy is the first, with which others are compared.
    if isinstance(items, (set, frozenset)):
        raise InputError(f"{kind} must be a list, got a set, which has no order")
    if isinstance(items, Mapping) or not isinstance(items, Iterable):
        raise InputError(f"{kind} must be a list, got {shown(items)}")
    items = list(items)
    if not items:
        raise InputError(f"{kind} must name at least one, got none")
    return items


def ready_settings(
    lidar: LidarLike, rules: RulesLike, pose: str | None = None, odometry: OdometryLike = None
) -> tuple[Lidar, Rules]:
    """Make scanner and rules from records or from mappings of some of their fields; refuse anything else.

    `pose` and `odometry` are those of the rules, if given.
    """
    own = {name: value for name, value in (("pose", pose), ("odometry", odometry)) if value is not None}
    ready = as_record("rules", rules, Rules).replace(**own)
    if ready.pose == "true" and ready.odometry != Odometry():
        raise InputError("odometry is for robots whose pose is not given: pose must be odometry or icp, got true")
    return as_record("lidar", lidar, Lidar), ready


def measures_of(rules: Rules) -> dict[str, Metric]:
    """Return the measures that episodes have as metrics by their rules: name -> `Metric`."""
    return {} if rules.pose == "true" else dict(MEASURES)


def ready_worlds(worlds: WorldLike | Iterable[WorldLike], cell_m: float) -> list[World]:
    """Make worlds with different names of names and `World` records, in order; a single one may stand for itself."""
    worlds = list_of("worlds", worlds)
    names = [w.name if isinstance(w, World) else str(w) for w in worlds]
    require_different("worlds", names)
    _require_texts(names)
    for world in worlds:
        if isinstance(world, World) and not world.name:
            raise InputError("a world needs a name to be told from others: world.replace(name=...)")
        if not isinstance(world, (str, os.PathLike, World)):
            raise InputError(f"a world must be a name, a path or a World, got {world!r}")
    return [require_world(world) if isinstance(world, World) else load_world(world, cell_m) for world in worlds]


def require_different_buildings(worlds: Iterable[World]) -> None:
    """Refuse one building under two names, such as `cave` and `cave#0`: statistics would count it as two.

    Buildings are the same whose occupied cells, cell size and ground are.
    """
    names: dict[Any, str] = {}
    for world in worlds:
        digest = hashlib.sha256(world.occupied.tobytes())
        if world.elevation is not None:
            digest.update(world.elevation.tobytes())
        known = names.setdefault((world.shape, world.cell_m, digest.digest()), world.name)
        if known != world.name:
            raise InputError(
                f"worlds {known!r} and {world.name!r} are the same building, which would count twice; leave out one of "
                "them, or run more episodes in it"
            )


def ready_strategies(strategies: StrategyLike | Iterable[StrategyLike]) -> list[Strategy]:
    """Make strategies with different names of what `policies.strategy` takes, in order; one may stand for itself."""
    if callable(strategies) or isinstance(strategies, (Policy, Strategy)):
        strategies = [strategies]
    strategies = list_of("strategies", strategies)
    ready = [strategy(given) for given in strategies]
    names = [one.name for one in ready]
    require_different("strategies", names, "; jx.strategy(..., name=...) tells them apart")
    _require_texts(names)
    return ready


def _require_texts(names):
    """Refuse names that tables cannot hold."""
    for name in names:
        if name.encode(errors="replace").decode() != name:
            raise InputError(f"{name!r}: the name of a world or strategy must be UTF-8: call the file otherwise")


def ready_starts(world: World, start: StartLike, n: int, *, seed: int, rules: Rules) -> np.ndarray:
    """Draw or read the starts of n episodes in a world: `[n, 3]` int32, row, col, heading in degrees.

    `start` is "random", drawn, start i the same for every n; else one for all: see `poses.read_start`.
    """
    require_clearance(rules, world.cell_m, repr(world.name))
    start, clearance_m, near_m = read_start(start), rules.clearance_m, rules.near_m
    if start == "random":
        starts = draw_starts(world, seed, n, clearance_m)
        check_start(world, starts[0], clearance_m, near_m)
        warn_of_floor(world, start_region(world, clearance_m), clearance_m, drawn=True)
        return starts
    if start == "world" and world.start is None:
        raise InputError(f"{world.name!r}: has no start of its own; use start random")
    cell: Any = world.start if start == "world" else start
    if isinstance(start, Pose):
        cell = cell_of(world, start)
    try:
        own = check_start(world, cell, clearance_m, near_m)
    except InputError as error:
        raise InputError(f"{start} is {error}" if isinstance(start, Pose) else str(error)) from None
    warn_of_floor(world, reached_from(world, *own[:2], clearance_m, near_m), clearance_m, drawn=False)
    return np.tile(np.asarray(own, np.int32), (n, 1))


def warn_of_share(world: World, lidar: Lidar, rules: Rules) -> None:
    """Warn of a share of the cells to stop at of which more lies out of a scanner's reach than may stay unknown."""
    if rules.stop_at is None:
        return
    ring, free = ring_of(world.occupied), ~with_ring(world).occupied
    stands = np.pad(start_region(world, rules.clearance_m), ring)
    if world.within is not None:
        free &= np.pad(world.within, ring)
    region = ndimage.binary_propagation(stands, mask=free)
    cells = ndimage.binary_dilation(region)  # and their walls
    away: Any = ndimage.distance_transform_edt(~stands)
    near = away * world.cell_m <= lidar.range_m + lidar.mount_m + rules.near_m
    share = (cells & near).sum() / max(cells.sum(), 1)
    if share < rules.stop_at:
        warnings.warn(
            f"{world.name!r}: rules.stop_at {rules.stop_at:g} can hardly be met: {share:.3f} of the cells lie within "
            f"{lidar.range_m:g} m of where a robot with {rules.clearance_m:g} m of clearance has room",
            InputWarning,
            stacklevel=2,
        )


def memory_needed(world: World, lidar: Lidar, rules: Rules, workers: int) -> int:
    """Estimate the bytes that episodes in a world take at a time."""
    rows, cols = (bucket(side) for side in ringed_shape(world.occupied))
    steps = max(LEAST_LIMIT, rows * cols, rules.max_steps or 0)
    beams = HEADINGS * lidar.n_beams * n_steps(farthest(lidar, world.cell_m))
    return workers * (CELL_BYTES * rows * cols + TRAIL_BYTES * steps) + BEAM_BYTES * beams


def _memory():
    """Return the bytes of memory of the machine, or of the container; None if unknown."""
    told = []
    with contextlib.suppress(AttributeError, OSError, ValueError):
        told.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    for file in LIMITS:
        with contextlib.suppress(OSError, ValueError):  # "max" is no limit
            told.append(int(Path(file).read_text(encoding="ascii")))
    return min(told, default=None)


def require_clearance(rules: Rules, cell_m: float, where: str) -> None:
    """Refuse a clearance of more cells than the kernels look across."""
    if radius_d2(rules.clearance_m, cell_m) >= WORD**2:
        most = (WORD - 0.5) * cell_m
        raise InputError(
            f"rules.clearance_m must be below {WORD} cells: at most {most:g} m in {where} with cells of "
            f"{cell_m:g} m, got {rules.clearance_m:g}"
        )


def require_memory(world: World, lidar: Lidar, rules: Rules) -> None:
    """Refuse what would not fit into the machine's memory."""
    have, need = _memory(), memory_needed(world, lidar, rules, os.cpu_count() or 1)
    if have is not None and need > RUN_MEMORY_SHARE * have:
        rows, cols = world.shape
        raise InputError(
            f"{world.name!r}: {rows} x {cols} cells and {lidar.n_beams} beams of {lidar.range_m:g} m need about "
            f"{need / 2**30:.1f} GiB, and the machine has {have / 2**30:.1f}; use a larger cell_m, fewer beams, "
            "a shorter lidar.range_m or a smaller rules.max_steps"
        )


def prepare_jobs(
    worlds: WorldLike | Iterable[WorldLike], strategies: StrategyLike | Iterable[StrategyLike], *, episodes: int,
    seed: int, cell_m: float, start: StartLike, start_m: Sequence[float] | None = None, lidar: LidarLike,
    rules: RulesLike, within: str | Polygon | None = None, from_map: KnownMap | None = None,
    metrics: MetricsLike = None, robot: RobotLike = ROBOT, pose: str | None = None, odometry: OdometryLike = None,
    **team: Any,
) -> list[Job]:  # fmt: skip
    """Check and load everything before `compare` runs: a list of `Job`. Arguments as there; `team` of `teams_of`."""
    lidar, rules = ready_settings(lidar, rules, pose, odometry)
    robot = as_record("robot", robot, Robot)
    episodes, seed = require_setting("episodes", episodes), require_setting("seed", seed)
    start = read_start(start, start_m)
    strategies, own = ready_strategies(strategies), ready_metrics(metrics) | measures_of(rules)
    ready, jobs = ready_worlds(worlds, cell_m), []
    require_different_buildings(ready)
    for world in (restricted(world, within, from_map) for world in ready):
        require_memory(world, lidar, rules)
        starts = ready_starts(world, start, episodes, seed=seed, rules=rules)
        warn_of_share(world, lidar, rules)
        jobs += [
            Job(world, one, starts, seed, lidar=lidar, rules=rules, metrics=own, robot=robot) for one in strategies
        ]
    return team_jobs(jobs, **team, start=start)


def require_key(key: Any) -> None:
    """Refuse anything but one key of JAX."""
    dtype, shape = getattr(key, "dtype", None), getattr(key, "shape", None)
    typed = dtype is not None and jnp.issubdtype(dtype, jax.dtypes.prng_key) and shape == ()
    if not (typed or (dtype == np.uint32 and shape == (2,))):
        got = type(key).__name__ if dtype is None else f"{list(shape or ())} {dtype}"
        raise InputError(f"key must be one jax.random.key(...), got {got}")


def whole_array(name: str, value: Any, shape: tuple[int, ...], meaning: str = "") -> Array:
    """Convert a value to int32 of a shape, which may be traced."""
    expected = f"{name} must be int32 {list(shape)}" + (f", {meaning}" if meaning else "")
    try:
        if not isinstance(value, Array) and np.asarray(value).dtype.kind in "iu":  # 64 bits are not cut off
            value = np.clip(value, -(2**31), 2**31 - 1)
        array = jnp.asarray(value)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{expected}, got {value!r}") from None
    if array.shape != shape or not jnp.issubdtype(array.dtype, jnp.integer):
        raise InputError(f"{expected}, got {list(array.shape)} {array.dtype}")
    return array.astype(jnp.int32)


def concrete(array: Array) -> np.ndarray | None:
    """Return an array's value on the host; None while it is traced."""
    return None if isinstance(array, Tracer) else np.asarray(array)
