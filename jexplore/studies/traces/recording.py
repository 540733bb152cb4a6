"""Scans along the way of a run of a plan, and the walls around it."""

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from jexplore.driving import vehicle
from jexplore.driving.batch import Driven
from jexplore.driving.building.walls import segments
from jexplore.driving.params.tree import using
from jexplore.driving.records import RunMode
from jexplore.engine.draws import pinned_draws, random_key
from jexplore.studies.traces.job import TraceJob
from jexplore.worlds.readers.scans import ScanLog

MODE_NAMES = tuple(mode.name.lower().replace("_", " ") for mode in RunMode)
LOG_EVERY_STEPS = 5  # steps between two scans of a log: 0.2 m of way
SCANS_A_CALL = 64  # scans that are made in one call


def scans_of(plan: TraceJob, way: Driven, *, setting: int = 0, run: int = 0, every: int = LOG_EVERY_STEPS) -> ScanLog:
    """Reproduce the scans of a run as they were measured, noise included; `setting` and `run` together make its noise.

    In the world's frame: `poses` are true, `odometry` holds the estimated ones: odometry, corrected by scans and at
    nodes met again. Readings are distances in the plane; 0 for none, or for a beam that has met ground.
    """
    steps = np.arange(0, len(way.truth), every)
    key = jax.random.fold_in(random_key(np.uint32(plan.seed)), run)
    robot, _, noise, params = _setting(plan, setting)
    building = jax.device_put(plan.building)
    calls = np.pad(steps, (0, -len(steps) % SCANS_A_CALL), "edge").reshape(-1, SCANS_A_CALL)
    found = [_measured(key, building, robot, noise, params, (some, way.truth[some])) for some in calls]
    ranges = np.concatenate(jax.device_get(found))[: len(steps)]
    origin = np.array([*plan.world.origin_m, 0.0])
    return ScanLog(
        poses=way.truth[steps] + origin,
        odometry=way.estimate[steps] + origin,
        ranges=np.where(np.isnan(ranges), 0.0, np.minimum(ranges, vehicle.SCAN_RANGE_M)).astype(np.float64),
        angles_rad=vehicle.ANGLES_RAD.astype(np.float64),
        times=vehicle.DT_S * steps,
        max_range_m=vehicle.SCAN_RANGE_M,
    )


def _setting(plan, setting):
    """Return robot, thresholds, noise and parameters of a setting."""
    own = np.array([setting])
    return jax.tree.map(lambda a: jnp.asarray(a[0]), (*plan.settings_of(own), plan.params_of(own)))


@pinned_draws()
@jax.jit
def _measured(key, building, robot, noise, params, steps_and_poses):
    """Return the scans in some steps, see `vehicle.level_scan`; inf: no return; NaN: no reading, or ground."""

    def one(of):
        step, pose = of
        body = vehicle.initial_body(building, robot, pose)
        senses = vehicle.read_sensors(
            vehicle.draw_one(jax.random.fold_in(key, step), noise), building, robot, noise, body
        )
        return vehicle.level_scan(senses, robot)[0].ranges_m

    with using(params):
        return jax.lax.map(one, jax.tree.map(jnp.asarray, steps_and_poses))


def in_world_frame(poses: ArrayLike, origin_m: tuple[float, float]) -> np.ndarray:
    """Convert poses `[n, 3]` to the world's frame."""
    return np.asarray(poses) + np.array([*origin_m, 0.0], np.float32)


def wall_lines(plan: TraceJob) -> np.ndarray:
    """Return the building's walls in the world's frame: `[S, 4]`, metres."""
    return segments(plan.building.walls) + np.tile(np.asarray(plan.world.origin_m), 2)


def beam_ends(log: ScanLog, poses: np.ndarray) -> np.ndarray:
    """Return the ends of beams, seen from poses: `[N, B, 2]`, metres; the poses themselves for a beam without echo."""
    angle = poses[:, 2:] + log.angles_rad
    length = np.where(log.echo, log.ranges, 0)
    return poses[:, None, :2] + length[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
