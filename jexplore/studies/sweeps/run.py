"""A sweep run, unit by unit, and its results."""

import dataclasses
import functools
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from jexplore.arrays.pictures import shown_figure
from jexplore.config import InputError, checked_names, require_engine
from jexplore.engine.backend import use_compilation_cache
from jexplore.engine.runner import Costs
from jexplore.exploration.uncertain.measures import MEASURES
from jexplore.report.ledger import Ledger
from jexplore.report.store import read_parquet
from jexplore.report.tables import aligned_table, number_text, ratio_text, spread_text
from jexplore.studies.results.columns import TEAM_MEASURES
from jexplore.studies.results.progress import progress_bar
from jexplore.studies.results.tables import ByStrategy
from jexplore.studies.results.units import rows_of, run_units, table_of
from jexplore.studies.statistics.by_world import DONE
from jexplore.studies.statistics.paired import NO_RATIO, finite_ratio
from jexplore.studies.sweeps.plan import SweepPlan, in_shard, prepare_sweep
from jexplore.studies.sweeps.spec import Sweep, read_spec, sweep_from

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN_ROWS = 24  # of the table in a notebook
WINDOW_EPISODES = 8192  # of units that are run together
WINDOW_SITES = 32  # worlds made ready at a time


@checked_names
@dataclasses.dataclass(frozen=True)
class SweepResult(ByStrategy):
    """Result of a sweep. Tables are pandas DataFrames.

    Iterating gives the names of its strategies.
    """

    spec: Sweep
    episodes: pd.DataFrame
    """One row an episode, ordered by setting, world, strategy, episode; columns `columns.COLUMNS`, metrics, settings:
    `setting` (its number), `lidar.range_m`, `strategy.weight`, ..."""
    columns: tuple[str, ...]
    """Names of the columns of settings."""
    costs: Costs
    missing: int = 0
    """Episodes that are missing because the run was interrupted."""
    resumed: int = 0
    """Episodes that an earlier run had finished."""
    reference: str = ""
    """Name of the first strategy, with which the others are compared."""

    @functools.cached_property
    def summary(self) -> pd.DataFrame:
        """Tabulate one row a setting, world and strategy.

        Columns are `n`, `mean` and `sd` of the path, metres, the paired `ratio` to the first strategy with `ratio_low`
        and `ratio_high` (95 %, see `paired.paired_ratio`), mean `explored_fraction`, share `complete`; those of
        settings and metrics.
        """
        measures = (name for name in (*MEASURES, *TEAM_MEASURES[1:]) if name in self.episodes)
        return summarise(self.episodes, self.columns, self.reference, (*self.spec.metrics, *measures))

    def plot(self) -> "Figure":
        """Draw the first of `figures`, as a matplotlib `Figure`: mean paths along the first number that is varied."""
        for make in self.figures().values():
            return shown_figure(make())
        raise InputError("a sweep is drawn along a number that is varied, and this one has none: see to_pandas()")

    def to_markdown(self, rows: int | None = None) -> str:
        """Format the summary as a Markdown table, at most `rows` rows and a line with the number of rows left out."""
        rows = len(self.summary) if rows is None else rows
        left = max(len(self.summary) - rows, 0)
        more = f"\n... and {left:,} more rows: summary.csv, or jx.load(DIR).summary\n" if left else ""
        return summary_table(self.summary.head(rows), self.varied) + more

    @property
    def varied(self) -> list[str]:
        """Return columns of settings that have more than one value."""
        some = [name for name in dict.fromkeys((*self.columns, "seed")) if name != "setting" and name in self.episodes]
        return [name for name in some if len(self.episodes[name].drop_duplicates()) > 1]

    def figures(self) -> dict[str, Callable[[], Any]]:
        """Return pictures of the sweep, of the first varied number: name of a file -> function that draws it."""
        from jexplore.studies.statistics import figures

        first = next((name for name in self.varied if self.episodes[name].dtype.kind in "iuf"), None)
        return {} if first is None else {"sweep.png": lambda: figures.response_figure(self.episodes, first)}

    def _repr_markdown_(self):
        return self.to_markdown(SHOWN_ROWS)

    def __repr__(self) -> str:
        return f"<Sweep of {self.episodes['setting'].nunique()} settings, {len(self.episodes)} episodes>"


def summarise(episodes: pd.DataFrame, columns: Sequence[str], first: str, metrics: Sequence[str] = ()) -> pd.DataFrame:
    """Compute the `SweepResult.summary` of a table of episodes whose settings are in these columns.

    Ratios are to the strategy `first`; NaN where it has no episode, as in a part of a sweep.
    """
    rows, own = [], [name for name in dict.fromkeys((*columns, "seed")) if name != "setting"]
    for pair, group in episodes.groupby(["setting", "world"], sort=False):
        setting, world = pair  # type: ignore[misc]
        reference = group[group["strategy"] == first].set_index("episode")["path_m"]
        for strategy, some in group.groupby("strategy", sort=False):
            path_m = some.set_index("episode")["path_m"]
            ratio = NO_RATIO._replace(ratio=1.0) if strategy == first else finite_ratio(*path_m.align(reference))
            rows.append(
                {
                    **{"setting": setting, "world": world, "strategy": strategy},
                    **{name: some[name].iloc[0] for name in own},
                    **{"n": len(some), "mean": path_m.mean(), "sd": path_m.std(ddof=1)},
                    **{"ratio": ratio.ratio, "ratio_low": ratio.low, "ratio_high": ratio.high},
                    "explored_fraction": some["explored_fraction"].mean(),
                    "complete": some["outcome"].isin(DONE).mean(),
                    **{name: some[name].mean() for name in metrics},
                }
            )
    return pd.DataFrame(rows)


def summary_table(summary: Any, varied: Sequence[str]) -> str:
    """Format rows of `SweepResult.summary` as Markdown."""
    head = ["world", *varied, "strategy", "n", "path m", "ratio to the first", "explored", "COMPLETE"]
    metrics = list(summary)[list(summary).index("complete") + 1 :]
    lines = []
    for _, row in summary.iterrows():
        line = [row["world"], *(_value_text(row[name]) for name in varied), row["strategy"], str(row["n"])]
        line += [spread_text(row["mean"], row["sd"]), ratio_text(row["ratio"], row["ratio_low"], row["ratio_high"])]
        line += [number_text(row["explored_fraction"], 3), f"{100 * row['complete']:.0f}%"]
        lines.append([*line, *(_value_text(row[name]) for name in metrics)])
    return aligned_table([*head, *metrics], lines, left=("world", "strategy"))


def _value_text(value):
    if value is None or value != value:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _windows(plan: SweepPlan, numbers: Sequence[int]) -> Iterator[list[int]]:
    """Yield units that are run together: few enough to fit into the memory."""
    window, sites, episodes = [], set(), 0
    for number in numbers:
        unit = plan.units[number]
        own = {block.job // len(plan.strategies) for block in unit.blocks}
        if window and (episodes + unit.n > WINDOW_EPISODES or len(sites | own) > WINDOW_SITES):
            yield window
            window, sites, episodes = [], set(), 0
        window.append(number)
        sites |= own
        episodes += unit.n
    if window:
        yield window


def _block_table(plan, block, job, found):
    """Return the table of a block: of its job and the outcomes, with the number of the setting and the strategy."""
    name = plan.strategies[block.job % len(plan.strategies)]  # a team's job has a label instead
    own = job._replace(strategy=job.strategy._replace(name=name))
    rows = {"setting": np.full(block.n, plan.setting_of(block.job)), **rows_of(own, found)}
    return table_of(rows | {name: np.full(block.n, np.nan) for name in plan.measures if name not in rows})


def run_sweep(
    plan: SweepPlan, *, ledger: Ledger | None = None, shard: tuple[int, int] | None = None, **how: Any
) -> SweepResult:
    """Run the units of a sweep that the ledger, which stores them as they are finished, does not have.

    With a shard `(i, n)` only every n-th unit, from the i-th on. After Ctrl-C the result holds the units that were
    finished; `KeyboardInterrupt` if none was. `how` are engine, lanes, workers and on_progress, as of `run_units`.
    """
    earlier = []
    if ledger is not None and ledger.after:
        table: Any = read_parquet(ledger.folder.parent / "episodes.parquet")
        earlier, plan = [table[table["episode"] < ledger.after]], dataclasses.replace(plan, after=ledger.after)
    numbers = in_shard(len(plan.units), shard)
    use_compilation_cache()
    own = {"windows": functools.partial(_windows, plan), "shared_with": plan.sharing}
    made = functools.partial(_block_table, plan)
    ran = run_units(plan.jobs, plan.units, numbers, ledger=ledger, earlier=earlier, to_table=made, **own, **how)
    table = whole_table(ran.tables, plan)
    missing = sum(map(len, earlier)) + sum(plan.units[number].n for number in numbers) - len(table)
    return SweepResult(plan.spec, table, tuple(plan.columns), ran.costs, missing, ran.resumed, plan.reference)


def labels_of(settings: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return labels that distinguish settings, a line each."""
    varied = [key for key in settings[0] if len({str(setting[key]) for setting in settings}) > 1]
    return [", ".join(f"{key.rpartition('.')[2]} {_value_text(own[key])}" for key in varied) for own in settings]


def whole_table(tables: Sequence[pd.DataFrame], plan: SweepPlan) -> pd.DataFrame:
    """Join tables of a sweep: rows by setting, world, strategy and episode, as in the spec, with all settings.

    Settings are truth values, whole numbers, numbers (NaN where missing), or text (empty where missing), by what they
    are in the whole sweep.
    """
    table = pd.concat(tables, ignore_index=True)
    strategy, world = (
        pd.Categorical(table[column], list(given)).codes
        for column, given in (("strategy", plan.strategies), ("world", map(os.fspath, plan.spec.worlds)))
    )
    own = [{f"strategy.{key}": value for key, value in one.items()} for one in plan.parameters]
    for rows, places in (([one.values for one in plan.settings], table["setting"]), (own, strategy)):
        for name in (name for name in plan.columns if any(name in row for row in rows)):
            table[name] = _column([row.get(name) for row in rows]).iloc[places].array
    return table.iloc[np.lexsort([table["episode"], strategy, world, table["setting"]])].reset_index(drop=True)


def _column(values):
    """Return values as a column of numbers or truth values if they all are, else of texts."""
    found = pd.Series(values, dtype=None if any(value is not None for value in values) else np.float64)
    return found if found.dtype.kind in "biuf" else pd.Series(["" if v is None else str(v) for v in values])


@checked_names
def sweep(
    spec: Sweep | Mapping[str, Any] | str | os.PathLike[str], *, engine: str = "auto", lanes: int | None = None,
    workers: int | None = None, on_progress: Callable[[int], object] | None = None, progress: bool | None = None,
) -> SweepResult:  # fmt: skip
    """Compare strategies over many settings.

    Args:
      spec: a `Sweep`, a mapping of its fields, or a YAML file. `jexplore sweep` keeps what it finishes; this does not.
      engine, lanes, workers, on_progress: as in `run_sweep`.
      progress: whether a bar shows how much is finished; by default in notebooks.
    """
    require_engine(engine, lanes)
    if isinstance(spec, (str, os.PathLike)):
        spec = read_spec(spec)
    elif isinstance(spec, Mapping):
        spec = sweep_from(spec)
    if not isinstance(spec, Sweep):
        raise InputError(f"a sweep must be a jx.Sweep, a mapping or a YAML file, got {spec!r}")
    how: dict[str, Any] = {"engine": engine, "lanes": lanes, "workers": workers}
    plan = prepare_sweep(spec)
    with progress_bar(progress, plan.episodes, "episodes", on_progress) as moved:
        return run_sweep(plan, **how, on_progress=moved)
