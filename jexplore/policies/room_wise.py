"""Room by room: a modifier of any strategy, by which frontier cells in the robot's own segment come first.

Holz et al. 2010, section 2.4; whether to do so is decided on the fly for every room, if wanted, which the paper
leaves to future work.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jexplore.arrays.loops import run_if
from jexplore.config import require_number
from jexplore.grid import count, is_free
from jexplore.planning import Belief, Choice
from jexplore.policies.policy import Policy
from jexplore.reach import FAR
from jexplore.segment import PROMINENCE_M, VARIANTS, Criteria, form_for, segment

KINDS = (*VARIANTS, "auto")


class Params(NamedTuple):
    """Parameters of the modifier and of the strategy that it modifies."""

    max_hops: int  # see `segment.Criteria`
    prominence_m: float  # metres
    gamma: float  # cells
    door_m: float  # width of the widest door, metres; inf: a segment need not have one
    room_m2: float  # area of the largest room, m^2
    inner: Any


def _criteria(params, cell_m):
    return Criteria(
        max_hops=params.max_hops,
        prominence=params.prominence_m / cell_m,
        gamma=params.gamma,
        max_clearance=jnp.float32(jnp.inf),
        longest_first=jnp.bool_(True),
    )


def own_segment(params: Params, belief: Belief) -> tuple[Array, Array, Array]:
    """Cells of the segment that the robot is in, whether that is a room, and what did not fit.

    A room has a door, a critical point no wider than doors are, and is no larger than rooms are: corridors, halls and
    caves are not preferred to what lies beside them.

    Args:
      params: `Params`.
      belief: `Belief`.

    Returns:
      `(mask, is_room, overflow)`: `[H, W]` bool; bool; int32.
    """
    free = is_free(belief.grid, belief.model.p_free)
    form = form_for(free.shape, coarse=belief.model.coarse, reach=belief.model.reach)
    found = segment(free, _criteria(params, belief.model.cell_m), form=form)
    own = found.label[belief.row, belief.col]
    mine = found.label == own
    # From the middle of one wall's cell to that of the other, a cell more than is free between them.
    narrow = (found.split_d2 > 0) & (
        2 * jnp.sqrt(found.split_d2.astype(jnp.float32)) * belief.model.cell_m <= params.door_m
    )
    has_door = jnp.any(jnp.repeat(narrow, 2) & (found.group == own))
    small = count(mine) * belief.model.cell_m**2 <= params.room_m2
    return mine, (own >= 0) & has_door & small, found.overflow


@dataclasses.dataclass(frozen=True)
class _Select:
    """The `select` of a strategy with the modifier. Equal for the same strategy, so compiled once."""

    inner: Callable[..., Any]

    def __call__(self, key, params, carry, belief, beams, route):
        mine, is_room, overflow = own_segment(params, belief)
        none = jnp.int32(-1)
        nothing = Choice(none, none, jnp.int32(FAR), jnp.int32(0))

        def attempt(i, state):
            # First only what lies in the robot's segment, then, if nothing does that can be reached, everything.
            def choose(_):
                here = belief.replace(exhausted=belief.exhausted | (~mine & (i == 0)))
                return self.inner(jax.random.fold_in(key, i), params.inner, carry, here, beams, route)

            return run_if((state[1].row < 0) & (is_room | (i > 0)), choose, state)

        carry, choice, route = lax.fori_loop(0, 2, attempt, (carry, nothing, route))
        return carry, choice.replace(overflow=choice.overflow + overflow), route


@dataclasses.dataclass(frozen=True)
class _Inner:
    """The `init` or `live` of a strategy with the modifier."""

    inner: Callable[..., Any]

    def __call__(self, params, *rest):
        return self.inner(params.inner, *rest)


def rebuilt(policy: Policy, change: Callable[[Any], Any]) -> Policy:
    """A policy with its functions, or with the modifier those of the strategy that it modifies, changed."""

    def one(function):
        if isinstance(function, (_Select, _Inner)):
            return type(function)(change(function.inner))
        return None if function is None else change(function)

    return policy._replace(init=one(policy.init), select=one(policy.select), live=one(policy.live))


def segmented(
    policy: Policy,
    kind: str = "holz",
    *,
    prominence_m: float = PROMINENCE_M,
    gamma: float = 3.0,
    door_m: float = 1.6,
    room_m2: float = 40.0,
) -> Policy:
    """A strategy that prefers frontier cells in the robot's own segment.

    Args:
      policy: `Policy`.
      kind: one of `KINDS`; "auto" segments as "holz" does, and prefers rooms only.
      prominence_m: how much the clearance must rise on both sides of a critical point, metres.
      gamma: see `segment.Criteria`, cells.
      door_m: width of the widest door, metres; "auto" only.
      room_m2: area of the largest room, m^2; "auto" only.

    Returns:
      `Policy`.
    """
    params = Params(
        max_hops=VARIANTS["holz" if kind == "auto" else kind],
        prominence_m=float(require_number("prominence_m", prominence_m, high=100)),
        gamma=float(require_number("gamma", gamma, high=100)),
        door_m=float(require_number("door_m", door_m, high=100)),
        room_m2=float(require_number("room_m2", room_m2, high=1e6)),
        inner=policy.params,
    )
    if kind != "auto":
        params = params._replace(door_m=math.inf, room_m2=math.inf)
    live = None if policy.live is None else _Inner(policy.live)
    return Policy(_Inner(policy.init), _Select(policy.select), params, live)
