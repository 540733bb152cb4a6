"""Learned: the frontier cluster that a network scores highest.

Attention over what may be done next, as in Cao, Hou, Wang, Yi, Sartoretti, "ARiADNE", ICRA 2023, there over the nodes
of a graph. Changed: over frontier clusters, a handful, and trained by what paths cost to the end of the episode.
"""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax.numpy as jnp
from jax import Array

from jexplore.arrays.loops import run_if
from jexplore.planning import Belief, Choice, field
from jexplore.policies.clusters import Targets, at_targets, go_to, targets
from jexplore.policies.learned.features import FEATURES, features, shortlist
from jexplore.policies.learned.model import SHIPPED, Model, load_model
from jexplore.policies.learned.networks import MASKED, scores
from jexplore.policies.policy import Policy
from jexplore.raycast import Beams

FORCED_M = 0.5  # a target as near as this is taken without asking


def init(params: Any, belief: Belief) -> Array:
    """Return the `init`. Carry: `[2]` int32, row and col of the last target; -1 before."""
    return jnp.full((2,), -1, jnp.int32)


def is_forced(at: Targets) -> Array:
    """Return whether the choice is forced: at most one target, or the first within `FORCED_M`."""
    return (jnp.sum(at.used, dtype=jnp.int32) < 2) | (at.path_m[0] <= FORCED_M)


def score_targets(network: str, weights: Any, at: Targets, tell: Callable[[], Array]) -> tuple[Array, Array]:
    """Score K targets, the nearest first; if the choice is forced, the nearest is above all others.

    `tell() -> [K, F]` gives their features, and is only called for an open choice. Returns `[K]` float32, scores; and
    `[K, F]` float32, features, 0 for a forced choice.
    """
    forced, size = is_forced(at), (len(at.used), len(FEATURES))
    told = run_if(~forced, lambda _: tell(), jnp.zeros(size, jnp.float32))
    nearest = jnp.where(jnp.arange(size[0]) == 0, 0.0, MASKED)
    return jnp.where(forced, nearest, scores(network, weights, told, at.used)), told


@dataclasses.dataclass(frozen=True)
class NetworkSelect:
    """The `select` of a network; equal for the same one, so compiled once."""

    network: str

    def __call__(self, *given: Any) -> tuple[Array, Choice, Array]:
        return self.scored(*given)[:3]

    def scored(
        self, key: Array, params: Any, carry: Array, belief: Belief, beams: Beams, route: Array
    ) -> tuple[Array, Choice, Array, Array]:
        """Choose as `clusters.Best.scored`, by the network's scores."""
        reached = field(belief)
        at = shortlist(targets(belief, reached))
        found, _ = score_targets(self.network, params, at, lambda: features(belief, at, carry, beams))
        which = jnp.where(at.used[0], jnp.argmax(found).astype(jnp.int32), -1)
        choice, route = go_to(belief, route, reached, at, which)
        return jnp.stack([choice.row, choice.col]), choice, route, at_targets(at, found, route.shape)


def policy_of(model: Model) -> Policy:
    """Return the policy of a model."""
    return Policy(init, NetworkSelect(model.network), model.weights)


def learned(path: Path = Path("shipped")) -> Policy:
    """Return the policy of a model from a file; `shipped` is the one that comes with the package."""
    return policy_of(load_model(SHIPPED if path == Path("shipped") else path))
