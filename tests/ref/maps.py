"""Maps for tests: drawn by hand, or at random from a seed. Row 0 is the bottom, so a drawing shows what one sees."""

import numpy as np

ROOM = """
    #######
    #.....#
    #..#..#
    #.....#
    #######
"""
"""A room with a pillar in its middle."""


def drawn(text):
    """Characters of a drawn map, `[H, W]`."""
    return np.array([list(line) for line in text.split()][::-1])


def walls(text):
    """Cells drawn as `#`."""
    return drawn(text) == "#"


def one(text, mark):
    """`(row, col)` of the one cell drawn as `mark`."""
    (cell,) = np.argwhere(drawn(text) == mark)
    return int(cell[0]), int(cell[1])


def picture(hits, misses):
    """A map of counts as drawn, top row first: `?` never observed, `#` hit at least once, `.` only missed."""
    cells = np.where(hits + misses == 0, "?", np.where(hits > 0, "#", "."))
    return ["".join(row) for row in cells[::-1]]


def cluttered(seed, height, width):
    """A ringed world of rooms with doors and some single pillars, and the number of each cell's room (-1 in walls).

    Returns:
      `occupied`: `[H, W]` bool; `rooms`: `[H, W]` int32.
    """
    draw = np.random.default_rng(seed)
    occupied = draw.random((height, width)) < 0.01
    occupied[[0, -1], :] = occupied[:, [0, -1]] = True
    row, col = (int(draw.integers(n // 3, 2 * n // 3)) for n in (height, width))
    occupied[row, :] = occupied[:, col] = True
    doors = ((row, slice(2, col - 1)), (row, slice(col + 2, width - 2)), (slice(2, row - 1), col))
    for across, along in doors:
        free = range(*(along if isinstance(along, slice) else across).indices(max(height, width)))
        n = min(len(free), 9)
        first = int(draw.integers(free[0], free[0] + len(free) - n + 1))
        gap = slice(first, first + n)
        occupied[(across, gap) if isinstance(along, slice) else (gap, along)] = False
    rows, cols = np.indices(occupied.shape)
    rooms = np.where(occupied, -1, 2 * (rows > row) + (cols > col)).astype(np.int32)
    return occupied, rooms
