"""Writing a map: changes of level from pitch alone, and every kind of node by hand."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref.passages import wall
from ref.runs import a_due_node

from jexplore import btm
from jexplore.btm import DIVERGENCE, FREE_SPACE, NONE, OBSTACLE, SEARCHED, TERMINAL, UNSEARCHED
from jexplore.driving import mapping, nodes
from jexplore.driving.params.tree import P
from jexplore.driving.records import Latch
from jexplore.driving.settings import ROBOTS, Tuning, for_world
from jexplore.tracemap import record
from jexplore.tracemap.similarity import code

pytestmark = pytest.mark.jit
TUNING, KAMUI = for_world(Tuning(), is_course=True), ROBOTS["kamui"]
EAST, NORTH, WEST, SOUTH = (math.radians(angle) for angle in (0, 90, 180, -90))


STEP_M = 0.04  # at 0.4 m/s and 0.1 s a step


def pitch_deg(odometer, creases, grounds, length_m):
    """A body on ground whose inclination changes at creases turns evenly while it is over one."""
    pitch = np.full(odometer.shape, float(grounds[0]))
    for crease, before, after in zip(creases, grounds, grounds[1:]):
        pitch += (after - before) * np.clip((odometer - crease) / length_m + 0.5, 0, 1)
    return pitch


WATCH = jax.jit(
    lambda pitch, odometer, even_m: jax.lax.scan(
        lambda level, now: _watched(level, *now, even_m), mapping.begin_map(1, 1, 1, jnp.zeros(3), False).level,
        (pitch, odometer),
    )[1]
)  # fmt: skip


def _watched(level, pitch, odometer_m, even_m):
    lean = jnp.stack([-pitch, 0.0])
    level, *seen = mapping.update_slope(level, lean, odometer_m, math.radians(TUNING.inclination_deg), even_m)
    return level, seen


def way_of(pitch, roll, heading):
    """The way of a robot that stands so step by step, angles in degrees."""
    n = len(pitch)
    pose = jnp.zeros((64, 3)).at[:n, 2].set(jnp.radians(jnp.asarray(heading, jnp.float32)))
    angles = {
        name: jnp.zeros(64).at[:n].set(jnp.radians(jnp.asarray(values, jnp.float32)))
        for name, values in (("pitch", pitch), ("roll", roll))
    }
    return mapping.no_way(64).replace(pose=pose, odometer_m=jnp.arange(64) * STEP_M, **angles)


def test_a_robot_that_turns_on_a_slope_stands_on_the_same_ground():
    """It rises to the east by 10 degrees: ahead, abeam and behind."""
    for heading, pitch, roll in ((0, -10, 0), (90, 0, -10), (180, 10, 0), (-90, 0, 10)):
        lean, odometer_m = mapping.slope_at(way_of([pitch] * 40, [roll] * 40, [heading] * 40), jnp.int32(39))
        np.testing.assert_allclose(np.degrees(lean), [10, 0], atol=1e-4)
        assert float(odometer_m) == pytest.approx(39 * STEP_M)


def test_a_pitch_that_jumps_is_averaged_and_one_that_does_not_is_not():
    rng, level = np.random.default_rng(0), np.zeros(60)
    calm = rng.normal(scale=0.1, size=60)
    lean, odometer_m = mapping.slope_at(way_of(calm, level, level), jnp.int32(59))
    assert float(lean[0]) == pytest.approx(math.radians(-calm[59]), abs=1e-6)
    assert float(odometer_m) == pytest.approx(59 * STEP_M)
    ways = jax.tree.map(lambda *a: jnp.stack(a), *[way_of(5 + rng.normal(size=60), level, level) for _ in range(50)])
    lean, odometer_m = jax.jit(jax.vmap(mapping.slope_at, (0, None)))(ways, 59)
    assert np.std(np.degrees(lean[:, 0])) < 0.5
    assert ((odometer_m > 50 * STEP_M) & (odometer_m < 60 * STEP_M)).all()


def changes(pitch, odometer, length_m=KAMUI.length_m):
    """`(odometer, crease, steepest in degrees)` of every change."""
    even_m = P.ground.even_lengths * length_m
    changed, crease, steepest = WATCH(jnp.radians(jnp.float32(pitch)), jnp.float32(odometer), even_m)
    changed = np.asarray(changed)
    return odometer[changed], np.asarray(crease)[changed], np.degrees(np.asarray(steepest)[changed])


RIDE = np.arange(0, 10, STEP_M)
BUMP = [2.0, 4.5, 7.0]  # the ground rises, falls, and is level again


@pytest.mark.parametrize(("degrees", "within_m", "noise_deg"), [(10, 0.03, 0), (6, 0.05, 0), (10, 0.08, 0.1)])
@pytest.mark.parametrize("direction", [-1, 1])
def test_a_ride_up_and_down_changes_three_times(degrees, within_m, noise_deg, direction):
    noise = noise_deg * np.random.default_rng(direction + 1).normal(size=RIDE.size)
    grounds = [0, direction * degrees, -direction * degrees, 0]
    at, crease, steepest = changes(pitch_deg(RIDE, BUMP, grounds, KAMUI.length_m) + noise, RIDE)
    np.testing.assert_allclose(crease, BUMP, atol=within_m)  # a degree of the turn is 3 to 12 cm long
    np.testing.assert_allclose(steepest, degrees, atol=1.1)
    # Known once the robot has stood evenly for a quarter of its length.
    late_m = (at - crease) / KAMUI.length_m
    assert noise_deg or ((late_m > 0.5) & (late_m < 0.8)).all()
    assert not changes(noise, RIDE)[0].size


def test_ground_that_hardly_changes_is_level():
    assert not changes(np.zeros(RIDE.size), RIDE)[0].size
    assert not changes(pitch_deg(RIDE, [3.0], [0, 4.5], KAMUI.length_m), RIDE)[0].size
    assert not changes(pitch_deg(RIDE, [3.0, 3.1], [0, 20, 0], KAMUI.length_m), RIDE)[0].size  # a sill
    assert not changes(np.linspace(0, 90, RIDE.size), RIDE)[0].size  # never even
    assert not changes(pitch_deg(RIDE, [3.0, 6.0], [0, 4.5, 9], KAMUI.length_m), RIDE)[0].size  # little by little


def test_a_crease_lies_half_way_for_a_robot_of_any_length():
    for length in (0.3, 1.2):
        at, crease, _ = changes(pitch_deg(RIDE, [4.0], [0, 12], length), RIDE, length)
        np.testing.assert_allclose(crease, [4], atol=0.06)
        assert at[0] == pytest.approx(4 + 0.75 * length, abs=0.15)


STEPS, POINTS, NODES, LINKS = 160, 512, 8, 12
BEGIN = jax.jit(mapping.begin_map, static_argnums=(0, 1, 2))


def begun(pose=(0.0, 0.0, 0.0), *, behind=False):
    return BEGIN(STEPS, NODES, LINKS, jnp.asarray(pose, jnp.float32), behind)


def path(writer, *rows):
    """The writer with a way of rows `(odometer, x, y, heading, pitch_deg, posture_deg, width)`."""
    table = np.tile(np.float32([math.inf, 0, 0, 0, 0, 0, math.inf]), (STEPS, 1))
    table[: len(rows)] = rows
    odometer, *_, pitch, posture, width = (jnp.asarray(column) for column in table.T)
    return writer.replace(
        way=writer.way.replace(
            odometer_m=odometer,
            pose=jnp.asarray(table[:, 1:4]),
            pitch=jnp.asarray(np.radians(pitch)),
            posture=jnp.asarray(np.radians(posture)),
            width_m=width,
        )
    )


ROWS = [(0, 0, 0, 0, 0, 1, 2.0), (1, 1, 0, 0.1, 0, 8, 1.5), (2, 2, 0, 0.2, 0, 3, 1.8), (3, 3, 0, 0.3, 0, 9, 1.0)]


def test_narrowest_and_steepest_between_two_places():
    way = path(begun(), *ROWS).way
    way = way.replace(roll=way.roll.at[1].set(math.radians(-35)))  # of five steps the mean
    for bounds, want in (
        ((0, 3), (4.3 / 3, 9, 7)),  # a width is a mean, too
        ((0, 2), (5.3 / 3, 8, 7)),
        ((1.5, 2.5), (1.8, 3, 7)),
        ((1.1, 1.9), (math.inf, 0, 0)),
    ):
        assert [float(value) for value in mapping.way_extremes(way, *bounds)] == pytest.approx(want)
    assert [float(value) for value in mapping.way_extremes(mapping.no_way(3), 0, 9)] == [math.inf, 0, 0]


# A T of passages two metres wide that one enters eastwards. Its circle touches two corners and the wall opposite.
T_CENTRE, T_RADIUS = (3.75, 0.0), 1.25
T_WALLS = np.concatenate([
    wall((0, 3), (1, 1)), wall((0, 3), (-1, -1)), wall((3, 3), (1, 4)), wall((3, 3), (-1, -4)), wall((5, 5), (-4, 4)),
])  # fmt: skip
# A dead end: a passage two metres wide that ends.
DEAD_CENTRE, DEAD_RADIUS = (0.0, 0.0), 1.0
DEAD_WALLS = np.concatenate([wall((-3, 1), (1, 1)), wall((-3, 1), (-1, -1)), wall((1, 1), (-1, 1))])


def turned(xy, angle):
    cos, sin = math.cos(angle), math.sin(angle)
    xy = np.asarray(xy, float)
    return np.stack([cos * xy[..., 0] - sin * xy[..., 1], sin * xy[..., 0] + cos * xy[..., 1]], axis=-1)


def seen(xy):
    """These points as what lies round the robot."""
    slots = np.zeros((POINTS, 2), np.float32)
    assert len(xy) <= POINTS
    slots[: len(xy)] = xy
    return slots, np.arange(POINTS) < len(xy)


NOTHING = seen(np.zeros((0, 2)))


def event(kind, odometer, pose, centre=None, *, radius=0.0, posture=0.0, steepest=0.0, step_m=0.0, blocked=False,
          returns=False):  # fmt: skip
    """A node that is due, angles in degrees."""
    return a_due_node(
        kind=jnp.int32(kind),
        odometer_m=jnp.float32(odometer),
        pose=jnp.asarray(pose, jnp.float32),
        centre=jnp.asarray(pose[:2] if centre is None else centre, jnp.float32),
        radius=jnp.float32(radius),
        posture=jnp.float32(math.radians(posture)),
        steepest=jnp.float32(math.radians(steepest)),
        step_m=jnp.float32(step_m),
        blocked=jnp.bool_(blocked),
        returns=jnp.bool_(returns),
    )


WRITE = jax.jit(lambda writer, due, points, tuning: nodes.write_node(writer, due, points, tuning, KAMUI))


def outcome_of(writer, due, points=NOTHING):
    """Return what `nodes.write_node` does; all of one type, so that one program does for all."""
    return WRITE(*jax.device_get((writer, due)), points, TUNING)


def write_node(writer, due, points=NOTHING):
    """`(writer, latch, target, shift)`."""
    writer, latch, target, _, correction = outcome_of(writer, due, points)
    return writer, int(latch), target.tolist(), correction.tolist()[:2]


def links_of(writer):
    """`(start, end, status)` of every link in use."""
    map_, n = writer.map, int(writer.map.n_links)
    return [tuple(int(field[i]) for field in (map_.start, map_.end, map_.status)) for i in range(n)]


def degrees(bearing):
    return math.degrees(float(bearing))


def arrival_at_the_t(turn=0.0, start=begun):
    """The writer before the T, the event there, and what lies round it, all turned about the start."""
    rows = [(0, 0, 1, 2.0), (1.5, 1.5, 2, 1.9), (3.5, 3.5, 1, 2.1)]
    rows = [(m, *turned((x, 0), turn), turn, 0, posture, width) for m, x, posture, width in rows]
    writer = path(start((0.0, 0.0, turn)), *rows).replace(entry=jnp.asarray(turned((1, 0), turn), jnp.float32))
    pose = (*turned((3.5, 0), turn), turn)
    due = event(DIVERGENCE, 3.5, pose, turned(T_CENTRE, turn), radius=T_RADIUS, posture=1.5)
    return writer, due, seen(turned(T_WALLS, turn))


def at_the_t(turn=0.0, start=begun):
    """The writer, latch and target on arrival at the T."""
    return write_node(*arrival_at_the_t(turn, start))


@pytest.mark.slow
@pytest.mark.parametrize("turn", [0.0, 0.7, -2.0])
def test_a_t_is_left_to_the_right_whichever_way_it_lies(turn):
    writer, latch, target, shift = at_the_t(turn)
    map_ = writer.map
    assert (int(map_.n_nodes), int(map_.n_links), int(map_.overflow)) == (2, 3, 0)
    assert sorted(links_of(writer)) == [(0, 1, SEARCHED), (1, NONE, UNSEARCHED), (1, NONE, UNSEARCHED)]
    assert links_of(writer)[0] == (0, 1, SEARCHED)
    # The openings bear as their passages do, square to where their walls are nearest to each other: within 3 degrees,
    # since connections of walls that end nearly as near count as well.
    bearings = [(degrees(map_.start_bearing[i]) - math.degrees(turn)) % 360 for i in (1, 2)]
    assert sorted(bearings) == pytest.approx([90, 270], abs=3)
    onto = int(writer.link)
    assert bearings[onto - 1] == pytest.approx(270, abs=3)
    assert latch == Latch.LEAVE
    # Beyond the middle: 0.25 m east of the centre, and between 1 m south, where the passage begins, and
    # 1.56 m, as far south as both walls lie in the search circle of 1.875 m on an average.
    x, y = turned(target, -turn) - T_CENTRE
    assert x == pytest.approx(0.25, abs=0.05)
    assert -1.56 < y + TUNING.leave_m < -1
    assert shift == [0, 0]
    assert float(writer.left_bearing) == float(map_.start_bearing[onto])
    assert (int(writer.node), float(writer.node_m), bool(writer.exhausted)) == (1, 3.5, False)


def test_the_way_in_is_the_opening_by_which_it_came_last():
    """Along the stem and into the south, then to the middle: its way in lies there, not where it began to approach."""
    rows = [(x, x, 0, 0, 0, 0, 2.0) for x in (0, 1, 2, 3)] + [(6, 4, -2, 0, 0, 0, 2.0), (7, 4, -1.2, 0, 0, 0, 2.0)]
    writer = path(begun(), *rows).replace(entry=jnp.asarray([1.0, 0.0]))
    due = event(DIVERGENCE, 8, (3.75, -0.2, NORTH), T_CENTRE, radius=T_RADIUS)
    writer, *_ = write_node(writer, due, seen(T_WALLS))
    assert degrees(writer.map.end_bearing[0]) == pytest.approx(-90, abs=3)
    assert sorted(degrees(writer.map.start_bearing[i]) % 360 for i in (1, 2)) == pytest.approx([90, 180], abs=3)


def hall():
    writer = path(begun(), *[(i, i, 0, 0, 0, i, 2 - i / 10) for i in range(8)]).replace(border_m=jnp.float32(2))
    first, latch, _, shift = write_node(writer, event(FREE_SPACE, 2, (2.0, 0.0, 0.25), posture=3))
    assert (latch, shift) == (Latch.FREE, [0, 0])
    return first


def test_a_free_space_is_two_nodes_on_the_way():
    writer = hall()
    assert links_of(writer) == [(0, 1, SEARCHED), (1, NONE, UNSEARCHED)]
    assert (int(writer.link), float(writer.left_bearing), float(writer.border_m)) == (1, 0.25, math.inf)
    writer, latch, *_ = write_node(writer, event(FREE_SPACE, 6, (6.0, 0.0, 0.0)))
    assert latch == Latch.FREE
    assert links_of(writer) == [(0, 1, SEARCHED), (1, 2, SEARCHED), (2, NONE, UNSEARCHED)]
    written = record.check_map(btm.to_map(writer.map))
    assert [node.type for node in written.nodes] == ["terminal", "free_space", "free_space"]
    assert written.nodes[1] == record.Node(1, 2.0, 0.0, "free_space", posture_deg=pytest.approx(3))
    link = written.links[1]
    assert (link.length_m, link.min_width_m, link.posture_deg) == pytest.approx((4, 1.5, 6))
    assert (link.start_bearing_deg, link.end_bearing_deg) == pytest.approx((math.degrees(0.25), 180))
    assert not writer.exhausted
    assert written.links[2].attributes == {}


def at_a_dead_end(writer, centre, heading, odometer):
    """Arrival at the end of a passage in which the robot drives."""
    writer = writer.replace(entry=jnp.asarray(turned((-2, 0), heading) + centre, jnp.float32))
    due = event(DIVERGENCE, odometer, (*centre, heading), centre, radius=DEAD_RADIUS)
    return write_node(writer, due, seen(turned(DEAD_WALLS, heading) + centre))


def back_at_the_t(writer, odometer, came_from, centre=T_CENTRE, turn=0.0):
    writer = writer.replace(entry=jnp.asarray(came_from, jnp.float32))
    due = event(DIVERGENCE, odometer, (3.7, 0.1, 0.0), centre, radius=T_RADIUS)
    around = turned(T_WALLS - np.array(T_CENTRE), turn) + centre
    return write_node(writer, due, seen(around))


def test_a_dead_end_sends_back_until_nothing_is_left():
    t, *_ = at_the_t()
    south, north = int(t.link), 3 - int(t.link)
    writer, latch, target, shift = at_a_dead_end(t, (4.0, -6.0), SOUTH, 9.5)
    assert links_of(writer)[south] == (1, 2, SEARCHED)
    assert float(writer.map.length_m[south]) == 6
    assert btm.to_map(writer.map).links[south].attributes["moved"] == pytest.approx([4 - T_CENTRE[0], -6, 0], abs=1e-5)
    assert int(writer.map.n_links) == 3  # a dead end has none of its own
    assert (int(writer.node), int(writer.link), latch, bool(writer.exhausted)) == (2, south, Latch.LEAVE, False)
    assert degrees(writer.left_bearing) == pytest.approx(90, abs=2)
    # Beyond the middle between the walls of the way out, 0.6 radii to 1.12 m before the centre: sqrt(1.5^2 - 1).
    assert target[0] == pytest.approx(4, abs=0.05)
    assert 0.6 * DEAD_RADIUS < target[1] + 6 - TUNING.leave_m < 1.12
    assert shift == [0, 0]

    # The T is met again on a known link: nothing new, a corrected odometry, and north is left.
    before = writer.map
    writer, latch, target, shift = back_at_the_t(writer, 15.5, (3.9, -4.0), (3.95, 0.1))
    jax.tree.map(np.testing.assert_array_equal, writer.map, before)
    assert shift == pytest.approx([-0.2 * P.graph.shift_share, -0.1 * P.graph.shift_share], abs=1e-6)
    assert (int(writer.node), int(writer.link), latch) == (1, north, Latch.LEAVE)
    assert target[0] == pytest.approx(4.2 - 0.2 * P.graph.shift_share, abs=0.05)  # where it is seen, put right
    assert 1 < target[1] - TUNING.leave_m < 1.56  # as to the south before

    writer, latch, *_ = at_a_dead_end(writer, (4.0, 6.0), NORTH, 21.5)
    assert links_of(writer) == [(0, 1, SEARCHED), *sorted([(1, 2, SEARCHED), (1, 3, SEARCHED)], reverse=south == 2)]
    assert (bool(writer.exhausted), int(writer.link), latch) == (True, 12, Latch.FREE)
    record.check_map(btm.to_map(writer.map))


@pytest.mark.parametrize(
    ("turn_deg", "centre", "share"),
    [
        (5, T_CENTRE, P.graph.turn_share),
        (-12, T_CENTRE, P.graph.turn_share),
        (8, (3.95, 0.1), P.graph.turn_share),
        (30, T_CENTRE, 0.0),  # one that is off too far is left alone
    ],
)
def test_where_a_node_is_met_again_the_heading_is_corrected(turn_deg, centre, share):
    """The openings are turned against its links by the error of the odometry."""
    t, *_ = at_the_t()
    dead, *_ = at_a_dead_end(t, (4.0, -6.0), SOUTH, 9.5)
    turn = math.radians(turn_deg)
    came = turned((0.1, -4.0), turn) + centre
    due = event(DIVERGENCE, 15.5, (*centre, NORTH + turn), centre, radius=T_RADIUS)
    around = seen(turned(T_WALLS - np.array(T_CENTRE), turn) + centre)
    dead = dead.replace(entry=jnp.asarray(came, jnp.float32))
    writer, latch, target, out, correction = outcome_of(dead, due, around)
    want = [*P.graph.shift_share * np.subtract(T_CENTRE, centre), -share * turn]
    np.testing.assert_allclose(correction, want, atol=math.radians(1))
    np.testing.assert_allclose(correction[:2], want[:2], atol=1e-6)
    if share == 0:
        return
    # The robot drives to where it sees the target, as if the odometry had not been off but for the uncorrected rest.
    left = turn - share * turn
    assert degrees(writer.origin[2]) == pytest.approx(-math.degrees(left), abs=1)
    target = turned(np.subtract(target, T_CENTRE), -left) + T_CENTRE
    assert (int(latch), int(writer.link)) == (Latch.LEAVE, 3 - int(t.link))
    assert degrees(out - left) == pytest.approx(90, abs=4)
    assert target[0] == pytest.approx(4, abs=0.15)
    assert 1 < float(target[1]) - TUNING.leave_m < 1.56


def bend(by_deg):
    """Return walls of a bend to the left by an angle, about the middle of the circle between them, and its radius.

    The circle touches the two walls outside and the corner inside.
    """
    turn, half = math.radians(by_deg), math.tan(math.radians(by_deg) / 2)
    west = [wall((-3, -half), (1, 1)), wall((-3, half), (-1, -1))]
    east = [wall((half, 3), (1, 1)), wall((-half, 3), (-1, -1))]
    cos = math.cos(turn / 2)
    radius = 2 / (1 + cos)
    centre = (radius - 1) / cos * np.array([-math.sin(turn / 2), cos])
    return np.concatenate([*west, *[turned(part, turn) for part in east]]) - centre, radius


def at_a_place(around, radius=1.0, stands=(0.0, 0.0)):
    """`(writer, latch, target, out)` before and after arrival at the origin, from the west."""
    writer = begun((-4.0, 0.0, 0.0)).replace(entry=jnp.asarray([-2.0, 0.0]))
    due = event(DIVERGENCE, 4, (*stands, 0.0), (0.0, 0.0), radius=radius)
    after, latch, target, out, correction = outcome_of(writer, due, seen(around))
    assert correction.tolist() == [0, 0, 0]
    return writer, after, int(latch), target.tolist(), float(out)


@pytest.mark.parametrize(("by_deg", "passes"), [(30, True), (60, False)])
def test_a_place_with_two_openings_in_line_is_passed(by_deg, passes):
    """In line is what bends by less than 45 degrees."""
    around, radius = bend(by_deg)
    writer, after, latch, target, out = at_a_place(around, radius)
    assert int(after.map.n_nodes) == 1 + (not passes)
    assert latch == Latch.LEAVE
    assert math.degrees(out) == pytest.approx(by_deg, abs=6)
    assert turned(target, -math.radians(by_deg))[0] > 0.6 * radius + TUNING.leave_m - 0.1
    if passes:
        jax.tree.map(np.testing.assert_array_equal, after.replace(passed=writer.passed), writer)
        assert after.passed.tolist() == pytest.approx([0, 0, radius, 4])
    else:
        assert after.passed.tolist() == writer.passed.tolist()
        assert links_of(after) == [(0, 1, SEARCHED), (1, NONE, UNSEARCHED)]


def test_when_nothing_else_is_left_links_that_were_given_up_are_tried_again():
    t, *_ = at_the_t()
    south, north = int(t.link), 3 - int(t.link)
    writer, *_ = at_a_dead_end(t, (4.0, -6.0), SOUTH, 9.5)
    after, *_ = at_a_dead_end(writer, (4.1, -6.1), SOUTH, 20)
    assert (int(after.link), bool(after.exhausted), int(after.last_chance)) == (south, False, 2)
    assert int(after.fails[south]) == 0  # once more
    vain = writer.replace(tries=writer.tries.at[north].set(1))
    after, *_ = at_a_dead_end(vain, (4.1, -6.1), SOUTH, 20)
    assert (int(after.link), bool(after.exhausted), int(after.last_chance)) == (south, False, 2)  # on the way there
    assert (int(after.tries[north]), bool(after.map.blocked[north])) == (0, False)
    after, *_ = at_a_dead_end(vain.replace(last_chance=jnp.int32(1)), (4.1, -6.1), SOUTH, 20)
    assert (bool(after.exhausted), bool(after.map.blocked[north])) == (True, True)
    # A searched one beyond which others are left gets more chances, while some are made use of: two are searched now.
    for last_chance, exhausted in ((1, False), (2, True)):
        after, *_ = at_a_dead_end(writer.replace(last_chance=jnp.int32(last_chance)), (4.1, -6.1), SOUTH, 20)
        assert (bool(after.exhausted), int(after.last_chance)) == (exhausted, 2)
    # What the ground has stopped stays blocked.
    stopped = writer.replace(map=writer.map.replace(blocked=writer.map.blocked.at[north].set(True)))
    after, *_ = at_a_dead_end(stopped, (4.1, -6.1), SOUTH, 20)
    assert (bool(after.exhausted), bool(after.map.blocked[north])) == (True, True)


def test_a_link_that_the_robot_has_left_for_a_known_one_is_still_to_be_searched():
    """It sets off north, and comes in at the dead end in the south by the known link from there."""
    t, *_ = at_the_t()
    south, north = int(t.link), 3 - int(t.link)
    writer, *_ = at_a_dead_end(t, (4.0, -6.0), SOUTH, 9.5)
    writer, *_ = back_at_the_t(writer, 15.5, (3.9, -4.0))
    assert (int(writer.link), int(writer.tries[north])) == (north, 1)
    after, *_ = at_a_dead_end(writer, (4.1, -6.1), SOUTH, 25)
    assert (links_of(after)[south], links_of(after)[north]) == ((1, 2, SEARCHED), (1, NONE, UNSEARCHED))
    assert (int(after.node), int(after.link), bool(after.exhausted)) == (2, south, False)
    # By another way it is a link of its own.
    other, *_ = at_a_dead_end(writer, (4.1, -6.1), SOUTH + math.radians(40), 25)
    assert links_of(other)[north] == (1, 2, SEARCHED)


def test_a_node_met_again_from_its_other_end_loses_the_double_link():
    t, *_ = at_the_t()
    south, north = int(t.link), 3 - int(t.link)
    writer, *_ = write_node(t, event(FREE_SPACE, 9.5, (4.0, -6.0, -0.5)))
    writer, _, _, shift = back_at_the_t(writer, 20, (3.9, 4.0), (3.65, -0.2))
    onward = 3
    assert links_of(writer)[south] == (1, 2, SEARCHED)
    assert links_of(writer)[onward] == (2, 1, SEARCHED)
    assert links_of(writer)[north] == (NONE, NONE, NONE)
    assert (int(writer.map.n_nodes), int(writer.map.n_links), int(writer.node)) == (3, 4, 1)
    assert shift == pytest.approx([0.1 * P.graph.shift_share, 0.2 * P.graph.shift_share], abs=1e-6)
    assert degrees(writer.map.end_bearing[onward]) == pytest.approx(90, abs=3)  # as its passage does
    assert writer.exhausted  # the ring is closed
    written = record.check_map(btm.to_map(writer.map))
    assert [(link.id, link.start, link.end) for link in written.links] == [(0, 0, 1), (1, 1, 2), (2, 2, 1)]


def test_a_way_may_lead_back_to_the_node_where_it_began():
    t, *_ = at_the_t()
    south, north = int(t.link), 3 - int(t.link)
    writer, _, _, shift = back_at_the_t(t, 20, (3.9, 4.0), (3.65, -0.2))
    assert links_of(writer)[south] == (1, 1, SEARCHED)
    assert links_of(writer)[north] == (NONE, NONE, NONE)
    assert (int(writer.map.n_nodes), bool(writer.exhausted)) == (2, True)
    assert shift == pytest.approx([0.1 * P.graph.shift_share, 0.2 * P.graph.shift_share], abs=1e-6)
    written = record.check_map(btm.to_map(writer.map))
    assert [(link.start, link.end) for link in written.links] == [(0, 1), (1, 1)]
    assert sorted(written.angles_deg(1)) == pytest.approx([90, 90, 180], abs=6)  # the link counts at both its ends
    assert code(written) == "T(D(=1,=1))"
    near, *_ = back_at_the_t(t, 6.9, (3.9, 4.0))  # after less than it takes to leave it twice
    assert int(near.map.n_nodes) == 3


def test_a_way_that_leads_back_to_its_own_opening_is_none():
    """The robot has turned round on the way, unawares."""
    t, *_ = at_the_t()
    south, north = int(t.link), 3 - int(t.link)
    writer, latch, *_ = back_at_the_t(t, 20, (3.9, -4.0), (3.65, -0.2))
    assert links_of(writer) == links_of(t)
    assert writer.map.blocked.tolist() == [i == south for i in range(len(writer.map.blocked))]
    assert (int(writer.link), latch) == (north, Latch.LEAVE)
    writer, *_ = back_at_the_t(writer, 40, (3.9, 4.0))
    assert links_of(writer) == links_of(t)
    assert int(writer.map.n_nodes) == 2


def test_past_its_start_a_robot_goes_on_behind_it():
    writer = begun(behind=True)
    assert links_of(writer) == [(0, NONE, UNSEARCHED)] * 2
    assert [abs(degrees(b)) for b in writer.map.start_bearing[:2]] == pytest.approx([0, 180])
    writer, latch, *_ = at_a_dead_end(writer, (4.0, 0.0), EAST, 4)
    assert (int(writer.link), latch, bool(writer.exhausted)) == (0, Latch.LEAVE, False)
    before = writer.map
    writer, latch, _, shift = write_node(writer, event(TERMINAL, 8, (-0.1, 0.2, WEST), returns=True))
    jax.tree.map(np.testing.assert_array_equal, writer.map, before)
    # The start is left by its open link, as a divergence is.
    assert (int(writer.node), int(writer.link), latch, shift) == (0, 1, Latch.LEAVE, [0, 0])
    assert abs(float(writer.left_bearing)) == pytest.approx(WEST)
    writer, *_ = at_a_dead_end(writer, (-5.0, 0.0), WEST, 13)
    assert links_of(writer) == [(0, 1, SEARCHED), (0, 2, SEARCHED)]
    assert (float(writer.map.length_m[1]), bool(writer.exhausted)) == (5, True)


def over(height, pitch=-10.0, heading=lambda s: 0.0):
    """The writer and the records after a ride over an obstacle from 2 m to 4 m of this profile, headed so, of
    which the robot sees what lies 0.6 m ahead.
    """
    odometer = np.arange(0, 6, 0.04)
    on_it = (odometer > 2) & (odometer < 4)
    writer = begun()
    rows = [(s, s, 0, heading(s), pitch * p, abs(pitch) * p + 1, 2.0) for s, p in zip(odometer, on_it)]
    writer = path(writer, *rows)
    z = np.zeros(STEPS, np.float32)
    z[: len(odometer)] = [*map(height, odometer + 0.6)]
    way = writer.way
    writer = writer.replace(way=way.replace(ground_x_m=way.odometer_m + 0.6, ground_z_m=jnp.asarray(z)))
    writer, latch, *_ = write_node(writer, event(OBSTACLE, 2, (2.0, 0.0, 0.0), steepest=9))
    assert latch == Latch.FREE
    first = btm.to_map(writer.map)
    writer, *_ = write_node(writer, event(OBSTACLE, 4, (4.0, 0.0, 0.0), steepest=9))
    return writer, first, record.check_map(btm.to_map(writer.map))


def slope(s):
    return math.tan(math.radians(10)) * min(max(s - 2, 0), 2)


def stairs(s):
    return 0.1 * math.floor(min(max(s - 2, 0), 2) / 0.4)


def test_an_obstacle_is_a_slope_until_its_profile_says_otherwise():
    _, first, written = over(slope)
    assert first.nodes[1].obstacle == "slope"
    assert first.nodes[1].inclination_deg == pytest.approx(9)
    for node in written.nodes[1:]:
        assert (node.type, node.obstacle, node.step_m) == ("obstacle", "slope", None)
        assert node.inclination_deg == pytest.approx(11, abs=0.01)  # as the body leant
        assert node.attributes.get("profile_variance_m2", 0) < 1e-6
    assert written.links[1].posture_deg == pytest.approx(11)
    assert [node.posture_deg for node in written.nodes[1:]] == pytest.approx([11, 11])


def test_stairs_round_a_bend_are_stairs_and_level_ground_behind_them_is_none():
    """The robot has left the node headed elsewhere."""
    writer, _, written = over(stairs, heading=lambda s: 1.5 * (s > 2.2))
    assert [node.obstacle for node in written.nodes[1:]] == ["stairs"] * 2
    assert [node.step_m for node in written.nodes[1:]] == [pytest.approx(0.1, abs=1e-3)] * 2
    writer, *_ = write_node(writer, event(OBSTACLE, 5.9, (5.9, 0.0, 0.0), steepest=7))
    last = btm.to_map(writer.map).nodes[3]
    assert (last.obstacle, last.step_m, last.attributes) == ("slope", None, {})


@pytest.mark.parametrize(("riser_m", "pitch"), [(0.1, -10), (0.05, -8)])
def test_stairs_fit_no_line(riser_m, pitch):
    _, first, written = over(lambda s: stairs(s) * riser_m / 0.1, pitch=pitch)
    assert first.nodes[1].obstacle == "slope"
    assert written.links[1].max_step_m == pytest.approx(riser_m, abs=1e-3)
    for node in written.nodes[1:]:
        assert (node.type, node.obstacle) == ("obstacle", "stairs")
        assert node.step_m == pytest.approx(riser_m, abs=1e-3)
        # h^2 / 12 of risers of h, about.
        assert node.attributes["profile_variance_m2"] == pytest.approx(riser_m**2 / 12, rel=0.2)


def test_rough_level_ground_is_no_stairs():
    _, _, written = over(lambda s: 0.06 * (int(s / 0.2) % 2), pitch=0)
    assert [(node.obstacle, node.attributes) for node in written.nodes[1:]] == [("slope", {})] * 2


@pytest.mark.parametrize("step_m", [0.0, 0.35])
def test_a_blocked_obstacle_sends_back(step_m):
    t, *_ = at_the_t()
    south = int(t.link)
    writer, latch, target, _ = write_node(
        t, event(OBSTACLE, 8, (4.0, -4.5, SOUTH), steepest=30, step_m=step_m, blocked=True)
    )
    node = btm.to_map(writer.map).nodes[2]
    want = ("obstacle", "stairs", pytest.approx(0.35)) if step_m else ("obstacle", "slope", None)
    assert (node.type, node.obstacle, node.step_m) == want
    assert node.inclination_deg == (None if step_m else pytest.approx(30))
    assert links_of(writer)[south] == (1, 2, SEARCHED)
    assert links_of(writer)[3] == (2, NONE, UNSEARCHED)
    np.testing.assert_array_equal(writer.map.blocked[:5], [False] * 3 + [True, False])
    lone, free, *_ = write_node(begun(), event(OBSTACLE, 2, (2.0, 0.0, 0.0), blocked=True))  # on the only way: the end
    assert (bool(lone.exhausted), free, int(lone.link)) == (True, Latch.FREE, 12)
    assert (latch, int(writer.link), bool(writer.exhausted)) == (Latch.LEAVE, south, False)
    np.testing.assert_allclose(target, [4, -4.5 + TUNING.leave_m], atol=1e-5)
    assert degrees(writer.left_bearing) == pytest.approx(90)
    before = writer.map
    writer, *_ = back_at_the_t(writer, 12.5, (3.9, -4.0))
    jax.tree.map(np.testing.assert_array_equal, writer.map, before)
    assert int(writer.link) == 3 - south


def room_for(links):
    """Return a start with room for a number of further links; the others have been withdrawn."""

    def start(pose=(0.0, 0.0, 0.0)):
        writer = begun(pose)
        return writer.replace(map=writer.map.replace(n_links=jnp.int32(LINKS - links)))

    return start


def test_links_that_do_not_fit_are_counted():
    writer, *_ = at_the_t(start=room_for(1))
    others = [(NONE,) * 3] * (LINKS - 2)
    assert links_of(writer) == [(0, 1, SEARCHED), *others, (1, NONE, UNSEARCHED)]
    assert int(writer.map.overflow) == 1
    record.check_map(btm.to_map(writer.map))
    assert int(at_the_t(start=room_for(2))[0].map.overflow) == 0


def full_of_nodes():
    """A hall's first border, and the last nodes taken by others far away."""
    writer, *_ = write_node(begun(), event(FREE_SPACE, 2, (2.0, 0.0, 0.0)))
    map_ = writer.map
    for i in range(int(map_.n_nodes), NODES):
        map_, _ = btm.add_node(map_, OBSTACLE, 100.0, float(i), posture_deg=1.0)
    return writer.replace(map=map_)


def test_a_node_that_does_not_fit_is_counted_and_overwrites_none():
    full = full_of_nodes()
    for kind in (FREE_SPACE, OBSTACLE):
        writer, *_ = write_node(full, event(kind, 6, (6.0, 0.0, 0.0), steepest=9, step_m=0.1))
        assert int(writer.map.overflow) >= 1
        assert int(writer.map.n_nodes) == NODES
        record.check_map(btm.to_map(writer.map))
        after, *_ = write_node(path(writer, *[(s, s, 0, 0, 10, 20, 2.0) for s in range(12)]),
                               event(FREE_SPACE, 10, (10.0, 0.0, 0.0)))  # fmt: skip
        for name in ("x_m", "y_m", "kind", "posture_deg", "obstacle", "inclination_deg", "step_m"):
            for one in (writer, after):
                np.testing.assert_array_equal(getattr(one.map, name), getattr(full.map, name))


def test_a_divergence_just_left_is_known():
    writer, *_ = at_the_t()  # at (3.75, 0), radius 1.25, odometer 3.5
    places = jnp.asarray([[3.75, 0.0], [4.95, 0.0], [5.05, 0.0], [3.75, -1.2], [0.0, 0.0]])

    def known(odometer, writer=writer):
        return mapping.is_near_known(writer, places, jnp.float32(odometer), TUNING.leave_m).tolist()

    assert known(3.5) == known(6.9) == [True, True, False, True, False]
    assert known(7.1) == [False] * 5  # it may come back
    small = writer.replace(map=writer.map.replace(radius_m=writer.map.radius_m.at[1].set(0.1)))
    near = jnp.asarray([[3.75, 0.45], [3.75, 0.55]])
    assert mapping.is_near_known(small, near, jnp.float32(3.5), TUNING.leave_m).tolist() == [True, False]
    assert known(0.5, begun()) == [False] * 5  # the start is not among them


@pytest.mark.parametrize(("off_m", "is_elsewhere"), [(0.0, False), (2.9, False), (3.1, True)])
def test_a_place_taken_for_a_node_that_lies_elsewhere_is_told(off_m, is_elsewhere):
    start = mapping.begin_map(1, 4, 4, jnp.zeros(3), False)
    map_, node = btm.add_node(start.map, DIVERGENCE, 5.0, 0.0, radius_m=1.0)
    there = start.replace(map=map_, node=node, node_m=jnp.float32(5.0))
    node_at, told = mapping.record_truth(jnp.full((4, 2), jnp.nan).at[0].set(0), start, there, jnp.array([5.0, 0.5]))
    np.testing.assert_allclose(node_at[:2], [[0, 0], [5, 0.5]])
    assert not told
    on_way = there.replace(node=jnp.int32(0), node_m=jnp.float32(10.0))  # at the start again
    again = on_way.replace(node=node, node_m=jnp.float32(15.0))
    at = jnp.array([5.0 + off_m, 0.5])
    kept, told = mapping.record_truth(node_at, on_way, again, at)
    assert bool(told) == is_elsewhere
    np.testing.assert_array_equal(kept, node_at)
    assert not mapping.record_truth(node_at, again, again, jnp.array([50.0, 50.0]))[1]  # under way
