"""Poses and maps of recorded logs: reading, errors, the study, the command."""

import dataclasses
import gzip
import json
import warnings
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref import slam as ref
from ref.refusals import refused

import jexplore as jx
from jexplore.arrays.poses import between, compose
from jexplore.cli.main import main
from jexplore.config import InputWarning
from jexplore.slam2d import mapping as mapping_module
from jexplore.slam2d.closing import Scanner
from jexplore.slam2d.mapping import Mapper, Sizes, begin, put
from jexplore.slam2d.matching import Outcome
from jexplore.slam2d.settings import SlamSettings
from jexplore.studies.slam import errors, logs
from jexplore.worlds.readers.bags import is_bag, read_laser_bag
from jexplore.worlds.readers.carmen import read_carmen
from jexplore.worlds.readers.ros import read_ros
from jexplore.worlds.readers.scans import ScanLog

N = 24


def drive(n=N, seed=0, noise=1.0):
    """A way through the room with noisy odometry."""
    rng, true = np.random.default_rng(seed), [np.array([1.0, 1.0, 0.0])]
    for i in range(n - 1):
        true.append(compose(true[-1], np.array([0.2, 0, 0.25 if i % 8 > 3 else 0.0])))
    true = np.array(true)
    steps = between(true[:-1], true[1:]) + noise * rng.normal(0, 1, (n - 1, 3)) * [0.02, 0.01, 0.02]
    odometry = [true[0]]
    for step in steps:
        odometry.append(compose(odometry[-1], step))
    ranges = np.array([ref.cast(pose) for pose in true]) + rng.normal(0, 0.005, (n, len(ref.ANGLES)))
    return ScanLog(true, np.array(odometry), ranges, ref.ANGLES, np.arange(n, dtype=float), 80.0)


def gmapping_lines(log):
    """The log as GMapping writes it."""
    moved = between(log.odometry[:-1], log.odometry[1:])
    for i, pose in enumerate(log.poses):
        if i:
            x, y, heading = compose(log.poses[i - 1], moved[i - 1])
            yield f"ODOM {x} {y} {heading} 0 0 0 {i} pippo {i}"
        own = " ".join(map(str, pose))
        told = " ".join(map(str, log.ranges[i]))
        yield (
            f"ROBOTLASER1 0 {log.angles_rad[0]} 3.14 {np.diff(log.angles_rad)[0]} 80 0.01 0 61 {told} 0 {own} {own} "
            + (f"0 0 0.1 0.1 0.2 {log.times[i]} pippo {log.times[i]}")
        )
        yield f"ODOM {own} 0 0 0 0 pippo 0"
        yield "NEFF 30"


@pytest.fixture(scope="module")
def log():
    return drive(noise=2.0)


# --- reading


def test_odometry_of_a_log_of_gmapping_packed_or_not(log, tmp_path):
    text = "\n".join(gmapping_lines(log))
    (tmp_path / "a.log").write_text(text)
    (tmp_path / "a.log.gz").write_bytes(gzip.compress(text.encode()))
    for name in ("a.log", "a.log.gz"):
        found = read_carmen(tmp_path / name)
        np.testing.assert_allclose(found.poses, log.poses)
        np.testing.assert_allclose(found.odometry, log.odometry, atol=1e-9)
        np.testing.assert_allclose(found.ranges, log.ranges)


def test_a_scan_without_odometry_stays_where_it_was(log, tmp_path):
    lines = list(gmapping_lines(log))
    (tmp_path / "a.log").write_text("\n".join(line for i, line in enumerate(lines) if i != 3))
    found = read_carmen(tmp_path / "a.log").odometry
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_allclose(
        between(found[1:-1], found[2:]), between(log.odometry[1:-1], log.odometry[2:]), atol=1e-9
    )


def test_a_log_of_gmapping_with_two_scans_swapped_keeps_its_odometry(log, tmp_path):
    lines = list(gmapping_lines(log))
    scans = [i for i, line in enumerate(lines) if line.startswith("ROBOTLASER1")]
    lines[scans[4]], lines[scans[5]] = lines[scans[5]], lines[scans[4]]
    (tmp_path / "a.log").write_text("\n".join(lines))
    found = read_carmen(tmp_path / "a.log").odometry
    still, rest = np.r_[4:6], np.r_[0:4, 6 : N - 1]  # steps from the two are not known
    assert (found[still] == found[still + 1]).all()
    moved = between(log.odometry[rest], log.odometry[rest + 1])
    np.testing.assert_allclose(between(found[rest], found[rest + 1]), moved, atol=1e-9)


def test_a_log_of_poses_alone_says_that_they_count_as_odometry(log, tmp_path):
    scans = [line for line in gmapping_lines(log) if line.startswith("ROBOTLASER1")]
    (tmp_path / "a.log").write_text("\n".join(scans))
    with pytest.warns(InputWarning, match="a.log': has one pose a scan: it counts as odometry"):
        found = logs.read_log(tmp_path / "a.log", None, None, None)
    np.testing.assert_array_equal(found.odometry, log.poses)


@pytest.mark.parametrize("content", [b"no gzip", gzip.compress(b"FLASER" * 99)[:-9]], ids=["other", "cut"])
def test_a_damaged_packed_log(tmp_path, content):
    (tmp_path / "a.log.gz").write_bytes(content)
    refused(r"a.log.gz': cannot be unpacked", read_carmen, tmp_path / "a.log.gz")


def test_scans_out_of_order_are_sorted_unless_times_tell_nothing(log):
    order = np.r_[0, 2, 1, 3:N]
    swapped = ScanLog(log.poses[order], log.odometry[order], log.ranges[order], log.angles_rad, log.times[order], 80.0)
    with pytest.warns(InputWarning, match="1 of 24 scans is earlier than the one before: all are sorted by time"):
        np.testing.assert_array_equal(logs.in_order(swapped).poses, log.poses)
    assert logs.in_order(log) is log
    odd = ScanLog(log.poses, log.odometry, log.ranges, log.angles_rad, np.arange(N)[::-1] * 1.0, 80.0)
    with pytest.warns(InputWarning, match="23 of 24 scans are earlier"):
        assert logs.in_order(odd) is odd


@pytest.fixture
def ros():
    """Makers of messages of ROS 1, and `write(path, topics)`."""
    bags = pytest.importorskip("ref.bags")

    class Ros:
        def make(self, name, second=0, **told):
            stamp = {"header__stamp__sec": int(second), "header__stamp__nanosec": round(second % 1 * 1e9)}
            return bags.make(bags.ROS1, name, **stamp, **told)

        def turn(self, heading, is_upside_down=False):
            sin, cos = np.sin(heading / 2), np.cos(heading / 2)
            x, y, z, w = (cos, sin, 0.0, 0.0) if is_upside_down else (0.0, 0.0, sin, cos)
            return bags.make(bags.ROS1, "geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

        def scan(self, second, ranges):
            span = {"angle_min": -1.0, "angle_max": 1.0, "angle_increment": 1.0, "range_min": 0.5, "range_max": 10.0}
            ranges = np.float32(ranges)
            return self.make("sensor_msgs/msg/LaserScan", second, header__frame_id="laser", ranges=ranges, **span)

        def odometry(self, second, x, heading):
            told = {"pose__pose__position__x": x, "pose__pose__orientation": self.turn(heading)}
            return self.make("nav_msgs/msg/Odometry", second, child_frame_id="base", **told)

        def transform(self, second, parent, child, place, turn):
            told = {f"transform__translation__{axis}": value for axis, value in zip("xyz", place)}
            names = {"header__frame_id": parent, "child_frame_id": child, "transform__rotation": turn}
            stamped = self.make("geometry_msgs/msg/TransformStamped", second, **names, **told)
            return bags.make(bags.ROS1, "tf2_msgs/msg/TFMessage", transforms=[stamped])

        def write(self, path, **topics):
            bags.write(path, {f"/{topic}": (told[0].__msgtype__, told) for topic, told in topics.items()})

    return Ros()


def test_a_rosbag_with_scans_and_odometry(tmp_path, ros):
    path = tmp_path / "a.bag"
    ros.write(
        path,
        base_scan=[ros.scan(2.5, [1, np.inf, 0.1]), ros.scan(1.5, [1, 2, 3])],
        odom=[ros.odometry(1, 0.0, 3.0), ros.odometry(2, 1.0, -3.0), ros.odometry(3, 2.0, -3.0)],
    )
    assert is_bag(path)
    assert not is_bag(tmp_path / "a.log")
    found = read_laser_bag(path)
    assert found.times.tolist() == [1.5, 2.5]
    assert found.ranges.tolist() == [[1, 2, 3], [1, np.inf, 0]]
    assert found.angles_rad.tolist() == [-1, 0, 1]
    assert found.max_range_m == 10
    np.testing.assert_allclose(found.odometry, [[0.5, 0, np.pi], [1.5, 0, 2 * np.pi - 3]], atol=1e-6)
    refused("no scan on the topic '/scan'; there are scans on /base_scan", read_laser_bag, path, topic="/scan")


@pytest.mark.parametrize("is_upside_down", [False, True])
def test_a_rosbag_with_odometry_in_transforms_and_a_mounted_scanner(tmp_path, ros, is_upside_down):
    """The base turns on the spot; the scanner stands 0.2 m before it and looks to its left."""
    path, place = tmp_path / "a.bag", (1.0, 2.0, 0.0)
    mount = ros.turn(np.pi / 2, is_upside_down)
    ros.write(
        path,
        scan=[ros.scan(1.5, [1, 2, 3])],
        tf=[
            ros.transform(1, "/odom", "base_link", place, ros.turn(0.0)),
            ros.transform(2, "odom", "/base_link", place, ros.turn(np.pi)),
            ros.transform(2, "map", "odom", (9.0, 9.0, 0.0), ros.turn(1.0)),
        ],
        tf_static=[
            ros.transform(0, "tower", "laser", (0.0, 0.0, 0.3), mount),
            ros.transform(0, "base_link", "tower", (0.2, 0.0, 0.5), ros.turn(0.0)),
            ros.transform(0, "odom", "other", (0.0, 0.0, 0.0), ros.turn(0.0)),
        ],
    )
    found = read_laser_bag(path)
    np.testing.assert_allclose(found.odometry, [[1, 2.2, np.pi / 2]], atol=1e-6)
    np.testing.assert_allclose(found.angles_rad, np.pi / 2 + np.array([-1, 0, 1]), atol=1e-6)
    assert found.ranges.tolist() == [[3, 2, 1] if is_upside_down else [1, 2, 3]]


def test_a_rosbag_whose_transforms_tell_nothing_is_refused(tmp_path, ros):
    level, scans = ros.turn(0.0), [ros.scan(1.5, [1, 2, 3])]
    tilted = dataclasses.replace(level, x=0.3, w=0.95)
    for name, transforms, told in (
        ("a", [("map", "odom", level)], "has no message of the type nav_msgs/Odometry"),
        ("b", [("odom", "one", level), ("odom", "other", level)], "frames in odom are one, other; none .*'laser'"),
        ("c", [("odom", "base", level), ("base", "laser", tilted)], "the scanner 'laser' is tilted"),
    ):
        path = tmp_path / f"{name}.bag"
        ros.write(path, scan=scans, tf=[ros.transform(1, *names, (0.0, 0.0, 0.0), turn) for *names, turn in transforms])
        refused(told, read_laser_bag, path)


# --- errors


def test_errors_of_relations_by_pencil(tmp_path):
    poses = np.array([[0, 0, 0], [1, 0, np.pi / 2], [1, 1, np.pi]])
    path = tmp_path / "a.relations"
    lines = "# t1 t2 x", "100.0 101.04 1 0 0 0 0 1.5707963", "101 102 1.3 0.4 0 0 0 1.0707963", "1 2 0 0 0 0 0 0"
    path.write_text("\n".join(lines))
    known = errors.read_relations(path, np.array([0.0, 1.0, 2.0]), 100.0)
    assert known.ends.tolist() == [[0, 1], [1, 2]]
    place, turn = errors.relation_errors(poses, known)
    np.testing.assert_allclose(place, [0, 0.5], atol=1e-6)
    np.testing.assert_allclose(turn, [0, 0.5], atol=1e-6)
    refused(r"no relation is of two scans within 0.1 s", errors.read_relations, path, np.array([0.0, 1.0, 2.0]), 50.0)
    path.write_text("1 2 3\n")
    refused(r"line 1 must be t1 t2 x y z roll pitch yaw", errors.read_relations, path, np.zeros(1))


def test_a_trajectory_that_is_turned_as_a_whole_has_no_error(log):
    moved = compose(np.broadcast_to(np.array([3.0, -2, 2.5]), log.poses.shape), log.poses)
    assert errors.trajectory_error(moved, log.poses) < 1e-9
    for relations in errors.relations_between(log.poses).values():
        assert np.max(errors.relation_errors(moved, relations)) < 1e-9
    moved[-1, 0] += 0.5
    assert errors.trajectory_error(moved, log.poses) > 0.05


def test_kinds_of_relations():
    poses = np.c_[np.r_[np.arange(0, 4, 0.5), np.arange(4, -0.5, -0.5)], np.zeros((17, 2))]
    known = errors.relations_between(poses)
    assert {"local", "revisit", "global"} == set(known)
    way = np.r_[0, np.cumsum(np.abs(np.diff(poses[:, 0])))]
    for name, low, high in (("local", 0, 5), ("revisit", 5, 99)):
        i, j = known[name].ends.T
        assert (np.abs(poses[j, 0] - poses[i, 0]) <= 1).all()
        assert ((way[j] - way[i] >= low) & (way[j] - way[i] <= high)).all()


# --- the study


@pytest.mark.jit
def test_scans_correct_the_odometry(log):
    done = []
    found = jx.slam(log, closing=False, on_progress=done.append)
    assert done == list(range(1, N + 1))
    assert found.ate_m < min(0.5 * errors.trajectory_error(log.odometry, log.poses), 0.03)
    np.testing.assert_allclose(found.poses[0], log.poses[0])
    assert set(found.errors["relations"]) == {"local", "global"}  # the way is too short for a revisit
    assert (found.errors["place_m"] < 0.04).all()
    lines = found.trajectory().splitlines()
    assert len(lines) == N
    t, x, y, *_, qz, qw = map(float, lines[-1].split())
    np.testing.assert_allclose([t, x, y, 2 * np.arctan2(qz, qw)], [N - 1, *found.poses[-1]], atol=1e-5)
    assert "24 scans" in found.to_markdown()
    assert "without odometry" not in found.to_markdown()
    ambiguous = dataclasses.replace(found, outcomes=np.full(24, Outcome.AMBIGUOUS))
    assert "warning: 24 scans without odometry fit another place" in ambiguous.to_markdown()
    drawn = found.map()
    assert np.asarray(drawn.grid.hits).sum() > 0
    assert len(found.figure().axes) == 2


@pytest.mark.jit
@pytest.mark.slow
def test_a_log_without_odometry_is_matched_by_search(log):
    still = ScanLog(log.poses, np.tile(log.poses[0], (N, 1)), log.ranges, log.angles_rad, log.times, 80.0)
    with pytest.warns(InputWarning, match="23 of 23 steps have no odometry"):
        found = jx.slam(still, closing=False)
    assert found.ate_m < 0.05


@pytest.mark.jit
@pytest.mark.slow
def test_a_loop_is_closed_by_logs_and_in_compiled_programs():
    log, own = drive(90, seed=2, noise=1.5), SlamSettings(close_every_m=0.5)
    found = jx.slam(log, matching=own)
    assert found.loops
    assert found.ate_m < 0.04
    assert len(found.poses) == 90
    assert all(key - other > 5 for key, other in found.loops)

    def step(mapping, scan):
        mapping = put(own, mapping, *scan, scanner, closing=True)
        return mapping, mapping.pose

    scanner, ranges = Scanner(jnp.float32(log.angles_rad), jnp.float32(log.max_range_m)), jnp.float32(log.ranges)
    moved = jnp.float32(between(log.odometry[:-1], log.odometry[1:]))
    mapping = begin(own, Sizes(64, 16, (512, 512, 4096)), ranges[0], np.zeros(3), scanner)
    mapping, poses = jax.jit(lambda *args: jax.lax.scan(step, *args))(mapping, (ranges[1:], moved))
    assert mapping.n_loops == len(found.loops)
    last = compose(found.poses[0], np.array(poses[-1], float))
    np.testing.assert_allclose(last, found.poses[-1], atol=2e-3)


@pytest.mark.jit
@pytest.mark.slow
def test_a_robot_that_stands_still_is_not_without_odometry(log):
    own, scanner = SlamSettings(), Scanner(jnp.float32(log.angles_rad), jnp.float32(log.max_range_m))
    mapping = begin(own, Sizes(4, 1, (512, 512, 4096)), jnp.float32(log.ranges[0]), np.zeros(3), scanner)
    again = put(own, mapping, jnp.full(len(log.angles_rad), jnp.inf), jnp.zeros(3), scanner, closing=False)
    assert again.place.outcome == Outcome.FEW
    np.testing.assert_array_equal(again.pose, np.zeros(3))
    assert again.n_keys == 1


@pytest.mark.jit
@pytest.mark.slow
def test_records_grow_and_maps_follow_the_robot(log, monkeypatch):
    """With room for six key scans at first, and a map of 8 m whose middle the robot leaves."""
    monkeypatch.setattr(mapping_module, "LOG", Sizes(6, 1, (224, 224, 4096)))
    mapper, moved = (
        Mapper(SlamSettings(), log.angles_rad, 80.0, closing=False),
        between(log.odometry[:-1], log.odometry[1:]),
    )
    for i, ranges in enumerate(log.ranges):
        mapper.put(ranges, moved[i - 1] if i else None)
    mapping = mapper.mapping
    assert len(mapping.pose_of) >= mapping.n_keys > 6
    assert np.abs(mapping.points.centre).max() > 1.9
    found = compose(np.broadcast_to(log.poses[0], (N, 3)), mapper.poses())
    assert errors.trajectory_error(found, log.poses) < 0.06


def test_wrong_input_is_told_in_a_line(log, tmp_path):
    for call, told in (
        (lambda: jx.slam("nothing.log"), "there is no such file"),
        (lambda: jx.slam(tmp_path / "a.log", topic="/scan"), "topic is for rosbags"),
        (lambda: jx.slam("a.bag", max_range_m=8), "leave out max_range_m"),
        (lambda: jx.slam(log, matching={"noise_m": -1}), "noise_m must be a number above 0"),
        (lambda: jx.slam(log, matching={"gate_m": 0.5}), "at most 4 min_distance_m"),
        (lambda: jx.slam(log, matching={"noise": 1}), "unknown field of matching"),
    ):
        refused(told, call)


@pytest.mark.jit
def test_the_command_writes_its_files(log, tmp_path, capsys):
    path, out = tmp_path / "a.log", tmp_path / "out"
    path.write_text("\n".join(gmapping_lines(log)))
    assert main(["slam", str(path), "--no-closing", "--out", str(out)]) == 0
    assert {file.name for file in out.iterdir()} == {
        *("trajectory.txt", "map.yaml", "map.pgm", "slam.png", "errors.parquet", "run.json"),
    }
    assert "24 scans" in capsys.readouterr().out
    occupancy, info = read_ros(out / "map.yaml")
    assert info.resolution_m == 0.05
    assert set(np.unique(occupancy)) == {-1, 0, 100}
    record = json.loads((out / "run.json").read_text())
    assert record["ate_m"] < 0.03
    assert main(["slam", str(tmp_path / "b.log"), "--out", str(out), "--overwrite"]) == 2
    assert main(["slam"]) == 2
    assert "expected a log" in capsys.readouterr().err


# --- recorded logs


@pytest.fixture(scope="module")
def folder():
    path = Path(__file__).resolve().parents[2] / "shared" / "logs"
    if not path.is_dir():
        pytest.skip(f"the recorded scans are not there: no folder {path}")
    return path


@pytest.mark.jit
@pytest.mark.slow
@pytest.mark.parametrize(("scans", "closing"), [(None, False), (250, True)])
def test_intel(folder, scans, closing):
    """The whole log without closing loops, and its beginning with 51 loops."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        whole = read_carmen(folder / "intel.gfs.log")
        fields = (array[:scans] for array in (whole.poses, whole.odometry, whole.ranges))
        log = ScanLog(*fields, whole.angles_rad, whole.times[:scans], whole.max_range_m)
        found = jx.slam(log, closing=closing)
    error = found.errors.set_index("relations")["place_m"]
    assert error["local"] < (0.045 if closing else 0.07)
    assert not closing or (found.loops and error["global"] < 0.5)
