"""Bounds of the parameters of generators. Plain Python: importing this loads neither jax nor numpy."""

import math
from collections.abc import Callable
from typing import Any

from jexplore.config import InputError, require_number, require_whole
from jexplore.worlds.sides import require_side

MAX_CELL_M = 0.3  # a wall is at least one cell thick: above this, small rooms would be lost in their walls
MAX_LOOPS = 1000.0  # ways round a 1000 m2: more than any building has
FURNISHED_CELL_M = 0.2  # a leg takes a whole cell: in larger ones furniture would bar the way
OBSTACLES = {"slope": 3, "stairs": 4, "platform": 2, "sill": 1, "cross-slope": 2, "none": 0}
"""Name of a course's obstacle -> places that become nodes: the stairs have a landing."""


def cave(cell_m: float, *, width_m: float, height_m: float, free: float, passage_m: float) -> None:
    """Refuse parameters of `cave.cave` that are out of range."""
    require_number("cave: free", free, low=0.5, high=0.9)
    require_number("cave: passage_m", passage_m, low=0.8, high=100)
    low = max(6.0, 6 * passage_m)
    require_size("cave", cell_m, width_m, height_m, (low, low))


def office(
    cell_m: float,
    *,
    width_m: float,
    height_m: float,
    corridor_m: float,
    room_m: float,
    corridor_sd_m: float,
    open_plan: object = False,
    **variants: float,
) -> None:
    """Refuse parameters of `office.office` that are out of range."""
    require_number("office: corridor_m", corridor_m, low=1.5, high=3)
    require_number("office: room_m", room_m, low=2.6, high=6)
    require_size("office", cell_m, width_m, height_m, (14.0, 9.0))
    require_number("office: corridor_sd_m", corridor_sd_m, high=1)
    require_variants("office", cell_m, **variants)


def hospital(
    cell_m: float,
    *,
    width_m: float,
    height_m: float,
    corridor_m: float,
    room_m: float,
    corridor_sd_m: float,
    **variants: float,
) -> None:
    """Refuse parameters of `hospital.hospital` that are out of range."""
    require_number("hospital: corridor_m", corridor_m, low=1.8, high=3.5)
    require_number("hospital: room_m", room_m, low=3.4, high=7)
    require_size("hospital", cell_m, width_m, height_m, (32.0, 11.0))
    require_number("hospital: corridor_sd_m", corridor_sd_m, high=1)
    require_variants("hospital", cell_m, **variants)


def maze(
    cell_m: float, *, width_m: float, height_m: float, corridor_m: float, wall_m: float, loops: float
) -> tuple[int, int]:
    """Refuse parameters of `maze.maze` that are out of range; `(rows, cols)`, cells."""
    require_number("maze: corridor_m", corridor_m, low=0.8, high=100)
    require_number("maze: wall_m", wall_m, low=0.01, high=10)
    require_number("maze: loops", loops, high=1)
    low = 2 * corridor_m + 3 * wall_m
    return require_size("maze", cell_m, width_m, height_m, (low, low))


def rooms(
    cell_m: float, *, width_m: float, height_m: float, room_m: float, extra_doors: float, **variants: float
) -> None:
    """Refuse parameters of `rooms.rooms` that are out of range."""
    require_number("rooms: room_m", room_m, low=2.0, high=100)
    require_number("rooms: extra_doors", extra_doors, high=1)
    require_size("rooms", cell_m, width_m, height_m, (2 * room_m, 2 * room_m))
    require_variants("rooms", cell_m, **variants)


def course(
    cell_m: float,
    *,
    width_m: float,
    obstacle: str,
    riser_m: float,
    furniture: bool,
    dead_ends: bool,
    loops: int,
    repeat: int,
) -> None:
    """Refuse parameters of `course.course` that are out of range or exclude each other."""
    require_number("course: cell_m", cell_m, low=0.001, high=0.2)
    require_number("course: width_m", width_m, low=1.2, high=3.0)
    require_number("course: riser_m", riser_m, low=0.01, high=0.3)
    if obstacle not in OBSTACLES:
        raise InputError(f"course: obstacle must be one of {', '.join(OBSTACLES)}, got {obstacle!r}")
    for name, value in (("furniture", furniture), ("dead_ends", dead_ends)):
        if not isinstance(value, bool):
            raise InputError(f"course: {name} must be true or false, got {value!r}")
    require_whole("course: loops", loops, 0, 3)
    require_whole("course: repeat", repeat, 0, 10)
    if repeat == 1:
        raise InputError("course: repeat must be from 2 to 10, or 0 for none, got 1")
    if furniture and (loops or repeat):
        raise InputError("course: furniture must be false where there are loops or repeat, got true")
    if repeat and not dead_ends:
        raise InputError("course: dead_ends must be true with repeat, whose side passages are dead ends, got false")


CHECKS: dict[str, Callable[..., Any]] = {
    "cave": cave,
    "office": office,
    "hospital": hospital,
    "maze": maze,
    "rooms": rooms,
    "course": course,
}
"""Name of a generator -> what refuses its parameters, called with `cell_m` and all of them by name."""


def require_size(
    kind: str, cell_m: float, width_m: float, height_m: float, low: tuple[float, float]
) -> tuple[int, int]:
    """Refuse a size that a generator cannot draw.

    Args:
      kind: name of the generator, for the message.
      cell_m: edge of a cell, metres.
      width_m, height_m: outer size, metres.
      low: the smallest width and height, metres.

    Returns:
      `(rows, cols)`, cells.

    Raises:
      InputError: not numbers, too small to hold the layout, or more than `MAX_SIDE` cells a side.
    """
    require_number(f"{kind}: cell_m", cell_m, low=0.001, high=MAX_CELL_M)
    require_number(f"{kind}: width_m", width_m, low=low[0], high=1e4)
    require_number(f"{kind}: height_m", height_m, low=low[1], high=1e4)
    rows, cols = (math.ceil(side / cell_m - 1e-6) for side in (height_m, width_m))
    require_side(kind, rows, cols)
    return rows, cols


def require_variants(kind: str, cell_m: float, *, furniture: float, wide_openings: float, max_loops: float) -> None:
    """Refuse shares and numbers out of range.

    Args:
      kind: name of the generator, for the message.
      cell_m: edge of a cell, metres.
      furniture, wide_openings: shares, 0 to 1.
      max_loops: ways round a 1000 m2, 0 to `MAX_LOOPS`.

    Raises:
      InputError: one of them is out of range, or there is furniture in cells over `FURNISHED_CELL_M`.
    """
    require_number(f"{kind}: furniture", furniture, high=1)
    require_number(f"{kind}: wide_openings", wide_openings, high=1)
    require_number(f"{kind}: max_loops", max_loops, high=MAX_LOOPS)
    if furniture > 0 and FURNISHED_CELL_M < cell_m <= MAX_CELL_M:
        raise InputError(f"{kind}: furniture needs a cell_m of at most {FURNISHED_CELL_M:g}, got {cell_m:g}")
