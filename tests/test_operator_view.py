"""The operator's view: what the page holds, read by another decoder and by a browser."""

import html
import json
import re

import numpy as np
import pytest
from ref.browser import assert_alone, data_of, unpacked

from jexplore.report.operator_view import RunRecording, page
from jexplore.tracemap.record import NOWHERE, BtmMap, Link, Node

N, B = 60, 19
WALLS = np.array(
    [[0, -1, 8, -1], [0, 1, 8, 1], [0, -1, 0, 1], [8, -1, 8, -4], [8, 1, 8, 4], [10, -4, 10, 4]], dtype=float
)
# The last half a character stays out of the nodes: a browser that dumps it to a file dies.
NASTY = "</script><script>boom()</script> \"T\" & 'q' {{data}} <!-- straße 通路 \u2028 \ud800"


def scan(pose, angles):
    """Ranges to the walls, infinite where a beam meets none: each beam is solved against each wall."""
    ranges = np.full(len(angles), np.inf)
    for beam, angle in enumerate(pose[2] + angles):
        for x0, y0, x1, y1 in WALLS:
            matrix = np.array([[np.cos(angle), x0 - x1], [np.sin(angle), y0 - y1]])
            if abs(np.linalg.det(matrix)) > 1e-9:
                along, part = np.linalg.solve(matrix, [x0 - pose[0], y0 - pose[1]])
                if along > 0 and 0 <= part <= 1:
                    ranges[beam] = min(ranges[beam], along)
    return ranges


def recording(**changes):
    """A robot in a corridor that ends at a T: frames 0.1 s apart, nodes at 0, 30 and 50, odometry that drifts."""
    x = np.linspace(1, 9, N)
    pose = np.stack([x, 0 * x, 0 * x], axis=1)
    angles = np.linspace(-1.5, 1.5, B)
    triangles = np.full((N, 3, 3, 2), np.nan)
    triangles[20:50, 0] = [[1, 1], [1, -1], [3, 0]]
    triangles[20:50, 2] = [[1, 1], [3, 0], [3, 2]]
    target = np.stack([x + 1, 0 * x], axis=1)
    target[-5:] = np.nan
    frame = np.arange(N)
    nodes = (
        Node(id=0, x_m=1.0, y_m=0.0, type="terminal"),
        Node(4, 5.1, 0.0, "obstacle", "slope", inclination_deg=10.5, attributes={"v": NASTY[:-1]}),
        Node(id=7, x_m=7.8, y_m=0.1, type="divergence", posture_deg=float("nan")),
    )
    links = (
        Link(id=0, start=0, end=4, status="searched", start_bearing_deg=0, end_bearing_deg=180, length_m=4.1),
        Link(1, 4, 7, "searched", 10, 180, min_width_m=1.9, attributes={"moved": (4.0123456, -0.5, 1e-7)}),
        Link(id=2, start=7, end=NOWHERE, status="un-searched", start_bearing_deg=270),
    )
    fields = {
        "title": "Corridor and T",
        "dt_s": 0.1,
        "mode_names": ("central_run", "wall_following", "branch_selection"),
        "walls_m": WALLS,
        "goal_m": (9.0, 3.5),
        "angles_rad": angles,
        "time_s": frame * 0.1,
        "pose": pose,
        "estimate": pose * [1.01, 1, 1] + [0, 0.001, 0],
        "mode": np.repeat([0, 1, 2], N // 3),
        "target_m": target,
        "ranges_m": np.stack([scan(row, angles) for row in pose]),
        "triangles_m": triangles,
        "chosen": np.where((frame >= 20) & (frame < 50), 2, -1),
        "pitch_deg": np.where(frame > 40, -10.25, 0.5),
        "roll_deg": np.where(frame > 40, np.nan, 0.0),
        "n_nodes": 1 + (frame >= 30) + (frame >= 50),
        "n_links": 1 + (frame >= 30) + (frame >= 50),
        "link_searched_frame": np.array([30, 50, N]),
        "votes": frame % 9,
        "left_m": np.where(frame > 50, np.inf, 1.0),
        "right_m": np.full(N, 1.234),
        "map": BtmMap(nodes, links),
    }
    return RunRecording(**fields | changes)


def test_arrays_come_back():
    run = recording()
    arrays = {name: unpacked(packed) for name, packed in data_of(page(run))["arrays"].items()}
    for name in ("time_s", "pose", "estimate", "walls_m"):
        np.testing.assert_allclose(arrays[name], getattr(run, name), atol=0.0005001, err_msg=name)
    for name in ("target_m", "ranges_m", "left_m", "right_m", "pitch_deg", "roll_deg"):  # NaN and infinity as they were
        np.testing.assert_allclose(arrays[name], getattr(run, name), atol=0.005001, err_msg=name)
    np.testing.assert_allclose(arrays["angles_rad"], run.angles_rad, atol=0.00005001)
    for name in ("mode", "n_nodes", "n_links", "link_searched_frame", "votes"):
        np.testing.assert_array_equal(arrays[name], getattr(run, name), err_msg=name)
    assert np.isinf(arrays["ranges_m"]).any()
    assert np.isnan(arrays["target_m"][-1]).all()


def test_triangles_lie_end_to_end_without_the_missing():
    arrays = {name: unpacked(packed) for name, packed in data_of(page(recording()))["arrays"].items()}
    np.testing.assert_array_equal(arrays["n_triangles"], [0] * 20 + [2] * 30 + [0] * 10)
    np.testing.assert_array_equal(arrays["chosen"], [-1] * 20 + [1] * 30 + [-1] * 10)
    assert arrays["triangles_m"].shape == (60, 3, 2)
    np.testing.assert_allclose(arrays["triangles_m"][0], [[1, 1], [1, -1], [3, 0]])
    np.testing.assert_allclose(arrays["triangles_m"][-1], [[1, 1], [3, 0], [3, 2]])


def test_no_text_leaves_its_place():
    plain, nasty = page(recording()), page(recording(title=NASTY, mode_names=(NASTY, "a", "b")))
    assert nasty.isascii()
    data = data_of(nasty)
    assert data["title"] == data["mode_names"][0] == NASTY
    for tag in ("<script", "</script", "<!--", "<title", "<h1"):
        assert nasty.count(tag) == plain.count(tag), tag
    (title,) = re.findall(r"<title>(.*?)</title>", nasty)
    (hint,) = re.findall(r'<h1 title="(.*?)">', nasty)
    assert title == hint
    assert '"' not in title
    assert html.unescape(title) == html.unescape("&#55296;").join(NASTY.split("\ud800"))
    assert len(data_of(page(recording(title="\\1 \\g<0>")))["arrays"]) == len(data["arrays"])


def test_nothing_outside_is_asked_for():
    assert_alone(page(recording(title="run")))


SCENARIO = """
<script>
const seen = {}, note = (name) => { seen[name] = replay.state(); };
const key = (key, more) => document.body.dispatchEvent(new KeyboardEvent("keydown", {key, bubbles: true, ...more}));
const wait = (ms) => new Promise((done) => setTimeout(done, ms));
const text = (id) => document.getElementById(id).textContent;
(async () => {
  note("hash");
  key("ArrowRight"); note("right"); key("ArrowLeft", {shiftKey: true}); note("second");
  key("End"); note("end"); key("Home"); note("home");
  replay.seek(1e9); note("far"); replay.seek(-3); note("near");
  replay.seek(55); seen.open = text("now-left"); seen.clear = text("now-right");
  seen.pitch = text("pitch"); seen.big = text("mode");
  seen.speed = text("now-speed"); seen.roll = text("roll");
  seen.links = [...document.querySelectorAll("#links tbody tr")].map((row) => row.cells[1].textContent);
  seen.moved = document.querySelectorAll("#links tbody tr")[1].cells[4].textContent;
  seen.notes = document.querySelectorAll("#nodes tbody tr")[1].cells[4].textContent;
  document.querySelectorAll("#nodes tbody button")[1].click(); note("picked");
  seen.rows = document.querySelectorAll("#nodes tbody tr").length;
  seen.linksThen = [...document.querySelectorAll("#links tbody tr")].map((row) => row.cells[1].textContent);
  key("Escape"); key("w"); note("whole");
  for (const box of document.querySelectorAll("#layers input")) box.click();
  await wait(50); note("layers");
  for (const box of document.querySelectorAll("#layers input")) box.click();
  document.getElementById("view").dispatchEvent(new WheelEvent("wheel", {deltaY: -100, cancelable: true}));
  await wait(50); note("zoomed");
  document.getElementById("theme").click();
  replay.seek(10); key(" "); note("started"); await wait(1500); note("later"); replay.pause(); note("paused");
  replay.setSpeed(8); replay.play(); await wait(3000); note("over");
  location.hash = "#frame=7"; await wait(50); note("again");
  seen.canvas = new Set(document.getElementById("view").getContext("2d").getImageData(0, 0, 400, 300).data).size;
  document.body.dataset.test = JSON.stringify(seen);
})();
</script>
"""


def test_it_replays_in_a_browser(body):
    found = body(page(recording(title=NASTY)), "#frame=20", SCENARIO)
    seen = json.loads(found["test"])
    frames = {name: value["frame"] for name, value in seen.items() if isinstance(value, dict)}
    assert frames["hash"] == 20
    assert (seen["hash"]["frames"], seen["hash"]["mode"], seen["hash"]["time_s"]) == (N, "wall_following", 2)
    assert [frames[name] for name in ("right", "second", "end", "home", "far", "near")] == [21, 11, 59, 0, 59, 0]
    assert (seen["open"], seen["clear"], seen["pitch"]) == ("open", "1.23 m", "−10.3°")
    assert (seen["big"], seen["speed"], seen["roll"]) == ("branch selection", "1.37 m/s", "–")
    assert seen["links"] == ["0 → 4", "4 → 7", "7 → ?"]
    assert "moved: 4.01 -0.5 1e-7" in seen["moved"]
    assert seen["notes"].startswith("slope, 10.5°, v: </script>")
    assert (frames["picked"], seen["picked"]["picked"], seen["rows"]) == (30, 4, 2)
    assert seen["linksThen"] == ["0 → 4", "4 → ?"]
    assert (seen["whole"]["view"], seen["whole"]["picked"], seen["zoomed"]["view"]) == ("whole", None, "free")
    assert [seen["layers"]["layers"][name] for name in ("building", "truth", "align")] == [False, False, True]
    assert seen["zoomed"]["layers"] == seen["hash"]["layers"]
    assert seen["started"]["playing"]
    assert 23 <= frames["later"] <= 26
    assert not seen["paused"]["playing"]
    assert (frames["over"], seen["over"]["playing"], frames["again"]) == (59, False, 7)
    assert seen["canvas"] > 10
    assert json.loads(found["state"])["frame"] == 7


@pytest.mark.slow
def test_one_frame_and_an_empty_map_open_too(body):
    run = recording()
    one = {name: value[:1] for name, value in vars(run).items() if np.shape(value)[:1] == (N,)}
    one |= {"map": BtmMap((), ()), "link_searched_frame": np.zeros(0, int), "n_nodes": np.zeros(1, int)}
    one |= {"n_links": np.zeros(1, int), "estimate": run.pose[:1], "goal_m": None, "walls_m": np.zeros((0, 4))}
    one |= {"ranges_m": np.zeros((1, 0)), "angles_rad": np.zeros(0), "triangles_m": np.zeros((1, 0, 3, 2))}
    found = body(page(recording(**one)), "#frame=x")
    assert json.loads(found["state"])["frames"] == 1
    assert not json.loads(found["state"])["drifts"]


@pytest.mark.slow
def test_an_error_in_the_page_would_show(body):
    with pytest.raises(AssertionError, match="missing is not defined"):
        body(page(recording()).replace("time.fromHash();", "time.fromHash(); missing();"))
