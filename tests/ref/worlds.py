"""Worlds for tests."""

import numpy as np

from jexplore.worlds.world import occupancy_to_world, with_ring


def two_rooms(name="two rooms", rows=22, cols=34, door=8):
    """A wall in the middle with a door; the robot does not see one room from the other."""
    occupied = np.zeros((rows, cols), bool)
    occupied[:, cols // 2] = True
    occupied[door : door + 8, cols // 2] = False
    return with_ring(occupancy_to_world(occupied, name=name))
