"""Logs of the CARMEN toolkit: the laser scans of a real robot, each with its pose.

Source:
  CARMEN 0.7, logger (readlog.c): the words of a line, and what it assumes of a scanner that a line says nothing about.
"""

import dataclasses
import math
import os
import re

import numpy as np

from jexplore.arrays.files import read_text
from jexplore.arrays.poses import between, compose
from jexplore.config import InputError, checked_names, shown, warn_of_input
from jexplore.worlds.readers.scans import ScanLog, fold_scans, require_of_scans
from jexplore.worlds.world import World

_MAX_BYTES = 256 * 2**20
_STEPS_DEG = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5, 400: 0.25, 401: 0.25}
"""Readings of an FLASER line -> degrees from one to the next. A scanner of 180 degrees may leave out the last one."""
_FAR_M, _NEAR_M, _NEAR_CODES_M = 80.0, 8.0, 8.2  # a SICK's two ranges, and what the codes of the shorter one lie below
_MAX_POSE = 1e6
_LONGEST = re.compile(r"(robot|laser)_(front_?)?laser_?1?_max(_?range)?")
"""Parameters that say how far the scanner reaches that looks forward, metres; CARMEN has robot_front_laser_max."""
_SAME = 0.999  # of the largest reading: a SICK's nine codes, 8183 to 8191, lie closer together
_PLACE_M = 0.1  # readings of one value that end in one square of this size count once: a robot may stand still
_OWN = 0.9  # of the scans of a log of GMapping, at least, stand before the ODOM line of their pose; others are lost
_OFTEN = 5  # times the median count of a value; the largest echo of scans recorded in five buildings stays within it


@checked_names
def read_carmen(path: str | os.PathLike[str], *, max_range_m: float | None = None) -> ScanLog:
    """Read the scans of a CARMEN log that have a pose.

    Read are the lines `FLASER` and `ROBOTLASER1`, of the scanner that looks forward. A pose is the first of a line's
    two, which programs that correct a log's poses write; `odometry` is the second. A log of GMapping has the corrected
    pose in both and in an `ODOM` line after every scan, from where further `ODOM` lines lead on: `odometry` joins these
    steps; a scan without one stays where the last one was. Of an `FLASER` line CARMEN assumes that the first of n
    readings points 90 degrees to the right. The next ones are 1 degree apart for n = 180 and 181, 0.5 for 360 and 361,
    0.25 for 400 and 401, else 180 / (n - 1). Readings of inf, NaN and below 0 stay as they are.

    Args:
      path: the log, a text file, or one packed by gzip whose name ends in `.gz`.
      max_range_m: a reading of this or more means that nothing was seen, metres. Default: the least of what the log
        gives signs of: what `ROBOTLASER1` lines say; for `FLASER` the last `PARAM robot_front_laser_max`, without one
        80, and 8 if no reading is above 8.2, as a SICK in its mode of millimetres has it; and, with a warning, the
        largest reading, where it ends in more than 5 times as many places as a reading does in the median, and in more
        than 5 where there is no other.
    """
    path = os.fspath(path)
    require_of_scans(path, max_range_m=max_range_m)
    scans, scanner, first, others, said_m, told = [], None, 0, set(), None, []
    for number, line in enumerate(read_text(path, _MAX_BYTES).splitlines(), start=1):
        word = line.split(maxsplit=1)[0] if line.strip() else ""
        if word not in _READ:
            others.add(word)
            if word == "ODOM" and told:
                told[-1] += _odom(line)
            said_m = max_range_m or _parameter(f"{path!r}: line {number}", line) or said_m
            continue
        own, *scan = _READ[word](f"{path!r}: line {number}", line.split())
        if scanner is None:
            scanner, first = own, number
        elif own != scanner:
            where = f"{path!r}: line {number} has {_describe(own)}, line {first} {_describe(scanner)}"
            raise InputError(f"{where}; keep the lines of one scanner")
        scans.append(scan)
        told.append([])
    if scanner is None:
        hint = "; RAWLASER lines have no pose" if any(word.startswith("RAWLASER") for word in others) else ""
        raise InputError(f"{path!r}: has no FLASER or ROBOTLASER1 line, so no scan with a pose{hint}")
    ranges, poses, odometry, times = (np.array(column) for column in zip(*scans))
    if (poses == odometry).all() and (joined := _joined(poses, told)) is not None:
        odometry = joined
    angles_rad = scanner[1] + scanner[2] * np.arange(scanner[0])
    longest_m = max_range_m or _longest(ranges, scanner[3], said_m)
    log = ScanLog(poses, odometry, ranges, angles_rad, times, float(longest_m))
    return log if max_range_m else dataclasses.replace(log, max_range_m=_found(path, log))


def _odom(line):
    """Return the pose of an ODOM line, in a list; nothing of a line without one."""
    try:
        pose = [float(value) for value in line.split()[1:4]]
    except ValueError:
        return []
    return [pose] if len(pose) == 3 and all(abs(value) < _MAX_POSE for value in pose) else []


def _joined(poses, told):
    """Join the steps of a log of GMapping, from the first pose on: `[N, 3]`; None for another log.

    `told` are the poses of ODOM lines after every scan: in such a log nearly every scan is followed by its own.
    """
    joined, n_own = [poses[0]], 0
    for pose, lines in zip(poses[:-1].tolist(), told):
        further = [line for line in lines if line != pose] if pose in lines else []
        moved = between(np.array(pose), np.array(further[-1])) if further else np.zeros(3)
        joined.append(compose(joined[-1], moved))
        n_own += pose in lines
    return np.array(joined) if n_own >= _OWN * (len(poses) - 1) else None


def load_carmen(
    path: str,
    *,
    cell_m: float = 0.1,
    p_free: float = 0.25,
    range_m: float | None = None,
    no_echo_m: float = 0.0,
    max_range_m: float | None = None,
) -> World:
    """Load a world from a CARMEN log: its scans folded into a reflection map, see `read_carmen` and `fold_scans`.

    A cell is free if it was seen and its reflection probability is at most `p_free`; every other is occupied.
    """
    # Before much is read.
    require_of_scans(path, p_free=p_free, range_m=range_m, no_echo_m=no_echo_m, max_range_m=max_range_m)
    log = read_carmen(path, max_range_m=max_range_m)
    scans = fold_scans(log, cell_m=cell_m, range_m=range_m, no_echo_m=no_echo_m, name=path)
    return scans.world(p_free=p_free, name=path)


def _parameter(where, line):
    """Return the longest range stated by a PARAM line, metres; None for every other line or value."""
    words = line.split()[:3]
    if len(words) < 2 or words[0] != "PARAM" or not _LONGEST.fullmatch(words[1]):
        return None
    text = " ".join(words[2:])
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if 0 < value <= 1000:
        return value
    warn_of_input(
        f"{where}: {words[1]} must be a number above 0 and at most 1000, got {shown(text)}; it is passed over",
    )
    return None


def _longest(ranges, longest_m, said_m):
    """Return the range from which a reading is no echo by the log and its scanner, metres. See `read_carmen`."""
    if longest_m:
        return longest_m
    longest_m = said_m or _FAR_M
    return min(longest_m, _NEAR_M) if ranges.max() <= _NEAR_CODES_M else longest_m  # never with inf or NaN among them


def _found(path, log):
    """Estimate the same from the readings: the largest range, if echoes would not repeat it in as many places."""
    echo, angle = log.echo, log.poses[:, 2:] + log.angles_rad
    values, which = np.unique(log.ranges[echo], return_inverse=True)
    tips = (log.poses[:, None, k] + np.where(echo, log.ranges, 0) * of(angle) for k, of in enumerate((np.cos, np.sin)))
    cells = np.unique([which, *(np.floor(tip[echo] / _PLACE_M).astype(np.int64) for tip in tips)], axis=1)
    places = np.bincount(cells[0], minlength=len(values))
    top = values >= _SAME * values.max(initial=0)
    usual = 1 if top.all() else np.median(places[~top])
    often = values[top & (places > _OFTEN * usual)]
    if not often.size:
        return log.max_range_m
    found_m = float(often[0])
    warn_of_input(
        f"{path!r}: {(log.ranges[echo] >= found_m).sum()} of its {echo.sum()} readings are {found_m:g} m or little "
        "more, the largest and far more than are equal elsewhere, and count as no echo; if they are walls, append "
        f":max_range_m={log.max_range_m:g}",
    )
    return found_m


def _flaser(where, words):
    """Parse FLASER n, n readings, pose, odometry, time, host, time since the log's beginning."""
    n = _count(where, words, 1)
    values = _numbers(where, words[2:], n, n + 7, n + 9)
    step_deg = _STEPS_DEG.get(n, 180 / max(n - 1, 1))
    return (n, -math.pi / 2, math.radians(step_deg), None), *_parts(where, values, n, n + 6)


def _robotlaser(where, words):
    """Parse type, start, field of view, step, range, 2 words, n, readings, m, remissions, poses, 5 words, time."""
    n = _count(where, words, 8)
    m = _count(where, words, 9 + n, least=0)
    kind = _numbers(where, words[1:8], 0, 7, 7)
    rest = words[9 : 9 + n] + words[10 + n + m :]
    values = _numbers(where, rest, n, n + 12, n + 14)
    start_rad, _, step_rad, longest_m = kind[1:5].tolist()
    if not step_rad > 0 or not longest_m > 0:
        raise InputError(f"{where}: the step and the longest range of a scanner must be above 0")
    return (n, start_rad, step_rad, longest_m), *_parts(where, values, n, n + 11)


_READ = {"FLASER": _flaser, "ROBOTLASER1": _robotlaser}


def _count(where, words, at, least=1):
    word = words[at] if at < len(words) else ""
    if not (word.isascii() and word.isdigit() and least <= int(word[:6]) and len(word) < 6):
        raise InputError(f"{where}: word {at + 1} must be the number of readings, got {word!r}")
    return int(word)


def _numbers(where, words, n, need, most):
    """Parse the first `need` words as numbers, finite but for the first `n`, which are readings."""
    if not need <= len(words) <= most:
        what = "is cut short" if len(words) < need else "has too many words"
        raise InputError(f"{where}: {what}; the number of readings that it gives does not fit its {len(words)} others")
    try:
        values = np.array(words[:need], float)
    except ValueError as error:
        raise InputError(f"{where}: {error}") from None
    if not np.isfinite(values[n:]).all():
        raise InputError(f"{where}: has a word that is no finite number where a pose or a time must be")
    return values


def _parts(where, values, n, at_time):
    """Return readings, pose, odometry, time."""
    ranges, poses = values[:n], values[n : n + 6]
    if np.abs(poses).max() > _MAX_POSE:
        raise InputError(f"{where}: a pose must lie within {_MAX_POSE:g} m of 0, got {np.abs(poses).max():g}")
    return ranges, poses[:3], poses[3:], values[at_time]


def _describe(scanner):
    n, start_rad, step_rad, longest_m = scanner
    below = f" below {longest_m:g} m" if longest_m else ""
    return f"{n} readings{below} from {math.degrees(start_rad):.4g} degrees by {math.degrees(step_rad):.4g}"
