"""Effect of drift on a trace map, and on the grid map drawn from the same odometry."""

import dataclasses
import os
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from parts.drift import figure as plots
from parts.drift.odometry_map import OdometryMap, occupied_centres, odometry_map

from jexplore.config import InputError, as_record
from jexplore.driving.batch import Driven
from jexplore.driving.settings import Noise, Robot, Tuning
from jexplore.engine.backend import use_compilation_cache
from jexplore.studies.traces.job import NOISE, TraceJob, prepare_trace
from jexplore.studies.traces.recording import scans_of, wall_lines
from jexplore.studies.traces.tracing import trace_table
from jexplore.tracemap.record import BtmMap
from jexplore.worlds.world import World

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AXES: dict[str, tuple[float, ...]] = {
    "length_scale": (0.9, 0.95, 1.0, 1.05, 1.1),
    "turn_scale": (0.8, 0.9, 1.0, 1.1, 1.2),
    "heading_bias_deg_m": (0.0, 1.0, 3.0, 6.0, 10.0),
    "heading_deg_sqrt_m": (0.5, 2.0, 5.0, 10.0, 20.0),
    "slip": (0.02, 0.1, 0.2, 0.3, 0.4),
}
"""Errors of the odometry, fields of `Noise` -> the values of each that are tried."""
RANGE_NOISE_M = 0.01  # range noise of a study, by default
SCAN_EVERY = 10  # steps between two scans that are drawn


@dataclasses.dataclass(frozen=True)
class Example:
    """A run whose map is true, and whose grid map is the worst of those."""

    errors: dict[str, float]
    """Those errors of its odometry that are not the study's own."""
    run: int
    map: BtmMap
    """As it was written."""
    placed: BtmMap
    """The same with nodes where they truly lie, and bearings as they truly are."""
    drawn: OdometryMap


@dataclasses.dataclass(frozen=True)
class DriftResult:
    """Result of `drift`."""

    plan: TraceJob
    axes: dict[str, list[float]]
    """Name of an error -> its values, rising, with that of the study."""
    runs: pd.DataFrame
    """A row a run: the columns of a trace's table; the errors; `node_error_m`, mean distance of the map's nodes from
    where they truly lie; `on_wall` and `doubled` of the grid map, see `OdometryMap`."""
    example: Example | None
    """None where no map was true."""

    @property
    def summary(self) -> pd.DataFrame:
        return summarised(self.runs, self.axes, self.plan.noise)

    def figure(self) -> "Figure":
        """Draw the three measures over every error; below the example: its grid map, and its map on the true plan."""
        if (one := self.example) is None:
            return plots.drift_figure(self.summary, None)
        errors = [f"{plots.ERROR_NAMES.get(name, name)} {value:g}" for name, value in one.errors.items()]
        pictures = plots.Pictures(
            title=", ".join(errors) or "no further error",
            walls=wall_lines(self.plan),
            cells=occupied_centres(one.drawn.map),
            cell_m=one.drawn.map.cell_m,
            map=one.map,
            placed=one.placed,
        )
        return plots.drift_figure(self.summary, pictures)


def drift(
    world: str | os.PathLike[str] | World = "course", *,
    axes: Mapping[str, Sequence[float]] | None = None, runs: int = 8, seed: int = 0,
    noise: Noise | Mapping[str, Any] | None = None, tuning: Tuning | Mapping[str, Any] | None = None,
    robot: str | Robot = "kamui", max_steps: int | None = None,
    workers: int | None = None, on_progress: Callable[[int], Any] = lambda done: None,
) -> DriftResult:  # fmt: skip
    """Let a robot write its map with one kind of odometry error after the other, and draw its grid map.

    The grid map is drawn from the scans of the same run, each placed at the estimated pose: by encoders, matched scans
    and nodes met again, as in the trace map. All runs are one batch of one compiled program.

    Args:
      world: name or `World`. Structure is judged if a true map exists, as for a course.
      axes: names of errors, fields of `Noise`, and their values; by default `AXES`. Each varies alone.
      runs: of every value; run i draws alike with all of them.
      noise: `Noise` of the constant errors, or a mapping of some of its fields; by default 1 cm of range noise.
      robot, seed, tuning, max_steps: see `prepare_trace`; the grid map has cells as large as the world's.
      workers: see `runner.find_resources`.
      on_progress: called with the number of finished runs.

    Returns:
      `DriftResult`. After Ctrl-C it holds what was finished.

    Raises:
      InputError: no such error, no value, or one out of range; else as `prepare_trace`.
    """
    noise = as_record("noise", noise or Noise(range_m=RANGE_NOISE_M), Noise)
    how = {"robot": robot, "runs": runs, "seed": seed, "max_steps": max_steps, "perception": "triangles"}
    plan = prepare_trace(world, noise=noise, tuning=tuning, **how)
    values, swept = _settings(AXES if axes is None else axes, noise)
    plan = dataclasses.replace(plan, swept=swept, settings=len(next(iter(swept.values()))))
    use_compilation_cache()
    # Run 0 of every value, then run 1 of every value: one that is interrupted has some of all.
    settings = np.tile(np.arange(plan.settings), plan.runs)
    which = np.repeat(np.arange(plan.runs, dtype=np.int32), plan.settings)
    rows, examples = {}, []

    def put(i, result, way):
        rows[i], example = _row(plan, result, way, settings[i : i + 1], which[i : i + 1])
        examples.extend([example] if example else [])
        examples[:] = sorted(examples, key=_rank, reverse=True)[:1]  # of equal ones the first
        on_progress(len(rows))

    costs = plan.run(
        settings, which, blocks=[(i, 1) for i in range(len(which))], on_block=put, ways=True, workers=workers
    ).costs
    if costs.interrupted and not rows:
        raise KeyboardInterrupt
    table = pd.concat([rows[i] for i in sorted(rows)]).sort_values(["setting", "run"], ignore_index=True)
    return DriftResult(plan, values, table, examples[0] if examples else None)


def _settings(axes, noise):
    """Return values of every error, and the swept settings: setting 0 is the study's own noise."""
    fields = {field.name for field in dataclasses.fields(Noise)}
    if not axes:
        raise InputError("axes must name an error or more, got none")
    values, rows = {}, [{}]
    for name, given in axes.items():
        if name not in fields:
            raise InputError(f"axes must be errors of jx.btm.Noise, {', '.join(sorted(fields))}, got {name!r}")
        own = float(getattr(noise, name))
        if not len(given):
            raise InputError(f"axes: {name} must have a value or more, got none")
        for value in given:
            dataclasses.replace(noise, **{name: float(value)})  # refused where out of range
        values[name] = sorted({own, *map(float, given)})
        rows += [{name: value} for value in values[name] if value != own]
    return values, {f"{NOISE}{name}": np.array([row.get(name, getattr(noise, name)) for row in rows]) for name in axes}


def _row(plan, result, way, setting, run):
    """Return the row of a run, and an `Example` if its map is true; `result`, `setting` and `run` have an axis of 1."""
    errors = {name: float(values[setting[0]]) for name, values in plan.swept.items()}
    row, (found,) = trace_table(plan, result, setting, run, errors)
    log = scans_of(plan, way, setting=int(setting[0]), run=int(run[0]), every=SCAN_EVERY)
    drawn = odometry_map(log, plan.world, cell_m=plan.world.cell_m)
    placed = placed_truly(found, result.node_at[0] + np.asarray(plan.world.origin_m), way, plan.world.origin_m)
    off_m = [np.hypot(a.x_m - b.x_m, a.y_m - b.y_m) for a, b in zip(found.nodes, placed.nodes)]
    row = row.assign(node_error_m=float(np.mean(off_m)), on_wall=drawn.on_wall, doubled=drawn.doubled)
    if not row["true"].fillna(False).iloc[0]:
        return row, None
    other = {name.removeprefix(NOISE): v for name, v in errors.items() if v != plan.swept[name][0]}
    return row, Example(other, int(run[0]), found, placed, drawn)


def _rank(example):
    """Return how bad the grid map of an example is."""
    return np.nan_to_num(example.drawn.doubled), -np.nan_to_num(example.drawn.on_wall, nan=1.0)


def placed_truly(btm: BtmMap, node_at: np.ndarray, way: Driven, origin_m: tuple[float, float] = (0.0, 0.0)) -> BtmMap:
    """Move the nodes of a run's map, and turn its bearings, to their true ones: as seen from the robot's true pose.

    `node_at` is `[N, 2]`, true positions of the robot when it made each node, metres, in the world's frame.
    """
    turns, nodes, origin = {}, [], np.array([*origin_m, 0.0])
    for node, at in zip(btm.nodes, node_at):
        step = int(np.argmin(np.hypot(*(way.truth[:, :2] + origin[:2] - at).T)))
        true, own = (np.asarray(poses[step]) + origin for poses in (way.truth, way.estimate))
        turn = true[2] - own[2]
        dx, dy = node.x_m - own[0], node.y_m - own[1]
        x_m = true[0] + np.cos(turn) * dx - np.sin(turn) * dy
        y_m = true[1] + np.sin(turn) * dx + np.cos(turn) * dy
        turns[node.id] = float(np.degrees(turn))
        nodes.append(dataclasses.replace(node, x_m=float(x_m), y_m=float(y_m)))
    links = []
    for link in btm.links:
        end = None if link.end_bearing_deg is None else link.end_bearing_deg + turns[link.end]
        start = link.start_bearing_deg + turns[link.start]
        links.append(dataclasses.replace(link, start_bearing_deg=start, end_bearing_deg=end))
    return dataclasses.replace(btm, nodes=tuple(nodes), links=tuple(links))


def summarised(runs: Any, axes: Mapping[str, Sequence[float]], noise: Noise) -> pd.DataFrame:
    """Tabulate `DriftResult.runs`, a row for every error and value of `DriftResult.axes`; `noise` is the study's own.

    Returns:
      Columns `error`, `value`, `n` runs; `true`, the share whose map has the true structure, with its 95 % Wilson
      interval `true_low`, `true_high` (NaN without a truth); of `node_error_m`, `on_wall` and `doubled` the median, and
      the quartiles as `..._low`, `..._high`. Values without a run are left out.
    """
    from scipy.stats import binomtest

    rows = []
    for name, values in axes.items():
        others = [f"{NOISE}{other}" for other in axes if other != name]
        alone = np.all([runs[other] == getattr(noise, other.removeprefix(NOISE)) for other in others], axis=0)
        for value in values:
            some = runs[alone & (runs[f"{NOISE}{name}"] == value)]
            if not len(some):
                continue
            known = some["true"].dropna()
            row: dict[str, Any] = {"error": name, "value": value, "n": len(some), "true": np.nan}
            row |= {"true_low": np.nan, "true_high": np.nan}
            if len(known):
                low, high = binomtest(int(known.sum()), len(known)).proportion_ci(method="wilson")
                row |= {"true": float(known.astype(float).mean()), "true_low": low, "true_high": high}
            for measure in ("node_error_m", "on_wall", "doubled"):
                low, median, high = np.nanquantile(some[measure], [0.25, 0.5, 0.75])
                row |= {measure: median, f"{measure}_low": low, f"{measure}_high": high}
            rows.append(row)
    return pd.DataFrame(rows)
