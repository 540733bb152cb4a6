"""Effects of drift on maps: true positions of nodes, summaries, and the bytes of maps."""

import dataclasses
import math

import numpy as np
import pandas as pd
import pytest
from parts.drift.odometry_map import odometry_map
from parts.drift.storage import packed_map
from parts.drift.study import drift, placed_truly, summarised
from ref.refusals import refused

import jexplore as jx
from jexplore.driving.batch import Driven
from jexplore.driving.settings import Noise
from jexplore.tracemap.record import BtmMap, Link, Node

NODES = (
    Node(0, 1.0, 0.0, "terminal"),
    Node(1, 4.2, 0.0, "divergence"),
    Node(2, 4.2, 3.0, "obstacle", "stairs", step_m=0.1),
)
LINKS = (
    Link(0, 0, 1, "searched", 0.0, 180.0, 3.2, 2.0),
    Link(1, 1, -1, "un-searched", 90.0),
    Link(2, 1, 2, "searched", 90.0, 270.0, 3.0, 2.0, attributes={"blocked": True}),
)
MAP = BtmMap(NODES, LINKS)


def way_of(truth, estimate):
    n = len(truth)
    return Driven(np.float32(truth), np.float32(estimate), np.zeros(n, np.int32), np.zeros(n, np.float32))


def test_where_nodes_truly_lie():
    """The robot has turned by a quarter without noticing: what it has ahead on +x lies on +y."""
    way = way_of([[1, 0, 0], [1, 3, math.pi / 2], [1, 3.2, math.pi / 2]], [[1, 0, 0], [4, 0, 0], [4.2, 0, 0]])
    found = placed_truly(BtmMap(NODES[:2], LINKS[:2]), np.array([[11.0, 5.0], [11.0, 8.0]]), way, (10.0, 5.0))
    assert (found.nodes[0].x_m, found.nodes[0].y_m) == pytest.approx((1.0, 0.0))
    # Node 1 lies at 4.2 in the world's frame; the robot took itself to be at (14, 5) there and was at (11, 8).
    assert (found.nodes[1].x_m, found.nodes[1].y_m) == pytest.approx((11 + 5.0, 8 - 9.8))
    assert found.links[0].start_bearing_deg == 0.0
    assert found.links[0].end_bearing_deg == pytest.approx(270.0)
    assert found.links[1].start_bearing_deg == pytest.approx(180.0)


def test_without_drift_nodes_lie_where_they_are():
    way = way_of(*[np.random.default_rng(0).uniform(0, 9, (20, 3))] * 2)
    found = placed_truly(MAP, way.truth[[3, 7, 11], :2].astype(float), way)
    for one, other in zip(found.nodes, MAP.nodes):
        assert (one.x_m, one.y_m) == pytest.approx((other.x_m, other.y_m), abs=1e-5)


def table():
    """Two errors: 4 runs of the study's own noise, 4 with more slip, 2 with a bias."""
    rows = [(0.02, 0.0, True)] * 4 + [(0.3, 0.0, True)] * 3 + [(0.3, 0.0, False)] + [(0.02, 3.0, None)] * 2
    found = pd.DataFrame(rows, columns=["noise.slip", "noise.heading_bias_deg_m", "true"])
    found["true"] = found["true"].astype("boolean")
    off = [0.0, 0.1, 0.2, 0.3, 1.0, 1.0, 1.0, 5.0, 2.0, np.nan]
    return found.assign(node_error_m=off, on_wall=0.9, doubled=0.1)


AXES = {"slip": [0.02, 0.3], "heading_bias_deg_m": [0.0, 3.0]}


def test_what_is_summed_up():
    found = summarised(table(), AXES, Noise())
    assert found["error"].tolist() == ["slip"] * 2 + ["heading_bias_deg_m"] * 2
    assert found["n"].tolist() == [4, 4, 4, 2]
    assert found["true"].tolist()[:3] == [1.0, 0.75, 1.0]
    assert np.isnan(found["true"][3])
    # Wilson's interval of 3 in 4, by its formula.
    z, n, p = 1.959964, 4, 0.75
    half = z / (1 + z * z / n) * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    assert found["true_low"][1] == pytest.approx(middle - half, abs=1e-5)
    assert found["true_high"][1] == pytest.approx(middle + half, abs=1e-5)
    assert found["node_error_m"].tolist() == pytest.approx([0.15, 1.0, 0.15, 2.0])
    assert found["node_error_m_high"][1] == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"axes": {}}, "axes must name an error or more"),
        ({"axes": {"drift": [1.0]}}, "axes must be errors of jx.btm.Noise, .*, got 'drift'"),
        ({"axes": {"slip": []}}, "slip must have a value or more"),
        ({"axes": {"slip": [0.9]}}, "noise.slip must be"),
    ],
)
def test_what_cannot_be_asked(options, says):
    refused(says, drift, **options)


@pytest.mark.slow
@pytest.mark.jit
def test_a_study_is_runs_of_traces(tmp_path):
    """Runs of the study's own noise are those of `trace`; more slip leaves the first steps alike and then does not."""
    noise, options = Noise(range_m=0.01), {"max_steps": 150, "seed": 3}
    found = drift(axes={"slip": [0.4]}, runs=2, noise=noise, **options)
    alone = jx.btm.trace("course", runs=2, noise=noise, **options)
    assert found.axes == {"slip": [0.02, 0.4]}
    assert found.runs["noise.slip"].tolist() == [0.02, 0.02, 0.4, 0.4]
    own = found.runs[:2]
    for name in ("path_m", "drift_m", "code", "nodes"):
        assert own[name].tolist() == alone.table[name].tolist()
    assert (found.runs["on_wall"] > 0.9).all()
    assert found.example is None
    assert len(found.figure().axes) == 3
    assert odometry_map(alone.scans(), found.plan.world).on_wall > 0.9


def test_bytes_of_a_packed_map():
    """8 bytes a node, 16 a link."""
    data = packed_map(MAP)
    assert len(data) == 3 * 8 + 3 * 16
    nodes, links = data[:24], data[24:]
    assert np.frombuffer(nodes[8:12], "<i2").tolist() == [320, 0]
    assert nodes[16 + 4 :] == bytes([3 + 4, 255, 10, 255])  # stairs, no inclination, 10 cm, no posture
    assert np.frombuffer(links[16:20], "<i2").tolist() == [1, -1]
    assert links[32 + 4] == 1 + 2  # searched, blocked
    assert np.frombuffer(links[5:11], "<i2").tolist() == [0, 180, 320]
    assert packed_map(BtmMap((), ())) == b""
    far = dataclasses.replace(NODES[1], x_m=9999.0)
    assert np.frombuffer(packed_map(BtmMap((NODES[0], far), ()))[8:10], "<i2").tolist() == [32767]
