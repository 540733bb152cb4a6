"""Rooms by the watershed of the clearance: the oracle, laws, bad input."""

import jax.numpy as jnp
import numpy as np
import pytest
from ref import basins, rooms

from jexplore.rooms.watershed import RoomForm, room_criteria, watershed

pytestmark = pytest.mark.jit
SHAPE = (24, 24)
FORM = RoomForm(basins=128, passes=256, edges=576)
CELL_M = 0.25


def found_in(free, unknown=None, **numbers):
    unknown = np.zeros_like(free) if unknown is None else unknown
    return watershed(jnp.asarray(free), jnp.asarray(unknown), room_criteria(CELL_M, **numbers), form=FORM)


# ---------------------------------------------------------------- by hand


def test_no_free_space_and_no_wall():
    none = found_in(np.zeros(SHAPE, bool))
    assert (np.asarray(none.label) == -1).all()
    everything = found_in(np.ones(SHAPE, bool))
    assert (np.asarray(everything.label) == np.asarray(everything.label)[0, 0]).all()
    assert int(everything.overflow) == 0


# ---------------------------------------------------------------- the oracle

DENSITIES = (0.02, 0.1, 0.3)
RATIOS = (0.5, 0.75, 0.9)


def scattered(seed, density):
    """Free and unknown cells: walls at random, thickened into pieces, a part of the map unknown."""
    rng = np.random.default_rng(seed)
    free = rng.random(SHAPE) > density
    free &= np.roll(free, 1, axis=int(rng.integers(2)))
    unknown = np.zeros(SHAPE, bool)
    if seed % 2:
        row = int(rng.integers(8, 24))
        unknown[row:] = ~free[row:] | (rng.random(SHAPE)[row:] < 0.8)
    return free & ~unknown, unknown


def both(seed, density, ratio):
    """Kernel and oracle on one map: for each its label map, and of every room the way out and the area, sorted."""
    free, unknown = scattered(seed, density)
    found = found_in(free, unknown, ratio=ratio, narrowing=0.9, smallest_m2=1.0, clutter_m=0.8)
    label, doors, areas = basins.watershed(
        free, unknown, ratio=ratio, narrowing=0.9, smallest=16.0, size=np.float32(0.8 / CELL_M)
    )
    assert int(found.overflow) == 0
    sides = []
    for one, d2, area in ((found.label, found.door_d2, found.area), (label, doors, areas)):
        sides.append((np.asarray(one), sorted((d, n) for d, n in zip(np.ravel(d2).tolist(), np.ravel(area)) if n > 0)))
    return sides


def test_rooms_are_the_oracles_on_many_maps():
    # 1163, 2765, 2867: a pocket in rock; 1538, 2618: small rooms in a row.
    for seed in (*range(30), 1163, 1538, 2618, 2765, 2867):
        (label, ways), (expected, expected_ways) = both(seed, DENSITIES[seed % 3], RATIOS[seed // 3 % 3])
        assert rooms.same_partition(label, expected), seed
        assert ways == expected_ways, seed


# ---------------------------------------------------------------- bad input


@pytest.mark.slow
def test_what_does_not_fit_is_counted():
    free, unknown = scattered(0, 0.3)
    small = watershed(free, unknown, room_criteria(CELL_M), form=RoomForm(4, 4, 16))
    assert int(small.overflow) > 0


def test_what_is_refused():
    mask = np.zeros((4, 4), bool)
    for free, unknown in ((mask.astype(int), mask), (mask[0], mask[0]), (mask, mask[:3]), (mask, mask.astype(int))):
        with pytest.raises(AssertionError):
            watershed(free, unknown, room_criteria(CELL_M), form=FORM)
