"""Behavioral Trace Maps as JSON: by hand, there and back, refusals."""

import json
import re

import pytest
from hypothesis import given, settings
from ref.refusals import refused
from ref.traces import CRAWLER, T_LEFT, changed, maps, node, stub, way

from jexplore.report import store
from jexplore.tracemap import json_form
from jexplore.tracemap.json_form import WANTED
from jexplore.tracemap.record import BtmMap


def text_of(btm, **replaced):
    return json.dumps({**json_form.to_json(btm), **replaced}, indent=2)


def test_json_by_hand():
    btm = BtmMap(
        (node(4, "T", 1.5, -2.0), node(2, "O", obstacle="stairs", step_m=0.1, attributes={"victim": [1, 2.5]})),
        (way(7, 4, 2, 90, length_m=2.0), stub(1, 4, 180, opening_m=0.9)),
        {"robot": "ü"},
    )
    unknown = {"inclination_deg": None, "posture_deg": None}
    link = {
        "start": 4,
        "min_width_m": None,
        "posture_deg": None,
        "max_roll_deg": None,
        "max_step_m": None,
        "attributes": {},
    }
    assert json_form.to_json(btm) == {
        "format": "behavioral-trace-map",
        "version": [1, 1],
        "attributes": {"robot": "ü"},
        "nodes": [
            {"id": 4, "x_m": 1.5, "y_m": -2.0, "type": "terminal", "obstacle": None, **unknown, "step_m": None}
            | {"links": 2, "angles_deg": [90.0, 270.0], "attributes": {}},
            {"id": 2, "x_m": 0.0, "y_m": 0.0, "type": "obstacle", "obstacle": "stairs", **unknown, "step_m": 0.1}
            | {"links": 1, "angles_deg": [360.0], "attributes": {"victim": [1, 2.5]}},
        ],
        "links": [
            {"id": 7, "end": 2, "status": "searched", "start_bearing_deg": 90.0, "end_bearing_deg": 270.0, **link}
            | {"length_m": 2.0, "opening_m": None},
            {"id": 1, "end": -1, "status": "un-searched", "start_bearing_deg": 180.0, "end_bearing_deg": None, **link}
            | {"length_m": None, "opening_m": 0.9},
        ],
    }


@settings(max_examples=30)
@given(maps(measures=True))
def test_there_and_back(btm):
    text = json.dumps(store.jsonable(json_form.to_json(btm)), ensure_ascii=False, allow_nan=False)
    assert json_form.parse_map(text, "btm.json") == btm
    assert repr(json_form.from_json(json_form.to_json(btm))) == repr(btm)  # -0.0 and 0.0, 1 and 1.0 and True differ


def test_a_newer_minor_version_is_read():
    obj = json_form.to_json(T_LEFT) | {"version": [1, 7], "levels": [{"id": 0}]}
    for item in (*obj["nodes"], *obj["links"]):
        item |= {"colour": "red", "attributes": {"intervention": None}}
    obj["nodes"][0]["links"] = "what an older reader computes itself"
    want = changed(T_LEFT, **dict.fromkeys(("nodes", "links"), lambda _: {"attributes": {"intervention": None}}))
    assert json_form.parse_map(json.dumps(obj), "btm.json") == want


@pytest.mark.parametrize(
    ("version", "got"), [([2, 0], r"\[2, 0\]"), (None, "None"), ([1], r"\[1\]"), ([1, -1], r".*"), ([1, "0"], r".*")]
)
def test_other_versions_are_refused(version, got):
    message = rf'^"b": version must be \[1, 0\] or a later minor one, got {got}$'
    refused(message, json_form.parse_map, text_of(T_LEFT, version=version), "b")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"end": 2,', '"end": 9,', "link 1 ends at node 9, which is not there"),
        ('"start": 1,', '"start": 9,', "link 1 starts at node 9, which is not there"),
        ('"id": 2,', '"id": 1,', "node ids must differ, got 1 again"),
        ('"type": "divergence"', '"type": "tree"', "node 1: type must be one of terminal, .*, obstacle, got 'tree'"),
        ('"type": "divergence",', "", "node 1: type is missing"),
        ('"obstacle": null', '"obstacle": "hole"', "node 0: obstacle must be one of slope, stairs, got 'hole'"),
        ('"x_m": 2.0', '"x_m": NaN', "node 1: x_m must be a finite number, got nan"),
        ('"x_m": 2.0', '"x_m": true', "node 1: x_m must be a finite number, got True"),
        ('"x_m": 2.0', '"x_m": ' + "9" * 400, "node 1: x_m must be a finite number, got .*"),
        ('"length_m": 2.0', '"length_m": -2', "link 0: length_m must be a finite number of at least 0, got -2"),
        ('"id": 2,', '"id": "2",', r"nodes\[2\]: id must be an integer from 0 to 9007199254740991, got '2'"),
        ('"id": 2,', '"id": -1,', "node -1: id must be an integer from 0 to 9007199254740991, got -1"),
        ('"end": 2,', '"end": -2,', "link 1: end must be an integer from -1 to 9007199254740991, got -2"),
        ('"end": 2,', '"end": -1,', 'link 1 has no end, so it must be un-searched, got "searched"'),
        ('"end": -1,', '"end": 0,', 'link 2 ends at node 0, so it must be searched, got "un-searched"'),
        ('"end_bearing_deg": 180.0', '"end_bearing_deg": null', "link 0 must have an end_bearing_deg if it has an .*"),
        ('"attributes": {}\n    },', '"attributes": [1]\n    },', r"node 0: attributes must be an object, got \[1\]"),
        ('"attributes": {}\n    },', '"attributes": {"a": [NaN]}\n    },', "node 0: attributes must .*, got nan"),
    ],
)
def test_wrong_items_are_refused_by_name(old, new, message):
    text = text_of(T_LEFT)
    bad = text.replace(old, new, 1)
    assert bad != text
    refused(rf'^"b\.json": {message}$', json_form.parse_map, bad, "b.json")


def test_a_cut_file_is_refused_wherever_it_is_cut():
    text = text_of(T_LEFT)
    for length in range(0, len(text), 7):
        said = refused(r'^"b": is not valid JSON \(line \d+: ', json_form.parse_map, text[:length], "b")
        assert int(re.findall(r"line (\d+)", said)[0]) <= text[:length].count("\n") + 1
    refused(r'^"b": is not valid JSON \(line 5: ', json_form.parse_map, "\n".join(text.split("\n")[:4]) + "\n", "b")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[]", f'"b": format must be "behavioral-trace-map", got a list; {WANTED}'),
        ("{}", f'"b": format must be "behavioral-trace-map", got None; {WANTED}'),
        ('{\n"format": "x"}', f'"b": format must be "behavioral-trace-map", got \'x\'; {WANTED}'),
        ('{"command": ["jexplore", "trace"]}', f'"b": is the record of a run; {WANTED}'),
        ('{"is_found": true, "links": []}', f'"b": is a route, the result of `jexplore route`; {WANTED}'),
        (text_of(T_LEFT, nodes={}), '"b": nodes must be a list, got {}'),
        (text_of(T_LEFT, links=None).replace('"links": null', '"link": 0'), '"b": links must be a list, got None'),
        (text_of(T_LEFT, attributes=3), '"b": attributes must be an object, got 3'),
        ("[" * 100_000, None),
        ("1" * 100_000, None),
    ],
)
def test_foreign_files_are_refused(text, message):
    said = refused(r'^"b"', json_form.parse_map, text, "b")
    assert message is None or said == message


def test_files(tmp_path):
    path = tmp_path / "map.json"
    store.write_json(json_form.to_json(CRAWLER), path)
    assert json_form.read_btm(path) == CRAWLER
    path.write_text(path.read_text()[:300])
    lines = path.read_text().count("\n") + 1
    refused(rf"is not valid JSON \(line {lines}: ", json_form.read_btm, path)
    refused(r"none.json': there is no such file", json_form.read_btm, tmp_path / "none.json")
    refused(f"is a directory; {WANTED} in it", json_form.read_btm, tmp_path)
