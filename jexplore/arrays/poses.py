"""Poses in the plane, `[..., 3]`: x, y, metres, and heading, radians; of numpy and of JAX."""

import math
from typing import Any


def wrapped(angle: Any) -> Any:
    """Return angles in [-pi, pi), radians."""
    return (angle + math.pi) % (2 * math.pi) - math.pi


def rotated(xy: Any, angle: Any) -> Any:
    """Return vectors `[..., 2]` turned by angles `[...]`."""
    xp = xy.__array_namespace__()
    cos, sin, x, y = xp.cos(angle), xp.sin(angle), xy[..., 0], xy[..., 1]
    return xp.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def placed(pose: Any, xy: Any) -> Any:
    """Return points `[..., 2]` in a pose's frame in that of the pose: `[..., 2]`."""
    return rotated(xy, pose[..., 2]) + pose[..., :2]


def compose(pose: Any, move: Any) -> Any:
    """Return the pose after a move that is given in the pose's frame, its heading wrapped."""
    xp = pose.__array_namespace__()
    return xp.concatenate([placed(pose, move[..., :2]), wrapped(pose[..., 2:] + move[..., 2:])], axis=-1)


def between(one: Any, other: Any) -> Any:
    """Return the second pose in the frame of the first, its heading wrapped."""
    xp = one.__array_namespace__()
    xy = rotated(other[..., :2] - one[..., :2], -one[..., 2])
    return xp.concatenate([xy, wrapped(other[..., 2:] - one[..., 2:])], axis=-1)
