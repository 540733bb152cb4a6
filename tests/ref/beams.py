"""Oracle for the scanner: one beam at a time, one cell at a time, float64.

Lengths are in cells. A position is a cell `(row, col)` and an offset `(x0, y0)` in it, both in [0, 1), 0.5 at the
centre; x runs along columns, y along rows. Angles are in degrees, counter-clockwise from +x.
"""

import functools
import math


def direction(deg):
    """Unit vector of a direction, `(c, s)` = (cosine, sine).

    Exact where it matters: 0 and 1 on the axes, `|c| == |s|` on the diagonals, 0.5 at 30 and 60 degrees and their like.
    """
    quarter, rest = divmod(deg % 360.0, 90.0)
    if rest <= 45.0:
        c, s = _first_octant(rest)
    else:
        s, c = _first_octant(90.0 - rest)
    for _ in range(int(quarter)):
        c, s = -s, c
    return c + 0.0, s + 0.0  # + 0.0 turns -0.0 into 0.0


def _first_octant(deg):
    if deg == 45.0:
        return math.sqrt(0.5), math.sqrt(0.5)
    if deg == 30.0:
        return math.sqrt(0.75), 0.5
    return math.cos(math.radians(deg)), math.sin(math.radians(deg))


def lidar_angles(n_beams, fov_deg):
    """Directions of the beams relative to the heading, degrees, in ascending order.

    A single beam looks straight ahead. Below 360 degrees both edges are included. At 360 degrees the first beam looks
    back (-180) and the last stops 360 / n_beams before that.
    """
    if n_beams == 1:
        return [0.0]
    gaps = n_beams if fov_deg == 360 else n_beams - 1
    # One division for each: the beam in the middle looks straight ahead, not past it by a rounding.
    return [(2 * i - gaps) * fov_deg / (2 * gaps) for i in range(n_beams)]


def in_cells(range_m, cell_m):
    """A range in cells, rounded to 1e-9: 1.05 m are 3.5 cells of 0.3 m, no more."""
    return round(range_m / cell_m, 9)


def beam_entries(c, s, max_range_cells, x0=0.5, y0=0.5):
    """Cells that a beam enters at a distance < range, as `(distance, drow, dcol)` in order (Amanatides and Woo 1987).

    The k-th vertical grid line is crossed at `(to the first line + k) / |c|`, the k-th horizontal one at the same with
    `|s|`. Through an exact corner the beam steps in x first: it enters the x-neighbour and, at the same distance, the
    diagonal cell.
    """
    step_x, first_x = (1, 1.0 - x0) if c > 0 else (-1, x0)
    step_y, first_y = (1, 1.0 - y0) if s > 0 else (-1, y0)
    crossed_x = crossed_y = 0
    entries = []
    while True:
        next_x = (first_x + crossed_x) / abs(c) if c != 0 else math.inf
        next_y = (first_y + crossed_y) / abs(s) if s != 0 else math.inf
        if min(next_x, next_y) >= max_range_cells:
            return entries
        if next_x <= next_y:
            crossed_x += 1
        else:
            crossed_y += 1
        entries.append((min(next_x, next_y), step_y * crossed_y, step_x * crossed_x))


_entries_again = functools.lru_cache(maxsize=4096)(beam_entries)  # an episode asks for the same few hundred


def cast(occupied, row, col, deg, max_range_cells, x0=0.5, y0=0.5):
    """One beam: `(missed, hit, distance)`.

    `missed`: the cells `(row, col)` passed before the first occupied one. `hit`: that cell, or None. `distance`: where
    the beam enters the hit cell, cells; `max_range_cells` without one. A beam that leaves the array ends there, without
    hit.
    """
    c, s = direction(deg)
    missed = []
    for distance, drow, dcol in _entries_again(c, s, max_range_cells, x0, y0):
        r, k = row + drow, col + dcol
        if not (0 <= r < occupied.shape[0] and 0 <= k < occupied.shape[1]):
            break
        if occupied[r, k]:
            return missed, (r, k), distance
        missed.append((r, k))
    return missed, None, max_range_cells


def scan(occupied, row, col, heading_deg, n_beams, fov_deg, max_range_cells, x0=0.5, y0=0.5):
    """One scan: a list of `(missed, hit)`, one for each beam in the order of `lidar_angles`."""
    angles = lidar_angles(n_beams, fov_deg)
    return [cast(occupied, row, col, heading_deg + a, max_range_cells, x0, y0)[:2] for a in angles]


@functools.cache
def line(x, y):
    """Cells of the way from a cell's centre to a point beyond which it goes on a little, `(drow, dcol)` in order.

    A step of a ten-thousandth of a cell at a time, first in x, then in y; a corner is passed within a thousandth.
    """
    n = max(round(10_000 * math.hypot(x, y)), 1) + 10
    cells = [(0, 0)]
    for i in range(n + 1):
        row, col = (math.floor(0.5 + a * i / (n - 10) + math.copysign(slack, a)) for a, slack in ((y, 0.0), (x, 1e-3)))
        for cell in ((cells[-1][0], col), (row, col)):
            if cell != cells[-1]:
                cells.append(cell)
    return cells[1:]


def mounted_scan(occupied, row, col, heading_deg, lidar, cell_m):
    """One scan of a `Lidar` with a mount and a least range: `(missed, hit)` of the beams that say anything.

    Every beam comes from the robot's centre over the scanner; one that is stopped on the way to the scanner, or nearer
    to it than the least range, says nothing.
    """
    c, s = direction(heading_deg)
    forward, left = in_cells(lidar.forward_m, cell_m), in_cells(lidar.left_m, cell_m)
    x, y = (forward * a + left * b + 0.5 for a, b in ((c, -s), (s, c)))
    to = math.floor(y), math.floor(x)
    before = line(x - 0.5, y - 0.5)[: abs(to[0]) + abs(to[1])]
    assert before[-1:] in ([], [to])
    before = [(row + drow, col + dcol) for drow, dcol in before]
    if any(occupied[cell] for cell in before):
        return []
    least, reach = in_cells(lidar.min_range_m, cell_m), in_cells(lidar.range_m, cell_m)
    told = []
    for angle in lidar_angles(lidar.n_beams, lidar.fov_deg):
        deg = heading_deg + lidar.yaw_deg + angle
        missed, hit, distance = cast(occupied, row + to[0], col + to[1], deg, reach, x % 1, y % 1)
        if hit is None or distance >= least:
            told.append((before + missed, hit))
    return told


def fold(hits, misses, row, col, beams):
    """Count a scan into the map, in place: each beam by itself, and one miss a scan in the robot's own cell."""
    misses[row, col] += 1
    for missed, hit in beams:
        for cell in missed:
            misses[cell] += 1
        if hit is not None:
            hits[hit] += 1
