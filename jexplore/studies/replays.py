"""Replays for a page: episodes that have been run, as frames."""

import dataclasses
import functools
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np

from jexplore.arrays.padding import within
from jexplore.config import InputError
from jexplore.engine.backend import use_compilation_cache
from jexplore.engine.runner import own_cores
from jexplore.exploration import batch
from jexplore.exploration.batch import Job
from jexplore.exploration.motion import LENGTHS
from jexplore.exploration.native import show_episode
from jexplore.exploration.replay import Moment, moments
from jexplore.exploration.site import prepare_site
from jexplore.exploration.state import Outcome
from jexplore.exploration.team.replay import known_at, last_clock, robot_at, team_beliefs
from jexplore.exploration.trail import Final
from jexplore.grid import is_free, is_occupied
from jexplore.planning import field
from jexplore.policies import Strategy, room_wise
from jexplore.report.page.replay import FRONTIER, OWN_ROOM, ReplayData, RobotReplay, changes_of, evenly
from jexplore.rules import Lidar, Rules
from jexplore.worlds.world import World, ring_of

MAX_FRAMES = 300  # of a replay
MAX_PAIRS = 12  # of world and strategy that are replayed on one page
EPISODES = 3  # of each pair
FEWER_FRAMES = 100  # of a replay of a later episode: maps are what a replay costs


@jax.jit
def _codes(belief):
    grid, p_free = belief.grid, belief.model.p_free
    state = is_free(grid, p_free) + 2 * is_occupied(grid, p_free)
    return (state + FRONTIER * field(belief).frontier).astype(jnp.uint8)


@jax.jit
def _own_room(params, belief):  # of a strategy that keeps its segment, too: where the robot is
    mine, is_room, _ = room_wise.own_segment(params, belief)
    return mine & is_room


def why_no_replay(rules: Rules) -> str:
    """Return why an episode whose plans are not on record cannot be replayed."""
    if rules.on_lattice:
        return "no replay, it made more plans than are kept"
    return "no replay, " + ("its pose was not given" if rules.motion == "lattice" else "it did not move cell by cell")


def replay_data(
    world: World, strategy: Strategy, final: Final, *, start: tuple[int, int, int], seed: int, number: int,
    lidar: Lidar, rules: Rules, outcome: str = "", max_frames: int = MAX_FRAMES, engine: str = "auto",
) -> ReplayData:  # fmt: skip
    """Convert one episode to the frames of a page: the maps after the last scan at each place that is shown.

    Frames are `max_frames` at most, evenly spaced over the steps, of a team over time, the last step among them. With
    engine "jax" there is no native code; the frames are the same.
    """
    common = {
        **{"world": world.name, "strategy": strategy.name, "which": f"seed {seed}", "episode": number},
        **{"outcome": outcome, "cell_m": world.cell_m, "truth": world.occupied, "rooms": world.rooms},
    }
    if final.ways is not None:
        site = prepare_site(world, lidar, rules)
        return ReplayData(**common, **_team_parts(site, world, strategy, final, start, max_frames))
    if final.plans is None:
        raise InputError(f"{strategy.name} in {world.name}: {why_no_replay(rules)}")
    shown = evenly(len(final.rows) - 1, max_frames)
    own_room, seen = isinstance(strategy.policy.params, room_wise.Params), None
    if engine != "jax" and not own_room:  # which JAX segments
        seen = show_episode(world, strategy, lidar, rules, start, final, shown, FRONTIER)
    if seen is not None:
        changes, headings = changes_of(iter(seen[0])), 45 * seen[1]
    else:
        headings, site = [], prepare_site(world, lidar, rules)
        found = before_leaving(moments(site, strategy, start, seed, number, final.plans), shown)
        params = strategy.policy.params._replace(inner=()) if own_room else None
        changes = changes_of(_images(world, params, found, headings))
    changes = tuple(changes)  # only then headings are there
    target, until = _aims(final, shown)
    return ReplayData(
        **common,
        rows=final.rows,
        cols=final.cols,
        steps=np.array(shown),
        heading_deg=np.array(headings),
        target=target,
        until=until,
        known_m2=final.n_known[shown] * world.cell_m**2,
        changes=changes,
        has_own_room=own_room,
    )


def _team_parts(site, world, strategy, final, start, max_frames):
    """Return what `ReplayData` has of the ways and maps of a team, evenly spaced in time."""
    clocks = evenly(last_clock(final), max_frames)
    beliefs = team_beliefs(site, strategy, final, start, clocks)
    images = (within(np.asarray(_codes(belief)), world.shape, site.ring) for belief in beliefs)
    first, *others = (robot_at(way, clocks, start[2]) for way in final.ways)
    return first | {
        "until": first["steps"],
        "known_m2": known_at(final, world.within, clocks) * world.cell_m**2,
        "changes": tuple(changes_of(images)),
        "others": tuple(RobotReplay(**other) for other in others),
        "clock_m": np.array(clocks) / LENGTHS[0] * float(site.numbers.model.cell_m),
    }


def before_leaving(found: Iterable[Moment], shown: Iterable[int]) -> Iterator[Moment]:
    """Yield the last moment at each of some places; `shown` are the steps made before, ascending."""
    left, last = list(shown), None
    for moment in found:
        while last is not None and left and left[0] < moment.step:
            yield last
            left.pop(0)
        last = moment
    yield from [last for _ in left if last is not None]


def _images(world, params, found, headings):
    """Yield the codes of all cells at some moments; note the robot's heading there. `params` of a room-wise policy."""
    ring = ring_of(world.occupied)
    for moment in found:
        codes = np.array(_codes(moment.belief))
        if params is not None:
            codes += np.uint8(OWN_ROOM) * np.asarray(_own_room(params, moment.belief))
        headings.append(45 * moment.heading)
        yield within(codes, world.shape, ring)


def _aims(final, shown):
    """Return targets after some numbers of steps, `[F, 2]`, and the steps at which they end, `[F]`."""
    steps = len(final.rows) - 1
    made = [plan.step for plan in final.plans]
    ends = [*made[1:], steps]
    targets, until = [], []
    for step, plan in zip(shown, np.searchsorted(made, shown, side="right") - 1):  # the last one made by then
        targets.append((final.plans[plan].target if plan >= 0 else None) or (-1, -1))
        until.append(max(ends[plan], step) if plan >= 0 else step)
    return np.array(targets), np.array(until)


def replays_of(
    jobs: Sequence[Job], *,
    episodes: int = EPISODES, max_frames: int = MAX_FRAMES, labels: Sequence[str] = (), engine: str = "auto",
) -> tuple[list[ReplayData], list[str]]:  # fmt: skip
    """Replay the first episodes of the first jobs, for a page: the replays, and lines about missing ones.

    Args:
      jobs: of a run, in its order, with their scanners and rules.
      episodes: most episodes shown of each job; those after the first have `FEWER_FRAMES` at most.
      max_frames: of a replay.
      labels: what tells each job from others of its world and strategy; by default its seed.
      engine: as in `batch.run_jobs`.
    """
    pairs, notes = list(zip(jobs, labels or [""] * len(jobs))), []
    moving = [(job, label) for job, label in pairs if job.rules is None or job.rules.on_lattice]
    if len(moving) < len(pairs):
        notes.append("There are no replays of robots that do not move from cell to cell, or whose pose is not given.")
    if len(moving) > MAX_PAIRS:
        notes.append(f"Replays show the first {MAX_PAIRS} of {len(moving)} pairs of world and strategy.")
    made, moving = [], moving[:MAX_PAIRS]
    use_compilation_cache()
    for episode in range(min((len(job.starts) for job, _ in moving), default=0))[:episodes]:
        shown, own = [], [job for job, _ in moving]
        ran = batch.run_jobs(own, Lidar(), Rules(), only=episode, engine=engine).outcomes
        for (job, label), found in zip(moving, ran):
            title = f"{job.strategy.name} in {job.world.name}, episode {job.first + episode}"
            if found.first is None:
                notes.append(f"{title}: no replay, the run was interrupted before it ended.")
            elif job.team is None and found.first.plans is None:
                notes.append(f"{title}: {why_no_replay(job.rules or Rules())}.")
            else:
                shown.append((job, found, label))
        most = min(max_frames, FEWER_FRAMES) if episode else max_frames
        with ThreadPoolExecutor(own_cores()) as pool:
            made += pool.map(functools.partial(_replay, episode, max_frames=most, engine=engine), *zip(*shown))
    return made, notes


def _replay(episode, job, found, label, **how):
    """Return an episode of a job, a number from 0, as `ReplayData`."""
    how |= {"start": tuple(job.starts[episode].tolist()), "number": job.first + episode}
    how |= {"outcome": Outcome(int(found.result.outcome[episode])).name}
    how |= {name: getattr(job, name) for name in ("seed", "lidar", "rules")}
    replay = replay_data(job.world, job.strategy, found.first, **how)
    return dataclasses.replace(replay, which=label) if label else replay
