"""Kernels of loop closing: the map round some key scans, and a scan's pose in it."""

from typing import NamedTuple

import jax.numpy as jnp
from flax import struct
from jax import Array, lax

from jexplore.arrays.loops import run_if
from jexplore.slam2d.matching import Match, match
from jexplore.slam2d.points import PointMap, add, empty_map
from jexplore.slam2d.scans import read_scan
from jexplore.slam2d.search import Found, Window, search
from jexplore.slam2d.settings import SlamSettings

WINDOW = Window(20, 30)  # 4.2 m and 45 degrees on either side, 7.8 m round the guess
SHAPE = (800, 800, 4096)  # of the map round a candidate: 28 m
FREE_M, FREE_RAD = 10.0, 1.0  # standard deviations of a guess that a measurement must not depend on


@struct.dataclass
class Keys:
    """Some key scans, the first to be added first."""

    ranges: Array  # [A, B] float32, metres
    pose: Array  # [A, 3] float32
    there: Array  # [A] bool


class Scanner(NamedTuple):
    """A scanner's beams."""

    angles_rad: Array  # [B] float32, directions
    max_range_m: Array  # float32, a reading of this or more has no end


def map_of(settings: SlamSettings, keys: Keys, scanner: Scanner, points: PointMap) -> PointMap:
    """Return the map that key scans make, one after the other, of one without points."""

    def put(points, key):
        def added(points):
            return add(settings, points, read_scan(settings, key.ranges, *scanner), key.pose)

        return run_if(key.there, added, points), None

    return lax.scan(put, points, keys)[0]


def verify(
    settings: SlamSettings,
    keys: Keys,
    ranges_m: Array,
    guess: Array,
    scanner: Scanner,
    window: Window = WINDOW,
    native: str | None = None,
) -> tuple[Match, Found]:
    """Look for a scan in the map of some key scans.

    Args:
      keys: scans round the place, their poses in the frame of the guess.
      guess: `[3]` float32; the pose is looked for in `window` round it and does not depend on it otherwise.

    Returns:
      `(match, found)`: the pose; the search, whose `other` tells how well another place fits.
    """
    scan = read_scan(settings, ranges_m, *scanner)
    points = map_of(settings, keys, scanner, empty_map(SHAPE, guess[:2] / 2, native))
    free = jnp.diag(jnp.array([FREE_M, FREE_M, FREE_RAD]) ** 2)
    found = search(settings, points, scan, guess, free, window)
    return match(settings, points, scan, found.pose, free), found
