"""Poses in the plane that fit what was measured between them as well as possible; one graph, batch from outside."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax

GAUSS_NEWTON_ROUNDS = 20  # of Gauss and Newton's method
MAX_HALVINGS = 5  # of a step that makes the misfit larger
REGULARISATION = 1e-4  # added to the diagonal: what nothing is known of stays where it is


class Settled(NamedTuple):
    """Best fit of a pose graph."""

    pose: Array  # [N, 3] float32, x, y, heading, radians
    misfit: Array  # [M, 3] float32, of every measurement, in its standard deviations; 0 in a place without one


def settle(pose: Array, ends: Array, moved: Array, spread: Array) -> Settled:
    """Fit poses to measured moves between them: least squares by Gauss-Newton from a first guess.

    Pose 0 and poses not joined with it by measurements stay in place. A step is halved until the misfit shrinks,
    `MAX_HALVINGS` times at most; otherwise the poses stay.

    Args:
      pose: `[N, 3]` float32, first guess: x, y, heading, radians.
      ends: `[M, 2]` int32, first and second pose of a measured move; below 0: empty.
      moved: `[M, 3]` float32, x, y, in the frame of the first; turn of the second against it, radians.
      spread: `[M, 2]` float32, standard deviations of a place and of a turn, above 0; inf: says nothing.

    Returns:
      `Settled`.
    """
    n, m = pose.shape[0], ends.shape[0]
    there = (ends >= 0).all(axis=1)
    first, second = jnp.clip(ends, 0, n - 1).T
    weight = jnp.where(there[:, None], 1 / spread, 0)[:, jnp.array([0, 0, 1])]  # [M, 3]
    moved = jnp.where((weight > 0), moved, 0)
    edge, place = jnp.arange(m), jnp.arange(2)

    def misfit(pose):
        turned = _turned(moved[:, :2], pose[first, 2])
        off = pose[first].at[:, :2].add(turned).at[:, 2].add(moved[:, 2]) - pose[second]
        return weight * off.at[:, 2].set((off[:, 2] + jnp.pi) % (2 * jnp.pi) - jnp.pi)

    def slopes(pose):
        """Return the derivatives `[M, 3, N, 3]` of every misfit by every pose but the first."""
        d = jnp.zeros((m, 3, n, 3)).at[edge[:, None], jnp.arange(3), first[:, None], jnp.arange(3)].add(1.0)
        d = d.at[edge[:, None], jnp.arange(3), second[:, None], jnp.arange(3)].add(-1.0)
        aside = _turned(moved[:, :2], pose[first, 2] + jnp.pi / 2)
        d = d.at[edge[:, None], place, first[:, None], 2].add(aside)
        return (weight[:, :, None, None] * d).at[:, :, 0].set(0.0)

    def better(_, pose):
        r, d = misfit(pose).reshape(-1), slopes(pose).reshape(3 * m, 3 * n)
        step = jnp.linalg.solve(d.T @ d + REGULARISATION * jnp.eye(3 * n), -d.T @ r).reshape(n, 3)
        tried = jnp.stack([pose + step / 2**k for k in range(MAX_HALVINGS)])
        cost = jnp.stack([jnp.sum(misfit(one) ** 2) for one in [pose, *tried]])
        return jnp.concatenate([pose[None], tried])[jnp.argmin(cost)]

    pose = lax.fori_loop(0, GAUSS_NEWTON_ROUNDS, better, jnp.asarray(pose, jnp.float32))
    return Settled(pose, misfit(pose))


def _turned(xy, angle):
    """Return `[M, 2]` vectors turned by `[M]` angles."""
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([cos * xy[:, 0] - sin * xy[:, 1], sin * xy[:, 0] + cos * xy[:, 1]], axis=1)
