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
    n, way = map_.kind.shape[0], writer.way
    before = jnp.minimum(writer.node, n - 1)
    over = map_.kind[before] == btm.OBSTACLE
    found = _gone_over(writer, event)
    is_steep = jnp.abs(jnp.arctan(found.slope)) > jnp.radians(tuning.inclination_deg)
    is_judged = over & is_steep & (found.count >= 3) & (event.odometer_m > writer.node_m)
    stairs = is_judged & is_stairs(found, tuning)
    # On the ground between, without the ramps of the robot's own length at both ends.
    margin = robot.length_m / 2 + 0.05
    on_it = (way.odometer_m > writer.node_m + margin) & (way.odometer_m < event.odometer_m - margin)
    even = jnp.degrees(jnp.sum(jnp.where(on_it, way.posture, 0)) / jnp.maximum(jnp.sum(on_it), 1))
    even = jnp.where(over & jnp.any(on_it) & (even > tuning.inclination_deg), even, jnp.nan)
    measures = {
        "obstacle": (stairs, jnp.int32(btm.STAIRS)),
        "step_m": (stairs, found.riser_m),
        "variance_m2": (is_judged, found.variance_m2),
        "inclination_deg": (over, even),
    }
    for at, is_one in ((before, True), (here, event.kind == btm.OBSTACLE)):
        for name, (when, value) in measures.items():
            map_ = map_.replace(**{name: _raised(getattr(map_, name), jnp.where(when & is_one, at, n), value)})
    map_ = map_.replace(posture_deg=_raised(map_.posture_deg, jnp.where(over, before, n), posture))
    risers = found.highest_m + jnp.abs(found.slope) * ground_profile.RISE_M
    step_here = jnp.where(stairs, jnp.maximum(found.riser_m, risers), found.highest_m)
    return map_, jnp.where(found.count >= 3, step_here, jnp.nan)


def _raised(array, at, value):
    """Raise one entry to a value; NaN counts as none, an index beyond the last does nothing."""
    return array.at[at].set(jnp.fmax(value, array.at[at].get(mode="clip")), mode="drop")
