"""Largest size of a world. Plain Python: importing this loads neither jax nor numpy."""

import math

from jexplore.config import InputError

MAX_SIDE = 4096  # cells along the longer side, ring included


def require_side(name: str, rows: float, cols: float, cell_m: float | None = None) -> None:
    """Refuse a world of more than `MAX_SIDE` rows or columns, before anything of that size is allocated.

    Args:
      name: what the error calls the world.
      rows, cols: its size, cells; may be infinite.
      cell_m: edge of a cell, metres, from which the error reckons one that would do.

    Raises:
      InputError: naming the world, the size, and how to go on.
    """
    if max(rows, cols) <= MAX_SIDE:
        return
    larger, cut = "use a larger cell_m", "cut the map into parts"
    if cell_m is not None:
        least_m = max(rows, cols) / (MAX_SIDE - 2) * cell_m
        if least_m <= 100:  # the largest there is
            digit = 10.0 ** (math.floor(math.log10(least_m)) - 1)
            larger = f"use a larger cell_m, at least {math.ceil(least_m / digit) * digit:.2g}"
        else:
            larger = "see whether its scale, the metres of a pixel, is right"
    size = f"{math.ceil(rows)} x {math.ceil(cols)}" if max(rows, cols) < 1e9 else "over a billion"
    raise InputError(f"{name!r}: {size} cells are more than {MAX_SIDE} a side; {larger}, or {cut}")
