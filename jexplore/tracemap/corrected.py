"""Correction of a map by its odometry, so that loops close without gaps."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from jexplore.arrays.poses import compose, wrapped
from jexplore.config import InputError, checked_names
from jexplore.tracemap.merging.rigid import Move
from jexplore.tracemap.record import NOWHERE, BtmMap, Link, check_map, direction_deg

CORRECTED_FRAME = "map"  # of a corrected map
PLACE = 0.1, 0.03  # standard deviation of a move along a link: metres, plus this share of its length
TURN_DEG = 2.0  # of how far the frame of one end is turned against that of the other


@checked_names
def correct_map(btm: BtmMap) -> BtmMap:
    """Correct places and bearings of a map so that they fit the odometry along all links in the least-squares sense.

    Its attribute `frame` is `map` then.

    The odometry is turned with the frames of the nodes: correcting a corrected map changes nothing.

    A driving robot takes a known place for where it was; the drift gathered until then stays in the last links. Here
    every link takes a share. The first node stays in place, and so do parts of the map without odometry. A wrong scale
    stays wrong.

    Args:
      btm: a map whose searched links have the attribute `moved`, as those of runs do: x, y, metres, from the first node
        to the other in the first's frame; turn of the other's frame, degrees, if known.

    Raises:
      InputError: not a proper map, or no searched link has the attribute, as in a merged map, or it is malformed.
    """
    btm = check_map(btm)
    moved = [(link, _moved(link)) for link in btm.links if link.end != NOWHERE]
    known = [(link.start, link.end, *move) for link, move in moved if move is not None]
    if moved and not known:
        raise InputError(
            "to correct a map its links must have the attribute moved, as those of a run have; none has "
            "(maps that are merged have it no more: correct them before)"
        )
    row = {node.id: i for i, node in enumerate(btm.nodes)}
    pose = fitted(
        np.array([(node.x_m, node.y_m, 0.0) for node in btm.nodes]),
        [(row[start], row[end]) for start, end, *_ in known],
        [(x_m, y_m, math.radians(sum(turn_deg))) for _, _, x_m, y_m, *turn_deg in known],
        [
            (PLACE[0] + PLACE[1] * math.hypot(x_m, y_m), math.radians(TURN_DEG) if turn_deg else math.inf)
            for _, _, x_m, y_m, *turn_deg in known
        ],
    )
    turn_deg = {node.id: math.degrees(pose[i][2]) for i, node in enumerate(btm.nodes)}
    nodes = (dataclasses.replace(node, x_m=float(x_m), y_m=float(y_m)) for node, (x_m, y_m, _) in zip(btm.nodes, pose))
    links = (_turned(link, turn_deg) for link in btm.links)
    return dataclasses.replace(
        btm, nodes=tuple(nodes), links=tuple(links), attributes={**btm.attributes, "frame": CORRECTED_FRAME}
    )


def fitted(pose: np.ndarray, ends: Sequence[tuple[int, int]], moved: ArrayLike, spread: ArrayLike) -> np.ndarray:
    """Fit poses, `[n, 3]`, x, y, metres, heading, radians, to moves between them; pose 0 stays.

    Args:
      pose: first guess.
      ends: `[m, 2]` int, first and second pose of a move.
      moved: `[m, 3]`, the second pose in the frame of the first.
      spread: `[m, 2]`, standard deviations of a place and of a turn; inf: says nothing.
    """
    if len(pose) < 2 or not len(ends):
        return pose
    (start, end), moved, spread = np.array(ends).T, np.array(moved), np.array(spread)[:, [0, 0, 1]]

    def misfit(rest: np.ndarray) -> np.ndarray:
        poses = np.concatenate([pose[:1], rest.reshape(-1, 3)])
        off = compose(poses[start], moved) - poses[end]
        return (np.concatenate([off[:, :2], wrapped(off[:, 2:])], axis=1) / spread).ravel()

    return np.concatenate([pose[:1], least_squares(misfit, pose[1:].ravel()).x.reshape(-1, 3)])


def _moved(link):
    moved = link.attributes.get("moved")
    if moved is None:
        return None
    is_list = isinstance(moved, list) and len(moved) in (2, 3)
    if not (is_list and all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in moved)):
        raise InputError(
            f"link {link.id}: the attribute moved must be [x_m, y_m] or [x_m, y_m, turn_deg], got {moved!r}"
        )
    return moved


def _turned(link: Link, turn_deg) -> Link:
    """Turn a link's bearings and move with the frames of its nodes."""
    end_deg = None
    if link.end_bearing_deg is not None:
        end_deg = direction_deg(link.end_bearing_deg + turn_deg[link.end])
    start_deg = direction_deg(link.start_bearing_deg + turn_deg[link.start])
    attributes = dict(link.attributes)
    if link.end != NOWHERE and (moved := _moved(link)) is not None:
        x_m, y_m = Move(turn_deg=turn_deg[link.start]).place(*moved[:2])
        apart_deg = turn_deg[link.start] - turn_deg[link.end]
        attributes["moved"] = [x_m, y_m, *(math.remainder(turn + apart_deg, 360.0) for turn in moved[2:])]
    return dataclasses.replace(link, start_bearing_deg=start_deg, end_bearing_deg=end_deg, attributes=attributes)
