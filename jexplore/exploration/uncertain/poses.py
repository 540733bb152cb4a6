"""Records of a robot whose pose is no cell, or that does not know it."""

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, Self

import jax.numpy as jnp
from flax import struct
from jax import Array

from jexplore.arrays.poses import rotated
from jexplore.grid import Grid
from jexplore.rules import Odometry
from jexplore.slam2d.mapping import Sizes, blank
from jexplore.slam2d.odometry import SystematicErrors, unknown_errors
from jexplore.slam2d.settings import SlamSettings

EIGHTH = 0.7853981633974483  # radians, between headings of the lattice
STAY_CELLS = 0.75  # a robot is in another cell only if it is farther than this from its cell's centre on some axis
TRAIL = ("way_m", "true_x", "true_y", "x", "y")  # columns of a trail of poses: metres; cells, as the robot has them too


class Unsure(NamedTuple):
    """Static config of a robot whose pose is no cell, or that does not know it."""

    sizes: Sizes | None = None  # of its record of scans; None: odometry alone
    centre_m: tuple[float, float] = (0.0, 0.0)  # x and y of the middle of its point map
    n_beams: int = 0
    closing: bool = False  # whether it closes loops
    rides: bool = False  # whether it is a differential drive, which knows its pose


@struct.dataclass
class RideNumbers:
    """Numbers of a differential drive, float32 but for the first: cells, seconds and radians, see `rules.Robot`."""

    tick_ms: Array  # int32, duration of a motion
    step_s: Array  # of a part of a motion
    speed: Array
    acceleration: Array
    turn: Array
    turn_acceleration: Array
    lookahead: Array
    tolerance: Array


@struct.dataclass
class Ride:
    """Motion of a differential drive."""

    speed: Array  # float32, cells a second
    turn: Array  # float32, radians a second
    anchor: Array  # [2] int32, row and col of the cell of its route that it has passed last
    careful: Array  # bool, whether it turns in place to the next cell of its route, and drives there straight
    turned_rad: Array  # float32, turned in all
    braked: Array  # float32, kinetic energy lost by braking, that at full speed is 1
    replace: ClassVar[Callable[..., Self]]


@struct.dataclass
class UnsureNumbers:
    """Numbers of a robot whose pose is no cell, or that does not know it."""

    odometry: Odometry
    matching: SlamSettings
    directions: Array  # [8, B, 2] float32, beams as unit vectors at each heading of the lattice
    angles_rad: Array  # [B] float32, beams relative to the heading
    reach: Array  # float32, range of the scanner, cells
    min_reach: Array  # float32, a beam that is stopped nearer says nothing, cells
    ride: RideNumbers | None = None  # of a differential drive


@struct.dataclass
class Poses:
    """True and estimated pose of a robot, and what they come from.

    Poses are x and y in cells (the centre of cell (row, col) is at col + 0.5, row + 0.5) and what the heading has more
    than the state's, which is on the lattice, in radians. So they are exact on the lattice.
    """

    true: Array  # [3] float32
    estimate: Array  # [3] float32
    covariance: Array  # [3, 3] float32, of the estimate, m^2, m rad, rad^2
    errors: SystematicErrors  # of its odometry
    seen: Grid | None  # [H, W], the map that the scans would make if the pose were given; None: it is given
    trail: Array  # [T + 1, 5] float32, `TRAIL` at the start and after every step
    way_m: Array  # float32, driven in truth
    motions: Array  # int32, steps and turns made
    bumps: Array  # int32, steps that a wall of the true world ended
    unmatched: Array  # int32, scans without a match
    strayed: Array  # bool, the robot is in another cell than where its plan has it
    mapping: Any = None  # `Mapping` of a robot that matches scans, else None
    ride: Ride | None = None  # of a differential drive
    key_of: Any = None  # [T + 1] int32, key scan that each place of the trail belongs to; None: loops are not closed
    replace: ClassVar[Callable[..., Self]]


def blank_poses(unsure: Unsure, grid: Grid, capacity: int, start: Any, cell_m: Any) -> Poses:
    """Return the `Poses` of a robot at a cell's centre that knows where it is; `grid` is what it has seen.

    `start`: `[3]` int32, row, col and heading.
    """
    row, col, heading = start
    pose = jnp.stack([col + 0.5, row + 0.5, 0.0]).astype(jnp.float32)
    zero, none = jnp.float32(0), jnp.int32(0)
    ride = Ride(zero, zero, jnp.stack([row, col]), jnp.bool_(False), zero, zero) if unsure.rides else None
    trail = jnp.zeros((capacity + 1, len(TRAIL)), jnp.float32)
    mapping = unsure.sizes and blank(
        unsure.sizes, unsure.n_beams, jnp.append(pose[:2] * cell_m, heading * EIGHTH), unsure.centre_m
    )
    return Poses(
        true=pose,
        estimate=pose,
        covariance=jnp.zeros((3, 3), jnp.float32),
        errors=unknown_errors(),
        seen=None if unsure.rides else grid,
        trail=trail,
        way_m=zero,
        motions=none,
        bumps=none,
        unmatched=none,
        strayed=jnp.bool_(False),
        mapping=mapping,
        ride=ride,
        key_of=jnp.zeros(capacity + 1, jnp.int32) if unsure.closing else None,
    )


def beams_of(own: UnsureNumbers, heading: Array, pose: Array) -> Array:
    """Return the beams from a pose as unit vectors: `[B, 2]`; `heading`: of the lattice."""
    return rotated(jnp.asarray(own.directions)[heading], jnp.broadcast_to(pose[2], own.angles_rad.shape))


def cell_of(pose: Array, row: Array, col: Array, extent: Array) -> tuple[Array, Array]:
    """Return the cell of a robot that was taken to be in (row, col): that one unless it is clearly in another one."""
    x, y = pose[0], pose[1]
    stays = jnp.maximum(jnp.abs(x - col - 0.5), jnp.abs(y - row - 0.5)) <= STAY_CELLS
    own_row, own_col = (jnp.clip(jnp.floor(a).astype(jnp.int32), 1, n - 2) for a, n in ((y, extent[0]), (x, extent[1])))
    return jnp.where(stays, row, own_row), jnp.where(stays, col, own_col)


def rounded(heading: Array, poses: Poses) -> tuple[Array, Poses]:
    """Return the heading of the lattice nearest to the estimated one, and poses relative to it."""
    more = jnp.round(poses.estimate[2] / EIGHTH)
    true, estimate = (pose.at[2].add(-more * EIGHTH) for pose in (poses.true, poses.estimate))
    return (heading + more.astype(jnp.int32)) % 8, poses.replace(true=true, estimate=estimate)


def note_pose(poses: Poses, steps: Array, when: Array | bool) -> Poses:
    """Add the present poses to their trail."""
    entry = jnp.concatenate([poses.way_m[None], poses.true[:2], poses.estimate[:2]])
    step = jnp.where(when, steps, poses.trail.shape[0])
    poses = poses.replace(trail=poses.trail.at[step].set(entry, mode="drop"))
    if poses.key_of is None:
        return poses
    return poses.replace(key_of=poses.key_of.at[step].set(poses.mapping.place.key, mode="drop"))
