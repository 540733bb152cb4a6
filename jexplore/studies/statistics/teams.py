"""Teams and one robot: times to known shares, speed-up, efficiency."""

from typing import Any, cast

import numpy as np
import pandas as pd

from jexplore.report.tables import aligned_table, number_text, ratio_text
from jexplore.studies.results.columns import TEAM_MEASURES
from jexplore.studies.statistics.by_world import DONE
from jexplore.studies.statistics.over_worlds import ratio_over_worlds
from jexplore.studies.statistics.paired import PairedRatio, finite_ratio

MEANS = "path_m_at_90", "path_m_at_95", "path_m_at_99", *TEAM_MEASURES
TABLE = (
    *("world", "strategy", "coordination", "contact", *MEANS),
    *("speed_up", "speed_up_low", "speed_up_high", "efficiency", "vs_independent", "vs_low", "vs_high"),
)


def _ratio(rows: Any, reference: Any) -> PairedRatio:
    """Return the ratio of the times until all is known, over the episodes that both have completed."""
    ours, theirs = (one[one["outcome"].isin(DONE)].set_index("episode")["path_m_at_100"] for one in (rows, reference))
    return finite_ratio(*ours.align(theirs))


def tabulate(episodes: pd.DataFrame) -> pd.DataFrame:
    """Tabulate one row a world and team, in order of first appearance; then one a team over several worlds, as "all".

    Returns:
      A DataFrame: means of times in metres on the common clock, and of the team's measures; `speed_up`, the mean time
        of one robot by that of the team until all is known, with its interval (`paired_ratio`), and `efficiency`, that
        by the number of robots: NaN without a team of one; `vs_independent`, the team's time by that of as many robots
        without coordination, with its interval. In a world intervals are over starts; over worlds they are by
        `ratio_over_worlds`.
    """
    table = []
    base = [_base(row) for row in episodes[["strategy", "robots", "coordination"]].itertuples(index=False)]
    episodes = episodes.assign(base=base)
    for who, own in episodes.groupby(["world", "strategy"], sort=False):
        (world, strategy), rows = cast(tuple[str, str], who), cast(Any, own)
        first = rows.iloc[0]
        alike = episodes[(episodes["world"] == world) & (episodes["base"] == first["base"])]
        alone = _ratio(rows, alike[alike["robots"] == 1])
        apart = alike[(alike["robots"] == first["robots"]) & (alike["coordination"] == "independent")]
        versus = _ratio(rows, apart)
        means = [float(rows[name].mean()) for name in MEANS]
        up = [1 / value for value in (alone.ratio, alone.high, alone.low)]
        names = world, strategy, first["coordination"], first["contact"]
        table.append((*names, *means, *up, up[0] / first["robots"], versus.ratio, versus.low, versus.high))
    found = pd.DataFrame(table, columns=[*TABLE])
    return found if len(set(found["world"])) < 2 else pd.concat([found, _over_worlds(found)], ignore_index=True)


def _over_worlds(table: Any) -> pd.DataFrame:
    """Return a row a team over all worlds, of those of single ones."""
    rows = []
    for _, own in table.groupby("strategy", sort=False):
        row = {**own.iloc[0], "world": "all", **own[[*MEANS]].mean()}
        for name, low, high in (("speed_up", "speed_up_low", "speed_up_high"), ("vs_independent", "vs_low", "vs_high")):
            some = own[np.isfinite(own[name])]
            row |= dict(zip((name, low, high), ratio_over_worlds(np.log(some[name]), some["world"])))
        rows.append(row | {"efficiency": row["speed_up"] / row["robots"]})
    return pd.DataFrame(rows, columns=[*TABLE])


def _base(row: Any) -> str:
    """Return the strategy of each robot, of a name as `Team.label` makes them."""
    return row.strategy.removeprefix(f"{row.robots} x ").removesuffix(f", {row.coordination}")


def team_table(table: pd.DataFrame) -> str:
    """Format a table of `tabulate` as Markdown."""
    head = ["world", "strategy", *(f"m at {share} %" for share in (90, 95, 99)), "m until all is known", "speed-up"]
    head += ["efficiency", "to independent", "sum of paths m", "overlap", "sd of shares", "waits", "connected"]
    lines = []
    for row in table.to_dict("records"):
        line = [str(row["world"]), str(row["strategy"])]
        line += [number_text(row[f"path_m_at_{share}"], 1) for share in (90, 95, 99, 100)]
        line += [ratio_text(row["speed_up"], row["speed_up_low"], row["speed_up_high"], 2)]
        line += [number_text(row["efficiency"], 2)]
        line += [ratio_text(row["vs_independent"], row["vs_low"], row["vs_high"])]
        line += [number_text(row["path_sum_m"], 1), number_text(row["overlap"], 2), number_text(row["share_sd"], 2)]
        lines.append([*line, number_text(row["waits"], 1), number_text(row["connected"], 2)])
    return aligned_table(head, lines, left=("world", "strategy"))
