"""The report: what the page holds, read by another decoder and by a browser."""

import base64
import html.parser
import io
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from PIL import Image
from ref.browser import assert_alone, data_of, unpacked

from jexplore.report.page.assemble import html_text, script_data
from jexplore.report.page.packing import change, runs
from jexplore.report.page.replay import ReplayData, changes_of, evenly
from jexplore.report.page.report import report_page
from jexplore.report.tables import aligned_table

NASTY = "</script><script>window.ran = 1</script><img src=x onerror=boom()> \"T\" & 'q' {{data}} <!-- ü 通路 \u2028"
SVG = b'<?xml version="1.0"?><svg xmlns="http://www.w3.org/2000/svg"><script>window.ran = 1</script></svg>'


def png(height=2, width=3):
    rng = np.random.default_rng(0)
    file = io.BytesIO()
    Image.fromarray(rng.integers(0, 256, (height, width, 3), dtype=np.uint8)).save(file, format="PNG")
    return file.getvalue()


def replay(n=40, side=20, frames=300, seed=0, **changes):
    """A robot that goes to and fro along a diagonal, in a world of random walls, and random codes of cells."""
    rng = np.random.default_rng(seed)
    rows = 1 + np.abs((np.arange(n + 1) + side - 3) % (2 * side - 6) - (side - 3))
    shown = np.array(evenly(n, frames))
    maps = []
    for _ in shown:
        before = maps[-1] if maps else np.zeros((side, side), np.uint8)
        some = rng.random((side, side)) < 0.05
        maps.append(np.where(some, rng.choice([1, 2, 5, 9, 13], (side, side)), before).astype(np.uint8))
    fields = {
        **{
            "world": "cave",
            "strategy": "closest",
            "which": "seed 0",
            "episode": 0,
            "outcome": "STEP_LIMIT",
            "cell_m": 0.5,
        },
        "truth": rng.random((side, side)) < 0.2,
        "rooms": rng.integers(-1, 40, (side, side)),
        **{"rows": rows, "cols": rows, "steps": shown, "heading_deg": 45 * (shown % 8)},
        "target": np.where(shown[:, None] < n, [[3, 4]], -1),
        "until": np.minimum(shown + 3, n),
        "known_m2": 0.25 * np.arange(len(shown)),
        "changes": tuple(changes_of(maps)),
        "has_own_room": True,
    }
    return ReplayData(**fields | changes)


def many(how_many, **settings):
    return [replay(seed=i, strategy=f"s{i}", **settings) for i in range(how_many)]


# ---- packing


@settings(max_examples=20)
@given(arrays.arrays(np.uint8, (2, 3, 200), elements=st.integers(0, 15)), st.integers(0, 15))
def test_changes_come_back(images, most):
    before, after = np.minimum(images, most)
    image = before.copy()
    change(image, runs(before, after))
    np.testing.assert_array_equal(image, after)


def images_of(raw, sizes, shape):
    """The images that runs of changes lead to, cell by cell."""
    flat, at, out = [0] * (shape[0] * shape[1]), 0, []
    for size in sizes:
        cell, gap, bits = 0, 0, 0
        part, at = list(raw[at : at + int(size)]), at + int(size)
        while part:
            byte = part.pop(0)
            gap, bits = gap + (byte % 128) * 2**bits, bits + 7
            if byte < 128:
                head = part.pop(0)
                cell += gap
                for _ in range(head // 16):
                    flat[cell] = head % 16
                    cell += 1
                gap = bits = 0
        out.append(np.array(flat).reshape(shape))
    return out


def test_what_the_page_holds_is_the_replay():
    one, two = replay(), replay(n=5, side=9, rooms=None, world="maze", seed=1)
    data = data_of(report_page("r", {}, replays=[one, two, one]))
    assert [world["name"] for world in data["worlds"]] == ["cave", "maze"]  # each once
    assert [found["world"] for found in data["replays"]] == [0, 1, 0]
    for want, found in zip((one, two), data["replays"]):
        world = data["worlds"][found["world"]]
        assert (world["shape"], world["cell_m"]) == (list(want.truth.shape), 0.5)
        raw = base64.b64decode(world["truth"])
        np.testing.assert_array_equal(images_of(raw, [len(raw)], world["shape"])[0], want.truth)
        if want.rooms is None:
            assert world["rooms"] is None
        else:
            raw = base64.b64decode(world["rooms"])
            shown = np.where(want.rooms < 0, 0, want.rooms % 15 + 1)
            np.testing.assert_array_equal(images_of(raw, [len(raw)], world["shape"])[0], shown)
        for name in ("steps", "heading_deg", "target", "until"):
            np.testing.assert_array_equal(unpacked(found[name]), getattr(want, name), err_msg=name)
        np.testing.assert_allclose(unpacked(found["known_m2"]), want.known_m2, atol=0.005001)
        maps = images_of(base64.b64decode(found["changes"]), unpacked(found["sizes"]), world["shape"])
        for codes, wanted in zip(maps, want.maps(), strict=True):
            np.testing.assert_array_equal(codes, wanted)
        up, right = np.divmod(np.frombuffer(base64.b64decode(found["moves"]), np.uint8), 3)
        np.testing.assert_array_equal(found["start"][0] + np.cumsum(up.astype(int) - 1), want.rows[1:])
        np.testing.assert_array_equal(found["start"][1] + np.cumsum(right.astype(int) - 1), want.cols[1:])


def test_two_worlds_of_one_name_stay_two():
    data = data_of(report_page("r", {}, replays=[replay(), replay(truth=np.ones((20, 20), bool))]))
    assert [found["world"] for found in data["replays"]] == [0, 1]


def test_fewer_frames_are_the_same_maps():
    full = replay(n=99)
    few = full.thinned(7)
    assert (len(few.steps), few.steps[0], few.steps[-1]) == (7, 0, 99)
    maps = [codes.copy() for codes in full.maps()]
    for codes, step in zip(few.maps(), few.steps, strict=True):
        np.testing.assert_array_equal(codes, maps[int(np.flatnonzero(full.steps == step)[0])])
    np.testing.assert_array_equal(few.until, full.until[np.isin(full.steps, few.steps)])
    assert full.thinned(100) is full
    assert full.thinned(1).steps.tolist() == [99]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"steps": np.arange(41)[::-1]}, "expected steps that increase up to 40, got"),
        ({"steps": np.r_[0, 0, 2:41]}, "expected steps that increase up to 40, got"),
        ({"steps": np.arange(41) - 1}, "expected steps that increase up to 40, got"),
        ({"rows": np.arange(41) * 2}, "expected rows and cols of neighbouring cells, got a jump"),
    ],
)
def test_what_does_not_fit_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        replay(**changes)


# ---- the page


class Reader(html.parser.HTMLParser):
    """Tags with their attributes, text by the innermost open tag, and what a browser would fetch or run."""

    VOID = ("meta", "img", "input", "br")

    def __init__(self, text):
        super().__init__()
        self.tags, self.open, self.text = [], [], {}
        self.feed(text)
        self.close()
        assert self.open == [], "tags that stay open"

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)
            self.text.setdefault(tag, []).append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open:
            self.text[self.open[-1]][-1] += data

    def attributes(self, tag):
        return [attrs for name, attrs in self.tags if name == tag]


def page(text="closest", **changes):
    table = aligned_table(["world", "mean"], [[text, "12.35"], ["b", "-"]], left=["world"])
    given = {
        "title": text,
        "asked": {
            "command": ["jexplore", text],
            "lidar": {"range_m": 4.0, "beams": [1, 2]},
            "note": text,
            "none": None,
        },
        "tables": [(text, table)],
        "figures": [(text, png(), f"alt {text}"), ("plot.svg", SVG, "a plot")],
        "replays": [replay(world=text, strategy=text, which=text, outcome=text), replay(strategy="b", seed=2)],
        "warnings": [f"warning {text}"],
        "notes": [f"note {text}"],
    }
    return report_page(**given | changes)


def test_structure():
    text = page()
    read = Reader(text)
    ids = [attrs["id"] for _, attrs in read.tags if "id" in attrs]
    assert len(ids) == len(set(ids))
    assert {"play", "seek", "speed", "layers", "measure", "world", "known"} <= set(ids)
    for tag in ("canvas", "button", "select"):  # all have a name for those who cannot see them
        for attrs in read.attributes(tag):
            assert attrs.get("aria-label") or attrs.get("title") or tag == "select", attrs


def test_nothing_outside_is_asked_for():
    text = page("run")
    assert text.isascii()
    assert_alone(text, ["data:image/png;", "data:image/svg+xml;"])
    assert "img-src data:" in text


def test_no_text_leaves_its_place():
    tame, nasty = Reader(page()), Reader(page(NASTY))
    assert [tag for tag, _ in nasty.tags] == [tag for tag, _ in tame.tags]
    shown = NASTY.replace("\r", "")
    assert nasty.text["title"] == nasty.text["h1"] == [shown]
    assert nasty.text["td"][0] == " ".join(NASTY.split())
    assert nasty.attributes("img")[0]["alt"] == f"alt {shown}"
    found = data_of(page(NASTY))
    assert (found["worlds"][0]["name"], found["replays"][0]["strategy"]) == (NASTY, NASTY)
    assert html_text("\ud800<") == "&#55296;&lt;"
    assert script_data({"a": "<!--</script>&"}) == '{"a":"\\u003c!--\\u003c/script\\u003e\\u0026"}'


def test_without_replays_figures_or_tables():
    read = Reader(report_page("plain", {}))
    assert read.text["h1"] == ["plain"]
    assert "h2" not in read.text
    assert Reader(report_page("plain", {"seed": 3}, notes=["none kept"])).text["li"] == ["none kept"]
    assert data_of(report_page("plain", {})) == {"worlds": [], "replays": []}


def test_long_tables_and_settings_are_cut_and_say_so():
    table = aligned_table(["n"], [[str(i)] for i in range(1000)], left=[])
    read = Reader(report_page("r", {f"k{i}": "x" * 999 for i in range(300)}, [("t", table)]))
    assert (len(read.text["td"]), len(read.text["dd"])) == (200, 200)
    assert read.text["dd"][0] == "x" * 400 + "…"
    assert read.text["p"] == ["The first 200 of 1000 rows.", "The first 200 of 300 settings."]


def test_what_is_no_picture_is_refused():
    with pytest.raises(ValueError, match=r"expected a.gif as the bytes of a PNG or SVG file, got b'GIF89a'"):
        report_page("r", {}, figures=[("a.gif", b"GIF89a", "")])


def test_the_page_keeps_to_its_size_and_says_how():
    replays = many(4, n=200, side=40)
    whole = report_page("r", {}, replays=replays)
    assert "li" not in Reader(whole).text
    fewer = report_page("r", {}, replays=replays, max_bytes=len(whole) - 1)
    assert Reader(fewer).text["li"] == ["To keep the page small, replays have at most 150 frames."]
    assert [len(unpacked(found["steps"])) for found in data_of(fewer)["replays"]] == [150] * 4
    bare = report_page("r", {}, notes=["x" * 200])
    room = len(bare) + (len(report_page("r", {}, replays=[replays[0].thinned(60)])) - len(report_page("r", {})))
    tight = report_page("r", {}, replays=replays, max_bytes=room)
    assert len(tight) <= room
    assert [found["strategy"] for found in data_of(tight)["replays"]] == ["s0"]
    assert Reader(tight).text["li"][0] == "To keep the page small, the last 3 of 4 replays are left out."
    with pytest.raises(ValueError, match=r"expected a page of at most 1000 bytes, got [0-9]+ without any replay"):
        report_page("r", {}, replays=replays, max_bytes=1000)


# ---- in a browser

SCENARIO = """
<script>
const seen = {ran: window.ran ?? 0, playing: replay.state().playing}, note = (name) => { seen[name] = replay.state(); };
const canvases = document.querySelectorAll("#tiles canvas"), id = (name) => document.getElementById(name);
const key = (key, more) => canvases[0].dispatchEvent(new KeyboardEvent("keydown", {key, bubbles: true, ...more}));
const wait = (ms) => new Promise((done) => setTimeout(done, ms));
const pick = (name, value) => { id(name).value = value; id(name).dispatchEvent(new Event("change")); };
const codes = (i) => replay.codes(i).join("");
const captions = () => [...document.querySelectorAll("#tiles figure:not([hidden]) .now")].map((now) => now.textContent);
(async () => {
  note("hash");
  seen.options = [...document.querySelectorAll("#world option")].map((option) => option.textContent);
  pick("world", -1); note("all");
  pick("measure", "steps");
  replay.seek(0); seen.codes0 = codes(0);
  replay.seek(30); note("thirty"); seen.codes30 = codes(0); seen.other30 = codes(1);
  seen.captions = captions();
  replay.seek(7); seen.codes7 = codes(0);
  key("ArrowRight"); note("right"); key("ArrowLeft"); note("left"); key("End"); note("end"); key("Home"); note("home");
  key("ArrowRight", {shiftKey: true}); note("second");
  document.body.dispatchEvent(new KeyboardEvent("keydown", {key: "End", bubbles: true})); note("elsewhere");
  key(" "); note("started"); await wait(2000); note("later"); key(" "); note("paused");
  replay.seek(40); seen.over = captions();
  for (const box of document.querySelectorAll("#layers input")) box.click();
  await wait(50); note("layers");
  for (const box of document.querySelectorAll("#layers input")) box.click();
  key("+"); await wait(50); note("zoomed"); key("w"); await wait(50); note("whole");
  document.querySelectorAll("#tiles button")[1].click(); await wait(50); note("large");
  key("Escape"); await wait(50); note("small");
  id("theme").click(); await wait(50);
  pick("measure", "metres"); location.hash = "#t=0.25"; await wait(50); note("quarter");
  const pen = canvases[0].getContext("2d"), {width, height} = canvases[0];
  seen.colours = new Set(new Uint32Array(pen.getImageData(0, 0, width, height).data.buffer)).size;
  seen.bold = document.querySelectorAll("#tiles b, #tiles script, #tiles img").length;
  document.body.dataset.test = JSON.stringify(seen);
})();
</script>
"""


def joined(codes):
    return "".join(map(str, codes.ravel().tolist()))


@pytest.mark.slow
def test_it_replays_in_a_browser(body):
    nasty = NASTY.replace("\u2028", "")
    one, other = (
        replay(world=nasty, strategy=nasty),
        replay(world=nasty, strategy="b", seed=2, n=20, truth=replay().truth),
    )
    text = page(nasty, replays=[one, other, replay(world="maze", strategy="b", seed=3)])
    seen = json.loads(body(text, "#t=0.5", SCENARIO)["test"])
    frames = {name: value["frame"] for name, value in seen.items() if isinstance(value, dict)}
    assert (seen["ran"], seen["playing"], seen["bold"]) == (0, False, 0)
    assert (frames["hash"], seen["hash"]["frames"], seen["hash"]["measure"]) == (20, 41, "metres")
    assert [tile["strategy"] for tile in seen["hash"]["tiles"]] == [nasty, "b"]  # of the first world
    assert len(seen["all"]["tiles"]) == 3
    assert seen["options"] == ["all", nasty, "maze"]
    assert [tile["step"] for tile in seen["thirty"]["tiles"]] == [30, 20, 30]  # the second one is over by then
    maps, others = [codes.copy() for codes in one.maps()], [codes.copy() for codes in other.maps()]
    assert [seen[f"codes{i}"] for i in (0, 30, 7)] == [joined(maps[i]) for i in (0, 30, 7)]
    assert seen["other30"] == joined(others[-1])
    # 30 diagonal steps of half a metre are 21.2 m, 40 are 28.3 m
    assert seen["captions"][0] == "21.2 of 28.3 m · step 30 of 40 · 7.5 m² known"
    assert seen["captions"][1] == "14.1 m · 20 steps · 5.0 m² known · step limit"
    assert [frames[name] for name in ("right", "left", "end", "home", "elsewhere")] == [8, 7, 40, 0, 2]
    assert frames["second"] == 2  # 40 steps in 30 seconds
    assert seen["started"]["playing"]
    assert 3 <= frames["later"] <= 6
    assert not seen["paused"]["playing"]
    assert seen["over"][0] == "28.3 m · 40 steps · 10.0 m² known · step limit"
    assert seen["layers"]["layers"] == {name: not on for name, on in seen["hash"]["layers"].items()}
    assert seen["hash"]["layers"]["rooms"] is False
    assert seen["hash"]["layers"]["own"] is True
    kinds = [{tile["view"]["kind"] for tile in seen[name]["tiles"]} for name in ("hash", "zoomed", "whole")]
    assert kinds == [{"whole"}, {"free"}, {"whole"}]
    assert [len(seen[name]["tiles"]) for name in ("large", "small")] == [1, 3]
    assert frames["quarter"] == 10
    assert seen["colours"] > 5


EPISODES = """
<script>
const id = (name) => document.getElementById(name), seen = [replay.state().tiles.length];
seen.push([...document.querySelectorAll("#episode option")].map((option) => option.textContent).join());
const pick = (name, value) => { id(name).value = value; id(name).dispatchEvent(new Event("change")); };
pick("episode", 4); seen.push(replay.state().tiles.map((tile) => tile.step), replay.state().frames);
pick("world", 1); seen.push(replay.state().tiles.length, replay.state().frames);
pick("episode", 0); seen.push(replay.state().tiles.length, id("episodebox").hidden);
document.body.dataset.test = JSON.stringify(seen);
</script>
"""


@pytest.mark.slow
def test_a_reader_chooses_the_episode(body):
    """In the second world only episode 0 is there: another one shows nothing, and does not fail."""
    plan = replay().truth
    shown = [replay(truth=plan, strategy=name, world=world) for world in ("cave", "maze") for name in "ab"]
    later = [replay(n=n, truth=plan, strategy=name, episode=4) for n, name in ((5, "a"), (3, "b"))]
    text = report_page("r", {}, replays=[*shown, *later])
    assert json.loads(body(text, scenario=EPISODES)["test"]) == [2, "0,4", [0, 0], 6, 0, 1, 2, False]


@pytest.mark.slow
def test_one_frame_opens_too(body):
    still = replay(n=0)
    assert json.loads(body(report_page("r", {}, replays=[still]), "#t=1")["state"])["frames"] == 1
    body(report_page("r", {}))
