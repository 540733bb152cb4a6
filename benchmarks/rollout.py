"""Is it worth while to play every first choice to the end before making it? On the true map, and on completed ones.

    python benchmarks/rollout.py [STARTS]

Of the best targets by `small-first` each is driven to and `closest+recheck` goes on from there, in a simulation on a
map that is completed from the robot's own: by the true one (which no robot has), by free cells up to some metres from
known free ones and walls beyond, or by copies of parts known elsewhere, turned over and shifted to a frontier. The
target of the shortest simulated path is taken, if it is shorter by a margin than that of the best target's. Worlds
#1000 and #1001.
"""

import functools
import sys
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

import jexplore as jx
from jexplore.arrays.loops import repeat, run_if
from jexplore.arrays.padding import bucket
from jexplore.bench.tables import markdown
from jexplore.distance import nearest_offset
from jexplore.exploration.motion import motion_step
from jexplore.grid import is_known, is_occupied
from jexplore.planning import field, is_live, nearest_frontier
from jexplore.policies.clusters import go_to, looks, paths_apart, targets
from jexplore.policies.distance_advantage import advantage
from jexplore.policies.policy import Policy, no_carry
from jexplore.raycast import fold, scan
from jexplore.reach import DIAGONAL, STRAIGHT
from jexplore.studies.statistics.league import paths_by_world

WORLDS = ("rooms#1000", "rooms#1001", "cave#1000", "cave#1001", "maze#1000", "maze#1001")
LIMIT_M = 250.0  # of a simulated path


class Params(NamedTuple):
    """Parameters."""

    most: int  # targets that are tried
    margin_m: float  # by which another target must be better than the first
    depth_m: float  # how far from known free cells unknown ones may be free
    samples: int  # completed maps; 0: one whose unknown cells are free
    truth: jax.Array  # [H, W] bool, occupied; or a single True where the map is completed


class Play(NamedTuple):
    """A simulation under way."""

    belief: object
    route: jax.Array
    target: jax.Array
    walking: jax.Array
    cost: jax.Array
    done: jax.Array


def completed(key, belief, at, params):
    """Occupied cells of a map without unknown ones, which ends at the world's outermost cells: `[H, W]` bool."""
    shape = belief.driven.shape
    known, walls = is_known(belief.grid), is_occupied(belief.grid, belief.model.p_free)
    free = known & ~walls
    rows, cols = (lax.broadcasted_iota(jnp.int32, shape, axis) for axis in (0, 1))
    inner = (rows > 0) & (cols > 0) & (rows < belief.extent[0] - 1) & (cols < belief.extent[1] - 1)
    deep = nearest_offset(free)[0] > (params.depth_m / belief.model.cell_m) ** 2
    which, where, turn = jax.random.split(key, 3)
    cell = jnp.argmax(jnp.where(free.reshape(-1), jax.random.uniform(which, (free.size,)), -1))
    slot = jnp.argmax(jnp.where(at.used, jax.random.uniform(where, at.used.shape), -1))
    sign = jnp.where(jax.random.bits(turn, (2,)) & 1, 1, -1)
    row = cell // shape[1] + sign[0] * (jnp.arange(shape[0]) - at.row[slot])
    col = cell % shape[1] + sign[1] * (jnp.arange(shape[1]) - at.col[slot])
    inside = ((row >= 0) & (row < shape[0]))[:, None] & ((col >= 0) & (col < shape[1]))
    copied = walls[jnp.clip(row, 0, shape[0] - 1)][:, jnp.clip(col, 0, shape[1] - 1)] & inside & (params.samples > 0)
    return jnp.where(known, walls, copied | deep | ~inner)


def played(belief, walls, beams, choice, route):
    """Cost of driving to a target and going on as `closest+recheck` does until no frontier is left."""
    limit = jnp.round(LIMIT_M / belief.model.cell_m * STRAIGHT).astype(jnp.int32)
    outside = belief.driven.shape[0]

    def seen(belief, heading, when):
        found = scan(walls, belief.row, belief.col, heading, beams)
        return belief.replace(grid=fold(belief.grid, belief.row, belief.col, heading, found, beams, when=when))

    def plan(play):
        choice, route = nearest_frontier(play.belief, play.route)
        return play._replace(route=route, target=jnp.stack([choice.row, choice.col]), done=choice.row < 0)

    def going(play):
        return ~play.done & (play.cost < limit)

    def step(play):
        on = going(play)
        play = run_if(on & ~play.walking, plan, play)
        on, belief, target = on & ~play.done, play.belief, play.target
        row, col = belief.row, belief.col
        drow, dcol, heading = motion_step(play.route[row, col])
        moves = on & ((row != target[0]) | (col != target[1]))
        length = jnp.where(moves, jnp.where((drow != 0) & (dcol != 0), DIAGONAL, STRAIGHT), 0)
        new_row, new_col = row + drow * moves, col + dcol * moves
        rows = jnp.where(moves, jnp.stack([new_row, new_row, row]), outside)
        driven = belief.driven.at[rows, jnp.stack([new_col, col, new_col])].set(True, mode="drop")
        heading = jnp.where(moves, heading, belief.heading)
        belief = seen(belief.replace(row=new_row, col=new_col, heading=heading, driven=driven), heading, on)
        here = on & (new_row == target[0]) & (new_col == target[1])
        look = here & is_live(belief, *target)
        belief = run_if(look, lambda belief: seen(belief, (belief.heading + 4) % 8, True), belief)
        live = is_live(belief, *target)
        spent = jnp.where(here & live, target[0], outside)
        belief = belief.replace(exhausted=belief.exhausted.at[spent, target[1]].set(True, mode="drop"))
        walking = jnp.where(on, ~here & live, play.walking)
        return play._replace(belief=belief, walking=walking, cost=play.cost + length)

    target = jnp.stack([choice.row, choice.col])
    start = Play(belief, route, target, choice.row >= 0, jnp.int32(0), jnp.bool_(False))
    return jnp.minimum(repeat(going, step, start).cost, limit)


def _select(key, params, carry, belief, beams, route):
    known = field(belief)
    at = targets(belief, known)
    area = looks(belief, at, beams)[0].astype(jnp.float32)
    usable = jnp.where(jnp.any(area > 0), at.used & (area > 0), at.used)
    worth = advantage(at.path_m, paths_apart(belief, at), usable, 0.5, area) - 0.5 * belief.model.cell_m * jnp.sqrt(
        area
    )
    order = jnp.argsort(jnp.where(usable, -worth, jnp.inf))
    n = jnp.minimum(jnp.sum(usable, dtype=jnp.int32), params.most)
    truth = jnp.broadcast_to(params.truth, belief.driven.shape)

    def one_map(state):
        number, total, route = state
        walls = jnp.where(jnp.all(truth), completed(jax.random.fold_in(key, number), belief, at, params), truth)

        def one(state):
            i, total, route = state
            choice, route = go_to(belief, route, known, at, order[i])
            return i + 1, total.at[i].add(played(belief, walls, beams, choice, route).astype(jnp.float32)), route

        return number + 1, *repeat(lambda state: (state[0] < n) & (n > 1), one, (jnp.int32(0), total, route))[1:]

    state = jnp.int32(0), jnp.zeros(order.shape, jnp.float32), route
    _, total, route = repeat(lambda state: state[0] < jnp.maximum(params.samples, 1), one_map, state)
    slots, margin = jnp.arange(len(order)), params.margin_m / belief.model.cell_m * STRAIGHT
    score = total / jnp.maximum(params.samples, 1) + jnp.where(slots > 0, margin, 0.0)
    which = order[jnp.argmin(jnp.where(slots < n, score, jnp.inf))].astype(jnp.int32)
    return carry, *go_to(belief, route, known, at, jnp.where(jnp.any(at.used), which, -1))


def rollout(most=8, margin_m=0.0, depth_m=3.0, samples=0, truth=np.True_):
    """The policy."""
    return Policy(no_carry, _select, Params(most, float(margin_m), float(depth_m), samples, np.asarray(truth)))


def occupied(world):
    """A world's walls, padded as in an episode."""
    height, width = world.shape
    return np.pad(world.occupied, [(0, bucket(n) - n) for n in (height, width)], constant_values=True)


def main(arguments):
    starts = int(arguments[0]) if arguments else 2
    settings = {
        "small-first alone": {"most": 1},
        "the true map": {"truth": True},
        **{f"free up to {d:g} m": {"depth_m": d} for d in (1.5, 3.0, 8.0)},
        **{f"free up to {d:g} m, margin 5 m": {"depth_m": d, "margin_m": 5.0} for d in (1.5, 8.0)},
        "3 copies": {"samples": 3, "most": 4},
        "3 copies, margin 5 m": {"samples": 3, "most": 4, "margin_m": 5.0},
    }
    tables = []
    for name in WORLDS:
        world = jx.load_world(name)
        strategies = ["closest+recheck"]
        for what, own in settings.items():
            own = own | ({"truth": occupied(world)} if "truth" in own else {})
            strategies.append(jx.strategy(functools.partial(rollout, **own)(), name=what, recheck=True))
        tables.append(paths_by_world(jx.compare(world, strategies, episodes=starts).episodes))
        print(f"{name}: done", file=sys.stderr, flush=True)
    rows = []
    for what in settings:
        logs = np.concatenate([table.loc[table["strategy"] == what, "log_ratio"] for table in tables])
        spread = np.std(logs, ddof=1) / len(logs) ** 0.5
        rows.append([what, f"{np.exp(np.mean(logs)):.3f} ± {spread:.3f}", *(f"{r:.3f}" for r in np.exp(logs))])
    print(markdown(["completed by", "path / closest+recheck", *WORLDS], rows))


if __name__ == "__main__":
    main(sys.argv[1:])
