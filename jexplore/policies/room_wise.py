"""Room by room: a modifier of any strategy, by which frontier cells in the robot's own segment come first.

Holz et al. 2010, section 2.4; whether to do so is decided on the fly for every room, if wanted, which the paper
leaves to future work.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jexplore.arrays.loops import run_if
from jexplore.config import InputError, require_number, shown
from jexplore.grid import count, is_free, is_known
from jexplore.planning import Belief, Choice
from jexplore.policies.policy import Policy, Span
from jexplore.reach import FAR
from jexplore.rooms import watershed
from jexplore.segment import MAX_HOPS, PROMINENCE_M, Criteria, form_for, segment

NO_DOOR = 2**30  # squared clearance of no way out, cells^2
_OF_GRAPH = "prominence_m", "gamma", "keep"
_OF_BASINS = "ratio", "smallest_m2", "clutter_m", "keep"
_OF_ROOMS = "door_m", "room_m2"
KINDS = {
    **dict.fromkeys(MAX_HOPS, _OF_GRAPH),
    "auto": _OF_GRAPH + _OF_ROOMS,
    "voronoi": _OF_BASINS,
    "rooms": _OF_BASINS + _OF_ROOMS,
}
"""Name -> the parameters that it goes by."""


class OfGraph(NamedTuple):
    """Segments cut at critical points of the Voronoi graph."""

    max_hops: Any  # int, see `segment.Criteria`
    prominence_m: Any  # float, metres
    gamma: Any  # float, cells

    def divide(self, free, belief):
        """Divide the map: `(label, door_d2, overflow)`: `[H, W]` int32; `[n]` int32, narrowest exit by label; int32."""
        model = belief.model
        form = form_for(free.shape, coarse=model.coarse)
        found = segment(free, Criteria(self.max_hops, self.prominence_m / model.cell_m, self.gamma), form=form)
        d2 = jnp.repeat(jnp.where(found.split_d2 > 0, found.split_d2, NO_DOOR), 2)
        narrowest = jnp.full(found.group.shape, NO_DOOR, jnp.int32).at[found.group].min(d2)
        return found.label, narrowest, found.overflow


class OfBasins(NamedTuple):
    """Basins of the clearance, joined where the pass between them is wide."""

    ratio: Any  # float, see `watershed.RoomCriteria`
    smallest_m2: Any  # float, m^2
    clutter_m: Any  # float, metres

    def divide(self, free, belief):
        """Divide the map as `OfGraph`, but with the widest exit."""
        model, unknown = belief.model, ~is_known(belief.grid)
        numbers = watershed.room_criteria(model.cell_m, narrowing=None, **self._asdict())
        form = watershed.room_form_for(free.shape, coarse=model.coarse)
        found = watershed.watershed(free, unknown, numbers, form=form)
        return found.label, jnp.where(found.door_d2 > 0, found.door_d2, NO_DOOR), found.overflow


class Params(NamedTuple):
    """Parameters of the modifier and of the strategy that it modifies."""

    cut: OfGraph | OfBasins
    door_m: float  # width of the widest door, metres; inf: a segment need not have one
    room_m2: float  # area of the largest room, m^2
    inner: Any


def own_segment(params: Params, belief: Belief, last: Array | None = None) -> tuple[Array, Array, Array]:
    """Return the robot's segment `[H, W]` bool, whether it is a room, and the cells that did not fit.

    With `last`, `[2]` int32, row and col of the last target, its segment instead; -1, or no segment: the robot's.

    A room has a door, and is no larger than rooms are: corridors, halls and caves get no preference. A door is a
    critical point no wider than doors are; a basin has a door if its widest exit is no wider.
    """
    free = is_free(belief.grid, belief.model.p_free)
    label, door_d2, overflow = params.cut.divide(free, belief)
    own = label[belief.row, belief.col]
    if last is not None:
        kept = label[last[0], last[1]]
        own = jnp.where((last[0] >= 0) & (kept >= 0), kept, own)
    mine = label == own
    door = door_d2[jnp.maximum(own, 0)]
    # From the middle of one wall's cell to that of the other, a cell more than is free between them.
    has_door = (door < NO_DOOR) & (2 * jnp.sqrt(door.astype(jnp.float32)) * belief.model.cell_m <= params.door_m)
    small = count(mine) * belief.model.cell_m**2 <= params.room_m2
    return mine, (own >= 0) & has_door & small, overflow


@dataclasses.dataclass(frozen=True)
class _Select:
    """The `select` of a strategy with the modifier. Equal for the same strategy, so compiled once."""

    inner: Callable[..., Any]
    keeps: bool  # the segment of the last target is the robot's; the carry is then that target and the inner one

    def __call__(self, key, params, carry, belief, beams, route):
        last, carry = carry if self.keeps else (None, carry)
        mine, is_room, overflow = own_segment(params, belief, last)
        none = jnp.int32(-1)
        nothing = Choice(none, none, jnp.int32(FAR), jnp.int32(0))

        def attempt(i, state):
            # First only what lies in the robot's segment, then, if nothing does that can be reached, everything.
            def choose(_):
                here = belief.replace(exhausted=belief.exhausted | (~mine & (i == 0)))
                return self.inner(jax.random.fold_in(key, i), params.inner, carry, here, beams, route)

            return run_if((state[1].row < 0) & (is_room | (i > 0)), choose, state)

        carry, choice, route = lax.fori_loop(0, 2, attempt, (carry, nothing, route))
        if self.keeps:
            carry = jnp.stack([choice.row, choice.col]), carry
        return carry, choice.replace(overflow=choice.overflow + overflow), route


@dataclasses.dataclass(frozen=True)
class _Inner:
    """The `init` or `live` of a strategy with the modifier."""

    inner: Callable[..., Any]
    keeps: bool = False  # of an `init`: see `_Select`

    def __call__(self, params: Any, *rest: Any) -> Any:
        found = self.inner(params.inner, *rest)
        return (jnp.full((2,), -1, jnp.int32), found) if self.keeps else found


def rebuilt(policy: Policy, change: Callable[[Any], Any]) -> Policy:
    """Change the functions of a policy, or of the strategy that it modifies."""

    def one(function):
        if isinstance(function, (_Select, _Inner)):
            return dataclasses.replace(function, inner=change(function.inner))
        return None if function is None else change(function)

    return policy._replace(init=one(policy.init), select=one(policy.select), live=one(policy.live))


def segmented(
    policy: Policy,
    kind: str = "holz",
    *,
    prominence_m: Annotated[float, Span(0.0, 0.5)] = PROMINENCE_M,
    gamma: Annotated[float, Span(1.0, 10.0)] = 3.0,
    ratio: Annotated[float, Span(0.3, 0.95)] = 0.75,  # alone, without the narrowing that `jexplore segment` looks at
    smallest_m2: Annotated[float, Span(0.5, 10.0, is_log=True)] = watershed.SMALLEST_ROOM_M2,
    clutter_m: Annotated[float, Span(0.0, 2.0)] = watershed.CLUTTER_M,
    door_m: Annotated[float, Span(0.6, 3.0)] = 1.6,
    room_m2: Annotated[float, Span(5.0, 200.0, is_log=True)] = 40.0,
    keep: bool = False,
) -> Policy:
    """Make a strategy that prefers frontier cells in the robot's own segment.

    Args:
      policy: `Policy`.
      kind: one of `KINDS`; "auto" segments as "holz" does, "rooms" as "voronoi" does, and both prefer rooms only.
      prominence_m: how much the clearance must rise on both sides of a critical point, metres.
      gamma: see `segment.Criteria`, cells.
      ratio, smallest_m2, clutter_m: see `watershed.room_criteria`.
      door_m: width of the widest door, metres; "auto" and "rooms" only.
      room_m2: area of the largest room, m^2; "auto" and "rooms" only.
      keep: whether the segment of the last target stays the robot's own until it holds none that can be reached, also
        while the robot drives through others.
    """
    if not isinstance(keep, bool):
        raise InputError(f"keep must be True or False, got {shown(keep)}")
    if "ratio" in KINDS[kind]:
        cut = OfBasins(
            float(require_number("ratio", ratio, high=1)),
            float(require_number("smallest_m2", smallest_m2, high=1e6)),
            float(require_number("clutter_m", clutter_m, high=1000)),
        )
    else:
        cut = OfGraph(
            MAX_HOPS.get(kind, MAX_HOPS["holz"]),
            float(require_number("prominence_m", prominence_m, high=100)),
            float(require_number("gamma", gamma, high=100)),
        )
    params = Params(
        cut=cut,
        door_m=float(require_number("door_m", door_m, high=100)),
        room_m2=float(require_number("room_m2", room_m2, high=1e6)),
        inner=policy.params,
    )
    if "door_m" not in KINDS[kind]:
        params = params._replace(door_m=math.inf, room_m2=math.inf)
    live = None if policy.live is None else _Inner(policy.live)
    return Policy(_Inner(policy.init, keep), _Select(policy.select, keep), params, live)
