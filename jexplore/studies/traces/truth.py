"""Truth for a run in a building: junctions and doors to be found, and nodes that match none of them."""

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from jexplore.extraction.extract import extract
from jexplore.grid import centre_of
from jexplore.rooms.doors import middles_of
from jexplore.rooms.scores import label_components
from jexplore.tracemap.record import BtmMap
from jexplore.tracemap.rooted import topology_from
from jexplore.worlds.starts import clear_of_walls
from jexplore.worlds.world import World

SQUARE_DEG = 1.0  # a heading this near to square to a link is
REACHED_M = 0.5  # a junction is reached within this, or within its circle if that is more; a door within this


class TraceTruth(NamedTuple):
    """Places where a robot of some size finds the nodes of a trace map."""

    map: BtmMap  # of a course its topology, else what `extract` makes of the true map
    marks: np.ndarray  # [K, 3] float, x, y, metres, in the world's frame; radius within which the place is reached
    is_door: np.ndarray  # [K] bool; the others are junctions


def truth_of(world: World, start_rc: tuple[int, int], width_m: float, open_m: float) -> TraceTruth:
    """Find the places of a world that a robot, who can reach the cell `start_rc`, should map.

    `open_m` is as of `extract`. Junctions are nodes of type divergence and free space. Without true rooms there are no
    doors.
    """
    free = ~world.occupied
    clear = clear_of_walls(world.occupied, width_m / 2, world.cell_m)
    reached = _around(clear, start_rc)
    distance = np.asarray(ndimage.distance_transform_edt(free)) * world.cell_m
    if world.course is None:
        near = np.asarray(ndimage.distance_transform_edt(~reached)) * world.cell_m <= width_m
        how = {"width_m": width_m, "open_m": open_m, "clutter_m": 0.0, "origin_m": world.origin_m}
        found = extract(free & near, np.ones_like(free), world.cell_m, **how)
    else:
        found = world.course.topology
    junctions = [node for node in found.nodes if node.type in ("divergence", "free_space")]
    places = np.array([(node.x_m, node.y_m) for node in junctions]).reshape(-1, 2)
    cells = np.floor((places - np.asarray(world.origin_m)) / world.cell_m).astype(int)
    radius = np.maximum(distance[cells[:, 1], cells[:, 0]], REACHED_M) if len(cells) else np.zeros(0)
    doors = np.zeros((0, 2))
    if world.rooms is not None:
        cells = middles_of(world.rooms, free, world.cell_m)
        cells = cells[reached[tuple(cells.T)]]
        doors = np.stack(centre_of(*cells.T, cell_m=world.cell_m, origin_m=world.origin_m), axis=1)
    at = np.concatenate([places, doors])
    marks = np.column_stack([at, np.concatenate([radius, np.full(len(doors), REACHED_M)])])
    return TraceTruth(found, marks, np.arange(len(marks)) >= len(places))


def maps_from(world: World, truth: TraceTruth, pose: tuple[float, float, float]) -> tuple[BtmMap, ...]:
    """Return the correct maps of a run that begins at a pose: x, y, metres, in the world's frame; heading, degrees.

    Any of them will do. Of a course with a goal its topology, from its own start alone. Of one without a goal the
    topology as begun there: two where the heading is square to the link, as it has no side ahead. None of other worlds,
    nor if the start lies in the circle of a divergence, off all links.
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


def false_divergences(found: BtmMap, node_at: np.ndarray, truth: TraceTruth) -> int:
    """Count a map's divergences that match no place; `node_at` is `[N, 2]`, where the robot truly made each node."""
    x_m, y_m, within_m = truth.marks[~truth.is_door].T
    made_at = [node_at[node.id] for node in found.nodes if node.type == "divergence"]
    return sum(not np.any(np.hypot(x_m - at[0], y_m - at[1]) <= within_m) for at in made_at)
