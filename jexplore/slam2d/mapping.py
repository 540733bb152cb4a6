"""Maps from the scans of one robot as they come in: key scans, loop closing, the map they make. On the host."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jexplore.arrays.poses import between, compose
from jexplore.slam2d.closing import Keys, map_of, verify
from jexplore.slam2d.graph import Edges, settle, turned_information
from jexplore.slam2d.matching import Match, Outcome
from jexplore.slam2d.points import add, empty_map
from jexplore.slam2d.scans import read_scan
from jexplore.slam2d.settings import SlamSettings
from jexplore.slam2d.tracking import WIDE, WINDOW, locate, predict

SHAPE = (256, 256, 16)  # of the map: 51 m until it repeats itself at cells of 0.2 m
ROUND = 128  # key scans nearest to the robot, of which the map is made anew
ASIDE = 3  # key scans before and after a candidate, in whose map a loop is verified


def _track(settings, points, ranges, angles_rad, max_range_m, pose, moved, window):
    scan = read_scan(settings, ranges, angles_rad, max_range_m)
    start, prior = predict(settings, pose, moved)
    return locate(settings, points, scan, start, prior, window)


def _add(settings, points, ranges, angles_rad, max_range_m, pose):
    return add(settings, points, read_scan(settings, ranges, angles_rad, max_range_m), pose)


_tracked, _verified, _remade = jax.jit(_track, static_argnums=7), jax.jit(verify), jax.jit(map_of, static_argnums=4)
_added = jax.jit(_add, donate_argnums=1)


class Place(NamedTuple):
    """Pose of a scan, and how well it matched."""

    key: int  # number of its key scan
    moved: np.ndarray  # [3] float64, pose in the frame of that key scan
    outcome: int  # `Outcome` of its match
    fitness: float


class Edge(NamedTuple):
    """Measured move between two key scans; see `Edges`."""

    first: int
    second: int
    moved: np.ndarray
    information: np.ndarray
    is_loop: bool


class Mapper:
    """Estimate of a robot's way while scans come in, from the pose 0, 0, 0 on.

    Without closing the map keeps every key scan where it was first put (Holz et al. 2010, section 2.1). With closing,
    key scans are looked for among earlier ones nearby, a pose graph spreads what that tells, and the map is made anew
    of the key scans nearest to the robot, the latest first.
    """

    def __init__(self, settings: SlamSettings, angles_rad: np.ndarray, max_range_m: float, *, closing: bool) -> None:
        """Begin without a scan.

        Args:
          angles_rad: `[B]`, directions of the beams.
          max_range_m: a reading of this or more has no end, metres.
        """
        self.settings, self.closing = settings, closing
        self._leaves = jax.tree.map(np.float32, settings)
        self._scanner = np.asarray(angles_rad, np.float32), np.float32(max_range_m)
        self.points = empty_map(SHAPE)
        self.overflow = 0  # points that found no room in this map and those before it
        self.places: list[Place] = []
        self.edges: list[Edge] = []
        self.keys = np.zeros((0, 3))  # poses of the key scans
        self._ways = np.zeros(0)  # of the key scans, metres
        self._ranges: list[np.ndarray] = []  # of the key scans
        self.pose, self._way = np.zeros(3), 0.0
        self._tried_at = self._remade_at = 0.0  # ways

    def put(self, ranges_m: np.ndarray, moved: np.ndarray) -> None:
        """Take in a scan `[B]` and the odometry's step since the last one `[3]`, all 0 for none."""
        ranges = np.asarray(ranges_m, np.float32)
        if not self.places:
            self._put_key(ranges)
            self.places.append(Place(0, np.zeros(3), int(Outcome.MATCHED), 1.0))
            return
        window = WINDOW if np.any(moved) else WIDE
        before = self.pose
        found: Match = jax.tree.map(
            np.asarray,
            _tracked(self._leaves, self.points, ranges, *self._scanner, np.float32(before), np.float32(moved), window),
        )
        self.pose = found.pose.astype(float)
        self._way += float(np.hypot(*(self.pose - before)[:2]))
        own, k, since = self.settings, len(self.keys), between(self.keys[-1], self.pose)
        is_far = np.hypot(*since[:2]) >= own.key_m or abs(since[2]) >= np.radians(own.key_deg)
        if is_far or (found.fitness < own.min_share and found.outcome < Outcome.FAR):
            information = self._information(found.covariance)
            self.edges.append(Edge(k - 1, k, since, turned_information(information, self.keys[-1, 2]), False))
            self._put_key(ranges)
            self.places.append(Place(k, np.zeros(3), int(found.outcome), float(found.fitness)))
        else:
            self.places.append(Place(k - 1, since, int(found.outcome), float(found.fitness)))

    def poses(self) -> np.ndarray:
        """Return the poses of all scans as they are known now: `[N, 3]` float64."""
        return compose(self.keys[[place.key for place in self.places]], np.array([p.moved for p in self.places]))

    @property
    def loops(self) -> list[tuple[int, int]]:
        """Return the loops closed: pairs of key scans, the later one first."""
        return [(edge.second, edge.first) for edge in self.edges if edge.is_loop]

    def _information(self, covariance):
        """Return the information of a measured step, which errs besides its own covariance."""
        own = self.settings
        sd = np.array([own.key_sd_m, own.key_sd_m, np.radians(own.key_sd_deg)])
        return np.linalg.inv(covariance.astype(float) + np.diag(sd**2))

    def _put_key(self, ranges):
        """Add the scan at the present pose to the map, and look for it among earlier ones."""
        self.keys = np.concatenate([self.keys, self.pose[None]])
        self._ways = np.append(self._ways, self._way)
        self._ranges.append(ranges)
        self.points = _added(self._leaves, self.points, ranges, *self._scanner, np.float32(self.pose))
        if not self.closing or self._way - self._tried_at < self.settings.close_every_m:
            return
        self._tried_at = self._way
        if self._close() or self._way - self._remade_at >= self.settings.remake_m:
            self._remade_at = self._way
            self.overflow += int(self.points.overflow)
            off = np.hypot(*(self.keys - self.pose)[:, :2].T)
            near = np.sort(np.argsort(off, kind="stable")[:ROUND])[::-1]
            self.points = _remade(self._leaves, self._some(near, ROUND, np.zeros(3)), *self._scanner, SHAPE)

    def _close(self):
        """Look for the last key scan round the nearest old one; return whether that has moved poses."""
        own, k = self.settings, len(self.keys) - 1
        away = between(self.keys, np.broadcast_to(self.keys[k], self.keys.shape))
        far = np.hypot(np.hypot(away[:, 0], away[:, 1]), own.close_turn_m * away[:, 2])
        far[self._way - self._ways <= own.close_m] = np.inf
        j = int(np.argmin(far))
        if far[j] > own.close_m:
            return False
        around = np.arange(max(j - ASIDE, 0), min(j + ASIDE + 1, k))
        keys = self._some(around, 2 * ASIDE + 1, self.keys[j])
        found, searched = jax.tree.map(
            np.asarray, _verified(self._leaves, keys, self._ranges[k], np.float32(away[j]), *self._scanner)
        )
        is_sure = found.outcome in (Outcome.MATCHED, Outcome.UNSETTLED) and found.fitness >= own.close_share
        if not is_sure or searched.other < searched.cost + own.close_margin:
            return False
        self.edges.append(Edge(j, k, found.pose.astype(float), self._information(found.covariance), True))
        before = self.keys
        first, second, *measured = zip(*self.edges)
        edges = Edges(np.stack([first, second], axis=1), *map(np.array, measured))
        self.keys, _ = settle(before, edges, doubt=own.close_doubt)
        self.pose = self.keys[k]
        return np.abs(self.keys - before)[:, :2].max() > own.min_distance_m

    def _some(self, which, size, frame):
        """Return some key scans in a frame, padded to a size."""
        n = len(which)
        ranges, pose = np.zeros((size, len(self._ranges[0])), np.float32), np.zeros((size, 3), np.float32)
        ranges[:n] = [self._ranges[i] for i in which]
        pose[:n] = between(np.broadcast_to(frame, (n, 3)), self.keys[which])
        return Keys(jnp.asarray(ranges), jnp.asarray(pose), jnp.arange(size) < n)
