"""The station's page: its content, its script compared with the rules of `passable` and `routes`, and its use."""

import dataclasses
import html
import json
import math
import random
import re

import pytest
from ref import browser
from ref.browser import assert_alone, data_of
from ref.traces import FIRST, GOOD, SECOND, chain, node, stub, way

import jexplore as jx
from jexplore.cli.main import main
from jexplore.driving.settings import ROBOTS
from jexplore.report.page.assemble import assembled
from jexplore.studies.traces import routes
from jexplore.studies.traces.station import GLOBAL_MAP, panels_of
from jexplore.tracemap import json_form
from jexplore.tracemap.merging.merge import merge_maps
from jexplore.tracemap.merging.rigid import Move, moved_map
from jexplore.tracemap.passable import hindrances, refusals
from jexplore.tracemap.record import NODE_TYPES, NOWHERE, OBSTACLE_SHAPES, BtmMap, Link, Node, check_map

# The last half a character stays out of the maps: a browser that dumps it to a file dies.
NASTY = "</script><script>boom()</script> \"T\" & 'q' {{data}} <!-- straße 通路 \u2028"
THERE = moved_map(SECOND, Move(2.0, -1.0, 90.0))
BLOCKED = "blocked: no measures of who could not pass; blocked set to false lifts it"
# A square, 0 below left, 1 right, 2 above, 3 above left, with a short cut from 0 to 2 over a step: link 4.
SQUARE = BtmMap(
    (
        node(0, "T", 0, 0, attributes={"victim": True, "radio_dbm": -61}),
        node(1, "D", 5, 0),
        node(2, "D", 5, 5, attributes={"note": NASTY, "__proto__": {"x_m": NASTY}, "constructor": NASTY}),
        node(3, "O", 0, 5, obstacle="stairs", step_m=0.1),
    ),
    (
        way(0, 0, 1, 0, **GOOD),
        way(1, 1, 2, 90, **GOOD),
        way(2, 2, 3, 180, **GOOD),
        way(3, 3, 0, 270, **(GOOD | {"length_m": None, "max_roll_deg": None, "attributes": {"blocked": True}})),
        way(4, 0, 2, 45, **(GOOD | {"length_m": 7.0, "max_step_m": 0.15})),
        stub(5, 2, 0, opening_m=0.8),
    ),
)


def panel_of(btm):
    return data_of(jx.btm.station([btm]))["panels"][0]


# By pencil


def test_the_page_holds_what_the_map_says():
    data = data_of(jx.btm.station([SQUARE], ["scout"], title="Third floor"))
    assert data["writers"] == ["scout"]
    assert data["robots"][1] == {"name": "wheeled", "width_m": 0.39, "max_step_m": 0.03, "max_slope_deg": 5.0}
    (panel,) = data["panels"]
    assert (panel["name"], panel["maps"], panel["note"]) == ("scout", ["scout"], "")
    corner = panel["nodes"][0]
    assert corner["attributes"] == {"victim": True, "radio_dbm": -61}
    assert (corner["from"], corner["bearings_deg"], corner["angles_deg"]) == ({"scout": 0}, [0, 45, 90], [45, 45, 270])
    assert panel["nodes"][2]["attributes"]["note"] == NASTY
    third, last = panel["links"][3], panel["links"][5]
    assert (third["metres"], third["length_mm"], third["blocked"]) == (5.0, 5000, True)
    assert third["doubts"] == ["roll unknown", "length unknown, 5.00 m in a straight line"]
    assert third["called"] == "link 3 (nodes 3 to 0)"
    assert (last["end"], last["metres"], last["length_mm"], last["opening_m"]) == (NOWHERE, None, None, 0.8)


def test_maps_that_fit_are_one_and_others_stand_apart():
    apart = chain("TDFDT", [(1, 90)])
    panels, said = panels_of([FIRST, THERE, apart], ["a", "b", "c"])
    assert [(panel.name, panel.maps) for panel in panels] == [(GLOBAL_MAP, ("a", "b")), ("c", ("c",))]
    assert panels[0].map == merge_maps([FIRST, THERE], ["a", "b"]).map
    assert panels[0].note == "In the frame of a."
    assert panels[1].map == check_map(apart)
    assert panels[1].note == "Stands apart: it has not enough in common with the other maps."
    assert said == ["node 3: victim is True in a and False in b"]
    nodes = panel_of(merge_maps([FIRST, THERE], ["a", "b"]).map)["nodes"]
    told = [{"from": ["a"], "value": True}, {"from": ["b"], "value": False}]
    assert (nodes[3]["attributes"], nodes[3]["conflicts"]) == ({}, {"victim": told})


def test_maps_none_of_which_fits_stand_each_alone():
    panels, said = panels_of([chain("TDT"), FIRST], ["a", "b"])
    assert [(panel.name, panel.map) for panel in panels] == [("a", check_map(chain("TDT"))), ("b", check_map(FIRST))]
    assert {panel.note for panel in panels} == {"Stands apart: no two of the maps have enough in common."}
    assert said == []
    ring = BtmMap(  # looks the same after half a turn
        (node(0, "D", 0, 0), node(1, "F", 7, 0), node(2, "D", 7, 4), node(3, "F", 0, 4)),
        (way(0, 0, 1, 0, length_m=7.0), way(1, 1, 2, 90, length_m=4.0), way(2, 2, 3, 180, length_m=7.0),
         way(3, 3, 0, 270, length_m=4.0), stub(4, 0, 180), stub(5, 2, 0)),
    )  # fmt: skip
    panels, _ = panels_of([ring, moved_map(ring, Move(1.0))])
    assert {panel.note for panel in panels} == {
        "Stands apart: the maps could be laid on each other in more than one way."
    }


def test_those_left_apart_are_merged_among_themselves():
    other = BtmMap(
        (node(0, "O", 0, 0, obstacle="slope", inclination_deg=20.0), node(1, "F", 3, 0), node(2, "D", 3, 7.5)),
        (way(0, 0, 1, 0, length_m=3.0), way(1, 1, 2, 60, length_m=7.5), stub(2, 2, 10), stub(3, 1, 300),
         stub(4, 0, 130)),
    )  # fmt: skip
    again = moved_map(other, Move(1.0, 2.0, 30.0))
    panels, _ = panels_of([FIRST, other, THERE, again], ["a", "b", "c", "d"])
    assert [panel.maps for panel in panels] == [("a", "c"), ("b", "d")]
    assert panels[1].name == "b and d"
    assert panels[1].note == ("Stands apart: it has not enough in common with the other maps. In the frame of b.")


def test_a_merged_map_says_whom_it_is_of():
    merged = merge_maps([FIRST, THERE], ["a", "b"]).map
    data = data_of(jx.btm.station([merged], ["global"]))
    assert data["writers"] == ["a", "b"]
    assert data["panels"][0]["nodes"][1]["from"] == {"a": 1, "b": 8}
    assert data["notes"] == ["node 3: victim is True in a and False in b"]


def test_no_text_leaves_its_place():
    few, nasty = jx.btm.station([chain("TDT")], ["a"]), jx.btm.station([SQUARE], [NASTY + "\ud800"])
    assert nasty.isascii()
    assert data_of(nasty)["writers"] == [NASTY + "\ud800"]
    for tag in ("<script", "</script", "<!--", "<title", "<h1"):
        assert nasty.count(tag) == few.count(tag), tag
    (title,) = re.findall(r"<title>(.*?)</title>", nasty)
    assert '"' not in title
    assert html.unescape(title).startswith(f"Station: {NASTY}")


def test_nothing_outside_is_asked_for():
    assert_alone(jx.btm.station([FIRST, THERE]))


# The script compared with the rules in Python

OWN = dataclasses.replace(ROBOTS["kamui"], name="own robot", width_m=0.7, max_step_m=0.125, max_slope_deg=17.5)
# Ways from 0 to 3 over 1 and over 2 are as long and have as many links; 1 cannot be passed by all. At 2 the way back
# and a stub leave in one direction, at 3 two stubs do.
DIAMOND = BtmMap(
    (node(0), node(1, "O", 3, 4, obstacle="stairs", step_m=0.1), node(2, "D", 3, -4), node(3, "D", 6, 0)),
    (
        *(way(0, 0, 1, 53, **GOOD), way(1, 1, 3, 307, **GOOD), way(2, 0, 2, 307, **GOOD), way(3, 2, 3, 53, **GOOD)),
        *(stub(4, 2, 127), stub(5, 3, 90), stub(6, 3, 90 + 1e-9)),
    ),
)
ANSWER = """
function answer({panels, robots, numbers}) {
  return {
    numbers: numbers.map(([value, digits]) => general(value, digits)),
    uses: panels.map((panel) => robots.map((robot) => [false, true].map((known) => {
      const use = useOf(makeMap(panel), robot, known);
      return [[...use.refused], [...use.barriers]];
    }))),
    routes: panels.map((panel) => robots.map((robot) => [false, true].map((known) => {
      const map = makeMap(panel), use = useOf(map, robot, known);
      return panel.pairs.map(([start, end]) => routeOf(map, use, start, end));
    }))),
  };
}
"""


def block(rng, near):
    """That a link is blocked, or not, for a robot at, near or far from those that ask, or for nobody known."""
    who = {"name": "scout", "width_m": near(0.39, 0.7), "max_step_m": near(0.03, 0.2), "max_slope_deg": near(5.0, 45.0)}
    said = {"blocked_for": rng.choice([who, who, "scout"])} if rng.random() < 0.7 else {"found_by": "scout"}
    told = {"blocked": rng.choice([True, True, False, [], "yes"]), **said}
    if rng.random() < 0.4:  # another map says otherwise
        others = {"blocked": rng.choice([True, False]), "blocked_for": rng.choice([None, {**who, "name": "other"}])}
        names = [name for name in others if name in told and rng.random() < 0.6]
        told["conflicts"] = {
            name: [{"from": ["a"], "value": told.pop(name)}, {"from": ["b"], "value": others[name]}] for name in names
        }
    return told


def random_map(rng):
    """Up to seven nodes and twelve links, with measures at, near and far from the limits of the robots, or unknown."""

    careful = rng.random() < 0.3  # few ways are open in such a map

    def near(*values):
        if not careful and rng.random() < 0.85:
            return 1.0 if values[0] == 0.39 else 0.01
        some = [value * (1 + rng.choice([0, 5e-7, -5e-7, 2e-6, -2e-6, 1e-3, 0.3, -0.3])) for value in values]
        return rng.choice([None, None, 0.0, *some])

    n = rng.randint(1, 7)
    ids, nodes, links = rng.sample(range(20), n), [], []
    for own in ids:
        kind = rng.choice(NODE_TYPES)
        shape = rng.choice([None, *OBSTACLE_SHAPES]) if kind == "obstacle" else None
        measures = (
            {"step_m": near(0.03, 0.2), "inclination_deg": near(5.0, 45.0)} if shape and rng.random() < 0.6 else {}
        )
        nodes.append(Node(own, rng.uniform(-9, 9), rng.uniform(-9, 9), kind, shape, **measures))
    for i, own in enumerate(rng.sample(range(30), rng.randint(0, 12))):
        is_open = rng.random() < 0.25
        start, end = ids[i] if i < n else rng.choice(ids), NOWHERE if is_open else rng.choice(ids)
        found = {
            "length_m": None if is_open else rng.choice([None, 2.0, 3.0, 5.0, 0.0, rng.uniform(0, 9)]),
            "min_width_m": None if is_open else near(0.39, 0.7),
            "opening_m": near(0.39, 0.7),
            "max_step_m": near(0.03, 0.2, 0.125),
            "posture_deg": near(5.0, 45.0, 17.5),
            "max_roll_deg": near(5.0, 45.0, 17.5),
            "attributes": block(rng, near) if rng.random() < 0.15 else {},
        }
        bearings = [rng.uniform(0, 360), None if is_open else rng.uniform(0, 360)]
        links.append(Link(own, start, end, "un-searched" if is_open else "searched", *bearings, **found))
    return BtmMap(tuple(nodes), tuple(links))


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    """Return Python's and the script's answers about random maps: `(map, pairs, routes by robot and known_only)`."""
    rng, robots = random.Random(5), [*ROBOTS.values(), OWN]
    maps, panels = [], []
    for _ in range(100):
        btm = random_map(rng) if maps else DIAMOND
        ids = [node.id for node in btm.nodes]
        pairs = [(0, 3), (0, None)] if btm is DIAMOND else []
        pairs += [(rng.choice(ids), rng.choice([*ids, None])) for _ in range(6 - len(pairs))]
        asked = [(start, routes.UNSEARCHED if end is None else end) for start, end in pairs]
        found = [routes.routes(btm, robots, asked, known_only=known) for known in (False, True)]
        maps.append((btm, pairs, found))
        panels.append({**panel_of(btm), "pairs": pairs})
    for panel, (btm, _, _) in zip(panels, maps):
        panel["nodes"] = rng.sample(panel["nodes"], len(btm.nodes))
    numbers = [(10 ** rng.uniform(-9, 20) * rng.choice([1, -1]), rng.randint(3, 17)) for _ in range(300)]
    numbers += [(value, digits) for value in (0.0, 2.125, 2.375, 0.125, 1e15 + 0.5, 99.95, 1e16, 5e-5, 1e5, 123456.5,
                                              999.5, 1000.5, 0.0009765625) for digits in range(3, 18)]  # fmt: skip
    bodies = [
        {name: getattr(robot, name) for name in ("name", "width_m", "max_step_m", "max_slope_deg")} for robot in robots
    ]
    given = {"panels": panels, "robots": bodies, "numbers": numbers}
    script = assembled("routes.js") + ANSWER
    return robots, maps, numbers, browser.answers(tmp_path_factory.mktemp("script"), script, given)


def test_numbers_are_told_alike(both):
    _, _, numbers, said = both
    for (value, digits), text in zip(numbers, said["numbers"], strict=True):
        assert text == f"{value:.{digits}g}", (value, digits)


def test_the_script_refuses_what_python_refuses(both):
    robots, maps, _, said = both
    refusing = 0
    for (btm, _, _), of_map in zip(maps, said["uses"], strict=True):
        nodes = {node.id: node for node in btm.nodes}
        for robot, of_robot in zip(robots, of_map, strict=True):
            for known, (refused, barriers) in enumerate(of_robot):
                links = {link.id: refusals(link, nodes, robot, known_only=bool(known)) for link in btm.links}
                passed = {node.id: hindrances(node, robot, known_only=bool(known)) for node in btm.nodes}
                assert {key: tuple(why) for key, why in refused} == {key: why for key, why in links.items() if why}
                assert {key: tuple(why) for key, why in barriers} == {key: why for key, why in passed.items() if why}
                refusing += len(refused)
    assert refusing > 300


def test_the_script_goes_where_python_goes(both):
    _, maps, _, said = both
    found_any = none = ahead = 0
    for (_, _, found), of_map in zip(maps, said["routes"], strict=True):
        for r, of_robot in enumerate(of_map):
            for known, many in enumerate(of_robot):
                for route, ours in zip(found[known][r], many, strict=True):
                    _assert_same(route, ours)
                    found_any += len(route.links) > 1
                    none += not route.is_found
                    ahead += route.onward is not None
    assert min(found_any, none, ahead) > 100, (found_any, none, ahead)


def _assert_same(route, ours):
    assert ours["found"] == route.is_found
    assert ours["trouble"] == route.trouble
    assert (tuple(ours["nodes"]), tuple(ours["links"])) == (route.nodes, route.links)
    for name in ("refused", "barriers"):
        assert tuple((key, tuple(why)) for key, why in ours[name]) == getattr(route, name)
    assert tuple(ours["unknown"]) == route.unknown
    if not route.is_found:
        return
    assert ours["end"] == route.end
    assert ours["length_m"] == pytest.approx(route.length_m, abs=1e-9)
    mine = [*ours["steps"], *([ours["onward"]] if ours["onward"] else [])]
    for step, own in zip([*route.steps, *([route.onward] if route.onward else [])], mine, strict=True):
        for name in ("link", "start", "end", "way", "ways"):
            assert own[name] == getattr(step, name)
        for name in ("bearing_deg", "turn_deg"):
            value = getattr(step, name)
            assert own[name] is None if value is None else math.isclose(own[name], value, abs_tol=1e-6)


# In a browser

SCENARIO = """
<script>
const seen = {}, wait = (ms = 60) => new Promise((done) => setTimeout(done, ms));
const note = async (name) => { await wait(); seen[name] = station.state(); };
const $ = (id) => document.getElementById(id);
const set = (id, value) => {
  $(id).value = value;
  for (const kind of ["input", "change"]) $(id).dispatchEvent(new Event(kind));
};
const canvas = () => document.querySelector("#large canvas");
const about = {button: 0, pointerId: 1, bubbles: true};
const pointer = (kind, [clientX, clientY]) => new PointerEvent(kind, {clientX, clientY, ...about});
const mouse = (kind, place) => canvas().dispatchEvent(pointer(kind, place));
const click = (place) => { mouse("pointerdown", place); mouse("pointerup", place); };
const key = (key) => document.body.dispatchEvent(new KeyboardEvent("keydown", {key, bubbles: true}));
const texts = (where) => [...document.querySelectorAll(where)].map((one) => one.textContent);
Element.prototype.setPointerCapture = () => {};
(async () => {
  await note("start");
  click(station.at("node", 0)); await note("one");
  click(station.at("node", 2)); await note("two"); seen.found = $("found").textContent;
  set("robot", "1"); await note("wheeled");
  mouse("pointermove", station.at("link", 4)); seen.hint = document.querySelector("#large .hint").textContent;
  click(station.at("link", 4)); await note("link"); seen.details = $("picked").textContent;
  set("to", "3"); await note("barrier");
  set("known", "on"); $("known").click(); await note("known"); seen.none = texts("#found li"); $("known").click();
  set("to", "unsearched"); await note("unsearched");
  set("robot", "own"); set("own-step", "0.149"); await note("low");
  set("own-step", "0.151"); await note("own");
  set("own-width", "-1"); await note("wrong"); seen.said = $("found").textContent;
  key("Escape"); await note("escaped");
  document.querySelector('#tables [data-pick="link-5"] button').click(); await note("table");
  seen.tables = texts("#tables summary"); seen.victims = texts('[aria-label="Victims"] td');
  document.querySelector('[data-writer="0"]').click(); await note("hidden");
  click(station.at("node", 0)); await note("nothing");
  document.querySelector('[data-writer="0"]').click();
  canvas().dispatchEvent(new WheelEvent("wheel", {deltaY: -100, cancelable: true})); await note("zoomed");
  key("w"); $("theme").click(); await note("whole");
  seen.about = $("about").textContent;
  const {width, height} = canvas();
  seen.colours = new Set(canvas().getContext("2d").getImageData(0, 0, width, height).data).size;
  document.body.dataset.test = JSON.stringify(seen);
})();
</script>
"""


def test_two_clicks_give_a_route(body):
    seen = json.loads(body(jx.btm.station([SQUARE], ["scout"]), scenario=SCENARIO)["test"])
    assert (seen["start"]["robot"]["name"], seen["start"]["route"], seen["start"]["picked"]) == ("kamui", None, None)
    assert (seen["one"]["from"], seen["one"]["to"], seen["one"]["picked"]) == (0, None, {"kind": "node", "id": 0})
    assert (seen["two"]["from"], seen["two"]["to"], seen["two"]["route"]["links"]) == (0, 2, [4])
    assert seen["found"].startswith("7.00 m over 1 link, node 0 to node 2")
    assert seen["wheeled"]["route"]["links"] == [0, 1]
    assert seen["wheeled"]["refused"] == [[3, [BLOCKED]], [4, ["step 0.15 m > 0.03 m"]]]
    assert seen["wheeled"]["barriers"] == [[3, ["step 0.1 m > 0.03 m"]]]
    assert seen["hint"] == "Link 4 (nodes 0 to 2)\nrefused for wheeled: step 0.15 m > 0.03 m"
    assert (seen["link"]["picked"], seen["link"]["to"]) == ({"kind": "link", "id": 4}, 2)
    assert "for wheeledrefused: step 0.15 m > 0.03 m" in seen["details"]
    assert seen["barrier"]["route"]["nodes"] == [0, 1, 2, 3]  # which it may come to, but not pass
    assert [3, [BLOCKED, "roll unknown"]] in seen["known"]["refused"]
    assert (seen["unsearched"]["to"], seen["unsearched"]["route"]["onward"]["link"]) == ("unsearched", 5)
    assert [4, ["step 0.15 m > 0.149 m"]] in seen["low"]["refused"]
    assert (seen["own"]["refused"], seen["own"]["route"]["links"]) == ([[3, [BLOCKED]]], [4])
    assert seen["own"]["robot"] == {"name": "own robot", "width_m": 0.39, "max_step_m": 0.151, "max_slope_deg": 45}
    assert (seen["said"], seen["wrong"]["route"]) == ("expected width above 0 to 10 m, got -1", None)
    assert (seen["escaped"]["from"], seen["escaped"]["to"], seen["escaped"]["picked"]) == (None, None, None)
    assert seen["table"]["picked"] == {"kind": "link", "id": 5}
    assert seen["tables"] == ["Written by: 1 map", "Un-searched links: 1", "Victims: 1", "All nodes: 4", "All links: 6"]
    assert seen["victims"] == ["■ 0", "0.0, 0.0 m", "yes", "scout"]
    assert (seen["hidden"]["hidden"], seen["nothing"]["picked"], seen["nothing"]["from"]) == (["scout"], None, None)
    assert (seen["zoomed"]["view"]["kind"], seen["whole"]["view"]["kind"]) == ("free", "whole")
    assert seen["zoomed"]["view"]["scale"] > seen["start"]["view"]["scale"]
    assert seen["about"] == (
        "4 nodes (1 terminal, 2 divergence, 1 obstacle); 6 links: 5 searched, 1 un-searched; 1 blocked; 1 victim"
    )
    assert seen["colours"] > 10


APART = """
<script>
const wait = (ms = 60) => new Promise((done) => setTimeout(done, ms));
(async () => {
  const seen = {captions: [...document.querySelectorAll("figcaption")].map((one) => one.textContent)};
  const folded = () => [...document.querySelectorAll("#tables details")].map((one) => one.textContent);
  await wait(); seen.about = folded().filter((text) => text.startsWith("About the map")); seen.first = station.state();
  [...document.querySelectorAll("#apart button")][0].click(); await wait(); seen.second = station.state();
  seen.large = document.querySelector("#large b").textContent;
  seen.froms = document.getElementById("from").options.length;
  station.setEnds(0, 4); await wait(); seen.route = station.state().route;
  document.body.dataset.test = JSON.stringify(seen);
})();
</script>
"""


@pytest.mark.slow
def test_maps_apart_are_asked_one_by_one(body):
    maps = (btm.with_attributes(own) for btm, own in ((FIRST, {"robot": "kamui"}), (THERE, {"robot": "wheeled"})))
    page = jx.btm.station([*maps, chain("TDFDT").with_attributes({"seed": 3})], ["a", NASTY, "c"])
    seen = json.loads(body(page, scenario=APART)["test"])
    assert seen["captions"] == [
        f"{GLOBAL_MAP}a, {NASTY}. In the frame of a.Enlarge",
        "cStands apart: it has not enough in common with the other maps.Enlarge",
    ]
    assert seen["about"] == [f"About the map: 2frame: odomrobot: kamui (a) or wheeled ({NASTY})"]
    assert (seen["first"]["map"], seen["second"]["map"], seen["large"]) == (GLOBAL_MAP, "c", "c")
    assert (seen["froms"], seen["route"]["links"]) == (6, [0, 1, 2, 3])


LAST = """
<script>
const last = Number([...document.getElementById("from").options].pop().value) || 0;
station.setEnds(last, document.getElementById("from").options.length > 1 ? last : null);
</script>
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("btm", "nodes"),
    [
        (BtmMap((), ()), None),
        (chain("T"), [0]),
        (chain("T", [(0, 30.0)]), [0]),
        (BtmMap((node(5),), (way(3, 5, 5, 0, 90),)), [5]),
    ],
)
def test_maps_of_one_node_or_none_open_too(body, btm, nodes):
    found = json.loads(body(jx.btm.station([btm]), scenario=LAST)["state"])
    assert found["map"] == "0"
    assert (found["route"] and found["route"]["nodes"]) == nodes


# Commands and wrong input


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, btm in (("a", FIRST), ("b", THERE), ("c", chain("TDFDT"))):
        (tmp_path / f"{name}.json").write_text(json.dumps(json_form.to_json(btm)))
    (tmp_path / "text.json").write_text("[1]")
    return tmp_path


def test_the_command_writes_a_page(files, capsys):
    assert main(["station", "a.json", "b.json", "c.json", "--out", "page.html"]) == 0
    out, err = capsys.readouterr()
    assert (files / "page.html").read_text() == jx.btm.station([FIRST, THERE, chain("TDFDT")], ["a", "b", "c"])
    assert "| global map | a, b |     6 |              5 |           2 |" in out
    assert "c: Stands apart: it has not enough in common with the other maps." in out
    assert "node 3: victim is True in a and False in b" in out
    assert out.endswith("wrote page.html\n")
    assert err == ""
    assert main(["station", "a.json", "--out", "page.html", "--overwrite"]) == 0
    assert [panel["name"] for panel in data_of((files / "page.html").read_text())["panels"]] == ["a"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "station: expected files of one map or more"),
        (["a.json"], "expected --out"),
        (["a.json", "b.json", "./a.json", "--out", "page.html"], "expected every map once, got ./a.json again"),
        (["text.json", "--out", "page.html"], 'format must be "behavioral-trace-map", got a list'),
        (["a.json", "--out", "b.json"], "is there already: name another file, or replace it with --overwrite"),
    ],
)
def test_the_command_refuses(files, refuses, words, said):
    before = sorted(file.name for file in files.iterdir())
    refuses(["station", *words], said)
    assert sorted(file.name for file in files.iterdir()) == before
