"""One episode to look at: run it, play it again scan by scan, and draw it."""

import dataclasses
import functools
import os
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.transforms import Affine2D

from jexplore.arrays.padding import within
from jexplore.arrays.pictures import axes_of, html_of, or_text, png_of
from jexplore.config import InputError, checked_names, require_setting
from jexplore.engine.backend import use_compilation_cache
from jexplore.exploration import batch
from jexplore.exploration.batch import Job
from jexplore.exploration.motion import LENGTHS
from jexplore.exploration.replay import Moment, moments
from jexplore.exploration.results import length_along_m, map_state
from jexplore.exploration.site import prepare_site
from jexplore.exploration.team.jobs import Coordinate
from jexplore.exploration.team.replay import known_at, last_clock
from jexplore.exploration.team.team import Starts
from jexplore.exploration.trail import Final
from jexplore.policies import Strategy
from jexplore.report import animate, plot
from jexplore.report.page.replay import ReplayData, evenly
from jexplore.rules import Lidar, Rules
from jexplore.studies import checks
from jexplore.studies.replays import MAX_FRAMES, before_leaving, replay_data, why_no_replay
from jexplore.studies.results.units import rows_of
from jexplore.worlds.restrict import KnownMap, Polygon
from jexplore.worlds.world import World, ring_of


@checked_names
@dataclasses.dataclass(frozen=True)
class EpisodeResult:
    """Result of `explore`."""

    world: World
    strategy: str
    start: tuple[int, int, int]
    """Row, col, heading in degrees."""
    seed: int
    number: int
    """Of the episode in a comparison with this seed."""
    lidar: Lidar
    rules: Rules
    final: Final
    """The last map and the way there."""
    measures: dict[str, Any]
    """Name -> number or text: the columns of a comparison's table of episodes."""
    asked: Strategy
    """The strategy as it was run."""
    compile_s: float
    """Seconds spent compiling, or loading the compiled program."""
    run_s: float
    """Seconds in which the compiled program ran."""

    @property
    def can_be_replayed(self) -> bool:
        """Return whether its frames can be shown: it has a record of its plans, or is a team's."""
        return self.final.plans is not None or self.final.ways is not None

    @property
    def title(self) -> str:
        """Return the title of a picture."""
        return f"{self.strategy} in {self.world.name}: {self.measures['path_m']:.1f} m, {self.measures['outcome']}"

    def figure(self) -> Figure:
        """Draw the last map with the path, and the growth of the known area: a matplotlib `Figure`."""
        final, cell_m = self.final, self.world.cell_m
        (rows, cols), estimate = self._ways
        path_m = length_along_m(final.rows, final.cols, cell_m) if final.poses is None else final.poses[:, 0]
        known_cells = final.n_known
        if final.seen_at is not None:
            clocks = evenly(last_clock(final), MAX_FRAMES)
            path_m = np.array(clocks) / LENGTHS[0] * cell_m
            known_cells = known_at(final, self.world.within, clocks)
        return plot.episode_figure(
            *(map_state(final.hits, final.misses, self.rules.p_free), rows, cols, cell_m),
            estimate=estimate,
            path_m=path_m,
            known_cells=known_cells,
            title=self.title,
        )

    @property
    def _ways(self):
        """Return true and estimated way, each rows and columns of cells' centres; no estimated one of a given pose."""
        poses = self.final.poses
        if poses is None:
            return self.final.own_cells, None
        x, y, own_x, own_y = poses[:, 1:].T - 0.5
        return (y, x), None if self.rules.pose == "true" else (own_y, own_x)

    def plot(self, ax: Any = None) -> Any:
        """Draw the last map with the path, in metres of the map's frame, on `Axes`, by default new; return them."""
        ax, final, world = axes_of(ax), self.final, self.world
        state = map_state(final.hits, final.misses, self.rules.p_free)
        true, estimate = self._ways
        drawn = [
            plot.draw_map(ax, state, world.cell_m),
            *(artist for way in plot.ways_of(*true) for artist in plot.draw_path(ax, *way, world.cell_m)),
        ]
        drawn += [] if estimate is None else [plot.draw_estimate(ax, *estimate, world.cell_m)]
        for artist in drawn:  # which lie at metres from the corner of cell (0, 0)
            artist.set_transform(Affine2D().translate(*world.origin_m) + ax.transData)
        ends = [(low, low + n * world.cell_m) for low, n in zip(world.origin_m, world.shape[::-1])]
        ax.set(xlim=ends[0], ylim=ends[1], xlabel="x (m)", ylabel="y (m)")
        ax.set_title(self.title).set_parse_math(False)
        return ax

    @functools.cached_property
    def _picture(self):
        return png_of(self.figure())

    def __repr__(self) -> str:
        return f"<Episode {self.title}>"

    @or_text
    def _repr_png_(self):
        return self._picture

    @or_text
    def _repr_html_(self):
        measures = self.measures
        row, col, heading_deg = self.start
        found = {
            "path": f"{measures['path_m']:.1f} m",
            "explored": f"{measures['explored_fraction']:.1%}",
            "95 % known after": f"{measures['path_m_at_95']:.1f} m",
            **{name: f"{measures[name]}" for name in ("plans", "scans", "outcome")},
        }
        caption = f"episode {self.number} of seed {self.seed}, from row {row}, col {col}, heading {heading_deg}°"
        return html_of(self._picture, caption, list(found), [list(found.values())])

    def save_gif(
        self, path: str | os.PathLike[str], *, max_frames: int = MAX_FRAMES, fps: int = 12,
        on_progress: Callable[[int], object] | None = None,
    ) -> None:  # fmt: skip
        """Write the episode as an animated GIF: known map, frontiers, target, path.

        Args:
          path: the file.
          max_frames: of more steps, that many are shown, evenly spaced, the last among them.
          fps: frames a second.
          on_progress: called with 1 for each frame drawn.
        """
        replay = self.replay if max_frames == MAX_FRAMES else replay_of(self, max_frames=max_frames)
        driven_m, what = length_along_m(replay.rows, replay.cols, replay.cell_m)[replay.steps], "driven"
        if replay.clock_m is not None:
            driven_m, what = replay.clock_m, "on the clock"
        captions = (f"{way:.1f} m {what}, {known:.0f} m² known" for way, known in zip(driven_m, replay.known_m2))
        animate.save_animation(replay, captions, path, fps=fps, on_progress=on_progress)

    @functools.cached_property
    def replay(self) -> ReplayData:
        """Return the frames of its page, `MAX_FRAMES` at most."""
        return replay_of(self)


@checked_names
def explore(
    world: checks.WorldLike, strategy: checks.StrategyLike, *, seed: int = 0, episode: int = 0, cell_m: float = 0.1,
    start: checks.StartLike = "random", start_m: Sequence[float] | None = None, within: str | Polygon | None = None,
    from_map: KnownMap | None = None, lidar: checks.LidarLike = checks.LIDAR, rules: checks.RulesLike = checks.RULES,
    robot: checks.RobotLike = checks.ROBOT, pose: str | None = None, odometry: checks.OdometryLike = None,
    robots: int | None = None, coordination: Coordinate = "independent", contact: str = "all",
    team_starts: Starts = "together", members: str | Sequence[str] = (),
) -> EpisodeResult:  # fmt: skip
    """Run one episode and keep its map and way.

    It is that episode of a comparison with the same world, strategy, seed, start, scanner and rules.

    Args:
      world, strategy: one of each; see `compare`.
      episode: its number, from 0.
      seed, cell_m, start, start_m, within, from_map, lidar, rules, robot, pose, odometry: as in `compare`.
      robots, coordination, contact, team_starts, members: of a team, one of each, as in `compare`.
    """
    where = {"cell_m": cell_m, "start": start, "start_m": start_m, "within": within, "from_map": from_map}
    where |= {"robot": robot, "pose": pose, "odometry": odometry}
    where |= {"robots": robots, "coordination": coordination, "contact": contact, "team_starts": team_starts}
    where["members"] = members
    return run_job(prepare_job(world, strategy, seed=seed, episode=episode, lidar=lidar, rules=rules, **where))


def prepare_job(world: checks.WorldLike, strategy: checks.StrategyLike, *, episode: int = 0, **settings: Any) -> Job:
    """Check and load everything before `explore` runs: a `Job` of episodes up to its own. `settings` as there."""
    jobs = checks.prepare_jobs(world, strategy, episodes=require_setting("episode", episode) + 1, **settings)
    if len(jobs) > 1:
        raise InputError("an episode has one number of robots and one coordination")
    return jobs[0]


def run_job(job: Job) -> EpisodeResult:
    """Run the last episode of a job."""
    use_compilation_cache()
    number = len(job.starts) - 1
    lidar, rules = job.lidar or checks.LIDAR, job.rules or checks.RULES
    report = batch.run_jobs([job], lidar, rules, only=number)
    (found,) = report.outcomes
    assert found.first is not None  # a run that was interrupted has raised
    last = {name: values[number] for name, values in rows_of(job, found).items()}
    start = tuple(job.starts[number].tolist())
    return EpisodeResult(
        *(job.world, job.strategy.name, start, job.seed, number, lidar, rules, found.first),
        measures={name: value.item() if hasattr(value, "item") else value for name, value in last.items()},
        asked=job.strategy,
        compile_s=report.costs.compile_s,
        run_s=report.costs.run_s,
    )


def replay_of(episode: EpisodeResult, *, max_frames: int = MAX_FRAMES) -> ReplayData:
    """Convert an episode to the frames of a page; see `replays.replay_data`."""
    how = {name: getattr(episode, name) for name in ("start", "seed", "number", "lidar", "rules")}
    how |= {"outcome": episode.measures["outcome"], "max_frames": max_frames}
    return replay_data(episode.world, episode.asked, episode.final, **how)


def steps_of(episode: EpisodeResult) -> Iterator[Moment]:
    """Return the episode again: its last `replay.Moment` at every step."""
    if episode.final.seen_at is not None:
        raise InputError(f"{episode.title}: a team's episode has no steps; save_gif and figure show it")
    if episode.final.plans is None:
        raise InputError(f"{episode.title}: {why_no_replay(episode.rules)}")
    site = prepare_site(episode.world, episode.lidar, episode.rules)
    found = moments(site, episode.asked, episode.start, episode.seed, episode.number, episode.final.plans)
    return before_leaving(found, range(len(episode.final.rows)))


def maps_at(episode: EpisodeResult, shares: Sequence[float]) -> Iterator[tuple[float, float, np.ndarray]]:
    """Yield the robot's maps when it first knew some shares, ascending, of its final known cells, past the start.

    Each is `(share, explored, state)`: the share reached, that known then, and the map by `results.map_state`.
    """
    known = episode.final.n_known / max(episode.final.n_known[-1], 1)
    left = [share for share in shares if share > known[0]]
    for moment in steps_of(episode):
        reached = [share for share in left if share <= known[moment.step]]
        if reached:
            left = left[len(reached) :]
            grid, ring = moment.belief.grid, ring_of(episode.world.occupied)
            state = map_state(np.asarray(grid.hits), np.asarray(grid.misses), episode.rules.p_free)
            yield reached[-1], float(known[moment.step]), within(state, episode.world.shape, ring)
        if not left:
            return
