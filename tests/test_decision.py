"""The decision alone: a grid and a pose in, an episode's own choice out."""

import math
import runpy
import sys
import types
from pathlib import Path

import jax
import numpy as np
import pytest
from ref import maps
from ref.refusals import refused
from ref.worlds import two_rooms

import jexplore as jx
from jexplore.engine.devices import random_key
from jexplore.exploration import replay
from jexplore.exploration.site import prepare_site
from jexplore.exploration.state import Stream
from jexplore.rules import Lidar, Rules

pytestmark = pytest.mark.jit

LIDAR, ORIGIN = Lidar(n_beams=37, range_m=1.0), (-1.3, 2.7)
POINT = Rules(clearance_m=0.0, near_m=0.0)


def grid_of(text):
    """Read a drawn map as an occupancy grid, `R` the robot: `(grid, x_m, y_m)`, cells of 1 m."""
    cells = maps.drawn(text)
    ((row, col),) = np.argwhere(cells == "R")
    values = {"#": 100, "?": -1, ".": 0, "R": 0}
    return np.array([[values[cell] for cell in line] for line in cells], np.int8), col + 0.5, row + 0.5


def ask(grid, pose, **how):
    return jx.next_target(grid, pose, cell_m=1.0, **{"rules": POINT, "lidar": LIDAR} | how)


DRAWN = """
    #######
    #....?#
    #R#..?#
    #######
"""


def test_target_path_and_scores_of_a_drawn_map():
    """No step cuts a corner of the pillar; two cells lie at the unknown ones."""
    grid, x, y = grid_of(DRAWN)
    found = ask(grid, (x, y, 1.0), scores=True)
    assert found.cell == (2, 4)
    np.testing.assert_array_equal(found.path, [(1.5, 1.5), (1.5, 2.5), (2.5, 2.5), (3.5, 2.5), (4.5, 2.5)])
    assert found.path_m == 4
    assert found.pose == (4.5, 2.5, 0.0)
    scores = {tuple(cell.tolist()): float(found.scores[tuple(cell)]) for cell in np.argwhere(~np.isnan(found.scores))}
    assert scores == pytest.approx({(1, 4): -3 - math.sqrt(2), (2, 4): -4})
    unscored = ask(grid, (x, y, 1.0))
    assert unscored.scores is None
    assert (unscored.cell, unscored.pose, unscored.path_m) == (found.cell, found.pose, found.path_m)


def test_what_was_driven_can_be_driven_and_what_is_exhausted_is_not_chosen():
    grid, x, y = grid_of("??????\n#R#..?\n######")
    first = ask(grid, (x, y, 0.0))
    assert first.cell == (1, 1)
    assert first.path.shape == (1, 2)
    assert first.pose == (x, y, 0.0)  # a path of no length keeps the heading
    done = ask(grid, (x, y, 0.0), exhausted_m=[(x, y), (99.0, 99.0)])
    assert done.cell is None
    assert done.pose is None
    assert done.path.shape == (0, 2)
    across = ask(grid, (x, y, 0.0), exhausted_m=[(x, y)], driven_m=[(2.5, 1.5)])
    assert across.cell == (1, 3)
    assert across.path_m == 2


def test_the_edge_of_a_grid_is_unknown_unless_it_is_the_outline():
    grid, x, y = grid_of("...\n.R.\n...")
    assert ask(grid, (x, y, 0.0)).path_m == 1
    assert ask(grid, (x, y, 0.0), rules=POINT.replace(known_outline=True)).cell is None


def as_arguments(belief, corner=ORIGIN):
    """Return what a belief of an episode is as arguments of `next_target`."""
    height, width = (int(n) for n in belief.extent)
    hits, misses = (np.asarray(a)[:height, :width] for a in (belief.grid.hits, belief.grid.misses))
    n, cell_m = hits + misses, float(belief.model.cell_m)
    grid = np.where(n > 0, -(-100 * hits // np.maximum(n, 1)), -1).astype(np.int8)

    def points(cells):
        return (np.array(cells, float).reshape(-1, 2)[:, ::-1] + 0.5) * round(cell_m, 6) + corner

    start = np.asarray(belief.start)
    x, y = points([(belief.row, belief.col)])[0]
    places = np.concatenate([points([start[:2]]), points(np.argwhere(np.asarray(belief.driven)))])
    known = {"driven_m": places, "exhausted_m": points(np.argwhere(np.asarray(belief.exhausted))), "origin_m": corner}
    return (grid, (x, y, int(belief.heading) * math.pi / 4)), {"cell_m": round(cell_m, 6), **known}


def check_episode(world, name, lidar, rules, *, episode=0, seed=3, most=10**6):
    """Hold the choices of an episode to those of `next_target`, as many as `most`: how many there were."""
    made = jx.explore(world, name, seed=seed, episode=episode, lidar=lidar, rules=rules)
    site, own, memory, n = prepare_site(made.world, lidar, rules), jx.strategy(name), None, 0
    key = jax.random.fold_in(jax.random.fold_in(random_key(seed), episode), Stream.POLICY)
    asked = []
    for _ in replay.moments(
        site, own, made.start, seed, episode, made.final.plans, lambda belief, plan: asked.append((belief, plan))
    ):
        if len(asked) >= most:
            break
    for belief, plan in asked[:most]:
        arguments, more = as_arguments(belief)
        draw = jax.random.fold_in(key, n)
        how = {"strategy": own, "lidar": lidar, "rules": rules, "memory": memory, "key": draw}
        found = jx.next_target(*arguments, **more, **how)
        memory, n = found.memory, n + 1
        assert found.cell == (None if plan.target is None else replay.target_of(plan, site.ring))
        cells = np.floor((found.path - ORIGIN) / more["cell_m"])
        motions = [(int(dy), int(dx)) for dx, dy in np.diff(cells, axis=0)]
        driven = [replay.MOTIONS[motion] for motion in plan.motions]
        assert motions[: len(driven)] == driven
    return n


def test_it_is_the_episodes_own_choice():
    assert check_episode(two_rooms(), "closest", LIDAR, Rules(), most=6) == 6


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["random", "tour+recheck", "learned+recheck", "decision-theoretic:samples=50", "closest+segment"]
)
def test_it_is_the_episodes_own_choice_by_each_kind_of_strategy(name):
    """Those that draw, remember, have a model, drive to view points or divide the map."""
    world = jx.load_world("rooms#1:width_m=8,height_m=6")
    assert sum(check_episode(world, name, Lidar(range_m=2.0), Rules(), seed=seed) for seed in range(2)) > 15


@pytest.mark.slow
def test_it_is_the_episodes_own_choice_with_noise():
    noisy = Lidar(n_beams=91, range_m=2.0, sigma_m=0.05, dropout=0.1)
    assert check_episode("rooms#5:width_m=8,height_m=6", "closest", noisy, Rules(max_plans=100)) > 10


@pytest.mark.slow
@pytest.mark.parametrize("name", ["closest", "utility", "mcdm", "small-first", "distance-advantage", "learned"])
def test_the_target_has_the_highest_score(name):
    """A room with three exits; asking for scores does not change the choice."""
    text = "##.####.######\n#............#\n#............#\n#.R...........\n#............#\n##############"
    grid, x, y = grid_of(text)
    found, plain = (ask(grid, (x, y, 0.0), strategy=name, scores=wanted) for wanted in (True, False))
    assert found.cell == plain.cell == tuple(np.argwhere(found.scores == np.nanmax(found.scores))[0])
    assert (~np.isnan(found.scores)).sum() == 3


FREE, WALL = np.zeros((3, 4), np.int8), np.eye(3, dtype=np.int8) * 90
KIND = "occupancy must be [H, W] int8, -1 unknown and 0 to 100"


@pytest.mark.parametrize(
    ("grid", "pose", "how", "message"),
    [
        (FREE.astype(float), (1, 1, 0), {}, f"{KIND}, got [3, 4] float64"),
        ([[0, 1]], (1, 1, 0), {}, f"{KIND}, got [1, 2] list"),
        (FREE[0], (1, 1, 0), {}, f"{KIND}, got [4] int8"),
        (FREE - 2, (1, 1, 0), {}, "occupancy must lie from -1 (unknown) to 100, got -2 to -2"),
        (FREE + 26, (1, 1, 0), {}, "occupancy must have a free cell, from 0 to 25, got none in [3, 4] int8"),
        (FREE, (1, 3.5, 0), {}, "pose (1, 3.5, 0): lies outside the grid of 3 x 4 cells"),
        (FREE, (-0.1, 1, 0), {}, "pose (-0.1, 1, 0): lies outside the grid of 3 x 4 cells"),
        (WALL, (1.5, 1.5, 0), {}, "pose (1.5, 1.5, 0): lies in a wall: cell (1, 1) is 90, above 25"),
        (FREE, (math.nan, 1, 0), {}, "pose must be 3 finite numbers, x_m, y_m, heading_rad, got (nan, 1, 0)"),
        (FREE, (1, 1), {}, "pose must be 3 finite numbers, x_m, y_m, heading_rad, got (1, 1)"),
        (FREE, (1, 1, 0), {"origin_m": (0, math.inf)}, "origin_m must be 2 finite numbers, x_m, y_m, got (0, inf)"),
        (FREE, (1, 1, 0), {"driven_m": [1, 2]}, "driven_m must be [N, 2] finite numbers, x_m and y_m, got [1, 2]"),
        (FREE, (1, 1, 0), {"driven_m": [(1, 2), (3,)]}, "driven_m must be [N, 2] finite numbers, x_m and y_m"),
        (FREE, (1, 1, 0), {"strategy": ["closest"]}, "strategy must be a name, a function, or made once"),
        (FREE, (1, 1, 0), {"exhausted_m": [(math.nan, 2)]}, "exhausted_m must be [N, 2] finite numbers"),
        (FREE, (1, 1, 0), {"cell_m": 0}, "cell_m must be a number at least 0.001 and at most 100, got 0"),
        (FREE, (1, 1, 0), {"cell_m": 0.005, "rules": {}}, "rules.clearance_m must be below 32 cells"),
        (FREE, (1, 1, 0), {"strategy": "nearst"}, "unknown strategy 'nearst'"),
    ],
)  # fmt: skip
def test_wrong_input_is_refused_in_one_line(grid, pose, how, message):
    line = refused(None, jx.next_target, grid, pose, **{"cell_m": 1.0, "rules": POINT} | how)
    assert line.startswith(message)


def test_a_strategy_of_ones_own_gives_its_scores_or_is_told_that_no_path_leads_there():
    grid, x, y = grid_of(DRAWN)

    def far(view):
        return view.path_m

    own = jx.strategy(far)
    found = ask(grid, (x, y, 0.0), strategy=own, scores=True)
    assert found.cell == (1, 4)
    assert found.scores[1, 4] == pytest.approx(found.path_m)

    def into_the_wall(key, params, carry, belief, beams, route):
        choice, route = jx.nearest_frontier(belief, route)
        return carry, choice.replace(row=choice.row * 0, col=choice.col * 0), route

    bad = jx.strategy(jx.Policy(lambda params, belief: (), into_the_wall), name="bad")
    refused(r"^bad: chose the cell \(-1, -1\), to which no path leads$", ask, grid, (x, y, 0.0), strategy=bad)


def test_the_ros_node_answers_messages_with_goals(monkeypatch):
    """With the messages' types of rosbags in the place of those of ROS, which pip cannot install."""
    bags = pytest.importorskip("ref.bags")
    goals, subscribed = [], {}
    node = types.SimpleNamespace(
        create_publisher=lambda kind, topic, depth: types.SimpleNamespace(publish=goals.append),
        create_subscription=lambda kind, topic, callback, depth: subscribed.update({topic: (kind, callback)}),
    )

    def pose(x, y, turn=0.0):
        told = {"position__x": x, "position__y": y, "orientation__z": math.sin(turn / 2)}
        told = {f"pose__{name}": value for name, value in told.items()}
        w = math.cos(turn / 2)
        return bags.make(
            bags.ROS2, "geometry_msgs/msg/PoseStamped", header__frame_id="map", pose__orientation__w=w, **told
        )

    def grid(cells):
        height, width = cells.shape
        told = {
            "info__resolution": 1.0,
            "info__width": width,
            "info__height": height,
            "info__origin__orientation__w": 1.0,
        }
        return bags.make(bags.ROS2, "nav_msgs/msg/OccupancyGrid", header__frame_id="map", data=cells.ravel(), **told)

    cells, x, y = grid_of(DRAWN)

    def spin(_):
        (_, on_pose), (_, on_map) = subscribed["pose"], subscribed["map"]
        on_map(grid(cells))  # before the first pose
        on_pose(pose(x, y))
        on_map(grid(cells))
        on_pose(pose(4.45, 2.55, 0.03))  # there, nearly, and the map is the same: it is exhausted
        on_map(grid(cells))
        closed = np.pad(np.zeros_like(cells[1:-1, 1:-1]), 1, constant_values=100)
        for _ in range(2):  # nothing is left to explore, and nothing later either
            on_map(grid(closed))

    rclpy = types.SimpleNamespace(init=lambda: None, create_node=lambda name: node, spin=spin)
    kinds = {name.split("/")[-1]: kind for name, kind in bags.ROS2.types.items()}
    messages = types.SimpleNamespace(PoseStamped=kinds["PoseStamped"], OccupancyGrid=kinds["OccupancyGrid"])
    for name, module in {"rclpy": rclpy, "geometry_msgs.msg": messages, "nav_msgs.msg": messages}.items():
        monkeypatch.setitem(sys.modules, name, module)
    module = runpy.run_path(str(Path(__file__).resolve().parents[1] / "examples" / "ros2_node.py"))
    explorer = module["Explorer"](rules=POINT, lidar=LIDAR)
    module["main"].__globals__["Explorer"] = lambda: explorer
    module["main"]()
    assert {topic: kind.__name__.split("__")[-1] for topic, (kind, _) in subscribed.items()} == {
        "pose": "PoseStamped", "map": "OccupancyGrid",
    }  # fmt: skip
    assert [(goal.pose.position.x, goal.pose.position.y) for goal in goals] == [(4.5, 2.5), (4.5, 1.5)]
    assert goals[0].header.frame_id == "map"
