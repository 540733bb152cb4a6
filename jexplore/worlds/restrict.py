"""Limits of an episode in a world, and prior knowledge of its robot: a region to stay in, a partial map."""

import os

import numpy as np
from numpy.typing import ArrayLike

from jexplore.config import InputError
from jexplore.grid import centre_of
from jexplore.worlds.poses import Polygon, read_polygon
from jexplore.worlds.readers.grids import FREE_MAX, OCCUPIED_MIN, inside_polygon, require_upright
from jexplore.worlds.readers.ros import read_ros
from jexplore.worlds.readers.scans import ScanMap
from jexplore.worlds.world import World

KnownMap = str | os.PathLike[str] | ArrayLike | ScanMap


def restricted(world: World, within: str | Polygon | None, from_map: KnownMap | None) -> World:
    """Return the world with a region to stay in and a partial map, as far as these are given."""
    world = world if within is None else stay_within(world, within)
    return world if from_map is None else with_known(world, from_map)


def stay_within(world: World, polygon_m: str | Polygon) -> World:
    """Return the world with a region that its robot stays in: cells whose centres lie in a polygon, metres.

    The region is no wall: beams pass its edge. Cells outside are never entered, are no frontier's unknown cells, and
    count neither as known nor as explorable.
    """
    corner = np.array(read_polygon(polygon_m))
    x, y = centre_of(*map(np.arange, world.shape), cell_m=world.cell_m, origin_m=world.origin_m)
    inside = inside_polygon(corner, x, y)
    if not (inside & ~world.occupied).any():
        (x0, y0), (x1, y1) = corner.min(axis=0), corner.max(axis=0)
        raise InputError(
            f"{world.name!r}: no free cell lies within {x0:g},{y0:g} to {x1:g},{y1:g}; the world spans "
            f"{x[0]:.1f},{y[0]:.1f} to {x[-1]:.1f},{y[-1]:.1f} m"
        )
    return world.replace(within=inside if world.within is None else inside & world.within)


def with_known(world: World, map_: KnownMap) -> World:
    """Return the world with a partial map that its robot has from the beginning.

    What it says of a cell counts as one observation; scans may contradict it. `map_` is the path of a ROS map, such as
    `explored.yaml` of `jexplore explore`; a `ScanMap`; or an occupancy `[H, W]` of the world's cells: -1 unknown, 0
    (free) to 100 (occupied). Between 25 and 65 it is unknown. A map of which no known free cell lies in the world is
    refused.
    """
    if isinstance(map_, (str, os.PathLike)):
        occupancy, info = read_ros(map_)
        name, cell_m, origin_m = os.fspath(map_), info.resolution_m, info.origin_m
        require_upright(repr(name), occupancy.shape, info.yaw_rad)
    elif isinstance(map_, ScanMap):
        hits, seen = np.asarray(map_.grid.hits), np.asarray(map_.grid.hits) + np.asarray(map_.grid.misses)
        occupancy = np.where(seen > 0, 100 * hits // np.maximum(seen, 1), -1)
        name, cell_m, origin_m = "the map", map_.cell_m, map_.origin_m
    else:
        name, occupancy, cell_m, origin_m = "the map", np.asarray(map_), world.cell_m, world.origin_m
        if occupancy.shape != world.shape or occupancy.dtype.kind not in "iu":
            raise InputError(
                f"the map must be integers [{world.shape[0]}, {world.shape[1]}], -1 unknown, 0 free to 100 occupied, "
                f"got {occupancy.dtype} of shape {list(occupancy.shape)}"
            )
    if abs(cell_m - world.cell_m) > 1e-6 * world.cell_m:
        raise InputError(f"{name}: has cells of {cell_m:g} m, {world.name!r} of {world.cell_m:g} m; make them equal")
    x, y = centre_of(*map(np.arange, world.shape), cell_m=world.cell_m, origin_m=world.origin_m)
    col, row = (np.floor((at - low) / cell_m).astype(int) for at, low in zip((x, y), origin_m))
    (height, width), known = occupancy.shape, np.full(world.shape, -1, np.int8)
    rows, cols = (row >= 0) & (row < height), (col >= 0) & (col < width)
    told = occupancy[np.ix_(row[rows], col[cols])]
    known[np.ix_(rows, cols)] = np.where((told >= 0) & (told <= FREE_MAX), 0, np.where(told >= OCCUPIED_MIN, 1, -1))
    if not ((known == 0) & ~world.occupied).any():
        raise InputError(f"{name}: none of its free cells is free in {world.name!r}; is it a map of this building?")
    return world.replace(known=known)
