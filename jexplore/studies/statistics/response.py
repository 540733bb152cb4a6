"""Paths as functions of settings: means at every value of a setting."""

import math
from typing import Any

import numpy as np
import pandas as pd

from jexplore.config import InputError, unknown
from jexplore.studies.statistics.over_worlds import ALL_WORLDS, kind_of, mean_over_worlds
from jexplore.studies.statistics.paired import mean_interval

SHARED = ("seed", "cell_m")
"""Settings without a dot in their name."""
BINS = 12
"""Parts into which a setting of more than twice as many values is cut."""
MOST_PANELS = 6
"""With more worlds than this, their means are shown instead of each."""


def setting_columns(episodes: pd.DataFrame) -> list[str]:
    """Return the setting columns of a table of episodes: those with a dot in their name, `seed` and `cell_m`."""
    return [name for name in map(str, episodes.columns) if "." in name or name in SHARED]


def _cut(table, name):
    """Bin a setting of many values, as of random draws, into parts of equally many, each at the mean of its values."""
    column = table[name]
    if column.dtype.kind not in "iuf" or column.nunique() <= 2 * BINS:
        return table
    values = pd.Series(np.sort(column.unique()).astype(np.float64))
    means = values.groupby(pd.qcut(values, BINS, labels=False)).transform("mean")
    return table.assign(**{name: column.astype(np.float64).map(dict(zip(values, means)))})


def response(episodes: pd.DataFrame, setting: str, *, over_worlds: bool | None = None) -> pd.DataFrame:
    """Estimate the mean path with its interval at every value of a setting.

    In one world the sample are its starts, episodes of one number and seed, each with its mean over all other settings:
    intervals by `mean_interval`. Over worlds it is the worlds' means, by `mean_over_worlds`.

    Args:
      episodes: a table of episodes with settings as columns, such as `lidar.range_m`.
      setting: one of the columns, of more than 24 numbers in `BINS` parts. Rows without it (another strategy's
        parameter) are left out.
      over_worlds: give the mean over worlds instead of every world; by default with more than `MOST_PANELS`.

    Returns:
      A DataFrame: `world` (`over_worlds.ALL_WORLDS` for the mean over them), `strategy`, the setting under its name,
        `n` starts or worlds, `estimate`, `low`, `high`; in order of first appearance, the setting rising.
    """
    if setting not in episodes.columns:
        raise unknown("column of the episodes:", str(setting), list(map(str, episodes.columns)))
    table: Any = episodes[episodes[setting].notna()]
    if not len(table):
        raise InputError(f"{setting} must be set in some episodes, got none")
    table = _cut(table, setting)
    worlds, strategies = list(dict.fromkeys(table["world"])), list(dict.fromkeys(episodes["strategy"]))
    over_worlds = len(worlds) > MOST_PANELS if over_worlds is None else over_worlds
    rows = []
    for key, some in table.groupby([*([] if over_worlds else ["world"]), "strategy", setting], sort=False):
        rows.append((*([ALL_WORLDS] if over_worlds else []), *key, *(_over_worlds if over_worlds else _in_world)(some)))
    found = pd.DataFrame(rows, columns=["world", "strategy", setting, "n", "estimate", "low", "high"])
    places: Any = found["strategy"].map(strategies.index), found["world"].map([*dict.fromkeys(found["world"])].index)
    return found.iloc[np.lexsort([pd.factorize(found[setting], sort=True)[0], *places])].reset_index(drop=True)


def _in_world(rows):
    """Return `(n, estimate, low, high)` of the starts of one world, strategy and setting."""
    values = rows.groupby(["episode", *(["seed"] if "seed" in rows else [])])["path_m"].mean().to_numpy()
    return len(values), float(values.mean()), *mean_interval(values)


def _over_worlds(rows):
    """Return `(n, estimate, low, high)` of the worlds of one strategy and setting."""
    means = rows.groupby("world", sort=False)["path_m"].mean()
    mean, low, high, _ = mean_over_worlds(means, [kind_of(world) for world in means.index])
    return len(means), mean, max(low, 0.0) if math.isfinite(low) else low, high
