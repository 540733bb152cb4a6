"""Consistent tour: the first stop of a short route through all frontier clusters that begins straight ahead.

The global tour of Zhou, Zhang, Chen, Shen, "FUEL: Fast UAV Exploration Using Incremental Frontier Structure and
Hierarchical Planning", RA-L 6(2), 2021, an asymmetric travelling salesman's: from the robot to cluster k it costs the
way and `w_c arccos((p_k - p_0) . v_0 / (|p_k - p_0| |v_0|))`, v_0 the robot's motion, between clusters the way, back to
the robot nothing. Changed: metres in place of seconds, so that w_c, 1.5 s/rad in their package, is multiplied by its
speed, 2 m/s; solved as `tour` is, not by LKH. Left out: turning towards view points (a scan is all round on arrival),
the choice among view points of the next clusters, and trajectories.
"""

from typing import Annotated, NamedTuple

import jax.numpy as jnp

from jexplore.config import require_number, require_whole
from jexplore.planning import field
from jexplore.policies.clusters import go_to, targets
from jexplore.policies.policy import MinGain, Policy, Span, no_carry
from jexplore.policies.tour import first_stop, stops_of


class Params(NamedTuple):
    """Parameters."""

    min_gain: int  # unknown cells that a look must show for a cluster to be a stop
    turn_m: float  # metres that a radian off the robot's heading is worth


def _select(key, params, carry, belief, beams, route):
    reached = field(belief)
    at = targets(belief, reached)
    bearing = jnp.arctan2(at.row - belief.row, at.col - belief.col) - belief.heading * (jnp.pi / 4)
    off = jnp.where((at.row == belief.row) & (at.col == belief.col), 0.0, jnp.arccos(jnp.cos(bearing)))
    begin_m = at.path_m + params.turn_m * off
    which = first_stop(belief, at, stops_of(belief, at, beams, params.min_gain), begin_m)
    return carry, *go_to(belief, route, reached, at, which)


def consistent_tour(min_gain: MinGain = 1, turn_m: Annotated[float, Span(0.1, 10.0, is_log=True)] = 3.0) -> Policy:
    """Return the policy. Carry: `()`. Parameters: `Params`."""
    gain = require_whole("min_gain", min_gain, low=0, high=2**20)
    return Policy(no_carry, _select, Params(gain, require_number("turn_m", turn_m, high=1e4)))
