"""Teams: equal to the oracle, and to a robot alone where there is only one; starts, contact, coordination, input."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from ref import team as oracle
from ref.refusals import refused

import jexplore as jx
from jexplore.config import InputError
from jexplore.exploration.batch import Job, run_jobs
from jexplore.exploration.team.coordination import COORDINATIONS, JointView
from jexplore.exploration.team.jobs import team_jobs
from jexplore.exploration.team.starts import place_team, steps_from
from jexplore.exploration.team.team import EVERYBODY, NOBODY, Member, Team, read_contact, read_coordination
from jexplore.grid import Grid
from jexplore.planning import Belief, MapModel
from jexplore.policies import strategy
from jexplore.reach import FAR, STRAIGHT
from jexplore.report.page.replay import STATE
from jexplore.rules import Lidar, Rules
from jexplore.studies.bounds.scene import prepare_scene
from jexplore.studies.bounds.teams import team_low
from jexplore.studies.replays import replays_of
from jexplore.studies.statistics import teams
from jexplore.studies.sweeps.plan import prepare_sweep
from jexplore.studies.sweeps.spec import sweep_from
from jexplore.worlds.world import World

RULES, LIDAR = Rules(clearance_m=0.0), Lidar(range_m=0.6, n_beams=61, fov_deg=360.0)


def world_of(text):
    """A world drawn in characters, # is wall; row 0 is the first line."""
    rows = text.split()
    return World(np.array([[sign == "#" for sign in row] for row in rows]), cell_m=0.1, name="drawn")


ROOM = world_of("""
########
#......#
#.##.#.#
#.#..#.#
#......#
########
""")
TICK = oracle.STRAIGHT


@pytest.mark.jit
@pytest.mark.parametrize("number", range(20))
def test_a_team_is_the_oracles(number):
    """Robots differ, and in every other case have a rendezvous."""
    told, _ = oracle.differences(oracle.mixed(oracle.draw_case(1, number, "independent", 3), number))
    assert told == []


def corridor_case(**contact):
    """Robots 0 and 1 in the middle of a corridor of 19 cells that see 2 cells; a third one is enclosed."""
    occupied = np.ones((5, 21), bool)
    occupied[1, 1:20] = occupied[3, 10] = False
    case = oracle.draw_case(1, 0, "independent", 3)
    return case._replace(
        occupied=occupied, starts=[(1, 10, 0), (1, 11, 0), (3, 10, 0)], cell_m=0.1, recheck=True,
        contact=oracle.Contact(np.int32(1), np.bool_(False), np.int32(contact.get("delay", 0)), np.float32(0),
                               np.int32(contact["rendezvous"])),
        lidar=Lidar(range_m=0.25, n_beams=24, fov_deg=360.0), paces=(1, 1, 1), ranges_m=(0.25,) * 3,
        rules=Rules(clearance_m=0.0, near_m=0.0, look_around=False),
    )  # fmt: skip


@pytest.mark.jit
def test_robots_come_back_to_the_rendezvous():
    """They go six steps apart, and back until they are next to each other."""
    told, (first, second, third) = oracle.differences(corridor_case(rendezvous=6 * TICK))
    assert told == []
    assert [col for _, col, _ in first.way[:13]] == [*range(10, 3, -1), *range(5, 11)]
    assert [col for _, col, _ in second.way[:13]] == [*range(11, 18), *range(16, 10, -1)]
    assert [robot.ended for robot in (first, second, third)] == ["COMPLETE", "COMPLETE", "STUCK"]


@pytest.mark.slow
@pytest.mark.jit
@pytest.mark.parametrize(("coordination", "n"), [("independent", 2), ("minpos", 3), ("voronoi", 3)])
def test_teams_are_the_oracles(coordination, n):
    """Fifty cases of each, with robots that wait for each other; with `voronoi` they differ, and JAX drives."""
    waits = 0
    for number in range(50):
        case = oracle.draw_case(2, number, coordination, n)
        is_mixed = coordination == "voronoi"
        told, robots = oracle.differences(oracle.mixed(case, number) if is_mixed else case, native=not is_mixed)
        assert told == []
        waits += sum(robot.waits for robot in robots)
    assert waits > 0


@pytest.mark.slow
@pytest.mark.jit
@pytest.mark.parametrize(("engine", "noise"), [("jax", {"sigma_m": 0.05, "dropout": 0.05}), ("auto", {})])
def test_a_team_of_one_is_a_robot_alone(engine, noise):
    """Every measure is equal to the bit, noise and draws of the strategy included; with a shorter range as well."""
    world, starts = jx.load_world("maze:width_m=3,height_m=3"), np.array([[5, 5, 0], [5, 5, 90]])
    lidar = Lidar(range_m=1.0, **noise)
    rules = Rules(clearance_m=0.1, look_around=True)
    job, long = Job(world, strategy("random+recheck"), starts, 3), lidar.replace(range_m=2.0)
    teams = [job._replace(team=Team(1)), job._replace(team=Team(1, members=(Member(1, 1.0),)), lidar=long)]
    alone, *teams = (run_jobs([one], lidar, rules, engine=engine).outcomes[0].result for one in (job, *teams))
    for name, team in itertools.product(alone.__dataclass_fields__, teams):
        if name not in ("metrics", "replace"):
            jax.tree.map(np.testing.assert_array_equal, getattr(alone, name), getattr(team, name))


def joint(robot, positions, aims=(), frontier=(0, 10)):
    """Return the view of robot `robot` in a corridor of 11 cells with frontier cells at both ends."""
    n, cells = len(positions), np.arange(11)
    costs = np.array([abs(cells - at) * STRAIGHT for at in positions], np.int32)[:, None]
    is_frontier = np.isin(cells, frontier)[None]
    targets = np.full((n, 2), -1, np.int32)
    for other, at in aims:
        targets[other] = 0, at
    at = np.array([(0, position) for position in positions], np.int32)
    view = JointView(
        jnp.int32(robot), jnp.ones(n, bool), jnp.asarray(at), jnp.asarray(targets), jnp.asarray(costs[robot]),
        jnp.asarray(costs), jnp.asarray(is_frontier), None, jnp.float32(4.0),
    )  # fmt: skip
    return view, is_frontier[0]


def chosen(name, *view):
    view, is_frontier = joint(*view)
    score = np.asarray(COORDINATIONS[name](view))[0].astype(float)
    return int(np.argmax(np.where(is_frontier, score, -np.inf)))


@pytest.mark.jit
def test_coordinated_robots_take_different_ends():
    """Robots in cells 3 and 4 are both nearer to the left end; the second goes right."""
    for name in ("minpos", "voronoi", "hungarian"):
        assert [chosen(name, robot, (3, 4)) for robot in (0, 1)] == [0, 10]


def test_greedy_avoids_what_the_others_target_shows():
    """The nearest end is another's target, or close to one: the far end is worth more, until it is too far."""
    assert chosen("greedy", 1, (3, 4)) == 0
    assert chosen("greedy", 1, (3, 4), [(0, 0)]) == 10
    assert chosen("greedy", 1, (3, 4), [(0, 3)]) == 0  # a quarter is shown, and the far end is 2 cells farther
    assert chosen("greedy", 1, (3, 1), [(0, 0)]) == 0


TWO_ROOMS = world_of("""
#######################
#..........#..........#
#..........#..........#
#.....................#
#.....................#
#.....................#
#..........#..........#
#..........#..........#
#######################
""")


@pytest.mark.jit
def test_segments_are_shared_out():
    """Two robots in one room, a frontier cell near to them there and two in the other room: each gets a room."""
    free = ~TWO_ROOMS.occupied
    view, _ = joint(0, (3, 4))
    frontier = np.zeros(free.shape, bool)
    frontier[[2, 4, 7], [2, 20, 20]] = True
    cells = np.array([[4, 3], [4, 4]])
    costs = np.where(free, [STRAIGHT * steps_from(free, tuple(cell)).clip(max=99) for cell in cells], FAR)
    model = MapModel(0.25, 0, np.float32(0.1), 0)
    grid = Grid(jnp.asarray(~free, jnp.int32), jnp.asarray(free, jnp.int32))
    belief = Belief(grid, None, None, 4, 3, 0, None, None, model)
    view = view.replace(
        cells=jnp.asarray(cells), costs=jnp.asarray(costs, jnp.int32), frontier=jnp.asarray(frontier), belief=belief
    )
    for robot, expected in ((0, [[2, 2]]), (1, [[4, 20]])):
        score = COORDINATIONS["segments"](view.replace(robot=jnp.int32(robot), cost=view.costs[robot]))
        score = np.where(frontier, score, -np.inf)
        assert np.argwhere(score == score.max()).tolist() == expected


@pytest.mark.jit
def test_robots_that_are_not_there_do_not_count():
    view, _ = joint(0, (4, 3))
    view = view.replace(there=jnp.array([True, False]), costs=view.costs.at[1].set(FAR))
    for name in ("minpos", "voronoi", "hungarian"):
        assert int(np.argmax(np.where(np.asarray(view.frontier), COORDINATIONS[name](view), -np.inf))) == 0


def lowest(world, start, starts, lidar, every=1):
    """Return `team_low` with some of the cells that must be seen as witnesses."""
    scene = prepare_scene(world, start, lidar, Rules(clearance_m=0.0, near_m=0.0), 2)
    return scene and team_low(scene, np.flatnonzero(scene.must_see)[::every], np.array(starts))


@pytest.mark.jit
def test_lower_bound_of_a_corridor():
    """Of 21 cells robots see 2 each way: the tree from the middle to both ends has 16 steps, for two robots 8."""
    corridor = World(np.pad(np.zeros((1, 21), bool), 1, constant_values=True), cell_m=0.1, name="corridor")
    lidar = Lidar(range_m=0.25, n_beams=9, fov_deg=360.0)
    for starts, expected in (([(1, 11)], 16), ([(1, 11), (1, 12)], 8), ([(1, 3), (1, 19)], 6)):
        assert lowest(corridor, (1, starts[0][1], 0), starts, lidar) == expected * STRAIGHT


@pytest.mark.jit
def test_no_team_is_below_its_lower_bound():
    ratios = []
    for number in range(10):
        case = oracle.draw_case(9, number, "independent", 2 + number % 2)
        case = case._replace(rules=case.rules.replace(max_steps=None, max_plans=None))
        team, log = oracle.simulate(case)
        if {robot.ended for robot in team} == {"COMPLETE"}:
            world = World(case.occupied, cell_m=case.cell_m, name="case")
            low = lowest(world, case.starts[0], case.starts, case.lidar, 4)
            time = oracle.when(log, [log[-1][0]])[0] / oracle.STRAIGHT
            assert low / STRAIGHT <= time * (1 + 1e-5)
            ratios += [low / STRAIGHT / time] if time else []
    assert len(ratios) > 5
    assert np.mean(ratios) > 0.2


def test_starts_together_and_apart():
    together = place_team(ROOM, (1, 1, 90), 3, "together", clearance_m=0.0, near_m=0.5)
    assert together.tolist() == [[1, 1, 90], [1, 2, 90], [2, 1, 90]]
    apart = place_team(ROOM, (1, 1, 90), 2, "apart", clearance_m=0.0, near_m=0.5)
    assert apart.tolist() == [[1, 1, 90], [4, 6, 90]]


@pytest.mark.parametrize(
    ("n", "starts", "text"),
    [
        (16, "together", None),
        (2, ((1, 1, 0), (1, 1, 90)), "two robots start at"),
        (2, ((1, 1, 0), (0, 0, 0)), "lies in a wall"),
        (3, ((1, 1, 0), (1, 2, 0)), "for each of 3 robots"),
        (2, "beside", "team_starts must be together or apart"),
    ],
)
def test_starts_that_cannot_be_are_refused(n, starts, text):
    if text is None:
        placed = place_team(ROOM, (1, 1, 0), n, starts, clearance_m=0.0, near_m=0.5)
        assert len({tuple(cell) for cell in placed[:, :2].tolist()}) == n
        text, starts, n = "robots do not fit", "apart", 40
    refused(text, place_team, ROOM, (1, 1, 0), n, starts, clearance_m=0.0, near_m=0.5)


def test_starts_with_a_wall_between_are_refused():
    two = World(np.vstack([ROOM.occupied, ROOM.occupied]), cell_m=0.1, name="two")
    with pytest.raises(InputError, match=r"no path leads from \(1, 1\) to \(7, 1\)"):
        place_team(two, (1, 1, 0), 2, ((1, 1, 0), (7, 1, 0)), clearance_m=0.0, near_m=0.5)


def test_contact_is_read():
    assert [read_contact(text, 0.1).d2 for text in ("all", "none", "range:0.3")] == [EVERYBODY, NOBODY, 9]
    assert read_contact("line-of-sight", 0.1) == (EVERYBODY, True, 0, 0, 0)
    assert read_contact("line-of-sight:0.3,loss=0.2,delay=2", 0.1) == (9, True, 2 * oracle.STRAIGHT, 0.2, 0)
    refused("robots that never hear each other cannot meet", read_contact, "none,rendezvous=6", 0.1)
    assert read_contact("all,rendezvous=30", 0.1).rendezvous == 30 * oracle.STRAIGHT
    for text in ("range", "range:-1", "range:inf", "sight", "range:4m", "all:4", "all,", "all,loss=2", "all,delay=.5",
                 "all,delay=1,delay=2", "none,hops=1", "all,rendezvous=0", "range:nan", "all,delay=-1"):  # fmt: skip
        refused("contact must be all, none, range:METRES or line-of-sight", read_contact, text, 0.1)


def jobs(text="closest", rules=RULES, metrics=None, **team):
    job = Job(ROOM, strategy(text), np.array([[1, 1, 0]]), lidar=LIDAR, rules=rules, metrics=metrics or {})
    return team_jobs([job], **team)


def test_teams_are_named():
    made = jobs(robots=[1, 2], coordination=["independent", "greedy"])
    names = [job.strategy.name for job in made]
    assert names == ["1 x closest", "2 x closest, independent", "2 x closest, greedy"]
    assert jobs()[0].team is None


@pytest.mark.parametrize(
    ("how", "text"),
    [
        ({"robots": 17}, "robots must be an integer from 1 to 16, got 17"),
        ({"robots": [2, 2]}, "different sizes"),
        ({"robots": 30}, "from 1 to 16"),
        ({"contact": "none"}, "give robots"),
        ({"robots": 2, "coordination": "gready"}, "greedy"),
        ({"robots": 2, "coordination": ["greedy", "greedy"]}, "different ones"),
        ({"robots": 2, "coordination": "greedy", "text": "random"}, "chooses targets itself"),
        ({"robots": 2, "coordination": "no_such_module:f"}, "no module"),
        ({"robots": 2, "rules": RULES.replace(pose="icp")}, "pose must be true"),
        ({"robots": 2, "metrics": {"own": None}}, "metrics are of one robot"),
        ({"robots": 2, "team_starts": ["here"]}, "team_starts must be together, apart, or row,col,heading_deg"),
        ({"robots": 2, "team_starts": 5}, "team_starts must be together, apart"),
        ({"robots": 2, "team_starts": [(1.5, 2, 0), (3, 3, 0)]}, "team_starts must be together, apart"),
        ({"robots": [1, 2], "team_starts": [(1, 2, 0)] * 3}, "one for each robot of the largest team, 2, got 3"),
        ({"robots": 2, "team_starts": [(1, 2, 0), (1, 3, 0)], "start": (1, 1, 0)}, "leave out start"),
        ({"robots": 2.5}, "robots must be an integer"),
        ({"robots": 2, "coordination": 5}, "coordination"),
        ({"robots": 2, "contact": "all,rendezvous=9", "rules": RULES.replace(return_home=True)}, "have a rendezvous"),
        ({"members": ["pace=2"]}, "give robots"),
        ({"robots": 2, "members": ["pace=2"]}, "one for each robot of the largest team, got 1"),
        ({"robots": 1, "members": ["pace=0"]}, "pace must be an integer from 1 to 8"),
        ({"robots": 1, "members": ["pace=2,pace=3"]}, "members must be such as pace=2"),
        ({"robots": 1, "members": ["range=0.7"]}, "range must be a number above 0 and at most 0.6"),
    ],
)
def test_what_teams_cannot_be_is_refused(how, text):
    refused(text, jobs, **how)


def test_a_coordination_of_ones_own_is_checked():
    own = read_coordination(lambda view: 3)
    view, _ = joint(0, (3, 4))
    refused("must return a score for every cell", own, view, view, None)


@pytest.mark.slow
@pytest.mark.jit
def test_teams_are_compared(tmp_path):
    """A table of teams with speed-up, that is kept and loaded."""

    def backwards(view):  # both robots have the same target
        return -jnp.arange(view.cost.size).reshape(view.cost.shape)

    found = jx.compare(
        ROOM, "closest", episodes=3, rules=RULES, lidar=LIDAR, robots=[1, 2], coordination=["independent", backwards],
        contact="range:0.3", out=tmp_path / "run",
    )  # fmt: skip
    table = found.teams.set_index("strategy")
    assert list(table.index) == ["1 x closest", "2 x closest, independent", "2 x closest, backwards"]
    assert table["speed_up"].iloc[0] == 1
    alone = found["1 x closest"]
    assert (alone["path_sum_m"] == alone["path_m"]).all()
    assert (found.episodes["connected"] <= 1).all()
    assert found.episodes["coordination"].tolist()[-1] == "backwards"
    assert set(found.episodes["outcome"]) == {"COMPLETE"}
    assert "speed-up" in found.to_markdown()
    again = jx.load(tmp_path / "run")
    assert again.teams.equals(found.teams)
    spec = {"worlds": ["maze:width_m=3,height_m=3"], "strategies": ["closest"], "episodes": 1, "robots": [2]}
    given = {"rules": {"clearance_m": 0.1}, "lidar": {"range_m": 0.6}, "members": ["", "pace=2 pace=8,range=.3"]}
    swept = jx.sweep({**spec, **given})
    own = jx.compare(spec["worlds"], "closest", robots=2, episodes=1, **{**given, "members": given["members"][1]})
    times = swept.episodes["path_m_at_100"].tolist()
    assert own.episodes["path_m_at_100"].tolist() == times[1:]
    assert times[0] < times[1]
    job = found.jobs[1]
    (replay,), _ = replays_of([job], episodes=1)
    *_, last = replay.maps()
    np.testing.assert_array_equal(last & STATE, found.first["drawn"][1].state)
    assert len(replay.others) == 1
    for robot in (replay, *replay.others):
        assert robot.steps[-1] == len(robot.rows) - 1
    bounds = jx.bound(ROOM, starts=3, max_floods=100, rules=RULES, lidar=LIDAR)
    ratios = bounds.beside(found)
    assert (ratios["path_over_low_any"].dropna() >= 1).all()
    assert ratios["path_over_low_any"].notna().sum() > 3
    refused("keep", jx.compare, ROOM, "closest", rules=RULES, robots=2, keep="paths")


@pytest.mark.jit
def test_axes_of_a_sweep_are_teams():
    """Programs are counted apart for every team; what a comparison refuses a sweep does."""
    spec = {"worlds": ["maze:width_m=3,height_m=3"], "strategies": ["closest"], "episodes": 2}
    given = {"robots": [1, 2], "coordination": ["independent", "minpos"], "rules": {"clearance_m": 0.1}}
    plan = prepare_sweep(sweep_from({**spec, **given}))
    assert [setting.team["robots"] for setting in plan.settings] == [1, 1, 2, 2]
    assert len(plan.programs) == 3  # one of a single robot
    team = plan.jobs[3].team
    assert team == Team(2, read_coordination("minpos"))
    plan = prepare_sweep(sweep_from({**spec, "robots": [1, 2], "members": ["pace=1 range=2", "pace=1 pace=2"]}))
    assert len(plan.programs) == 3  # one of a single robot
    assert plan.jobs[1].team.members == (Member(),)
    assert plan.jobs[3].team.members == (Member(), Member(2))
    for more, text in (
        *(({"coordination": "minpos"}, "give robots"), ({"robots": 17}, "from 1 to 16")),
        *(({"robots": 2, "members": "pace=9"}, "from 1 to 8"), ({"robots": 2, "members": "pace=2"}, "got 1")),
        ({"robots": 2, "members": 3}, "members must be a list of texts"),
    ):
        refused(text, prepare_sweep, sweep_from({**spec, **more}))


@pytest.mark.slow
@pytest.mark.jit
def test_a_sweep_of_teams_has_ratios_and_parameters():
    given = {"strategies": ["closest", {"name": "utility", "beta": [5]}], "robots": [1, 2], "episodes": 2}
    found = jx.sweep({"worlds": ["maze:width_m=3,height_m=3"], "rules": {"clearance_m": 0.1}, **given})
    assert found.summary["ratio"].notna().all()
    assert set(found.episodes.groupby("strategy")["strategy.beta"].max().dropna()) == {5}


def test_an_own_coordination_has_a_name_of_its_own():
    def minpos(view):
        return -view.cost

    refused("coordination minpos is built in: give your function another name", team_jobs, [], 2, minpos)


def test_ratios_over_worlds_and_of_completed_episodes():
    """Two worlds in which two robots take 1/2 and 1/8 of the time of one: 1/4 in the mean of logarithms."""
    rows = []
    for world, times in (("a#0", (8.0, 4.0)), ("a#1", (8.0, 1.0))):
        for robots, time in zip((1, 2), times):
            for episode in range(3):
                name = Team(robots).label("closest")
                ended = "STEP_LIMIT" if episode == 2 else "COMPLETE"
                path = 1000.0 if episode == 2 and robots == 2 else time  # not counted in ratios
                row = {"world": world, "strategy": name, "coordination": "independent", "contact": "all"}
                row |= dict.fromkeys(teams.MEANS, 1.0) | {"episode": episode, "outcome": ended}
                row |= {"robots": robots, "path_m_at_100": path}
                rows.append(row)
    table = teams.tabulate(pd.DataFrame(rows))
    assert table["world"].tolist() == ["a#0", "a#0", "a#1", "a#1", "all", "all"]
    pair = table[table["robots"] == 2]
    assert pair["speed_up"].tolist() == pytest.approx([2, 8, 4])
    assert pair["efficiency"].tolist() == pytest.approx([1, 4, 2])
    assert table["vs_independent"].tolist() == pytest.approx([1] * 6)
