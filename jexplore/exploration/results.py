"""Measures of an episode in metres, radians and words, converted from the device's integers here only."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from jexplore.exploration.motion import EIGHTH_TURN_RAD
from jexplore.exploration.state import PERCENTILES, Outcome, Result
from jexplore.rules import Robot

UNKNOWN, FREE, OCCUPIED = 0, 1, 2


def path_m(straight: ArrayLike, diagonal: ArrayLike, cell_m: float) -> Any:
    """Return the length of a path of straight and diagonal steps, metres: float64, of the shape of the arguments."""
    return (np.asarray(straight, np.float64) + np.asarray(diagonal, np.float64) * math.sqrt(2)) * cell_m


def progress_m(result: Result, cell_m: float) -> np.ndarray:
    """Return the path driven when each 1 / `MARKS` of the world's knowable cells was first known.

    `[N, MARKS]` float64, metres; NaN where that share was never known.
    """
    if result.way_m is not None:
        return np.asarray(result.way_m[..., 1 + len(PERCENTILES) :], np.float64)
    metres = path_m(result.straight_along, result.diagonal_along, cell_m)
    return np.where(np.asarray(result.straight_along) < 0, np.nan, metres)


def turning_rad(result: Result) -> np.ndarray:
    """Return the angle turned in episodes: `[N]` float64, radians."""
    turned = result.turns * EIGHTH_TURN_RAD if result.ride is None else result.ride[:, 0]
    return np.asarray(turned, np.float64)


def energy_j(result: Result, robot: Robot, cell_m: float) -> np.ndarray:
    """Return the energy of episodes: `[N]` float64, joules.

    Standby power all the time, rolling by the metre, turning by the radian, and the kinetic energy of every run, which
    braking loses.

    Source:
      Mei et al. 2005: a Pioneer 3-DX draws 0.29 W + 7.4 J/m times its speed to move. Added: turning in place, and the
      kinetic energy, which is not in what they measured at even speeds.
    """
    way_m, full = path_m(result.straight, result.diagonal, cell_m), np.asarray(result.starts) / 1000
    if result.ride is not None and result.way_m is not None:
        way_m, full = (np.asarray(a, np.float64) for a in (result.way_m[:, 0], result.ride[:, 1]))
    rolled = robot.drive_j_m * way_m
    turned = robot.turn_j_rad * turning_rad(result)
    kinetic = robot.mass_kg / 2 * robot.speed_m_s**2 * full
    return robot.standby_w * np.asarray(result.time_ms) / 1000 + rolled + turned + kinetic


def _area(along: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """Return the area above a curve of the known share: its mean over shares, `whole` for those never known."""
    return np.where(np.isnan(along), whole[:, None], along).mean(axis=1)


def length_along_m(rows: np.ndarray, cols: np.ndarray, cell_m: float) -> np.ndarray:
    """Return the length of a walk from its first cell to each of its N cells, neighbours in order: `[N]`, metres."""
    diagonal = np.concatenate([[0], np.cumsum((np.diff(rows) != 0) & (np.diff(cols) != 0))])
    return path_m(np.arange(len(rows)) - diagonal, diagonal, cell_m)


def map_state(hits: np.ndarray, misses: np.ndarray, p_free: float) -> np.ndarray:
    """Classify the cells of a reflection map: `[H, W]` uint8, 0 unknown, 1 free, 2 occupied.

    `p_free`, the largest probability of a free cell, is judged in float32 as on the device.
    """
    seen = hits + misses
    free = hits.astype(np.float32) <= np.float32(p_free) * seen.astype(np.float32)
    return np.where(seen == 0, UNKNOWN, np.where(free, FREE, OCCUPIED)).astype(np.uint8)


def to_occupancy(state: np.ndarray) -> np.ndarray:
    """Convert a map of `map_state` to ROS counts: `[H, W]` int8, -1 unknown, 0 free, 100 occupied."""
    return np.array([-1, 0, 100], np.int8)[state]


def columns(
    result: Result, starts: np.ndarray, *, seed: int, cell_m: float, has_rooms: bool, robot: Robot
) -> dict[str, Any]:
    """Return the columns of a table of episodes, arrays `[N]`, of a numpy `Result` with a leading axis N.

    `starts`: `[N, 3]` int, row, col, heading in degrees. `room_entries` is a list, of None for a world without rooms.
    """
    n, whole_m = len(result.outcome), path_m(result.straight, result.diagonal, cell_m)
    if result.way_m is not None:
        whole_m = np.asarray(result.way_m[:, 0], np.float64)
    whole_s = np.asarray(result.time_ms, np.float64) / 1000
    along_s = np.where(result.time_along < 0, np.nan, result.time_along / 1000)
    table = {
        "episode": np.arange(n, dtype=np.int64),
        "seed": np.full(n, seed, np.int64),
        "start_row": starts[:, 0].astype(np.int64),
        "start_col": starts[:, 1].astype(np.int64),
        "start_heading_deg": starts[:, 2].astype(np.int64),
        "path_m": whole_m,
        "turning_rad": turning_rad(result),
        "time_s": whole_s,
        "energy_j": energy_j(result, robot, cell_m),
        "steps": (result.straight + result.diagonal).astype(np.int64),
        "scans": result.scans.astype(np.int64),
        "plans": result.plans.astype(np.int64),
        "outcome": [Outcome(int(code)).name for code in result.outcome],
        "exhausted": result.exhausted.astype(np.int64),
        "explored_fraction": result.explored / np.maximum(result.explorable, 1).astype(np.float64),
    }
    for i, q in enumerate(PERCENTILES):
        table[f"path_m_at_{q}"] = path_m(result.straight_at[:, i], result.diagonal_at[:, i], cell_m)
        table[f"time_s_at_{q}"] = result.time_at[:, i] / 1000
    table |= {"area_m": _area(progress_m(result, cell_m), whole_m), "area_s": _area(along_s, whole_s)}
    if result.way_m is not None:
        names = (f"path_m_at_{q}" for q in PERCENTILES)
        table |= dict(zip(names, np.asarray(result.way_m[:, 1:], np.float64).T))
    table["room_entries"] = [int(count) if has_rooms else None for count in result.room_entries]
    table["refused"] = result.refused.astype(np.int64)
    table["overflow"] = result.overflow.astype(np.int64)
    table["saturated"] = result.saturated.astype(np.int64)
    return table
