"""Episodes compared with the bounds of their starts."""

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
import pandas as pd

from jexplore.config import InputError
from jexplore.report.tables import aligned_table, number_text, ratio_text
from jexplore.studies.results.columns import RATIO_COLUMNS
from jexplore.studies.statistics.over_worlds import kind_of, ratio_over_worlds

START = ("start_row", "start_col", "start_heading_deg")


def with_bound_ratios(episodes: pd.DataFrame, bounds: pd.DataFrame, digests: Mapping[str, str]) -> pd.DataFrame:
    """Add the columns `RATIO_COLUMNS` to the table of episodes; NaN for an incomplete episode or one without a bound.

    A ratio to the walk that was found may be below 1: that walk is short, not the shortest, and stands on clear cells.
    `digests` is world -> SHA-256 of the world that the episodes ran in.

    Raises:
      InputError: bounds of another world of the same name; no start in common.
    """
    for world, sha256 in dict(zip(bounds["world"], bounds["sha256"])).items():
        if digests.get(world, sha256) != sha256:
            raise InputError(f"the bounds of {world!r} are of another world of that name: find them anew")
    keys: Any = ["world", *START]
    known: Any = bounds[[*keys, "high_m", "low_any_m"]]
    found: Any = episodes[keys].merge(known.drop_duplicates(keys), on=keys, how="left")
    if not found["low_any_m"].notna().any():
        raise InputError("bounds must be of the episodes' worlds and starts, and have none of them")
    path_m = episodes["path_m"].where(episodes["outcome"] == "COMPLETE").to_numpy()
    lengths = (found[column].where(found[column] > 0).to_numpy() for column in ("high_m", "low_any_m"))
    return episodes.assign(**{name: path_m / length for name, length in zip(RATIO_COLUMNS, lengths)})


def beside_table(table: pd.DataFrame, by: Sequence[str] = ("world", "strategy")) -> str:
    """Format ratios from `with_bound_ratios` as Markdown, a row for each value of the columns `by`.

    Means are of logarithms, each world once; next to them the worst episode's. Intervals (95 %) are for other worlds of
    the same kinds, as in a league; where there are several kinds, each one's ratio to the walk is a column.
    """
    found = table.assign(kind=[kind_of(world) for world in table["world"]])
    kinds = [] if "world" in by else list(dict.fromkeys(found["kind"]))
    kinds = kinds if len(kinds) > 1 else []
    head = [*by, "n", "path / high", *kinds, "worst / high", "below 1", "path / low any", "worst / low any"]
    lines = []
    for names, rows in found.groupby(list(by), sort=False):
        own = cast(Any, rows)
        high, low = (own[name].dropna() for name in RATIO_COLUMNS)
        line = [*map(str, cast(tuple, names)), str(len(low)), _over_worlds(own, RATIO_COLUMNS[0])]
        line += [_over_worlds(own[own["kind"] == kind], RATIO_COLUMNS[0]).split(" ")[0] for kind in kinds]
        line += [number_text(high.max(), 3), str(int((high < 1).sum()))]
        lines.append([*line, _over_worlds(own, RATIO_COLUMNS[1]), number_text(low.max(), 3)])
    return aligned_table(head, lines, left=by)


def _over_worlds(rows, column):
    """Format the ratio of some episodes, a world's mean logarithm counting once, and its interval."""
    known = rows.dropna(subset=[column])
    logs = np.log(known[column]).groupby(known["world"], sort=False).mean()
    return ratio_text(*ratio_over_worlds(logs, logs.index)[:3])
