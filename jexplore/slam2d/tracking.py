"""One step of localisation: odometry, match, search."""

import jax.numpy as jnp
from jax import Array

from jexplore.arrays.loops import pick, run_if
from jexplore.arrays.poses import compose
from jexplore.slam2d.matching import Match, Outcome, match
from jexplore.slam2d.points import PointMap
from jexplore.slam2d.scans import Scan
from jexplore.slam2d.search import Window, search
from jexplore.slam2d.settings import SlamSettings

SURE = 2.0  # standard deviations of a point's place that must lie within the gate
WINDOW = Window(3, 12)  # 0.63 m and 18 degrees on either side, 7.8 m round the robot
WIDE = Window(12, 90, best=1024)  # 2.5 m and 135 degrees, for steps without odometry


def predict(settings: SlamSettings, pose: Array, moved: Array | None) -> tuple[Array, Array]:
    """Return the pose after a step of the odometry, and the covariance of that step.

    Args:
      pose: `[3]` float32.
      moved: `[3]` float32, the step in the frame of the pose; None: there is no odometry.

    Returns:
      `(pose, covariance)`: `[3]`, `[3, 3]` float32.
    """
    if moved is None:
        sd = jnp.stack([settings.unknown_m, settings.unknown_m, jnp.radians(settings.unknown_deg)])
        return pose, jnp.diag(sd**2)
    way, turn = jnp.hypot(moved[0], moved[1]), jnp.abs(moved[2])
    place_sd = settings.way_m + settings.way_share * way
    turn_sd = settings.turn_share * turn + jnp.radians(settings.turn_deg + settings.turn_deg_m * way)
    return compose(pose, moved), jnp.diag(jnp.stack([place_sd, place_sd, turn_sd]) ** 2)


def locate(
    settings: SlamSettings, points: PointMap, scan: Scan, start: Array, prior: Array, window: Window = WINDOW
) -> Match:
    """Match a scan: from the odometry's pose if that is certain enough to find the right partners, or if nearly all of
    the scan matches from there, else from where a search finds it. A search follows as well if the match fails or fits
    badly; then the better of the two counts. Without odometry (`WIDE`) the match is `AMBIGUOUS` if another place costs
    less than `close_margin` more: it is kept, and its covariance says nothing of that other place.

    Returns:
      `Match`.
    """
    reach2 = jnp.sum(jnp.where(scan.valid, jnp.sum(scan.xy**2, 1), 0)) / jnp.maximum(jnp.sum(scan.valid), 1)
    spread = jnp.sqrt((prior[0, 0] + prior[1, 1]) / 2 + prior[2, 2] * reach2)  # of the scan's points
    is_sure = SURE * spread < settings.gate_m
    first = match(settings, points, scan, start, prior)

    def again(first):
        found = search(settings, points, scan, start, prior, window)
        second = match(settings, points, scan, start, prior, found.pose)
        is_better = (second.outcome <= Outcome.UNSETTLED) & (~is_sure | (second.fitness > first.fitness))
        if window == WIDE:
            has_rival = is_better & (found.other < found.cost + settings.close_margin)
            second = second._replace(outcome=jnp.where(has_rival, Outcome.AMBIGUOUS, second.outcome))
        return pick(is_better, second, first)

    is_good = (first.outcome <= Outcome.UNSETTLED) & (first.fitness >= settings.min_share)
    is_plain = is_sure | (first.fitness > settings.plain_share)
    return run_if(~(is_plain & is_good), again, first)
