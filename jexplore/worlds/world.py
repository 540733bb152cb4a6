"""A world: the true floor plan that an episode runs in, and the cells in it that an episode may start from."""

import dataclasses
import hashlib
import math
import operator
import os
import re
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, SupportsIndex

import numpy as np
from flax import struct
from numpy.typing import ArrayLike

from jexplore.config import InputError, require_number
from jexplore.grid import radius_d2
from jexplore.tracemap.record import BtmMap

MAX_SIDE = 4096  # cells along the longer side, ring included
HEADINGS_DEG = (0, 45, 90, 135, 180, 225, 270, 315)


@dataclasses.dataclass(frozen=True)
class Course:
    """A way through a world, and what a robot that follows it should find.

    Metres are those of the world: (x, y) lies in column (x - origin_m[0]) / cell_m and row (y - origin_m[1]) / cell_m.
    """

    start_pose: tuple[float, float, float]
    """x, y in metres, heading in degrees, counter-clockwise from +x."""
    goal_m: tuple[float, float]
    """x, y, metres."""
    topology: BtmMap = dataclasses.field(hash=False)
    """The true map, nodes in the order in which the robot meets them."""


@struct.dataclass
class World:
    """One floor plan, on the host. Row 0 is the bottom; x runs along columns, y along rows.

    The outermost rows and columns are always occupied (`with_ring` adds them where they are not).
    """

    occupied: np.ndarray  # [H, W] bool, True where a wall or obstacle is
    rooms: np.ndarray | None = None  # [H, W] int32, room number from 0; -1 where there is none; None: no ground truth
    # row, col, heading_deg (a multiple of 45)
    start: tuple[int, int, int] | None = struct.field(pytree_node=False, default=None)
    cell_m: float = struct.field(pytree_node=False, default=0.1)  # edge of a cell, metres
    name: str = struct.field(pytree_node=False, default="")  # as the user typed it
    # x, y of the lower left corner of cell (0, 0), metres
    origin_m: tuple[float, float] = struct.field(pytree_node=False, default=(0.0, 0.0))
    elevation: np.ndarray | None = None  # [H, W] float32, height of the ground at cell centres, metres; None: level
    course: Course | None = struct.field(pytree_node=False, default=None)

    if TYPE_CHECKING:  # made by flax, unseen by type checkers

        def replace(self, **changes: Any) -> "World": ...

    @property
    def shape(self) -> tuple[int, int]:
        """`(H, W)`, cells."""
        return self.occupied.shape

    @property
    def free_m2(self) -> float:
        """Area of the free cells, square metres."""
        return float((~self.occupied).sum()) * self.cell_m**2


def checked(world: World) -> World:
    """A world that a caller has made, after a look at what the kernels rely on.

    Args:
      world: a `World`.

    Returns:
      The same world `with_ring`, its elevation as float32, its name as text.

    Raises:
      InputError: arrays of another shape or dtype than `World` says, sizes out of range, or no free cell.
    """
    if not isinstance(world.name, (str, os.PathLike)):
        raise InputError(f"the name of a world must be text, got {world.name!r}")
    world = world.replace(name=os.fspath(world.name))
    name, occupied = world.name or "world", np.asarray(world.occupied)
    if occupied.ndim != 2 or occupied.dtype != bool or not occupied.size:
        raise InputError(f"{name!r}: occupied must be [H, W] bool, got {occupied.shape} {occupied.dtype}")
    require_side(name, *occupied.shape)
    require_number(f"{name!r}: cell_m", world.cell_m, low_open=True, high=100)
    rooms = world.rooms
    if rooms is not None and (
        np.shape(rooms) != occupied.shape or not np.issubdtype(np.asarray(rooms).dtype, np.integer)
    ):
        raise InputError(f"{name!r}: rooms must be integers of shape {occupied.shape}, got {np.shape(rooms)}")
    if world.elevation is not None:
        elevation = np.asarray(world.elevation)
        if elevation.shape != occupied.shape or not np.issubdtype(elevation.dtype, np.floating):
            raise InputError(
                f"{name!r}: elevation must be floats of shape {occupied.shape}, got {elevation.shape} {elevation.dtype}"
            )
        if not np.isfinite(elevation).all():
            raise InputError(f"{name!r}: elevation must be finite; use 0 where the height of the ground is unknown")
        world = world.replace(elevation=elevation.astype(np.float32, copy=False))
    if occupied.all():
        raise InputError(f"{name!r}: no cell is free")
    return with_ring(world)


def with_ring(world: World) -> World:
    """The same world with all four edges occupied: unchanged if they are, else one cell larger on every side.

    Rooms, elevation, start and origin move along, so that every cell keeps its place in metres. No room covers a new
    cell; its ground is as high as that of the nearest old cell, so that no step arises at the edge.

    Args:
      world: a `World` of at least one cell.

    Returns:
      A `World` whose first and last rows and columns are occupied.

    Raises:
      InputError: the ring would make a side longer than `MAX_SIDE` cells.
    """
    occupied = world.occupied
    if occupied[[0, -1], :].all() and occupied[:, [0, -1]].all():
        return world
    rows, cols = (n + 2 for n in occupied.shape)
    require_side(world.name or "world", rows, cols)
    x_m, y_m = world.origin_m
    return world.replace(
        occupied=np.pad(occupied, 1, constant_values=True),
        rooms=None if world.rooms is None else np.pad(world.rooms, 1, constant_values=-1),
        elevation=None if world.elevation is None else np.pad(world.elevation, 1, mode="edge"),
        start=None if world.start is None else (world.start[0] + 1, world.start[1] + 1, world.start[2]),
        origin_m=(x_m - world.cell_m, y_m - world.cell_m),
    )


def pad(world: World, shape: tuple[int, int]) -> World:
    """The same world in a larger array: occupied rows are added at the top and occupied columns on the right.

    Args:
      world: a `World`.
      shape: `(H, W)` of the result, cells; no smaller than `world.shape`.

    Returns:
      A `World` of that shape. Indices, metres and starts are those of `world`; in what is new, rooms are -1 and the
      ground is as high as at the nearest old cell.

    Raises:
      ValueError: `shape` is smaller than the world.
    """
    grow = [(0, new - old) for new, old in zip(shape, world.shape)]
    if len(shape) != 2 or min(after for _, after in grow) < 0:
        raise ValueError(f"expected a shape of at least {world.shape}, got {tuple(shape)}")
    return world.replace(
        occupied=np.pad(world.occupied, grow, constant_values=True),
        rooms=None if world.rooms is None else np.pad(world.rooms, grow, constant_values=-1),
        elevation=None if world.elevation is None else np.pad(world.elevation, grow, mode="edge"),
    )


def require_side(name: str, rows: float, cols: float) -> None:
    """Refuse a world of more than `MAX_SIDE` rows or columns, before anything of that size is allocated.

    Raises:
      InputError: naming the world and the size.
    """
    if max(rows, cols) > MAX_SIDE:
        raise InputError(
            f"{name!r}: {rows:.0f} x {cols:.0f} cells are more than {MAX_SIDE} a side; "
            "use a larger cell_m or a smaller map"
        )


def occupancy_to_world(
    occupancy: ArrayLike,
    *,
    cell_m: float = 0.1,
    name: str = "",
    origin_m: Iterable[Any] = (0.0, 0.0),
    free_max: int = 25,
) -> World:
    """A world from an occupancy array, as ROS has it in an OccupancyGrid. Unknown counts as occupied.

    Args:
      occupancy: `[H, W]` integers, -1 unknown, 0 (free) to 100 (occupied); or `[H, W]` bool, True is occupied.
        Row 0 is the bottom.
      cell_m: edge of a cell, metres.
      name: what errors and results call it.
      origin_m: x, y of the lower left corner of cell (0, 0), metres.
      free_max: a cell is free if its occupancy is from 0 to this.

    Returns:
      A `World`, with a ring of occupied cells added if it has none.

    Raises:
      InputError: not a matrix, empty, of another dtype, a value outside -1..100, no free cell, or too large.
    """
    what = name or "occupancy"
    occupancy = np.asarray(occupancy)
    if occupancy.ndim != 2 or occupancy.size == 0 or occupancy.dtype.kind not in "biu":
        raise InputError(
            f"{what!r}: must be a matrix [H, W] of bool, or of integers from -1 to 100, "
            f"got {occupancy.dtype} of shape {occupancy.shape}"
        )
    require_number("cell_m", cell_m, low_open=True)
    require_side(what, *occupancy.shape)
    if occupancy.dtype.kind == "b":
        occupied = occupancy.copy()
    else:
        low, high = occupancy.min(), occupancy.max()
        if low < -1 or high > 100:
            raise InputError(f"{what!r}: occupancy must lie from -1 (unknown) to 100, got {low} to {high}")
        occupied = (occupancy < 0) | (occupancy > free_max)
    if occupied.all():
        raise InputError(f"{what!r}: no cell is free (occupancy 0 to {free_max})")
    return with_ring(World(occupied=occupied, cell_m=float(cell_m), name=name, origin_m=tuple(origin_m)))


def clear_cells(occupied: np.ndarray, clearance_m: float, cell_m: float) -> np.ndarray:
    """Cells with more clearance than the radius: free, and no occupied cell within it, centre to centre.

    Only the cells of the array count: what lies outside it is not an obstacle.

    Args:
      occupied: `[H, W]` bool.
      clearance_m: the radius, metres. At 0 every free cell is clear.
      cell_m: edge of a cell, metres.

    Returns:
      `[H, W]` bool.
    """
    d2 = radius_d2(clearance_m, cell_m)
    rows, cols = occupied.shape
    before = np.zeros((rows, cols + 1), np.int32)  # occupied cells of the row to the left of a column edge
    np.cumsum(occupied, axis=1, out=before[:, 1:])
    col = np.arange(cols)
    near = np.zeros_like(occupied)
    for dy in range(min(math.isqrt(d2), rows - 1) + 1):
        half = math.isqrt(d2 - dy * dy)
        hit = before[:, np.minimum(col + half + 1, cols)] > before[:, np.maximum(col - half, 0)]
        near[dy:] |= hit[: rows - dy]
        near[: rows - dy] |= hit[dy:]
    return ~near


def label_components(mask: np.ndarray) -> np.ndarray:
    """4-connected components, numbered in the order of their lowest flat indices.

    A diagonal step of the robot needs both its orthogonal neighbours, so what it can reach in 8 directions is
    exactly a 4-connected component.

    Args:
      mask: `[H, W]` bool.

    Returns:
      `[H, W]` int32, component number from 0; -1 where `mask` is False.
    """
    starts = mask.copy()
    starts[:, 1:] &= ~mask[:, :-1]
    run = np.cumsum(starts, dtype=np.int32).reshape(mask.shape) - 1  # the horizontal run a cell of the mask is in
    touching = mask[1:] & mask[:-1]
    lower, upper = run[:-1][touching], run[1:][touching]
    root = np.arange(int(starts.sum()), dtype=np.int32)
    for _ in range(root.size):  # a round hooks each root that has a smaller neighbour, so at least one
        if not lower.size:
            break
        np.minimum.at(root, np.maximum(lower, upper), np.minimum(lower, upper))
        while not np.array_equal(root, shorter := root[root]):
            root = shorter
        lower, upper = root[lower], root[upper]
        apart = lower != upper
        lower, upper = lower[apart], upper[apart]
    number = np.cumsum(root == np.arange(root.size), dtype=np.int32) - 1
    labels = np.full(mask.shape, -1, np.int32)
    labels[mask] = number[root[run[mask]]]
    return labels


def start_region(world: World, clearance_m: float) -> np.ndarray:
    """The cells that a drawn start may lie in: the largest 4-connected component of the clear cells.

    Args:
      world: a `World`.
      clearance_m: no occupied cell lies within this distance of a clear cell, centre to centre, metres.

    Returns:
      `[H, W]` bool. Among components of one size, the one with the lowest flat index. All False if no cell is clear.
    """
    clear = clear_cells(world.occupied, clearance_m, world.cell_m)
    labels = label_components(clear)
    sizes = np.bincount(labels[clear])
    return labels == (np.argmax(sizes) if sizes.size else 0)


def draw_starts(world: World, seed: int, n: int, clearance_m: float) -> np.ndarray:
    """Starts 0 to n - 1 of a seed: `draw_start` for each, at the cost of one.

    Returns:
      `[n, 3]` int32: row, col, heading in degrees.

    Raises:
      InputError: as `draw_start`.
    """
    cells = start_cells(world, clearance_m)
    starts = [_draw(cells, world.name, seed, i) for i in range(n)]
    return np.array(starts, np.int32).reshape(n, 3)


def draw_start(world: World, seed: int, i: int, clearance_m: float) -> tuple[int, int, int]:
    """Start number `i` of a seed: uniform over the start region, heading uniform over the multiples of 45 degrees.

    It depends on the world and its name, the clearance, `seed` and `i` alone: neither on how many starts are drawn nor
    on padding. Starts of one number in worlds of different names have nothing in common. Of a map file's name the
    folder does not count; a generator's name without a seed is that with seed 0.

    Args:
      world: a `World`.
      seed: integer from 0.
      i: number of the start, from 0.
      clearance_m: as in `start_region`.

    Returns:
      `(row, col, heading_deg)`, Python integers.

    Raises:
      InputError: no cell has that much clearance, or `seed` or `i` is negative.
    """
    return _draw(start_cells(world, clearance_m), world.name, seed, i)


def start_cells(world: World, clearance_m: float) -> np.ndarray:
    cells = np.argwhere(start_region(world, clearance_m))
    if not len(cells):
        raise InputError(
            f"{world.name or 'world'!r}: no cell has more than {clearance_m:g} m of clearance; "
            "use a smaller rules.clearance_m or a roomier map"
        )
    return cells


def _words(name):
    """What a world's name adds to the seed of its starts: four 32-bit numbers."""
    name = re.split(r"[/\\]", name)[-1]
    name = re.sub(r"^([A-Za-z_][\w-]*)(?=:|$)", r"\1#0", name)
    return np.frombuffer(hashlib.sha256(os.fsencode(name)).digest()[:16], "<u4").tolist()


def _draw(cells, name, seed, i):
    if seed < 0 or i < 0:
        raise InputError(f"seed and number of a start must be at least 0, got seed {seed} and number {i}")
    generator = np.random.Generator(np.random.PCG64([seed, i, *_words(name)]))
    row, col = cells[generator.integers(len(cells))]
    return int(row), int(col), HEADINGS_DEG[generator.integers(len(HEADINGS_DEG))]


def check_start(
    world: World, start: Iterable[SupportsIndex], clearance_m: float, near_m: float = 0.5
) -> tuple[int, int, int]:
    """Refuse a start that an episode cannot leave or stand on.

    The robot may drive over clear cells and over free cells within `near_m` of the start. A start from which no
    clear cell but itself can be reached that way is enclosed.

    Args:
      world: a `World`.
      start: `(row, col, heading_deg)`, integers.
      clearance_m: as in `start_region`. The start itself need only be free.
      near_m: metres.

    Returns:
      `(row, col, heading_deg)` as Python integers, the heading from 0 to 315.

    Raises:
      InputError: the start lies outside, in a wall, is enclosed, or its heading is not a multiple of 45 degrees.
    """
    try:
        row, col, heading = (operator.index(value) for value in start)
    except (TypeError, ValueError):
        raise InputError(f"start must be three integers row,col,heading_deg, got {start!r}") from None
    rows, cols = world.shape
    place = f"start ({row}, {col}) of {world.name or 'world'!r}"
    if not (0 <= row < rows and 0 <= col < cols):
        raise InputError(f"{place}: lies outside; rows are 0 to {rows - 1}, columns 0 to {cols - 1}")
    if world.occupied[row, col]:
        raise InputError(f"{place}: lies in a wall; choose a free cell")
    if heading % 45:
        raise InputError(f"{place}: its heading must be a multiple of 45 degrees, got {heading}")
    clear = clear_cells(world.occupied, clearance_m, world.cell_m)
    dy, dx = np.arange(rows)[:, None] - row, np.arange(cols)[None, :] - col
    near = (dy * dy + dx * dx <= radius_d2(near_m, world.cell_m)) & ~world.occupied
    labels = label_components(clear | near)
    reached = clear & (labels == labels[row, col])
    reached[row, col] = False
    if not reached.any():
        raise InputError(
            f"{place}: is enclosed; no cell with more than {clearance_m:g} m of clearance can be reached from it"
        )
    return row, col, heading % 360
