"""Worlds for tests."""

import numpy as np

from jexplore.worlds.world import occupancy_to_world, with_ring


def two_rooms(name="two rooms", rows=22, cols=34, door=8):
    """A wall in the middle with a door; the robot does not see one room from the other."""
    occupied = np.zeros((rows, cols), bool)
    occupied[:, cols // 2] = True
    occupied[door : door + 8, cols // 2] = False
    return with_ring(occupancy_to_world(occupied, name=name))


def with_walls(world, shape):
    """The world in an array of a shape, with walls of no room at the top and on the right."""
    grow = [(0, new - old) for new, old in zip(shape, world.shape)]
    rooms = None if world.rooms is None else np.pad(world.rooms, grow, constant_values=-1)
    return world.replace(occupied=np.pad(world.occupied, grow, constant_values=True), rooms=rooms)
