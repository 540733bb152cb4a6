"""Maps of the MovingAI benchmark: a text file with one character a cell.

Source:
  Sturtevant 2012, Benchmarks for grid-based pathfinding. Its rule that a swamp is left only into a swamp is dropped.
"""

import numpy as np

from jexplore.arrays.files import read_text
from jexplore.config import InputError
from jexplore.worlds.bounds import require_side
from jexplore.worlds.readers.grids import resample
from jexplore.worlds.world import World

_FREE, _BLOCKED = ".GS", "@OTW"  # ground, ground, swamp; out of bounds twice, trees, water
_MAX_MAP_BYTES = 128 * 2**20


def load_movingai(path: str, map_cell_m: float | None = None, *, cell_m: float = 0.1) -> World:
    """Load a world from a `.map` file, whose first row of characters is the top.

    `map_cell_m` is the edge of one cell of the file, by default `cell_m`.
    """
    if isinstance(map_cell_m, tuple):
        raise InputError(f"{path!r}: a .map file takes the metres of one cell after the '@', as in @0.1")
    map_cell_m = cell_m if map_cell_m is None else map_cell_m
    lines = read_text(path, _MAX_MAP_BYTES).splitlines()
    rows, cols, first = _header(path, lines)
    require_side(path, *(n * map_cell_m / cell_m for n in (rows, cols)), cell_m=cell_m)
    lines = [line.rstrip() for line in lines[first:]]
    while lines and not lines[-1]:
        lines.pop()
    if len(lines) != rows:
        raise InputError(f"{path!r}: its header says {rows} rows, but {len(lines)} follow")
    for number, line in enumerate(lines, start=first + 1):
        if len(line) != cols:
            raise InputError(f"{path!r}: line {number} must have {cols} characters, it has {len(line)}")
        unknown = line.strip(_FREE + _BLOCKED)
        if unknown:
            raise InputError(f"{path!r}: line {number} has {unknown[0]!r}; the characters are {_FREE} and {_BLOCKED}")
    characters = np.frombuffer("".join(lines).encode(), np.uint8).reshape(rows, cols)[::-1]
    occupied = ~np.isin(characters, np.frombuffer(_FREE.encode(), np.uint8))
    return World(occupied=resample(occupied, (map_cell_m, map_cell_m), cell_m, name=path), cell_m=cell_m, name=path)


def _header(path: str, lines: list[str]) -> tuple[int, int, int]:
    """Return rows, columns and the index of the line after `map`."""
    size = {}
    for first, line in enumerate(lines[:16], start=1):
        key, _, value = line.strip().partition(" ")
        if key == "map":
            if set(size) != {"height", "width"}:
                break
            return size["height"], size["width"], first
        if key in ("height", "width"):
            value = value.strip()
            if not (value.isascii() and value.isdigit() and len(value) < 10 and int(value) > 0):
                raise InputError(f"{path!r}: {key} must be an integer from 1, got {value!r}")
            size[key] = int(value)
        elif key != "type":
            break
    raise InputError(f"{path!r}: is not a MovingAI map; expected the lines type, height, width and map")
