"""Recordings of ROS 1 and ROS 2: maps, and scans with odometry.

Read are messages of the types nav_msgs/OccupancyGrid; sensor_msgs/LaserScan and nav_msgs/Odometry; tf2_msgs/TFMessage
for odometry and where the scanner is mounted.

rosbags, which reads both without a ROS, is an extra, imported by the function that needs it.
"""

import collections
import contextlib
import dataclasses
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from jexplore.arrays.files import first_line, opened, told_kind
from jexplore.config import InputError, checked_names, require_number
from jexplore.worlds.names import FILES, recording_folder
from jexplore.worlds.readers.grids import free_cells, require_upright, resample
from jexplore.worlds.readers.images import MAX_PIXELS
from jexplore.worlds.readers.scans import ScanLog
from jexplore.worlds.world import World, require_hundred

_FLAT = 1e-3  # of the tilt's part of a quaternion; a map so tilted is shorter by less than 1e-5
_LEVEL = 0.99  # cosine of a scanner's tilt; one more tilted does not scan in the plane
_TRANSFORMS = "tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"
_ODOM = "odom"  # frame in which odometry is told, REP 105 of ROS


class Kind(NamedTuple):
    """A type of message."""

    type: str
    usual: str  # topic that is taken of several
    name: str  # of such messages in errors, in the plural
    hint: str  # how to name a topic


_MAPS = Kind("nav_msgs/msg/OccupancyGrid", "/map", "maps", "append :topic=")
_SCANS = Kind("sensor_msgs/msg/LaserScan", "/scan", "scans", "give topic=")
_ODOMETRY = Kind("nav_msgs/msg/Odometry", "/odom", "odometry", "give odometry_topic=")


@dataclasses.dataclass(frozen=True)
class RecordedGrid:
    """A message of the type nav_msgs/OccupancyGrid."""

    topic: str  # topic on which it was published
    occupancy: np.ndarray  # `[H, W]` int8, -1 unknown, 0 free to 100 occupied; row 0 is the bottom
    resolution_m: float  # edge of a cell, metres
    origin_m: tuple[float, float]  # x, y of the lower left corner of cell (0, 0), metres


@checked_names
def read_bag(path: str | os.PathLike[str], *, topic: str | None = None) -> RecordedGrid:
    """Read the last map that was published while a recording was made.

    Args:
      path: `.bag` of ROS 1; `.db3` or `.mcap` of ROS 2, or the folder, or the `metadata.yaml` in it, of such files.
      topic: by default the only one with maps; of several, `/map`.
    """
    path = os.fspath(path)
    if topic is not None and not isinstance(topic, str):
        raise InputError(f"{path!r}: topic must be the name of one, as /map, got {topic!r}")
    with opened_bag(path) as reader:
        topic, (grid,) = _messages(path, reader, topic, _MAPS, most=1)
    return _recorded(f"{path!r}: the map on {topic}", topic, grid)


@contextlib.contextmanager
def opened_bag(path: str) -> Iterator[Any]:
    """Open a recording with rosbags' `AnyReader`; errors within the context are reported in one form."""
    folder = recording_folder(path)
    if folder is None:
        with opened(path) as file:
            what = told_kind(file.read(16))
        if what and not what.endswith(os.path.splitext(path)[1].lower() or "."):
            raise InputError(f"{path!r}: is {what}")
    try:
        # Ignored types: an extra that need not be installed.
        from rosbags.highlevel import AnyReader  # type: ignore[import-not-found]
        from rosbags.typesys import Stores, get_typestore  # type: ignore[import-not-found]
    except ImportError:
        raise InputError(f"{path!r}: reading it takes rosbags: pip install 'jexplore[ros]'") from None
    try:
        with AnyReader([Path(folder or path)], default_typestore=get_typestore(Stores.LATEST)) as reader:
            yield reader
    except InputError:
        raise
    except Exception as error:  # rosbags lets through what the formats' own readers raise
        raise InputError(f"{path!r}: is damaged or no recording of ROS ({first_line(error)})") from None


@checked_names
def load_bag(
    path: str | os.PathLike[str],
    *,
    cell_m: float = 0.1,
    topic: str | None = None,
    free_max: int | None = None,
    occupied_min: int | None = None,
) -> World:
    """Load a world from a map in a recording, with its origin. Unknown cells count as occupied.

    `load_world("run.bag:topic=/map,free_max=49")` is the same; topics that a name cannot hold are given here. `topic`
    is as of `read_bag`, `free_max` and `occupied_min` as of `grids.free_cells`.
    """
    path = os.fspath(path)
    grid = read_bag(path, topic=topic)
    where = f"{path!r}: the map on {grid.topic}"
    require_hundred(path, grid.occupancy)
    free = free_cells(where, grid.occupancy, free_max=free_max, occupied_min=occupied_min)
    cells = resample(~free, (grid.resolution_m, grid.resolution_m), cell_m, name=path)
    return World(occupied=cells, cell_m=cell_m, name=path, origin_m=grid.origin_m)


def _messages(path: str, reader: Any, topic: str | None, kind: Kind, most: int | None = None) -> tuple[str, list[Any]]:
    """Return the topic of a recording with messages of one kind, and its messages; with `most` the last of them."""
    some = [one for one in reader.connections if one.msgtype == kind.type]
    topics = sorted({one.topic for one in some})
    if not some:
        others = ", ".join(sorted({one.topic for one in reader.connections})) or "none"
        raise InputError(
            f"{path!r}: has no message of the type {kind.type.replace('/msg/', '/')} (its topics: {others})"
        )
    if topic is None and len(topics) > 1 and kind.usual not in topics:
        raise InputError(f"{path!r}: has {kind.name} on {', '.join(topics)}; {kind.hint}{topics[0]} for one of them")
    chosen = (kind.usual if kind.usual in topics else topics[0]) if topic is None else topic
    if chosen not in topics:
        one = kind.name.removesuffix("s")
        raise InputError(
            f"{path!r}: has no {one} on the topic {chosen!r}; there are {kind.name} on {', '.join(topics)}"
        )
    some = [one for one in some if one.topic == chosen]
    found = collections.deque((raw for _, _, raw in reader.messages(some)), maxlen=most)
    if not found:
        raise InputError(f"{path!r}: has no message on the topic {chosen}")
    return chosen, [reader.deserialize(raw, kind.type) for raw in found]


def _recorded(where: str, topic: str, grid: Any) -> RecordedGrid:
    """Convert a message of rosbags to `RecordedGrid`."""
    info, place = grid.info, grid.info.origin.position
    height, width = int(info.height), int(info.width)
    yaw_rad = _yaw(where, grid.info.origin.orientation)
    if not height * width or len(grid.data) != height * width:
        raise InputError(f"{where}: is {height} x {width} cells and has {len(grid.data)} values; expected one for each")
    if height * width > MAX_PIXELS:
        raise InputError(f"{where}: has more than {MAX_PIXELS // 10**6} million cells; cut out a smaller one")
    # Resolutions are sent in 32 bits: 0.05, not 0.05000000074505806.
    resolution_m = require_number(
        f"{where}: resolution", float(str(np.float32(info.resolution))), low_open=True, high=100
    )
    x_m, y_m = (require_number(f"{where}: origin", float(v), low=-math.inf) for v in (place.x, place.y))
    occupancy = np.asarray(grid.data, np.int8).reshape(height, width)
    low, high = int(occupancy.min()), int(occupancy.max())
    if low < -1 or high > 100:
        raise InputError(f"{where}: occupancy must lie from -1 (unknown) to 100, got {low} to {high}")
    require_upright(where, occupancy.shape, yaw_rad)
    return RecordedGrid(topic, occupancy, resolution_m, (x_m, y_m))


def _yaw(where: str, turn: Any) -> float:
    """Return the yaw of an orientation; all zeros, for a missing one, are 0."""
    x, y, z, w = (float(v) for v in (turn.x, turn.y, turn.z, turn.w))
    if not all(math.isfinite(v) for v in (x, y, z, w)):
        raise InputError(f"{where}: the orientation of its origin must be finite")
    if max(abs(x), abs(y)) > _FLAT:
        raise InputError(f"{where}: is tilted; the orientation of its origin must be a turn about z")
    return math.remainder(2 * math.atan2(z, w), 2 * math.pi) if z or w else 0.0


def is_bag(path: str | os.PathLike[str]) -> bool:
    """Return whether a name is that of a recording of ROS: by its ending, or a folder with a `metadata.yaml`."""
    path = os.fspath(path)
    ending = os.path.splitext(path)[1].lower().lstrip(".")
    return ending in FILES["ROS bag"].suffixes or recording_folder(path) is not None


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
        topic, scans = _messages(path, reader, topic, _SCANS)
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
    topic, messages = _messages(path, reader, topic, _ODOMETRY)
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
