"""Teams of trace robots: the clock, contacts, merges, counts against the plan, refusals; a team in a small building."""

import dataclasses
import types

import numpy as np
import pandas as pd
import pytest
from ref.browser import assert_alone, data_of
from ref.refusals import refused
from ref.traces import T_LEFT, T_RIGHT

from jexplore import btm
from jexplore.cli import main
from jexplore.studies.traces import job
from jexplore.studies.traces.teams import clock, counts, team
from jexplore.tracemap import json_form
from jexplore.tracemap.merging.merge import merge_maps
from jexplore.worlds import load_world

FAR = 100.0  # m


class Robot:
    """Log of a robot that is at given places at the exchanges and has given maps there."""

    def __init__(self, xs, maps):
        self.truth = np.repeat(np.array([(x, 1.0, 0.0) for x in xs], np.float32), clock.EXCHANGE_STEPS, axis=0)
        self.exchanges, self.maps, self.xs = [None] * len(xs), maps, xs
        self.result = self.held(len(xs))

    def place(self, exchange):
        return np.array([self.xs[min(exchange, len(self.xs) - 1)], 1.0])

    def held(self, exchange):
        own = self.maps[min(exchange, len(self.maps) - 1)]
        kind = np.array([btm.NODE_TYPES.index(node.type) for node in own.nodes])
        places = np.array([(node.x_m, node.y_m) for node in own.nodes])
        map_ = types.SimpleNamespace(n_nodes=len(own.nodes), kind=kind, whole=own)
        return types.SimpleNamespace(map=map_, node_at=places)


@pytest.fixture(scope="module")
def plan():
    """The paper's course, whose junctions are nodes 4, 5, 6 and 7 of its map."""
    return job.prepare_trace("course")


@pytest.fixture
def by_hand(monkeypatch):
    monkeypatch.setattr(team, "_map_at", lambda plan, log, exchange: log.held(exchange).map.whole)


def test_a_robot_that_has_ended_stays_where_it_is():
    truth = np.column_stack([np.arange(1, 251), np.zeros(250), np.zeros(250)])
    log = clock.RobotLog(None, truth, [])  # type: ignore[arg-type]
    assert [log.place(exchange)[0] for exchange in (0, 1, 2, 9)] == [100, 200, 250, 250]


def test_maps_merge_once_a_contact_and_only_with_new_nodes(plan, by_hand):
    whole, other = load_world("course").course.topology, load_world("course#1").course.topology  # type: ignore[union-attr]
    near_at = (1, 2, 4, 6, 7)
    first = Robot([0.0] * 8, [T_LEFT, T_LEFT, T_LEFT, whole])
    second = Robot([3.0 if exchange in near_at else FAR for exchange in range(8)], [T_RIGHT, T_RIGHT, T_LEFT, whole])
    third = Robot([2 * FAR] * 8, [other])
    found = team.merge_team(plan, [first, second, third], "range:4")  # type: ignore[list-item]
    said = found.contacts[["step", "one", "other", "away_m", "nodes_one", "outcome", "wrong"]].values.tolist()
    assert said == [[200, 0, 1, 3.0, 3, "NOT_ENOUGH_IN_COMMON", 0], [500, 0, 1, 3.0, len(whole.nodes), "MERGED", 0]]
    assert [*found.groups] == [("robot-0", "robot-1")]
    assert len(found.map.nodes) == len(whole.nodes)
    everywhere = team.merge_team(plan, [first, second, third], "all")  # type: ignore[list-item]
    assert [*everywhere.groups] == [("robot-0", "robot-1", "robot-2")]
    panels = data_of(everywhere.page())["panels"]
    assert [panel["name"] for panel in panels] == ["global map", "robot-0", "robot-1", "robot-2"]
    assert "Stands apart: it has not enough in common" in panels[-1]["note"]
    nowhere = team.merge_team(plan, [first, second, third], "none")  # type: ignore[list-item]
    assert not nowhere.groups
    assert not len(nowhere.contacts)
    assert [panel["note"] for panel in data_of(nowhere.page())["panels"]] == ["As it was written."] * 3
    assert nowhere.map is nowhere.maps["robot-0"]


def test_contacts_join_groups_over_other_robots():
    near = {(0, 2): np.array([1]), (2, 3): np.array([5]), (1, 4): np.array([0])}
    assert team._groups(near, 5) == [("robot-0", "robot-2", "robot-3"), ("robot-1", "robot-4")]
    assert team._groups(near, 3) == [("robot-0", "robot-2")]
    assert team._groups(near, 1) == []


def test_a_place_counts_for_the_nearest_junction_whose_circle_holds_it(plan):
    at = plan.truth.marks[~plan.truth.is_door, :2] - plan.world.origin_m
    places = np.concatenate([at, at + np.array([0.0, 0.3]), [[-FAR, 0.0]]])
    assert counts.junctions_at(plan, places).tolist() == [*range(len(at)), *range(len(at)), -1]
    assert counts.junctions_at(plan, np.zeros((0, 2))).tolist() == []


def test_what_a_team_has_found(plan, by_hand):
    topology = load_world("course").course.topology  # type: ignore[union-attr]
    marks = plan.truth.marks[~plan.truth.is_door]
    half = dataclasses.replace(topology, nodes=topology.nodes[:5], links=topology.links[:4])
    slow, quick = Robot(marks[:, 0], [half, half, topology]), Robot(marks[::-1, 0], [half, topology])
    for robot in (slow, quick):
        robot.truth[:, 1] = marks[0, 1]
    table = team.merge_team(plan, [slow, quick], "all").table  # type: ignore[list-item]
    assert table["robots"].tolist() == [1, 2]
    assert table["steps_mapped_90"].tolist() == [300, 200]
    assert table["merged"].tolist() == table["all"].tolist() == [len(marks)] * 2
    assert table["doubled"].tolist() == table["wrong"].tolist() == [0, 0]
    assert table["outcome"].tolist() == ["", "MERGED"]


def test_wrong_and_doubled_nodes_are_counted(plan):
    topology = load_world("course").course.topology  # type: ignore[union-attr]
    merged = merge_maps([topology, topology], ["a", "b"])
    places = np.array([(node.x_m, node.y_m) for node in topology.nodes])
    moved = places + np.where(np.arange(len(places)) == 4, 2.5, 0.0)[:, None]
    assert counts.wrong_matches(merged, {"a": places, "b": places}) == 0
    assert counts.wrong_matches(merged, {"a": places, "b": moved}) == 1
    split = dataclasses.replace(merged, nodes={"a": merged.nodes["a"], "b": {**merged.nodes["b"], 4: 99}})
    logs = [types.SimpleNamespace(truth=np.zeros((5, 3)), result=types.SimpleNamespace(node_at=places))] * 2
    never = [np.full((2, 4), np.inf)] * 2
    row = counts.team_row(plan, logs, never, {"a": topology, "b": topology}, {("a", "b"): split})  # type: ignore[arg-type]
    assert row["doubled"] == 1
    assert np.isnan(row["steps_reached_90"])


def test_sizes():
    assert [counts.sizes_of(n) for n in (1, 2, 3, 4, 6, 16)] == [
        [1], [1, 2], [1, 2, 3], [1, 2, 4], [1, 2, 4, 6], [1, 2, 4, 8, 16],
    ]  # fmt: skip


def test_starts_of_a_team(plan):
    together, apart = (team.place_robots(plan, 3, starts) for starts in ("together", "apart"))
    for found in (together, apart):
        assert np.array_equal(found[0], plan.begins[0])
        turned = (found[:, 2] - found[0, 2]) % (2 * np.pi)
        np.testing.assert_allclose(turned, 2 * np.pi * np.arange(3) / 3, atol=1e-5)
    away = [np.hypot(*(found[1:, :2] - found[0, :2]).T) for found in (together, apart)]
    assert away[0].max() < 0.3
    assert away[1].min() > 5.0
    given = team.place_robots(plan, 2, ["1,2,90", (3, 2, 0.0)])
    np.testing.assert_allclose(given, [[1, 2, np.pi / 2], [3, 2, 0]], atol=1e-6)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ("--robots 0", "robots must be an integer from 1 to 16, got 0"),
        ("--robots 17", "robots must be an integer from 1 to 16, got 17"),
        ("--robots 2 --contact radio", "contact of trace robots must be all, none or range:METRES, got 'radio'"),
        ("--robots 2 --contact range:-1", "range:METRES, got 'range:-1'"),
        ("--robots 2 --contact all:3", "range:METRES, got 'all:3'"),
        ("--robots 3 --team-starts 1,2,0 3,2,0", "3 robots need 3 starts, got ('1,2,0', '3,2,0')"),
        ("--robots 2 --team-starts near", "2 robots need 2 starts, got 'near'"),
        ("--robots 2 --team-starts 1,2,0 3,2", "a start of team_starts must be x,y,heading_deg, got '3,2'"),
        ("--robots 2 --team-starts 1,-2,0 1,99,0", "start (1.00, -2.00) m of 'course': lies outside"),
        ("--robots 1 --team-starts 1,2,0 --start 1 2 0", "start and given team_starts exclude each other"),
        ("--robots 2 --runs 3", "--robots takes no --runs: every robot makes one run"),
        ("--robots 2 --engine jax", "--robots takes no --engine: every robot makes one run"),
        ("--contact none", "--contact goes with --robots"),
        ("--limits.lost 2", "--limits goes with --robots"),
    ],
)
def test_bad_input_is_one_line(options, says, tmp_path, refuses):
    refuses(["trace", *options.split(), "--out", tmp_path / "o"], says)
    assert not (tmp_path / "o").exists()


def test_names_are_checked_in_python():
    refused("robots must be an integer", team.trace_team, "course", robots=True)


@pytest.mark.slow
@pytest.mark.jit
def test_a_team_in_rooms(tmp_path, capsys):
    out = tmp_path / "out"
    options = "--world rooms --robots 2 --noise-m 0.01 --contact range:4 --max-steps 4000"
    assert main.main(["trace", *options.split(), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    contacts, table = (pd.read_parquet(out / f"{name}.parquet") for name in ("contacts", "teams"))
    assert "MERGED" in set(contacts["outcome"])
    assert max(contacts["away_m"]) <= 4.0
    assert {*(contacts["step"] % clock.EXCHANGE_STEPS)} == {0}
    assert table["merged"].iloc[-1] > table["one"].iloc[-1] > 0
    assert table["steps_reached_90"].isna().tolist()[0]
    assert "robot-0, robot-1 in the end: MERGED" in said
    assert "outcomes: STEP_LIMIT 2" in said
    merged = json_form.read_btm(out / "btm.json")
    assert merged.attributes["merged_from"] == ["robot-0", "robot-1"]
    page = (out / "station.html").read_text()
    assert_alone(page)
    assert [panel["name"] for panel in data_of(page)["panels"]] == ["global map", "robot-0", "robot-1"]
    assert (out / "team.png").stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.jit
def test_a_team_on_a_course_perceives_by_triangles():
    found = team.trace_team("course", robots=2, noise={"range_m": 0.01}, max_steps=300)
    assert (found.plan.perception, len(found.logs)) == ("triangles", 2)
    assert len(found.table) == 2
    for log in found.logs:
        assert len(log.exchanges) == len(log.truth) // clock.EXCHANGE_STEPS >= 2
        own = log.exchanges[-1]
        assert 0 < own.map.n_nodes <= log.result.map.n_nodes  # a run that breaks off ends in a node
        some = slice(int(own.map.n_nodes))
        np.testing.assert_array_equal(own.node_at[some], log.result.node_at[some])
