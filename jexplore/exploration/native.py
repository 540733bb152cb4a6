"""Whole episodes in native code: of the strategies that it knows, by scanners without noise, with equal results."""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from jexplore.engine.runner import OwnRuns
from jexplore.engine.threads import Pieces, share_out
from jexplore.exploration.motion import clock_table
from jexplore.exploration.site import ROBOT, regions_of, rule_numbers, tasks_of
from jexplore.exploration.state import MARKS, PERCENTILES, Outcome, Result
from jexplore.exploration.trail import Final, Record, decode, record_of
from jexplore.native import episodes, gpu
from jexplore.native.build import warn_once
from jexplore.native.episodes import trace_beams
from jexplore.policies.closest import closest
from jexplore.policies.policy import Strategy
from jexplore.policies.uniform import uniform
from jexplore.raycast import scans_all_round
from jexplore.rules import Lidar, Robot, Rules
from jexplore.worlds.world import World, ring_of, with_ring

MOST = 4096  # episodes in one call
# Episodes of a strategy in a world from which a GPU runs them: an H100 takes a second to begin, in which 16 cores make
# 1,300 in a cave, and makes 100,000 a second (`benchmarks/device.py`).
GPU_FROM = 4096
ON_GPU, ON_CPU = "native on a GPU", "native on a CPU"
CHOOSERS = {closest().select: episodes.NEAREST, uniform().select: episodes.UNIFORM}
"""`select` of a strategy -> how native code chooses as it does."""
_MEASURES = [field.name for field in dataclasses.fields(Result) if field.name not in ("metrics", "way_m", "ride")]
_OUTCOME = _MEASURES.index("outcome")
_WIDTHS = {"at": len(PERCENTILES), "along": MARKS}  # of measures whose names end so; of others 1


def is_exact(lidar: Lidar) -> bool:
    """Tell whether a scanner is without noise, and sees all from the robot's centre, as native code has it."""
    return lidar.sigma_m == lidar.dropout == lidar.min_range_m == lidar.mount_m == 0


def is_native(strategy: Strategy, lidar: Lidar, rules: Rules) -> bool:
    """Tell whether there is native code for a strategy's episodes by a scanner and rules."""
    return strategy.policy.select in CHOOSERS and is_exact(lidar) and rules.on_lattice


class NativePlace(NamedTuple):
    """A world, a scanner, rules and a strategy in the library, and what they are made of."""

    inner: episodes.World
    spec: episodes.Spec
    given: episodes.Given
    world: World  # as the user has it
    ring: int  # cells by which indices in the library are larger than the world's


def native_place(
    loaded: Any,
    world: World,
    strategy: Strategy,
    lidar: Lidar,
    rules: Rules,
    robot: Robot = ROBOT,
) -> NativePlace:
    """Make a world ready for episodes of a strategy in native code."""
    whole = with_ring(world)
    spec = episodes.Spec(
        height=whole.shape[0],
        width=whole.shape[1],
        n_beams=lidar.n_beams,
        first_scans=scans_all_round(lidar),
        recheck=strategy.recheck,
        chooser=CHOOSERS[strategy.policy.select],
        clock=clock_table(robot, whole.cell_m, max(whole.shape)),
        **rule_numbers(whole, lidar, rules),
    )
    rooms = np.full(whole.shape, -1, np.int32) if whole.rooms is None else whole.rooms
    # A wall ends every beam within the diagonal.
    range_m = min(lidar.range_m, (math.hypot(*whole.shape) + 1) * whole.cell_m)
    beams = trace_beams(lidar.without_noise().replace(range_m=range_m), whole.cell_m)
    given = episodes.Given(whole.occupied, rooms, regions_of(whole), whole.within, whole.known, beams)
    return NativePlace(episodes.World(loaded, spec, given), spec, given, world, ring_of(world.occupied))


def result_of(table: np.ndarray) -> Result:
    """Return the `Result` of integers as the library writes them: `[..., RESULT]` int32."""
    widths = [_WIDTHS.get(name.rpartition("_")[2], 0) for name in _MEASURES]
    parts = np.split(table, np.cumsum(np.maximum(widths, 1))[:-1], axis=-1)
    named = {name: part if n else part[..., 0] for name, n, part in zip(_MEASURES, widths, parts)}
    return Result(**named)  # type: ignore[arg-type]  # numpy on the host


@dataclasses.dataclass
class NativeRun(OwnRuns):
    """Episodes of one strategy in one world, and what has come back; like `engine.program.Line`."""

    place: NativePlace
    starts: np.ndarray  # [N, 3] int, row, col, heading_deg
    seed: int
    first: int  # number of the first of these episodes
    which: np.ndarray
    detailed: int = -1  # number of the one of which map and way are kept whole
    keep: str | None = None  # one of `trail.RECORDS`
    phase: int = 0
    records: dict[int, Record] = dataclasses.field(default_factory=dict[int, Record])
    final: Final | None = None
    levels: set[str] = dataclasses.field(default_factory=set[str])  # what has run some of them: `ON_GPU`, `ON_CPU`
    finished: np.ndarray = dataclasses.field(init=False)
    table: np.ndarray = dataclasses.field(init=False)  # [N, RESULT] int32
    tasks: np.ndarray = dataclasses.field(init=False)
    stop: np.ndarray = dataclasses.field(init=False)  # [1] int32; not 0: the rest is given up

    def __post_init__(self) -> None:
        n = len(self.starts)
        self.table, self.stop = np.zeros((n, episodes.RESULT), np.int32), np.zeros(1, np.int32)
        self.finished = np.zeros(n, bool)
        starts = tasks_of(self.starts, self.place.ring)
        self.tasks = self.place.inner.tasks(starts, self.seed, np.arange(n, dtype=np.int32) + self.first)

    @property
    def results(self) -> Result:
        """Return a `Result` of numpy arrays with a leading axis N; zeros for an episode that has not come back."""
        return result_of(self.table)

    @property
    def left(self) -> np.ndarray:
        """Return `[m]` int, numbers of the episodes that have not come back."""
        return self.which[~self.finished[self.which]]

    def pieces(self) -> Pieces:
        """Return the episodes that have not come back, for `threads.share_out`."""
        left = self.left

        def call(first: int, n: int) -> episodes.Played:
            numbers = left[first : first + n]
            at, paths = np.flatnonzero(numbers == self.detailed), self.keep is not None
            return self.place.inner.play(
                self.tasks[numbers],
                self.stop,
                paths=paths,
                states=self.keep == "maps",
                whole=int(at[0]) if at.size else -1,
            )

        def keep(first: int, n: int, found: episodes.Played) -> None:
            self.put(left[first : first + n], found)

        return Pieces(len(left), MOST, call, keep, phase=self.phase)

    def give_up(self) -> None:
        """Make `pieces` that are under way return soon."""
        self.stop[0] = 1

    def put(self, numbers: np.ndarray, found: episodes.Played, level: str = ON_CPU) -> None:
        """Keep the results of some episodes, `[k]` int."""
        ended = found.results[:, _OUTCOME] != Outcome.RUNNING
        if ended.any():
            self.levels.add(level)
        self.table[numbers[ended]] = found.results[ended]
        self.finished[numbers[ended]] = True
        if found.paths is None:  # not asked for, or all given up
            return
        ring, shape = self.place.ring, self.place.inner.shape
        if found.counts is not None and found.choices is not None:
            i = int(np.flatnonzero(numbers == self.detailed)[0])
            bumped = found.choices[-1, 1] % 16 - 1
            whole = (*found.counts, found.paths[i], found.choices[:-1], bumped)
            self.final = decode(whole, result_of(found.results[i]), self.place.world.shape, ring)
        if self.keep is not None:
            for i, number in enumerate(numbers[ended]):
                state = () if found.states is None else (found.states[i],)
                kept = record_of(result_of(found.results[i]), (found.paths[i], *state), shape, shape[1], ring)
                self.records[int(number)] = kept


def play_on_gpu(runs: Sequence[NativeRun], tell: Callable[[int], object]) -> list[str]:
    """Run large groups on a GPU; episodes that it gives up, or that are kept whole, are left for the CPU.

    `tell` is called when some have come. Returns why some did not: lines.
    """
    by_place: dict[int, list[NativeRun]] = {}
    for run in runs:
        if run.keep is None:
            by_place.setdefault(id(run.place), []).append(run)
    groups = [group for group in by_place.values() if sum(len(run.which) for run in group) >= GPU_FROM]
    if not groups or not gpu.device_count():
        return []
    (loaded, why, _), stop, why_not = gpu.load_gpu(), np.zeros(1, np.int32), list[str]()
    left = [[run.left[run.left != run.detailed] for run in group] for group in groups]

    def call(i: int, _: int) -> gpu.Played | None:
        assert loaded is not None
        place, tasks = groups[i][0].place, [run.tasks[own] for run, own in zip(groups[i], left[i])]
        try:
            return gpu.play(loaded, place.spec, place.given, np.concatenate(tasks), stop)
        except (MemoryError, RuntimeError) as error:
            why_not.append(str(error))

    def keep(i: int, _: int, played: gpu.Played | None) -> None:
        ends = np.cumsum([len(own) for own in left[i]])
        parts = [] if played is None else np.split(played.results, ends[:-1])
        for run, own, results in zip(groups[i], left[i], parts):
            run.put(own, episodes.Played(results, None, None, None, None), ON_GPU)

    if loaded is None:
        why_not.append(why)
    else:  # in a thread: the calling one hears Ctrl-C
        share_out([Pieces(len(groups), 1, call, keep)], 1, tell, lambda: stop.fill(1))
    for line in why_not:
        warn_once(line, "the CPU's cores run the episodes")
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

    `start`: row, col, heading in degrees; `shown`: numbers of steps, ascending.

    Returns:
      `(codes, headings)`: `[F, H, W]` uint8, 0 unknown, 1 free, 2 occupied, `frontier` more where a frontier cell can
        be reached; `[F]` int32, units of 45 degrees, at the last scan there. None: the scanner has noise, or there is
        no native code.
    """
    found = episodes.load_episodes()
    if not is_exact(lidar) or found.loaded is None or final.plans is None:
        return None
    rules = dataclasses.replace(rules, max_steps=max(len(final.rows) - 1, 1), max_plans=None)
    # Instead of the nearest cells it has recorded targets.
    place, *_, ring = native_place(found.loaded, world, strategy._replace(policy=closest()), lidar, rules)
    made = [plan for plan in final.plans if plan.target is not None]
    task = place.tasks(tasks_of(np.asarray([start]), ring), 0, np.zeros(1, np.int32))
    codes, headings = place.replay(task, made, ring, final.looked, np.asarray(shown), frontier)
    height, width = world.shape
    return codes[:, ring : ring + height, ring : ring + width], headings
