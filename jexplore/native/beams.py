"""The beams of a scanner, a bit a step: each step of Amanatides and Woo's traversal is to the next column or row."""

import functools
from typing import NamedTuple

import numpy as np

from jexplore.grid import in_cells
from jexplore.raycast import HEADINGS, advance_beams, beam_angles_deg, beam_geometry, exact_direction, n_steps
from jexplore.rules import Lidar

WORD = 32


class Beams(NamedTuple):
    """The cells that beams enter, from a cell's centre, with a heading that is a multiple of 45 degrees."""

    way: np.ndarray  # [8, B, 2] int32, direction of a beam's columns and of its rows: -1 or 1
    length: np.ndarray  # [8, B] int32, cells entered at a distance below the range
    is_row: np.ndarray  # [8, B, n] uint32, a bit a step, the lowest first: whether it is to the next row


@functools.lru_cache(maxsize=8)
def trace_beams(lidar: Lidar, cell_m: float) -> Beams:
    """Trace the beams of a scanner at the robot's centre: the same cells as those of `raycast.beam_table`."""
    reach = in_cells(lidar.range_m, cell_m)
    dx, dy = exact_direction(45.0 * np.arange(HEADINGS)[:, None] + beam_angles_deg(lidar))
    geometry = beam_geometry(dx, dy, 0.5, 0.5)
    longest = n_steps(reach)
    is_row = np.zeros((*dx.shape, -(-longest // WORD)), np.uint32)
    length, state = np.zeros(dx.shape, np.int32), (np.zeros(dx.shape), np.zeros(dx.shape))
    for step in range(longest):
        rows = state[1]
        state, (_, _, entry) = advance_beams(state, geometry)
        length += entry < reach
        is_row[..., step // WORD] |= (state[1] > rows).astype(np.uint32) << np.uint32(step % WORD)
    way = np.stack([geometry[0], geometry[1]], axis=-1).astype(np.int32)
    return Beams(way, length, is_row)
