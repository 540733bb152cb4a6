"""The differential drive: its motion against the oracle, by pencil, and whole episodes."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref.pursuit import STEPS, Rider
from ref.refusals import refused

import jexplore as jx
from jexplore.engine.program import Given
from jexplore.exploration import environment, site
from jexplore.exploration.uncertain.poses import EIGHTH
from jexplore.exploration.uncertain.pursuit import begin_route, brake, pursue
from jexplore.grid import Grid
from jexplore.policies.closest import closest
from jexplore.rules import Lidar, Robot, Rules

RIDE = {"motion": "diff-drive"}
LIDAR = Lidar(n_beams=13, range_m=2.0)
SLOW = Robot(speed_m_s=0.4, acceleration_m_s2=0.4, lookahead_m=0.31)  # no whole cells: no ties
EAST, NORTH, WEST, SOUTH, NE = 0, 1, 2, 3, 4


def hall():
    occupied = np.ones((30, 44), bool)
    occupied[2:28, 2:42] = False
    return jx.World(occupied=occupied, cell_m=0.1, name="hall")


@functools.cache
def begun():
    own = site.prepare_site(hall(), LIDAR, Rules(motion="diff-drive"), robot=SLOW)
    numbers = jax.tree.map(jnp.asarray, own.numbers)
    scenes = jax.tree.map(lambda a: jnp.asarray(a)[None], own.truth)
    task = jnp.int32([6, 6, 0])
    given = Given(jax.random.key(3), jax.tree.map(jnp.asarray, own.beams), scenes, jnp.int32(0), numbers, task)
    setup = own.setup._replace(policy=closest()._replace(params=()))
    state = jax.jit(environment.begin, static_argnums=0)(setup, given)
    free = ~scenes.occupied[0]
    grid = Grid((~free).astype(jnp.int32), free.astype(jnp.int32))
    return given, state.replace(belief=state.belief.replace(grid=grid)), jax.jit(pursue)


def on_route(motions, heading=0, closed=()):
    """A robot at cell (6, 6) that begins to follow motions: state, route, target."""
    _, state, _ = begun()
    cell, route = (6, 6), {}
    for motion in motions:
        route[cell] = motion
        cell = cell[0] + STEPS[motion][0], cell[1] + STEPS[motion][1]
    laid = np.full(state.shape, -1, np.int8)
    for at, motion in route.items():
        laid[at] = motion
    grid, belief = state.belief.grid, state.belief
    for at in closed:
        grid = Grid(grid.hits.at[at].add(100), grid.misses)
    state = state.replace(
        target=jnp.int32(cell), heading=jnp.int32(heading),
        belief=belief.replace(grid=grid, heading=jnp.int32(heading)),
    )  # fmt: skip
    return begin_route(state, jnp.asarray(laid)), route, cell


ROUTES = {
    "straight": ([EAST] * 20, 0, ()),
    "corner": ([EAST] * 10 + [NORTH] * 12, 0, ()),
    "behind it": ([WEST] * 3 + [NE] * 8, 0, ()),
    "stairs": ([EAST, NORTH] * 8 + [WEST] * 6, 3, ()),
    "into a closed cell": ([EAST] * 10 + [NORTH] * 5, 0, tuple((9, col) for col in range(13, 20))),
}


@pytest.mark.jit
@pytest.mark.parametrize("name", ROUTES)
def test_a_motion_is_that_of_plain_numpy(name):
    motions, heading, closed = ROUTES[name]
    given, _, step = begun()
    state, route, target = on_route(motions, heading, closed)
    rider = Rider(SLOW, 0.1, (6.5, 6.5, heading * EIGHTH))
    rider.anchor = (6, 6)
    assert given.numbers.unsure.ride.tick_ms == round(1000 * rider.period_s) == 200
    for _ in range(70):
        state, stopped = step(given, state, jnp.bool_(True))
        assert bool(stopped) == rider.tick(route, target, lambda row, col: (row, col) not in closed)
        pose, ride = np.asarray(state.poses.true, float), state.poses.ride
        np.testing.assert_allclose(pose[:2], [rider.x, rider.y], atol=0.02)
        off = pose[2] + int(state.heading) * EIGHTH - rider.heading
        assert abs((off + math.pi) % (2 * math.pi) - math.pi) < 0.05
        found = ride.speed, ride.turn, ride.turned_rad, ride.braked, state.poses.way_m
        np.testing.assert_allclose(found, [rider.v, rider.w, rider.turned, rider.braked, rider.way], atol=0.02)
        assert bool(ride.careful) == rider.careful
        assert abs(ride.turn) <= SLOW.turn_rad_s + 1e-6
        if stopped:
            break
    assert bool(stopped) == bool(closed)
    assert closed or (int(state.row), int(state.col)) == target


@pytest.mark.jit
def test_a_straight_way_by_pencil():
    """0.4 m/s after a second and 0.2 m; 2 m from standing to standing take 6 s."""
    given, _, step = begun()
    state, _, _ = on_route([EAST] * 20)
    ticks = 0
    while ticks == 0 or state.poses.ride.speed > 0:
        state, _ = step(given, state, jnp.bool_(True))
        ticks += 1
        assert ticks < 40
        if ticks == 5:
            assert state.poses.ride.speed == pytest.approx(4.0)
            assert state.poses.way_m == pytest.approx(0.2, abs=0.011)  # in steps of 0.05 s
    assert 0.2 * ticks == pytest.approx(6, abs=0.41)
    assert state.poses.way_m == pytest.approx(2.0, abs=0.11)
    assert state.poses.ride.braked == pytest.approx(1.0, abs=1e-3)
    assert state.poses.ride.turned_rad == 0
    idle, _ = step(given, state, jnp.bool_(False))
    np.testing.assert_array_equal(idle.poses.true, state.poses.true)


def test_braking_takes_its_time_and_energy():
    given, state, _ = begun()
    poses = state.poses
    fast = state.replace(poses=poses.replace(ride=poses.ride.replace(speed=jnp.float32(2.0), turn=jnp.float32(1.0))))
    after = brake(given, fast, True)
    assert after.time_ms - fast.time_ms == 500  # 0.2 m/s at 0.4 m/s^2
    assert after.poses.ride.braked == pytest.approx(0.25)
    assert after.poses.ride.speed == after.poses.ride.turn == 0
    assert brake(given, fast, jnp.bool_(False)).poses.ride.speed == 2.0


def crooked():
    """Corridors one cell wide, with dead ends and right angles: narrower than any arc."""
    rows = ["###########", "#...#...#.#", "###.#.#.#.#", "#...#.#...#", "#.###.###.#", "#.....#...#", "###########"]
    occupied = np.array([[c == "#" for c in row] for row in rows])
    return jx.World(occupied=occupied, cell_m=0.1, name="crooked")


@pytest.fixture(scope="module")
def ridden(jit_on):
    rules = RIDE | {"clearance_m": 0.0, "near_m": 0.0, "frontier_connectivity": 4}
    with jit_on():
        return jx.compare(crooked(), ["closest", "closest+recheck"], episodes=3, rules=rules, lidar=LIDAR)


@pytest.mark.jit
def test_pockets_narrower_than_its_turn_are_explored(ridden):
    found = ridden.episodes
    assert (found["outcome"] == "COMPLETE").all()
    assert (found["turning_rad"] > 0).all()
    assert (found["path_m_at_90"] <= found["path_m"]).all()
    assert (found["time_s_at_90"] <= found["time_s"]).all()
    robot = Robot()
    least = robot.standby_w * found["time_s"] + robot.drive_j_m * found["path_m"]
    least += robot.turn_j_rad * found["turning_rad"]
    assert (found["energy_j"] >= least - 1e-3).all()
    assert (found["time_s"] >= found["path_m"] / robot.speed_m_s).all()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"rules": {"motion": "flying"}}, r"unknown motion 'flying' \(there are: lattice, diff-drive\)"),
        ({"rules": RIDE, "pose": "icp"}, "motion diff-drive is for a robot whose pose is given: pose must be true"),
        ({"rules": RIDE | {"scan_every_m": 1}}, "rules.scan_every_m is for the lattice"),
        ({"rules": RIDE, "lidar": {"forward_m": 0.1}}, "lidar.forward_m and left_m must be 0"),
        (
            {"rules": RIDE, "robots": 2},
            "teams are of robots whose pose is given, on the lattice: motion must be lattice",
        ),
        ({"rules": RIDE, "robot": {"speed_m_s": 0}}, "robot.speed_m_s must be a number at least 0.001"),
        ({"rules": RIDE, "robot": {"turn_rad_s": 0}}, "robot.turn_rad_s must be a number at least 0.001"),
        ({"rules": RIDE, "robot": {"plan_s": -1}}, "robot.plan_s must be a number at least 0"),
        ({"rules": RIDE, "robot": {"scan_period_s": -0.2}}, "robot.scan_period_s must be a number at least 0"),
        ({"rules": RIDE, "robot": {"tolerance_m": 0}}, "robot.tolerance_m must be a number at least 0.01"),
    ],
)
def test_wrong_options_are_refused_in_a_line(given, message):
    refused(message, jx.compare, hall(), ["closest"], episodes=1, **given)
