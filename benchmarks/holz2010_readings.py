"""Test other readings of points that Holz et al. 2010 leave open: does an ordering that does not hold depend on them?

    python benchmarks/holz2010_readings.py [MAP@SCALE | WORLD] [EPISODES]

- Rooms with the Voronoi diagram of occupied cells only (Figure 7, step 1): unknown cells are no walls.
- Cells as near to an obstacle as the clearance are traversable (section 2.2 drops those *below* it).
- "The segment currently being explored" (section 2.4) is that of the last target until it is done (`keep`), not that in
  which the robot happens to be when it decides: with re-checking it decides anew on its way through others.
- `decision-theoretic` that looks ahead, not all round, along the way by which it comes, and that ends when no view
  point shows enough, instead of going to the nearest frontier (section 3.2).

Ratios of mean paths, paired, next to the reproduced ones; of episodes that end early also at equal coverage.
"""

import sys

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

import jexplore as jx
from jexplore import Rules, compare
from jexplore.arrays.loops import repeat, run_if
from jexplore.bench.tables import markdown
from jexplore.gain import look, prospect
from jexplore.grid import is_free, is_occupied
from jexplore.planning import choose, field, known_of, metres, nearest_of
from jexplore.policies import parse_strategy, views
from jexplore.policies.policy import Policy, no_carry
from jexplore.raycast import by_beam, square_side
from jexplore.report.tables import ratio_text
from jexplore.segment import PROMINENCE_M, criteria, form_for, segment
from jexplore.studies.statistics.by_world import path_at_equal_coverage
from jexplore.studies.statistics.paired import paired_ratio

NEAREST = parse_strategy("closest").policy


def _in_room(key, params, carry, belief, beams, route):
    """`closest`, first within the segment of a map whose unknown cells are no walls."""
    rows, cols = (lax.broadcasted_iota(jnp.int32, belief.driven.shape, axis) for axis in (0, 1))
    inside = (rows < belief.extent[0]) & (cols < belief.extent[1])
    open_cells = inside & ~is_occupied(belief.grid, belief.model.p_free)
    how = criteria("holz", gamma=3.0).replace(prominence=params / belief.model.cell_m)
    found = segment(open_cells, how, form=form_for(open_cells.shape))
    mine = (found.label == found.label[belief.row, belief.col]) & is_free(belief.grid, belief.model.p_free)
    here = belief.replace(exhausted=belief.exhausted | ~mine)
    first = NEAREST.select(key, (), carry, here, beams, route)
    return run_if(first[1].row < 0, lambda first: NEAREST.select(key, (), carry, belief, beams, first[2]), first)


def rooms_by_walls(prominence_m: float = PROMINENCE_M) -> Policy:
    """Room by room, as `closest+segment`, with walls as the only sites."""
    return Policy(NEAREST.init, _in_room, jnp.float32(prominence_m))


def _ahead(key, params, carry, belief, beams, route):
    """The sampled view point with the best look ahead, in the direction in which it lies from the robot."""
    view, falls_back = params
    reached = field(belief)
    height, width = reached.cost.shape
    row, col = views.drawn(key, belief, reached, view)
    n = jnp.where(jnp.any(reached.frontier), view.samples, 0)
    row, ahead = jnp.minimum(row, height - 1), prospect(known_of(belief), beams.all_round)
    offset = beams.drow * square_side(beams) + beams.dcol
    beams = beams.replace(offset=offset, by_beam=by_beam(offset), all_round=None)
    path_m = metres(reached.cost[row, col], belief.model.cell_m)
    turn = jnp.arctan2((row - belief.row).astype(jnp.float32), (col - belief.col).astype(jnp.float32))
    heading = jnp.round(turn / (jnp.pi / 4)).astype(jnp.int32) % 8

    def evaluate(state):
        i, best, cell = state
        one = jax.tree.map(lambda a: a[heading[i]][None] if a.ndim else a, beams)
        told = look(ahead, row[i], col[i], one)
        worth = views.gain_for_path(view, told.gain, path_m[i])
        better = (i < n) & (told.unknown >= view.min_gain) & (worth > best)
        new = jnp.where(better, worth, best), jnp.where(better, row[i] * width + col[i], cell)
        return i + (i < n), *new

    state = jnp.int32(0), jnp.float32(-jnp.inf), jnp.int32(-1)
    _, _, cell = repeat(lambda state: state[0] < n, evaluate, state)
    near_row, near_col = nearest_of(reached)
    falls_back = falls_back & (cell < 0)
    row = jnp.where(cell >= 0, cell // width, jnp.where(falls_back, near_row, -1))
    col = jnp.where(cell >= 0, cell % width, jnp.where(falls_back, near_col, -1))
    choice, route = choose(belief, route, reached, row, col)
    return carry, choice.replace(is_view=cell >= 0), route


def theoretic_ahead(samples: int = 500, falls_back: bool = True) -> Policy:
    """`decision-theoretic` whose looks are ahead."""
    view = views.views(("lam", 0.2), samples, 1.0, 10)
    return Policy(no_carry, _ahead, (view, np.bool_(falls_back)), lambda params, *rest: views.live(params[0], *rest))


def _text(found):
    return ratio_text(found.ratio, found.low, found.high)


def main(arguments):
    world = arguments[0] if arguments else "hospital"
    episodes = int(arguments[1]) if len(arguments) > 1 else 20
    closest, recheck = "closest", "closest+recheck"
    theoretic = "decision-theoretic"
    others = {
        "rooms": jx.strategy(rooms_by_walls(), name="rooms", recheck=True),
        "literal rooms": jx.strategy(rooms_by_walls(0.0), name="literal rooms", recheck=True),
        "ahead": jx.strategy(theoretic_ahead(), name="ahead"),
        "ahead, ends": jx.strategy(theoretic_ahead(falls_back=False), name="ahead, ends"),
    }
    names = [closest, recheck, f"{recheck}+segment", f"{recheck}+segment:prominence_m=0", theoretic]
    kept = [f"{recheck}+segment:keep=true", f"{recheck}+segment:prominence_m=0,keep=true"]
    lines = [
        ("as reproduced: re-checking", recheck, closest),
        ("as reproduced: rooms", names[2], recheck),
        ("as reproduced: rooms, literal minima", names[3], recheck),
        ("as reproduced: decision-theoretic", theoretic, closest),
        ("the last target's segment is kept: rooms", kept[0], recheck),
        ("the last target's segment is kept: rooms, literal minima", kept[1], recheck),
        ("sites from walls only: rooms", "rooms", recheck),
        ("sites from walls only: rooms, literal minima", "literal rooms", recheck),
        ("looks ahead: decision-theoretic", "ahead", closest),
        ("looks ahead, ends without a view point: decision-theoretic", "ahead, ends", closest),
    ]
    rows = []

    def add(lines, found, note=""):
        table = found.to_pandas()
        paths = table.pivot(index="episode", columns="strategy", values="path_m")
        for what, of, to in lines:
            seen = table[table["strategy"] == of]
            one, other = (found.progress[seen["world"].iloc[0], name] for name in (of, to))
            equal = paired_ratio(*path_at_equal_coverage(one, other))
            told = [_text(paired_ratio(paths[of], paths[to])), _text(equal), f"{seen['explored_fraction'].mean():.1%}"]
            rows.append([note + what, *told, f"{(seen['outcome'] == 'COMPLETE').mean():.0%}"])
        print(f"{note or 'readings'}: done", file=sys.stderr, flush=True)

    add(lines, compare(world, [*names, *kept, *others.values()], episodes=episodes))
    less = compare(world, names, episodes=episodes, rules=Rules(clearance_m=0.2999))
    add(
        [(what.removeprefix("as reproduced: "), *pair) for what, *pair in lines[:4]],
        less,
        "clearance compared with <: ",
    )
    alone = compare(
        world, [closest, others["ahead"], others["ahead, ends"]], episodes=episodes, rules=Rules(look_around=False)
    )
    add(lines[-2:], alone, "no look around on arrival, ")
    print(f"{world}, {episodes} starts\n")
    print(markdown(["reading", "ratio of paths", "at equal coverage", "free cells seen", "COMPLETE"], rows))


if __name__ == "__main__":
    main(sys.argv[1:])
