"""Poses and map of a robot from its scans as they come in: key scans, loop closing, the map they make.

`begin` makes a record of the first scan; `put` takes in the next one and returns the record after it: a pure function
of fixed sizes for recorded logs (`Mapper`) and for loops of compiled programs alike. Its parts are for robots that
predict their pose in their own way, those of episodes: `blank`, `enter`, `close`, `remake`.
"""

from collections.abc import Callable
from typing import ClassVar, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import Array, lax

from jexplore.arrays.loops import run_if
from jexplore.arrays.poses import between, compose
from jexplore.slam2d.closing import WINDOW as LOOP_WINDOW
from jexplore.slam2d.closing import Keys, Scanner, map_of, verify
from jexplore.slam2d.graph import Loops, Steps, settle, surprise, turned_covariance
from jexplore.slam2d.matching import Match, Outcome
from jexplore.slam2d.points import PointMap, add, cell_m, empty_map
from jexplore.slam2d.scans import Scan, read_scan
from jexplore.slam2d.search import Window
from jexplore.slam2d.settings import SlamSettings
from jexplore.slam2d.tracking import WIDE, WINDOW, locate, predict

ROUND = 128  # key scans nearest to the robot, of which the map is made anew
ASIDE = 3  # key scans before and after a candidate, in whose map a loop is verified


class Sizes(NamedTuple):
    """Sizes of a record; static."""

    keys: int = 256
    loops: int = 64
    map: tuple[int, int, int] = (2048, 2048, 2**16)  # 72 m square, see `empty_map`
    native: str | None = None  # target of native kernels


@struct.dataclass
class Place:
    """Pose of a scan, and how well it matched."""

    key: Array  # int32, number of its key scan
    moved: Array  # [3] float32, pose in the frame of that key scan
    outcome: Array  # int32, `Outcome` of its match
    fitness: Array  # float32


@struct.dataclass
class Mapping:
    """Record of a robot after some scans: K key scans and L loops at most."""

    points: PointMap
    pose: Array  # [3] float32, of the last scan
    place: Place  # the same, of the last scan
    way: Array  # float32, metres
    n_keys: Array  # int32; those beyond K entered the map, and their record is that of the latest
    pose_of: Array  # [K, 3] float32, poses of key scans
    ranges_of: Array  # [K, B] float32, their ranges, metres
    way_of: Array  # [K] float32, the way up to them, metres
    steps: Steps  # between them
    n_loops: Array  # int32; those beyond L were found, and not closed
    loops: Loops
    tried_at: Array  # float32, way at which a loop was last looked for, metres
    remade_at: Array  # float32, way at which the map was last made anew, metres
    overflow: Array  # int32, the most points that found no room in a map before this one
    replace: ClassVar[Callable[..., Self]]


def blank(sizes: Sizes, n_beams: int, pose: Array, centre: tuple[float, float] | Array = (0.0, 0.0)) -> Mapping:
    """Return the record of a robot at a pose `[3]` before its first scan; `centre`: of the map, see `empty_map`."""
    k, loops = sizes.keys, sizes.loops
    pose, zero, none = jnp.asarray(pose, jnp.float32), jnp.float32(0), jnp.int32(0)
    return Mapping(
        empty_map(sizes.map, centre, sizes.native),
        pose,
        Place(none, jnp.zeros(3), jnp.int32(Outcome.MATCHED), jnp.float32(1)),
        zero,
        none,
        jnp.zeros((k, 3)).at[0].set(pose),
        jnp.zeros((k, n_beams)),
        jnp.zeros(k),
        Steps(jnp.zeros((k, 3)), jnp.zeros((k, 3, 3))),
        none,
        Loops(jnp.full((loops, 2), -1, jnp.int32), jnp.zeros((loops, 3)), jnp.zeros((loops, 3, 3))),
        zero, zero, none,
    )  # fmt: skip


def begin(
    settings: SlamSettings, sizes: Sizes, ranges_m: Array, pose: Array, scanner: Scanner,
    centre: tuple[float, float] | Array = (0.0, 0.0),
) -> Mapping:  # fmt: skip
    """Return the record after a first scan `[B]` from a pose; see `blank`."""
    mapping = blank(sizes, len(ranges_m), pose, centre)
    found = Match(mapping.pose, jnp.zeros((3, 3)), mapping.place.fitness, mapping.place.outcome)
    return enter(settings, mapping, ranges_m, read_scan(settings, ranges_m, *scanner), found)[0]


def put(
    settings: SlamSettings, mapping: Mapping, ranges_m: Array, moved: Array | None, scanner: Scanner, *, closing: bool
) -> Mapping:
    """Take in a scan.

    Without closing the map keeps every key scan where it was first put (Holz et al. 2010, section 2.1). With closing,
    key scans are looked for among earlier ones nearby, a pose graph spreads what that tells, and the map is made anew
    of the key scans nearest to the robot, the latest first. It is made anew as well where the robot leaves its middle.

    The buffers of a record that is used no more are changed in place.

    Args:
      ranges_m: `[B]` float32.
      moved: `[3]` float32, the odometry's step since the last scan, in the frame of its pose; None: no odometry.
      closing: static.

    Returns:
      `Mapping`.
    """
    scan = read_scan(settings, ranges_m, *scanner)
    start, prior = predict(settings, mapping.pose, moved)
    found = locate(settings, mapping.points, scan, start, prior, WIDE if moved is None else WINDOW)
    mapping, is_key = enter(settings, mapping, ranges_m, scan, found)
    is_stale = is_key & _is_leaving(settings, mapping)
    if closing:
        mapping, is_due = close(settings, mapping, scanner, is_key)
        is_stale |= is_due & (mapping.way - mapping.remade_at >= settings.remake_m)
    return run_if(is_stale, lambda mapping: remake(settings, mapping, scanner, mapping.pose[:2]), mapping)


def enter(settings: SlamSettings, mapping: Mapping, ranges_m: Array, scan: Scan, found: Match) -> tuple[Mapping, Array]:
    """Take in a scan whose pose has been found: `(mapping, is_key)`; the first one is a key scan.

    A record without room for another key scan keeps it in the place of the last one.
    """
    n, k = mapping.n_keys, len(mapping.pose_of)
    last, at = jnp.clip(n, 1, k) - 1, jnp.minimum(n, k - 1)
    way = mapping.way + jnp.hypot(*(found.pose - mapping.pose)[:2])
    since = between(mapping.pose_of[last], found.pose)
    is_far = (jnp.hypot(since[0], since[1]) >= settings.key_m) | (jnp.abs(since[2]) >= jnp.radians(settings.key_deg))
    is_key = is_far | ((found.fitness < settings.min_share) & (found.outcome < Outcome.FAR)) | (n == 0)
    place = Place(jnp.where(is_key, at, last), jnp.where(is_key, 0, since), found.outcome, found.fitness)
    before = mapping.pose_of[jnp.maximum(at - 1, 0)]
    covariance = turned_covariance(found.covariance, before[2])

    def put_key(mapping):
        steps, own = mapping.steps, covariance + _own_covariance(settings)
        return mapping.replace(
            points=add(settings, mapping.points, scan, mapping.pose),
            n_keys=n + 1,
            pose_of=mapping.pose_of.at[at].set(mapping.pose),
            ranges_of=mapping.ranges_of.at[at].set(ranges_m),
            way_of=mapping.way_of.at[at].set(mapping.way),
            steps=Steps(steps.moved.at[at].set(between(before, mapping.pose)), steps.covariance.at[at].set(own)),
        )

    return run_if(is_key, put_key, mapping.replace(pose=found.pose, place=place, way=way)), is_key


def close(
    settings: SlamSettings, mapping: Mapping, scanner: Scanner, is_key: Array, window: Window = LOOP_WINDOW
) -> tuple[Mapping, Array]:
    """Look for a loop if the last scan is a key scan and the robot has come some way: `(mapping, whether it did)`."""
    is_due = is_key & (mapping.way - mapping.tried_at >= settings.close_every_m)
    is_due &= mapping.n_keys <= len(mapping.pose_of)

    def look(mapping):
        return _close(settings, mapping.replace(tried_at=mapping.way), scanner, window)

    return run_if(is_due, look, mapping), is_due


def _own_covariance(settings):
    """Return what a measured move errs besides its own covariance: `[3, 3]`."""
    return jnp.diag(jnp.stack([settings.key_sd_m, settings.key_sd_m, jnp.radians(settings.key_sd_deg)]) ** 2)


def _is_leaving(settings, mapping):
    """Return whether the robot is nearer to the edge of the map than to its middle."""
    half_m = jnp.array(mapping.points.near.shape[::-1]) * cell_m(settings) / 2
    return jnp.any(jnp.abs(mapping.pose[:2] - mapping.points.centre) > half_m / 2)


def _close(settings, mapping, scanner, window):
    """Look for the last key scan round the nearest old one; where that moves poses, the map is to be made anew.

    A scan alone is sure of places that look alike: the way between must allow the loop as well.
    """
    last, pose_of, numbers = mapping.n_keys - 1, mapping.pose_of, jnp.arange(len(mapping.pose_of))
    away = between(pose_of, jnp.broadcast_to(pose_of[last], pose_of.shape))
    far = jnp.hypot(jnp.hypot(away[:, 0], away[:, 1]), settings.close_turn_m * away[:, 2])
    is_old = (numbers < last) & (mapping.way - mapping.way_of > settings.close_m)
    far = jnp.where(is_old, far, jnp.inf)
    j = jnp.argmin(far)

    def look(mapping):
        around = j + jnp.arange(-ASIDE, ASIDE + 1)
        keys = _some(mapping, around, (around >= 0) & (around < last), pose_of[j])
        found, searched = verify(
            settings, keys, mapping.ranges_of[last], away[j], scanner, window, mapping.points.native
        )
        is_sure = (found.outcome == Outcome.MATCHED) | (found.outcome == Outcome.UNSETTLED)
        is_sure &= (found.fitness >= settings.close_share) & (searched.other >= searched.cost + settings.close_margin)

        def weigh(mapping):
            n, loops = mapping.n_loops, mapping.loops
            own = Loops(jnp.stack([j, last]), found.pose, found.covariance + _own_covariance(settings))
            more = jax.tree.map(lambda a, one: jnp.concatenate([a, one[None]]), loops, own)
            off2 = surprise(pose_of, mapping.steps, more, jnp.int32(len(loops.ends)), settings.close_doubt)
            is_true = off2 <= settings.close_doubt

            def join(mapping):
                joined = jax.tree.map(lambda a, one: a.at[n].set(one), loops, own)
                settled, _ = settle(pose_of, mapping.steps, joined, settings.close_doubt)
                moved_m = jnp.max(jnp.where(numbers <= last, jnp.hypot(*(settled - pose_of)[:, :2].T), 0))
                is_moved = moved_m > settings.min_distance_m
                return mapping.replace(
                    loops=joined, pose_of=settled, pose=settled[last],
                    remade_at=jnp.where(is_moved, -jnp.inf, mapping.remade_at),
                )  # fmt: skip

            return run_if(is_true & (n < len(loops.ends)), join, mapping).replace(n_loops=n + is_true)

        return run_if(is_sure, weigh, mapping)

    return run_if(far[j] <= settings.close_m, look, mapping)


def remake(settings: SlamSettings, mapping: Mapping, scanner: Scanner, centre: Array, most: int = ROUND) -> Mapping:
    """Make the map anew of the key scans nearest to the robot, the latest first, at `most` some; static."""
    pose_of, points = mapping.pose_of, mapping.points
    numbers = jnp.arange(len(pose_of))
    off = jnp.hypot(*(pose_of - mapping.pose)[:, :2].T)
    near = lax.top_k(jnp.where(numbers < mapping.n_keys, -off, -jnp.inf), min(most, len(pose_of)))[1]
    near = jnp.sort(jnp.where(near < mapping.n_keys, near, -1))[::-1]
    keys = _some(mapping, near, near >= 0, jnp.zeros(3))
    rows, cols = points.near.shape
    blank = empty_map((rows, cols, len(points.x)), centre, points.native)
    return mapping.replace(
        points=map_of(settings, keys, scanner, blank),
        remade_at=mapping.way,
        overflow=jnp.maximum(mapping.overflow, points.overflow),
    )


def _some(mapping, which, there, frame):
    """Return some key scans in a frame."""
    pose = between(jnp.broadcast_to(frame, (len(which), 3)), mapping.pose_of[which])
    return Keys(mapping.ranges_of[which], pose, there)


class Mapper:
    """Estimate of a robot's way while its scans come in, from the pose 0, 0, 0 on; on the host."""

    def __init__(self, settings: SlamSettings, angles_rad: np.ndarray, max_range_m: float, *, closing: bool) -> None:
        """Begin without a scan.

        Args:
          angles_rad: `[B]`, directions of the beams.
          max_range_m: a reading of this or more has no end, metres.
        """
        self.settings, self.closing = settings, closing
        self._leaves = jax.device_put(jax.tree.map(np.float32, settings))
        self._scanner = jax.device_put(Scanner(jnp.float32(angles_rad), jnp.float32(max_range_m)))
        self.mapping: Mapping | None = None
        self.places: list[Place] = []

    def put(self, ranges_m: np.ndarray, moved: np.ndarray | None) -> None:
        """Take in a scan `[B]` and the odometry's step since the last one `[3]`; None: no odometry."""
        ranges, mapping = np.asarray(ranges_m, np.float32), self.mapping
        if mapping is None:
            mapping = _begun(self._leaves, LOG, ranges, np.zeros(3, np.float32), self._scanner)
        else:
            if mapping.n_keys == len(mapping.pose_of) or mapping.n_loops == len(mapping.loops.ends):
                mapping = grown(mapping)
            step = None if moved is None else np.asarray(moved, np.float32)
            mapping = _put(self._leaves, mapping, ranges, step, self._scanner, closing=self.closing)
        self.mapping = mapping
        self.places.append(jax.device_get(mapping.place))

    def poses(self) -> np.ndarray:
        """Return the poses of all scans as they are known now: `[N, 3]` float64."""
        if self.mapping is None:
            return np.zeros((0, 3))
        keys = np.asarray(self.mapping.pose_of, float)
        return compose(keys[[p.key for p in self.places]], np.array([p.moved for p in self.places], float))

    @property
    def loops(self) -> list[tuple[int, int]]:
        """Return the loops closed: pairs of key scans, the later one first."""
        ends = np.zeros((0, 2), int) if self.mapping is None else np.asarray(self.mapping.loops.ends)
        return [(int(second), int(first)) for first, second in ends if first >= 0]

    @property
    def overflow(self) -> int:
        """Return the most points that found no room in a map, this one or one before it."""
        return 0 if self.mapping is None else int(max(self.mapping.overflow, self.mapping.points.overflow))


LOG = Sizes(1024, 256)  # of a log at first
_begun = jax.jit(begin, static_argnums=1)
_put = jax.jit(put, static_argnames="closing", donate_argnums=1)


def grown(mapping: Mapping) -> Mapping:
    """Return the record with room for twice as many key scans and loops."""
    k, loops = len(mapping.pose_of), len(mapping.loops.ends)

    def wider(a, n, fill=0):
        return jnp.concatenate([a, jnp.full((n, *a.shape[1:]), fill, a.dtype)])

    of_keys = {name: wider(getattr(mapping, name), k) for name in ("pose_of", "ranges_of", "way_of")}
    steps = jax.tree.map(lambda a: wider(a, k), mapping.steps)
    more = jax.tree.map(lambda a: wider(a, loops), mapping.loops)
    more = more._replace(ends=wider(mapping.loops.ends, loops, -1))
    return mapping.replace(**of_keys, steps=steps, loops=more)
