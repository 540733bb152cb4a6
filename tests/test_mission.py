"""Whole runs: what the robot of the paper finds on its course, how it drives, and how a run may end."""

import dataclasses
import functools
import math
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref.refusals import refused
from ref.runs import a_state

import jexplore as jx
from jexplore.driving import approach, batch, mission, vehicle
from jexplore.driving.batch import building_of, pose_in
from jexplore.driving.building.terrain import FINER, is_level
from jexplore.driving.mission import RunOutcome
from jexplore.driving.params.tree import P
from jexplore.driving.records import RunMode
from jexplore.driving.settings import ROBOTS, Noise, Tuning, for_world
from jexplore.driving.vehicle import DT_S
from jexplore.engine.program import Given
from jexplore.extraction.extract import extract
from jexplore.studies.traces import job, tracing
from jexplore.tracemap.merging.rigid import apart_deg
from jexplore.tracemap.similarity import code
from jexplore.worlds import load_world
from jexplore.worlds.world import World

STILL = Noise(attitude_deg=0, length=0, turn=0, heading_deg_sqrt_m=0, slip=0, beacon_m=0)
KAMUI, TUNING = ROBOTS["kamui"], for_world(Tuning(), is_course=True)


SHORT = {"seed": 5, "max_steps": 1000}


def ran(plan):
    return tracing.execute(plan, workers=1)


@pytest.fixture(scope="module")
def course(jit_on):
    """`kamui` on `course` without noise."""
    with jit_on():
        return ran(job.prepare_trace("course", noise=STILL))


@pytest.fixture(scope="module")
def noisy(jit_on):
    """The first 1000 steps of two runs at 1 cm, of two settings."""
    with jit_on():
        return ran(job.prepare_trace("course", noise=Noise(range_m=0.01), runs=2, sweep=["votes=5,3"], **SHORT))


def kinds(found):
    return "".join(
        {"terminal": "T", "obstacle": "O", "divergence": "D", "free_space": "F"}[n.type] for n in found.nodes
    )


@pytest.mark.slow
def test_the_crawlers_course(course):
    table, driven = course.table, course.driven
    assert kinds(course.first) == "TOOODFFDT"
    assert code(course.first) == code(course.truth)
    assert table["outcome"].tolist() == ["GOAL"]
    assert table["contacts"].tolist() == table["interventions"].tolist() == [0]
    assert table["time_s"][0] == table["steps"][0] * DT_S == len(driven.truth) * DT_S
    for found, true in zip(course.first.nodes, course.truth.nodes):
        off = math.hypot(found.x_m - true.x_m, found.y_m - true.y_m)
        assert off < {"divergence": 0.2, "obstacle": 0.1, "free_space": 0.3, "terminal": 0.6}[true.type]
    # Pose and estimate are of one moment; matching scans adds some millimetres each time, along passages above all.
    np.testing.assert_allclose(driven.truth[:, :2], driven.estimate[:, :2], atol=0.15)
    np.testing.assert_allclose(driven.truth[:, 2], driven.estimate[:, 2], atol=0.02)  # each matched scan adds its error


@pytest.mark.slow
@pytest.mark.jit
def test_the_map_that_the_robot_writes_agrees_with_that_of_the_whole_grid(course):
    world = course.plan.world
    free = ~world.occupied
    cell = tuple(int(v / world.cell_m) for v in world.course.start_pose[1::-1])
    grid_map = extract(free, np.ones_like(free), world.cell_m, start_rc=cell)
    ours, theirs = ([n for n in m.nodes if n.type == "divergence"] for m in (grid_map, course.first))
    assert len(ours) == len(theirs) + 3 == 5  # the grid also shows the three ends that the robot did not go to
    for node in theirs:
        (near,) = (n for n in ours if math.hypot(n.x_m - node.x_m, n.y_m - node.y_m) <= 2 * world.cell_m)
        assert len(grid_map.bearings_deg(near.id)) == len(course.first.bearings_deg(node.id))


@pytest.mark.slow
def test_every_field_of_the_tables_is_set(course):
    found = course.first
    for node in found.nodes:
        assert math.isclose(sum(found.angles_deg(node.id)), 360)
        if node.type == "obstacle":
            assert node.obstacle == "slope"
            assert abs(node.inclination_deg - 10) < 1
            assert abs(node.posture_deg - 10) < 1
    for link in found.links:
        if link.status == "searched":
            assert link.length_m > 0
            assert abs(link.min_width_m - 2) < 0.1
            assert link.posture_deg is not None
        else:
            assert link.end == -1
            assert abs(link.opening_m - 2) < 0.2
    lengths = [link.length_m for link in found.links if link.status == "searched"]
    true = [link.length_m for link in course.truth.links if link.status == "searched"]
    assert np.abs(np.array(lengths) - true).max() < 0.8


@pytest.mark.slow
def test_both_divergences_are_turned_right_and_modes_come_in_the_order_of_the_text(course):
    heading = course.driven.truth[:, 2]
    assert math.cos(heading[-1]) < math.cos(math.pi - 0.1)
    mode = course.driven.mode
    order = [RunMode(m) for m in mode[np.flatnonzero(np.diff(mode, prepend=-1))]]
    central, branch, wall = RunMode.CENTRAL, RunMode.BRANCH_SELECTION, RunMode.WALL_FOLLOWING
    assert order == [central, branch, central, wall, central, branch, central]


@pytest.mark.slow
def test_the_middle_of_passages_is_kept(course):
    x, y, _ = course.driven.truth.T
    passage = (x < 15) & (np.abs(y - 27) < 2) & (course.driven.mode == RunMode.CENTRAL)
    assert passage.sum() > 200
    assert np.abs(y[passage] - 27).max() < 0.05
    hall = (np.abs(x - 17.4) < 2) & (y > 12.5) & (y < 23)
    assert np.abs(x[hall & (y > 16.5)] - 17.4).max() < 0.05
    # Where the hall ends the nearest wall on its side is its corner, behind the robot.
    assert np.abs(x[hall] - 17.4).max() < 0.15


@pytest.mark.slow
@pytest.mark.jit
def test_the_wheeled_robot_without_the_slope():
    world = load_world("course:obstacle=none")
    world = world.replace(elevation=np.full(world.shape, 1e-9))  # ground like that of the course: it shares a program
    found = ran(job.prepare_trace(world, robot="wheeled", noise=STILL))
    assert kinds(found.first) == "TDFFDT"
    assert code(found.first) == code(found.truth)


@pytest.mark.slow
@pytest.mark.jit
def test_the_wheeled_robot_cannot_pass_the_slope():
    found = ran(job.prepare_trace("course", robot="wheeled", noise=STILL))
    assert kinds(found.first) == "TO"
    assert found.table["outcome"].tolist() == ["EXHAUSTED"]
    assert found.table["refused"].tolist() == [0]  # it has seen it
    (onward,) = (link for link in found.first.links if link.status == "un-searched")
    assert onward.attributes["blocked"] is True
    assert onward.attributes["blocked_for"]["name"] == "wheeled"
    assert jx.btm.route(found.first, "wheeled", 0, "unsearched").trouble
    assert jx.btm.route(found.first, "kamui", 0, "unsearched").onward.link == onward.id  # it climbs more
    assert found.first.nodes[1].obstacle == "slope"
    assert abs(found.first.nodes[1].inclination_deg - 10) < 2


@pytest.mark.slow
@pytest.mark.jit
@pytest.mark.parametrize(
    ("obstacle", "step_m"),
    [
        ("stairs,riser_m=0.15", 0.15),
        ("platform,riser_m=0.15", 0.15),
        ("sill,riser_m=0.06", 0.06),
        ("cross-slope", None),
    ],
)
def test_what_the_robot_goes_over_is_in_its_map(obstacle, step_m):
    found = ran(job.prepare_trace(f"course:obstacle={obstacle}", noise=Noise(range_m=0.01)))
    assert code(found.first) == code(found.truth)
    assert found.table["refused"].tolist() == [0]
    nodes = [node for node in found.first.nodes if node.type == "obstacle"]
    true = [node for node in found.truth.nodes if node.type == "obstacle"]
    for node, other in zip(nodes, true, strict=True):
        assert math.hypot(node.x_m - other.x_m, node.y_m - other.y_m) < 0.3
        assert node.step_m == (None if step_m is None else pytest.approx(step_m, abs=0.025))
    if obstacle.startswith("stairs"):
        assert found.first.links[1].max_step_m == pytest.approx(step_m, abs=0.04)
    else:
        assert found.first.links[0].max_step_m < 0.02  # level ground
    over = [link for link in found.first.links if link.max_roll_deg and link.max_roll_deg > 5]
    assert bool(over) == (step_m is None)  # whoever goes along a cross slope rolls


@pytest.mark.slow
@pytest.mark.jit
@pytest.mark.parametrize(
    "noise",
    [Noise(range_m=0.05), Noise(range_m=0.01, attitude_deg=1), Noise(range_m=0.01, slip=0.2)],
    ids=["ranges", "attitude", "slip"],
)
def test_a_noisy_sensor_makes_the_same_map(noise):
    found = ran(job.prepare_trace("course", noise=noise, runs=2))
    assert found.table["true"].all()


@pytest.mark.slow
@pytest.mark.jit
def test_a_riser_that_the_ground_refuses_is_an_obstacle():
    # The scanner looks over the stairs: higher ground looks like the end of the passage.
    robot = "kamui:scan_height_m=2"
    found = ran(job.prepare_trace("course:obstacle=stairs,riser_m=0.25", robot=robot, noise=Noise(range_m=0.01)))
    assert kinds(found.first) == "TO"
    assert found.table["outcome"].tolist() == ["EXHAUSTED"]
    (onward,) = (link for link in found.first.links if link.status == "un-searched")
    assert onward.attributes["blocked"] is True
    assert found.first.nodes[1].obstacle == "stairs"
    assert abs(found.first.nodes[1].step_m - 0.25) < 0.03


def test_ends_by_name():
    state = a_state()
    full = state.replace(writer=state.writer.replace(full=True))
    done = state.replace(writer=state.writer.replace(exhausted=True))
    for at, at_end, outcome in [
        (state, False, RunOutcome.RUNNING),
        (state, True, RunOutcome.GOAL),
        (full, False, RunOutcome.MAP_FULL),
        (done, False, RunOutcome.EXHAUSTED),
        (state.replace(helps=TUNING.helps), False, RunOutcome.RUNNING),
        (state.replace(since_node=TUNING.helps), False, RunOutcome.STUCK),
        (state.replace(blind=P.graph.blind_steps), False, RunOutcome.BLIND),
        (done, True, RunOutcome.GOAL),
    ]:
        assert int(mission._end(at, at_end, TUNING).outcome) == outcome


@pytest.mark.slow
def test_a_run_depends_on_its_number_and_settings_alone(noisy, jit_on):
    with jit_on():
        again = ran(job.prepare_trace("course", noise=Noise(range_m=0.01), runs=2, tuning=Tuning(votes=3), **SHORT))
    ours = noisy.table[noisy.table["setting"] == 1]
    for name in ("outcome", "steps", "path_m", "drift_m", "code", "inclination_deg"):
        assert ours[name].tolist() == again.table[name].tolist()
    assert noisy.table["drift_m"].nunique() == len(noisy.table)  # the runs differ


@pytest.mark.slow
def test_threads_change_nothing(noisy, jit_on):
    with jit_on():
        other = tracing.execute(noisy.plan, workers=2)
    assert other.table.equals(noisy.table)


AS_ON_COURSES = {"nodes": 32, "links": 64, "perception": "triangles"}


def box(height_m=1.6, width_m=1.6):
    """A closed room, on ground and with arrays like those of the course, with whose map it shares a program."""
    world = load_world("course")
    occupied = np.ones(world.shape, bool)
    occupied[2 : 2 + round(10 * height_m), 2 : 2 + round(10 * width_m)] = False
    return World(occupied=occupied, elevation=1e-9 + 0 * world.elevation, cell_m=0.1, name="box")


@pytest.mark.slow
@pytest.mark.jit
@pytest.mark.parametrize(
    ("change", "outcome"), [({"noise": Noise(invalid=1.0)}, "BLIND"), ({"max_steps": 100}, "STEP_LIMIT")]
)
def test_how_runs_may_end(change, outcome):
    found = ran(job.prepare_trace("course", **{"noise": STILL, **change}))
    assert found.table["outcome"].tolist() == [outcome]
    assert found.table["steps"][0] == {"BLIND": P.graph.blind_steps, "STEP_LIMIT": 100}[outcome]
    assert kinds(found.first) == "TT"  # it ends at a node, before which nothing has been searched
    way, onward = found.first.links
    assert (way.start, way.end, way.status) == (0, 1, "searched")
    assert way.length_m == pytest.approx(found.table["path_m"][0], abs=0.02)
    assert (onward.start, onward.status) == (1, "un-searched")
    assert apart_deg(onward.start_bearing_deg, math.degrees(found.driven.estimate[-1, 2])) == pytest.approx(0, abs=3)
    end = found.first.nodes[1]
    assert math.hypot(*(np.array([end.x_m, end.y_m]) - found.driven.truth[-1, :2])) < 0.1


@pytest.mark.slow
@pytest.mark.jit
def test_a_robot_that_drives_up_and_down_is_helped(course):
    building = jax.tree.map(jnp.asarray, course.plan.building)

    @jax.jit
    def help_robot(state, makes_node):
        draws = vehicle.draw_one(jax.random.key(0), STILL)
        senses = vehicle.read_sensors(draws, building, KAMUI, STILL, state.body)
        return approach.help_robot(state, senses, makes_node, building, KAMUI)

    body = vehicle.initial_body(building, KAMUI, jnp.asarray(course.plan.begins[0]))
    state = a_state(body=body, estimate=body.pose, odometry=body.pose, stray_from=body.pose[:2])
    late = state.replace(step=jnp.int32(P.motion.stray_steps), moved_step=jnp.int32(P.motion.stray_steps - 1))
    helped = help_robot(late, False)
    assert (int(helped.helps), int(helped.stray_step)) == (1, P.motion.stray_steps)
    off = late.replace(estimate=late.estimate.at[0].add(P.motion.stray_m + 0.1))
    for other, makes_node in ((off, False), (late, True), (late.replace(step=late.step - 1), False)):
        assert int(help_robot(other, makes_node).helps) == 0
    assert help_robot(off, False).stray_from.tolist() == off.estimate[:2].tolist()


@pytest.mark.slow
@pytest.mark.jit
def test_room_for_the_maps_of_buildings():
    plan = job.prepare_trace("rooms", sweep=["open_m=0,3"])
    assert plan.swept["open_m"].tolist() == [5, 3]  # 0 stands for another number, swept or not
    assert plan.size == (256, 512)
    triangles = job.prepare_trace("rooms", perception="triangles")
    assert triangles.size == (job.MIN_NODES, 2 * job.MIN_NODES)
    assert plan.size[0] >= plan.places
    many = plan.truth._replace(map=dataclasses.replace(plan.truth.map, nodes=plan.truth.map.nodes[:1] * 70))
    assert job.map_room(plan.world, many) == (256, 512)
    assert job.map_room(plan.world, many, links=30) == (256, 30)
    small = job.prepare_trace("course:obstacle=none", robot="wheeled", noise=STILL, nodes=4, links=6)
    assert (is_level(small.building.terrain), small.size, small.places) == (True, (4, 6), 6)


@pytest.mark.slow
@pytest.mark.jit
def test_a_room_without_a_passage():
    found = ran(job.prepare_trace(box(), start=(1.0, 1.0, 0), noise=STILL, **AS_ON_COURSES))
    assert found.table["outcome"].tolist()[0] in ("STUCK", "EXHAUSTED")
    assert found.table["steps"][0] < 1000


@pytest.mark.slow
@pytest.mark.jit
def test_without_a_goal_what_lies_behind_the_start_is_searched_as_well():
    found = ran(job.prepare_trace(box(2.0, 14.0), start=(6.0, 1.2, 0), noise=STILL, **AS_ON_COURSES))
    assert kinds(found.first) == "TDD"
    assert found.table["outcome"].tolist() == ["EXHAUSTED"]
    links = [(link.start, link.end, link.status) for link in found.first.links]
    assert links == [(0, 1, "searched"), (0, 2, "searched")]
    east, west = found.first.nodes[1:]
    assert [east.x_m, west.x_m] == pytest.approx([13.2, 1.2], abs=0.3)
    lengths = [link.length_m for link in found.first.links]
    assert lengths == pytest.approx([7.2, 4.8], abs=0.6)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"start": (0.3, 0.3, 0)}, "lies in a wall"),
        ({"start": (-3, 0.3, 0)}, "lies outside"),
        ({"robot": "kamui:width_m=2.2"}, "does not fit there"),
        ({"robot": "tank"}, "robot must be one of kamui, wheeled, got 'tank'"),
        ({"robot": "kamui:legs=4"}, "there is no 'legs'"),
        ({"robot": "kamui:width_m=wide"}, "width_m must be a number"),
        ({"sweep": ["votes=10"]}, "tuning.votes"),
        ({"noise": {"range_m": -1}}, "noise.range_m"),
        ({"sweep": ["vote=3"]}, "sweep must be NAME="),
        ({"sweep": ["votes=a"]}, "values must be numbers"),
        ({"sweep": ["circle=2:1.5"]}, "a range must rise"),
        ({"sweep": ["circle=1.2", "circle=1.5"]}, "names circle more than once"),
        ({"sweep": ["votes=2.5"]}, "votes must be integers"),
        ({"sweep": [f"{name}=" + ",".join(["1.5"] * 200) for name in ("circle", "same_m", "ahead_m")]}, "combinations"),
        ({"runs": 0}, "runs must be an integer"),
        ({"runs": 1000, "sweep": ["circle=1.2:2"], "settings": 10_000}, "use fewer"),
        ({"sweep": ["open_m=-1,3"]}, "tuning.open_m must be a number at least 0"),
        ({"max_steps": 5}, "max_steps"),
        ({"nodes": 1}, "nodes"),
        ({"links": 1}, "links"),
        ({"nodes": job.MOST_NODES + 1}, "nodes"),
    ],
)
def test_what_is_refused(arguments, says):
    refused(re.escape(says), job.prepare_trace, "course", **arguments)


def test_sweeps():
    values = job.swept_values(["votes=1,3", "circle=1.2,1.5"], 100, 0)
    assert {name: v.tolist() for name, v in values.items()} == {"votes": [1, 1, 3, 3], "circle": [1.2, 1.5, 1.2, 1.5]}
    values = job.swept_values(["votes=1:9", "circle=1.1:2.0", "noise.range_m=0,0.03"], 64, 0)
    assert set(values["votes"]) <= set(range(1, 10))
    assert len(set(np.floor((values["circle"] - 1.1) / 0.9 * 64))) == 64  # one in every 64th: Latin
    assert sorted(set(values["noise.range_m"])) == [0, 0.03]
    assert job.swept_values([], 100, 0) == {}
    assert job.prepare_trace("course", sweep=["open_m=0,3"]).swept["open_m"].tolist() == [2.5, 3]


@pytest.mark.slow
@pytest.mark.jit
def test_every_step_has_the_draws_of_its_own_number_and_no_key_is_used_twice(monkeypatch):
    """Beyond the first block of draws, and the second."""
    met, noise, key = [], jax.tree.map(jnp.float32, Noise(range_m=0.01, invalid=0.5)), jax.random.key(3)

    def make_step(draws, *rest):
        met.append(draws)
        return rest[-1].replace(step=rest[-1].step + 1)

    monkeypatch.setattr(mission, "make_step", make_step)
    task = mission.MissionTask(KAMUI, TUNING, noise, jnp.zeros(3), None)
    given = Given(key, (), (jnp.zeros((1, 1)),), jnp.int32(0), jnp.int32(100), task)
    with jax.debug_key_reuse(True):
        one, block = jax.jit(vehicle.draw_one), jax.jit(mission._draws_from)(key, 0, noise)
        wanted = [one(jax.random.fold_in(key, i), noise) for i in range(2 * mission.DRAWN_STEPS + 2)]
    state = a_state(draws=jax.tree.map(jnp.zeros_like, block))
    for _ in wanted:
        state = mission.advance(None, given, state)
    for ours, theirs in zip(met, wanted, strict=True):
        jax.tree.map(np.testing.assert_array_equal, ours, theirs)


def test_a_building_keeps_the_worlds_measures():
    world = load_world("course", 0.1)
    building = building_of(world, world.course.goal_m, np.array([[2.5, 27, 0.5]]))
    assert [batch.step_slots(n) for n in (1, 6000, 6001, 12001)] == [6000, 6000, 12000, 24000]
    assert building.walls.x.shape == building.walls.y.shape == (32, 3)
    assert building.terrain.height_m.shape == (FINER * 512, FINER * 512)  # the same size
    assert building_of(load_world("rooms", 0.1)).terrain.height_m.shape == (2, 2)  # level
    assert building.marks.shape == (64, 3)  # padded, so that buildings share programs
    assert building.marks[0].tolist() == pytest.approx([2.5, 27, 0.5])
    assert (building.marks[1:, :2] < -1e5).all()  # where nobody comes
    assert pose_in(world, (2.5, 27, 90)).tolist() == pytest.approx([2.5, 27, math.pi / 2])
    assert np.isnan(building_of(world).goal).all()


@pytest.mark.slow
@pytest.mark.jit
def test_lanes_give_the_same_maps_and_are_filled_again(noisy, monkeypatch):
    """As on an accelerator; five short runs in two lanes. The last of this file: it has a large program of its own."""
    plan, draws, done = noisy.plan, np.array([0, 1, 2, 1, 3], np.int32), []
    numbers = *plan.settings_of(np.zeros(5, int)), plan.starts_of(draws)
    how = {"max_steps": 120}
    alone = batch.run_missions(plan.building, *numbers, 5, draws, workers=1, **how).result
    monkeypatch.setattr(batch, "find_resources", functools.partial(batch.find_resources, in_lanes=True))
    report = batch.run_missions(
        plan.building, *numbers, 5, draws, engine="jax", lanes=2, on_progress=done.append, **how
    )
    lanes = report.result
    assert lanes.steps.tolist() == alone.steps.tolist() == [120] * 5
    np.testing.assert_array_equal(lanes.map.kind, alone.map.kind)
    np.testing.assert_allclose(lanes.path_m, alone.path_m, rtol=1e-4)
    assert lanes.path_m[1] == lanes.path_m[3]  # they draw alike
    assert len(set(lanes.path_m.tolist())) == 4
    assert len(report.driven.truth) == 120
    assert report.costs.lanes == 2
    assert report.costs.levels == {"kamui": ["JAX in lanes"]}
    assert report.costs.interrupted is False
    assert done[-1] == 5
