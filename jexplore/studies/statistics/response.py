"""Paths as functions of settings: means or paired ratios at every value of one setting, or of two."""

import difflib
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from jexplore.config import InputError
from jexplore.studies.statistics.over_worlds import ALL_WORLDS, kind_of, mean_over_worlds, ratio_over_worlds
from jexplore.studies.statistics.paired import mean_interval, paired_ratio

SHARED = ("seed", "cell_m")
"""Settings without a dot in their name."""
BINS = 12
"""Parts into which a setting of more than twice as many values is cut."""
MOST_PANELS = 6
"""With more worlds than this, their means are shown instead of each."""


def setting_columns(episodes: pd.DataFrame) -> list[str]:
    """Return the setting columns of a table of episodes: those with a dot in their name, `seed` and `cell_m`."""
    return [name for name in map(str, episodes.columns) if "." in name or name in SHARED]


def require_column(episodes: pd.DataFrame, name: str, what: str) -> None:
    """Refuse a column that a table does not have; say which is near."""
    if name not in episodes.columns:
        near = difflib.get_close_matches(str(name), map(str, episodes.columns), 1)
        raise InputError(
            f"{what} must be a column of the episodes{f', such as {near[0]}' if near else ''}, got {name!r}"
        )


def _numbers(episodes, name):
    """Return a column of measured numbers as float64, NaN where missing."""
    require_column(episodes, name, "value")
    try:
        return episodes[name].astype("Float64").to_numpy(dtype=np.float64, na_value=np.nan)
    except (TypeError, ValueError):
        raise InputError(f"value must be a column of numbers, got {name!r}") from None


def _cut(table, own, bins):
    """Bin settings of many values, as of random draws, into parts of equally many, each at the mean of its values."""
    draws = len(table[own].drop_duplicates())
    is_grid = math.prod(table[name].nunique() for name in own) <= 4 * draws or draws <= 2 * BINS
    bins = bins or (BINS if len(own) == 1 else math.ceil(math.sqrt(draws) / 2))
    found = {}
    for name in own:
        column = table[name]
        if column.dtype.kind in "iuf" and column.nunique() > max(2 * BINS if is_grid else 2 * bins, bins):
            values = np.sort(column.unique()).astype(np.float64)
            parts = np.array_split(values, bins)
            means = np.repeat(_rounded([part.mean() for part in parts]), [len(part) for part in parts])
            found[name] = column.astype(np.float64).map(dict(zip(values.tolist(), means.tolist())))
    return table.assign(**found)


def _rounded(means):
    """Round rising numbers to as few digits, three or more, as keep them distinct."""
    for digits in range(3, 17):
        short = [float(f"{mean:.{digits}g}") for mean in means]
        if len(set(short)) == len(means):
            return short
    return means


def _with_reference(table):
    """Add to every value that of the first strategy in the same world, episode and settings.

    Settings that some strategy does not have, being parameters of another, are not compared.
    """
    keys = [name for name in setting_columns(table) if table[name].groupby(table["strategy"]).count().min() > 0]
    keys = ["world", "episode", *keys]
    first = table["strategy"].iloc[0]
    reference = table.loc[(table["strategy"] == first).to_numpy(), [*keys, "value"]]
    twice = reference.duplicated(keys).to_numpy()
    if twice.any():
        where = ", ".join(f"{key} {reference[key][twice].iloc[0]}" for key in keys)
        raise InputError(f"{first} must have an episode once in each setting, got it more than once at {where}")
    return table.merge(reference.rename(columns={"value": "reference"}), on=keys, how="inner", validate="m:1")


def response(
    episodes: pd.DataFrame, settings: str | Sequence[str], *, value: str = "path_m", ratio: bool = False,
    over_worlds: bool | None = None, bins: int | None = None,
) -> pd.DataFrame:  # fmt: skip
    """Estimate a mean, or a paired ratio to the first strategy, with its interval, at every value of a setting or two.

    In one world the sample are its starts, episodes of one number and seed, each with its mean over all other settings:
    intervals by `mean_interval` and `paired_ratio`. Over worlds it is the worlds' means or logarithms of ratios, by
    `mean_over_worlds`.

    Args:
      episodes: a table of episodes with settings as columns, such as `lidar.range_m`. A row is paired with that of the
        first strategy in the same world, episode and settings.
      settings: one of the columns, or two. Rows without it (another strategy's parameter) are left out.
      value: the column that is averaged; rows without it are left out.
      ratio: give ratios to the first strategy of the table instead of means.
      over_worlds: give the mean over worlds instead of every world; by default with more than `MOST_PANELS`.
      bins: number of bins, with equal numbers of values, of a setting with more than 24 values, or of two that are
        drawn at random; by default 12, or, for two settings, a number that puts about four draws into each bin.

    Returns:
      A DataFrame: `world` (`over_worlds.ALL_WORLDS` for the mean over them), `strategy`, the settings under their
        names, `n` starts or worlds, `estimate`, `low`, `high`; in order of first appearance, settings rising.
    """
    own = [settings] if isinstance(settings, str) else list(settings)
    for name in own:
        require_column(episodes, name, "setting")
    table: Any = episodes.assign(value=_numbers(episodes, value))
    table = table[np.isfinite(table["value"])]
    table = _with_reference(table) if ratio and len(table) else table.assign(reference=1.0)
    table = table[table[own].notna().all(axis=1)]
    table = _cut(table, own, bins)
    if not len(table):
        raise InputError(f"{' and '.join(own)} must be set in some episodes that have a {value}, got none")
    worlds = list(dict.fromkeys(table["world"]))
    over_worlds = len(worlds) > MOST_PANELS if over_worlds is None else over_worlds
    rows = []
    by = ["strategy", *own] if over_worlds else ["world", "strategy", *own]
    for key, some in table.groupby(by, sort=False):
        estimate = _over_worlds(some, ratio) if over_worlds else _in_world(some, ratio)
        rows.append((*([ALL_WORLDS] if over_worlds else []), *key, *estimate))
    found = pd.DataFrame(rows, columns=["world", "strategy", *own, "n", "estimate", "low", "high"])
    order: Any = [found["world"].map(list(dict.fromkeys(found["world"])).index)]
    order += [found["strategy"].map(list(dict.fromkeys(episodes["strategy"])).index), *(found[name] for name in own)]
    return found.iloc[np.lexsort([pd.factorize(one, sort=True)[0] for one in reversed(order)])].reset_index(drop=True)


def _in_world(rows, ratio):
    """Return `(n, estimate, low, high)` of the starts of one world, strategy and setting."""
    starts = rows.groupby(["episode", *(["seed"] if "seed" in rows else [])])[["value", "reference"]].mean()
    values, reference = starts.to_numpy().T
    if not ratio:
        return len(values), float(values.mean()), *mean_interval(values)
    found = paired_ratio(values, reference)
    return found.n, found.ratio, found.low, found.high


def _over_worlds(rows, ratio):
    """Return `(n, estimate, low, high)` of the worlds of one strategy and setting."""
    means = rows.groupby("world", sort=False)[["value", "reference"]].mean()
    if ratio:
        means = means[(means > 0).all(axis=1)]
        found = ratio_over_worlds(np.log(means["value"] / means["reference"]), means.index)
        return found.n, found.ratio, found.low, found.high
    values = (means["value"] / means["reference"]).to_numpy()
    mean, low, high, _ = mean_over_worlds(values, [kind_of(world) for world in means.index])
    return len(values), mean, max(low, 0.0) if math.isfinite(low) else low, high
