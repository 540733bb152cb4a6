"""Decision-theoretic: go to the sampled view point with the most information, discounted by the way there.

Gonzalez-Banos and Latombe, "Navigation Strategies for Exploring Indoor Environments", IJRR 21(10-11), 2002, in the form
of Holz et al. 2010, section 3.2.
"""

from jexplore.policies import views
from jexplore.policies.policy import Policy, no_carry


def decision_theoretic(samples: int = 500, lam: float = 0.2, spread_m: float = 1.0, min_gain: int = 10) -> Policy:
    """Return the policy. Carry: `()`. Parameters: `Views`, with lam (1/m) as the weight."""
    return Policy(no_carry, views.SELECT, views.views(("lam", lam), samples, spread_m, min_gain), views.live)
