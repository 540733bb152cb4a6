"""Gain rate: go to the sampled view point with the most information for every metre of the way there.

Gain over cost is the efficiency that Schmid et al., "An Efficient Sampling-Based Method for Online Informative Path
Planning in Unknown Environments", RA-L 5(2), 2020, maximise along a tree. Here for single view points, with 1 m added
to the path, so that the nearest ones are not preferred without bound.
"""

from jexplore.policies import views
from jexplore.policies.policy import Policy, no_carry


def gain_rate(samples: int = 500, plus_m: float = 1.0, spread_m: float = 1.0, min_gain: int = 10) -> Policy:
    """Return the policy. Carry: `()`. Parameters: `Views`, with plus_m, added to the path, as the weight."""
    params = views.views(("plus_m", plus_m), samples, spread_m, min_gain, by_rate=True)
    return Policy(no_carry, views.SELECT, params, views.live)
