"""ROS maps: a yaml file and its picture, read as map_server (ROS 1) and nav2_map_server (ROS 2) read them.

Source:
  nav2_map_server, map_io.cpp, as it has been since pull request 5071 of 2025 (occupancy of a pixel in the modes
  trinary, scale and raw; greys of a saved map). Colours count by their luma, pixels on a threshold are free or
  occupied, and pixels that are not fully opaque are unknown in trinary too. Before that, and in map_server of ROS 1,
  image_loader.cpp, channels were averaged, opacity among them, and a pixel on a threshold was unknown.
"""

import dataclasses
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from jexplore.arrays.files import first_line, read_yaml
from jexplore.config import InputError, require_number, shown, warn_of_input
from jexplore.worlds.readers.grids import LEAST_PIXEL_M, MOST_PIXEL_M, free_cells, require_upright, resample
from jexplore.worlds.readers.images import grey, read_pixels, transparency
from jexplore.worlds.world import World, require_hundred, require_occupancy

ROS_MODES = ("trinary", "scale", "raw")
_FREE, _UNKNOWN, _OCCUPIED = 254, 205, 0  # greys of a saved map
_FAR_M = 1e9  # an origin farther away leaves no digits for cells
_SUSPECT = 0.01  # share of unknown pixels that may be free without a word
_MAX_YAML = 2**16
_BOOLS = {"y": 1, "yes": 1, "on": 1, "n": 0, "no": 0, "off": 0}  # of yaml-cpp, in addition to true


@dataclasses.dataclass(frozen=True)
class RosInfo:
    """Content of the yaml file of a ROS map."""

    image: str  # path of the picture
    resolution_m: float  # edge of a pixel, metres
    origin_m: tuple[float, float]  # x, y of the lower left corner of the picture, metres
    yaw_rad: float  # turn of the picture about that corner, counter-clockwise
    negate: bool  # true if white is occupied
    occupied_thresh: float  # a pixel is occupied if its probability is this or more
    free_thresh: float  # a pixel is free if its probability is this or less
    mode: str  # `trinary`, `scale` or `raw`


def read_ros(path: str | os.PathLike[str]) -> tuple[np.ndarray, RosInfo]:
    """Read the occupancy of a ROS map, cell for cell as the map server publishes it, and its yaml file.

    The occupancy is `[H, W]` int8, -1 unknown, 0 free to 100 occupied, row 0 at the bottom. It is not turned by the
    yaw.
    """
    levels, info = _read(str(path))
    return _occupancy(levels, info), info


def _read(path: str) -> tuple[np.ndarray, RosInfo]:
    """Read the picture's levels, row 0 at the bottom, and the `RosInfo`."""
    info = _read_yaml(path)
    try:
        return read_pixels(info.image, as_stored=True)[::-1], info
    except InputError as error:  # a name may be as long as one likes
        raise InputError(f"{path!r}: its image cannot be read: {error!s:.300}") from None


def load_ros(
    path: str | os.PathLike[str], *, cell_m: float = 0.1, free_max: int | None = None, occupied_min: int | None = None
) -> World:
    """Load a world from a ROS map, with its origin. Unknown cells count as occupied.

    `free_max` and `occupied_min` are for the modes scale and raw, see `grids.free_cells`. Warns of pixels that stand
    for unknown and are free by the map's own thresholds or mode, as they are in the map server, and of a picture of
    black and white in mode raw.
    """
    path = str(path)
    levels, info = _read(path)
    occupancy = _occupancy(levels, info)
    if info.mode == "raw":
        require_hundred(path, occupancy)
        if np.array_equal(np.unique(grey(levels)), [0, 255]):
            warn_of_input(
                f"{path!r}: in mode raw black is free and white unknown, and its picture has nothing else; if black is "
                "a wall, write mode: trinary",
            )
    if info.mode == "trinary" and not free_max is occupied_min is None:
        raise InputError(
            f"{path!r}: free_max and occupied_min are for the modes scale and raw; in mode trinary the file's "
            "free_thresh and occupied_thresh say what is free"
        )
    free = free_cells(repr(path), occupancy, free_max=free_max, occupied_min=occupied_min)
    if not free.any():
        clear = transparency(levels).mean()
        hint = f"; {clear:.0%} of its pixels are transparent: flatten the picture onto white" if clear else ""
        raise InputError(
            f"{path!r}: no pixel is free at free_thresh {info.free_thresh:g}, negate {info.negate:d}{hint}"
        )
    _warn_of_unknown(path, levels, info, free)
    require_upright(repr(path), free.shape, info.yaw_rad)
    cells = resample(~free, (info.resolution_m, info.resolution_m), cell_m, name=path)
    return World(occupied=cells, cell_m=cell_m, name=path, origin_m=info.origin_m)


def write_ros(
    occupancy: ArrayLike,
    path: str | os.PathLike[str],
    *,
    cell_m: float = 0.1,
    origin_m: tuple[float, float] = (0.0, 0.0),
) -> Path:
    """Write a ROS map that `read_ros` and the map servers read back unchanged: a yaml file and a PGM next to it.

    The mode is trinary if every value is -1, 0 or 100, else raw. Returns the path of the picture.

    Args:
      occupancy: `[H, W]` integers from -1 to 100, or bool, True is occupied; row 0 at the bottom.
      path: the yaml file to write. The picture gets its name with the suffix `.pgm`.
      cell_m: edge of a cell, metres.
      origin_m: x, y of the lower left corner, metres.
    """
    path = Path(path)
    if path.suffix.lower() not in (".yaml", ".yml"):
        raise InputError(f"{str(path)!r}: the file to write must end in .yaml")
    require_number("cell_m", float(cell_m), low=LEAST_PIXEL_M, high=MOST_PIXEL_M)
    x_m, y_m = (require_number("origin_m", float(value), low=-_FAR_M, high=_FAR_M) for value in origin_m)
    occupancy = require_occupancy("occupancy", occupancy)
    occupancy = np.where(occupancy, 100, 0) if occupancy.dtype.kind == "b" else occupancy
    trinary = bool(np.isin(occupancy, (-1, 0, 100)).all())
    if trinary:
        pixels = np.select([occupancy == 0, occupancy == 100], [_FREE, _OCCUPIED], _UNKNOWN)
    else:
        pixels = np.where(occupancy < 0, 255, occupancy.astype(np.int32))
    image = path.with_suffix(".pgm")
    text = (
        f"image: {json.dumps(image.name)}\n"
        f"mode: {'trinary' if trinary else 'raw'}\n"
        f"resolution: {_decimal(cell_m)}\n"
        f"origin: [{_decimal(x_m)}, {_decimal(y_m)}, 0.0]\n"
        "negate: 0\n"
        "occupied_thresh: 0.65\n"
        "free_thresh: 0.196\n"
    )
    rows, cols = occupancy.shape
    try:
        image.write_bytes(f"P5\n{cols} {rows}\n255\n".encode() + pixels[::-1].astype(np.uint8).tobytes())
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{str(path)!r}: cannot be written ({first_line(error)})") from None
    return image


def _decimal(value: float) -> str:
    """Format a length without the rounding errors of sums, as a number for every YAML reader."""
    return np.format_float_positional(round(value, 12) + 0.0, trim="0")


def _occupancy(levels: np.ndarray, info: RosInfo) -> np.ndarray:
    """Compute the occupancy by a table over greys, in 32 bits as the map server does."""
    shade = np.arange(256)
    if info.mode == "raw":
        return np.where(shade > 100, -1, shade).astype(np.int8)[grey(levels)]
    p = shade.astype(np.float32) / np.float32(255)
    if not info.negate:
        p = 1 - p
    free, occupied = p <= np.float32(info.free_thresh), p >= np.float32(info.occupied_thresh)
    between = -1
    if info.mode == "scale":
        span = np.float32(info.occupied_thresh - info.free_thresh)
        between = np.floor((p - np.float32(info.free_thresh)) / span * np.float32(100) + np.float64(0.5))
    occupancy = np.select([free, occupied], [0, 100], between).astype(np.int8)[grey(levels)]
    occupancy[transparency(levels)] = -1
    return occupancy


def _warn_of_unknown(path: str, levels: np.ndarray, info: RosInfo, free: np.ndarray) -> None:
    """Warn where pixels are free that have the grey which map savers write for unknown."""
    share = ((grey(levels) == _UNKNOWN) & free).mean()
    if share < _SUSPECT or info.mode == "raw":  # which has no such grey
        return
    cures = []
    if info.mode == "scale":
        cures.append("write mode: trinary")
    if info.mode == "trinary" or info.free_thresh >= (255 - _UNKNOWN) / 255:
        cures.append("write free_thresh: 0.196")
    warn_of_input(
        f"{path!r}: {share:.0%} of its pixels are grey {_UNKNOWN}, which stands for unknown, and yet free, as in the "
        f"map server; to have them unknown {' and '.join(cures)}",
    )


def _read_yaml(path: str) -> RosInfo:
    content = read_yaml(path, _MAX_YAML)
    if not isinstance(content, dict):
        raise InputError(f"{path!r}: is not a ROS map; expected the keys image, resolution, origin, ...")
    for key in ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh"):
        if key not in content:
            raise InputError(f"{path!r}: the key {key!r} is missing")
    image, origin, mode = content["image"], content["origin"], content.get("mode", "trinary")
    if not isinstance(image, str) or not image:
        raise InputError(f"{path!r}: image must be the name of a file, got {shown(image)}")
    if not isinstance(origin, list) or len(origin) != 3:
        raise InputError(f"{path!r}: origin must be [x, y, yaw], got {shown(origin)}")
    x_m, y_m, yaw_rad = (_float(path, "origin", value, low=-_FAR_M, high=_FAR_M) for value in origin)
    if not isinstance(mode, str) or mode.lower() not in ROS_MODES:
        raise InputError(f"{path!r}: mode must be one of {', '.join(ROS_MODES)}, got {shown(mode)}")
    info = RosInfo(
        image=os.path.join(os.path.dirname(path), image),
        resolution_m=_float(path, "resolution", content["resolution"], low=LEAST_PIXEL_M, high=MOST_PIXEL_M),
        origin_m=(x_m, y_m),
        yaw_rad=yaw_rad,
        negate=bool(_float(path, "negate", _BOOLS.get(str(content["negate"]).lower(), content["negate"]), high=1)),
        occupied_thresh=_float(path, "occupied_thresh", content["occupied_thresh"], high=1),
        free_thresh=_float(path, "free_thresh", content["free_thresh"], high=1),
        mode=mode.lower(),
    )
    low, high = info.free_thresh, info.occupied_thresh
    if low >= high:
        raise InputError(f"{path!r}: free_thresh {low:g} must be below occupied_thresh {high:g}")
    return info


def _float(path: str, key: str, value: Any, **bounds: Any) -> float:
    """Parse a number as the map server does: also in quotes, and true for 1."""
    try:
        number = value if "_" in str(value) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = value
    return require_number(f"{path!r}: {key}", number, **bounds)
