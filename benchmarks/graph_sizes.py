"""Measure the size of rooms' structures on the maps that an exploring robot plans on.

    python benchmarks/graph_sizes.py [CELL_M...]

Counted are nodes and critical points of Voronoi graphs; peaks, passes and edges of watersheds. `segment.form_for` and
`watershed.room_form_for` must have room for them. Built-in worlds of several sizes, for cells of 0.05 to 0.3 m.
"""

import functools
import sys

import jax
import jax.numpy as jnp

from jexplore import Lidar, Rules
from jexplore.bench.tables import markdown
from jexplore.config import InputError
from jexplore.engine.backend import use_compilation_cache
from jexplore.exploration import batch, replay
from jexplore.exploration.site import COARSE_M, prepare_site
from jexplore.grid import any_within_one, is_free, is_known
from jexplore.policies import parse_strategy
from jexplore.rooms import watershed
from jexplore.segment import PROMINENCE_M, Form, criteria, form_for, segment
from jexplore.worlds import load_world
from jexplore.worlds.starts import draw_starts

FULL = "furniture=1,wide_openings=0.1,max_loops=5"
SIZES = {
    "cave": ((6.2, 6.2), (9.0, 9.0), (16.0, 16.0), (25.0, 25.0)),
    "maze": ((4.0, 4.0), (9.0, 9.0), (16.0, 16.0)),
    "rooms": ((6.0, 6.0), (9.0, 9.0), (20.0, 20.0)),
    "office": ((14.0, 9.0), (30.0, 20.0)),
    "hospital": ((32.0, 11.0), (50.0, 20.0)),
    f"office:{FULL}": ((14.0, 9.0), (30.0, 20.0)),
    f"hospital:{FULL}": ((50.0, 20.0),),
    f"rooms:{FULL}": ((6.0, 6.0), (20.0, 20.0)),
}
CELLS_M = (0.3, 0.2, 0.1, 0.05)
PLANS = 24  # of an episode, at which the graph is made
WHAT = ("nodes", "critical", "peaks", "passes", "edges")


@functools.partial(jax.jit, static_argnums=1)
def _counts(belief, form):
    free, unknown = is_free(belief.grid, belief.model.p_free), ~is_known(belief.grid)
    found = segment(free, criteria(prominence=PROMINENCE_M / belief.model.cell_m), form=form)
    clutter = watershed.room_criteria(1.0).clutter / belief.model.cell_m
    wide = watershed.RoomForm(free.size // 8, free.size // 8, free.size)
    rooms = watershed.watershed(free, unknown, watershed.room_criteria(1.0).replace(clutter=clutter), form=wide)
    edges, overflow = jnp.sum(~free & any_within_one(free)), found.overflow + rooms.overflow
    return jnp.sum(found.graph.cell < free.size), found.count, rooms.peaks, rooms.passes, edges, overflow


def measure(world, seed=5):
    """The most of `WHAT` in one episode of `closest+recheck`: `(padded shape, *most)`."""
    lidar, rules, strategy = Lidar(), Rules(), parse_strategy("closest+recheck")
    starts = draw_starts(world, seed, 1, rules.clearance_m)
    site = prepare_site(world, lidar, rules)
    found = batch.run_jobs([batch.Job(world, strategy, starts, seed)], lidar, rules)
    plans, shape = found.outcomes[0].first.plans, site.truth.occupied.shape
    form = Form(nodes=shape[0] * shape[1] // 4, splits=2048)
    every, found = max(1, len(plans) // PLANS), []

    def measure_plan(belief, _):
        found.append((0,) * (len(WHAT) + 1))
        if len(found) % every == 0 or len(found) > len(plans) - 3:
            found[-1] = tuple(map(int, _counts(belief, form)))

    for _ in replay.moments(site, strategy, starts[0], seed, 0, plans, measure_plan):
        pass
    *most, overflow = map(max, zip(*found))
    assert overflow == 0
    return shape, *most


def main(arguments):
    use_compilation_cache()
    rows, worst = [], {coarse: [0.0] * len(WHAT) for coarse in (True, False)}
    for cell_m in map(float, arguments) if arguments else CELLS_M:
        for kind, sizes in SIZES.items():
            for seed, (width_m, height_m) in enumerate(sizes):
                base, _, more = kind.partition(":")
                name = f"{base}#{seed}:width_m={width_m},height_m={height_m}" + (f",{more}" if more else "")
                try:
                    world = load_world(name, cell_m)
                except InputError as error:
                    print(error, file=sys.stderr)
                    continue
                shape, *counts = measure(world)
                cells, coarse = shape[0] * shape[1], cell_m > COARSE_M
                form = form_for(shape, coarse=coarse)[:2] + watershed.room_form_for(shape, coarse=coarse)
                worst[coarse] = [max(a, n / cells) for a, n in zip(worst[coarse], counts)]
                fits = all(n <= room for n, room in zip(counts, form))
                rooms = [f"{n} of {room}" for n, room in zip(counts, form)]
                rows.append([name, f"{cell_m:g}", f"{shape[0]} x {shape[1]}", *rooms, "yes" if fits else "NO"])
    print(markdown(["world", "cell m", "padded", *WHAT, "fits"], rows))
    for coarse, shares in worst.items():
        if any(shares):
            most = ", ".join(
                f"{what} one cell in {1 / share:.3g}" if share else f"{what} none" for what, share in zip(WHAT, shares)
            )
            print(f"{'coarse' if coarse else 'fine'} maps, the most: {most}")


if __name__ == "__main__":
    main(sys.argv[1:])
