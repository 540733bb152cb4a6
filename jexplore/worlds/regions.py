"""Regions of a floor plan: outside and inside, in reach and apart; their description and choice.

A region is a 4-connected component of the cells that are clear for some robot, with the adjacent free cells.
"""

import numpy as np

from jexplore.config import InputError, checked_names, warn_of_input
from jexplore.rooms.doors import with_doorways
from jexplore.rooms.scores import label_components
from jexplore.rules import Rules
from jexplore.worlds.poses import cell_at
from jexplore.worlds.starts import clear_in
from jexplore.worlds.world import World

GAP_M = Rules().clearance_m  # m, clearance; outside and inside are apart where the default robot does not fit through
SIZEABLE_M2 = 4.0  # m2 of clear floor, that of a room of 2.6 m by 2.6 m: below are shafts, columns, tables in outline
SIZEABLE_SHARE = 0.02  # of the floor in reach; where cells are large, pockets of a few cells have many m2
ALONG_EDGE = 0.1  # share of the cells along the edge; a building cut off by the picture's edge touches less
REACHED_SHARE = 0.5  # of the free floor; below, what an episode tells of explored cells says little about the building
CORNER_CLEARANCES = 2.0  # along free cells from the clear floor into the corner of a room


def _regions(world: World) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the region of every cell, -1 for none, and by region its area in m2, and whether it touches the edge."""
    floor = with_doorways(label_components(clear_in(world, GAP_M)), ~world.occupied, world.occupied.size)
    m2 = np.bincount(floor[floor >= 0]) * world.cell_m**2
    return floor, m2, np.isin(np.arange(len(m2)), _edge(floor))


def _edge(array: np.ndarray) -> np.ndarray:
    """Return the cells along the edge of an array, round it once."""
    return np.concatenate([array[0], array[-1], array[1:-1, 0], array[1:-1, -1]])


@checked_names
def inside(world: World, point_m: tuple[float, float] | None = None) -> World:
    """Return the inside of a building: the same world with other free floor as wall.

    Regions are separate if a robot of `GAP_M` clearance does not fit through. Only the region of the point `point_m`
    remains, x, y, metres in the world's frame; without one, all regions but those that touch the edge of the map. Start
    and rooms are kept where they are free. Refused if nothing is enclosed, or no robot can stand round that point.
    """
    name, (floor, _, at_edge) = world.name or "world", _regions(world)
    if point_m is None:
        keep = ~world.occupied & ~np.append(at_edge, False)[floor]
        if at_edge.all():
            raise InputError(
                f"{name!r}: inside: no floor is enclosed; a gap wider than {2 * GAP_M:g} m leads from the edge of the "
                "map to all of it: close the outer wall in the map, or leave inside out"
            )
    else:
        what = f"{name!r}: inside: " + "({:g}, {:g}) m".format(*point_m)
        own = floor[cell_at(world, *point_m, what)]
        if own < 0:
            raise InputError(f"{what}: lies in a wall, or no robot fits in there; give another point")
        keep = floor == own
    start = world.start if world.start is not None and keep[world.start[:2]] else None
    rooms = None if world.rooms is None else np.where(keep, world.rooms, -1)
    return world.replace(occupied=~keep, rooms=rooms, start=start)


def warn_of_outside(world: World, reached: np.ndarray) -> bool:
    """Warn, and return True, if robots start on floor along the edge of the map while other floor is enclosed."""
    if np.mean(~_edge(world.occupied)) < ALONG_EDGE or not reached.any():
        return False
    floor, m2, at_edge = _regions(world)
    own = np.zeros(len(m2), bool)
    own[floor[reached & (floor >= 0)]] = True
    edge = _edge(floor)
    along = np.mean((edge >= 0) & np.append(own, False)[edge])
    own_m2 = m2[own].sum()
    enclosed_m2 = m2[~own & ~at_edge & (m2 >= max(SIZEABLE_M2, SIZEABLE_SHARE * own_m2))].sum()
    if along < ALONG_EDGE or not enclosed_m2:
        return False
    warn_of_input(
        f"{world.name or 'world'}: robots start outside, on {own_m2:.0f} m2 along the edge of the map, and "
        f"{enclosed_m2:.0f} m2 are enclosed; for the inside give the name of a map file the parameter inside=true, or "
        "the point inside_x_m=X,inside_y_m=Y; of an array take jexplore.worlds.regions.inside(world)",
    )
    return True


def warn_of_floor(world: World, reached: np.ndarray, clearance_m: float, *, drawn: bool) -> None:
    """Warn, by one `InputWarning`, that robots start outside, or that free floor is out of their reach.

    `reached` `[H, W]` bool has the clear cells that robots reach from their starts; a start that is not `drawn` may lie
    outside. The share counts free cells in reach and adjacent ones, up to `CORNER_CLEARANCES` along free cells, not the
    floor outside a building in which robots start.
    """
    if not reached.any() or (drawn and warn_of_outside(world, reached)):
        return
    free, cell_m2 = ~world.occupied, world.cell_m**2
    labels = label_components(clear_in(world, clearance_m))
    m2 = np.bincount(labels[labels >= 0]) * cell_m2
    apart = np.ones(len(m2), bool)
    apart[labels[reached & (labels >= 0)]] = False
    if np.mean(~_edge(world.occupied)) >= ALONG_EDGE:
        floor, _, at_edge = _regions(world)
        if not at_edge[floor[reached & (floor >= 0)]].any():
            outside = (floor >= 0) & np.append(at_edge, False)[floor]
            free &= ~outside
            apart[labels[outside & (labels >= 0)]] = False
    large = np.flatnonzero(apart & (m2 >= max(SIZEABLE_M2, SIZEABLE_SHARE * reached.sum() * cell_m2)))
    if not len(large) and reached.sum() >= REACHED_SHARE * free.sum():
        return
    gap = round(CORNER_CLEARANCES * clearance_m / world.cell_m)
    share = np.count_nonzero(with_doorways(np.where(reached, 0, -1), free, gap) >= 0) / np.count_nonzero(free)
    if not len(large) and share >= REACHED_SHARE:
        return
    text = f"{world.name or 'world'}: a robot of {clearance_m:g} m clearance reaches {share:.0%} of the free floor"
    if len(large):
        row, col = np.argwhere(labels == large[np.argmax(m2[large])])[0]
        text += f"; no way leads to {m2[large].sum():.0f} m2 where it could stand, such as row {row}, col {col}"
    warn_of_input(text)
