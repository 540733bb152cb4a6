"""Registration of a scan in the point map: iterated closest points, point to line."""

import enum
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from jexplore.arrays.poses import placed, rotated, wrapped
from jexplore.slam2d.points import Near, PointMap, near_slots, nearest
from jexplore.slam2d.scans import Scan
from jexplore.slam2d.settings import SlamSettings

COARSE = 1.0, 0.7  # shares of the gate, of the first rounds; all others have the fine one
ROUNDS = 20  # of these at most


class Outcome(enum.IntEnum):
    """Outcomes of a match, the best first."""

    MATCHED = 0
    DEGENERATE = 1  # a direction or the heading follows the odometry
    UNSETTLED = 2  # the last round still moved it
    FAR = 3  # farther from the odometry than plausible
    FEW = 4  # too few points have partners


class Match(NamedTuple):
    """Estimate of a pose."""

    pose: Array  # [3] float32; the start for `FAR` and `FEW`
    covariance: Array  # [3, 3] float32, m^2, m rad, rad^2, in the map's frame; that of the odometry for these two
    information: Array  # [3, 3] float32, of the scan alone
    fitness: Array  # float32, share of the scan's points that lie on the map, 0 to 1
    outcome: Array  # int32, an `Outcome`


def inverted(a: Array) -> Array:
    """Invert a symmetric positive matrix `[3, 3]`, scaled to ones on its diagonal first."""
    scale = 1 / jnp.sqrt(jnp.diagonal(a))
    a = a * scale * scale[:, None]
    c00 = a[1, 1] * a[2, 2] - a[1, 2] ** 2
    c01 = a[0, 2] * a[1, 2] - a[0, 1] * a[2, 2]
    c02 = a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]
    per = 1 / jnp.maximum(a[0, 0] * c00 + a[0, 1] * c01 + a[0, 2] * c02, 1e-12)
    c11, c12 = a[0, 0] * a[2, 2] - a[0, 2] ** 2, a[0, 1] * a[0, 2] - a[0, 0] * a[1, 2]
    c22 = a[0, 0] * a[1, 1] - a[0, 1] ** 2
    rows = [jnp.stack([c00, c01, c02]), jnp.stack([c01, c11, c12]), jnp.stack([c02, c12, c22])]
    return jnp.stack(rows) * per * scale * scale[:, None]


def equations(
    settings: SlamSettings, points: PointMap, near: Near, scan: Scan, pose: Array, gate_m: Array | float
) -> Any:
    """Return the normal equations of a scan at a pose: `(matrix, vector, partners)`; `[3, 3]`, `[3]`, `[B]` bool.

    A partner on a line pulls across it, another one in both directions.
    """
    xy, normal = placed(pose, scan.xy), rotated(scan.normal, pose[2])
    partner = nearest(points, near, xy)
    n = partner.normal
    both = jnp.any(scan.normal != 0, axis=1) & jnp.any(n != 0, axis=1)
    facing = jnp.sum(n * normal, axis=1) > jnp.cos(jnp.radians(settings.max_facing_deg))
    counts = scan.valid & (partner.d2 < gate_m**2) & (facing | ~both)
    off = jnp.where(counts[:, None], xy - partner.xy, 0)
    n = jnp.where(counts[:, None], n, 0)
    across = jnp.sum(n * off, axis=1)
    is_lined = jnp.any(n != 0, axis=1)
    size = jnp.where(is_lined, jnp.abs(across) / settings.noise_m, jnp.sqrt(jnp.sum(off**2, 1)) / settings.isolated_m)
    weight = counts / jnp.maximum(1, size / settings.huber) / settings.correlation
    line = jnp.where(is_lined, weight / settings.noise_m**2, 0)
    lone = jnp.where(is_lined, 0, weight / settings.isolated_m**2)
    arm = rotated(scan.xy, pose[2])
    aside = jnp.stack([-arm[:, 1], arm[:, 0]], -1)  # d xy / d heading
    rows = jnp.stack([n[:, 0], n[:, 1], jnp.sum(n * aside, axis=1)])
    zero, one = jnp.zeros_like(line), jnp.ones_like(line)
    by_x, by_y = jnp.stack([one, zero, aside[:, 0]]), jnp.stack([zero, one, aside[:, 1]])
    matrix = (rows * line) @ rows.T + (by_x * lone) @ by_x.T + (by_y * lone) @ by_y.T
    vector = (rows * line) @ across + (by_x * lone) @ off[:, 0] + (by_y * lone) @ off[:, 1]
    return matrix, vector, counts


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
      odometry is a measurement as well, so that degenerate directions follow it.
    """
    known = inverted(prior)

    def away(pose):
        off = pose - start
        return off.at[2].set(wrapped(off[2]))

    def look(pose):
        return near_slots(settings, points, placed(pose, scan.xy))

    def nearer(near, pose, gate_m):
        matrix, vector, counts = equations(settings, points, near, scan, pose, gate_m)
        step = inverted(matrix + known) @ (-known @ away(pose) - vector)
        return pose + jnp.where(jnp.sum(counts) >= settings.min_points, step, 0)

    pose = start if guess is None else guess
    near = look(pose)
    for share in COARSE:
        pose = nearer(near, pose, jnp.maximum(share * settings.gate_m, settings.fine_gate_m))
    near = look(pose)  # once more, and not in every round: a CPU gathers longer than it does all else

    def finer(state):
        pose, _, rounds = state
        after = nearer(near, pose, settings.fine_gate_m)
        return after, jnp.max(jnp.abs(after - pose)) >= settings.settled_m, rounds + 1

    first = pose, jnp.bool_(True), jnp.int32(0)
    pose, moves, _ = lax.while_loop(lambda state: state[1] & (state[2] < ROUNDS), finer, first)
    matrix, _, counts = equations(settings, points, near, scan, pose, settings.fine_gate_m)
    n = jnp.sum(counts)
    is_far = away(pose) @ known @ away(pose) > 3 * settings.max_deviations**2
    outcome = jnp.select(
        [n < settings.min_points, is_far, moves, is_degenerate(settings, matrix)],
        [Outcome.FEW, Outcome.FAR, Outcome.UNSETTLED, Outcome.DEGENERATE],
        Outcome.MATCHED,
    )
    kept = outcome < Outcome.FAR
    return Match(
        jnp.where(kept, pose, start),
        jnp.where(kept, inverted(matrix + known), prior),
        jnp.where(kept, matrix, 0),
        n / jnp.maximum(jnp.sum(scan.valid), 1),
        jnp.asarray(outcome, jnp.int32),
    )


def is_degenerate(settings: SlamSettings, matrix: Array) -> Array:
    """Return whether an information matrix `[3, 3]` leaves a direction less certain than `degenerate_m`: bool."""
    place = matrix[:2, :2] - jnp.outer(matrix[:2, 2], matrix[2, :2]) / jnp.maximum(matrix[2, 2], 1e-6)
    mean, root = (place[0, 0] + place[1, 1]) / 2, jnp.hypot((place[0, 0] - place[1, 1]) / 2, place[0, 1])
    return mean - root < 1 / settings.degenerate_m**2
