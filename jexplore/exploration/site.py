"""A world made ready for episodes: padded, with the scanner's beams traced, and the numbers that go with a strategy."""

import dataclasses
import math
import threading
from typing import NamedTuple

import jax
import numpy as np

from jexplore import raycast, reach
from jexplore.arrays.padding import bucket, number
from jexplore.config import InputError
from jexplore.exploration.episode import Numbers, Outcome, Result, Setup, Truth, no_results
from jexplore.grid import in_cells, radius_d2
from jexplore.raycast import beam_table, scans_all_round

LEAST_LIMIT = 20_000  # default bound of steps and plans on small maps


@dataclasses.dataclass(frozen=True)
class Kernels:
    """Which form of the kernels is used. Results are the same."""

    reach: str = "sweeps"
    """One of `reach.METHODS`."""
    scan: str = "blocks"
    """One of `raycast.METHODS`."""

    def __post_init__(self):
        for name, known in (("reach", reach.METHODS), ("scan", raycast.METHODS)):
            if getattr(self, name) not in known:
                raise InputError(f"kernel {name} must be one of {', '.join(known)}, got {getattr(self, name)!r}")


ENGINES = {"serial": Kernels(), "lockstep": Kernels(reach="wave", scan="whole")}
"""Name -> the kernels that suit it."""


class Site(NamedTuple):
    """A world, a scanner and rules, ready for episodes."""

    truth: Truth  # of one world
    beams: object  # `raycast.Beams`
    clearance_d2: int
    first_scans: int
    window: int
    noisy: bool
    capacity: int
    near_d2: int
    max_steps: int
    max_plans: int
    sigma_cells: float
    dropout: float
    p_free: float
    cell_m: float
    look_around: bool


def prepare(world, lidar, rules):
    """Pads a world and traces the scanner's beams.

    Args:
      world: `World`.
      lidar: `Lidar`.
      rules: `Rules`.

    Returns:
      `Site`.
    """
    from scipy import ndimage

    height, width = world.shape
    shape = bucket(height), bucket(width)
    pad = [(0, full - n) for full, n in zip(shape, world.shape)]
    rooms = world.rooms if world.rooms is not None else np.full(world.shape, -1, np.int32)
    region = ndimage.label(~world.occupied)[0].astype(np.int32)  # type: ignore[index]
    truth = Truth(
        occupied=np.pad(world.occupied, pad, constant_values=True),  # type: ignore[arg-type]
        rooms=np.pad(rooms, pad, constant_values=-1),  # type: ignore[arg-type]
        region=np.pad(region, pad),  # type: ignore[arg-type]
        extent=np.asarray([world.shape], np.int32),  # type: ignore[arg-type]
    )
    limit = max(LEAST_LIMIT, height * width)
    max_steps = rules.max_steps or limit
    return Site(
        truth=truth,
        beams=beam_table(lidar, world.cell_m, shape[1]),
        clearance_d2=radius_d2(rules.clearance_m, world.cell_m),
        first_scans=scans_all_round(lidar.fov_deg),
        window=math.ceil(in_cells(lidar.range_m + 4 * lidar.sigma_m, world.cell_m)) + 1,
        noisy=lidar.sigma_m > 0 or lidar.dropout > 0,
        capacity=max(LEAST_LIMIT, shape[0] * shape[1]) if max_steps <= limit else max_steps,
        near_d2=radius_d2(rules.near_m, world.cell_m),
        max_steps=max_steps,
        max_plans=rules.max_plans or limit,
        sigma_cells=lidar.sigma_m / world.cell_m,
        dropout=lidar.dropout,
        p_free=rules.p_free,
        cell_m=world.cell_m,
        look_around=rules.look_around,
    )


def setup_of(site, strategy, kernels):
    """The `Setup` of a strategy in a `Site`."""
    return Setup(
        init=strategy.policy.init,
        select=strategy.policy.select,
        live=strategy.policy.live,
        clearance_d2=site.clearance_d2,
        first_scans=site.first_scans,
        window=site.window,
        noisy=site.noisy,
        capacity=site.capacity,
        reach=kernels.reach,
        scan=kernels.scan,
    )


def numbers_of(site, strategy):
    """The `Numbers` of a strategy in a `Site`."""
    return Numbers(
        p_free=np.float32(site.p_free),  # type: ignore[arg-type]
        near_d2=np.int32(site.near_d2),  # type: ignore[arg-type]
        cell_m=np.float32(site.cell_m),  # type: ignore[arg-type]
        look_around=np.bool_(site.look_around),  # type: ignore[arg-type]
        recheck=np.bool_(strategy.recheck),  # type: ignore[arg-type]
        max_steps=np.int32(site.max_steps),  # type: ignore[arg-type]
        max_plans=np.int32(site.max_plans),  # type: ignore[arg-type]
        sigma_cells=np.float32(site.sigma_cells),  # type: ignore[arg-type]
        dropout=np.float32(site.dropout),  # type: ignore[arg-type]
        params=jax.tree.map(number, strategy.policy.params),
    )


@dataclasses.dataclass
class Line:
    """The episodes of one strategy in one world that are to be run here, and what has come back."""

    site: Site
    setup: Setup
    numbers: Numbers
    seed: int
    starts: np.ndarray  # [N, 3] int32, row, col, heading (units of 45 degrees)
    which: np.ndarray  # [n] int32, numbers of the episodes to be run here; ascending
    results: Result = dataclasses.field(init=False)  # numpy, [N]; outcome RUNNING where there is none yet
    first: tuple | None = None  # of episode 0, padded: hits, misses `[H, W]` and trail `[T + 1, 3]`
    lock: threading.Lock = dataclasses.field(default_factory=threading.Lock)

    def __post_init__(self):
        self.results = no_results(len(self.starts))

    def put(self, which, results):
        """Keeps results: `[k]` numbers of episodes, and a `Result` of `[k]`. Any thread may call it."""
        with self.lock:
            jax.tree.map(lambda all_, new: all_.__setitem__(which, new), self.results, results)

    @property
    def left(self):
        """`[m]` int32, numbers of the episodes that have no result yet."""
        return self.which[self.results.outcome[self.which] == Outcome.RUNNING]

    @property
    def kind(self):
        """What must be equal for two lines to share a compiled program. Hashable."""
        leaves, tree = jax.tree.flatten((self.site.truth, self.site.beams, self.numbers))
        return self.setup, tree, tuple((a.shape, a.dtype) for a in leaves)


def line_of(site, strategy, starts, seed, kernels, which):
    """A `Line`.

    Args:
      site: `Site`.
      strategy: `Strategy`.
      starts: `[N, 3]` int, row, col, heading_deg (multiples of 45).
      seed: int.
      kernels: `Kernels`.
      which: `[n]` int, numbers of the episodes to be run here.
    """
    starts = np.array(starts, np.int32)
    starts[:, 2] //= 45
    setup = setup_of(site, strategy, kernels)
    return Line(site, setup, numbers_of(site, strategy), seed, starts, np.asarray(which, np.int32))
