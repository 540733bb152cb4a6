"""Scans and odometry in recordings of ROS: messages of the types sensor_msgs/LaserScan and nav_msgs/Odometry."""

import os
from typing import Any

import numpy as np

from jexplore.config import InputError, checked_names
from jexplore.worlds.names import METADATA, SUFFIXES
from jexplore.worlds.readers.bags import Kind, connections_of, opened_bag
from jexplore.worlds.readers.scans import ScanLog

_SCANS = Kind("sensor_msgs/msg/LaserScan", "/scan", "scans", "give topic=")
_ODOMETRY = Kind("nav_msgs/msg/Odometry", "/odom", "odometry", "give odometry_topic=")


def is_bag(path: str | os.PathLike[str]) -> bool:
    """Return whether a name is that of a recording of ROS: by its ending, or a folder with a `metadata.yaml`."""
    path = os.fspath(path)
    ending = os.path.splitext(path)[1].lower().lstrip(".")
    folder = os.path.dirname(path) or "." if os.path.basename(path) == METADATA else path
    return ending in SUFFIXES["ROS bag"] or os.path.isfile(os.path.join(folder, METADATA))


@checked_names
def read_laser_bag(
    path: str | os.PathLike[str], *, topic: str | None = None, odometry_topic: str | None = None
) -> ScanLog:
    """Read the scans of a recording, in order of their time stamps, each with the odometry at its time.

    The scanner counts as standing at the robot's base, looking forward. Between two messages the odometry is
    interpolated; scans before the first message or after the last have its pose.

    Args:
      path: `.bag` of ROS 1; `.db3` or `.mcap` of ROS 2, or the folder, or the `metadata.yaml` in it, of such files.
      topic, odometry_topic: by default the only one of its type; of several, `/scan` and `/odom`.

    Returns:
      `ScanLog`; `poses` are those of the odometry: there are no corrected ones.

    Raises:
      InputError: rosbags is not installed; the recording cannot be read, or has no such topic or no message on it;
        scans differ in their beams; or a number is not finite where it must be.
    """
    path = os.fspath(path)
    with opened_bag(path) as reader:
        topic, some = connections_of(path, reader.connections, topic, _SCANS)
        scans = [reader.deserialize(raw, _SCANS.type) for _, _, raw in reader.messages(some)]
        own, some = connections_of(path, reader.connections, odometry_topic, _ODOMETRY)
        odometry = [_pose(reader.deserialize(raw, _ODOMETRY.type)) for _, _, raw in reader.messages(some)]
    for where, messages in ((topic, scans), (own, odometry)):
        if not messages:
            raise InputError(f"{path!r}: has no message on the topic {where}")
    steps = np.array(sorted(odometry))
    if not np.isfinite(steps).all():
        raise InputError(f"{path!r}: the odometry on {own} has a number that is not finite")
    scans.sort(key=lambda scan: _seconds(scan.header))
    first = scans[0]
    scanner = [(len(s.ranges), float(s.angle_min), float(s.angle_increment), float(s.range_max)) for s in scans]
    if len(set(scanner)) > 1 or not len(first.ranges) or not np.isfinite(scanner[0]).all():
        raise InputError(f"{path!r}: the scans on {topic} must have readings, and all the same beams and largest range")
    times = np.array([_seconds(scan.header) for scan in scans])
    angle = np.interp(times, steps[:, 0], np.unwrap(steps[:, 3]))
    poses = np.stack([*(np.interp(times, steps[:, 0], steps[:, k]) for k in (1, 2)), angle], axis=1)
    ranges = np.array([scan.ranges for scan in scans], float)
    ranges[ranges < first.range_min] = 0.0  # too near: says nothing
    angles_rad = float(first.angle_min) + float(first.angle_increment) * np.arange(len(first.ranges))
    return ScanLog(poses, poses.copy(), ranges, angles_rad, times, float(first.range_max))


def _seconds(header: Any) -> float:
    return header.stamp.sec + 1e-9 * header.stamp.nanosec


def _pose(message: Any) -> tuple[float, float, float, float]:
    """Return time, x, y and heading of a message of odometry."""
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    heading = np.arctan2(2 * (turn.w * turn.z + turn.x * turn.y), 1 - 2 * (turn.y**2 + turn.z**2))
    return _seconds(message.header), float(place.x), float(place.y), float(heading)
