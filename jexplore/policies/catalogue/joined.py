"""Several strategies as one, so that they share a compiled program: all but choosing is compiled once for all."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

from jexplore.arrays.loops import run_if
from jexplore.planning import Choice
from jexplore.policies.catalogue.adapt import is_theirs
from jexplore.policies.policy import Policy, Strategy
from jexplore.reach import FAR


class Params(NamedTuple):
    """Index of the selected strategy, and the parameters of all."""

    which: Any  # int32
    each: tuple[Any, ...]


@dataclasses.dataclass(frozen=True)
class Joined:
    """The functions of strategies that are told apart by a number."""

    policies: tuple[Policy, ...]  # without their parameters

    def init(self, params: Params, belief: Any) -> Any:
        """Return the carries of all."""
        return tuple(policy.init(own, belief) for policy, own in zip(self.policies, params.each))

    def select(
        self, key: Array, params: Params, carry: Any, belief: Any, beams: Any, route: Array
    ) -> tuple[Any, Choice, Array]:
        """Choose by the selected strategy alone."""
        none, zero = jnp.int32(-1), jnp.int32(0)
        state: Any = carry, Choice(none, none, jnp.int32(FAR), zero, jnp.bool_(False), zero), route
        for i, policy in enumerate(self.policies):

            def ask(state, i=i, policy=policy):
                carry, _, route = state
                own, choice, route = policy.select(key, params.each[i], carry[i], belief, beams, route)
                return (*carry[:i], own, *carry[i + 1 :]), choice, route

            state = run_if(params.which == i, ask, state)
        return state

    def live(self, params: Params, belief: Any, beams: Any, row: Array, col: Array) -> Array:
        """Return whether a view point is live for the selected strategy."""
        live = jnp.bool_(True)
        for i, policy in enumerate(self.policies):
            if policy.live is not None:
                look = functools.partial(policy.live, params.each[i], belief, beams, row, col)
                live = run_if(params.which == i, lambda _, look=look: look(), live)
        return live


@functools.lru_cache(maxsize=32)
def _joined(policies):
    """Return the same `Joined` for the same functions: methods of equal ones would differ."""
    return Joined(policies)


def join_strategies(strategies: Sequence[Strategy]) -> list[Strategy]:
    """Make strategies share a program, one for each that is given, in order.

    A lone one stays unchanged, and so does a user's. Those with the same functions need parameters of one structure.
    """
    kinds: dict[Policy, Any] = {}
    ours = [one for one in strategies if not is_theirs(one.policy)]
    for one in sorted(ours, key=lambda one: one.name):  # in whatever order they are given, it is the same program
        kinds.setdefault(one.policy._replace(params=()), one.policy.params)
    if len(kinds) < 2:
        return list(strategies)
    whole = _joined(tuple(kinds))
    live = whole.live if any(policy.live is not None for policy in kinds) else None

    def one_of(given):
        which = whole.policies.index(given.policy._replace(params=()))
        each = [*kinds.values()]
        each[which] = given.policy.params
        return given._replace(policy=Policy(whole.init, whole.select, Params(which, tuple(each)), live))

    return [given if is_theirs(given.policy) else one_of(given) for given in strategies]
