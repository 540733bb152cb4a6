"""A trace map extracted from the grid map of an exploration episode, compared with the truth."""

import dataclasses
import os
from typing import TYPE_CHECKING, Any

import numpy as np

from jexplore.config import require_number
from jexplore.driving.settings import Tuning, for_world, require_tuning
from jexplore.extraction.extract import extract
from jexplore.grid import centre_of
from jexplore.report import plot_traces
from jexplore.rooms.watershed import CLUTTER_M
from jexplore.studies import explore
from jexplore.studies.explore import EpisodeResult
from jexplore.studies.traces.recording import walls_in_frame
from jexplore.tracemap.record import BtmMap
from jexplore.worlds.world import World, ring_of, with_ring

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NEAR_CELLS = 2.0  # a node is found if it lies this near to the true one


@dataclasses.dataclass(frozen=True)
class ExtractionResult:
    """Result of `extracted`."""

    map: BtmMap
    episode: EpisodeResult

    @property
    def measures(self) -> dict[str, Any]:
        """Return the episode's measures: name -> value."""
        return {"strategy": self.episode.strategy, **self.episode.measures}

    def agreement(self) -> list[str]:
        """Compare the map with the world's true topology: lines of text, none if the world has none."""
        course = self.episode.world.course
        return [] if course is None else [agreement(self.map, course.topology, self.episode.world.cell_m)]

    def figure(self) -> "Figure":
        """Draw the map over the building and the robot's way: a matplotlib `Figure`."""
        world, final = self.episode.world, self.episode.final
        x, y = centre_of(final.rows, final.cols, cell_m=world.cell_m, origin_m=world.origin_m)
        trail, modes = np.stack([x, y, np.zeros(len(x))], axis=1), np.zeros(len(x), int)
        walls, episode = walls_in_frame(with_ring(world)), self.episode
        return plot_traces.trace_figure(self.map, walls, trail, None, modes, [episode.strategy], episode.title)


def extracted(
    world: str | os.PathLike[str] | World, strategy: str = "closest+recheck", *, seed: int = 0, cell_m: float = 0.1,
    clutter_m: float = CLUTTER_M, tuning: Tuning | None = None,
) -> ExtractionResult:  # fmt: skip
    """Explore a world, a course from its own start, and extract the map from the last grid.

    `tuning` gives the reference width and C1; `clutter_m` as of `extract.extract`, the others as of `explore.explore`.
    """
    own = isinstance(world, str) and world.partition("#")[0].partition(":")[0] == "course"
    is_course = own or getattr(world, "course", None) is not None
    tuning = for_world(tuning or Tuning(), is_course=is_course)
    require_tuning(tuning)
    require_number("clutter_m", clutter_m)
    start = "world" if is_course else "random"
    episode = explore.explore(world, strategy, seed=seed, cell_m=cell_m, start=start)
    final = episode.final
    n = final.hits + final.misses
    free = (n > 0) & (final.hits <= episode.rules.p_free * n)
    ring = ring_of(episode.world.occupied)  # what lies beyond the edge is known to be wall
    found = extract(
        np.pad(free, ring),
        np.pad(n > 0, ring, constant_values=True),
        cell_m,
        start_rc=(int(final.rows[0]) + ring, int(final.cols[0]) + ring),
        trail=np.stack([final.rows, final.cols], axis=1) + ring,
        width_m=tuning.width_m,
        open_m=tuning.open_m,
        clutter_m=clutter_m,
        origin_m=with_ring(episode.world).origin_m,
    )
    return ExtractionResult(found, episode)


def matched(found: BtmMap, true: BtmMap, cell_m: float) -> tuple[int, int, int]:
    """Count divergences of one map that lie where another has one of the same degree: `(hits, n_found, n_true)`."""
    ours, theirs = ([n for n in m.nodes if n.type == "divergence"] for m in (found, true))
    left = list(ours)
    for node in theirs:
        near = [o for o in left if np.hypot(o.x_m - node.x_m, o.y_m - node.y_m) <= NEAR_CELLS * cell_m]
        near = [o for o in near if len(found.bearings_deg(o.id)) == len(true.bearings_deg(node.id))]
        left = [o for o in left if o not in near[:1]]
    return len(ours) - len(left), len(ours), len(theirs)


def agreement(found: BtmMap, true: BtmMap, cell_m: float) -> str:
    """Compare the divergences of two maps: a line of text."""
    hits, ours, theirs = matched(found, true, cell_m)
    return f"true divergences found, within {NEAR_CELLS:g} cells and of their degree: {hits} of {theirs}; {ours} in all"
