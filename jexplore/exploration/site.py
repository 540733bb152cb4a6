"""A world made ready for episodes: padded, with the scanner's beams traced, and all numbers of the rules, once."""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from numpy.typing import ArrayLike

from jexplore import reach
from jexplore.arrays.padding import bucket, number
from jexplore.config import InputError
from jexplore.engine.program import Given, Line
from jexplore.exploration import environment
from jexplore.exploration.episode import program_of
from jexplore.exploration.metrics import Metric, traced_metrics
from jexplore.exploration.motion import LENGTHS, clock_table
from jexplore.exploration.state import NEVER, WHOLE, Numbers, Setup, Truth
from jexplore.exploration.trail import record_of
from jexplore.exploration.uncertain.poses import Unsure, UnsureNumbers, blank_poses
from jexplore.exploration.uncertain.pursuit import ride_numbers
from jexplore.grid import in_cells, radius_d2
from jexplore.native.build import Library, warn_once
from jexplore.native.drive import load_driving
from jexplore.planning import MapModel
from jexplore.policies.catalogue import adapt
from jexplore.policies.policy import Strategy
from jexplore.raycast import (
    HEADINGS,
    Beams,
    beam_angles_deg,
    beam_table,
    exact_direction,
    farthest,
    scans_all_round,
)
from jexplore.rules import Lidar, Robot, Rules
from jexplore.slam2d.mapping import Sizes
from jexplore.slam2d.points import cell_m as index_cell_m
from jexplore.slam2d.settings import SlamSettings
from jexplore.worlds.world import World, ring_of, with_ring

LEAST_LIMIT = 20_000  # default bound of steps and plans on small maps
ROBOT = Robot()
# A scan from new ground lies half on the map, and matches all the same. Errors of simulated ranges are independent:
# with the correlation of recorded logs the trajectory error is 3.6 times as large (8 episodes in the cave).
# Turns by 45 degrees are uncertain odometry: nine of ten points on the map tell that they went well without a search.
MATCHING = SlamSettings(min_share=0.5, plain_share=0.9, correlation=1.0)
MARGIN_M = 1.0  # m, by which the point map is larger than the world on every side
MOST_POINTS = 2**15  # of the point map: 1.6 km of walls
MOST_KEYS, MOST_LOOPS = 1024, 128  # key scans and loops of a robot that closes them: some 300 m of way
COARSE_M = 0.15  # cells longer than this are coarse: a corridor is a few of them wide


def drive_for(platform: str) -> Library:
    """Return the library that drives one robot, built if need be; its name is a target of JAX's FFI, None: JAX drives.

    Only a CPU has native driving. Warns once in a process where it cannot be built.
    """
    is_native = platform == "cpu" and not jax.config.values["jax_disable_jit"]
    found = load_driving() if is_native else Library(None)
    if found.why_not:
        warn_once(found.why_not)
    return found


class Site(NamedTuple):
    """A world, a scanner and rules, ready for the episodes of any strategy."""

    truth: Truth
    beams: Beams
    setup: Setup  # of no policy yet
    numbers: Numbers  # of no policy yet
    ring: int  # cells by which indices in these maps are larger than the world's

    def with_strategy(self, strategy: Strategy) -> tuple[Setup, Numbers]:
        """Return the `Setup` and the `Numbers` of a strategy here: `(setup, numbers)`."""
        policy = strategy.policy
        try:
            params = jax.tree.map(number, policy.params)
        except (TypeError, ValueError):
            raise InputError(f"{strategy.name}: params of a Policy must be numbers and arrays") from None
        numbers = self.numbers.replace(recheck=np.bool_(strategy.recheck), params=params)
        if adapt.is_theirs(policy):  # traced here, and refused if its result is wrong
            route = jax.ShapeDtypeStruct(self.truth.occupied.shape, np.int8)
            policy = adapt.traced_policy(policy, params, _example(self, numbers)[1], self.beams, route)
        return self.setup._replace(policy=policy._replace(params=())), numbers


def _example(site: Site, numbers: Numbers) -> tuple[Given, Any, Any]:
    """Return a `Given` of a site, and the shapes of belief and poses at the start, for tracing users' functions."""
    truth = jax.tree.map(lambda a: a[None], site.truth)
    task = np.zeros(3, np.int32)
    # Ignored types: numpy on the host, where the record says what it is on the device.
    given = Given(np.zeros((), np.int32), site.beams, truth, np.int32(0), numbers, task)  # type: ignore[arg-type]
    belief = jax.eval_shape(environment.blank_belief, given)
    unsure, capacity = site.setup.unsure, site.setup.capacity
    poses = unsure and jax.eval_shape(
        lambda grid, task: blank_poses(unsure, grid, capacity, task, task[0]), belief.grid, task
    )
    # A function is told by what it computes, by whatever code.
    return given, belief.replace(model=belief.model.replace(native=None)), poses


def prepare_site(
    world: World,
    lidar: Lidar,
    rules: Rules,
    shape: tuple[int, int] | None = None,
    *,
    robot: Robot = ROBOT,
    native: str | None = None,
    shared_with: Sequence[tuple[Lidar, Rules]] = (),
    metrics: Sequence[Metric] = (),
) -> Site:
    """Prepare a world, in numpy: add a ring if needed, pad it and trace the scanner's beams.

    Args:
      shape: `(H, W)` to which the world is padded; by default the next that many worlds share.
      robot: how long its motions take.
      native: target of native code that drives and plans, for one robot on a CPU; None, or a noisy scanner: JAX does.
      shared_with: scanners and rules of other runs. The static config then suits all of them whose scanner has as many
        beams, so that they share a program; results are the same.
      metrics: of every episode. For those after every motion JAX drives.

    Raises:
      InputError: a metric that raises, returns no number, or is not pure.
    """
    ring, world = ring_of(world.occupied), with_ring(world)
    shape = shape or (bucket(world.shape[0]), bucket(world.shape[1]))
    truth = _truth(world, shape)
    everyone = [(lidar, rules), *(pair for pair in shared_with if pair[0].n_beams == lidar.n_beams)]
    native = None if any(metric.reduce for metric in metrics) else native
    setup = _setup(everyone, world.cell_m, shape, limit_of(world.shape), native)
    planner = setup.native
    if not rules.on_lattice:  # JAX drives
        setup = setup._replace(native=None, unsure=_unsure(rules, lidar.n_beams, shape, world.cell_m, planner))
        if rules.pose not in ("true", "odometry"):
            setup = setup._replace(first_scans=HEADINGS)  # or the first scans would not overlap
    own = rule_numbers(world, lidar, rules)
    model: Any = {name: own.pop(name) for name in ("p_free", "near_d2", "clearance_d2", "connectivity", "least")}
    model.update(cell_m=world.cell_m, known_outline=rules.known_outline)
    model = MapModel(coarse=world.cell_m > COARSE_M, native=planner, **model)  # type: ignore[arg-type]
    more: Any = {"sigma_cells": lidar.sigma_m / world.cell_m, "dropout": lidar.dropout, "recheck": False}
    more["clock"] = clock_table(robot, world.cell_m, max(shape))
    unsure = None if setup.unsure is None else _unsure_numbers(lidar, rules, world.cell_m, robot)
    if rules.motion != "lattice":
        own["scan_every"] = round(1000 * robot.scan_period_s)
    numbers = jax.tree.map(number, Numbers(model=model, params=(), unsure=unsure, **more, **own))
    # The beam table is the same for all rules and noise: megabytes.
    longest = max(farthest(one, world.cell_m) for one, _ in everyone)
    site = Site(truth, beam_table(lidar.without_noise(), world.cell_m, shape[1], longest), setup, numbers, ring)
    own = traced_metrics(metrics, *_example(site, numbers)) if metrics else ()
    return site._replace(setup=setup._replace(metrics=own))


def _unsure(rules: Rules, n_beams: int, shape: tuple[int, int], cell_m: float, native: str | None) -> Unsure:
    """Return how a robot in maps of a shape learns its pose."""
    if rules.pose in ("true", "odometry"):
        return Unsure(rides=rules.motion != "lattice")
    edge = float(index_cell_m(MATCHING))
    margin = math.ceil(MARGIN_M / edge)
    # Even, so that the cells of the index lie alike in maps of all shapes.
    rows, cols = (2 * math.ceil((n * cell_m / edge + 2 * margin) / 2) for n in shape)
    closing = rules.pose == "icp+closing"
    keys, loops = (MOST_KEYS, MOST_LOOPS) if closing else (1, 0)
    centre_m = (cols / 2 - margin) * edge, (rows / 2 - margin) * edge
    return Unsure(Sizes(keys, loops, (rows, cols, MOST_POINTS), native), centre_m, n_beams, closing)


def _unsure_numbers(lidar: Lidar, rules: Rules, cell_m: float, robot: Robot) -> UnsureNumbers:
    if lidar.mount_m:
        raise InputError(
            "lidar.forward_m and left_m must be 0 where the pose is not given, and with motion diff-drive, got "
            f"{lidar.forward_m:g} and {lidar.left_m:g} m for pose {rules.pose}, motion {rules.motion}"
        )
    angles = beam_angles_deg(lidar)
    directions = exact_direction(45.0 * np.arange(HEADINGS)[:, None] + angles)
    # Ignored types: numpy on the host, where the record says what it is on the device.
    return UnsureNumbers(
        odometry=rules.odometry,
        matching=MATCHING,
        directions=np.stack(directions, axis=-1),  # type: ignore[arg-type]
        angles_rad=np.radians(angles),  # type: ignore[arg-type]
        reach=in_cells(lidar.range_m, cell_m),  # type: ignore[arg-type]
        min_reach=in_cells(lidar.min_range_m, cell_m),  # type: ignore[arg-type]
        ride=None if rules.motion == "lattice" else ride_numbers(robot, cell_m),
    )


def unify_truths(truths: Sequence[Truth]) -> list[Truth]:
    """Return records of worlds with the same arrays: what one of them restricts is unrestricted in the others."""
    free: dict[str, Any] = {"within": True, "prior": np.int8(-1)}
    free = {name: value for name, value in free.items() if any(getattr(one, name) is not None for one in truths)}

    def unified(truth: Truth) -> Truth:
        missing = {name: value for name, value in free.items() if getattr(truth, name) is None}
        return truth.replace(**{name: np.full(truth.occupied.shape, value) for name, value in missing.items()})

    return list(map(unified, truths))


def rule_numbers(world: World, lidar: Lidar, rules: Rules) -> dict[str, Any]:
    """Return the numbers of rules and scanner in cells and costs, as JAX and native code are given them.

    Args:
      world: with its ring.
    """
    limit = limit_of(world.shape)
    return {
        "p_free": float(rules.p_free),
        "clearance_d2": reach_d2(rules.clearance_m, world),
        "near_d2": reach_d2(rules.near_m, world),
        "arrival_d2": reach_d2(rules.arrival_m, world),
        "scan_every": round(min(in_cells(rules.scan_every_m, world.cell_m) * reach.STRAIGHT, reach.FAR)),
        "max_steps": rules.max_steps or limit,
        "max_plans": rules.max_plans or limit,
        "look_around": bool(rules.look_around),
        "no_echo_is_free": lidar.no_echo == "free",
        "connectivity": rules.frontier_connectivity,
        "least": rules.min_frontier_cells,
        "stop_at": round((rules.stop_at or 0) * WHOLE),
        "return_home": rules.return_home,
        "max_path": limited(rules.max_path_m, LENGTHS[0] / world.cell_m, math.floor),
        "max_ms": limited(rules.max_time_s, 1000.0, math.ceil),
    }


def limited(limit: float | None, scale: float, whole: Callable[[float], int]) -> int:
    """Convert a limit to whole units; `NEVER` for none, or one that an int32 does not hold."""
    most = NEVER - max(LENGTHS)
    return NEVER if limit is None or limit * scale > most else whole(round(limit * scale, 6))


def reach_d2(radius_m: float, world: World) -> int:
    """Return `grid.radius_d2` of a radius, at most the squared diagonal of the world."""
    height, width = world.shape
    return min(radius_d2(radius_m, world.cell_m), height**2 + width**2)


def _truth(world: World, shape: tuple[int, int]) -> Truth:
    """Make the `Truth` of a world with its ring, padded."""
    pad = [(0, full - n) for full, n in zip(shape, world.shape)]
    rooms = world.rooms if world.rooms is not None else np.full(world.shape, -1, np.int32)
    # Ignored types: numpy on the host, where the record says what it is on the device.
    return Truth(
        occupied=np.pad(world.occupied, pad, constant_values=True),  # type: ignore[arg-type]
        rooms=np.pad(rooms, pad, constant_values=-1),  # type: ignore[arg-type]
        region=np.pad(regions_of(world), pad),  # type: ignore[arg-type]
        extent=np.asarray(world.shape, np.int32),  # type: ignore[arg-type]
        within=None if world.within is None or world.within.all() else np.pad(world.within, pad),  # type: ignore[arg-type]
        prior=None if world.known is None else np.pad(world.known, pad, constant_values=-1),  # type: ignore[arg-type]
    )


def limit_of(shape: tuple[int, ...]) -> int:
    """Return the default bound of steps and of plans in a world of a shape, ring included."""
    return max(LEAST_LIMIT, math.prod(shape))


def regions_of(world: World) -> np.ndarray:
    """Label each 4-connected region of free cells within: `[H, W]` int32."""
    from scipy import ndimage

    free = ~world.occupied if world.within is None else ~world.occupied & world.within
    return ndimage.label(free)[0].astype(np.int32)  # type: ignore[index]  # scipy says too little


def _setup(
    everyone: Sequence[tuple[Lidar, Rules]], cell_m: float, shape: tuple[int, int], limit: int, native: str | None
) -> Setup:
    """Make a static config that suits several scanners and rules, those of the site first."""
    lidar, _ = everyone[0]
    max_steps = max(rules.max_steps or limit for _, rules in everyone)
    noisy = any(one.sigma_m > 0 or one.dropout > 0 for one, _ in everyone)
    most = max(farthest(one, cell_m) + 4 * in_cells(one.sigma_m, cell_m) for one, _ in everyone)
    return Setup(
        policy=None,
        first_scans=scans_all_round(lidar),
        noisy=noisy,
        capacity=max(LEAST_LIMIT, shape[0] * shape[1]) if max_steps <= limit else max_steps,
        window=math.ceil(most) + 1,
        native=None if noisy else native,
        ends=any(rules.stop_at is not None or rules.return_home for _, rules in everyone),
    )


def tasks_of(starts: ArrayLike, ring: int) -> np.ndarray:
    """Convert starts in a world to tasks of runs: `[N, 3]` int32.

    Row and col in the maps of a site with this ring, heading in units of 45 degrees.
    """
    row, col, heading_deg = np.array(starts, np.int32).T
    return np.stack([row + ring, col + ring, heading_deg // 45], axis=1)


def line_of(
    site: Site,
    fitted: tuple[Setup, Numbers],
    starts: ArrayLike,
    seed: int,
    which: Any,
    *,
    detailed: int = 0,
    keep: str | None = None,
) -> Line:
    """Make the `Line` of a strategy's episodes; `fitted` comes from `site.with_strategy`.

    `starts`: `[N, 3]` int, row, col, heading_deg; `which`: numbers of the episodes to run here; `detailed`: of the one
    whose map and way are kept whole; `keep`: record of every episode, see `episode.program_of`.
    """
    setup, numbers = fitted
    trim = None
    if keep is not None:
        shape, width = tuple(int(n) for n in site.truth.extent), site.truth.occupied.shape[1]
        trim = functools.partial(record_of, shape=shape, width=width, ring=site.ring)
    tasks = tasks_of(starts, site.ring)
    return Line(program_of(setup, keep), site.beams, site.truth, numbers, seed, tasks, which, detailed, trim=trim)
