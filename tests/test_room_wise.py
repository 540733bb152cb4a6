"""The modifier that prefers frontier cells in the robot's own segment."""

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref import beliefs

from jexplore.policies import parse_strategy
from jexplore.policies.room_wise import own_segment

pytestmark = pytest.mark.jit

# Two rooms and a door of three cells of 0.1 m. The frontier in the other room is nearer than that in the own one.
ROOMS = """
    ########################################
    #?...................#.................#
    #....................#.................#
    #....................#.................#
    #....................#.................#
    #....................#.................#
    #..................................?...#
    #...................R..................#
    #......................................#
    #....................#.................#
    #....................#.................#
    #....................#.................#
    #....................#.................#
    #....................#.................#
    ########################################
"""
# The same, but a wall with a gap of one cell, too narrow for the clearance, cuts off the own frontier.
CUT_OFF = """
    ########################################
    #?...#...............#.................#
    #....#...............#.................#
    #....#...............#.................#
    #....#...............#.................#
    #.####...............#.................#
    #..................................?...#
    #...................R..................#
    #......................................#
    #....................#.................#
    #....................#.................#
    #....................#.................#
    #....................#.................#
    #....................#.................#
    ########################################
"""
OWN, OTHER = (12, 2), (7, 34)


def belief_of(text=ROOMS):
    return beliefs.belief_of(text, clearance_d2=1)


def target(name, belief):
    return beliefs.target_of(name, belief, beliefs.LIDAR)


own = jax.jit(own_segment)


KINDS = {
    "": OWN,
    "=holz": OWN,
    "=wurm": OWN,
    "=thrun": OWN,
    # The door is 0.4 m wide from wall to wall, the room 13 x 20 cells.
    "=auto": OWN,
    "=auto:door_m=0.41": OWN,
    "=auto:door_m=0.39": OTHER,
    "=auto:room_m2=2.7": OWN,
    "=auto:room_m2=2.5": OTHER,
    "=voronoi": OWN,
    "=voronoi:ratio=0": OTHER,  # nothing is a door
    "=voronoi:smallest_m2=3": OTHER,
    "=rooms": OWN,
    "=rooms:door_m=0.41": OWN,
    "=rooms:door_m=0.39": OTHER,
    "=rooms:room_m2=2.5": OTHER,
    ":prominence_m=100": OTHER,  # no critical point: a single segment
    ":gamma=4": OTHER,  # both sides of the door count as one obstacle
}


def test_the_own_room_comes_first():
    belief = belief_of()
    assert target("closest", belief) == OTHER
    assert {kind: target(f"closest+segment{kind}", belief) for kind in KINDS} == KINDS


def test_the_segment_of_the_last_target_is_kept_until_it_is_done():
    policy = parse_strategy("closest+segment:keep=true").policy
    belief, select = belief_of(), jax.jit(policy.select)
    beams = beliefs.table(beliefs.LIDAR, belief)
    carry = policy.init(policy.params, belief)
    for last, done_from, want in (
        ((-1, -1), 40, OWN),  # no target before: the robot's own
        ((9, 30), 40, OTHER),
        ((9, 5), 40, OWN),
        ((0, 0), 40, OWN),  # a wall by now
        ((9, 30), 30, OWN),  # done: everything
    ):
        given = jnp.array(last, jnp.int32), carry[1]
        now = belief.replace(exhausted=jnp.broadcast_to(jnp.arange(40) >= done_from, (15, 40)))
        new, choice, _ = select(jax.random.key(0), policy.params, given, now, beams, jnp.zeros((15, 40), jnp.int8))
        assert (int(choice.row), int(choice.col)) == want
        assert new[0].tolist() == list(want)
    assert carry[0].tolist() == [-1, -1]
    assert policy.select != parse_strategy("closest+segment").policy.select


def test_what_cannot_be_reached_does_not_hold_the_robot():
    """A frontier in the own room that is cut off, or exhausted, and then none at all."""
    belief = belief_of(CUT_OFF)
    mine, _, overflow = own(parse_strategy("closest+segment").policy.params, belief)
    assert mine[OWN]
    assert not mine[OTHER]
    assert overflow == 0
    assert target("closest+segment", belief) == OTHER
    belief = belief_of()
    for exhausted, want in ((lambda c: c < 10, OTHER), (lambda c: c > 30, OWN), (lambda c: c >= 0, (-1, -1))):
        columns = jnp.broadcast_to(exhausted(jnp.arange(40)), (15, 40))
        assert target("closest+segment", belief.replace(exhausted=columns)) == want


def test_the_own_segment_is_the_room():
    belief = belief_of()
    free = np.asarray(belief.grid.misses) > 0
    rooms = np.where(np.arange(40) < 21, 1, 2)
    for kind in ("holz", "auto", "voronoi", "rooms"):
        params = parse_strategy(f"closest+segment={kind}").policy.params
        for col, room in ((20, 1), (5, 1), (23, 2), (36, 2)):
            mine, is_room, _ = own(params, belief.replace(col=jnp.int32(col)))
            assert is_room
            # The door itself may go to either side.
            np.testing.assert_array_equal(mine & (np.arange(40) != 21), free & (rooms == room) & (np.arange(40) != 21))


@pytest.mark.slow
def test_the_kinds_share_a_program():
    """They differ by numbers only, so that a sweep over them is compiled once."""
    policies = [parse_strategy(f"closest+segment{k}").policy for k in ("", "=holz", "=wurm", "=thrun", "=auto")]
    policies += [parse_strategy("closest+segment=auto:prominence_m=1,gamma=2,door_m=1,room_m2=1").policy]
    chex.clear_trace_counter()
    belief = belief_of()
    init, *_ = (p.init for p in policies)
    basins = [parse_strategy(f"closest+segment={k}").policy for k in ("voronoi", "rooms", "rooms:ratio=0.5,door_m=1")]
    select = jax.jit(chex.assert_max_traces(lambda params: own_segment(params, belief), n=2))
    for policy in (*policies, *basins):
        assert policy.select == policies[0].select
        assert hash(policy.select) == hash(policies[0].select)
        assert policy.init == init
        assert policy.live is None
        select(policy.params)
    views = [parse_strategy(f"{name}+segment").policy for name in ("gain-rate", "gain-rate", "mcdm")]
    assert views[0].select == views[1].select != views[2].select
    assert views[0].live == views[1].live is not None


def test_a_modified_strategy_asks_the_strategy_whether_a_view_point_is_live():
    belief = beliefs.belief_of("###### #.R.?# ######", cell_m=1.0)
    beams = beliefs.table(beliefs.Lidar(n_beams=4, fov_deg=360, range_m=2.0), belief)
    for min_gain in (1, 2):
        policy = parse_strategy(f"gain-rate+segment:min_gain={min_gain}").policy
        assert bool(jax.jit(policy.live)(policy.params, belief, beams, jnp.int32(1), jnp.int32(3))) == (min_gain == 1)
