"""The grid map drawn from the robot's estimated poses, and its correct share."""

import dataclasses
import math

import numpy as np
from scipy.spatial import KDTree

from jexplore.driving.building.walls import segments, walls_of
from jexplore.studies.traces.recording import beam_ends
from jexplore.tracemap.merging.rigid import Move, fit
from jexplore.worlds.readers.scans import ScanLog, ScanMap, fold_scans
from jexplore.worlds.world import World

ON_WALL_M = 0.1  # an occupied cell whose centre lies this near to a true wall is correct
DOUBLED_M = 0.3  # a wall is doubled if it was drawn in places farther apart than this
PIECE_M = 0.25  # length of the pieces of wall of which it is asked
MIN_BEAMS = 4  # beams that a piece of wall must have stopped to count
MIDDLE = 5.0, 95.0  # per cent: the places in which a piece was drawn are those of its beams between these
WIDE_M, NARROW_M = (0.5,) * 4, (0.2,) * 4 + (0.15,) * 4  # rounds: cells farther from a wall than this do not pull
BEGINNINGS = 8  # scans from whose places an alignment begins, besides that of the whole way
SPACING_M = 0.02  # of the points by which walls are found


@dataclasses.dataclass(frozen=True)
class OdometryMap:
    """A grid map drawn by odometry, held against the true building."""

    map: ScanMap
    """In the odometry's frame."""
    on_wall: float
    """Share of its occupied cells that lie within 0.1 m of a true wall, once the whole map has been turned and shifted
    onto the building as well as it can be; NaN without occupied cells."""
    doubled: float
    """Share of the true wall that was seen, in pieces of 0.25 m, whose beams were drawn more than 0.3 m apart across
    it; NaN if none was seen."""
    move: Move
    """That turn and shift."""


def odometry_map(log: ScanLog, world: World, *, cell_m: float = 0.1, p_free: float = 0.25) -> OdometryMap:
    """Draw the grid map of a log by its odometry, as the reflection map, and compare it with the truth.

    The map is laid onto the true walls by iterated closest points, from several beginnings: as its way lies best on the
    true way, and as single scans along the way lie on theirs. The best one counts.

    Args:
      log: `ScanLog` whose `poses` are true and whose `odometry` is where the robot took itself to be, such as
        `TraceResult.scans()`. A beam without an echo counts as free up to the log's `max_range_m`.
      world: the building, `World`, in whose frame the poses are.
      cell_m: edge of a cell of the map, metres.
      p_free: largest reflection probability of a free cell; above it is occupied.

    Returns:
      `OdometryMap`.

    Source:
      Holz et al. 2010, section 2.1, for the map; Besl and McKay 1992, A method for registration of 3-D shapes, for
      the alignment. Changed: in the plane, and far cells do not pull.
    """
    drawn = fold_scans(dataclasses.replace(log, poses=log.odometry), cell_m=cell_m, no_echo_m=log.max_range_m)
    centres = occupied_centres(drawn, p_free)
    points, normals, piece = _wall_points(world)
    tree = KDTree(points)
    whole, *single = _beginnings(log)
    moves = [_closest(centres, points, tree, whole, WIDE_M + NARROW_M)]
    moves += [_closest(centres, points, tree, begin, NARROW_M) for begin in single]
    shares = [_near(_placed(centres, move), tree) for move in moves]
    best = int(np.nanargmax(shares)) if len(centres) else 0
    return OdometryMap(drawn, shares[best], _doubled(log, tree, normals, piece), moves[best])


def occupied_centres(drawn: ScanMap, p_free: float = 0.25) -> np.ndarray:
    """Return centres of the occupied cells of a `ScanMap`, see `grid.is_occupied`: `[n, 2]` float64, metres."""
    hits, misses = (np.asarray(a) for a in (drawn.grid.hits, drawn.grid.misses))  # on the host: every map has a shape
    cells = np.argwhere(hits.astype(np.float32) > np.float32(p_free) * (hits + misses).astype(np.float32))
    return (cells[:, ::-1] + 0.5) * drawn.cell_m + np.asarray(drawn.origin_m)


def _beginnings(log):
    """Return `Move`s that roughly align the odometry's way with the true one: as a whole, and at single scans."""
    turn_deg = math.degrees(log.poses[0, 2] - log.odometry[0, 2])
    found = [fit(log.odometry[:, :2].tolist(), log.poses[:, :2].tolist(), turn_deg)]
    for i in np.unique(np.linspace(0, len(log.poses) - 1, BEGINNINGS).astype(int)):
        (x_m, y_m, heading), (own_x_m, own_y_m, own) = log.poses[i], log.odometry[i]
        turned = Move(turn_deg=math.degrees(heading - own))
        at = turned.place(own_x_m, own_y_m)
        found.append(Move(float(x_m - at[0]), float(y_m - at[1]), turned.turn_deg))
    return found


def _wall_points(world):
    """Return points along the true walls, `[P, 2]`, metres; the wall's normal at each, `[P, 2]`, and its piece."""
    points, normals, pieces, count = [], [], [], 0
    walls = segments(walls_of(world.occupied, world.cell_m)) + np.tile(np.asarray(world.origin_m), 2)
    for line in walls.astype(np.float64):
        start, along = line[:2], line[2:] - line[:2]
        length = float(np.hypot(*along))
        k, n = (max(1, round(length / part_m)) for part_m in (SPACING_M, PIECE_M))
        at = (np.arange(k) + 0.5) / k
        points.append(start + at[:, None] * along)
        normals.append(np.broadcast_to(np.array([-along[1], along[0]]) / length, (len(at), 2)))
        pieces.append(count + np.minimum((at * n).astype(int), n - 1))
        count += n
    return np.concatenate(points), np.concatenate(normals), np.concatenate(pieces)


def _placed(points, move):
    """Transform points `[n, 2]` by a `Move`."""
    cos, sin = math.cos(math.radians(move.turn_deg)), math.sin(math.radians(move.turn_deg))
    return points @ np.array([[cos, sin], [-sin, cos]]) + [move.x_m, move.y_m]


def _closest(points, walls, tree, move, gates_m):
    """Refine a `Move` so that it lays points nearest to walls."""
    for gate_m in gates_m:
        off, at = tree.query(_placed(points, move), distance_upper_bound=gate_m)
        near = np.isfinite(off)
        if near.sum() < 2:
            break
        move = fit(points[near].tolist(), walls[at[near]].tolist(), move.turn_deg)
    return move


def _near(points, tree):
    """Share of points within `ON_WALL_M` of a wall."""
    return float(np.mean(tree.query(points)[0] <= ON_WALL_M)) if len(points) else math.nan


def _doubled(log, tree, normals, piece):
    """See `OdometryMap.doubled`."""
    hit = log.echo
    true, drawn = (beam_ends(log, poses)[hit] for poses in (log.poses, log.odometry))
    off, at = tree.query(true, distance_upper_bound=ON_WALL_M)
    there = np.isfinite(off)
    at, drawn, true = at[there], drawn[there], true[there]
    across = np.sum((drawn - true) * normals[at], axis=1)
    order = np.lexsort([across, piece[at]])
    across, groups = across[order], np.unique(piece[at][order], return_index=True)[1]
    some = [own for own in np.split(across, groups[1:]) if len(own) >= MIN_BEAMS]
    spans = [np.ptp(np.percentile(own, MIDDLE)) for own in some]
    return float(np.mean(np.array(spans) > DOUBLED_M)) if spans else math.nan
