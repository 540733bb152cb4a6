"""Truth for a run in a building: junctions and doors to be found, and nodes that match none of them."""

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from jexplore.extraction.extract import extract
from jexplore.grid import centre_of
from jexplore.rooms.doors import middles_of
from jexplore.tracemap.record import BtmMap
from jexplore.tracemap.rooted import topology_from
from jexplore.worlds.starts import clear_of_walls, label_components
from jexplore.worlds.world import World

SQUARE_DEG = 1.0  # a heading this near to square to a link is
NEAR_M = 0.5  # a junction is reached within this, or within its circle if that is more; a door within this


class Truth(NamedTuple):
    """Places where a robot of some size finds the nodes of a trace map."""

    map: BtmMap  # of a course its topology, else what `extract` makes of the true map
    marks: np.ndarray  # [K, 3] float, x, y, metres, in the world's frame; radius within which the place is reached
    is_door: np.ndarray  # [K] bool; the others are junctions
    around_m: np.ndarray  # [K] float, metres: a divergence no farther away is no false one


def truth_of(world: World, start_rc: tuple[int, int], width_m: float, open_m: float, coast_m: float = 0.0) -> Truth:
    """Find the places of a world that a robot can reach and should map.

    Args:
      world: `World`.
      start_rc: row and col of a cell that the robot can reach.
      width_m: of the robot.
      open_m: see `extract`.
      coast_m: distance of the robot's divergence before the mouth of a passage into free space, metres.

    Returns:
      `Truth`. Junctions are nodes of type divergence and free space. Without true rooms there are no doors.
    """
    free = ~world.occupied
    known = np.ones_like(free)
    clear = clear_of_walls(world.occupied, width_m / 2, world.cell_m)
    reached = _around(clear, start_rc)
    distance = np.asarray(ndimage.distance_transform_edt(free)) * world.cell_m
    if world.course is None:
        near = np.asarray(ndimage.distance_transform_edt(~reached)) * world.cell_m <= width_m
        found = extract(
            free & near,
            known,
            world.cell_m,
            width_m=width_m,
            open_m=open_m,
            clutter_m=0.0,
            origin_m=world.origin_m,
        )
    else:
        found = world.course.topology
    junctions = [node for node in found.nodes if node.type in ("divergence", "free_space")]
    is_mouth = np.array([node.type == "free_space" for node in junctions], bool)
    places = np.array([(node.x_m, node.y_m) for node in junctions]).reshape(-1, 2)
    cells = np.floor((places - np.asarray(world.origin_m)) / world.cell_m).astype(int)
    radius = np.maximum(distance[cells[:, 1], cells[:, 0]], NEAR_M) if len(cells) else np.zeros(0)
    doors = np.zeros((0, 2))
    if world.rooms is not None:
        cells = middles_of(world.rooms, free, world.cell_m)
        cells = cells[reached[tuple(cells.T)]]
        doors = np.stack(centre_of(*cells.T, cell_m=world.cell_m, origin_m=world.origin_m), axis=1)
    at = np.concatenate([places, doors])
    marks = np.column_stack([at, np.concatenate([radius, np.full(len(doors), NEAR_M)])])
    around_m = marks[:, 2] + coast_m * np.append(is_mouth, np.zeros(len(doors), bool))
    return Truth(found, marks, np.arange(len(marks)) >= len(places), around_m)


def maps_from(world: World, truth: Truth, pose: tuple[float, float, float]) -> tuple[BtmMap, ...]:
    """Return the correct maps of a run that begins at a pose, any of which will do.

    Args:
      world: `World`.
      truth: its `Truth`.
      pose: x, y, metres, in the world's frame; heading, degrees.

    Returns:
      Of a course with a goal its topology, from its own start alone. Of one without a goal the topology as begun there:
      two where the heading is square to the link, as it has no side ahead. None of other worlds, nor if the start lies
      in the circle of a divergence, off all links.
    """
    course = world.course
    if course is None:
        return ()
    if course.goal_m is not None:
        off = np.subtract(pose, course.start_pose)
        at_start = np.hypot(*off[:2]) < 1e-3 and abs((off[2] + 180) % 360 - 180) < 1e-3
        return (course.topology,) if at_start else ()
    off_m = np.hypot(*(truth.marks[:, :2] - pose[:2]).T)
    if np.any((off_m < truth.marks[:, 2]) & ~truth.is_door):
        return ()
    either = [topology_from(course.topology, (*pose[:2], pose[2] + turn)) for turn in (0.0, -SQUARE_DEG, SQUARE_DEG)]
    return tuple(found for i, found in enumerate(either) if found not in either[:i])


def _around(clear, cell):
    """Return the connected part of a mask in which a cell lies, or that is nearest to it."""
    if not clear.any():
        return clear
    parts = label_components(clear)
    nearest = ndimage.distance_transform_edt(~clear, return_distances=False, return_indices=True)
    row, col = np.asarray(nearest)[(slice(None), *cell)]
    return parts == parts[row, col]


def false_divergences(found: BtmMap, node_at: np.ndarray, truth: Truth) -> int:
    """Count the false divergences of a map.

    Args:
      found: `BtmMap`.
      node_at: `[N, 2]`, true positions of the robot when it made each node, in the world's frame.
      truth: `Truth`.
    """
    places, around_m = truth.marks[~truth.is_door], truth.around_m[~truth.is_door]
    count = 0
    for node in found.nodes:
        if node.type == "divergence":
            off = np.hypot(*(places[:, :2] - node_at[node.id]).T)
            count += not np.any(off <= around_m)
    return count
