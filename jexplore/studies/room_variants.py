"""The ways to divide a map into rooms, by name: one interface to the kernels and to the plain methods."""

import dataclasses
import functools
from typing import Any, NamedTuple

import jax
import numpy as np

from jexplore import segment
from jexplore.arrays.padding import bucket, framed, within
from jexplore.config import checked_names, require_number
from jexplore.rooms import watershed
from jexplore.rooms.baselines import BASELINES
from jexplore.worlds.world import ring_of

ROOM_VARIANTS = ("voronoi", *BASELINES, *segment.MAX_HOPS)
BEST = "voronoi"  # by left-out scores: `benchmarks/segmentation_left_out.py`


@functools.partial(checked_names, own="segment_maps")
@dataclasses.dataclass(frozen=True)
class RoomSettings:
    """Numbers and choices of all variants."""

    ratio: float = watershed.RATIO  # voronoi: see `watershed.RoomCriteria`
    narrowing: float = watershed.NARROWING  # voronoi: see there; 0: any
    smallest_m2: float = watershed.SMALLEST_ROOM_M2  # voronoi: area of the smallest room, m^2
    clutter_m: float = watershed.CLUTTER_M  # all but the paper's: smaller obstacles are no walls, metres
    prominence_m: float = segment.PROMINENCE_M  # thrun, wurm, holz: see `segment.Criteria`, metres
    gamma: float = 3.0  # cells

    def __post_init__(self) -> None:
        most = {"ratio": 1, "narrowing": 1, "smallest_m2": 1e6, "clutter_m": 1000, "prominence_m": 100, "gamma": 1000}
        for name, high in most.items():
            require_number(name, getattr(self, name), high=high)


class RoomMap(NamedTuple):
    """A map in rooms."""

    label: np.ndarray  # [H, W] int32; negative for none
    lines: np.ndarray  # [n] int, flat index of the cells of the Voronoi graph, where the variant has one
    critical: np.ndarray  # [m] int, flat index of its critical points
    overflow: int  # what did not fit


def divided(free: np.ndarray, unseen: np.ndarray, variant: str, settings: RoomSettings, cell_m: float) -> RoomMap:
    """Divide a map by a variant, a name in `ROOM_VARIANTS`.

    `free` and `unseen` are `[H, W]` bool; cells that nobody has seen are obstacles for the paper's variants.
    """
    if variant in segment.MAX_HOPS:
        criteria = segment.criteria(variant, prominence=settings.prominence_m / cell_m, gamma=settings.gamma)
        made: Any = segmented(free, criteria)  # of numpy arrays
        cell = made.graph.cell
        return RoomMap(made.label, cell[cell < free.size], cell[made.critical], int(made.overflow))
    (height, width), wide_free, wide_unseen = free.shape, framed(free), framed(unseen)
    form = watershed.room_form_for(wide_free.shape, coarse=True)
    if variant == "voronoi":
        sizes = {"smallest_m2": settings.smallest_m2, "clutter_m": settings.clutter_m}
        numbers = watershed.room_criteria(cell_m, ratio=settings.ratio, narrowing=settings.narrowing, **sizes)
        rooms = watershed.watershed(wide_free, wide_unseen, numbers, form=form)
        label, overflow = np.asarray(rooms.label), rooms.overflow
    else:
        size = np.float32(settings.clutter_m / cell_m)
        inside, d2, overflow = watershed.cleared(wide_free, wide_unseen, size, edges=form.edges)
        label = BASELINES[variant](np.asarray(inside), np.sqrt(np.asarray(d2)) - 0.5, cell_m)
    none = np.zeros(0, int)
    return RoomMap(np.where(free, label[1 : height + 1, 1 : width + 1], -1), none, none, int(overflow))


def segmented(free: np.ndarray, criteria: segment.Criteria) -> segment.Segments:
    """Segment a map, `[H, W]` bool: numpy arrays; the label is cut to the map and flat indices count in it."""
    (height, width), ring = free.shape, ring_of(~free)
    shape = bucket(height + 2 * ring), bucket(width + 2 * ring)
    padded = np.pad(free, [(ring, full - n - ring) for full, n in zip(shape, free.shape)])
    made = segment.segment(padded, criteria, form=segment.form_for(shape, coarse=True))
    made = jax.tree.map(np.asarray, made)

    def in_map(cell):
        inside = (cell // shape[1] - ring) * width + cell % shape[1] - ring
        return np.where(cell < padded.size, inside, free.size)

    graph = made.graph.replace(cell=in_map(made.graph.cell))
    return made.replace(label=within(made.label, free.shape, ring), graph=graph, seed=in_map(made.seed))
