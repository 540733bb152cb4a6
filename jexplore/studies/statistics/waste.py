"""Wasted path: transits of an episode that show nothing new, and visits to leftovers.

A *transit* is a stretch of at least `TRANSIT_M` on which nothing new is seen. The part up to the next transit is its
visit; a visit that shows less than `LEFTOVER_M2` was to a leftover, an area that had been left behind.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, cast

import numpy as np
import pandas as pd

from jexplore.config import InputError
from jexplore.exploration.results import length_along_m
from jexplore.report.tables import aligned_table, number_text
from jexplore.studies.results.columns import WASTE_COLUMNS

TRANSIT_M = 2.0
LEFTOVER_M2 = 3.0
NEW, IDLE, LEFTOVER = 0, 1, 2
"""Kind of a step: new cells, or too short for a transit; part of a transit; part of a visit to a leftover."""


class Waste(NamedTuple):
    """Wasted parts of a way."""

    kinds: np.ndarray  # [n] int8, of each step: NEW, IDLE or LEFTOVER
    idle_m: float
    leftovers: int
    leftover_m: float
    leftover_m2: float


def waste_of(way: np.ndarray, cell_m: float) -> Waste:
    """Measure the wasted parts of a way: `[n + 1, 3]` int32, row, col and known cells after 0 to n steps."""
    at_m, new = length_along_m(way[:, 0], way[:, 1], cell_m), np.diff(way[:, 2])
    step_m, idle = np.diff(at_m), new == 0
    kinds = np.full(len(new), NEW, np.int8)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], idle, [0]]).astype(np.int8)))
    transits = [(a, b) for a, b in edges.reshape(-1, 2).tolist() if at_m[b] - at_m[a] >= TRANSIT_M - 1e-9]
    leftovers, leftover_m2 = 0, 0.0
    for (first, until), after in zip(transits, [a for a, _ in transits[1:]] + [len(new)]):
        shown_m2 = float(new[until:after].sum()) * cell_m**2
        is_leftover = shown_m2 < LEFTOVER_M2
        kinds[first:until] = LEFTOVER if is_leftover else IDLE
        if is_leftover:
            kinds[until:after] = LEFTOVER
            leftovers, leftover_m2 = leftovers + 1, leftover_m2 + shown_m2
    leftover_m = float(step_m[kinds == LEFTOVER].sum())
    return Waste(kinds, float(step_m[idle].sum()), leftovers, leftover_m, leftover_m2)


def wasted(
    episodes: pd.DataFrame, paths: Mapping[tuple[str, str], Sequence[np.ndarray]], cells_m: Mapping[str, float]
) -> pd.DataFrame:
    """Add the columns `WASTE_COLUMNS` to the table of episodes.

    `paths` are `ComparisonResult.paths`; `cells_m` is world -> edge of its cells, metres.
    """
    if not paths:
        raise InputError('no ways were kept: compare(..., keep="paths")')
    rows = {name: np.full(len(episodes), np.nan) for name in WASTE_COLUMNS}
    for (world, strategy), ways in paths.items():
        own = np.flatnonzero((episodes["world"] == world).to_numpy() & (episodes["strategy"] == strategy).to_numpy())
        for at, way in zip(own, ways):
            found = waste_of(way, cells_m[world])
            for name in WASTE_COLUMNS:
                rows[name][at] = getattr(found, name)
    return episodes.assign(**rows)


def waste_table(table: pd.DataFrame, by: Sequence[str] = ("world", "strategy")) -> str:
    """Format shares of the path from `wasted` as Markdown, a row for each value of the columns `by`."""
    head = [*by, "path m", "shows nothing new", "after 95 %", "leftovers", "to leftovers", "that show m2"]
    lines = []
    for names, rows in table.groupby(list(by), sort=False):
        own = cast(Any, rows)
        path_m = own["path_m"].sum()
        late = (own["path_m"] - own["path_m_at_95"]).sum()
        nothing, after, to = (
            f"{100 * value / path_m:.0f}%" if path_m else "-"
            for value in (own["idle_m"].sum(), late, own["leftover_m"].sum())
        )
        line = [*map(str, cast(tuple, names)), number_text(own["path_m"].mean(), 1), nothing, after]
        lines.append([*line, number_text(own["leftovers"].mean(), 1), to, number_text(own["leftover_m2"].mean(), 1)])
    return aligned_table(head, lines, left=by)
