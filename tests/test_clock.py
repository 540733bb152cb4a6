"""Times of motions: by hand, against the oracle, and laws; columns of time and energy."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ref import clock as oracle
from ref import episodes, maps
from ref.refusals import refused
from ref.results import result

import jexplore as jx
from jexplore.exploration import results
from jexplore.exploration.motion import MOST_MS, PLAN, RUN, SCAN, TURN, clock_table
from jexplore.rules import Lidar, Robot, Rules

# A metre a second after one metre, and a quarter turn a second after half of one.
CROSS = Lidar(n_beams=4, fov_deg=360, range_m=2.0)  # ahead, back, left, right, 2 cells far
PLAIN = Robot(speed_m_s=1.0, acceleration_m_s2=0.5, turn_rad_s=math.pi / 2, turn_acceleration_rad_s2=math.pi / 2)
SLOW = PLAIN.replace(scan_s=0.5, plan_s=2.0, standby_w=10, drive_j_m=3, turn_j_rad=2, mass_kg=8)


def entries(robot, cell_m=1.0, longest=4):
    return clock_table(robot, cell_m, longest)[RUN:].reshape(longest + 1, 2, 3)


def test_a_table_by_hand():
    """v / a = 2 s and v^2 / a = 2 m: within one metre it speeds up, from two on it cruises before it brakes."""
    table = clock_table(SLOW, 1.0, 4)
    assert (table[SCAN], table[PLAN]) == (500, 2000)
    # 45 degrees: speeding up and slowing down, 2 sqrt(1/2) s; 90: 2 s; then a second for every quarter turn.
    assert table[TURN : TURN + 5].tolist() == [0, 1414, 2000, 2500, 3000]
    straight, diagonal = entries(SLOW).transpose(1, 0, 2)
    assert straight.tolist() == [
        [0, 0, 0],
        [2000, 2828, 500],
        [3000, 4000, 1000],
        [4000, 5000, 1000],
        [5000, 6000, 1000],
    ]
    assert diagonal[1].tolist() == [2414, 3364, 707]


@settings(max_examples=50, deadline=None)
@given(speed=st.floats(0.01, 10), acceleration=st.floats(0.01, 10), cell_m=st.floats(0.01, 2))
def test_a_table_is_the_oracles(speed, acceleration, cell_m):
    robot = Robot(speed_m_s=speed, acceleration_m_s2=acceleration)
    table = entries(robot, cell_m, 30)
    for n in range(1, 31):
        for k, step in enumerate((1, math.sqrt(2))):
            way = n * step * cell_m
            want = (
                1000 * oracle._reach_s(way, speed, acceleration),
                1000 * oracle.stop_s(way, speed, acceleration),
                oracle.share(way, speed, acceleration),
            )
            np.testing.assert_allclose(table[n, k], want, atol=0.501)
    assert (np.diff(table, axis=0) >= 0).all()


def test_a_clock_stands_still_rather_than_overflow():
    table = clock_table(Robot(speed_m_s=0.001, acceleration_m_s2=0.001), 100.0, 1000)
    assert table.min() >= 0
    assert 5 * int(table.max()) + MOST_MS < 2**31


@pytest.mark.slow
@pytest.mark.jit
@pytest.mark.parametrize("number", range(2))
def test_episodes_by_hard_numbers_are_the_oracles(number):
    """Of other robots, in a world of rooms; whole numbers on both sides."""
    rng = np.random.default_rng(number)
    robot = Robot(*(float(value) for value in rng.uniform(0.05, 2, 6)))
    world = jx.load_world("rooms#3:width_m=8,height_m=8", cell_m=0.2)
    start = tuple(episodes.clear_cells(world.occupied, 4)[7 * number].tolist())
    strategy = ("closest", "closest+recheck")[number % 2]
    lidar, rules = Lidar(n_beams=37, range_m=3.0), Rules()
    for native in (False, True):
        episodes.compared(
            world.occupied, (*start, 45 * number), strategy, lidar, rules, cell_m=0.2, robot=robot, native=native
        )


@pytest.mark.slow
@pytest.mark.jit
def test_paths_do_not_depend_on_the_robot_and_engines_agree():
    tables = [
        jx.compare(
            "rooms#3:width_m=8,height_m=8", ["closest+recheck", "random"], episodes=3, cell_m=0.2, robot=robot,
            engine=engine,
        ).episodes
        for robot, engine in ((Robot(), "auto"), (SLOW, "auto"), (SLOW, "jax"))
    ]  # fmt: skip
    timed = [name for name in tables[0] if name.startswith("time_s")] + ["area_s", "energy_j"]
    assert tables[1].equals(tables[2])
    assert tables[0].drop(columns=timed).equals(tables[1].drop(columns=timed))
    assert (tables[1]["time_s"] != tables[0]["time_s"]).all()
    found = tables[0]
    marks = found[["time_s_at_50", "time_s_at_90", "time_s_at_95", "time_s_at_99", "time_s"]].to_numpy()
    assert (np.diff(marks, axis=1) >= 0).all()
    assert (found["time_s"] >= found["path_m"] / Robot().speed_m_s).all()


def test_energy_and_areas_by_hand():
    along = np.full((2, 100), 3)
    along[1, 50:] = -1
    episode = result(
        2, straight=[3, 4], diagonal=[0, 0], turns=[4, 0], time_ms=[7000, 5000], starts=[1500, 1000],
        straight_along=along, diagonal_along=np.minimum(along, 0), time_along=1000 * along,
    )  # fmt: skip
    found = results.columns(episode, np.zeros((2, 3), int), seed=0, cell_m=1.0, has_rooms=False, robot=SLOW)
    assert found["time_s"].tolist() == [7.0, 5.0]
    # 10 W for 7 s, 3 J/m over 3 m, 2 J/rad over pi, and 1.5 times 8 kg (1 m/s)^2 / 2.
    assert found["energy_j"].tolist() == pytest.approx([70 + 9 + 2 * math.pi + 6, 50 + 12 + 4])
    assert found["area_m"].tolist() == [3.0, 3.5]  # half of the cells were never known: the whole path stands for them
    assert found["area_s"].tolist() == [3.0, 4.0]


@pytest.mark.parametrize(
    "wrong",
    [
        {"speed_m_s": 0}, {"turn_rad_s": -1}, {"acceleration_m_s2": 0}, {"scan_s": -0.1}, {"plan_s": math.nan},
        {"mass_kg": -1}, {"speed": 1},
    ],
)  # fmt: skip
def test_wrong_robots_are_refused_in_one_line(wrong):
    refused(next(iter(wrong)), Robot, **wrong)


BEND = maps.walls("""
    #####
    #...#
    #.#.#
    #.#.#
    #####
""")


def played(occupied, start, robot, rules):
    how = {"cell_m": 1.0, "robot": robot, "shape": (5, 7)}  # one program
    found, _, want = episodes.compared(occupied, start, "closest", CROSS, rules, **how)
    return found, want


STRAIGHT_ON = Rules(clearance_m=0.0, near_m=1.0, look_around=False)


@pytest.mark.jit
def test_a_bend_by_hand():
    """Three runs of 2 m, and two quarter turns in place between."""
    found, _ = played(BEND, (1, 1, 90), PLAIN, STRAIGHT_ON)
    assert (int(found.turns), int(found.time_ms), int(found.starts)) == (4, 3 * 4000 + 2 * 2000, 3000)
