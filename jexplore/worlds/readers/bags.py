"""Maps in recordings of ROS: messages of the type nav_msgs/OccupancyGrid, of ROS 1 and ROS 2.

rosbags, which reads both without a ROS, is an extra, imported by the function that needs it.
"""

import collections
import contextlib
import dataclasses
import math
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jexplore.arrays.files import first_line, opened, told_kind
from jexplore.config import InputError, checked_names, require_number
from jexplore.worlds.names import METADATA
from jexplore.worlds.readers.grids import free_cells, require_upright, resample
from jexplore.worlds.readers.images import MAX_PIXELS
from jexplore.worlds.world import World, require_hundred

_LEVEL = 1e-3  # of the tilt's part of a quaternion; a map so tilted is shorter by less than 1e-5


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
        topic, connections = connections_of(path, reader.connections, topic, _MAPS)
        last = collections.deque((raw for _, _, raw in reader.messages(connections)), maxlen=1)
        if not last:
            raise InputError(f"{path!r}: has no message on the topic {topic}")
        grid = reader.deserialize(last[0], _MAPS.type)
    return _recorded(f"{path!r}: the map on {topic}", topic, grid)


@contextlib.contextmanager
def opened_bag(path: str) -> Iterator[Any]:
    """Open a recording with rosbags' `AnyReader`; errors within the context are reported in one form."""
    if os.path.basename(path) == METADATA:
        path = os.path.dirname(path) or "."
    is_folder = os.path.isfile(os.path.join(path, METADATA))
    if not is_folder:
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
        with AnyReader([Path(path)], default_typestore=get_typestore(Stores.LATEST)) as reader:
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


class Kind(NamedTuple):
    """A type of message."""

    type: str
    usual: str  # topic that is taken of several
    name: str  # of such messages in errors, in the plural
    hint: str  # how to name a topic


def connections_of(path: str, connections: Iterable[Any], topic: str | None, kind: Kind) -> tuple[str, list[Any]]:
    """Return the topic of a recording with messages of one kind, and its connections."""
    some = [one for one in connections if one.msgtype == kind.type]
    topics = sorted({one.topic for one in some})
    if not some:
        others = ", ".join(sorted({one.topic for one in connections})) or "none"
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
    return chosen, [one for one in some if one.topic == chosen]


_MAPS = Kind("nav_msgs/msg/OccupancyGrid", "/map", "maps", "append :topic=")


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
    if max(abs(x), abs(y)) > _LEVEL:
        raise InputError(f"{where}: is tilted; the orientation of its origin must be a turn about z")
    return math.remainder(2 * math.atan2(z, w), 2 * math.pi) if z or w else 0.0
