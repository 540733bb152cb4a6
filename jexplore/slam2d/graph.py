"""Pose graph of key scans: a chain of measured steps, and loops that join its poses; batch from outside.

A robot's key scans make a chain, and few loops. What the loops ask of the chain is therefore solved for, and not the
poses: a turn of a step moves all poses after it as a rigid body, so that their moves are sums along the chain.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax
from jax.scipy.sparse.linalg import cg

from jexplore.arrays.poses import between, rotated, wrapped
from jexplore.slam2d.matching import inverted

ROUNDS = 30  # of Gauss and Newton's method
FALL = 4.0  # of the misfit that is trusted, from round to round
SETTLED = 1e-4  # m, rad; a round that moves no pose by more is the last one
SOLVE_ROUNDS, SOLVE_ERROR = 100, 1e-4  # of conjugate gradients; the next round begins where this one ended


class Steps(NamedTuple):
    """Measured steps of a chain; row 0 and those beyond the last pose say nothing."""

    moved: Array  # [K, 3] float32, a pose in the frame of the one before
    covariance: Array  # [K, 3, 3] float32, in that frame


class Loops(NamedTuple):
    """Measured moves between poses far apart on the chain; they may be wrong."""

    ends: Array  # [L, 2] int32, the earlier pose and the later one; below 0: none
    moved: Array  # [L, 3] float32, the later pose in the frame of the earlier one
    covariance: Array  # [L, 3, 3] float32, in that frame


def settle(pose: Array, steps: Steps, loops: Loops, doubt: Array | float) -> tuple[Array, Array]:
    """Fit poses to measured moves; pose 0 stays where it is.

    Args:
      pose: `[K, 3]` float32, first guess.
      doubt: squared misfit, in standard deviations, from which on a loop counts less and less.

    Returns:
      `(pose, misfit2)`: `[K, 3]`, `[L]` float32, squared misfit of every loop, in standard deviations.

    Source:
      Agarwal et al., Robust map optimization using dynamic covariance scaling (2013), for the weights of loops;
      Yang et al., Graduated non-convexity for robust spatial perception (2020), for their fall from round to round.
    """
    there, first, second, own, moved = _rows(loops)
    information = jax.vmap(inverted)(own)

    def misfit(pose):
        off = _off(pose[first], pose[second], moved) * there[:, None]
        return off, jnp.einsum("li,lij,lj->l", off, information, off)

    def better(state):
        pose, pull, trust, _, k = state
        off, misfit2 = misfit(pose)
        # Trusted at first, or what has drifted far would never be closed.
        trust = jnp.maximum(jnp.minimum(trust / FALL, jnp.max(misfit2, initial=0)), doubt)
        twist, spread = _twists(pose, steps)
        solve, across, along = _chain(pose, spread, loops, _doubted(own, misfit2, trust))
        pull = solve(off - across(twist), pull)
        total = jnp.cumsum(-along(pull) - twist, axis=0)
        step = total.at[:, :2].add(_aside(pose[:, :2]) * total[:, 2:])
        return pose + step, pull, trust, jnp.max(jnp.abs(step)), k + 1

    def is_going(state):
        return (state[4] < ROUNDS) & ((state[3] >= SETTLED) | (state[2] > doubt))

    first_state = pose, jnp.zeros_like(moved), jnp.float32(jnp.inf), jnp.float32(jnp.inf), jnp.int32(0)
    pose = lax.while_loop(is_going, better, first_state)[0]
    return pose, misfit(pose)[1]


def surprise(pose: Array, steps: Steps, loops: Loops, which: Array, doubt: Array | float) -> Array:
    """Return how far a loop lies from what the chain and the other loops tell: float32, squared standard deviations.

    If the loop is true this has the chi-square distribution of three degrees of freedom.

    Args:
      pose: `[K, 3]` float32, settled without it.
      which: int32, its row.

    Source:
      Neira and Tardos, Data association in stochastic mapping using the joint compatibility test (2001): of the joint
      test, the part that one more loop adds.
    """
    there, first, second, own, moved = _rows(loops)
    off = _off(pose[first], pose[second], moved) * there[:, None]
    misfit2 = jnp.einsum("li,lij,lj->l", off, jax.vmap(inverted)(own), off)
    measured = jnp.where((jnp.arange(len(own)) == which)[:, None, None], own, _doubted(own, misfit2, doubt))
    solve = _chain(pose, _twists(pose, steps)[1], loops, measured)[0]
    alone = jnp.zeros_like(off).at[which].set(off[which])
    return off[which] @ solve(alone, alone * 0)[which]


def _rows(loops):
    """Return whether there is a loop in each row, its ends, covariance and move."""
    there = loops.ends[:, 0] >= 0
    own = jnp.where(there[:, None, None], loops.covariance, jnp.eye(3))
    return there, *jnp.maximum(loops.ends, 0).T, own, jnp.where(there[:, None], loops.moved, 0)


def _doubted(covariance, misfit2, trust):
    """Return covariances of loops, larger where their misfit exceeds the trust."""
    return covariance / jnp.minimum(1, 2 * trust / (trust + misfit2))[:, None, None] ** 2


def _chain(pose, spread, loops, measured):
    """Return functions `(solve, across, along)`: the pulls of loops that explain misfits, beginning with others; what
    loops see of twists of the chain; what they ask of every step.
    """
    there, first, second, _, _ = _rows(loops)
    seen = _rigid(-pose[first, 2], rotated(_aside(pose[second, :2]), -pose[first, 2])) * there[:, None, None]

    def across(chain):
        total = jnp.cumsum(chain, axis=0)
        return jnp.einsum("lij,lj->li", seen, total[second] - total[first])

    def along(pull):
        each = jnp.einsum("lji,lj->li", seen, pull)
        after = jnp.zeros_like(pose).at[first].add(-each).at[second].add(each)
        return jnp.einsum("kij,kj->ki", spread, jnp.cumsum(after[::-1], axis=0)[::-1])

    def joint(pull):
        return across(along(pull)) + jnp.einsum("lij,lj->li", measured, pull)

    total = jnp.cumsum(spread, axis=0)
    alone = jax.vmap(inverted)(seen @ (total[second] - total[first]) @ seen.mT + measured)

    def solve(off, pull):
        return cg(joint, off, pull, tol=SOLVE_ERROR, maxiter=SOLVE_ROUNDS,
                  M=lambda pull: jnp.einsum("lij,lj->li", alone, pull))[0]  # fmt: skip

    return solve, across, along


def turned_covariance(covariance: Array, angle: Array) -> Array:
    """Return a covariance `[3, 3]` of the map's frame in a frame that is turned by an angle."""
    turn = jnp.eye(3).at[:2, :2].set(rotated(jnp.eye(2), -angle).T)
    return turn @ covariance @ turn.T


def _twists(pose, steps):
    """Return misfits of steps as twists about the origin, `[K, 3]`, and their covariances `[K, 3, 3]`.

    Pose k moves by the sum of the twists up to k, whatever k is.
    """
    before = jnp.concatenate([pose[:1], pose[:-1]])
    to_twist = _rigid(before[:, 2], -_aside(pose[:, :2]))
    is_step = (jnp.arange(len(pose)) > 0)[:, None]
    twist = jnp.einsum("kij,kj->ki", to_twist, is_step * _off(before, pose, steps.moved))
    return twist, is_step[..., None] * (to_twist @ steps.covariance @ to_twist.mT)


def _off(one, other, moved):
    """Return how far poses lie from where a move from others leads, in the frame of these: `[M, 3]`."""
    off = between(one, other) - moved
    return off.at[:, 2].set(wrapped(off[:, 2]))


def _aside(xy):
    """Return vectors `[..., 2]` turned by 90 degrees."""
    return jnp.stack([-xy[..., 1], xy[..., 0]], axis=-1)


def _rigid(heading, aside):
    """Return `[M, 3, 3]`: turns by headings, and a column of what a turn adds."""
    cos, sin, zero, one = jnp.cos(heading), jnp.sin(heading), jnp.zeros_like(heading), jnp.ones_like(heading)
    rows = [cos, -sin, aside[:, 0]], [sin, cos, aside[:, 1]], [zero, zero, one]
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)
