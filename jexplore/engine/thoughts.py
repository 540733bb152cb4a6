"""Deciding in pieces, for lanes in lockstep: glances at groups of lanes, and searches that go on from turn to turn.

The same work in every turn, whatever the lanes hold: no loop of which the host must ask whether it goes on.
"""

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, Self

import jax
import jax.numpy as jnp
from flax import struct
from jax import Array

from jexplore.arrays.loops import first_lanes, put, take
from jexplore.engine.program import Pieces

# Of runs simulated and estimated (`jexplore bench --target h100`): more keep more lanes busy, fewer are less work.
GLANCERS = (4, 16)  # one lane in so many is given a first glance in a turn, and one in so many each later one
SEEKERS = (8, 11, 28)  # there is a slot for one lane in so many: without glances, after one, after more
NEWCOMERS = 2  # in a turn one slot in so many is taken, and as many are given back; all where there are no glances


class Sizes(NamedTuple):
    """How many lanes each part of the work is for."""

    glances: tuple[int, ...]
    slots: int
    newcomers: int

    @property
    def counted(self) -> int:
        """Places of which the use is counted: those for a first glance; without glances the slots."""
        return self.glances[0] if self.glances else self.slots


def seekers(n_glances: int) -> int:
    """There is a slot for one lane in so many."""
    return SEEKERS[min(n_glances, len(SEEKERS) - 1)]


def sizes(n_lanes: int, n_glances: int) -> Sizes:
    """`Sizes` for so many lanes and glances."""
    slots = -(-n_lanes // seekers(n_glances))
    glances = tuple(-(-n_lanes // GLANCERS[min(i, 1)]) for i in range(n_glances))
    return Sizes(glances, slots, -(-slots // NEWCOMERS) if glances else slots)


@struct.dataclass
class Thoughts:
    """What lanes that must decide have come to."""

    stage: Array  # [L] int32, glances that have settled nothing
    lane: Array  # [P] int32, the lane of each slot; L: none
    searches: Any  # [P, ...]
    seen: tuple[Any, ...]  # of each glance `[L, ...]`, what it has seen
    replace: ClassVar[Callable[..., Self]]


def blank(pieces: Pieces, search: Any, seen: tuple[Any, ...], n_lanes: int) -> Thoughts:
    """No thoughts.

    Args:
      pieces: `Pieces`.
      search, seen: shapes of one search, and of what each glance sees.
      n_lanes: L.
    """
    slots = sizes(n_lanes, len(pieces.glances)).slots
    return Thoughts(
        stage=jnp.zeros(n_lanes, jnp.int32),
        lane=jnp.full(slots, n_lanes, jnp.int32),
        searches=jax.tree.map(lambda a: jnp.zeros((slots, *a.shape), a.dtype), search),
        seen=jax.tree.map(lambda a: jnp.zeros((n_lanes, *a.shape), a.dtype), seen),
    )


def seen_before(thoughts: Thoughts, i: int, which: Array) -> Any:
    """What lanes `which` (`[m]` int32) have seen at the glance before glance i; () before the first."""
    return take(thoughts.seen[i - 1], which) if i else ()


def glanced(thoughts: Thoughts, i: int, which: Array, settled: Array, seen: Any) -> Thoughts:
    """After glance i at lanes `which` (`[m]` int32) that settled some of them (`[m]` bool), and what it has seen."""
    stage = jnp.where(settled, 0, take(thoughts.stage, which) + 1)
    all_ = list(thoughts.seen)
    all_[i] = put(all_[i], which, seen)
    return thoughts.replace(stage=put(thoughts.stage, which, stage), seen=tuple(all_))


def is_seeking(thoughts: Thoughts) -> Array:
    """Whether each lane has a slot: `[L]` bool."""
    n_lanes = thoughts.stage.shape[0]
    # Slots without a lane write to places of their own beyond the last.
    return put(jnp.zeros(n_lanes, bool), thoughts.lane, jnp.ones(thoughts.lane.shape, bool))


def taken(thoughts: Thoughts, waits: Array, m: int) -> tuple[Array, Array]:
    """Free slots and the lanes that get them, up to m: `([m] int32, [m] int32)`, P and L where there is none.

    Args:
      thoughts: `Thoughts`.
      waits: `[L]` bool, lanes that no glance has settled.
      m: int. Static.
    """
    n_lanes, n_slots = thoughts.stage.shape[0], thoughts.lane.shape[0]
    slot = first_lanes(thoughts.lane == n_lanes, m)
    lane = first_lanes(waits & ~is_seeking(thoughts), m)
    both = (slot < n_slots) & (lane < n_lanes)
    return jnp.where(both, slot, n_slots), jnp.where(both, lane, n_lanes)


def found(pieces: Pieces, thoughts: Thoughts, m: int) -> tuple[Array, Array]:
    """Slots whose search is done and their lanes, as `taken`."""
    n_lanes = thoughts.stage.shape[0]
    slot = first_lanes((thoughts.lane < n_lanes) & jax.vmap(pieces.is_done)(thoughts.searches), m)
    return slot, jnp.where(slot < thoughts.lane.shape[0], take(thoughts.lane, slot), n_lanes)


def given_back(thoughts: Thoughts, slot: Array, lane: Array) -> Thoughts:
    """Without the searches in some slots (`[m]` int32), and their lanes (`[m]` int32) as if they had none."""
    n_lanes = thoughts.stage.shape[0]
    return thoughts.replace(
        lane=put(thoughts.lane, slot, jnp.full(slot.shape, n_lanes, jnp.int32)),
        stage=put(thoughts.stage, lane, jnp.zeros(lane.shape, jnp.int32)),
    )
