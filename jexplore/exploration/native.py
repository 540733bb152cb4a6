"""Whole episodes in native code: of the strategies that it knows, by scanners without noise, with equal results."""

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any

import numpy as np

from jexplore.config import Lidar, Rules
from jexplore.engine.threads import Pieces, share_out
from jexplore.exploration.site import cost_of, limit_of, reach_d2, regions_of, tasks_of
from jexplore.exploration.state import MARKS, PERCENTILES, Outcome, Result
from jexplore.exploration.trail import Final, Record, decode, record_of
from jexplore.native import episodes, gpu
from jexplore.native.beams import trace_beams
from jexplore.native.build import warn_once
from jexplore.policies.closest import is_nearest
from jexplore.policies.policy import Strategy
from jexplore.policies.uniform import is_uniform
from jexplore.raycast import scans_all_round
from jexplore.worlds.world import World, ring_of, with_ring

MOST = 4096  # episodes in one call
# Episodes of a strategy in a world from which a GPU runs them: an H100 takes a second to begin, in which 16 cores make
# 1,300 in a cave, and makes 100,000 a second (`benchmarks/device.py`).
GPU_FROM = 4096
ON_GPU, ON_CPU = "native on a GPU", "native on a CPU"
_MEASURES = [field.name for field in dataclasses.fields(Result) if field.name != "metrics"]
_OUTCOME = _MEASURES.index("outcome")
_WIDTHS = {
    "straight_at": len(PERCENTILES),
    "diagonal_at": len(PERCENTILES),
    "straight_along": MARKS,
    "diagonal_along": MARKS,
}


def chooser_of(strategy: Strategy) -> int | None:
    """Return how native code chooses targets as a strategy does; None: it cannot."""
    if is_nearest(strategy.policy):
        return episodes.NEAREST
    return episodes.UNIFORM if is_uniform(strategy.policy) else None


def is_exact(lidar: Lidar) -> bool:
    """Tell whether a scanner is without noise, and sees all from the robot's centre, as native code has it."""
    return lidar.sigma_m == lidar.dropout == lidar.min_range_m == lidar.mount_m == 0


def is_native(strategy: Strategy, lidar: Lidar) -> bool:
    """Tell whether there is native code for a strategy's episodes by a scanner."""
    return chooser_of(strategy) is not None and is_exact(lidar)


def native_world(
    loaded: Any, world: World, chooser: int, lidar: Lidar, rules: Rules, *, recheck: bool
) -> episodes.World:
    """Make a world ready for episodes in native code."""
    return episodes.World(loaded, *parts_of(world, chooser, lidar, rules, recheck=recheck))


def parts_of(
    world: World, chooser: int, lidar: Lidar, rules: Rules, *, recheck: bool
) -> tuple[episodes.Spec, episodes.Given]:
    """Return what native code is given of a world, a scanner and rules."""
    world = with_ring(world)
    cell_m, limit = world.cell_m, limit_of(world.shape)
    spec = episodes.Spec(
        height=world.shape[0],
        width=world.shape[1],
        n_beams=lidar.n_beams,
        first_scans=scans_all_round(lidar),
        clearance_d2=reach_d2(rules.clearance_m, world),
        near_d2=reach_d2(rules.near_m, world),
        arrival_d2=reach_d2(rules.arrival_m, world),
        scan_every=cost_of(rules.scan_every_m, cell_m),
        max_steps=rules.max_steps or limit,
        max_plans=rules.max_plans or limit,
        look_around=rules.look_around,
        recheck=recheck,
        no_echo_is_free=lidar.no_echo == "free",
        chooser=chooser,
        p_free=rules.p_free,
    )
    rooms = np.full(world.shape, -1, np.int32) if world.rooms is None else world.rooms
    # A wall ends every beam within the diagonal.
    range_m = min(lidar.range_m, (math.hypot(*world.shape) + 1) * cell_m)
    beams = trace_beams(lidar.without_noise().replace(range_m=range_m), cell_m)
    return spec, episodes.Given(world.occupied, rooms, regions_of(world), world.within, world.known, beams)


def result_of(table: np.ndarray) -> Result:
    """Return the `Result` of integers as the library writes them: `[..., RESULT]` int32."""
    parts, at = {}, 0
    for name in _MEASURES:
        width = _WIDTHS.get(name)
        parts[name] = table[..., at] if width is None else table[..., at : at + width]
        at += width or 1
    return Result(**parts)


@dataclasses.dataclass
class NativeRun:
    """Episodes of one strategy in one world, and what has come back; like `engine.program.Line`."""

    place: episodes.World
    parts: tuple[episodes.Spec, episodes.Given]  # of which it is made
    world: World  # as the user has it
    starts: np.ndarray  # [N, 3] int, row, col, heading_deg
    seed: int
    first: int  # number of the first of these episodes
    which: np.ndarray  # [n] int32, those that are to be run
    keeps: int  # number of the one of which map and way are kept whole
    keep: str | None  # one of `trail.RECORDS`
    turn: int = 0
    n_done: int = 0  # episodes that have come back
    records: dict[int, Record] = dataclasses.field(default_factory=dict)
    final: Final | None = None
    levels: set[str] = dataclasses.field(default_factory=set)  # what has run some of them: `ON_GPU`, `ON_CPU`
    table: np.ndarray = dataclasses.field(init=False)  # [N, RESULT] int32
    tasks: np.ndarray = dataclasses.field(init=False)

    def __post_init__(self) -> None:
        n = len(self.starts)
        self.table = np.zeros((n, episodes.RESULT), np.int32)
        ring = ring_of(self.world.occupied)
        self.tasks = self.place.tasks(tasks_of(self.starts, ring), self.seed, np.arange(n, dtype=np.int32) + self.first)
        self.which = np.sort(self.which)

    @property
    def results(self) -> Result:
        """Return a `Result` of numpy arrays with a leading axis N; zeros for an episode that has not come back."""
        return result_of(self.table)

    @property
    def left(self) -> np.ndarray:
        """Return `[m]` int32, numbers of the episodes that have not come back."""
        return self.which[self.table[self.which, _OUTCOME] == Outcome.RUNNING]

    @property
    def is_done(self) -> bool:
        """Return whether all episodes have come back."""
        return self.n_done == len(self.which)

    @property
    def has_some(self) -> bool:
        """Return whether any episode has come back."""
        return bool((self.table[:, _OUTCOME] != Outcome.RUNNING).any())

    def play(self, numbers: np.ndarray, stop: np.ndarray) -> episodes.Played:
        """Run some of the episodes, by numbers, `[k]` int32."""
        at = np.flatnonzero(numbers == self.keeps)
        return self.place.play(
            self.tasks[numbers],
            stop,
            paths=self.keep is not None,
            states=self.keep == "maps",
            whole=int(at[0]) if at.size else -1,
        )

    def put(self, numbers: np.ndarray, found: episodes.Played, level: str = ON_CPU) -> None:
        """Keep what `play` has returned."""
        ended = found.results[:, _OUTCOME] != Outcome.RUNNING
        if ended.any():
            self.levels.add(level)
        self.table[numbers[ended]] = found.results[ended]
        self.n_done += int(ended.sum())
        if found.paths is None:  # not asked for, or all given up
            return
        ring, shape, width = ring_of(self.world.occupied), self.place.shape, self.place.shape[1]
        if found.counts is not None and found.choices is not None:
            i = int(np.flatnonzero(numbers == self.keeps)[0])
            bumped = found.choices[-1, 1] % 16 - 1
            whole = (*found.counts, found.paths[i], found.choices[:-1], bumped)
            self.final = decode(whole, result_of(found.results[i]), self.world.shape, ring)
        if self.keep is not None:
            for i, number in enumerate(numbers[ended]):
                state = () if found.states is None else (found.states[i],)
                kept = record_of(result_of(found.results[i]), (found.paths[i], *state), shape, width, ring)
                self.records[int(number)] = kept


def _play_on_gpu(runs, stop, progress):
    """Run large groups on a GPU; episodes that it gives up, or that are kept whole, are left for the CPU.

    Returns:
      The reason why not; "" where it did, or had nothing to do.
    """
    groups = {}
    for run in runs:
        if run.keep is None:
            groups.setdefault(id(run.place), []).append(run)
    groups = [group for group in groups.values() if sum(len(run.which) for run in group) >= GPU_FROM]
    if not groups or not gpu.device_count():
        return ""
    found = gpu.load()
    if found.loaded is None:
        return _told(found.why_not)
    why_not = ""
    with ThreadPoolExecutor(1) as pool:  # the calling thread hears Ctrl-C
        for group in groups:
            (spec, given), numbers = group[0].parts, [run.left[run.left != run.keeps] for run in group]
            tasks = np.concatenate([run.tasks[own] for run, own in zip(group, numbers)])
            future = pool.submit(gpu.play, found.loaded, spec, given, tasks, stop)
            try:
                wait([future])
            except BaseException:
                stop[0] = 1
                raise
            finally:
                why_not = _put_all(group, numbers, future) or why_not
            progress(0)
    return why_not


def _told(why_not):
    """Why a GPU does not run episodes, which is said once."""
    warn_once(why_not, "the CPU's cores run the episodes")
    return why_not


def _put_all(group, numbers, future):
    """Keep what a GPU has found for some runs, once it has; return why it could not go on, or ""."""
    try:
        played = future.result()
    except (MemoryError, RuntimeError) as error:
        return _told(str(error))
    at = 0
    for run, own in zip(group, numbers):
        if played is not None:
            run.put(own, episodes.Played(played.results[at : at + len(own)], None, None, None, None), ON_GPU)
        at += len(own)
    return ""


def play_all(
    runs: Sequence[NativeRun],
    workers: int,
    on_progress: Callable[[int], object],
    on_run: Callable[[int], object] | None = None,
) -> str:
    """Run the episodes of some `NativeRun`s on a GPU or the cores of a CPU, and put the results there.

    Args:
      runs: list of `NativeRun`.
      workers: threads.
      on_progress: called with the number of finished episodes, from the calling thread.
      on_run: called from the calling thread with the number of a run once all its episodes have come back.

    Returns:
      why no GPU ran what it should have; "" otherwise.

    Raises:
      KeyboardInterrupt: after running episodes have been given up; finished ones are kept.
    """
    stop, told = np.zeros(1, np.int32), set()

    def pieces_of(run):
        left = run.left

        def call(first, n):
            since = time.perf_counter()
            return run.play(left[first : first + n], stop), time.perf_counter() - since

        def keep(first, n, found):
            run.put(left[first : first + n], found)

        return Pieces(total=len(left), most=MOST, call=call, keep=keep, turn=run.turn)

    def progress(_):
        for i, run in enumerate(runs):
            if on_run is not None and i not in told and run.is_done:
                told.add(i)
                on_run(i)
        on_progress(sum(run.n_done for run in runs))

    def give_up():
        stop[0] = 1

    why_not = _play_on_gpu(runs, stop, progress)
    share_out([pieces_of(run) for run in runs], workers, progress, give_up)
    return why_not


def show_episode(
    world: World,
    strategy: Strategy,
    lidar: Lidar,
    rules: Rules,
    start: Sequence[int],
    final: Final,
    shown: Sequence[int],
    frontier: int,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the known map at some steps of a recorded episode, of any strategy.

    Args:
      world, strategy, lidar, rules: those of the episode.
      start: row, col, heading in degrees.
      final: the record, with its plans.
      shown: numbers of steps, ascending.
      frontier: added to the codes of frontier cells.

    Returns:
      `(codes, headings)`: `[F, H, W]` uint8, 0 unknown, 1 free, 2 occupied, `frontier` more where a frontier cell can
        be reached; `[F]` int32, units of 45 degrees, at the last scan there. None: the scanner has noise, or there is
        no native code.
    """
    found = episodes.load()
    if not is_exact(lidar) or found.loaded is None or final.plans is None:
        return None
    rules = dataclasses.replace(rules, max_steps=max(len(final.rows) - 1, 1), max_plans=None)
    place = native_world(found.loaded, world, episodes.NEAREST, lidar, rules, recheck=strategy.recheck)
    ring = ring_of(world.occupied)
    made = [plan for plan in final.plans if plan.target is not None]
    script = episodes.Script(
        targets=np.array([plan.target for plan in made], np.int32).reshape(-1, 2) + ring,
        is_view=np.array([plan.is_view for plan in made], bool),
        motions=[plan.motions for plan in made],
        looked=final.looked,
    )
    task = place.tasks(tasks_of(np.asarray([start]), ring), 0, np.zeros(1, np.int32))
    codes, headings = place.replay(task, script, np.asarray(shown), frontier)
    height, width = world.shape
    return codes[:, ring : ring + height, ring : ring + width], headings
