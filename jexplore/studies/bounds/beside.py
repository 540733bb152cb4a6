"""Episodes beside the bounds of their starts.

pandas is imported by the functions that need it.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

from jexplore.config import InputError
from jexplore.report.tables import aligned_table, number_text

if TYPE_CHECKING:
    import pandas as pd

START = ("start_row", "start_col", "start_heading_deg")
COLUMNS = ("path_over_high", "path_over_low_any")
"""Columns of `beside`: the path over the length of the walk that was found, and over the bound of every robot."""


def beside(episodes: "pd.DataFrame", bounds: "pd.DataFrame", digests: Mapping[str, str]) -> "pd.DataFrame":
    """The table of episodes with the columns `COLUMNS`; NaN for an episode that is not complete or has no bound.

    A ratio to the walk that was found may be below 1: that walk is short, not the shortest, and stands on clear cells.

    Args:
      episodes: the table of a comparison, a pandas DataFrame.
      bounds: `Bounds.table`.
      digests: world -> SHA-256 of the world that the episodes ran in.

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
    ratios = {}
    for name, column in zip(COLUMNS, ("high_m", "low_any_m")):
        length = found[column].where(found[column] > 0)
        ratios[name] = path_m / length.to_numpy()
    return episodes.assign(**ratios)


def beside_table(table: "pd.DataFrame", by: Sequence[str] = ("world", "strategy")) -> str:
    """Means and the worst of the ratios as Markdown.

    Args:
      table: from `beside`.
      by: columns; a row for each of their values.
    """
    head = [*by, "n", "path / high", "worst", "below 1", "path / low any", "worst "]
    lines = []
    for names, rows in table.groupby(list(by), sort=False):
        own = cast(Any, rows)
        high, low = (own[name].dropna() for name in COLUMNS)
        line = [*map(str, cast(tuple, names)), str(len(low)), number_text(high.mean(), 3), number_text(high.max(), 3)]
        lines.append([*line, str(int((high < 1).sum())), number_text(low.mean(), 3), number_text(low.max(), 3)])
    return aligned_table(head, lines, left=by)
