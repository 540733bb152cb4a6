"""The lines of a Voronoi graph on the host: its cells, paths along them, and branches that only lead into corners."""

import itertools
import math
from collections.abc import Collection, Container, Iterable, Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jexplore.arrays.groups import EIGHT_NEIGHBOURS
from jexplore.arrays.padding import bucket
from jexplore.skeleton import voronoi_graph

CORNER_DEG = 40.0
"""A branch that ends at a wall is roughness of the wall where the directions to its two walls differ by less."""
DEPTH = 1.5  # and where the corner lies less far beyond the disc that touches its two walls, cells
TAPER_DEG = 135.0
"""Such a branch is a passage with a dead end where they differ by more, else a corner: 90 degrees in a square one."""
PASSAGE = 6  # and where they differ by as much for fewer cells: narrow corners are rough
NECK = 0.75
"""A branch that ends at corners of its own is a way into a room where it has been narrower than this share of its end's
clearance: a corner that is cut off only narrows."""

_voronoi = jax.jit(voronoi_graph, static_argnames="size")


class Lines(NamedTuple):
    """The cells of the Voronoi graph, N of them."""

    row: np.ndarray  # [N] int
    col: np.ndarray  # [N] int
    at: np.ndarray  # [N, 2] float, row and col of the axis there: at most half a cell off
    radius: np.ndarray  # [N] float, cells: from the axis to the centre of the nearest obstacle
    spread_deg: np.ndarray  # [N] float, between the directions to the two nearest walls
    known: np.ndarray  # [N] bool, seen to be free
    near: list[set[int]]  # neighbours of each cell; `take_corners` changes them


def lines_of(obstacle: np.ndarray, free: np.ndarray, *, width: float) -> Lines:
    """Return `Lines` of the space that is not `obstacle` [H, W] bool, through passages of `width` cells and more.

    Cells that are `free` [H, W] bool are known.
    """
    height, cols = obstacle.shape
    padded = np.zeros((bucket(height), bucket(cols)), bool)
    padded[:height, :cols] = obstacle
    gamma = max(math.ceil(width), 2)  # centre to centre, a passage of `width` has more
    graph, drow, dcol = _voronoi(jnp.asarray(padded), jnp.float32(gamma**2), size=padded.size)
    cell, link = np.asarray(graph.cell), np.asarray(graph.link)
    row, col = np.divmod(cell, padded.shape[1])
    slot = np.flatnonzero((row < height) & (col < cols))
    at, radius, spread_deg = _axis(np.stack([drow, dcol], axis=-1), row[slot], col[slot])
    wide = 2 * radius - 1 >= width - 1e-9
    slot = slot[wide]
    number = np.full(len(cell) + 1, -1)
    number[slot] = np.arange(len(slot))
    near = [{int(i) for i in number[there] if i >= 0} for there in link[slot]]
    row, col = row[slot], col[slot]
    return Lines(row, col, at[wide], radius[wide], spread_deg[wide], free[row, col], near)


def _axis(off, row, col):
    """Compute `at`, `radius` and `spread_deg` of `Lines`, from the offsets of all cells to their nearest obstacles."""
    # The axis lies between a cell and its neighbours: in a passage of an even number of cells, on the edge of two.
    off = np.pad(off.astype(float), ((1, 1), (1, 1), (0, 0)))
    own = off[row + 1, col + 1]
    d = np.hypot(*own.T)
    radii, shifts, spread = [d], [np.zeros(2)], np.zeros(d.shape)
    for step in EIGHT_NEIGHBOURS:
        other, half = off[row + 1 + step[0], col + 1 + step[1]], np.asarray(step) / 2
        there = np.hypot(*other.T) > 0
        wall = other + step  # as seen from this cell
        cosine = (own * wall).sum(1) / np.maximum(d * np.hypot(*wall.T), 1e-9)
        angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
        beside = there & (np.hypot(*(wall - half).T) <= d + 1)
        spread = np.where(beside, np.maximum(spread, angle), spread)
        if 0 in step:
            shifts.append(half)
            to_walls = np.minimum(np.hypot(*(own - half).T), np.hypot(*(wall - half).T))
            radii.append(np.where(there & (angle >= 60), to_walls, 0))
    radius = np.max(radii, axis=0)
    widest = np.stack(radii) > radius - 1e-9
    shift = (widest[:, :, None] * np.stack(shifts)[:, None]).sum(0) / widest.sum(0)[:, None]
    return np.stack([row, col], axis=1) + shift, radius, spread


# Paths


def cells_apart(lines: Lines, a: int, b: int) -> float:
    """Return the distance from one cell to another, cells."""
    return float(math.dist(lines.at[a], lines.at[b]))


def bearing_deg(lines: Lines, a: int, b: int) -> float:
    """Return the direction from one cell to another, degrees."""
    return math.degrees(math.atan2(*(lines.at[b] - lines.at[a]))) % 360


def chains(
    near: list[set[int]] | dict[int, set[int]], cells: Iterable[int], keys: Container[int]
) -> Iterator[list[int]]:
    """Yield paths between cells that are in `keys` or have not two neighbours, each once, in the order of `cells`."""
    seen = set()
    for a in cells:
        if a not in keys and len(near[a]) == 2:
            continue
        for b in sorted(near[a]):
            if (a, b) not in seen:
                path = [a, b]
                while path[-1] not in keys and len(near[path[-1]]) == 2:
                    (on,) = near[path[-1]] - {path[-2]}
                    path.append(on)
                seen |= {(path[0], path[1]), (path[-1], path[-2])}
                yield path


def connected_cells(near: list[set[int]] | dict[int, set[int]], cells: Collection[int]) -> list[set[int]]:
    """Return sets of connected cells that hold any of `cells`, in their order."""
    left, found = set(cells), []
    for cell in cells:
        if cell in left:
            part, stack = {cell}, [cell]
            while stack:
                others = near[stack.pop()] - part
                part |= others
                stack += others
            left -= part
            found.append(part)
    return found


# Corners


def take_corners(lines: Lines) -> dict[int, int]:
    """Take the branches that end at a wall off `lines.near`; return how many corners each junction had, by cell.

    A branch whose far end has lost its own branches is looked at in turn: a corner may be cut off. A line from a wall
    into the unknown is such a branch too: its junction has not been seen.
    """
    near, corners = lines.near, {}

    def begins_unseen(path):
        loose = all(len(near[end]) == 1 and end not in corners for end in (path[0], path[-1]))
        return loose and lines.known[path[-1]] and not lines.known[path[0]]

    while True:
        loose = {"rough": [], "corner": [], "passage": []}
        for path in chains(near, range(len(near)), corners):
            if len(near[path[-1]]) > 1 or begins_unseen(path[::-1]):
                path = path[::-1]
            is_branch = len(near[path[-1]]) == 1 and len(near[path[0]]) + corners.get(path[0], 0) > 2
            if is_branch or begins_unseen(path):
                loose[_branch(lines, path, path[-1] in corners)].append(path)
        # A junction keeps a way out until its roughness has gone.
        taken = loose["rough"] or loose["corner"]
        if not taken:
            return corners
        for path in taken:
            for a, b in itertools.pairwise(path):
                near[a].discard(b)
                near[b].discard(a)
            own = corners.pop(path[-1], 0)
            if taken is loose["corner"]:
                own = 1
            elif not _is_one_place(lines, path):
                own = 0
            if own and near[path[0]]:
                corners[path[0]] = corners.get(path[0], 0) + own


def _is_one_place(lines, path):
    """Return whether the end of a branch lies in the disc of its junction and has about the same clearance."""
    here, tip = lines.radius[path[0]], lines.radius[path[-1]]
    return tip >= NECK * here and cells_apart(lines, path[0], path[-1]) <= here


def _branch(lines, path, has_corners):
    """Classify a branch from a junction to a loose end, possibly with corners: "rough", "corner" or "passage"."""
    here, tip = lines.radius[path[0]], lines.radius[path[-1]]
    is_room = has_corners and lines.radius[path].min() < NECK * tip
    radius, spread = lines.radius[path[1:]], lines.spread_deg[path[1:]]
    # Walls on both sides for a while, not only in the disc of the junction.
    if (
        is_room
        or tip > here
        or np.count_nonzero(spread[max(2, len(spread) // 3) :] >= TAPER_DEG) >= max(PASSAGE, tip / 2)
    ):
        return "passage" if cells_apart(lines, path[0], path[-1]) > here else "rough"
    # Not in the disc of the junction, where there is a third wall.
    first = min(2, len(radius) - 1)
    radius, spread = radius[first:], spread[first:]
    depth = np.median(radius * (1 / np.cos(np.radians(np.minimum(spread, 179)) / 2) - 1))
    is_corner = np.median(spread) >= CORNER_DEG and depth >= DEPTH and here - tip >= 0.5
    return "corner" if is_corner else "rough"
