"""Strategies that a user brings: scores, constructors, policies, names, modules; errors in one line."""

import functools
import itertools
import math
import os
import re
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref import beliefs
from ref.refusals import refused
from ref.worlds import two_rooms

import jexplore as jx
from jexplore import users
from jexplore.config import InputError
from jexplore.engine import one_by_one
from jexplore.exploration import batch
from jexplore.exploration.site import prepare_site
from jexplore.policies import STRATEGIES, Strategy, parse_strategy, strategy
from jexplore.policies.catalogue import adapt, entries
from jexplore.policies.catalogue.grammar import strategies
from jexplore.rules import Lidar
from jexplore.studies.sweeps.spec import sweep_from

LIDAR = Lidar(n_beams=37, range_m=1.0)
NOISY = Lidar(n_beams=37, range_m=1.0, sigma_m=0.03, dropout=0.02)
MODULE = """
import jexplore as jx

def nearest(view):
    return -view.cost

def near(view, weight=1.0, mode="plain", way=None):
    return -view.path_m * weight

def closest(steps=2):
    "Like closest."
    def select(key, params, carry, belief, beams, route):
        choice, route = jx.nearest_frontier(belief, route)
        return carry + params, choice, route
    return jx.Policy(lambda params, belief: 0, select, steps)
"""


def nearest(view):
    return -view.cost


def equal(table, one, other):
    """Return whether two strategies have the same rows but for their names."""
    rows = [table[table["strategy"] == name].drop(columns="strategy").reset_index(drop=True) for name in (one, other)]
    assert len(rows[0]) > 0
    return rows[0].equals(rows[1])


@functools.cache
def site():
    return prepare_site(two_rooms(), LIDAR, jx.Rules())


def program(one):
    """Return the identity of a strategy's program."""
    return site().with_strategy(strategy(one))[0].policy


def compare(strategies, *, lidar=LIDAR, **how):
    return jx.compare(two_rooms(), strategies, **{"episodes": 3, "seed": 2, "lidar": lidar, **how}).to_pandas()


# ---------------------------------------------------------------- scores


def chosen(score, text="...?\n.R..\n...?", **how):
    """Return row and column that a score chooses in a drawn belief; its frontier cells."""
    belief = beliefs.belief_of(text, **how)
    policy = strategy(score, name="score").policy
    route = jnp.full(belief.driven.shape, -1, jnp.int8)
    _, choice, _ = policy.select(jax.random.key(0), policy.params, (), belief, None, route)
    return (int(choice.row), int(choice.col)), np.argwhere(jx.field(belief).frontier).tolist()


def highest(score):
    """Return row and column of the highest score of the cells of that belief."""
    return chosen(lambda view: jnp.asarray(score))[0]


@functools.cache
def reachable():
    return jx.field(beliefs.belief_of("...?\n.R..\n...?"))


def test_the_highest_score_is_the_target_and_ties_go_to_the_lowest_index():
    target, candidates = chosen(nearest)
    assert candidates == [[0, 2], [1, 2], [1, 3], [2, 2]]
    assert target == (1, 2)  # one straight step away
    assert chosen(lambda view: -jnp.arange(12, dtype=jnp.int8).reshape(3, 4))[0] == (0, 2)
    assert highest(reachable().cost) == (1, 3)
    assert highest(jnp.zeros((3, 4))) == (0, 2)


def test_what_is_not_finite():
    nan, inf = np.nan, np.inf

    def scored(**at):
        score = np.full((3, 4), nan, np.float32)
        for place, value in at.items():
            score[int(place[1]), int(place[2])] = value
        return score

    assert highest(scored(_02=-5.0)) == (0, 2)  # NaN elsewhere
    assert highest(scored(_02=-5.0, _22=inf)) == (2, 2)
    assert highest(scored(_02=-5.0, _22=-inf)) == (0, 2)
    assert highest(scored(_00=7.0)) == (1, 2)  # only a cell that is no frontier: the nearest
    for value in (nan, inf, -inf):
        assert highest(np.full((3, 4), value)) == (1, 2)


def test_without_a_frontier_there_is_no_target():
    assert chosen(nearest, "....\n.R..\n....") == ((-1, -1), [])


def test_the_view():
    seen = []
    chosen(lambda view: seen.append(view) or view.cost, "R.#.\n..#?")
    (view,) = seen
    assert view.cost[:, :2].tolist() == [[2**16, 92682], [0, 2**16]]  # the picture's upper row is the last
    np.testing.assert_allclose(view.path_m[:, :2], [[0.1, 0.1 * 2**0.5], [0, 0.1]], atol=1e-6)
    assert np.isinf(view.path_m[:, 2:]).all()
    assert view.path_m.dtype == np.float32
    assert not view.frontier.any()  # the only frontier cell lies behind the wall
    assert view.belief.start.tolist() == [1, 0, 0]


@pytest.mark.jit
def test_the_plainest_strategy_is_closest_to_the_bit():
    assert equal(compare(["closest", nearest]), "closest", "nearest")


@pytest.mark.slow
@pytest.mark.jit
def test_ones_own_in_lanes_modified_too(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "engines_mine.py").write_text(MODULE)
    names = ["closest+recheck+segment", "engines_mine:nearest+recheck+segment"]
    table = compare(names, lidar=NOISY)
    assert equal(table, *names)
    with monkeypatch.context() as patch:
        patch.setattr(batch, "find_resources", functools.partial(batch.find_resources, in_lanes=True))
        lanes = compare(names[1:], lidar=NOISY)
    assert lanes.equals(table[table["strategy"] == names[1]].reset_index(drop=True))
    assert equal(compare(["closest", "engines_mine:closest"]), "closest", "engines_mine:closest")
    sys.modules.pop("engines_mine")


@pytest.mark.jit
def test_parameters_are_swept_without_compiling_anew():
    traced = itertools.count()

    def weighed(view, weight=1.0, power=2):
        next(traced)
        return -view.path_m * weight**power

    def names(*weights):
        return [strategy(weighed, weight=w, name=f"w{w}") for w in weights]

    assert equal(compare(names(1.0, 3.0)), "w1.0", "w3.0")
    n = next(traced)
    compare(names(5.0))
    assert next(traced) - n <= 2  # once more to be checked, never to be compiled
    assert strategy(weighed, weight=3, recheck=True).name == "weighed+recheck:weight=3"


# ---------------------------------------------------------------- names


@pytest.fixture
def module(tmp_path, monkeypatch):
    """A folder with a module of strategies, in which we are."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "mine_of_tests.py").write_text(MODULE)
    yield tmp_path
    sys.modules.pop("mine_of_tests", None)


def test_a_module_of_the_current_folder(module):
    plain = parse_strategy("mine_of_tests:nearest")
    assert program(plain) == program("mine_of_tests:nearest")  # equal, so compiled once
    assert parse_strategy("mine_of_tests:nearest+recheck").recheck
    near = parse_strategy("mine_of_tests:near:weight=2,mode=odd,way=data/w.npz").policy
    assert near.params == {"weight": 2}
    assert dict(near.select.fixed) == {"mode": "odd", "way": "data/w.npz"}
    made = parse_strategy("mine_of_tests:closest+segment=auto:steps=5,door_m=2").policy
    assert (made.params.inner, made.params.door_m) == (5, 2.0)


def test_a_module_elsewhere_is_found_before_a_builtin_name_is_asked(module):
    (module / "broken_of_tests.py").write_text("import notthere_of_tests")
    (module / "wrong_of_tests.py").write_text("1 / 0")
    for text, says in (
        ("broken_of_tests:x", "'broken_of_tests' does not import: ModuleNotFoundError: No module named 'notthere_of"),
        ("wrong_of_tests:x", "'wrong_of_tests' does not import: ZeroDivisionError: division by zero"),
        ("absent_of_tests:x", "no module 'absent_of_tests', neither installed nor in "),
        ("mine_of_tests:nearset", "'mine_of_tests' has no 'nearset' (there are: nearest, near, closest)"),
        ("mine_of_tests:near:weight=heavy", "expected a number for weight"),
        ("mine_of_tests:near:weight=1,weight=2", "expected weight=NUMBER once"),
        ("mine_of_tests:near:wait=1", "unknown parameter of 'mine_of_tests:near': 'wait'; did you mean 'weight'?"),
    ):
        refused(re.escape(says), strategy, text)


def test_a_module_is_as_it_is_now_and_here(module, tmp_path_factory, monkeypatch):
    def score():
        return program("mine_of_tests:nearest")

    first = score()
    file = module / "mine_of_tests.py"
    file.write_text(MODULE.replace("-view.cost", "+view.cost"))
    os.utime(file, ns=(1, 1))
    changed = score()
    assert changed != first
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    monkeypatch.chdir(elsewhere)
    refused("no module 'mine_of_tests', neither installed nor in ", score)
    (elsewhere / "mine_of_tests.py").write_text(MODULE)
    assert score() == first
    (elsewhere / "json.py").write_text(MODULE)
    refused(r"json.py is hidden by another module 'json', of .*: rename it", strategy, "json:nearest")
    (elsewhere / "exits_of_tests.py").write_text("raise SystemExit(3)")
    refused("'exits_of_tests' does not import: SystemExit: 3", strategy, "exits_of_tests:nearest")
    for text, says in (
        ("mine_of_tests.py:nearest", "named like mine_of_tests:nearest"),
        ("./mine:near+recheck", "named like mine:near+recheck"),
        ("mine_of_tests+recheck", "a function of mine_of_tests.py is named like mine_of_tests:function"),
    ):
        refused(re.escape(says), strategy, text)
    assert str(elsewhere) not in sys.path


def number_of(text):
    """Return the result of a function of a module, in its present form."""
    return users.import_object(*text.split(":"))()


def test_modules_are_read_from_their_source(module):
    """Neither bytecode, which knows files by size and second, nor an imported module replaces the present source."""
    (module / "helper_of_tests.py").write_text("W = 1\n")
    (module / "asking_of_tests.py").write_text("import helper_of_tests\ndef weight():\n    return helper_of_tests.W\n")
    assert users.import_object("asking_of_tests", "weight") is users.import_object("asking_of_tests", "weight")
    assert number_of("asking_of_tests:weight") == 1
    before = os.stat(module / "helper_of_tests.py")
    for n in (2, 3):
        (module / "helper_of_tests.py").write_text(f"W = {n}\n")  # as long as before, and in the same second
        os.utime(module / "helper_of_tests.py", ns=(before.st_atime_ns, before.st_mtime_ns))
        assert number_of("asking_of_tests:weight") == n
    assert not (module / "__pycache__").exists()
    package = module / "package_of_tests"
    (package / "inner").mkdir(parents=True)
    for name, text in (
        ("__init__", ""),
        ("top", "from . import near\nfrom package_of_tests.inner.far import FAR\ndef both(): return near.NEAR, FAR\n"),
        ("near", "NEAR = 1\n"),
        ("inner/far", "FAR = 1\n"),
    ):
        (package / f"{name}.py").write_text(text)
    assert number_of("package_of_tests.top:both") == (1, 1)
    (package / "near.py").write_text("NEAR = 2\n")
    assert number_of("package_of_tests.top:both") == (2, 1)
    (package / "inner/far.py").write_text("FAR = 2\n")
    assert number_of("package_of_tests.top:both") == (2, 2)


def test_a_module_that_registers_may_be_written_anew(module, monkeypatch):
    monkeypatch.setattr(entries, "STRATEGIES", dict(STRATEGIES))
    text = "import jexplore as jx\n@jx.register('written-anew')\ndef score(view):\n    return -view.cost\n"
    (module / "registers_of_tests.py").write_text(text)
    first = program("registers_of_tests:score")
    (module / "registers_of_tests.py").write_text(text.replace("-view", "+view"))
    assert program("registers_of_tests:score") == program("written-anew") != first
    with pytest.raises(InputError, match="'written-anew' is registered already"):
        jx.register("written-anew", users.import_object("registers_of_tests", "score"))


def test_registered(monkeypatch):
    monkeypatch.setattr(entries, "STRATEGIES", dict(STRATEGIES))
    assert jx.register("mine-1", nearest, source="us, 2026") is nearest

    @jx.register("decorated")
    def other(view, beta=0.5):
        """Goes elsewhere.

        And more.
        """
        return view.cost * beta

    found = {name: told for name, *told in strategies()}
    assert found["mine-1"][2] == "us, 2026"
    assert found["decorated"][0] == "Goes elsewhere."
    assert found["decorated"][1] == "beta=0.5"
    assert re.search(r"test_own_strategies\.py:\d+$", found["decorated"][2])
    assert parse_strategy("mine-1+recheck").recheck
    assert parse_strategy("decorated:beta=2").policy.params == {"beta": 2}
    refused("'mine-1' is registered already", jx.register, "mine-1", nearest)
    jx.register("mine-1", other, replace=True)
    assert entries.STRATEGIES["mine-1"].make is other
    for name, thing, says in (
        ("closest", nearest, "registered already"),
        ("my own", nearest, "must be letters"),
        ("number", 3, "3 is no strategy"),
    ):
        refused(says, jx.register, name, thing)
    refused("one of jexplore's own", jx.register, "closest", nearest, replace=True)


def test_what_stands_for_a_strategy():
    assert strategy("closest+recheck") == parse_strategy("closest+recheck")
    given = strategy(nearest)
    assert strategy(given).name == "nearest"
    assert strategy(given).policy.select.function is nearest
    assert strategy(STRATEGIES["closest"].make).name == "closest"
    assert strategy(nearest, segment=True, recheck=True).name == "nearest+recheck+segment=holz"
    assert strategy(nearest, segment="auto", door_m=2.0).policy.params.door_m == 2.0
    for what, how, says in (
        (3, {}, "3 is no strategy: expected a name, a function of the view"),
        (lambda view, other: 0, {}, "a score takes one argument, the view.* got view, other"),
        (lambda: 3, {}, "must return a Policy, got int"),
        (lambda **_: 1 / 0, {}, r"raised ZeroDivisionError at .*test_own_strategies.py:\d+: division by zero"),
        (nearest, {"weight": 2}, "has no parameter 'weight'"),
        (lambda *, weights: 0, {}, "needs the parameter weights"),
        (nearest, {"segment": "holtz"}, "unknown kind of segment: 'holtz'; did you mean 'holz'"),
        ("closest", {"recheck": True}, "'closest' says itself"),
        (jx.Policy(3, 4), {"name": "x"}, "init must be a function, got 3"),
        (nearest, {"recheck": "no"}, "recheck must be True or False"),
        (nearest, {"name": 5}, "a strategy's name must be text, got 5"),
        (lambda view, gamma=1: 0, {"segment": True}, "has a parameter 'gamma', which is one of the modifiers'"),
        (Strategy("raw", 3), {}, "'raw': policy must be a Policy, got int"),
        (Strategy(None, jx.Policy(nearest, nearest)), {}, "name must be text, got None"),
        (type("Thing", (), {"__call__": lambda self, view: view.cost})(), {}, "has no name"),
    ):
        refused(says, strategy, what, **how)


def made(times, helper="view.cost"):
    """A score and a select that close over a number and call a helper, as a notebook would define them."""
    code = f"""
def helper(view):
    return {helper}
def score(view, weight=1):
    return -helper(view) * weight * times
def again(n):
    return again(n - 1) if n else (lambda: helper)
"""
    exec(compile(code, "cell", "exec"), found := {"times": times})
    return found


def known(thing, **given):
    return program(strategy(thing, name="thing", **given))


def test_what_computes_the_same_is_compiled_once():
    one, same, other, changed = made(2), made(2), made(3), made(2, "view.path_m")
    first = known(one["score"])
    assert first == known(same["score"], weight=3)  # a parameter is not compiled in
    assert hash(first) == hash(known(same["score"]))
    assert first != known(changed["score"])  # its helper is another
    assert first != known(other["score"])  # a global number is another
    one["helper"] = changed["helper"]
    assert first != known(one["score"])  # changed since

    def closing(array):
        return jax.jit(lambda view: jax.lax.map(lambda _: view.cost + array, jnp.arange(2))[0])

    table = np.zeros((64, 64), np.float32)
    other = table.copy()
    other[63, 63] = 1e-9
    assert known(closing(table)) == known(closing(table.copy())) != known(closing(other))


def test_what_calls_back_into_python_is_compiled_anew():
    """JAX does not see what it computes."""

    def asks(view):
        return view.path_m * jax.pure_callback(lambda: np.float32(1), jax.ShapeDtypeStruct((), jnp.float32))

    first = known(asks)
    assert first != known(asks)
    assert adapt.digest_of(first) is None


def test_numbers_that_would_become_others_are_refused():
    def weighed(view, weight=1.0):
        return view.path_m * weight

    def given(value):
        return strategy(weighed, weight=value, name="mine")

    whole = "must be a whole number from -2147483648 to 2147483647, got"
    for value, says in (
        (2**32, f"{whole} 4294967296"),
        (np.int64(2**40), whole),
        (1e300, r"must be from -3.4e\+38 to 3.4e\+38, or infinite, got 1e\+300"),
        (1 + 2j, r"must be real, got \(1\+2j\)"),
        (math.nan, "must be a number, not NaN, got nan"),
        (np.array([2**40], object), "must be an array of numbers"),
    ):
        refused(f"strategy 'mine': weight {says}", given, value)
    for value in (2**31 - 1, -(2**31), 3e38, math.inf, -math.inf, True, np.float32(1), np.array([math.inf])):
        assert given(value).policy.select.function is weighed
    refused(r"'mine': weight\.inner must be a whole number", given, {"inner": 2**40})
    with pytest.raises(InputError, match=r"'put together': params must be a number, not NaN"):
        strategy(Strategy("put together", jx.Policy(nearest, nearest, math.nan)))
    with pytest.raises(InputError, match=r"'weighed\+segment=holz:weight=\d+': weight must be a whole number"):
        strategy(weighed, weight=2**40, segment=True)


def test_sets_have_no_order():
    for kind, given in (("strategies", {"closest", "random"}), ("worlds", frozenset({"cave", "office"}))):
        arguments = {"worlds": "cave", "strategies": "closest", kind: given}
        refused(f"{kind} must be a list, got a set, which has no order", jx.compare, **arguments, episodes=1)
    with pytest.raises(InputError, match="strategies must be a list, got "):
        sweep_from({"worlds": ["cave"], "strategies": {"closest", "random"}})


# ---------------------------------------------------------------- errors


def policy(select, init=lambda params, belief: (), **more):
    return lambda: jx.Policy(init, select, **more)


def chooses(change=lambda choice: choice, carry=(), route=lambda route: route):
    def select(key, params, old, belief, beams, way):
        choice, way = jx.nearest_frontier(belief, way)
        return carry, change(choice), route(way)

    return select


@pytest.mark.jit
@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (lambda view: view.cost[0], r"a score for every cell, \[64, 64\] integer or float, got \[64\] int32"),
        (
            lambda view: 1 if view.cost > 3 else 0,
            r"raised \w+ at .*test_own_strategies.py:\d+: .*(truth value|boolean)",
        ),
        (lambda view: -view.path_m * float(view.cost[0, 0]), "jnp.where instead of if, jnp instead of math and numpy"),
        (
            lambda view: view.coast,
            r"raised AttributeError at .*: 'View' object has no attribute 'coast' .it has cost, path_m",
        ),
        (policy(lambda *_: 3), r"must return \(carry, Choice, route\), .* got int 3"),
        (policy(lambda: 3), r"raised TypeError: .* takes 0 positional arguments"),
        (
            policy(chooses(carry=jnp.float32(0)), lambda *_: 0),
            r"like that of init: 0 must be \[\] int32, got \[\] float32",
        ),
        (policy(chooses(), lambda *_: "none"), "numbers and arrays, got str 'none'"),
        (policy(chooses(lambda choice: choice.replace(row=1.5))), r"1\.row must be \[\] int32, got \[\] float32"),
        (
            policy(chooses(lambda choice: choice.replace(col=jnp.zeros(2, jnp.int32)))),
            r"1\.col must be \[\] int32, got \[2\] int32",
        ),
        (policy(chooses(route=lambda route: route[1:])), r"2 must be \[64, 64\] int8, got \[63, 64\] int8"),
        (policy(chooses(), live=lambda *_: 3), r"one bool, got \[\] int32"),
        (policy(chooses(), params="a word"), "params of a Policy must be numbers and arrays"),
    ],
)
def test_what_is_wrong_is_said_in_one_line_before_anything_compiles(wrong, says, monkeypatch):
    monkeypatch.setattr(one_by_one, "compile_chunk", lambda *_: pytest.fail("compiled"))
    with pytest.raises(InputError, match=says) as caught:
        compare(["closest", strategy(wrong, name="wrong")])
    assert "\n" not in str(caught.value)
    assert caught.value._render_traceback_() == [f"InputError: {caught.value}"]


@pytest.mark.jit
def test_a_strategy_put_together_by_hand_is_checked_as_well():
    refused(r"must return \(carry, Choice, route\), .* got int 5", compare, [Strategy("raw", policy(lambda *_: 5)())])

    def unlaid(key, params, carry, belief, beams, route):
        return carry, jx.Choice(*jnp.int32([5, 30, 9])), route

    table = compare([Strategy("raw", policy(unlaid)())], episodes=1)
    assert table["outcome"].tolist() == ["BAD_TARGET"]


def wall(key, params, n, belief, beams, route):
    """Choose targets that no path leads to: bad, bad, good, bad, bad, good, bad, bad, bad."""
    known = jx.field(belief)
    good, route = jx.nearest_frontier(belief, route)
    bad, _ = jx.choose(belief, route, known, jnp.int32(0), jnp.int32(0))
    take = (n % 3 == 2) & (n < 6)
    return n + 1, jax.tree.map(lambda a, b: jnp.where(take, a, b), good, bad), route


@pytest.mark.jit
def test_a_target_that_no_path_leads_to_ends_the_episode_at_the_third():
    table = compare([strategy(policy(wall, lambda *_: 0), name="wall")])
    assert table["outcome"].tolist() == ["BAD_TARGET"] * 3
    assert table["plans"].tolist() == [9] * 3
    assert (table["steps"] > 0).all()


@pytest.mark.jit
def test_a_way_must_lead_to_its_target():
    def select(key, params, carry, belief, beams, route):
        choice, route = jx.nearest_frontier(belief, route)
        return carry, choice.replace(row=jnp.int32(63), col=jnp.int32(63)), route  # the way leads elsewhere

    found = jx.compare(two_rooms(), strategy(policy(select), name="astray"), episodes=2, seed=2, lidar=LIDAR)
    assert found.episodes["outcome"].tolist() == ["BAD_TARGET"] * 2
    assert found.episodes["plans"].tolist() == [3] * 2
    assert found.warnings[-1] == (
        "two rooms: astray: 2 of 2 episodes ended because the strategy chose a target that no path leads to, "
        "three times in a row"
    )


def test_a_way_is_followed_cell_by_cell():
    belief = beliefs.belief_of("R..#")
    way = jnp.array([[0, 0, 0, -1]], jnp.int8)

    def leads(col, row=0, way=way):
        return bool(adapt._leads_there(belief, way, jx.Choice(jnp.int32(row), jnp.int32(col), jnp.int32(0))))

    assert [leads(col) for col in range(4)] == [True, True, True, False]  # a wall is not stepped into
    assert not leads(-1, -1)
    assert not leads(2, row=900)  # not on the map
    assert not leads(2, way=jnp.array([[0, -1, 0, 0]], jnp.int8))
    assert not leads(2, way=jnp.array([[0, 2, 0, 0]], jnp.int8))  # to and fro
    assert not leads(2, way=jnp.array([[2, 0, 0, 0]], jnp.int8))  # over the edge
