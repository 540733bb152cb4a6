"""Behavioral Trace Maps on the host: angles by hand, refusals, plain numbers."""

import math
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ref.refusals import refused
from ref.traces import node, stub, way

from jexplore.config import InputError
from jexplore.tracemap import record
from jexplore.tracemap.record import BtmMap, Node


@pytest.mark.parametrize(
    ("bearings", "angles"),
    [
        ([], []),
        ([77], [360]),
        ([0, 90, 180], [90, 90, 180]),
        ([350, 10, -100], [250, 90, 20]),
        ([-1e-20, 180], [180, 180]),
    ],
)
def test_angles_by_hand(bearings, angles):
    btm = BtmMap((node(0),), tuple(stub(i, 0, bearing) for i, bearing in enumerate(bearings)))
    assert btm.angles_deg(0) == angles


def test_bearings_count_both_ends():
    btm = BtmMap((node(0), node(1)), (way(0, 0, 1, 10, 200), way(1, 0, 0, 30, 370), stub(2, 1, -90)))
    assert btm.bearings_deg(0) == [10, 10, 30]
    assert btm.bearings_deg(1) == [200, 270]
    assert BtmMap((node(0),), (stub(0, 0, -1e-20), stub(1, 0, 180))).bearings_deg(0) == [0, 180]  # rounds up to 360


@given(st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=6))
def test_angles_are_a_full_turn(bearings):
    angles = BtmMap((node(0),), tuple(stub(i, 0, b) for i, b in enumerate(bearings))).angles_deg(0)
    assert len(angles) == len(bearings)
    assert min(angles) >= 0
    assert math.fsum(angles) == pytest.approx(360)


def test_numbers_of_numpy_become_plain():
    btm = BtmMap((Node(np.int32(0), np.float32(0.5), 1, "terminal", attributes={"heat": np.float64(2)}),), ())
    found = record.check_map(btm)
    assert repr(found.nodes[0]) == repr(Node(0, 0.5, 1.0, "terminal", attributes={"heat": 2.0}))


def test_attributes_are_set_of_a_node_of_a_link_and_of_the_map():
    btm = BtmMap((node(0), node(7)), (way(3, 0, 7, 10),), {"world": "w"})
    found = btm.with_attributes({"victim": True}, node=7)
    found = found.with_attributes({"heat": np.float32(0.5), "victim": "two"}, node=7)
    found = found.with_attributes({"radio_dbm": -61}, link=3).with_attributes({"frame": "map"})
    assert found.nodes[1].attributes == {"victim": "two", "heat": 0.5}
    assert found.links[0].attributes == {"radio_dbm": -61}
    assert found.attributes == {"world": "w", "frame": "map"}
    assert found.nodes[0] == btm.nodes[0]
    assert not btm.nodes[1].attributes


@pytest.mark.parametrize(
    ("where", "says"),
    [
        ({"node": 1}, "there is no node 1: the map has 1 nodes"),
        ({"link": 0}, "there is no link 0: the map has 0 links"),
        ({"node": 0, "link": 0}, "of a node or of a link, not of both at once"),
    ],
)
def test_attributes_that_cannot_be_set(where, says):
    refused(says, BtmMap((node(0),), ()).with_attributes, {"a": 1}, **where)


def test_an_attribute_that_json_cannot_hold():
    refused("attributes must be what JSON can hold", BtmMap((node(0),), ()).with_attributes, {"a": math.nan}, node=0)


def test_a_map_that_is_none_is_refused():
    with pytest.raises(InputError, match=r'^"map": link 0 ends at node 1, which is not there$'):
        record.check_map(BtmMap((node(0),), (way(0, 0, 1, 0),)))
    refused(r"^mine: node ids must differ, got 0 again$", record.check_map, BtmMap((node(0), node(0)), ()), "mine")


@pytest.mark.parametrize("module", ["tracemap.record", "tracemap.json_form", "tracemap.similarity"])
def test_import_loads_no_jax(module):
    program = f"import sys, jexplore.{module}; sys.exit('jax' in sys.modules)"
    subprocess.run([sys.executable, "-c", program], check=True)
