"""Classification of obstacles: slope or stairs, inclination, height of steps."""

import jax.numpy as jnp
from jax import Array

from jexplore import btm
from jexplore.btm import Btm
from jexplore.driving.params.tree import P
from jexplore.driving.records import DueNode, Writer
from jexplore.driving.sensing import ground_profile
from jexplore.driving.sensing.ground_profile import Profile
from jexplore.driving.settings import Robot, Tuning


def is_stairs(found: Profile, tuning: Tuning) -> Array:
    """Return whether an inclined profile is that of stairs: bool.

    Its wave is large enough and stands out of the rest, which is noise or a tipping body.
    """
    rest = found.variance_m2 - found.tread_wave_m2
    noise = jnp.minimum(found.noise_m**2, rest)  # of points far apart neighbours differ by risers
    share = (P.ground.noise_shares[0] * rest + P.ground.noise_shares[1] * noise) / jnp.maximum(found.count, 1)
    doubt = jnp.minimum(share, P.ground.sure_wave_ratio * tuning.tread_wave_m2)
    return found.tread_wave_m2 > jnp.maximum(tuning.tread_wave_m2, doubt)


def _gone_over(writer, event):
    """Return the `Profile` of the ground between the last node and the one that is due."""
    way = writer.way
    within = (way.ground_x_m > writer.node_m + P.ground.profile_margin_m) & (
        way.ground_x_m < event.odometer_m - P.ground.profile_margin_m
    )
    return ground_profile.profile(way.ground_x_m, way.ground_z_m, within & jnp.isfinite(way.ground_x_m))


def classify_obstacle(
    map_: Btm,
    writer: Writer,
    event: DueNode,
    tuning: Tuning,
    robot: Robot,
    posture: Array,
    here: Array,
) -> tuple[Btm, Array]:
    """Classify the obstacle behind the robot, once it has passed it.

    Args:
      posture: float32, degrees, largest inclination of the body on the way here.
      here: int32, the node.

    Returns:
      `(map, step_m)`: `Btm`; float32, the highest step on the way here, NaN where hardly any ground was seen.
    """
    before = jnp.minimum(writer.node, map_.kind.shape[0] - 1)
    over = map_.kind[before] == btm.OBSTACLE
    way = writer.way
    found = _gone_over(writer, event)
    is_steep = jnp.abs(jnp.arctan(found.slope)) > jnp.radians(tuning.inclination_deg)
    is_judged = over & is_steep & (found.count >= 3) & (event.odometer_m > writer.node_m)
    stairs = is_judged & is_stairs(found, tuning)

    def mark(array, at, value, when):
        return array.at[jnp.where(when, at, array.shape[0])].set(value, mode="drop")

    obstacle, step, variance = map_.obstacle, map_.step_m, map_.variance_m2
    for at, is_one in ((before, stairs), (here, stairs & (event.kind == btm.OBSTACLE))):
        obstacle = mark(obstacle, at, btm.STAIRS, is_one)
        step = mark(step, at, jnp.fmax(found.riser_m, step[at]), is_one)
    for at, is_one in ((before, is_judged), (here, is_judged & (event.kind == btm.OBSTACLE))):
        variance = mark(variance, at, jnp.fmax(found.variance_m2, variance[at]), is_one)
    known = map_.posture_deg[before]
    # On the ground between, without the ramps of the robot's own length at both ends.
    margin = robot.length_m / 2 + 0.05
    on_it = (way.odometer_m > writer.node_m + margin) & (way.odometer_m < event.odometer_m - margin)
    n = jnp.sum(on_it)
    even = jnp.degrees(jnp.sum(jnp.where(on_it, way.posture, 0)) / jnp.maximum(n, 1))
    even = jnp.where(over & (n > 0) & (even > tuning.inclination_deg), even, jnp.nan)
    inclination = map_.inclination_deg
    for at, is_one in ((before, over), (here, over & (event.kind == btm.OBSTACLE))):
        inclination = mark(inclination, at, jnp.fmax(inclination[at], even), is_one)
    risers = found.highest_m + jnp.abs(found.slope) * ground_profile.RISE_M
    step_here = jnp.where(stairs, jnp.maximum(found.riser_m, risers), found.highest_m)
    map_ = map_.replace(
        obstacle=obstacle,
        step_m=step,
        variance_m2=variance,
        inclination_deg=inclination,
        posture_deg=mark(map_.posture_deg, before, jnp.fmax(known, posture), over),
    )
    return map_, jnp.where(found.count >= 3, step_here, jnp.nan)
