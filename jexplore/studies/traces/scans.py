"""Scans of the forward scanner along the way of a trace run."""

import jax
import jax.numpy as jnp
import numpy as np

from jexplore.driving import vehicle
from jexplore.driving.batch import Driven
from jexplore.engine.draws import pinned_draws, random_key
from jexplore.studies.traces.job import TraceJob
from jexplore.worlds.readers.scans import ScanLog

LOG_EVERY_STEPS = 5  # steps between two scans of a log: 0.2 m of way
SCANS_A_CALL = 64  # scans that are made in one call


def scans_of(plan: TraceJob, way: Driven, *, setting: int = 0, run: int = 0, every: int = LOG_EVERY_STEPS) -> ScanLog:
    """Reproduce the scans of a run as they were measured, noise included; `setting` and `run` together make its noise.

    In the world's frame: `poses` are true, `odometry` holds the estimated ones: odometry, corrected by scans and at
    nodes met again. Readings are distances in the plane; 0 for none, or for a beam that has met ground.
    """
    steps = np.arange(0, len(way.truth), every)
    ranges = measured(plan, steps, way.truth[steps], setting=setting, run=run)
    ranges = np.where(np.isnan(ranges), 0.0, np.minimum(ranges, vehicle.SCAN_RANGE_M)).astype(np.float64)
    origin = np.array([*plan.world.origin_m, 0.0])
    return ScanLog(
        poses=way.truth[steps] + origin,
        odometry=way.estimate[steps] + origin,
        ranges=ranges,
        angles_rad=vehicle.ANGLES_RAD.astype(np.float64),
        times=vehicle.DT_S * steps,
        max_range_m=vehicle.SCAN_RANGE_M,
    )


def measured(plan: TraceJob, steps: np.ndarray, poses: np.ndarray, *, setting: int = 0, run: int = 0) -> np.ndarray:
    """Compute the scans in some steps of a run from true poses `[n, 3]` in the building, see `vehicle.level_scan`.

    Returns `[n, B]` float32, metres; inf: no return; NaN: no reading, or ground.
    """
    robot, _, noise = jax.tree.map(lambda a: a[0], plan.settings_of(np.array([setting])))
    key = jax.random.fold_in(random_key(np.uint32(plan.seed)), run)
    building, found = jax.device_put(plan.building), []
    for first in range(0, len(steps), SCANS_A_CALL):
        own = steps[first : first + SCANS_A_CALL], poses[first : first + SCANS_A_CALL]
        lack = SCANS_A_CALL - len(own[0])
        some = np.pad(own[0], (0, lack), "edge"), np.pad(own[1], ((0, lack), (0, 0)), "edge")
        found.append(np.asarray(_measured(key, building, robot, noise, some))[: SCANS_A_CALL - lack])
    return np.concatenate(found)


@pinned_draws()
@jax.jit
def _measured(key, building, robot, noise, steps_and_poses):
    def one(of):
        step, pose = of
        body = vehicle.initial_body(building, robot, pose)
        senses = vehicle.read_sensors(
            vehicle.draw_one(jax.random.fold_in(key, step), noise), building, robot, noise, body
        )
        return vehicle.level_scan(senses, robot)[0].ranges_m

    return jax.lax.map(one, jax.tree.map(jnp.asarray, steps_and_poses))
