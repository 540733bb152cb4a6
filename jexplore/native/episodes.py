"""Batches of whole episodes by the native library: its inputs and outputs as numpy arrays."""

import ctypes
import functools
from collections.abc import Sequence
from ctypes import POINTER, Structure, c_float, c_int, c_int32, c_int64, c_uint8, c_void_p
from typing import Any, NamedTuple

import numpy as np

from jexplore.grid import in_cells
from jexplore.native.build import FOLDER, Library, load_library
from jexplore.raycast import HEADINGS, advance_beams, beam_angles_deg, beam_geometry, exact_direction, n_steps
from jexplore.rules import Lidar

WORD = 32


class Beams(NamedTuple):
    """The cells that beams enter, from a cell's centre, with a heading that is a multiple of 45 degrees."""

    way: np.ndarray  # [8, B, 2] int32, direction of a beam's columns and of its rows: -1 or 1
    length: np.ndarray  # [8, B] int32, cells entered at a distance below the range
    is_row: np.ndarray  # [8, B, n] uint32, a bit a step, the lowest first: whether it is to the next row


@functools.lru_cache(maxsize=8)
def trace_beams(lidar: Lidar, cell_m: float) -> Beams:
    """Trace the beams of a scanner at the robot's centre: the same cells as those of `raycast.beam_table`."""
    reach = in_cells(lidar.range_m, cell_m)
    dx, dy = exact_direction(45.0 * np.arange(HEADINGS)[:, None] + beam_angles_deg(lidar))
    geometry = beam_geometry(dx, dy, 0.5, 0.5)
    longest = n_steps(reach)
    is_row = np.zeros((*dx.shape, -(-longest // WORD)), np.uint32)
    length, state = np.zeros(dx.shape, np.int32), (np.zeros(dx.shape), np.zeros(dx.shape))
    for step in range(longest):
        rows = state[1]
        state, (_, _, entry) = advance_beams(state, geometry)
        length += entry < reach
        is_row[..., step // WORD] |= (state[1] > rows).astype(np.uint32) << np.uint32(step % WORD)
    way = np.stack([geometry[0], geometry[1]], axis=-1).astype(np.int32)
    return Beams(way, length, is_row)


SOURCES = tuple(FOLDER / name for name in ("cpu.cc", "bytes.h", "paths.h", "world.h", "rules.h"))
EMULATED = (*SOURCES, FOLDER / "warp_host.h", FOLDER / "warp.h")
NEAREST, UNIFORM = 0, 1  # how a target is chosen
RESULT = 328  # int32 of `exploration.state.Result`
_PLANS, _OUTCOME = 4, 6  # places in it
TASK = np.dtype(
    [("start", np.int32, 3), ("seed", np.uint32), ("draw", np.uint32), ("goal", np.int32), ("region", np.int32)]
)


class Spec(Structure):
    """Common data of all episodes of a world; `Spec` in rules.h."""

    _fields_ = [
        *((name, c_int32) for name in (
            "height", "width", "n_beams", "first_scans", "clearance_d2", "near_d2", "arrival_d2", "scan_every",
            "max_steps", "max_plans", "look_around", "recheck", "no_echo_is_free", "chooser", "connectivity", "least",
            "stop_at", "return_home", "max_path", "max_ms",
        )),
        ("p_free", c_float), ("n_clock", c_int32), ("clock", c_void_p),
    ]  # fmt: skip

    def __init__(self, *numbers: Any, clock: np.ndarray, **named: Any) -> None:
        self.times = np.ascontiguousarray(clock, np.int32)  # `exploration.motion.clock_table`; must stay alive
        super().__init__(*numbers, **named, n_clock=self.times.size, clock=self.times.ctypes.data)


class _Given(Structure):
    _fields_ = [
        *((name, c_void_p) for name in ("occupied", "rooms", "region", "within", "prior", "way", "length", "is_row")),
        ("n_words", c_int32),
    ]


class _Batch(Structure):
    _fields_ = [
        ("tasks", c_void_p), ("n", c_int64), ("stop", c_void_p), ("results", c_void_p), ("states", c_void_p),
        ("paths", POINTER(c_int32)), ("n_steps", c_void_p), ("whole", c_int64), ("hits", c_void_p),
        ("misses", c_void_p), ("choices", POINTER(c_int32)),
    ]  # fmt: skip


class _Replay(Structure):
    _fields_ = [
        ("task", c_void_p), ("n_plans", c_int64), ("targets", c_void_p), ("is_view", c_void_p), ("ends", c_void_p),
        ("motions", c_void_p), ("looked", c_void_p), ("n_shown", c_int64), ("shown", c_void_p), ("frontier", c_uint8),
        ("codes", c_void_p), ("headings", c_void_p),
    ]  # fmt: skip


class Given(NamedTuple):
    """A world with its ring, and the beams of a scanner in it."""

    occupied: np.ndarray  # [H, W] bool
    rooms: np.ndarray  # [H, W] int32; -1 outside rooms
    region: np.ndarray  # [H, W] int32, number of each 4-connected region of free cells within
    within: np.ndarray | None  # [H, W] bool, where the robot may be and what it is to know
    prior: np.ndarray | None  # [H, W] int8, what it knows before its first scan: -1, 0 free, 1 occupied
    beams: Beams


class Played(NamedTuple):
    """Results of some episodes."""

    results: np.ndarray  # [n, RESULT] int32
    paths: list[np.ndarray] | None  # [steps + 1, 2] int32 of each that ended: spot (`trail.Trail.SPOT`), known cells
    states: np.ndarray | None  # [n, H, W] uint8, the last maps: 0 unknown, 1 free, 2 occupied
    counts: tuple[np.ndarray, np.ndarray] | None  # [H, W] int32, hits and misses of the episode wanted whole
    choices: np.ndarray | None  # [plans + 1, 2] int32, its plans (`trail.Choices`), and what they ended with


def load_episodes(*, emulator: bool = False) -> Library:
    """Return the library, built if need be; on request one that can also run episodes as a GPU does."""
    found = load_library(EMULATED, ("-DJEXPLORE_EMULATE",)) if emulator else load_library(SOURCES)
    if found.loaded is not None:
        _declare(found.loaded)
        if emulator:
            found.loaded.jexplore_emulate.argtypes = [c_void_p, POINTER(_Batch), c_int]
    return found


def _declare(loaded):
    loaded.jexplore_world.restype = c_void_p
    loaded.jexplore_forget_world.argtypes = loaded.jexplore_free.argtypes = [c_void_p]
    loaded.jexplore_goals.argtypes = [c_void_p, c_void_p, c_int64]
    loaded.jexplore_replay.argtypes, loaded.jexplore_replay.restype = [c_void_p, POINTER(_Replay)], c_int64
    loaded.jexplore_episodes.argtypes = [c_void_p, POINTER(_Batch)]


def _pointer(array: np.ndarray | None, dtype: Any, keep: list[Any]) -> int | None:
    """Return the address of an array as a C array of a dtype; `keep` holds arrays that must stay alive."""
    if array is None:
        return None
    keep.append(np.ascontiguousarray(array, dtype))
    return keep[-1].ctypes.data


def as_struct(given: Given, keep: list[Any]) -> Structure:
    """Return a `Given` as C has it; `keep` holds the arrays, which must not be let go before."""
    types = (np.uint8, np.int32, np.int32, np.uint8, np.int8, np.int32, np.int32, np.uint32)
    pointers = [_pointer(array, dtype, keep) for array, dtype in zip((*given[:5], *given.beams), types)]
    return _Given(*pointers, given.beams.is_row.shape[-1])


class World:
    """A world in the library, in which many threads may run episodes."""

    def __init__(self, loaded: ctypes.CDLL, spec: Spec, given: Given) -> None:
        self._loaded, self._keep, self.shape = loaded, [spec], given.occupied.shape
        self._handle = loaded.jexplore_world(ctypes.byref(spec), ctypes.byref(as_struct(given, self._keep)))
        if not self._handle:
            raise MemoryError("no memory for a world")

    def __del__(self) -> None:
        if getattr(self, "_handle", None):
            self._loaded.jexplore_forget_world(self._handle)

    def tasks(self, starts: np.ndarray, seed: int, draws: np.ndarray) -> np.ndarray:
        """Make the tasks of episodes, `[N]` of `TASK`. Not while episodes run here.

        `starts`: `[N, 3]` int32, row, col and heading (units of 45 degrees), in the world with its ring; `seed` and
        `draws`, `[N]` int32, make the keys.
        """
        tasks = np.zeros(len(starts), TASK)
        tasks["start"], tasks["seed"], tasks["draw"] = starts, seed, draws
        if self._loaded.jexplore_goals(self._handle, tasks.ctypes.data, len(tasks)):
            raise MemoryError("no memory for tasks")
        return tasks

    def play(
        self, tasks: np.ndarray, stop: np.ndarray, *, paths: bool = False, states: bool = False, whole: int = -1
    ) -> Played:
        """Run episodes, one after the other; once `stop`, `[1]` int32, is not 0, the rest is given up: outcome 0.

        `paths`, `states`: whether they are kept; `whole`: number of the episode of which path, counts and choices are.
        """
        n, tasks = len(tasks), np.ascontiguousarray(tasks)
        results, steps = np.zeros((n, RESULT), np.int32), np.zeros(n, np.int64)
        maps = np.zeros((n, *self.shape), np.uint8) if states else None
        counts = (np.zeros(self.shape, np.int32), np.zeros(self.shape, np.int32)) if whole >= 0 else None
        batch = _Batch(
            tasks=tasks.ctypes.data, n=n, stop=stop.ctypes.data, results=results.ctypes.data, whole=whole,
            states=None if maps is None else maps.ctypes.data,
            n_steps=steps.ctypes.data if paths or whole >= 0 else None,
            hits=None if counts is None else counts[0].ctypes.data,
            misses=None if counts is None else counts[1].ctypes.data,
        )  # fmt: skip
        try:
            if self._loaded.jexplore_episodes(self._handle, ctypes.byref(batch)):
                raise MemoryError("no memory for episodes")
            kept = None
            if batch.paths:
                ends = np.cumsum(steps[results[:, _OUTCOME] != 0] + 1)
                kept = np.split(np.ctypeslib.as_array(batch.paths, (int(ends[-1]), 2)).copy(), ends[:-1])
            choices = None
            if batch.choices:
                choices = np.ctypeslib.as_array(batch.choices, (int(results[whole, _PLANS]) + 1, 2)).copy()
        finally:
            self._loaded.jexplore_free(batch.paths)
            self._loaded.jexplore_free(batch.choices)
        return Played(results, kept, maps, counts, choices)

    def emulate(self, tasks: np.ndarray, *, views: bool) -> np.ndarray | None:
        """Run episodes as a warp of a GPU does, on the CPU: `[n, RESULT]` int32; an outcome of 0 was given up.

        `views`: whether scans are looked up. The world is of the library with the emulator. None: it does not suit.
        """
        results, tasks = np.zeros((len(tasks), RESULT), np.int32), np.ascontiguousarray(tasks)
        batch = _Batch(tasks=tasks.ctypes.data, n=len(tasks), results=results.ctypes.data)
        code = self._loaded.jexplore_emulate(self._handle, ctypes.byref(batch), views)
        if code == 1:
            raise MemoryError("no memory for episodes")
        return None if code else results

    def replay(
        self, task: np.ndarray, plans: Sequence[Any], ring: int, looked: np.ndarray, shown: np.ndarray, frontier: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Show a recorded episode as the robot leaves some places, `[F]` numbers of steps: `(codes, headings)`.

        `plans`: those with a target, of `exploration.trail.Plan`, in a world without this ring; `looked`: `[steps + 1]`
        int, scans made in place.

        `codes`: `[F, H, W]` uint8, 0 unknown, 1 free, 2 occupied, `frontier` more where a frontier cell can be reached.
        `headings`: `[F]` int32, units of 45 degrees, at the last scan there.
        """
        keep: list[Any] = []
        codes, headings = np.zeros((len(shown), *self.shape), np.uint8), np.zeros(len(shown), np.int32)
        targets = np.array([plan.target for plan in plans], np.int32).reshape(-1, 2) + np.int32(ring)
        motions = np.array([motion for plan in plans for motion in plan.motions], np.int8)
        found = self._loaded.jexplore_replay(self._handle, ctypes.byref(_Replay(
            task=_pointer(task, TASK, keep), n_plans=len(targets),
            targets=_pointer(targets[:, 0] * self.shape[1] + targets[:, 1], np.int32, keep),
            is_view=_pointer(np.array([plan.is_view for plan in plans]), np.uint8, keep),
            ends=_pointer(np.cumsum([len(plan.motions) for plan in plans]), np.int64, keep),
            motions=_pointer(motions, np.int8, keep), looked=_pointer(looked, np.int32, keep),
            n_shown=len(shown), shown=_pointer(shown, np.int32, keep), frontier=frontier,
            codes=codes.ctypes.data, headings=headings.ctypes.data,
        )))  # fmt: skip
        if found < 0:
            raise MemoryError("no memory for a replay")
        return codes, headings
