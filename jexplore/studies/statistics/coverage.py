"""Strategies at equal coverage: paths and times until a share was known, relative to the first strategy."""

from typing import Any

import pandas as pd

from jexplore.report.tables import aligned_table, ratio_text
from jexplore.studies.statistics.league import paths_by_world
from jexplore.studies.statistics.over_worlds import ALL_WORLDS, comparable_paths, ratio_over_worlds
from jexplore.studies.statistics.paired import MIN_PAIRS, finite_ratio

_SHARES = {"50 %": "_at_50", "90 %": "_at_90", "95 %": "_at_95", "99 %": "_at_99", "100 %": ""}
MEASURES = {
    **{("path", share): f"path_m{end}" for share, end in _SHARES.items()},
    ("path", "area"): "area_m",
    **{("time", share): f"time_s{end}" for share, end in _SHARES.items()},
    ("time", "area"): "area_s",
    ("time", "energy"): "energy_j",
}
"""Measure and place on the curve -> column of the table of episodes."""


def at_coverage(episodes: pd.DataFrame) -> pd.DataFrame:
    """Tabulate ratios to the first strategy at every share, of path and time.

    `area` is the area above the curve of the known share, over the path or over time: how far the robot has driven, or
    how long, when a share was first known, in the mean over all hundredths. The area below the curve up to a common end
    D, beyond all curves, is 1 - area / D: the ratio of the areas above depends on no such end. Episodes that have
    failed (`over_worlds.comparable_paths`) are left out with their partners. A team's path to 100 % ends when all was
    known, not with its last robot.

    Returns:
      A DataFrame, a row each: `measure`, `share` (of `MEASURES`), `world`, `strategy`, `ratio`, `low`, `high`, `p`, and
        `n`, how many worlds or pairs. With `MIN_PAIRS` worlds or more the rows are over all of them, as in
        `league.standings`, else of each world, by `paired_ratio`.
    """
    if "path_m_at_100" in episodes:
        episodes = episodes.assign(path_m=episodes["path_m_at_100"])
    worlds, strategies = (list(dict.fromkeys(episodes[key])) for key in ("world", "strategy"))
    together = len(worlds) >= MIN_PAIRS
    rows = []
    for (measure, share), column in MEASURES.items():
        values: Any = paths_by_world(episodes, column) if together else comparable_paths(episodes, column)
        for world in [ALL_WORLDS] if together else [one for one in worlds if one in values.index]:
            for name in strategies:
                if together:
                    own = values[values["strategy"] == name]
                    found = ratio_over_worlds(own["log_ratio"], own["world"])
                else:
                    found = finite_ratio(values.loc[world][name], values.loc[world].iloc[:, 0])
                rows.append((measure, share, world, name, *found))
    return pd.DataFrame(rows, columns=["measure", "share", "world", "strategy", *("ratio", "low", "high", "p", "n")])


TITLES = {
    "path": "Path until a share was known, to that of the first strategy",
    "time": "Time until a share was known, to that of the first strategy",
}


def coverage_tables(table: pd.DataFrame) -> dict[str, str]:
    """Format `at_coverage` as Markdown tables by title; over many worlds the shortest to 100 % come first."""
    found = {}
    for measure, title in TITLES.items():
        own: Any = table[table["measure"] == measure]
        keys = ["strategy"] if set(own["world"]) == {ALL_WORLDS} else ["world", "strategy"]
        if keys == ["strategy"]:
            whole = own[own["share"] == "100 %"].set_index("strategy")["ratio"]
            own = own.sort_values("strategy", key=lambda names, whole=whole: names.map(whole), kind="stable")
        lines = [
            [*map(str, key), *(ratio_text(row.ratio, row.low, row.high) for row in rows.itertuples())]
            for key, rows in own.groupby(keys, sort=False)
        ]
        found[title] = aligned_table([*keys, *dict.fromkeys(own["share"])], lines, left=keys)
    return found


def coverage_text(table: pd.DataFrame) -> str:
    """Format `at_coverage` as Markdown with titles."""
    return "\n".join(f"{title}:\n\n{text}" for title, text in coverage_tables(table).items())
