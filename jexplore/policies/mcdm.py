"""Multi-criteria decision making: several criteria put together by a Choquet integral.

The way of deciding is that of Basilico and Amigoni, "Exploration strategies based on multi-criteria decision making for
searching environments in rescue operations", Autonomous Robots 31(4), 2011; the criteria are not. Two are theirs,
unknown area in sight (A) and path length (d). Their third is the probability of transmission to a base, which a robot
here does not need; in its place stands known area in sight (O), by which a robot localises itself. The weights are this
package's own: area and path are worth more together than apart, the other pairs less.
"""

from typing import Annotated, NamedTuple, TypeAlias

import jax.numpy as jnp
from jax import Array

from jexplore.config import InputError, require_number
from jexplore.policies.clusters import Best, looks
from jexplore.policies.policy import Policy, Span, no_carry

Weight: TypeAlias = Annotated[float, Span(0.0, 1.0)]


class Params(NamedTuple):
    """The fuzzy measure: the weight of every set of criteria but the empty one (0) and the whole one (1)."""

    a: float
    d: float
    o: float
    ad: float
    ao: float
    do: float


def relative(value: Array, used: Array) -> Array:
    """Scale values from the worst to the best used slot to 0 to 1; 1 if all are equal. `[M]` float32."""
    low = jnp.min(jnp.where(used, value, jnp.inf))
    span = jnp.max(jnp.where(used, value, -jnp.inf)) - low
    return jnp.where(used, jnp.where(span > 0, (value - low) / jnp.where(span > 0, span, 1.0), 1.0), 0.0)


def choquet(utilities: Array, measure: Array) -> Array:
    """Compute the Choquet integral of each column of utilities, `[n, M]`, of n criteria: `[M]` float32.

    `measure`: `[2**n]` float32, weight of every set of criteria; bit i stands for criterion i.
    """
    order = jnp.argsort(utilities, axis=0)
    sorted_ = jnp.take_along_axis(utilities, order, axis=0)
    steps = jnp.diff(sorted_, axis=0, prepend=0.0)
    # The set of criteria that are at least as well fulfilled as each.
    sets = jnp.cumsum((1 << order)[::-1], axis=0)[::-1]
    return jnp.sum(steps * measure[sets], axis=0)


def _judge(params, belief, at, beams):
    unknown, seen_known = looks(belief, at, beams)
    criteria = unknown.astype(jnp.float32), -jnp.where(at.used, at.path_m, 0.0), seen_known.astype(jnp.float32)
    utilities = jnp.stack([relative(value, at.used) for value in criteria])
    measure = jnp.stack([jnp.float32(0), params.a, params.d, params.ad, params.o, params.ao, params.do, jnp.float32(1)])
    return choquet(utilities, measure), at.used


def mcdm(
    a: Weight = 0.5, d: Weight = 0.3, o: Weight = 0.2, ad: Weight = 0.95, ao: Weight = 0.7, do: Weight = 0.4
) -> Policy:
    """Return the policy. Carry: `()`. Parameters: `Params`, from 0 to 1, none above that of a larger set."""
    params = Params(
        *(require_number(name, value, high=1) for name, value in zip(Params._fields, (a, d, o, ad, ao, do)))
    )
    given = params._asdict()
    for pair in ("ad", "ao", "do"):
        for one in pair:
            if given[one] > given[pair]:
                raise InputError(f"{pair} must be at least {one}, got {given[pair]} and {given[one]}")
    return Policy(no_carry, Best(_judge), params)
