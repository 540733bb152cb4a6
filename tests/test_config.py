"""Settings, and messages about values of any kind: one short line, whatever was given."""

import types

import numpy as np
import pytest
from ref.refusals import refused

from jexplore.config import as_record, require_kind, require_whole, shown
from jexplore.rules import Lidar, Rules


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.1, "0.1"),
        ("cave", "'cave'"),
        ({"range_m": 3}, "{'range_m': 3}"),
        (10**400, "1000000000000000000000000000...00000000000000000000000000000"),
        (np.eye(2), "array([[1., 0.], [0., 1.]])"),
        ([[1]] * 1000, "[[1], [1], [1], [1], [1], [1], ...]"),
        ("a\nb", "'a\\nb'"),
    ],
)
def test_what_a_message_shows_of_a_value(value, text):
    assert shown(value) == text


def test_more_digits_than_python_writes_are_shown_as_what_they_are():
    assert shown(10**5000).startswith("<int")
    refused("n must be an integer from 0 to 9, got <int", require_whole, "n", 10**5000, 0, 9)


def test_a_value_of_many_copies_of_itself_is_shown_at_once():
    value = [1]
    for _ in range(60):
        value = [value] * 9
    assert len(shown(value)) == 200


def test_a_dict_of_fields_shows_how_the_record_is_written():
    require_kind("lidar", Lidar(), Lidar)
    for value, line in (
        ({"range_m": 3}, r"lidar must be a jx.Lidar, such as jx.Lidar\(range_m=3\), got \{'range_m': 3\}$"),
        ({"range_m": 3, "n_beams": 7}, r"such as jx.Lidar\(range_m=3, n_beams=7\), got"),
        ({"rang_m": 3}, r"such as jx.Lidar\(n_beams=181\), got"),
        ({}, r"such as jx.Lidar\(n_beams=181\), got \{\}$"),
        (Lidar, r"such as jx.Lidar\(n_beams=181\), got <class"),
        (Rules(), r"such as jx.Lidar\(n_beams=181\), got Rules\("),
    ):
        refused(line, require_kind, "lidar", value, Lidar)


def test_a_mapping_stands_for_settings():
    assert as_record("lidar", {"range_m": 4}, Lidar) == Lidar(range_m=4)
    assert as_record("lidar", {}, Lidar) == Lidar()
    assert as_record("lidar", types.MappingProxyType({"n_beams": 7}), Lidar) == Lidar(n_beams=7)
    assert as_record("rules", Rules(near_m=1), Rules) == Rules(near_m=1)
    for value, line in (
        ({"rang_m": 4}, "unknown field of lidar: 'rang_m'; did you mean 'range_m'"),
        ({4: "range_m"}, "unknown field of lidar: '4'"),
        ({"range_m": "4"}, "lidar.range_m must be a number"),
        (None, "lidar must be a jx.Lidar"),
        (Rules(), "lidar must be a jx.Lidar"),
        ("range_m=4", "lidar must be a jx.Lidar"),
    ):
        refused(line, as_record, "lidar", value, Lidar)


def test_settings_are_replaced_and_stay_checked():
    assert Lidar(n_beams=7).replace(range_m=4.0) == Lidar(n_beams=7, range_m=4.0)
    refused(r"lidar\.range_m must be", Lidar().replace, range_m=-1)
    refused("did you mean 'range_m'", Lidar().replace, range=4)
