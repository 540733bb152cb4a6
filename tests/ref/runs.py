"""States of a trace run of which a test knows only some fields."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from jexplore.driving.batch import building_of
from jexplore.driving.mission import Setup, initial_state
from jexplore.driving.records import DueNode, Openings, State
from jexplore.driving.settings import ROBOTS
from jexplore.worlds.world import World


@functools.cache
def _first():
    building = building_of(World(occupied=np.ones((3, 3), bool), cell_m=1.0))
    with jax.disable_jit(False):  # one program, where its steps would be a hundred
        return jax.jit(lambda: initial_state(Setup(64, 8, 16), building, ROBOTS["kamui"], jnp.zeros(3)))()


def a_state(**known) -> State:
    """Return the state before the first step, with other values where they are known."""
    return _first().replace(**known)


def a_due_node(**known) -> DueNode:
    """Return a node that is due, with zeros where nothing is known."""
    blank = {name: jnp.float32(0) for name in DueNode.__dataclass_fields__}
    return DueNode(**{**blank, **known})


def place(*bearings):
    """Return openings that bear so, radians, of 8 slots."""
    n, flat = len(bearings), jnp.zeros(8)
    bearing = np.pad(np.array(bearings, np.float32), (0, 8 - n))
    return Openings(jnp.asarray(bearing), jnp.zeros((8, 2)), flat, jnp.arange(8) < n, jnp.int32(0))
