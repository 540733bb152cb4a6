"""A world: the true floor plan that an episode runs in."""

import dataclasses
import importlib
import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from flax import struct
from numpy.typing import ArrayLike

from jexplore.arrays.pictures import axes_of, html_of, or_text, png_of, soft_colours
from jexplore.config import InputError, checked_names, require_number, require_whole
from jexplore.tracemap.record import BtmMap
from jexplore.worlds.bounds import require_side

ROBOT_PT = 9  # from the middle of the arrow to its tip
ROBOT = "#e69f00"
ARRAYS: dict[str, tuple[str, str, dict[str, Any]]] = {
    "rooms": ("iu", "integers", {"constant_values": -1}),
    "elevation": ("f", "floats", {"mode": "edge"}),
    "within": ("b", "bool", {}),
    "known": ("i", "integers, -1 unknown, 0 free, 1 occupied,", {"constant_values": -1}),
}
"""Array of a world that it need not have -> kinds of its dtype, how a message tells them, and how a ring pads it."""


@dataclasses.dataclass(frozen=True)
class Course:
    """A way through a world, and what a robot that follows it should find, in metres of the world."""

    start_pose: tuple[float, float, float]
    """x, y in metres, heading in degrees, counter-clockwise from +x."""
    goal_m: tuple[float, float] | None
    """x, y, metres. None: the robot goes on until nothing is left."""
    topology: BtmMap = dataclasses.field(hash=False)
    """The true map, nodes in the order in which the robot meets them; of a course with a goal the part on its way."""


@checked_names
@struct.dataclass
class World:
    """One floor plan, on the host. Row 0 is the bottom; x runs along columns, y along rows.

    Indices of starts, trails and maps are those of `occupied`. What lies beyond its edge is wall: robots live in the
    world `with_ring`, and what they return is told in indices without it.
    """

    occupied: np.ndarray  # [H, W] bool, True where a wall or obstacle is
    rooms: np.ndarray | None = None  # [H, W] int32, room number from 0; -1 outside rooms; None: no ground truth
    # row, col, heading_deg (a multiple of 45)
    start: tuple[int, int, int] | None = struct.field(pytree_node=False, default=None)
    cell_m: float = struct.field(pytree_node=False, default=0.1)  # edge of a cell, metres
    name: str = struct.field(pytree_node=False, default="")  # as the user typed it
    # x, y of the lower left corner of cell (0, 0), metres
    origin_m: tuple[float, float] = struct.field(pytree_node=False, default=(0.0, 0.0))
    elevation: np.ndarray | None = None  # [H, W] float32, height of the ground at cell centres, metres; None: level
    course: Course | None = struct.field(pytree_node=False, default=None)
    within: np.ndarray | None = None  # [H, W] bool, where the robot may be and what it is to know; None: everywhere
    known: np.ndarray | None = None  # [H, W] int8, what it knows from the beginning: -1 unknown, 0 free, 1 occupied

    def __post_init__(self) -> None:
        if isinstance(self.occupied, (list, np.ndarray)):  # a world on its way through jax holds other things
            object.__setattr__(self, "occupied", _as_mask(self.name or "world", self.occupied))

    if TYPE_CHECKING:  # made by flax, unseen by type checkers

        def replace(self, **changes: Any) -> "World": ...

    @property
    def shape(self) -> tuple[int, int]:
        """Return `(H, W)`, cells."""
        return self.occupied.shape

    @property
    def free_m2(self) -> float:
        """Return the area of the free cells, square metres."""
        return float((~self.occupied).sum()) * self.cell_m**2

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        """Return `occupied`, for numpy and for `plt.imshow(world, origin="lower")`."""
        return np.array(self.occupied, dtype, copy=copy)

    def plot(self, ax: Any = None) -> Any:
        """Draw walls, rooms and start in metres of the map's frame; return the `Axes`, by default new ones."""
        ax, (rows, cols), (x_m, y_m) = axes_of(ax), self.shape, self.origin_m
        colours, rooms = np.full((rows, cols, 3), 255, np.uint8), np.full((rows, cols), -1)
        if self.rooms is not None and np.max(self.rooms) >= 0:
            rooms[:] = self.rooms
            colours[rooms >= 0] = np.array(soft_colours(int(rooms.max()) + 1), np.uint8)[rooms[rooms >= 0]]
        colours[np.asarray(self.occupied)] = 0
        extent = (x_m, x_m + cols * self.cell_m, y_m, y_m + rows * self.cell_m)
        ax.imshow(colours, origin="lower", extent=extent)
        if self.start is not None:
            row, col, heading_deg = self.start
            at, marker = (x_m + (col + 0.5) * self.cell_m, y_m + (row + 0.5) * self.cell_m), (3, 0, heading_deg - 90)
            ax.plot(*at, marker=marker, markersize=ROBOT_PT, color=ROBOT, markeredgecolor="black")
        ax.set(xlabel="x (m)", ylabel="y (m)")
        ax.set_title(self.name).set_parse_math(False)
        return ax

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write walls and origin as a map of ROS's map_server: a yaml file and a PGM; return the first.

        Missing folders are made. `jx.load_world(path, cell_m=world.cell_m)` gives the same cells and origin. Such a map
        cannot hold rooms, start and elevation.
        """
        ros = importlib.import_module("jexplore.worlds.readers.ros")  # by name: readers stand upon worlds
        path = Path(os.path.expanduser(path))
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{os.fspath(path.parent)!r} must be a folder: {error.strerror}") from None
        ros.write_ros(self.occupied, path, cell_m=self.cell_m, origin_m=self.origin_m)
        return path

    def __repr__(self) -> str:
        return f"<World {self._told() or repr(self.name)}>"

    @or_text
    def _told(self):
        name = " ".join(str(self.name).split()) or "without a name"
        if not isinstance(self.occupied, np.ndarray):  # on its way through jax
            return f"{name}; occupied: {type(self.occupied).__name__}"
        sides = " x ".join(map(str, self.shape))
        text = f"{name}; {sides} cells of {self.cell_m:g} m, {self.free_m2:.0f} m² free"
        rooms = [] if self.rooms is None else np.unique(self.rooms)
        n_rooms = sum(room >= 0 for room in rooms)
        return text + (f", {n_rooms} room{'s' if n_rooms > 1 else ''}" if n_rooms else "")

    @or_text
    def _repr_png_(self):
        from matplotlib.figure import Figure

        figure = Figure(layout="constrained")
        self.plot(figure.add_subplot())
        return png_of(figure)

    @or_text
    def _repr_html_(self):
        picture = self._repr_png_()
        return html_of(picture, self._told()) if picture else None


def _as_mask(name, occupied):
    """Convert to an array of bool. Integers are refused: `~` and sums would silently mean something else."""
    try:
        occupied = np.asarray(occupied)
    except ValueError:
        raise InputError(f"{name!r}: occupied must be [H, W] bool, got rows of different lengths") from None
    if occupied.dtype != bool:
        raise InputError(
            f"{name!r}: occupied must be [H, W] bool, True at a wall, got {occupied.dtype}; write array == 1 for a "
            "mask of 0 and 1, and jx.occupancy_to_world(array) for 0 (free) to 100 (occupied)"
        )
    return occupied


def require_world(world: World) -> World:
    """Refuse a world that the kernels cannot use; return it with its elevation as float32, its name as text."""
    if not isinstance(world.name, (str, os.PathLike)):
        raise InputError(f"the name of a world must be text, got {world.name!r}")
    world = world.replace(name=os.fspath(world.name))
    name, occupied = world.name or "world", np.asarray(world.occupied)
    if occupied.ndim != 2 or occupied.dtype != bool or not occupied.size:
        raise InputError(f"{name!r}: occupied must be [H, W] bool, got {occupied.shape} {occupied.dtype}")
    require_number(f"{name!r}: cell_m", world.cell_m, low_open=True, high=100)
    require_side(name, *ringed_shape(occupied), cell_m=world.cell_m)
    for field, (kinds, what, _) in ARRAYS.items():
        if getattr(world, field) is not None:
            array = np.asarray(getattr(world, field))
            if array.shape != occupied.shape or array.dtype.kind not in kinds:
                wanted = f"{what} of shape {occupied.shape}"
                raise InputError(f"{name!r}: {field} must be {wanted}, got {array.shape} {array.dtype}")
            if field == "elevation" and not np.isfinite(array).all():
                raise InputError(f"{name!r}: elevation must be finite; use 0 where the height of the ground is unknown")
            world = world.replace(**{field: array.astype(np.float32, copy=False) if field == "elevation" else array})
    if occupied.all():
        raise InputError(f"{name!r}: no cell is free")
    return world


def ring_of(occupied: np.ndarray) -> int:
    """Return the width of the ring that a map `[H, W]` needs, cells: 0 if all its edge is occupied, else 1."""
    return 0 if occupied[[0, -1], :].all() and occupied[:, [0, -1]].all() else 1


def ringed_shape(occupied: np.ndarray) -> tuple[int, int]:
    """Return `(H, W)` of a map with the ring that it needs, cells."""
    ring = ring_of(occupied)
    return occupied.shape[0] + 2 * ring, occupied.shape[1] + 2 * ring


def with_ring(world: World) -> World:
    """Add occupied edges to a world: unchanged if it has them, else one cell larger on every side.

    Rooms, elevation, start and origin move along, so that every cell keeps its place in metres; indices grow by
    `ring_of`.
    """
    occupied = world.occupied
    if not ring_of(occupied):
        return world
    x_m, y_m = world.origin_m
    arrays = {name: (getattr(world, name), how) for name, (_, _, how) in ARRAYS.items()}
    return world.replace(
        occupied=np.pad(occupied, 1, constant_values=True),
        **{name: None if array is None else np.pad(array, 1, **how) for name, (array, how) in arrays.items()},
        start=None if world.start is None else (world.start[0] + 1, world.start[1] + 1, world.start[2]),
        origin_m=(round(x_m - world.cell_m, 9), round(y_m - world.cell_m, 9)),  # as people write them, to the nanometre
    )


@checked_names
def occupancy_to_world(
    occupancy: ArrayLike,
    *,
    cell_m: float = 0.1,
    name: str = "",
    origin_m: Iterable[Any] = (0.0, 0.0),
    free_max: int = 25,
) -> World:
    """Make a world of an occupancy array, as in a ROS OccupancyGrid. Unknown cells count as occupied.

    Args:
      occupancy: `[H, W]` integers, -1 unknown, 0 (free) to 100 (occupied); or `[H, W]` bool, True is occupied.
        Row 0 is the bottom.
      cell_m: edge of a cell, metres.
      name: what errors and results call it.
      origin_m: x, y of the lower left corner of cell (0, 0), metres.
      free_max: a cell is free if its occupancy is from 0 to this.

    Returns:
      A `World`, its cells those of the array.

    Raises:
      InputError: not a matrix, empty, of another dtype, a value outside -1..100, no value that is a wall, no free
        cell, or too large.
    """
    what, free_max = name or "occupancy", require_whole("free_max", free_max, 0, 99)
    require_number("cell_m", cell_m, low_open=True)
    occupancy = require_occupancy(what, occupancy, free_max)
    occupied = occupancy.copy() if occupancy.dtype.kind == "b" else (occupancy < 0) | (occupancy > free_max)
    if occupied.all():
        raise InputError(f"{what!r}: no cell is free (occupancy 0 to {free_max})")
    require_side(what, *ringed_shape(occupied), cell_m=cell_m)
    return World(occupied=occupied, cell_m=float(cell_m), name=name, origin_m=tuple(origin_m))


def require_occupancy(what: str, occupancy: ArrayLike, free_max: int = 1) -> np.ndarray:
    """Return an occupancy as an array, `[H, W]` of bool or of integers from -1 to 100 that are no classes."""
    if isinstance(occupancy, np.ma.MaskedArray):
        raise InputError(f"{what!r}: has a mask; write array.filled(-1) for masked cells that are unknown")
    try:
        occupancy = np.asarray(occupancy)
    except ValueError:
        raise InputError(f"{what!r}: must be a matrix [H, W], got rows of different lengths") from None
    if occupancy.ndim != 2 or occupancy.size == 0 or occupancy.dtype.kind not in "biu":
        raise InputError(
            f"{what!r}: must be a matrix [H, W] of bool, or of integers from -1 to 100, "
            f"got {occupancy.dtype} of shape {occupancy.shape}"
            + ("; write np.rint(100 * array).astype(int) for probabilities" if occupancy.dtype.kind == "f" else "")
        )
    if occupancy.dtype.kind != "b":
        if occupancy.min() < -1 or occupancy.max() > 100:
            low, high = occupancy.min(), occupancy.max()
            raise InputError(f"{what!r}: occupancy must lie from -1 (unknown) to 100, got {low} to {high}")
        require_hundred(what, occupancy, free_max)
    return occupancy


def require_hundred(name: str, occupancy: np.ndarray, free_max: int = 1) -> None:
    """Refuse classes, such as 0, 1 and 2, where 100 is occupied: all walls up to `free_max` would be free."""
    most = int(occupancy.max())
    if not 1 <= most <= free_max:
        return
    what, write = "integers of 0 and 1 alone", "array == 1 or array * 100"
    if most > 1:
        what = f"integers up to {most}"
        write = "array == N, where N is the class of walls, or give a free_max below the walls' values"
    raise InputError(f"{name!r}: {what} would have no wall, for 100 is occupied; use bool, or 0..100: write {write}")
