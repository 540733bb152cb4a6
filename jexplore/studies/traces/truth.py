"""What a run in a building should have found: junctions and doors of the true map, and which nodes are none of them."""

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from jexplore.extraction.extract import extract
from jexplore.grid import centre_of
from jexplore.rooms.doors import middles_of
from jexplore.tracemap.record import BtmMap
from jexplore.worlds.starts import clear_cells, label_components
from jexplore.worlds.world import World

NEAR_M = 0.5  # a junction is reached within this, or within its circle if that is more; a door within this


class Truth(NamedTuple):
    """Where a robot of some size finds what a Behavioral Trace Map is made of."""

    map: BtmMap  # of a course its topology, else what `extract` makes of the true map
    marks: np.ndarray  # [K, 3] float, x, y, metres, in the world's frame; radius within which the place is reached
    is_door: np.ndarray  # [K] bool; the others are junctions


def truth_of(world: World, start_rc: tuple[int, int], width_m: float, open_m: float) -> Truth:
    """What there is to find in a world, as far as a robot gets.

    Args:
      world: `World`.
      start_rc: row and col of a cell that the robot can reach.
      width_m: of the robot.
      open_m: see `extract`.

    Returns:
      `Truth`. Junctions are nodes of type divergence and free space. Without true rooms there are no doors.
    """
    free = ~world.occupied
    known = np.ones_like(free)
    clear = clear_cells(world.occupied, width_m / 2, world.cell_m)
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
    places = [(node.x_m, node.y_m) for node in found.nodes if node.type in ("divergence", "free_space")]
    places = np.array(places).reshape(-1, 2)
    cells = np.floor((places - np.asarray(world.origin_m)) / world.cell_m).astype(int)
    radius = np.maximum(distance[cells[:, 1], cells[:, 0]], NEAR_M) if len(cells) else np.zeros(0)
    doors = np.zeros((0, 2))
    if world.rooms is not None:
        cells = middles_of(world.rooms, free, world.cell_m)
        cells = cells[reached[tuple(cells.T)]]
        doors = np.stack(centre_of(*cells.T, cell_m=world.cell_m, origin_m=world.origin_m), axis=1)
    at = np.concatenate([places, doors])
    marks = np.column_stack([at, np.concatenate([radius, np.full(len(doors), NEAR_M)])])
    return Truth(found, marks, np.arange(len(marks)) >= len(places))


def _around(clear, cell):
    """The connected part of a mask in which a cell lies, or that is nearest to it."""
    if not clear.any():
        return clear
    parts = label_components(clear)
    nearest = ndimage.distance_transform_edt(~clear, return_distances=False, return_indices=True)
    row, col = np.asarray(nearest)[(slice(None), *cell)]
    return parts == parts[row, col]


def false_divergences(found: BtmMap, node_at: np.ndarray, truth: Truth) -> int:
    """How many divergences of a map are none.

    Args:
      found: `BtmMap`.
      node_at: `[N, 2]`, where the robot truly was when it made each node, in the world's frame.
      truth: `Truth`.
    """
    places = truth.marks[~truth.is_door]
    count = 0
    for node in found.nodes:
        if node.type == "divergence":
            off = np.hypot(*(places[:, :2] - node_at[node.id]).T)
            count += not np.any(off <= places[:, 2])
    return count
