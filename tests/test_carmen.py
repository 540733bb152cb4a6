"""Scans that real robots recorded: CARMEN logs, and the reflection maps that they make."""

import dataclasses
import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ref.refusals import refused

from jexplore.config import InputWarning
from jexplore.worlds import load_world
from jexplore.worlds.readers import carmen, scans
from jexplore.worlds.readers.carmen import read_carmen
from jexplore.worlds.readers.scans import ScanLog, fold_scans

LINE = "FLASER 3 1.5 2 81.83 0.35 -0.25 {heading} 1 2 3 10.5 pippo 10.6"
GOOD = LINE.format(heading=0)


def write(tmp_path, *lines, name="scans.log"):
    path = tmp_path / name
    path.write_text("\n".join(lines) + "\n")
    return str(path)


def log_of(ranges, poses=((0.5, 0.5, 0),), angles_rad=(0.0,), max_range_m=80.0):
    ranges, poses = np.array(ranges, float), np.array(poses, float)
    return ScanLog(poses, poses, ranges, np.array(angles_rad, float), np.zeros(len(poses)), max_range_m)


def counts(made):
    return np.asarray(made.grid.hits).tolist(), np.asarray(made.grid.misses).tolist()


# --- the text


def test_lines_by_pencil(tmp_path):
    text = (
        "# a comment",
        "PARAM robot_length 1",
        "ODOM 0 0 0 0 0 0 10.4 pippo 10.4",
        GOOD,
        "",
        LINE.format(heading=-0.5),
        "RLASER 1 1 1 1 1 1 1 1 1 pippo 1",
    )
    log = read_carmen(write(tmp_path, *text))
    assert log.poses.tolist() == [[0.35, -0.25, 0], [0.35, -0.25, -0.5]]
    assert log.odometry.tolist() == [[1, 2, 3], [1, 2, 3]]
    assert log.ranges.tolist() == [[1.5, 2, 81.83]] * 2
    np.testing.assert_allclose(np.degrees(log.angles_rad), [-90, 0, 90])
    assert log.times.tolist() == [10.5, 10.5]
    assert log.max_range_m == 80
    assert repr(log) == "<ScanLog of 2 scans of 3 readings below 80 m>"


@pytest.mark.parametrize(
    ("n", "last_deg"), [(180, 89), (181, 90), (360, 89.5), (361, 90), (401, 10), (5, 90), (1, -90)]
)
def test_directions_that_a_line_does_not_tell(tmp_path, n, last_deg):
    log = read_carmen(write(tmp_path, f"FLASER {n} {'2 ' * n} 0 0 0 0 0 0 1 h 1"), max_range_m=8)
    assert math.degrees(log.angles_rad[0]) == pytest.approx(-90)
    assert math.degrees(log.angles_rad[-1]) == pytest.approx(last_deg)


def test_a_robotlaser_line_tells_its_scanner(tmp_path):
    head, tail = "ROBOTLASER1 0 -0.75 1.5 0.75 20 0.01 0", "7 8 0.5 1 2 3 0 0 0.1 0.1 0.2 99.5 host 1.5"
    log = read_carmen(write(tmp_path, f"{head} 3 4 20 6 0 {tail}", f"{head} 3 1 2 3 3 50 51 52 {tail}"))
    assert log.ranges.tolist() == [[4, 20, 6], [1, 2, 3]]
    assert log.angles_rad.tolist() == [-0.75, 0, 0.75]
    assert log.poses.tolist() == [[7, 8, 0.5]] * 2
    assert log.odometry.tolist() == [[1, 2, 3]] * 2
    assert log.times.tolist() == [99.5] * 2
    assert log.max_range_m == 20


def test_the_longest_range(tmp_path):
    near = write(tmp_path, GOOD.replace("81.83", "8.183"))
    assert read_carmen(near).max_range_m == 8
    assert read_carmen(near, max_range_m=50).max_range_m == 50
    assert read_carmen(write(tmp_path, GOOD.replace("81.83", "8.21"))).max_range_m == 80


@pytest.mark.parametrize(
    ("parameter", "expected_m"),
    [
        ("robot_front_laser_max 30.0 nohost 0", 30),
        ("robot_front_laser_max 80.99 1071078718.4 merci 1071078718.4", 80.99),
        ("robot_frontlaser_max 30.0", 30),
        ("laser_front_laser_max 30.0", 30),
        ("robot_rear_laser_max 30.0", 80),
    ],
)
def test_a_parameter_of_the_log_says_the_longest_range(tmp_path, parameter, expected_m):
    path = write(tmp_path, f"PARAM {parameter}", GOOD)
    assert read_carmen(path).max_range_m == expected_m
    assert read_carmen(path, max_range_m=50).max_range_m == 50


@pytest.mark.parametrize("value", ["off", "1e4", ""])
def test_a_parameter_that_is_no_distance_is_told(tmp_path, value):
    path = write(tmp_path, "# made by hand", f"PARAM robot_front_laser_max {value}", GOOD)
    with pytest.warns(InputWarning, match=rf"line 2: robot_front_laser_max must be a number .*, got '{value}'; it is"):
        assert read_carmen(path).max_range_m == 80
    assert read_carmen(path, max_range_m=50).max_range_m == 50


def room_lines(no_echo, *, poses=((2, 2, 0), (3, 3, 180), (5, 3, 0), (5, 2, 90), (6, 4, 45)), step_deg=0.5, door=True):
    """FLASER lines of a room of 8 x 6 m, and the word that each beam through its door, 1 m in the right wall, gets."""
    angles = np.arange(-90, 90.1, step_deg)
    for x, y, heading_deg in poses:
        turned = np.radians(heading_deg + angles) + 1e-4  # never along a wall
        to_side = np.where(np.cos(turned) > 0, 8 - x, -x) / np.cos(turned)
        away = np.minimum(to_side, np.where(np.sin(turned) > 0, 6 - y, -y) / np.sin(turned))
        out = door & (np.cos(turned) > 0) & (away == to_side) & (np.abs(y + away * np.sin(turned) - 3) < 0.5)
        words = " ".join(no_echo if gone else f"{reading:.2f}" for gone, reading in zip(out, away))
        yield f"FLASER {len(angles)} {words} {f'{x} {y} {math.radians(heading_deg)} ' * 2}1 host 1"


@pytest.mark.parametrize("no_echo", ["12.00", "65.533"])
def test_no_echo_of_any_scanner_is_no_wall_and_told(tmp_path, no_echo):
    expected = load_world(write(tmp_path, *room_lines("81.91")))
    assert expected.free_m2 == pytest.approx(46, abs=1)
    path = write(tmp_path, *room_lines(no_echo))
    line = rf"of its \d+ readings are {float(no_echo):g} m or little more, .* append :max_range_m=80$"
    with pytest.warns(InputWarning, match=line):
        world = load_world(path)
    np.testing.assert_array_equal(world.occupied, expected.occupied)
    assert load_world(f"{path}:max_range_m=80").free_m2 > expected.free_m2 + 1
    with_range = f"{path}:max_range_m={no_echo},range_m=3"
    assert load_world(with_range).free_m2 < expected.free_m2 - 1


def test_a_scanner_that_sees_no_wall_anywhere_has_no_echo(tmp_path):
    words = " ".join(["5.6"] * 181)
    with pytest.warns(InputWarning, match=r"181 of its 181 readings are 5.6 m or little more"):
        assert read_carmen(write(tmp_path, f"FLASER 181 {words} {'0 0 0 ' * 2}1 host 1")).max_range_m == 5.6


@pytest.mark.parametrize(
    ("tail", "said"),
    [
        *((f":{name}={value}", f"{name} must be a number") for name, value in
          (("range_m", -1), ("range_m", "far"), ("max_range_m", 0), ("no_echo_m", -1), ("p_free", 1))),
        (":free=3", "there is no parameter 'free'; it takes p_free, range_m, no_echo_m, max_range_m"),
        ("@0.1", "a CARMEN file has its own scale; leave out what follows the '@'"),
    ],
)  # fmt: skip
def test_bad_parameters_are_told_before_the_log_is_read(tmp_path, monkeypatch, tail, said):
    monkeypatch.setattr(carmen, "read_carmen", lambda *_, **__: pytest.fail("it read"))
    refused(said, load_world, write(tmp_path, GOOD) + tail)


@pytest.mark.parametrize("poses", [[(3, 2, 20)] * 30, [(2, 3, deg) for deg in range(0, 90, 3)], [(1, 1, 45)]])
def test_the_farthest_corner_is_an_echo_however_often_it_is_seen(tmp_path, poses):
    path = write(tmp_path, *room_lines("", poses=poses, door=False))
    assert read_carmen(path).echo.all()  # and no warning


def test_readings_that_are_no_distance(tmp_path):
    """REP 117: inf is no echo, -inf too near, NaN invalid; converted logs have -1 and 0 as well."""
    known = {
        word: load_world(write(tmp_path, *room_lines(word)) + ":no_echo_m=6")
        for word in ("81.91", "inf", "Infinity", "nan", "-inf", "-1", "0", "0.00")
    }
    for word in ("inf", "Infinity"):
        np.testing.assert_array_equal(known[word].occupied, known["81.91"].occupied)
    for word in ("-inf", "-1", "0", "0.00"):
        np.testing.assert_array_equal(known[word].occupied, known["nan"].occupied)
    assert known["inf"].free_m2 > known["nan"].free_m2 + 0.2
    log = read_carmen(write(tmp_path, *(line.replace("3.00", "nan") for line in room_lines("inf"))))
    assert log.max_range_m == 80  # inf marks what has no echo: 8 m is no limit
    assert log.echo.sum() == (np.isfinite(log.ranges) & (log.ranges > 0)).sum() < log.ranges.size


ROBOT = "ROBOTLASER1 0 -1.57 3.14 0.0174 80 0.01 0 1 2 0 0 0 0 0 0 0 0 0 0 0 0 1 h 1"


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ([GOOD, GOOD.replace("1.5 2", "1.5")], "line 2: could not convert string to float: .*'pippo'"),
        ([GOOD, "FLASER 3 1.5 2 8"], "line 2: is cut short"),
        ([GOOD.replace("FLASER 3", "FLASER 300")], "line 1: is cut short"),
        ([GOOD + " 1 2"], "line 1: has too many words"),
        (["FLASER"], "line 1: word 2 must be the number of readings, got ''"),
        ([GOOD.replace("FLASER 3", "FLASER -3")], "must be the number of readings, got '-3'"),
        ([GOOD.replace("0.35", "nan")], "line 1: has a word that is no finite number"),
        ([GOOD.replace("0.35", "1e9")], r"a pose must lie within 1e\+06 m of 0, got 1e\+09"),
        ([GOOD, "FLASER 2 1.5 2 0 0 0 1 2 3 1 h 1"], "line 2 has 2 readings from -90 degrees by 180, line 1 3"),
        ([GOOD, ROBOT], "line 2 has 1 readings below 80 m .* keep the lines of one scanner"),
        ([ROBOT.replace("0.0174", "0")], "step and the longest range of a scanner must be above 0"),
        (["ODOM 0 0 0 0 0 0 1 h 1"], "has no FLASER or ROBOTLASER1 line, so no scan with a pose$"),
        (["RAWLASER1 0 0"], "no scan with a pose; RAWLASER lines have no pose"),
    ],
)
def test_bad_logs_are_refused_by_file_and_line(tmp_path, lines, said):
    path = write(tmp_path, *lines)
    assert refused(said, load_world, path).startswith(repr(path))


# --- the map


def cells_of(x, y, angle, length):
    """The cells that a beam passes, in order, from the crossings' exact order: a plain loop over sorted crossings."""
    x, y, dx, dy = (Fraction(float(v)) for v in (x, y, math.cos(angle), math.sin(angle)))
    length = Fraction(float(length))
    at = {Fraction(0), length}
    for start, direction in ((x, dx), (y, dy)):
        if direction:
            end = start + direction * length
            low, high = min(start, end), max(start, end)
            at |= {(k - start) / direction for k in range(math.floor(low), math.ceil(high) + 1)}
    at = sorted(t for t in at if 0 <= t <= length)
    middles = [(a + b) / 2 for a, b in itertools.pairwise(at)]
    found = [(math.floor(y + dy * t), math.floor(x + dx * t)) for t in middles]
    return [cell for i, cell in enumerate(found) if i == 0 or cell != found[i - 1]]


def folded_slowly(log, cell_m, range_m, no_echo_m):
    """{cell: (hits, misses)}, cells counted from the frame's own 0, 0."""
    hits, misses = {}, {}
    for (x, y, heading), readings in zip(log.poses, log.ranges):
        own = math.floor(y / cell_m), math.floor(x / cell_m)
        misses[own] = misses.get(own, 0) + 1
        for angle, reading in zip(log.angles_rad, readings):
            echo = reading < log.max_range_m
            ends = echo and reading < range_m
            length = reading if ends else range_m if echo else no_echo_m
            *passed, last = cells_of(x / cell_m, y / cell_m, heading + angle, length / cell_m) or [own]
            for cell in (passed if ends else [*passed, last])[1:]:
                misses[cell] = misses.get(cell, 0) + 1
            if ends and passed:
                hits[last] = hits.get(last, 0) + 1
    return hits, misses


@settings(max_examples=20)
@given(seed=st.integers(0, 10**6), cell_m=st.sampled_from([0.1, 0.25, 1.0]), no_echo_m=st.sampled_from([0.0, 2.0]))
def test_any_pose_as_a_slow_plain_loop(seed, cell_m, no_echo_m):
    draw = np.random.default_rng(seed)
    poses = np.column_stack([draw.uniform(-3, 3, (4, 2)), draw.uniform(-9, 9, 4)])
    ranges = np.where(draw.random((4, 7)) < 0.2, 5.0, draw.uniform(0.01, 4, (4, 7)))
    log = log_of(ranges, poses, draw.uniform(-4, 4, 7), max_range_m=5.0)
    made = fold_scans(log, cell_m=cell_m, range_m=3.0, no_echo_m=no_echo_m)
    expected = folded_slowly(log, cell_m, 3.0, no_echo_m)
    shift = [round(v / cell_m) for v in made.origin_m]
    for found, of_cells in zip((made.grid.hits, made.grid.misses), expected):
        array = np.zeros(found.shape, int)
        for (row, col), n in of_cells.items():
            row, col = row - shift[1], col - shift[0]
            if 0 <= row < array.shape[0] and 0 <= col < array.shape[1]:
                array[row, col] = n
        np.testing.assert_array_equal(found, array)
    assert sum(expected[0].values()) == int(made.grid.hits.sum())  # every end lies on the map


@pytest.fixture
def drive():
    draw = np.random.default_rng(8)
    poses = np.column_stack([draw.uniform(0, 3, (20, 2)), draw.uniform(-9, 9, 20)])
    return log_of(draw.uniform(0.01, 4, (20, 30)), poses, np.linspace(-2, 2, 30), max_range_m=3.5)


def test_beams_are_counted_alike_however_many_at_a_time(drive, monkeypatch):
    expected = counts(fold_scans(drive, no_echo_m=1))
    monkeypatch.setattr(scans, "_TOGETHER", 70)
    assert counts(fold_scans(drive, no_echo_m=1)) == expected


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"cell_m": 0}, "cell_m must be a number at least 0.001"),
        ({"range_m": 0}, "range_m must be a number above 0"),
        ({"no_echo_m": -1}, "no_echo_m must be a number at least 0"),
        ({"cell_m": 0.001}, "'scans': .* cells are more than 4096 a side"),
    ],
)
def test_bad_numbers_are_refused(drive, changes, said):
    refused(said, fold_scans, drive, **changes)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"ranges": np.ones(3)}, r"ranges of a ScanLog must be readings \[N, B\], got float64 \[3\]"),
        ({"ranges": np.full((20, 30), "1")}, "ranges of a ScanLog must be finite numbers"),
        ({"poses": np.ones((20, 2))}, r"poses of a ScanLog must be finite numbers of shape \[20, 3\], got float64"),
        ({"poses": np.full((20, 3), np.nan)}, "poses of a ScanLog must be finite"),
        ({"times": np.array(["a"] * 20)}, r"times of a ScanLog must be finite numbers of shape \[20\], got <U1"),
        ({"max_range_m": 0}, "max_range_m must be a number above 0"),
    ],
)
def test_bad_scans_are_refused(drive, changes, said):
    refused(said, dataclasses.replace, drive, **changes)


# --- the world


def test_a_world_by_its_name(tmp_path):
    """Cells of 1 m. A second look sees through what the first one hit: 1 of 2 beams."""
    lines = [f"FLASER 1 {reading} 2.5 0.5 1.6 0 0 0 1 h 1" for reading in (2.3, 3.3)]
    path = write(tmp_path, *lines)  # looks down, -90 degrees from about +90
    world = load_world(path, cell_m=1)
    assert world.name == path
    assert world.occupied.astype(int).tolist() == [[1] * 6, [1, 0, 0, 1, 1, 1], [1] * 6]
    assert world.start == (1, 1, 90)
    assert world.origin_m == (1, -1)
    free = load_world(path + ":p_free=0.5", cell_m=1)
    assert free.occupied.astype(int).tolist()[1] == [1, 0, 0, 0, 1, 1]
    short = load_world(path + ":range_m=1.2", cell_m=1)  # free up to the edge of the map
    assert short.occupied.astype(int).tolist()[1] == [1, 0, 0]
    assert (short.start, short.origin_m) == ((1, 1, 90), (1, -1))
    far = load_world(path + ":max_range_m=3,no_echo_m=2", cell_m=1)
    assert far.occupied.astype(int).tolist()[1] == [1, 0, 0, 1, 1]
