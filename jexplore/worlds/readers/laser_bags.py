"""Scans and odometry in recordings of ROS: messages of the types sensor_msgs/LaserScan, nav_msgs/Odometry, and
tf2_msgs/TFMessage for odometry and where the scanner is mounted.
"""

import os
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from jexplore.config import InputError, checked_names
from jexplore.worlds.names import FILES, METADATA
from jexplore.worlds.readers.bags import Kind, connections_of, opened_bag
from jexplore.worlds.readers.scans import ScanLog

_SCANS = Kind("sensor_msgs/msg/LaserScan", "/scan", "scans", "give topic=")
_ODOMETRY = Kind("nav_msgs/msg/Odometry", "/odom", "odometry", "give odometry_topic=")
_TRANSFORMS = "tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"
_ODOM = "odom"  # frame in which odometry is told, REP 105 of ROS
_LEVEL = 0.99  # cosine of a scanner's tilt; one more tilted does not scan in the plane


def is_bag(path: str | os.PathLike[str]) -> bool:
    """Return whether a name is that of a recording of ROS: by its ending, or a folder with a `metadata.yaml`."""
    path = os.fspath(path)
    ending = os.path.splitext(path)[1].lower().lstrip(".")
    folder = os.path.dirname(path) or "." if os.path.basename(path) == METADATA else path
    return ending in FILES["ROS bag"].suffixes or os.path.isfile(os.path.join(folder, METADATA))


@checked_names
def read_laser_bag(
    path: str | os.PathLike[str], *, topic: str | None = None, odometry_topic: str | None = None
) -> ScanLog:
    """Read the scans of a recording, in order of their time stamps, each with the odometry at its time.

    Odometry is that of Odometry messages; without any, the transforms from the frame `odom` to the robot's base.
    Between two messages it is interpolated; scans before the first message or after the last have its pose. A scanner
    is mounted where transforms from the base to its frame say, also upside down; without any it stands at the base and
    looks forward. `poses` of the `ScanLog` are those of the odometry: there are no corrected ones.

    Args:
      path: `.bag` of ROS 1; `.db3` or `.mcap` of ROS 2, or the folder, or the `metadata.yaml` in it, of such files.
      topic, odometry_topic: by default the only one of its type; of several, `/scan` and `/odom`.
    """
    path = os.fspath(path)
    with opened_bag(path) as reader:
        topic, some = connections_of(path, reader.connections, topic, _SCANS)
        scans = [reader.deserialize(raw, _SCANS.type) for _, _, raw in reader.messages(some)]
        if not scans:
            raise InputError(f"{path!r}: has no message on the topic {topic}")
        links, frame = _links(reader), _name(scans[0].header.frame_id)
        own, base, odometry = _odometry(path, reader, odometry_topic, links, frame)
    steps = np.array(sorted(odometry))
    if not np.isfinite(steps).all():
        raise InputError(f"{path!r}: the odometry on {own} has a number that is not finite")
    scans.sort(key=lambda scan: _seconds(scan.header))
    first = scans[0]
    scanner = [(len(s.ranges), float(s.angle_min), float(s.angle_increment), float(s.range_max)) for s in scans]
    if len(set(scanner)) > 1 or not len(first.ranges) or not np.isfinite(scanner[0]).all():
        raise InputError(f"{path!r}: the scans on {topic} must have readings, and all the same beams and largest range")
    mount = _mount(links, frame, base)
    if not abs(mount[2, 2]) > _LEVEL:
        raise InputError(f"{path!r}: the scanner {frame!r} is tilted against {base!r}; its scans are in no plane")
    times = np.array([_seconds(scan.header) for scan in scans])
    angle = np.interp(times, steps[:, 0], np.unwrap(steps[:, 3]))
    x, y = (np.interp(times, steps[:, 0], steps[:, k]) for k in (1, 2))
    cos, sin, (ahead, aside) = np.cos(angle), np.sin(angle), mount[:2, 3]
    poses = np.stack([x + cos * ahead - sin * aside, y + sin * ahead + cos * aside, angle], axis=1)
    ranges = np.array([scan.ranges for scan in scans], float)
    ranges[ranges < first.range_min] = 0.0  # too near: says nothing
    angles_rad = float(first.angle_min) + float(first.angle_increment) * np.arange(len(first.ranges))
    way = np.sign(mount[2, 2])  # below 0: upside down
    angles_rad = np.arctan2(mount[1, 0], mount[0, 0]) + way * angles_rad
    return ScanLog(poses, poses.copy(), ranges[:, :: int(way)], angles_rad[:: int(way)], times, float(first.range_max))


def _odometry(
    path: str, reader: Any, topic: str | None, links: dict[str, "_Link"], frame: str
) -> tuple[str, str, list[tuple[float, float, float, float]]]:
    """Return the topic or frame of the odometry, the base's frame, and time, x, y and heading of every message."""
    are_messages = any(one.msgtype == _ODOMETRY.type for one in reader.connections)
    if topic is None and not are_messages and any(link.parent == _ODOM for link in links.values()):
        base = _base(path, links, frame)
        return _ODOM, base, [(time, *_flat(matrix)) for time, matrix in links[base].known]
    topic, some = connections_of(path, reader.connections, topic, _ODOMETRY)
    messages = [reader.deserialize(raw, _ODOMETRY.type) for _, _, raw in reader.messages(some)]
    if not messages:
        raise InputError(f"{path!r}: has no message on the topic {topic}")
    told = [(m.header, m.pose.pose.position, m.pose.pose.orientation) for m in messages]
    odometry = [(_seconds(header), *_flat(_matrix(place, turn))) for header, place, turn in told]
    return topic, _name(messages[0].child_frame_id), odometry


class _Link(NamedTuple):
    """Transforms of a frame into its parent's."""

    parent: str
    known: list[tuple[float, np.ndarray]]  # seconds, [4, 4]


def _links(reader: Any) -> dict[str, _Link]:
    """Return the transforms of a recording by the frame that they place."""
    links: dict[str, _Link] = {}
    some = [one for one in reader.connections if one.msgtype in _TRANSFORMS]
    for connection, _, raw in reader.messages(some) if some else ():
        for told in reader.deserialize(raw, connection.msgtype).transforms:
            link = links.setdefault(_name(told.child_frame_id), _Link(_name(told.header.frame_id), []))
            if link.parent == _name(told.header.frame_id):
                place = told.transform
                link.known.append((_seconds(told.header), _matrix(place.translation, place.rotation)))
    return links


def _base(path: str, links: dict[str, _Link], frame: str) -> str:
    """Return the frame whose transforms are the odometry: that which carries the scanner, or else the only one."""
    some = [name for name, link in links.items() if link.parent == _ODOM]
    above = [name for name in _above(links, frame) if name in some]
    if not above and len(some) > 1:
        raise InputError(f"{path!r}: frames in odom are {', '.join(sorted(some))}; none of them carries {frame!r}")
    return (above or some)[0]


def _above(links: dict[str, _Link], frame: str) -> list[str]:
    """Return a frame and those that carry it, from one to the next."""
    names = [frame]
    while names[-1] in links and links[names[-1]].parent not in names:
        names.append(links[names[-1]].parent)
    return names


def _mount(links: dict[str, _Link], frame: str, base: str) -> np.ndarray:
    """Return the transform `[4, 4]` of a frame into the base's, by the first one of every link; of none it is 1."""
    above, mount = _above(links, frame), np.eye(4)
    for name in above[: above.index(base)] if base in above else ():
        mount = links[name].known[0][1] @ mount
    return mount


def _name(frame: str) -> str:
    return frame.lstrip("/")  # as ROS's first releases wrote them


def _seconds(header: Any) -> float:
    return header.stamp.sec + 1e-9 * header.stamp.nanosec


def _matrix(place: Any, turn: Any) -> np.ndarray:
    """Return a place and a quaternion as a transform `[4, 4]`; a quaternion of zeros is no turn."""
    matrix, q = np.eye(4), np.array([turn.x, turn.y, turn.z, turn.w], float)
    matrix[:3, :3] = Rotation.from_quat(q if q.any() else (0, 0, 0, 1)).as_matrix()
    matrix[:3, 3] = place.x, place.y, place.z
    return matrix


def _flat(matrix: np.ndarray) -> tuple[float, float, float]:
    """Return x, y and heading of a transform."""
    return float(matrix[0, 3]), float(matrix[1, 3]), float(np.arctan2(matrix[1, 0], matrix[0, 0]))
