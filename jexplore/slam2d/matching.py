"""Registration of a scan in the point map: iterated closest points, point to line."""

import enum
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from jexplore.arrays.loops import one_kernel
from jexplore.arrays.poses import wrapped
from jexplore.slam2d.points import PointMap, cells_of, partners
from jexplore.slam2d.scans import Scan
from jexplore.slam2d.settings import SlamSettings

COARSE = 1.0, 0.7  # shares of the gate, of the first rounds; all others have the fine one
ROUNDS = 20  # of these at most
UPPER = [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]  # rows and columns of an upper triangle


class Outcome(enum.IntEnum):
    """Outcomes of a match, the best first."""

    MATCHED = 0
    DEGENERATE = 1  # a direction or the heading follows the odometry
    UNSETTLED = 2  # the last round still moved it
    AMBIGUOUS = 3  # another place fits nearly as well, and there is no odometry to tell
    FAR = 4  # farther from the odometry than plausible
    FEW = 5  # too few points have partners


class Match(NamedTuple):
    """Estimate of a pose."""

    pose: Array  # [3] float32; the start for `FAR` and `FEW`
    covariance: Array  # [3, 3] float32, m^2, m rad, rad^2, in the map's frame; that of the odometry for these two
    fitness: Array  # float32, share of the scan's points that lie on the map, 0 to 1
    outcome: Array  # int32, an `Outcome`


class Rounds(NamedTuple):
    """Result of the rounds of a match."""

    pose: Array  # [3] float32
    matrix: Array  # [6] float32, upper triangle of the information of the scan, row by row, in the last round
    partners: Array  # float32, points with a partner in the last round
    moves: Array  # bool, the last round still moved the pose


def symmetric(six: Array) -> Array:
    """Return the matrix `[3, 3]` of an upper triangle `[6]`, row by row."""
    return six[jnp.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])]


def inverted(a: Array) -> Array:
    """Invert a symmetric positive matrix `[3, 3]`, scaled to ones on its diagonal first."""
    return symmetric(jnp.stack(_inverse(a[0, 0], a[0, 1], a[0, 2], a[1, 1], a[1, 2], a[2, 2])))


def _inverse(a00, a01, a02, a11, a12, a22):
    """Return the upper triangle of the inverse of an upper triangle; scalars."""
    s0, s1, s2 = (1 / jnp.sqrt(a) for a in (a00, a11, a22))
    b01, b02, b12 = a01 * s0 * s1, a02 * s0 * s2, a12 * s1 * s2
    c00, c01, c02 = 1 - b12 * b12, b02 * b12 - b01, b01 * b12 - b02
    per = 1 / jnp.maximum(c00 + b01 * c01 + b02 * c02, 1e-12)
    c11, c12, c22 = 1 - b02 * b02, b01 * b02 - b12, 1 - b01 * b01
    return (
        c00 * per * s0 * s0, c01 * per * s0 * s1, c02 * per * s0 * s2,
        c11 * per * s1 * s1, c12 * per * s1 * s2, c22 * per * s2 * s2,
    )  # fmt: skip


def sums(settings: SlamSettings, points: PointMap, scan: Scan, pose: Array, gate_m: Array | float) -> tuple[Array, ...]:
    """Return the normal equations of a scan at a pose: upper triangle of the matrix, vector, number of partners.

    A partner on a line pulls across it, another one in both directions.
    """
    cos, sin, (x, y) = jnp.cos(pose[2]), jnp.sin(pose[2]), jnp.unstack(scan.xy, axis=1)
    own_x, own_y = jnp.unstack(scan.normal, axis=1)
    arm_x, arm_y = cos * x - sin * y, sin * x + cos * y
    at_x, at_y = arm_x + pose[0], arm_y + pose[1]
    partner = partners(points, *cells_of(settings, points, at_x, at_y), at_x, at_y)
    nx, ny = partner.normal_x, partner.normal_y
    is_lined, is_own_lined = (nx != 0) | (ny != 0), (own_x != 0) | (own_y != 0)
    facing = nx * (cos * own_x - sin * own_y) + ny * (sin * own_x + cos * own_y)
    faces = facing > jnp.cos(jnp.radians(settings.max_facing_deg))
    counts = scan.valid & (partner.d2 < gate_m**2) & (faces | ~(is_lined & is_own_lined))
    off_x, off_y = at_x - partner.x, at_y - partner.y
    across = nx * off_x + ny * off_y
    size = jnp.where(
        is_lined, jnp.abs(across) / settings.noise_m, jnp.sqrt(off_x * off_x + off_y * off_y) / settings.isolated_m
    )
    weight = jnp.where(counts, 1 / (jnp.maximum(1, size / settings.huber) * settings.correlation), 0)
    line = jnp.where(is_lined, weight / settings.noise_m**2, 0)
    lone = jnp.where(is_lined, 0, weight / settings.isolated_m**2)
    turn, pull = ny * arm_x - nx * arm_y, line * across  # d across / d heading
    terms = (
        line * nx * nx + lone, line * nx * ny, line * nx * turn - lone * arm_y,
        line * ny * ny + lone, line * ny * turn + lone * arm_x,
        line * turn * turn + lone * (arm_x * arm_x + arm_y * arm_y),
        pull * nx + lone * off_x, pull * ny + lone * off_y, pull * turn + lone * (arm_x * off_y - arm_y * off_x),
        counts.astype(jnp.float32),
    )  # fmt: skip
    return tuple(jnp.sum(term) for term in terms)


def rounds(settings: SlamSettings, points: PointMap, scan: Scan, start: Array, known: Array, guess: Array) -> Rounds:
    """Move a pose until a round moves it no more; see `match`. Without enough partners it stays.

    Args:
      known: `[6]` float32, information of the start, an upper triangle row by row.
    """
    k00, k01, k02, k11, k12, k22 = known

    def once(state):
        _, pose, _, _, k = state
        share = jnp.where(k == 0, COARSE[0], jnp.where(k == 1, COARSE[1], 0.0))
        gate_m = jnp.maximum(share * settings.gate_m, settings.fine_gate_m)
        m00, m01, m02, m11, m12, m22, v0, v1, v2, n = sums(settings, points, scan, pose, gate_m)
        dx, dy, turn = pose[0] - start[0], pose[1] - start[1], wrapped(pose[2] - start[2])
        w0 = v0 + k00 * dx + k01 * dy + k02 * turn
        w1 = v1 + k01 * dx + k11 * dy + k12 * turn
        w2 = v2 + k02 * dx + k12 * dy + k22 * turn
        i00, i01, i02, i11, i12, i22 = _inverse(m00 + k00, m01 + k01, m02 + k02, m11 + k11, m12 + k12, m22 + k22)
        step = i00 * w0 + i01 * w1 + i02 * w2, i01 * w0 + i11 * w1 + i12 * w2, i02 * w0 + i12 * w1 + i22 * w2
        step = jnp.where(n >= settings.min_points, -jnp.stack(step), 0)
        moves = (jnp.max(jnp.abs(step)) >= settings.settled_m) | (k < len(COARSE))
        return moves, pose + step, jnp.stack([m00, m01, m02, m11, m12, m22]), n, k + 1

    def is_going(state):
        return state[0] & (state[4] < ROUNDS + len(COARSE))

    first = jnp.bool_(True), guess, jnp.zeros(6), jnp.float32(0), jnp.int32(0)
    moves, pose, matrix, n, _ = lax.while_loop(is_going, once, first)
    return Rounds(pose, matrix, n, moves)


def match(
    settings: SlamSettings, points: PointMap, scan: Scan, start: Array, prior: Array, guess: Array | None = None
) -> Match:
    """Estimate the pose from which a scan was taken, by its points and the odometry.

    Args:
      start: `[3]` float32, pose by the odometry.
      prior: `[3, 3]` float32, its covariance, positive. Where the scan tells nothing the pose stays there.
      guess: `[3]` float32, where the rounds begin; by default at `start`.

    Returns:
      `Match`.

    Source:
      Censi, An ICP variant using a point-to-line metric (2008). Changed: normals are those of the map's points; the
      odometry is a measurement as well, so that degenerate directions follow it; a point's partner is the one nearest
      to the middle of its cell.
    """
    known6 = jnp.stack(_inverse(*prior[UPPER]))
    guess = start if guess is None else guess
    found = one_kernel(rounds, settings, points, scan, start, known6, guess)
    known, matrix, n = symmetric(known6), symmetric(found.matrix), found.partners
    off = found.pose - start
    off = off.at[2].set(wrapped(off[2]))
    is_far = off @ known @ off > 3 * settings.max_deviations**2
    outcome = jnp.select(
        [n < settings.min_points, is_far, found.moves, is_degenerate(settings, matrix)],
        [Outcome.FEW, Outcome.FAR, Outcome.UNSETTLED, Outcome.DEGENERATE],
        Outcome.MATCHED,
    )
    kept = outcome < Outcome.FAR
    return Match(
        jnp.where(kept, found.pose, start),
        jnp.where(kept, inverted(matrix + known), prior),
        n / jnp.maximum(jnp.sum(scan.valid), 1),
        jnp.asarray(outcome, jnp.int32),
    )


def is_degenerate(settings: SlamSettings, matrix: Array) -> Array:
    """Return whether an information matrix `[3, 3]` leaves a direction less certain than `degenerate_m`: bool."""
    place = matrix[:2, :2] - jnp.outer(matrix[:2, 2], matrix[2, :2]) / jnp.maximum(matrix[2, 2], 1e-6)
    mean, root = (place[0, 0] + place[1, 1]) / 2, jnp.hypot((place[0, 0] - place[1, 1]) / 2, place[0, 1])
    return mean - root < 1 / settings.degenerate_m**2
