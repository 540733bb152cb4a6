"""Halls: gateways against walls that are drawn, the direction along a wall, and what a robot does before a gateway."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref.runs import a_state

from jexplore import btm
from jexplore.driving import behaviour, mapping
from jexplore.driving.params.tree import P
from jexplore.driving.records import Latch, RunMode, Surround
from jexplore.driving.sensing import gateways, surround
from jexplore.driving.sensing.surround import SECTORS
from jexplore.driving.settings import ROBOTS, Tuning, for_world

KAMUI = ROBOTS["kamui"]
TUNING = for_world(Tuning(), is_course=False)
COAST_M = TUNING.coast_m
REACH_M = 8.0
FIND = jax.jit(lambda xy, known, middle, out: gateways.find_gateway(xy, known, middle, out, TUNING.width_m))


def turned(xy, angle):
    cos, sin = math.cos(angle), math.sin(angle)
    return np.asarray(xy) @ np.array([[cos, sin], [-sin, cos]])


def surround_of(*walls, seed=None):
    """Return the `Surround` of a robot at the origin that has looked all round: walls are `(x0, y0, x1, y1)`."""
    angle = np.radians(np.arange(SECTORS) * (360 / SECTORS) - 180)
    way = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    range_m = np.full(SECTORS, math.inf)
    for x0, y0, x1, y1 in walls:
        dx, dy = x1 - x0, y1 - y0
        cross = way[:, 0] * dy - way[:, 1] * dx
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (x0 * dy - y0 * dx) / cross
            s = np.where(abs(dx) > abs(dy), (t * way[:, 0] - x0) / dx, (t * way[:, 1] - y0) / dy)
        range_m = np.where((t > 0) & (s >= 0) & (s <= 1) & (t < range_m), t, range_m)
    if seed is not None:
        range_m = range_m + np.random.default_rng(seed).normal(0, 0.01, SECTORS)
    range_m[range_m > REACH_M] = math.inf
    with np.errstate(invalid="ignore"):
        xy = np.where(np.isfinite(range_m)[:, None], range_m[:, None] * way, math.inf)
    return Surround(*jnp.asarray(xy.T, jnp.float32))


def with_gap(away_m, wide_m, *, at_m=0.0, deep_m=4.0, more=()):
    """The wall of a hall to the right, with a passage: `(x0, y0, x1, y1)` each."""
    one, other = at_m - wide_m / 2, at_m + wide_m / 2
    wall = [(-9.0, -away_m, one, -away_m), (other, -away_m, 9.0, -away_m)]
    jambs = [(x, -away_m, x, -away_m - deep_m) for x in (one, other)]
    return [*wall, *jambs, (one, -away_m - deep_m, other, -away_m - deep_m), *more]


def found(around, middle, out):
    there, *rest = FIND(*surround.known_points(around), jnp.asarray(middle, jnp.float32), jnp.float32(out))
    return bool(there), *(np.asarray(a) for a in rest)


@pytest.mark.jit
@pytest.mark.parametrize("wide_m", [0.8, 2.0, 4.0])
@pytest.mark.parametrize("away_m", [1.2, 1.9])
@pytest.mark.parametrize("off_deg", [-15, 10])
@pytest.mark.parametrize("corner", [False, True])
def test_a_gateway_beside_the_robot(wide_m, away_m, off_deg, corner):
    """Though the robot's heading is not quite along its wall, and the wall of a corner stands square to that."""
    more = [(wide_m / 2 + 1.2, -away_m, wide_m / 2 + 1.2, 9.0)] if corner else []
    walls = with_gap(away_m, wide_m, more=more)
    walls = [
        np.concatenate([turned(w[:2], math.radians(off_deg)), turned(w[2:], math.radians(off_deg))]) for w in walls
    ]
    there, middle, out, width_m = found(surround_of(*walls, seed=0), (0, -COAST_M), -math.pi / 2)
    assert there
    assert middle == pytest.approx(turned((0, -away_m), math.radians(off_deg)), abs=0.15)
    assert math.degrees(out) == pytest.approx(-90 + off_deg, abs=4)
    assert width_m == pytest.approx(wide_m, abs=0.3)


@pytest.mark.jit
@pytest.mark.parametrize("turn", [-2.5, 0.7])
def test_a_gateway_in_any_direction(turn):
    """Not expected to the right: the same, turned."""
    walls = [np.concatenate([turned(w[:2], turn), turned(w[2:], turn)]) for w in with_gap(1.5, 1.2, at_m=0.3)]
    there, middle, out, _ = found(surround_of(*walls), turned((0, -1.5), turn), turn - math.pi / 2)
    assert there
    assert middle == pytest.approx(turned((0.3, -1.5), turn), abs=0.1)
    assert btm.wrapped(float(out) - turn + math.pi / 2) == pytest.approx(0, abs=0.05)


@pytest.mark.jit
@pytest.mark.parametrize(
    "walls",
    [
        [(-9.0, -1.5, 9.0, -1.5)],  # none
        with_gap(1.5, 1.2, deep_m=0.4),  # a recess
        with_gap(1.5, 0.3),  # too narrow for any robot
        with_gap(1.5, 5.5),  # the hall itself
        with_gap(1.5, 1.2, at_m=2.5),  # not abeam of the robot
        [],
        [(-9.0, -1.5, 0.0, -1.5)],  # the wall's end
    ],
)
def test_what_is_no_gateway(walls):
    assert not found(surround_of(*walls), (0, -COAST_M), -math.pi / 2)[0]


def test_ways_from_before_a_gateway():
    ways = gateways.gateway_exits(jnp.float32(math.radians(100)), jnp.float32(math.hypot(COAST_M, 0.5)), COAST_M, 8)
    n = int(ways.valid.sum())
    assert n == 3
    assert np.degrees(ways.bearing[:n]).tolist() == pytest.approx([-170, 10, 100], abs=1e-3)
    assert ways.width_m[:n].tolist() == pytest.approx([2 * COAST_M, 2 * COAST_M, 1.0], abs=1e-5)
    assert np.hypot(*ways.middle[:n].T).tolist() == pytest.approx([1.5811, 1.5811, 1.5], abs=1e-3)
    assert int(ways.overflow) == 0


def along(walls, side=-1):
    """Direction in degrees; seen in a mirror it is the other way round."""
    degrees = math.degrees(float(surround.wall_direction(surround_of(*walls), jnp.int32(side), COAST_M, KAMUI)))
    mirrored = [(x0, -y0, x1, -y1) for x0, y0, x1, y1 in walls]
    other = math.degrees(float(surround.wall_direction(surround_of(*mirrored), jnp.int32(-side), COAST_M, KAMUI)))
    assert abs(btm.wrapped(math.radians(degrees + other))) < 1e-4
    return degrees


@pytest.mark.parametrize(
    ("walls", "low", "high"),
    [
        ([(-9, -1.4, 9, -1.4)], -5, 5),  # along it
        ([(-9, -0.8, 9, -0.8)], 10, 60),  # away from one that is near
        ([(-9, -2.6, 9, -2.6)], -95, -10),  # towards one that is far
        ([(-9, -1.4, 1.6, -1.4), (1.6, -1.4, 1.6, 9)], 60, 100),  # round a corner inside
        ([(-9, -1.4, -0.8, -1.4), (-0.8, -1.4, -0.8, -9)], -90, -20),  # and one outside
        (with_gap(1.4, 1.2), -5, 5),  # past a gateway
        ([(1.5, -9, 1.5, 9)], 80, 120),  # who comes to a wall has it to the right then
        ([], 0, 0),
        ([(-9, -5, 9, -5)], 0, 0),  # far from any wall straight on
    ],
)
def test_the_direction_along_a_wall(walls, low, high):
    assert low - 1e-3 <= along(walls) <= high + 1e-3


@pytest.mark.parametrize(
    ("bearing", "inside", "side"),
    [(0.3, False, 0), (0.3 + math.pi / 2, True, -1), (0.3 - math.pi / 2, True, 1), (0.3 + math.pi / 2 - 0.2, True, -1)],
)
def test_which_wall_is_followed_from_a_gateway_on(bearing, inside, side):
    drive = behaviour.initial_drive().replace(out=jnp.float32(bearing), side=jnp.int32(5))
    space = behaviour.no_free_space().replace(inside=jnp.bool_(True), streak=jnp.int32(2))
    after, gone = behaviour.leave_gateway(space, drive, jnp.float32(0.3))
    assert (bool(after.inside), int(after.streak), int(gone.side)) == (inside, 0, side)
    after, gone = behaviour.leave_gateway(space, drive, jnp.float32(math.nan))
    assert (bool(after.inside), int(after.streak), int(gone.side)) == (True, 2, 5)


def crossing(inside, width_m, node, *, pose=(10.0, 4.0, math.pi / 2)):
    """Return the result for a robot that has driven north for two metres past the border at a place.

    Walls before that are `width_m` apart, and the last node is a divergence somewhere.
    """
    writer = mapping.begin_map(mapping.SLOPE_STEPS, 4, 4, jnp.array([0.0, 0.0, 0.0]), False)
    map_, last = btm.add_node(writer.map, btm.DIVERGENCE, *node, radius_m=1.6)
    gone_m = np.arange(mapping.SLOPE_STEPS) * 0.2
    at = np.searchsorted(gone_m, gone_m[-1] - 2)
    poses = np.array([(pose[0], pose[1] + m - gone_m[at], pose[2]) for m in gone_m])
    width = np.where(gone_m <= gone_m[at], width_m, math.inf)
    fields = {"odometer_m": gone_m, "pose": poses, "width_m": width}
    way = writer.way.replace(**{name: jnp.asarray(a, jnp.float32) for name, a in fields.items()})
    writer = writer.replace(map=map_, node=last, way=way)
    return gateways.gateway_crossed(writer, jnp.bool_(inside), jnp.float32(gone_m[at]), TUNING)


def test_the_gateway_by_which_a_hall_is_entered_or_left():
    """Told from where the robot was at the border, though it is noticed later."""
    comes = crossing(True, 1.0, (0.0, 0.0))
    assert comes.centre.tolist() == pytest.approx([10, 4 + COAST_M], abs=1e-4)
    assert float(comes.out) == pytest.approx(math.pi / 2 + math.pi, abs=1e-4)
    assert float(comes.radius) == pytest.approx(math.hypot(COAST_M, 0.5))
    goes = crossing(False, 1.0, (0.0, 0.0))
    assert goes.centre.tolist() == pytest.approx([10, 4 - COAST_M], abs=1e-4)
    assert float(goes.out) == pytest.approx(math.pi / 2)


def gone_round(
    turned_deg, *, gone_m=20.0, off_m=0.5, side=-1, at_node=False, inside=True, latch=Latch.FREE, n_nodes=1, heading=0.1
):
    """Return `(drive, is_round)` of a robot some way past where it began to follow a wall."""
    began = jnp.array([2.0, 3.0, math.radians(turned_deg), 50.0, heading])
    drive = behaviour.initial_drive().replace(side=jnp.int32(side), latch=jnp.int32(latch), began=began)
    writer = mapping.begin_map(mapping.SLOPE_STEPS, 4, 4, jnp.array([0.0, 0.0, 0.0]), False)
    writer = writer.replace(map=writer.map.replace(n_nodes=jnp.int32(n_nodes)))
    state = a_state(mode=jnp.int32(RunMode.WALL_FOLLOWING), odometer_m=jnp.float32(50 + gone_m))
    space = behaviour.no_free_space().replace(inside=jnp.bool_(inside))
    around = surround_of((-9, side * 1.4, 9, side * 1.4))
    estimate = jnp.array([2.0 + off_m, 3.0, 0.1])
    return behaviour.go_round(state, drive, space, writer, around, estimate, jnp.bool_(at_node), TUNING)


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("change", [{}, {"gone_m": 3.0}, {"off_m": 2.5}, {"turned_deg": 180}, {"inside": False}])
def test_a_hall_without_a_gateway_is_gone_round_once(side, change):
    drive, is_round = gone_round(**{"turned_deg": -side * 350, "side": side, **change})
    assert bool(is_round) == (not change)
    assert int(drive.latch) == Latch.FREE


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("more", [{"turned_deg": 350}, {"turned_deg": -350, "n_nodes": 2}])
def test_what_stands_in_a_hall_is_left_straight_across(side, more):
    """So is a wall without a gateway, where the robot has come from elsewhere."""
    drive, is_round = gone_round(**{**more, "turned_deg": side * more["turned_deg"]}, side=side)
    assert not bool(is_round)
    assert (int(drive.latch), int(drive.side)) == (Latch.LEAVE, 0)
    out = 0.1 - side * math.pi / 2
    away = (drive.target - jnp.array([2.5, 3.0])).tolist()
    assert away == pytest.approx(
        [P.motion.leave_island_m * math.cos(out), P.motion.leave_island_m * math.sin(out)], abs=1e-4
    )
    assert math.isnan(float(drive.began[0]))


def test_walls_are_followed_in_halls_alone():
    around = surround_of((-9, -1.4, 9, -1.4))
    course = for_world(Tuning(), is_course=True)
    for mode in RunMode:
        direction = float(behaviour.coast_direction(jnp.int32(mode), jnp.int32(-1), around, TUNING, KAMUI))
        assert math.isfinite(direction) == (mode == RunMode.WALL_FOLLOWING)
        assert math.isnan(float(behaviour.coast_direction(jnp.int32(mode), jnp.int32(-1), around, course, KAMUI)))
