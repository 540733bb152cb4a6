"""Bounds of worlds' sizes and of generators' parameters. Plain Python: importing this loads neither jax nor numpy."""

import math
from collections.abc import Callable, Mapping
from typing import Any

from jexplore.config import InputError, require_number, require_whole

MAX_SIDE = 4096  # cells along the longer side, ring included
MAX_CELL_M = 0.3  # a wall is at least one cell thick: above this, small rooms would be lost in their walls
MAX_LOOPS = 1000.0  # ways round a 1000 m2: more than any building has
FURNISHED_CELL_M = 0.2  # a leg takes a whole cell: in larger ones furniture would bar the way
CREASES = {"slope": 3, "stairs": 4, "platform": 2, "sill": 1, "cross-slope": 2, "none": 0}
"""Name of a course's obstacle -> places that become nodes: the stairs have a landing."""

_VARIANTS = {"furniture": (0.0, 1.0), "wide_openings": (0.0, 1.0), "max_loops": (0.0, MAX_LOOPS)}
PARAMETERS: dict[str, dict[str, Any]] = {
    "cave": {"free": (0.5, 0.9), "passage_m": (0.8, 100.0)},
    "office": {"corridor_m": (1.5, 3.0), "room_m": (2.6, 6.0), "corridor_sd_m": (0.0, 1.0), **_VARIANTS},
    "hospital": {"corridor_m": (1.8, 3.5), "room_m": (3.4, 7.0), "corridor_sd_m": (0.0, 1.0), **_VARIANTS},
    "maze": {"corridor_m": (0.8, 100.0), "wall_m": (0.01, 10.0), "loops": (0.0, 1.0)},
    "rooms": {"room_m": (2.0, 100.0), "extra_doors": (0.0, 1.0), **_VARIANTS},
    "course": {
        "cell_m": (0.001, 0.2),
        "width_m": (1.2, 3.0),
        "riser_m": (0.01, 0.3),
        "obstacle": tuple(CREASES),
        "loops": (0, 3),
        "repeat": (0, 10),
    },
}
"""Generator -> parameter -> its least and largest value, an integer where these are; or its words."""
LEAST_M: dict[str, Callable[[Mapping[str, Any]], tuple[float, ...]]] = {
    "office": lambda given: (14.0, 9.0),
    "hospital": lambda given: (32.0, 11.0),
    "cave": lambda given: (max(6.0, 6 * given["passage_m"]),) * 2,
    "maze": lambda given: (2 * given["corridor_m"] + 3 * given["wall_m"],) * 2,
    "rooms": lambda given: (2 * given["room_m"],) * 2,
}
"""Generator -> the least width and height of its worlds by their parameters, metres."""


def require_generator(kind: str, given: Mapping[str, Any]) -> None:
    """Refuse parameters that a generator cannot draw; `given` are all of them, `cell_m` included."""
    for name, bounds in PARAMETERS[kind].items():
        what, value = f"{kind}: {name}", given[name]
        if isinstance(bounds[0], str):
            if value not in bounds:
                raise InputError(f"{what} must be one of {', '.join(bounds)}, got {value!r}")
        elif isinstance(bounds[0], int):
            require_whole(what, value, *bounds)
        else:
            require_number(what, value, low=bounds[0], high=bounds[1])
    if kind == "course":
        _require_course(**{key: given[key] for key in ("furniture", "dead_ends", "loops", "repeat")})
        return
    low_m, cell_m = LEAST_M[kind](given), given["cell_m"]
    require_number(f"{kind}: cell_m", cell_m, low=0.001, high=MAX_CELL_M)
    for side, low in zip(("width_m", "height_m"), low_m):
        require_number(f"{kind}: {side}", given[side], low=low, high=1e4)
    require_side(kind, count_cells(given["height_m"], cell_m), count_cells(given["width_m"], cell_m))
    if given.get("furniture", 0) > 0 and cell_m > FURNISHED_CELL_M:
        raise InputError(f"{kind}: furniture needs a cell_m of at most {FURNISHED_CELL_M:g}, got {cell_m:g}")


def _require_course(furniture: bool, dead_ends: bool, loops: int, repeat: int) -> None:
    """Refuse parameters of a course that exclude each other."""
    if repeat == 1:
        raise InputError("course: repeat must be from 2 to 10, or 0 for none, got 1")
    if furniture and (loops or repeat):
        raise InputError("course: furniture must be false where there are loops or repeat, got true")
    if repeat and not dead_ends:
        raise InputError("course: dead_ends must be true with repeat, whose side passages are dead ends, got false")


def count_cells(size_m: float, cell_m: float) -> int:
    """Return the cells that cover a length: `ceil(size / cell)`, at least one, with a tolerance for rounding."""
    return max(1, math.ceil(size_m / cell_m - 1e-6))


def require_side(name: str, rows: float, cols: float, cell_m: float | None = None) -> None:
    """Refuse a world of more than `MAX_SIDE` rows or columns, before anything of that size is allocated.

    The size in cells may be infinite. From `cell_m` the error reckons an edge of a cell that would do.
    """
    if max(rows, cols) <= MAX_SIDE:
        return
    larger, least_m = "use a larger cell_m", max(rows, cols) / (MAX_SIDE - 2) * (cell_m or math.inf)
    if least_m <= 100:  # the largest there is
        digit = 10.0 ** (math.floor(math.log10(least_m)) - 1)
        larger += f", at least {math.ceil(least_m / digit) * digit:.2g}"
    elif cell_m is not None:
        larger = "see whether its scale, the metres of a pixel, is right"
    size = f"{math.ceil(rows)} x {math.ceil(cols)}" if max(rows, cols) < 1e9 else "over a billion"
    raise InputError(f"{name!r}: {size} cells are more than {MAX_SIDE} a side; {larger}, or cut the map into parts")
