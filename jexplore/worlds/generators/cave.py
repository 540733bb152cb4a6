"""A cave: one open space with lobes, pillars and tongues of rock."""

import math

import numpy as np
from scipy import ndimage

from jexplore.worlds.bounds import count_cells
from jexplore.worlds.generators.draft import PASSABLE_M, random_stream
from jexplore.worlds.starts import clear_of_walls, largest_component
from jexplore.worlds.world import World

_DESIGN_M = 0.1  # rocks are placed on a lattice of this width, whatever `cell_m` is
_RIM_M = 0.4  # rock along the edges, before it is roughened
_N_WAVES = 24
_ROUGH_M = 0.2  # standard deviation of the outlines
_MARGIN_M = 1.0  # no outline moves further than this
_LEAST_M2 = 0.3  # a rock that adds less finds no place
_FAILURES = 200  # draws in a row that find no place


def cave(
    seed: int,
    *,
    cell_m: float = 0.1,
    width_m: float = 16.0,
    height_m: float = 16.0,
    free: float = 0.7,
    passage_m: float = 1.0,
) -> World:
    """Generate an open cave: rocks with rounded, rough outlines stand free, lean on the rim or reach in from it.

    Rocks are added until the free part has shrunk to `free`, 0.5 to 0.9, or no more fit with passages between them:
    some 0.65 at 16 m a side and 0.8 at 100 m. Narrow places are filled afterwards, seldom more than 0.05 of the area. A
    disc of diameter `passage_m` can reach every place, up to a cell.
    """
    rng = random_stream(seed, "cave")
    waves = _draw_waves(rng)
    rocks = _place_rocks(rng, (width_m, height_m), waves, free, 1.25 * passage_m)
    occupied = _draw(rocks, (width_m, height_m), waves, cell_m)
    return World(occupied=_widen(occupied, passage_m / 2 / cell_m, cell_m), cell_m=float(cell_m))


def _draw_waves(rng):
    """Draw plane waves that roughen outlines: `[n, 4]`, wave vector (x, y) per metre, phase, amplitude in metres."""
    length = rng.uniform(1.5, 8.0, _N_WAVES)
    angle, phase = rng.uniform(0, 2 * np.pi, (2, _N_WAVES))
    amplitude = _ROUGH_M * np.sqrt(2 * length / length.sum())
    return np.stack([2 * np.pi / length * np.cos(angle), 2 * np.pi / length * np.sin(angle), phase, amplitude], axis=1)


def _roughness(waves, x, y):
    """Sum the waves at `y` (rows) and `x` (columns), metres: a product of thin matrices, not a sum of grids."""
    kx, ky, phase, amplitude = waves.T
    across, along = x[:, None] * kx + phase, y[:, None] * ky
    left = np.concatenate([np.cos(along) * amplitude, np.sin(along) * amplitude], axis=1)
    right = np.concatenate([np.cos(across), -np.sin(across)], axis=1)
    return left @ right.T


def _outside(rock, x, y):
    """Compute the signed distance to a rock, a turned box with round corners, metres: `[len(y), len(x)]`."""
    cx, cy, half_x, half_y, turn, radius = rock
    dx, dy = (x - cx)[None, :], (y - cy)[:, None]
    u = np.abs(dx * np.cos(turn) + dy * np.sin(turn)) - (half_x - radius)
    v = np.abs(dy * np.cos(turn) - dx * np.sin(turn)) - (half_y - radius)
    return np.hypot(np.maximum(u, 0), np.maximum(v, 0)) + np.minimum(np.maximum(u, v), 0) - radius


def _window(rock, n, cell_m, margin_m):
    """Return slices `(y, x)` of the cells around a rock, and the coordinates of their centres."""
    reach = math.hypot(rock[2], rock[3]) + margin_m
    spans = []
    for middle, count in ((rock[1], n[0]), (rock[0], n[1])):
        low, high = math.floor((middle - reach) / cell_m), math.ceil((middle + reach) / cell_m)
        spans.append(slice(max(0, low), max(0, min(count, high))))
    y, x = ((np.arange(span.start, span.stop) + 0.5) * cell_m for span in spans)
    return tuple(spans), x, y


def _draw(rocks, size_m, waves, cell_m):
    """Draw the rim and the rocks as cells, `[H, W]` bool."""
    rows, cols = (count_cells(side, cell_m) for side in size_m[::-1])
    x, y = ((np.arange(n) + 0.5) * cell_m for n in (cols, rows))
    rim = np.minimum(np.minimum(x, size_m[0] - x)[None, :], np.minimum(y, size_m[1] - y)[:, None])
    occupied = rim + _roughness(waves, x, y) < _RIM_M
    for rock in rocks:
        where, x, y = _window(rock, (rows, cols), cell_m, _MARGIN_M)
        occupied[where] |= _outside(rock, x, y) + _roughness(waves, x, y) < 0
    occupied[[0, -1], :] = True
    occupied[:, [0, -1]] = True
    return occupied


def _place_rocks(rng, size_m, waves, free, gap_m):
    """Draw groups of rocks until enough is rock. They keep `gap_m` from each other; some lean on the rim."""
    n = tuple(math.ceil(side / _DESIGN_M) for side in size_m[::-1])  # also where a side is whole but for rounding
    rim = _draw([], size_m, waves, _DESIGN_M)
    taken = rim.copy()
    rocks, failures, missing = [], 0, (1 - free) * taken.size - taken.sum()
    while missing > 0 and failures < _FAILURES:
        leaning = rng.random() < 0.3
        group = _draw_group(rng, size_m, leaning)
        shapes = [_shape(rock, n, waves, gap_m) for rock in group]
        leans = any((shape & rim[where]).any() for where, shape in shapes)
        added = sum((shape & ~taken[where]).sum() for where, shape in shapes)
        fits = leans == leaning and added * _DESIGN_M**2 > _LEAST_M2
        if not fits or any(
            _distance(shape, taken[where] & ~rim[where] if leaning else taken[where]) * _DESIGN_M < gap_m
            for where, shape in shapes
        ):
            failures += 1
            continue
        rocks += group
        failures = 0
        missing -= added
        for where, shape in shapes:
            taken[where] |= shape
    return rocks


def _shape(rock, n, waves, gap_m):
    """Draw a rough rock as cells of the design lattice, with room for a gap around it: `(where, shape)`."""
    where, x, y = _window(rock, n, _DESIGN_M, gap_m + _MARGIN_M)
    return where, _outside(rock, x, y) + _roughness(waves, x, y) < 0


def _distance(shape, obstacles):
    """Return the least distance between the cells of two masks, cells; infinite if one is empty."""
    if not (shape.any() and obstacles.any()):
        return np.inf
    return np.asarray(ndimage.distance_transform_edt(~obstacles))[shape].min()


def _draw_group(rng, size_m, leaning):
    """Draw a pillar, a pillar with a bump, or a tongue of up to four rocks that bends inwards from the rim."""
    small = min(1.0, min(size_m) / 12)
    if not leaning:
        half = rng.uniform(0.6, 1.6, 2) * small
        middle = [rng.uniform(0, side) for side in size_m]
        turn = rng.normal(0, 0.25)
        group = [(*middle, *half, turn, 0.5 * half.min())]
        if rng.random() < 0.35:
            angle = rng.uniform(0, 2 * np.pi)
            bump = rng.uniform(0.5, 0.9, 2) * small
            at = np.array(middle) + 0.9 * half * (np.cos(angle), np.sin(angle))
            group.append((*at, *bump, turn + rng.uniform(0.4, 1.1), 0.4 * bump.min()))
        return group
    edge = rng.integers(4)
    along = rng.uniform(0.08, 0.92)
    at = np.array([(0.0, along), (1.0, along), (along, 0.0), (along, 1.0)][edge]) * size_m
    heading = (0.0, np.pi, np.pi / 2, -np.pi / 2)[edge] + rng.normal(0, 0.2)
    n = rng.choice([1, 2, 3, 4])
    group = []
    for _ in range(n):
        half = np.array([rng.uniform(1.0, 1.7), rng.uniform(0.7, 1.2) if n > 1 else rng.uniform(1.0, 2.4)]) * small
        group.append((*at, *half, heading, 0.5 * half.min()))
        at = at + 1.5 * half[0] * np.array([np.cos(heading), np.sin(heading)])
        heading += rng.normal(0, 0.45)
    return group


def _widen(occupied, radius, cell_m):
    """Fill what a disc of `radius` cells cannot touch, and every pocket: the clear cells are then one component."""
    inside = largest_component(ndimage.distance_transform_edt(~occupied) > radius)
    occupied = ndimage.distance_transform_edt(~inside) > radius
    occupied |= ~largest_component(~occupied)
    while (pockets := (clear := clear_of_walls(occupied, PASSABLE_M, cell_m)) & ~largest_component(clear)).any():
        occupied = ~largest_component(~(occupied | pockets))
    return occupied
