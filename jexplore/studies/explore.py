"""One episode to look at: run it, walk its way again scan by scan, and draw it.

An episode's trail keeps cells and targets, not maps. `frames` makes the scans again on the host, one jitted call each,
and so sees the map, the frontiers and the target at every step.
"""

import dataclasses
import functools
import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jexplore.config import Lidar, Rules, require_whole
from jexplore.exploration import batch
from jexplore.exploration.batch import Final
from jexplore.exploration.episode import LOOK_AROUND, Stream
from jexplore.exploration.results import columns, length_along_m, map_state
from jexplore.exploration.site import prepare
from jexplore.grid import Grid, empty_grid, is_known
from jexplore.planning import Belief, field
from jexplore.raycast import disturb, fold, scan
from jexplore.reach import HEADING, MOTIONS
from jexplore.report import animate, plot
from jexplore.studies.checks import LIDAR, MAX_SEED, RULES, ready_starts, ready_strategies, ready_worlds, require_memory
from jexplore.worlds.world import World

MAX_FRAMES = 300
_HEADING_OF = dict(zip(MOTIONS, HEADING))


class Frame(NamedTuple):
    """An episode after some of its steps."""

    step: int  # steps made; 0 at the start
    hits: np.ndarray  # [H, W] int32
    misses: np.ndarray  # [H, W] int32
    frontier: np.ndarray  # [H, W] bool, frontier cells that can be reached and are not exhausted
    row: int  # the robot's cell
    col: int
    heading_deg: int
    target: tuple[int, int] | None  # row, col of what it goes to next; None in the end


@dataclasses.dataclass(frozen=True)
class Episode:
    """What `explore` found."""

    world: World
    strategy: str
    start: tuple[int, int, int]
    """Row, col, heading in degrees."""
    seed: int
    lidar: Lidar
    rules: Rules
    final: Final
    """The last map and the way there."""
    measures: dict
    """Name -> number or text: the columns of a comparison's table of episodes."""
    compile_s: float
    """Seconds spent compiling, or loading the compiled program."""
    run_s: float
    """Seconds in which the compiled program ran."""

    @property
    def title(self):
        """What a picture says above itself."""
        return f"{self.strategy} in {self.world.name}: {self.measures['path_m']:.1f} m, {self.measures['outcome']}"

    def figure(self):
        """The last map with the path, and how the known area grew with it: a matplotlib `Figure`."""
        final, cell_m = self.final, self.world.cell_m
        return plot.episode_figure(
            map_state(final.hits, final.misses, self.rules.p_free),
            final.rows,
            final.cols,
            cell_m,
            path_m=length_along_m(final.rows, final.cols, cell_m),
            known_cells=final.known,
            title=self.title,
        )

    def save_gif(self, path, *, max_frames=MAX_FRAMES, fps=12, on_progress=None):
        """Write the episode as an animated GIF: known map, frontiers, target, path.

        Args:
          path: the file.
          max_frames: of more steps, that many are shown, evenly spaced, the last among them.
          fps: frames a second.
          on_progress: called with 1 for each frame drawn.

        Raises:
          InputError: the file cannot be written.
        """
        animate.animate_gif(self._pictures(max_frames, on_progress), path, cell_m=self.world.cell_m, fps=fps)

    def _pictures(self, max_frames, on_progress):
        final, cell_m = self.final, self.world.cell_m
        length_m = length_along_m(final.rows, final.cols, cell_m)
        for frame in frames(self, max_frames=max_frames):
            known_m2 = int(final.known[frame.step]) * cell_m**2
            yield {
                "state": map_state(frame.hits, frame.misses, self.rules.p_free),
                "frontier": frame.frontier,
                "row": frame.row,
                "col": frame.col,
                "heading_deg": frame.heading_deg,
                "target": frame.target,
                "rows": final.rows[: frame.step + 1],
                "cols": final.cols[: frame.step + 1],
                "caption": f"{length_m[frame.step]:.1f} m driven, {known_m2:.0f} m² known",
            }
            if on_progress is not None:
                on_progress(1)


def explore(world, strategy, *, seed=0, cell_m=0.1, start="random", lidar=LIDAR, rules=RULES):
    """Runs one episode and keeps its map and way.

    It is episode 0 of a comparison with the same world, strategy, seed, start, scanner and rules.

    Args:
      world: name (`worlds.load_world`) or `World`.
      strategy: name (`policies.parse_strategy`).
      seed: of the start and the draws.
      cell_m: edge of a cell of a world that is loaded by name, metres.
      start: "random", "world" for the world's own, or `(row, col, heading_deg)`.
      lidar: `Lidar`.
      rules: `Rules`.

    Returns:
      `Episode`.

    Raises:
      InputError: a name, number, map or start that cannot be used. Raised before anything is compiled.
    """
    job = prepare_job(world, strategy, seed=seed, cell_m=cell_m, start=start, lidar=lidar, rules=rules)
    return run_job(job, lidar, rules)


def prepare_job(world, strategy, *, seed, cell_m, start, lidar, rules):
    """Everything that `explore` refuses or loads before it runs: a `batch.Job`. Arguments as there."""
    seed = require_whole("seed", seed, 0, MAX_SEED)
    (parsed,), (world,) = ready_strategies(strategy), ready_worlds(world, cell_m)
    require_memory(world, lidar, rules)
    return batch.Job(world, parsed, ready_starts(world, start, 1, seed=seed, rules=rules), seed)


def run_job(job, lidar, rules):
    """The `Episode` of a job of one start."""
    batch.use_compilation_cache()
    report = batch.run([job], lidar, rules)
    ((result, final),) = report.outcomes
    has_rooms, cell_m = job.world.rooms is not None, job.world.cell_m
    found = columns(result, job.starts, seed=job.seed, cell_m=cell_m, has_rooms=has_rooms)
    row, col, heading_deg = (int(value) for value in job.starts[0])
    return Episode(
        world=job.world,
        strategy=job.strategy.name,
        start=(row, col, heading_deg),
        seed=job.seed,
        lidar=lidar,
        rules=rules,
        final=final,
        measures={
            name: values[0].item() if hasattr(values[0], "item") else values[0] for name, values in found.items()
        },
        compile_s=report.compile_s,
        run_s=report.run_s,
    )


@functools.partial(jax.jit, static_argnames=("noisy",))
def _rescan(grid, row, col, heading, number, key, truth, beams, sigma_cells, dropout, *, noisy):
    """The map after one more scan, the `number`-th of the episode, with the noise that this scan had."""
    seen = scan(truth.occupied, row, col, heading, beams)
    if noisy:
        key = jax.random.fold_in(jax.random.fold_in(key, Stream.SENSOR), number)
        noise = {"sigma_cells": sigma_cells, "dropout": dropout}
        seen = disturb(key, seen, row, col, heading, beams, truth.extent[0], **noise)
    return fold(grid, row, col, heading, seen, beams)


_candidates = jax.jit(lambda belief: field(belief).candidates)


def headings_of(final, first):
    """Heading at the start and after each step, before any turn in place: `[n + 1]` ints, units of 45 degrees."""
    steps = zip(np.diff(final.rows).tolist(), np.diff(final.cols).tolist())
    return [first, *(_HEADING_OF[step] for step in steps)]


def frames(episode, *, max_frames=MAX_FRAMES):
    """The episode again, step by step.

    The scans are made again from the trail, so their maps are those of the episode, noise included. One kind of scan
    leaves no trace there: the one after a refused step, which only a noisy scanner can bring about. Where there were
    such (`measures["refused"]`), the maps in between lack them; the last map is always the episode's own. A view point
    counts as exhausted here by the rule for frontier cells: a frontier cell may be missing until the end.

    Args:
      episode: `Episode`.
      max_frames: at most so many frames, evenly spaced over the steps; the last step is always one.

    Yields:
      `Frame`s.
    """
    final, n = episode.final, len(episode.final.rows) - 1
    chosen = set(np.unique(np.linspace(n, 0, min(max_frames, n + 1)).round().astype(int)).tolist())
    for step, grid, belief, heading in _states(episode):
        if step not in chosen:
            continue
        height, width = episode.world.shape
        hits, misses = (np.asarray(a)[:height, :width] for a in (grid.hits, grid.misses))
        if step == n:
            hits, misses = final.hits, final.misses
        more = step < n and final.target_rows[step + 1] >= 0
        yield Frame(
            step=step,
            hits=hits,
            misses=misses,
            frontier=np.asarray(_candidates(belief))[:height, :width],
            row=int(final.rows[step]),
            col=int(final.cols[step]),
            heading_deg=45 * heading,
            target=(int(final.target_rows[step + 1]), int(final.target_cols[step + 1])) if more else None,
        )


def maps_at(episode, shares):
    """The maps that the robot had when it first knew some shares of the cells that it knew in the end.

    Args:
      episode: `Episode`.
      shares: ascending numbers from 0 to 1. Those that it had passed with its first scans at the start are left out.

    Yields:
      `(share, explored, state)`: the share that was reached, that which was known then, and `[H, W]` uint8, see
      `results.map_state`.
    """
    height, width = episode.world.shape
    known = episode.final.known / episode.final.known[-1]
    left = [share for share in shares if share > known[0]]
    for step, grid, _, _ in _states(episode):
        reached = [share for share in left if share <= known[step]]
        if reached:
            left = left[len(reached) :]
            hits, misses = (np.asarray(a)[:height, :width] for a in (grid.hits, grid.misses))
            yield reached[-1], float(known[step]), map_state(hits, misses, episode.rules.p_free)
        if not left:
            return


def _states(episode):
    """After each step: `(step, grid, belief, heading)`."""
    final, site = episode.final, prepare(episode.world, episode.lidar, episode.rules)
    shape = site.truth.occupied.shape
    rescan = functools.partial(
        _rescan,
        key=jax.random.fold_in(jax.random.key(np.uint32(episode.seed)), 0),
        truth=site.truth,
        beams=site.beams,
        sigma_cells=np.float32(site.sigma_cells),
        dropout=np.float32(site.dropout),
        noisy=site.noisy,
    )
    grid, number = empty_grid(shape), itertools.count()
    driven, exhausted = np.zeros(shape, bool), np.zeros(shape, bool)
    headings = headings_of(final, episode.start[2] // 45)
    for step, heading in enumerate(headings):
        row, col = int(final.rows[step]), int(final.cols[step])
        before_row, before_col = (int(a[max(step - 1, 0)]) for a in (final.rows, final.cols))
        driven[[row, row, before_row], [col, before_col, col]] = True
        if step == 0:
            turns = [heading + 8 // site.first_scans * k for k in range(site.first_scans)] if final.known[0] else []
        else:
            turns = [heading]
        looked = int(final.looked[step])
        for turn in [*turns, *(heading + 2 * k for k in range(1, looked + 1))]:
            grid = rescan(grid, np.int32(row), np.int32(col), np.int32(turn % 8), np.int32(next(number)))
        arrived = (row, col) == (final.target_rows[step], final.target_cols[step])
        if arrived and (looked == LOOK_AROUND or not site.look_around):
            near = np.asarray(is_known(grid))[row - 1 : row + 2, col - 1 : col + 2]
            exhausted[row, col] = not near.all()
        belief = Belief(
            grid=Grid(grid.hits, grid.misses),
            driven=jnp.asarray(driven),
            exhausted=jnp.asarray(exhausted),
            row=jnp.int32(row),
            col=jnp.int32(col),
            heading=jnp.int32(heading),
            extent=jnp.asarray(site.truth.extent[0]),
            p_free=jnp.float32(site.p_free),
            near_d2=jnp.int32(site.near_d2),
            cell_m=jnp.float32(site.cell_m),
            clearance_d2=site.clearance_d2,
        )
        yield step, grid, belief, (heading + 2 * looked) % 8
