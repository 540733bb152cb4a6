"""Pose graph of key scans, sparse, on the host in float64: least squares that large misfits do not dominate."""

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from jexplore.arrays.poses import between, rotated

ROUNDS = 30  # of Gauss and Newton's method
FALL = 4.0  # of the misfit that is trusted, from round to round
SETTLED = 1e-6  # m, rad; a round that moves no pose by more is the last one


class Edges(NamedTuple):
    """Measured moves between poses."""

    ends: np.ndarray  # [M, 2] int, first and second pose
    moved: np.ndarray  # [M, 3] float64, the second pose in the frame of the first
    information: np.ndarray  # [M, 3, 3] float64, in the frame of the first
    is_loop: np.ndarray  # [M] bool, may be wrong


def settle(poses: np.ndarray, edges: Edges, *, doubt: float) -> tuple[np.ndarray, np.ndarray]:
    """Fit poses to measured moves; pose 0 stays where it is.

    Args:
      poses: `[N, 3]` float64, first guess; every pose is joined with pose 0 by edges.
      doubt: squared misfit, in standard deviations, from which on a loop counts less and less.

    Returns:
      `(poses, misfit2)`: `[N, 3]`, `[M]`, squared misfit of every edge.

    Source:
      Agarwal et al., Robust map optimization using dynamic covariance scaling (2013), for the weights of loops;
      Yang et al., Graduated non-convexity for robust spatial perception (2020), for their fall from round to round.
    """
    n, m = len(poses), len(edges.ends)
    i, j = edges.ends.T
    poses, trust = poses.copy(), np.inf
    for _ in range(ROUNDS):
        off, first, second = _linearised(poses, edges)
        misfit2 = np.einsum("mi,mij,mj->m", off, edges.information, off)
        # Trusted at first, or what has drifted far would never be closed.
        trust = max(min(trust / FALL, misfit2.max(initial=0)), doubt)
        scale = np.where(edges.is_loop, np.minimum(1, 2 * trust / (trust + misfit2)), 1.0)
        weight = edges.information * (scale**2)[:, None, None]
        rows = np.repeat(np.arange(3 * m).reshape(m, 3, 1), 3, axis=2)
        cols = [np.repeat(3 * k[:, None, None] + np.arange(3), 3, axis=1) for k in (i, j)]
        entries = (
            np.concatenate([first.ravel(), second.ravel()]),
            (
                np.concatenate([rows.ravel(), rows.ravel()]),
                np.concatenate([cols[0].ravel(), cols[1].ravel()]),
            ),
        )
        slopes = sparse.csr_matrix(entries, shape=(3 * m, 3 * n))[:, 3:]  # pose 0 is fixed
        weights = sparse.block_diag(list(weight), format="csr")
        pull = -slopes.T @ (weights @ off.ravel())
        step = np.asarray(spsolve((slopes.T @ weights @ slopes).tocsc(), pull)).reshape(n - 1, 3)
        poses[1:] += step
        if np.abs(step).max() < SETTLED and trust == doubt:
            break
    off = _linearised(poses, edges)[0]
    return poses, np.einsum("mi,mij,mj->m", off, edges.information, off)


def _linearised(poses, edges):
    """Return misfits `[M, 3]` and their derivatives by first and second pose, each `[M, 3, 3]`."""
    one, other = poses[edges.ends[:, 0]], poses[edges.ends[:, 1]]
    is_ = between(one, other)
    off = is_ - edges.moved
    off[:, 2] = between(np.zeros_like(off), off)[:, 2]
    cos, sin, zero, unit = np.cos(one[:, 2]), np.sin(one[:, 2]), np.zeros(len(one)), np.ones(len(one))
    second = np.stack([cos, sin, zero, -sin, cos, zero, zero, zero, unit], axis=1).reshape(-1, 3, 3)
    first = -second
    first[:, :2, 2] = np.stack([is_[:, 1], -is_[:, 0]], axis=1)
    return off, first, second


def turned_information(information: np.ndarray, angle: float) -> np.ndarray:
    """Return an information matrix `[3, 3]` of the map's frame in a frame that is turned by an angle."""
    turn = np.eye(3)
    turn[:2, :2] = rotated(np.eye(2), np.float64(-angle)).T
    return turn @ information @ turn.T
