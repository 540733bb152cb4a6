"""Utility: go to the frontier cluster with the greatest gain less what the way there costs.

Expected gain against the cost of the way, as in Stachniss and Burgard, "Exploring Unknown Environments with Mobile
Robots using Coverage Maps", IJCAI 2003. Changed: the gain is the unknown area that a look would show, not the entropy
of coverage maps. The utility of Burgard, Moors, Stachniss, Schneider, "Coordinated Multi-Robot Exploration", IEEE T-RO
21(3), 2005, is another: it falls near the targets of other robots, so that a single robot there explores as `closest`.
"""

from typing import Annotated, NamedTuple

from jexplore.config import require_number, require_whole
from jexplore.policies.clusters import Best, looks
from jexplore.policies.policy import MinGain, Policy, Span, no_carry


class Params(NamedTuple):
    """Parameters."""

    beta: float  # m^2 of unknown space that a metre of the way must bring
    min_gain: int  # unknown cells that a look must show for a cluster to be considered


def _judge(params, belief, at, beams):
    unknown, _ = looks(belief, at, beams)
    return unknown * belief.model.cell_m**2 - params.beta * at.path_m, unknown >= params.min_gain


def utility(beta: Annotated[float, Span(0.1, 100.0, is_log=True)] = 5.0, min_gain: MinGain = 1) -> Policy:
    """Return the policy. Carry: `()`. Parameters: `Params`."""
    params = Params(require_number("beta", beta, high=1e6), require_whole("min_gain", min_gain, low=0, high=2**20))
    return Policy(no_carry, Best(_judge), params)
