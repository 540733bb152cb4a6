"""Pictures of tables of episodes: estimated here, drawn by `report.plots`."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from jexplore.config import InputError
from jexplore.report.plots import compare, curves
from jexplore.report.plots.compare import ComparisonPanel, Estimates
from jexplore.studies.statistics.by_world import DONE, summarise
from jexplore.studies.statistics.league import paths_by_world, standings
from jexplore.studies.statistics.over_worlds import ALL_WORLDS
from jexplore.studies.statistics.paired import MIN_PAIRS
from jexplore.studies.statistics.response import response, setting_columns

MOST_WORLDS = 12
"""With more worlds than this, a picture of a comparison shows all of them together only."""
MOST_CURVES = 7
"""Most of the best strategies in a picture of curves over many worlds; the reference is in it always."""


def compare_figure(
    episodes: pd.DataFrame, *, summary: pd.DataFrame | None = None, table: pd.DataFrame | None = None
) -> Figure:
    """Draw every episode's path with means, intervals and paired ratios: a panel a world, and one for six or more.

    `summary` and `table` are those of `summarise` and `standings` if they are there already. With more than
    `MOST_WORLDS` worlds the picture has the panel of all of them only.
    """
    if not len(episodes):
        raise InputError("episodes must be one or more to be drawn, got none")
    strategies, worlds = (list(dict.fromkeys(episodes[key])) for key in ("strategy", "world"))
    panels = []
    if len(worlds) >= MIN_PAIRS:
        table = standings(episodes) if table is None else table
        panels += [_over_worlds(episodes, table, strategies)] if max(table["worlds"], default=0) >= MIN_PAIRS else []
    if len(worlds) <= MOST_WORLDS or not panels:
        summary = summarise(episodes) if summary is None else summary
        panels += [_in_world(world, episodes, summary, strategies) for world in worlds[:MOST_WORLDS]]
    return compare.comparison_figure(panels, strategies)


def draw_world(ax: Any, episodes: pd.DataFrame, summary: pd.DataFrame, world: str) -> list[Any]:
    """Draw the path lengths of one world as points, with means and intervals from `summarise`.

    Returns one `ErrorbarContainer` a strategy.
    """
    strategies = list(dict.fromkeys(episodes["strategy"][episodes["world"] == world]))
    return compare.draw_panel(ax, _in_world(world, episodes, summary, strategies), strategies)


def _estimates(table, strategies, *columns, scale=1.0):
    """Return three columns of a table as `Estimates` in the order of strategies, NaN for a missing one."""
    rows = table.set_index("strategy").reindex(strategies)
    return Estimates(*(scale * rows[name].to_numpy(np.float64) for name in columns))


def _in_world(world, episodes, summary, strategies):
    own, rows = episodes[episodes["world"] == world], summary[summary["world"] == world]
    parts = [own[own["strategy"] == name] for name in strategies]
    return ComparisonPanel(
        title=str(world),
        label="path length (m)",
        points=[part["path_m"].to_numpy(np.float64) for part in parts],
        ended_well=[part["outcome"].isin(DONE).to_numpy(bool) for part in parts],
        means=_estimates(rows, strategies, "mean", "ci_low", "ci_high"),
        shares=False,
        ratio_points=[np.zeros(0)] * len(parts),
        ratios=_estimates(rows, strategies, "ratio", "ratio_low", "ratio_high"),
    )


def _over_worlds(episodes, table, strategies):
    ratios: Any = paths_by_world(episodes)
    own = [np.exp(ratios["log_ratio"][ratios["strategy"] == name].to_numpy(np.float64)) for name in strategies]
    own[0] = own[0][:0]  # the reference relative to itself
    n = int(table["worlds"].max())
    return ComparisonPanel(
        title=f"over {n} worlds, which count the same",
        label=f"starts with a shorter path than {strategies[0]} (%)",
        points=[np.zeros(0)] * len(strategies),
        ended_well=[np.zeros(0, bool)] * len(strategies),
        means=_estimates(table, strategies, "shorter", "shorter_low", "shorter_high", scale=100.0),
        shares=True,
        ratio_points=own,
        ratios=_estimates(table, strategies, "ratio", "ratio_low", "ratio_high"),
    )


def coverage_figure(progress: Mapping[tuple[str, str], np.ndarray]) -> Figure:
    """Draw the known part of the knowable share along the path, one panel a world: medians and quartile bands.

    `progress` is `ComparisonResult.progress`, metres; `MOST_WORLDS` worlds are shown.
    """
    worlds = list(dict.fromkeys(world for world, _ in progress))[:MOST_WORLDS]
    if not worlds:
        raise InputError("progress must be of one world or more to be drawn, got none")
    entries = [(str(one), {name: rows for (world, name), rows in progress.items() if world == one}) for one in worlds]
    return curves.coverage_curves_figure(entries)


def league_coverage_figure(
    episodes: pd.DataFrame, progress: Mapping[tuple[str, str], np.ndarray], table: pd.DataFrame
) -> Figure:
    """Draw the known share over all worlds, along paths as multiples of the first strategy's whole path there.

    `progress` as of `coverage_figure`, in the order of the rows of `episodes`; the `MOST_CURVES` best of `table`, from
    `league.standings`, are shown, and the first strategy.
    """
    reference = str(episodes["strategy"].iloc[0])
    whole_m = episodes[episodes["strategy"] == reference].set_index(["world", "episode"])["path_m"]
    best = list(dict.fromkeys([reference, *table["strategy"][:MOST_CURVES]]))
    parts: dict[str, list[np.ndarray]] = {name: [] for name in best}
    shown: Any = episodes[episodes["strategy"].isin(best)]
    for (world, strategy), rows in shown.groupby(["world", "strategy"], sort=False):
        own_m = np.array([whole_m.get((world, episode), 0.0) for episode in rows["episode"]])
        parts[str(strategy)].append(progress[world, strategy][own_m > 0] / own_m[own_m > 0, None])
    found = {name: np.concatenate(own) for name, own in parts.items() if own}
    title = f"over {episodes['world'].nunique()} worlds: medians over all starts, and quartiles"
    return curves.coverage_curves_figure([(title, found)], label=f"path length over the whole one of {reference}")


def response_figure(episodes: pd.DataFrame, setting: str, *, over_worlds: bool | None = None) -> Figure:
    """Draw the mean path over one setting, a line a strategy and a panel a world; arguments of `response.response`."""
    table = response(episodes, setting, over_worlds=over_worlds)
    varied = [name for name in setting_columns(episodes) if name != setting and len(set(episodes[name])) > 1]
    what = "worlds" if ALL_WORLDS in set(table["world"]) else "starts"
    averaged = f"means over {table['n'].max()} {what}" + (f" and all values of {', '.join(varied)}" if varied else "")
    return curves.response_curves_figure(table, setting, averaged=f"{averaged}, with 95 % intervals")
