"""Exploration episodes drawn from a number: odd scanners, cells, rules, worlds, starts and noise.

A case is played by the engine and by the oracle, and everything measured is compared. What the engine must know before
it compiles (`Fixed`) is drawn from a list, so that many cases share few programs; the rest is drawn to fit it.
"""

import dataclasses
import math
from typing import NamedTuple

import jax
import numpy as np
from scipy import ndimage

from jexplore.exploration.state import Outcome
from jexplore.grid import in_cells, radius_d2
from jexplore.native.build import find_compiler
from jexplore.raycast import n_steps
from jexplore.rules import Lidar, Robot, Rules

from . import episodes, maps, native

SPECIAL_FOV = (30.0, 45.0, 60.0, 90.0, 120.0, 180.0, 270.0, 360.0)
SPECIAL_CELLS = (0.05, 0.1, 0.3)
PACKED = 128  # a map with a longer side has windows to plan in


class Fixed(NamedTuple):
    """Static part of a case: one compiled program."""

    shape: tuple[int, int] = (64, 64)  # to which worlds are padded, cells
    policy: str = "closest"  # without rechecking, which needs no program of its own
    clearance_d2: int = 9  # cells^2
    noisy: bool = False
    range_cells: int = 81  # most that a scanner sees
    beams_as: tuple[int, int] = (120, 181)  # most steps and most beams
    restricted: bool = False  # whether the robot stays within a region and knows a part of the map
    native: bool = False  # whether native code drives
    frontier: tuple[int, int] = (8, 1)  # connectivity, and cells of the smallest group
    ends: bool = False  # whether it may end early or at home


WIDE, TALL = (64, 256), (224, 64)
FEW = (
    Fixed(),
    Fixed(policy="random"),
    Fixed(clearance_d2=0, noisy=True),
    Fixed(clearance_d2=1, restricted=True, native=True),
    Fixed(WIDE, clearance_d2=1, range_cells=21, beams_as=(40, 181), native=True),
    Fixed(WIDE, clearance_d2=0, noisy=True),
    Fixed(policy="random", native=True),
)
"""Seven programs; tests of episodes have the first three as well."""
ENDS = (
    Fixed(clearance_d2=0, native=True, frontier=(4, 1), ends=True),
    Fixed(WIDE, clearance_d2=0, frontier=(4, 2), ends=True),
    Fixed(policy="random", clearance_d2=1, native=True, frontier=(8, 4), ends=True),
    Fixed(clearance_d2=1, noisy=True, frontier=(4, 3), ends=True),
)
"""Four programs with other frontiers and ends."""
MANY = (
    *FEW,
    Fixed(clearance_d2=1, range_cells=9, beams_as=(16, 361)),
    Fixed(clearance_d2=0),
    Fixed(clearance_d2=25),
    Fixed(clearance_d2=0, native=True),
    Fixed(clearance_d2=1, restricted=True),
    Fixed(TALL, clearance_d2=1, range_cells=241, beams_as=(344, 361), native=True),
    Fixed(policy="random", clearance_d2=0, noisy=True),
    Fixed(clearance_d2=4, noisy=True, range_cells=9, beams_as=(16, 181)),
    Fixed(WIDE),
    Fixed(WIDE, clearance_d2=0, range_cells=241, beams_as=(344, 361)),
    Fixed(WIDE, policy="random", clearance_d2=2),
    Fixed(WIDE, clearance_d2=1, noisy=True, range_cells=21, beams_as=(40, 361)),
    Fixed(TALL, clearance_d2=4),
    Fixed(TALL, policy="random", clearance_d2=0, noisy=True),
    Fixed(clearance_d2=1),
    Fixed(policy="random", clearance_d2=0, restricted=True),
    Fixed(WIDE, clearance_d2=4, noisy=True),
    *ENDS,
)
"""Twenty-eight programs."""
EXACT = tuple(fixed for fixed in MANY if not fixed.noisy)
"""Programs without noise, as native code has them."""


ROBOTS = Robot(), Robot(0.8, 0.9, 0.15, 0.7, 0.4, 0.25)


@dataclasses.dataclass(frozen=True)
class Case:
    """An episode to be compared."""

    fixed: Fixed
    seed: int  # of the episode's own draws
    world: str  # what kind of world it is
    occupied: np.ndarray  # [H, W] bool
    rooms: np.ndarray | None  # [H, W] int32
    within: np.ndarray | None  # [H, W] bool
    known: np.ndarray | None  # [H, W] int8
    start: tuple[int, int, int]  # row, col, heading in degrees
    strategy: str
    lidar: Lidar
    rules: Rules
    cell_m: float

    @property
    def robot(self):
        """The robot: every other one stands while it plans."""
        return ROBOTS[self.seed % 2]


class Verdict(NamedTuple):
    """Result of a case."""

    differences: list[str]  # empty: everything is equal
    outcome: str
    steps: int
    scans: int
    refused: int


# ---------------------------------------------------------------- worlds


def ringed(inner):
    """A world with its walls all round."""
    return np.pad(inner, 1, constant_values=True)


def corridor(draw, height, width):
    """One to three cells wide, along or across, with a step aside."""
    occupied = np.ones((height, width), bool)
    row, wide = int(draw.integers(1, height - 1)), int(draw.integers(1, 4))
    other, bend = int(draw.integers(1, height - 1)), int(draw.integers(1, width - 1))
    occupied[row : row + wide, 1 : bend + 1] = False
    occupied[other : other + wide, bend:-1] = False
    occupied[min(row, other) : max(row, other) + 1, bend : bend + wide] = False
    return ringed(occupied[1:-1, 1:-1])


def maze(draw, height, width):
    """Corridors of up to four cells, without a loop but for some walls that are missing."""
    step = int(draw.integers(1, 5))
    rows, cols = (max((n // step - 1) // 2, 1) for n in (height, width))
    small = np.ones((2 * rows + 1, 2 * cols + 1), bool)
    way = [(0, 0)]
    small[1, 1] = False
    while way:
        r, c = way[-1]
        beside = [(r + 1, c), (r, c + 1), (r - 1, c), (r, c - 1)]
        beside = [(a, b) for a, b in beside if 0 <= a < rows and 0 <= b < cols and small[2 * a + 1, 2 * b + 1]]
        if not beside:
            way.pop()
            continue
        a, b = beside[draw.integers(len(beside))]
        small[2 * a + 1, 2 * b + 1] = small[r + a + 1, c + b + 1] = False
        way.append((a, b))
    small &= draw.random(small.shape) > draw.choice([0, 0.1])
    large = np.repeat(np.repeat(small, step, axis=0), step, axis=1)[:height, :width]
    grow = [(0, full - n) for full, n in zip((height, width), large.shape)]
    return ringed(np.pad(large, grow, constant_values=True)[1:-1, 1:-1])


def cave(draw, height, width):
    """Noise made smooth: halls, and places that nothing leads to."""
    field = ndimage.gaussian_filter(draw.random((height, width)), draw.uniform(1, 3))
    return ringed((field > np.quantile(field, draw.uniform(0.4, 0.75)))[1:-1, 1:-1])


def pillars(draw, height, width):
    """An empty room, or one with single pillars, up to many."""
    return ringed(draw.random((height - 2, width - 2)) < draw.choice([0, 0.01, 0.05, 0.2]))


def cluttered(draw, height, width):
    """Four rooms with doors."""
    return maps.cluttered(int(draw.integers(2**31)), max(height, 12), max(width, 12))[0]


KINDS = {kind.__name__: kind for kind in (corridor, maze, cave, pillars, cluttered)}


def _side(draw, full, tiny):
    """A side that fits a padded one: a long one is filled beyond `PACKED`."""
    if full > PACKED:
        return int(draw.integers(PACKED + 1, min(full, 200) + 1))
    low, high = (3, 6) if tiny else draw.choice([(3, 16), (16, full + 1)], p=[0.3, 0.7])
    return int(draw.integers(low, high))


def _world(draw, fixed, tiny):
    """A kind and a world that fits the padded shape."""
    height, width = (_side(draw, full, tiny) for full in fixed.shape)
    if min(height, width) < 5 or max(height, width) < 8:
        kind = draw.choice(["corridor", "pillars"])
    else:
        kind = draw.choice(list(KINDS))
    return str(kind), KINDS[kind](draw, height, width)


def _roomy_world(draw, fixed):
    """The first of some worlds that has more than a few clear cells; sometimes any, or a tiny one."""
    tiny = draw.random() < 0.06
    tries = 0 if tiny or draw.random() < 0.1 else 9
    kind, occupied = _world(draw, fixed, tiny)
    while tries and len(episodes.clear_cells(occupied, fixed.clearance_d2)) <= 10:
        kind, occupied = _world(draw, fixed, tiny)
        tries -= 1
    return kind, occupied


def _rooms(draw, occupied):
    """Blocks of some cells, with numbers, some of them no room; or none at all."""
    if draw.random() < 0.4:
        return None
    side = int(draw.integers(2, 20))
    rows, cols = (index // side for index in np.indices(occupied.shape))
    number = rows * (occupied.shape[1] // side + 1) + cols
    none = draw.random(number.max() + 1) < 0.2
    return np.where(occupied | none[number], -1, number).astype(np.int32)


def _start(draw, occupied, clearance_d2):
    """Anywhere free, where there is room, close to a wall, or (rarely) in one."""
    where = draw.choice(["free", "clear", "wall", "any"], p=[0.2, 0.6, 0.18, 0.02])
    cells = np.argwhere(~occupied)
    if where == "any":
        cells = np.argwhere(occupied | True)
    elif where == "clear":
        cells = episodes.clear_cells(occupied, clearance_d2)
    elif where == "wall":
        cells = np.argwhere(~occupied & ndimage.binary_dilation(occupied, iterations=2))
    cells = cells if len(cells) else np.argwhere(occupied | True)
    row, col = cells[draw.integers(len(cells))]
    return int(row), int(col), 45 * int(draw.integers(8))


# ---------------------------------------------------------------- scanners and rules


def _radius(draw, d2, cell_m):
    """A radius that reaches cells at the squared distance `d2` and no others, metres."""
    within = math.sqrt(d2) * cell_m
    radius_m = draw.choice([within, draw.uniform(within, math.sqrt(d2 + 1) * cell_m)])
    return float(radius_m if radius_d2(radius_m, cell_m) == d2 else within)


def _range(draw, cell_m, most_cells):
    """A range, metres: any, with two decimals, or a whole number of cells or half cells, where a beam enters a cell."""
    most_m = min(12.0, most_cells * cell_m)
    range_m = math.exp(draw.uniform(math.log(min(0.3, most_m)), math.log(most_m)))
    how = draw.choice(["any", "decimals", "halves"], p=[0.3, 0.2, 0.5])
    if how == "decimals":
        range_m = round(range_m, 2)
    elif how == "halves":
        halves = max(round(2 * range_m / cell_m), 1)
        range_m = (halves | int(draw.integers(2))) * cell_m / 2
        range_m = round(range_m, 4) if cell_m in SPECIAL_CELLS else range_m
    return float(min(range_m, most_m))


def _lidar(draw, fixed, cell_m):
    steps, most_beams = fixed.beams_as
    most_cells = fixed.range_cells
    while n_steps(most_cells) > steps:
        most_cells -= 1
    if most_beams > 181 and draw.random() < 0.5:
        n_beams = int(draw.integers(182, most_beams + 1))
    else:
        n_beams = int(draw.choice([1, draw.integers(2, 20), draw.integers(2, 182)], p=[0.05, 0.25, 0.7]))
    n_beams = min(n_beams | int(draw.integers(2)), most_beams)  # odd ones have a beam straight ahead
    noise = {}
    if fixed.noisy:
        sigma_cells, dropout = draw.choice([0, 0.1, 0.5, 1, 3]), draw.choice([0, 0.05, 0.3])
        noise = {"sigma_m": float(sigma_cells * cell_m * draw.uniform(0.5, 1.5)), "dropout": float(dropout)}
        if not any(noise.values()):
            noise["dropout"] = 0.1
    return Lidar(
        n_beams=n_beams,
        fov_deg=float(draw.choice([draw.choice(SPECIAL_FOV), draw.uniform(30, 360)])),
        range_m=_range(draw, cell_m, most_cells),
        no_echo=str(draw.choice(["free", "free", "free", "unknown"])),
        **noise,
    )


def _rules(draw, fixed, cell_m, n_cells):
    """Bounds for all noisy episodes and for large worlds, where the oracle is slow; else for some."""
    bounded = fixed.noisy or n_cells > 4000 or draw.random() < 0.2
    most_steps, most_plans = (400, 100) if fixed.noisy else (1000, 200)
    p_free = draw.choice([0.25, draw.choice([0.125, 0.5]), draw.integers(1, 95) / 100, draw.uniform(0, 0.95)])
    return Rules(
        clearance_m=_radius(draw, fixed.clearance_d2, cell_m),
        near_m=float(draw.choice([0, 0.5, draw.uniform(0, 1)])),
        p_free=float(p_free),
        look_around=bool(draw.random() < 0.75),
        scan_every_m=float(draw.choice([0, 0, 0, draw.uniform(0, 2)])),
        arrival_m=float(draw.choice([0, 0, 0, draw.uniform(0, 1)])),
        max_steps=int(draw.integers(10, most_steps)) if bounded else None,
        max_plans=int(draw.integers(3, most_plans)) if bounded else None,
        frontier_connectivity=fixed.frontier[0],
        min_frontier_cells=fixed.frontier[1],
        **(_ends(draw) if fixed.ends else {}),
    )


def _ends(draw):
    """A share to stop at, a way home, or both; sometimes a limit of the path or the time."""
    stop_at = draw.choice([None, 1.0, round(draw.uniform(0.2, 1), 3)])
    return {
        "stop_at": stop_at,
        "return_home": bool(stop_at is None or draw.random() < 0.5),
        "max_path_m": float(draw.uniform(0.1, 20)) if draw.random() < 0.2 else None,
        "max_time_s": float(draw.uniform(1, 60)) if draw.random() < 0.2 else None,
    }


def kinds_of(case, verdict):
    """Return the kinds of which a case is an example, as texts."""
    lidar, (height, width) = case.lidar, case.occupied.shape
    among = {
        "noise": case.fixed.noisy,
        f"more than {PACKED} columns": width > PACKED,
        f"more than {PACKED} rows": height > PACKED,
        f"noise, a side above {PACKED}": case.fixed.noisy and max(height, width) > PACKED,
        "field of view below 90 degrees": lidar.fov_deg < 90,
        "field of view of 360 degrees": lidar.fov_deg == 360,
        "no echo, unknown": lidar.no_echo == "unknown",
        "restricted": case.within is not None,
        "one beam": lidar.n_beams == 1,
        "more than 181 beams": lidar.n_beams > 181,
        "a range of whole or half cells": (2 * in_cells(lidar.range_m, case.cell_m)).is_integer(),
        "no clearance": case.fixed.clearance_d2 == 0,
        "no look around": not case.rules.look_around,
        "scans now and then": case.rules.scan_every_m > 0,
        "arrives before the target": case.rules.arrival_m > 0,
        "driven by native code": case.fixed.native,
        "rooms": case.rooms is not None,
        "refused steps": verdict.refused > 0,
        "frontiers across edges": case.rules.frontier_connectivity == 4,
        "groups of frontier cells": case.rules.min_frontier_cells > 1,
        "stops": case.rules.stop_at is not None,
        "returns": case.rules.return_home,
        "limit of the path": case.rules.max_path_m is not None,
        "limit of the time": case.rules.max_time_s is not None,
    }
    kinds = [kind for kind, is_one in among.items() if is_one]
    return [*kinds, f"world: {case.world}", f"strategy: {case.strategy}", f"outcome: {verdict.outcome}"]


def draw_case(seed, number, fixed=MANY):
    """A case: of the same three arguments always the same one.

    Args:
      seed, number: ints, at least 0.
      fixed: what there are programs for; the cases take turns.
    """
    draw, chosen = np.random.default_rng((seed, number)), fixed[number % len(fixed)]
    most_m = min(0.3, 0.6 / math.sqrt(chosen.clearance_d2 + 1))
    special = [cell_m for cell_m in SPECIAL_CELLS if cell_m <= most_m]
    cell_m = float(draw.choice([draw.choice(special), draw.uniform(0.05, most_m)]))
    world, occupied = _roomy_world(draw, chosen)
    start = _start(draw, occupied, chosen.clearance_d2)
    within, known = _restricted(draw, occupied, start) if chosen.restricted else (None, None)
    return Case(
        fixed=chosen,
        seed=number,
        world=world,
        occupied=occupied,
        rooms=_rooms(draw, occupied),
        within=within,
        known=known,
        start=start,
        strategy=chosen.policy + str(draw.choice(["", "+recheck"])),
        lidar=_lidar(draw, chosen, cell_m),
        rules=_rules(draw, chosen, cell_m, occupied.size),
        cell_m=cell_m,
    )


def _restricted(draw, occupied, start):
    """Draw a region around the start, and a partial map known before, with some errors."""
    rows, cols = np.indices(occupied.shape)
    slope, side = draw.normal(size=2), draw.uniform(2, max(occupied.shape))
    within = np.abs(slope @ np.stack([rows.ravel() - start[0], cols.ravel() - start[1]])) < side
    known = np.where(rows < draw.integers(occupied.shape[0] + 1), occupied, -1)
    wrong = draw.random(occupied.shape) < draw.choice([0, 0.02])
    wrong[[0, -1]] = wrong[:, [0, -1]] = False
    return within.reshape(occupied.shape), np.where((known >= 0) & wrong, 1 - known, known).astype(np.int8)


def compare(case, *, oracle=True, loaded=None):
    """Plays a case by the engine, natively where that can be, and by the oracle: a `Verdict`.

    Args:
      case: `Case`.
      oracle: whether the oracle is asked.
      loaded: the native library; by default that of the package.
    """
    fixed = case.fixed
    world = {name: getattr(case, name) for name in ("cell_m", "rooms", "within", "known", "robot")}
    how = {"shape": fixed.shape, "seed": case.seed, "beams_as": fixed.beams_as}
    episode = case.occupied, case.start, case.strategy, case.lidar, case.rules
    result, state = episodes.play(*episode, native=fixed.native, **world, **how)
    told = []
    if not fixed.noisy and find_compiler():
        told = native.differences(native.play(case, loaded), result, state, case.occupied)
    if oracle:
        told += _by_oracle(case, episode, world, how, result, state)
    return _verdict(told, result)


def _verdict(told, result):
    return Verdict(
        differences=told,
        outcome=Outcome(int(result.outcome)).name,
        steps=int(result.straight + result.diagonal),
        scans=int(result.scans),
        refused=int(result.refused),
    )


def compare_alone(case):
    """Play a case without noise in native code in several ways, without JAX: a `Verdict`."""
    run, told = native.differences_among(case)
    result = jax.tree.map(lambda a: a[0], run.results)
    return _verdict(told, result)


def _by_oracle(case, episode, world, how, result, state):
    fixed = case.fixed
    sense = episodes.readings_of(case.occupied, case.lidar, cell_m=case.cell_m, **how) if fixed.noisy else None
    choose = episodes.choice_of(case.seed) if fixed.policy == "random" else None
    want = episodes.replay(*episode, **world, choose=choose, sense=sense)
    return episodes.differences(result, state, want, **world)
