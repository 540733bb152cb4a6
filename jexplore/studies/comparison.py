"""A comparison made: strategies in worlds, all from the same starts."""

import dataclasses
import datetime
import functools
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from jexplore.config import InputError, checked_names, require_engine
from jexplore.exploration.batch import Job
from jexplore.exploration.team.jobs import CoordinationLike
from jexplore.exploration.team.team import Starts
from jexplore.exploration.trail import RECORDS
from jexplore.report.ledger import open_ledger
from jexplore.studies import checks
from jexplore.studies.metrics import MetricsLike
from jexplore.studies.results import loading, provenance, saving
from jexplore.studies.results.comparison import ComparisonResult, run_comparison
from jexplore.studies.results.progress import progress_bar
from jexplore.studies.results.units import cut_jobs
from jexplore.worlds.restrict import KnownMap, Polygon


@checked_names
def compare(
    worlds: checks.WorldLike | Iterable[checks.WorldLike],
    strategies: checks.StrategyLike | Iterable[checks.StrategyLike], *, episodes: int = 20, seed: int = 0,
    cell_m: float = 0.1, start: checks.StartLike = "random", start_m: Sequence[float] | None = None,
    within: str | Polygon | None = None, from_map: KnownMap | None = None, lidar: checks.LidarLike = checks.LIDAR,
    rules: checks.RulesLike = checks.RULES, robot: checks.RobotLike = checks.ROBOT, pose: str | None = None,
    odometry: checks.OdometryLike = None, robots: int | Sequence[int] | None = None,
    coordination: CoordinationLike = "independent", contact: str = "all", team_starts: Starts = "together",
    members: str | Sequence[str] = (), engine: str = "auto", lanes: int | None = None, workers: int | None = None,
    on_progress: Callable[[int], object] | None = None, progress: bool | None = None, keep: str | None = None,
    metrics: MetricsLike = None, out: str | os.PathLike[str] | None = None,
    overwrite: bool = False, resume: bool = False, trust: bool = False,
) -> ComparisonResult:  # fmt: skip
    """Run every strategy in every world, from the same starts. An interruption keeps finished units.

    Args:
      worlds: one or several names (`worlds.load_world`) or `World`s.
      strategies: names, functions of the view, constructors, `Policy`s (`policies.strategy`); the others are compared
        with the first.
      episodes: of each strategy in each world. More episodes leave the earlier ones as they were.
      seed: of starts and draws.
      cell_m: edge of a cell of the worlds that are loaded by name, metres.
      start: "random"; "world" for every world's own; `(row, col, heading_deg)` or a text as of `--start` for all.
      start_m: such a start in metres of the map's frame instead: `(x_m, y_m, yaw_deg)`.
      within: region that robots stay in, corners in metres: see `restrict.stay_within`.
      from_map: partial map that they have from the beginning: see `restrict.with_known`.
      lidar, rules, robot: `Lidar`, `Rules`, `Robot`, or mappings of the fields that are not default: `{"range_m": 4}`.
      pose, odometry: those of the rules, if given.
      robots: sizes of teams, 1 to 16, each compared with the first; see `team.environment`.
      coordination: one or several of independent, greedy, hungarian, minpos, voronoi, segments; your own functions.
      contact, members, team_starts: see `team.read_contact`, `read_members`, `starts.place_team`.
      engine: "auto", native code where it can and JAX for the rest; "jax", JAX alone. Results are equal.
      lanes, workers: episodes at a time on each GPU, with "jax"; threads on a CPU. By default as many as fit.
      on_progress, progress: called with the number of episodes finished; whether a bar shows it, as in notebooks.
      keep: "paths" for the way of every episode, 12 bytes a step, "maps" for its last map as well, a byte a cell.
      metrics: columns of your own: name -> function of an `EpisodeView`, see `metric`, or "module:function".
      out: folder to write, see `ComparisonResult.save`. Finished episodes are stored on the way.
      overwrite, resume: replace a run in the folder; continue it, if there is any.
      trust: when continuing, take your own strategies and metrics as unchanged even if that cannot be checked.

    Raises:
      InputWarning: as `batch.run_jobs`.
    """
    require_engine(engine, lanes)
    _require_setup(keep, out, overwrite, resume, robots)
    settings = {"episodes": episodes, "seed": seed, "cell_m": cell_m, "start": start, "start_m": start_m}
    settings |= {"within": within, "from_map": from_map, "lidar": lidar, "rules": rules, "robot": robot}
    team = {"robots": robots, "coordination": coordination, "contact": contact, "team_starts": team_starts}
    more = {"members": members, "metrics": metrics, "pose": pose, "odometry": odometry}
    jobs = checks.prepare_jobs(worlds, strategies, **settings, **team, **more)
    how = {"engine": engine, "lanes": lanes, "workers": workers, "keep": keep}
    with progress_bar(progress, sum(len(job.starts) for job in jobs), "episodes", on_progress) as moved:
        run = functools.partial(_run, jobs, settings, how, on_progress=moved)
        if out is None:
            return run()
        with saving.claimed_by_call(out, overwrite=overwrite, resume=resume) as folder:
            return _run_in_folder(folder, run, jobs, _asked(jobs, how), resume=resume, trust=trust)


def _run_in_folder(folder, run, jobs, asked, **how):
    """Run a comparison with a folder that keeps its units and finally holds it."""
    ledger = open_ledger(folder, asked, lambda after: len(cut_jobs(jobs, after)), **how)
    if ledger is None:
        return dataclasses.replace(loading.load(folder.path), jobs=tuple(jobs))
    found = run(ledger=ledger)
    saving.write_comparison(folder, found)
    return found


def _require_setup(keep: str | None, out: object, overwrite: bool, resume: bool, robots: object) -> None:
    """Refuse what does not go together."""
    if keep is not None and robots is not None:
        raise InputError("ways and maps are kept of one robot: leave out keep or robots")
    if keep is not None and keep not in tuple(RECORDS):
        raise InputError(f"keep must be None, {' or '.join(RECORDS)}, got {keep!r}")
    if overwrite and resume:
        raise InputError("resume goes on with a run and overwrite replaces it: give one of them")
    if out is None and (overwrite or resume):
        raise InputError("overwrite and resume are for a folder: name it with out")


def _asked(jobs: Sequence[Job], how: Mapping[str, Any]) -> dict[str, Any]:
    """Return all that results depend on, for a ledger."""
    return {"command": "compare", **provenance.asked(jobs, how["keep"]), "bound_seconds": None}


def _run(jobs: Sequence[Job], settings: Mapping[str, Any], how: Mapping[str, Any], **more: Any) -> ComparisonResult:
    """Run a comparison, and record how it was run."""
    began = datetime.datetime.now(datetime.UTC)
    found = run_comparison(jobs, **how, **more)
    wall_s = (datetime.datetime.now(datetime.UTC) - began).total_seconds()
    asked, from_map = _asked(jobs, how), settings["from_map"]
    given = {name: asked[name] for name in ("worlds", "strategies")} | dict(settings) | dict(how)
    given |= {name: getattr(jobs[0], name) for name in ("lidar", "rules", "robot")}
    if not (from_map is None or isinstance(from_map, (str, os.PathLike))):
        given["from_map"] = type(from_map).__name__  # an array
    record = {"command": ["jx", "compare"], "started": began, "wall_s": wall_s, "configuration": given, **found.record}
    return dataclasses.replace(found, record={**record, "asked": asked, "units": len(cut_jobs(jobs))})
