"""Kernels of loop closing: the map round some key scans, and a scan's pose in it."""

import jax.numpy as jnp
from flax import struct
from jax import Array, lax

from jexplore.arrays.loops import run_if
from jexplore.slam2d.matching import Match, match
from jexplore.slam2d.points import PointMap, add, empty_map
from jexplore.slam2d.scans import read_scan
from jexplore.slam2d.search import Found, Window, draw_map, search
from jexplore.slam2d.settings import SlamSettings

WINDOW = Window(20, 30, 320, 80)  # 4 m and 30 degrees on either side, 8 m round the guess
SHAPE = (128, 128, 16)  # of the map round a candidate
FREE_M, FREE_RAD = 10.0, 1.0  # standard deviations of a guess that a measurement must not depend on


@struct.dataclass
class Keys:
    """Some key scans, the first to be added first."""

    ranges: Array  # [A, B] float32, metres
    pose: Array  # [A, 3] float32
    there: Array  # [A] bool


def map_of(settings: SlamSettings, keys: Keys, angles_rad: Array, max_range_m: Array, shape: tuple) -> PointMap:
    """Return the map that key scans make, one after the other."""

    def put(points, key):
        def added(points):
            return add(settings, points, read_scan(settings, key.ranges, angles_rad, max_range_m), key.pose)

        return run_if(key.there, added, points), None

    return lax.scan(put, empty_map(shape), keys)[0]


def verify(
    settings: SlamSettings, keys: Keys, ranges_m: Array, guess: Array, angles_rad: Array, max_range_m: Array
) -> tuple[Match, Found]:
    """Look for a scan in the map of some key scans.

    Args:
      keys: scans round the place, their poses in the frame of the guess.
      guess: `[3]` float32; the pose is looked for in `WINDOW` round it and does not depend on it otherwise.

    Returns:
      `(match, found)`: the pose with its information; the search, whose `other` tells how well another place fits.
    """
    scan = read_scan(settings, ranges_m, angles_rad, max_range_m)
    points = map_of(settings, keys, angles_rad, max_range_m, SHAPE)
    free = jnp.diag(jnp.array([FREE_M, FREE_M, FREE_RAD]) ** 2)
    picture = draw_map(settings, points, guess[:2], WINDOW.side, WINDOW.cells)
    found = search(settings, picture, scan, guess, free, WINDOW)
    return match(settings, points, scan, found.pose, free), found
