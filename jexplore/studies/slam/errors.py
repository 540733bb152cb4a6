"""Errors of a trajectory: against relations between poses, and against a whole other trajectory."""

import os
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import KDTree

from jexplore.arrays.files import read_text
from jexplore.arrays.poses import between, compose
from jexplore.config import InputError

LOCAL_M, WAY_M = 1.0, 5.0  # m; a local relation joins poses so near to each other, after no more way
PAIRS = 10_000  # random pairs of poses, of the global relations
MOST_BYTES = 64 * 2**20  # of a file of relations
SAME_S = 0.1  # s; a relation is of the scan nearest in time, no farther off


class Relations(NamedTuple):
    """Known moves between pairs of poses."""

    ends: np.ndarray  # [M, 2] int, the two scans
    moved: np.ndarray  # [M, 3] float64, the second pose in the frame of the first


def relations_between(poses: np.ndarray, seed: int = 0) -> dict[str, Relations]:
    """Return relations of a trajectory that counts as true: `local`, `revisit` and `global` ones.

    Local ones are all pairs within 1 m and 5 m of way, revisits those within 1 m after more way, global ones 10,000
    pairs drawn from all.
    """
    way = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    near = np.sort(KDTree(poses[:, :2]).query_pairs(LOCAL_M, output_type="ndarray").reshape(-1, 2), axis=1)
    is_local = way[near[:, 1]] - way[near[:, 0]] <= WAY_M
    drawn = np.sort(np.random.default_rng(seed).integers(0, len(poses), (PAIRS, 2)), axis=1)
    pairs = {"local": near[is_local], "revisit": near[~is_local], "global": drawn[drawn[:, 0] < drawn[:, 1]]}
    return {name: Relations(k, between(poses[k[:, 0]], poses[k[:, 1]])) for name, k in pairs.items() if len(k)}


def read_relations(path: str | os.PathLike[str], times: np.ndarray, offset_s: float = 0.0) -> Relations:
    """Read a file of relations, each line `t1 t2 x y z roll pitch yaw`.

    Args:
      times: `[N]` float64, of the scans, seconds.
      offset_s: what the file's times have more than these.

    Source:
      Kümmerle et al., On measuring the accuracy of SLAM algorithms (2009).
    """
    path, rows = os.fspath(path), []
    for number, line in enumerate(read_text(path, MOST_BYTES).splitlines(), start=1):
        words = line.split("#")[0].split()
        if not words:
            continue
        try:
            row = [float(word) for word in words[:8]]
        except ValueError:
            row = []
        if len(row) < 8 or not np.isfinite(row).all():
            raise InputError(f"{path!r}: line {number} must be t1 t2 x y z roll pitch yaw, eight numbers")
        rows.append(row)
    order = np.argsort(times, kind="stable")
    asked = np.array(rows).reshape(-1, 8)[:, :2] - offset_s
    at = np.searchsorted(times[order], asked)
    before, after = np.maximum(at - 1, 0), np.minimum(at, len(times) - 1)
    near = np.abs(times[order][before] - asked) <= np.abs(times[order][after] - asked)
    ends = order[np.where(near, before, after)]
    there = (np.abs(times[ends] - asked) <= SAME_S).all(axis=1)
    if not there.any():
        raise InputError(
            f"{path!r}: no relation is of two scans within {SAME_S:g} s; the log's times go from {times.min():.3f} to "
            f"{times.max():.3f}; --relations-offset-s is what the file's times have more"
        )
    return Relations(ends[there], np.array(rows)[there][:, [2, 3, 7]])


def relation_errors(poses: np.ndarray, relations: Relations) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors of poses `[N, 3]`: `[M]` float64 of the place, metres, and of the heading, radians."""
    first, second = relations.ends.T
    off = between(relations.moved, between(poses[first], poses[second]))
    return np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2])


def aligned(poses: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return poses `[N, 3]` turned and shifted as a whole so that their places fit those of others best."""
    one, other = (p[:, :2] - p[:, :2].mean(axis=0) for p in (poses, others))
    cross, dot = np.sum(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]), np.sum(one * other)
    turn = np.array([0.0, 0.0, np.arctan2(cross, dot)])
    moved = compose(np.broadcast_to(turn, poses.shape), poses)
    moved[:, :2] += others[:, :2].mean(axis=0) - moved[:, :2].mean(axis=0)
    return moved


def trajectory_error(poses: np.ndarray, others: np.ndarray) -> float:
    """Return the root mean square distance of the places of two trajectories once the first is `aligned`, metres."""
    return float(np.sqrt(np.mean(np.sum((aligned(poses, others) - others)[:, :2] ** 2, axis=1))))


def error_rows(poses: np.ndarray, known: dict[str, Relations]) -> list[dict[str, Any]]:
    """Return a row for every kind of relation: number of pairs, mean and standard deviation of both errors."""
    rows = []
    for name, relations in known.items():
        place, turn = relation_errors(poses, relations)
        rows.append({
            "relations": name, "pairs": len(place), "place_m": place.mean(), "place_sd_m": place.std(),
            "turn_deg": np.degrees(turn.mean()), "turn_sd_deg": np.degrees(turn.std()),
        })  # fmt: skip
    return rows
