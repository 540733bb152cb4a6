"""Provenance of results: the worlds to the bit, the commit of this package."""

import collections
import functools
import hashlib
import importlib.metadata
import json
import os
import subprocess
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jexplore.arrays.padding import bucket
from jexplore.config import __version__
from jexplore.engine.runner import Costs
from jexplore.exploration.batch import Job
from jexplore.exploration.site import prepare_site
from jexplore.exploration.team.coordination import COORDINATIONS
from jexplore.policies.catalogue import adapt
from jexplore.studies.results.columns import TEAM_MEASURES
from jexplore.worlds.world import World, ringed_shape

GIT_S = 5.0  # seconds that git may take


def world_digest(world: World) -> str:
    """Return SHA-256 of everything in a world that an episode depends on, in hexadecimal digits."""
    found = hashlib.sha256(np.float64(world.cell_m).tobytes())
    restrictions = (array for array in (world.within, world.known) if array is not None)
    for array in (world.occupied, world.rooms, world.elevation, world.start, *restrictions):
        some = np.zeros(0) if array is None else np.ascontiguousarray(array)
        found.update(f"{some.dtype.str}{some.shape}".encode())
        found.update(some.tobytes())
    return found.hexdigest()


@functools.cache
def package_commit() -> str | None:
    """Return the commit that this package was installed from; None if unknown.

    It ends in `+changed` if the files have changed since.
    """
    folder = Path(__file__).resolve().parents[3]
    if (folder / ".git").exists():
        try:
            how = {"cwd": folder, "text": True, "timeout": GIT_S, "stderr": subprocess.PIPE}
            commit = subprocess.check_output(["git", "rev-parse", "HEAD"], **how)
            changes = subprocess.check_output(["git", "status", "--porcelain", "--", "jexplore"], **how)
            return commit.strip() + ("+changed" if changes.strip() else "")
        except (OSError, subprocess.SubprocessError):
            return None
    try:
        page = importlib.metadata.distribution("jexplore").read_text("direct_url.json")
        return json.loads(page or "{}").get("vcs_info", {}).get("commit_id")
    except (importlib.metadata.PackageNotFoundError, ValueError):
        return None


def own_digests(jobs: Iterable[Job]) -> dict[str, str | None]:
    """Compute digests of users' metrics and strategies, and of those with weights: their names do not determine them.

    Returns:
      "strategy 'name'" or "metric 'name'" -> SHA-256, in hexadecimal digits, of all parameters and of the traced
      computation in the jobs' worlds; None if unknown, see `computation_digest`.
    """
    parts: dict[str, dict[Any, str | None]] = collections.defaultdict(dict)
    for job in jobs:
        assert job.lidar is not None
        assert job.rules is not None
        if job.team is not None and job.team.coordination is not None and job.team.coordinates not in COORDINATIONS:
            parts[f"coordination {job.team.coordinates!r}"] = {0: None}
        policy, own = job.strategy.policy, f"strategy {job.strategy.name!r}"
        leaves, theirs = jax.tree.leaves(policy.params), adapt.is_theirs(policy)
        if theirs or any(map(np.ndim, leaves)):
            numbers = b"".join(np.ascontiguousarray(leaf).tobytes() for leaf in leaves)
            parts[own]["numbers"] = hashlib.sha256(numbers).hexdigest()
        sides = tuple(bucket(side) for side in ringed_shape(job.world.occupied))
        where = sides, job.world.within is None, job.world.cell_m, job.lidar, job.rules
        names = [*(f"metric {name!r}" for name in job.metrics), *([own] if theirs else ())]
        if not all(where in parts[name] for name in names):
            site = prepare_site(job.world, job.lidar, job.rules, metrics=tuple(job.metrics.values()))
            found = [metric.digest for metric in site.setup.metrics]
            found += [adapt.digest_of(site.with_strategy(job.strategy)[0].policy)] if theirs else []
            for name, digest in zip(names, found):
                parts[name][where] = digest
    told = {name: list(own.values()) for name, own in parts.items()}
    return {name: None if None in own else hashlib.sha256(repr(own).encode()).hexdigest() for name, own in told.items()}


def asked(jobs: Sequence[Job], keep: str | None = None) -> dict[str, Any]:
    """Return all that the results of some jobs depend on, as plain values: equal ones mean equal units.

    The jobs have one number of episodes, one seed, one scanner and the same rules. `keep` as of `compare`.
    """
    worlds, first = {os.fspath(job.world.name): job.world for job in jobs}, jobs[0]
    measured = {name: metric.reduce or "end" for name, metric in first.metrics.items()}
    measured |= {} if first.team is None else dict.fromkeys(TEAM_MEASURES, "end")
    teams = {
        job.strategy.name: {**job.team._asdict(), "coordination": job.team.coordinates} for job in jobs if job.team
    }
    # The first start tells whether starts are drawn, and from where: with more episodes it stays the same.
    starts = hashlib.sha256(b"".join(np.ascontiguousarray(job.starts[0], np.int32).tobytes() for job in jobs))
    return {
        "version": __version__,
        "worlds": list(worlds),
        "strategies": list(dict.fromkeys(job.strategy.name for job in jobs)),
        **{"episodes": len(first.starts), "seed": first.seed, "lidar": first.lidar, "rules": first.rules},
        "robot": first.robot,
        "starts": starts.hexdigest(),
        "digests": {name: world_digest(world) for name, world in worlds.items()},
        "own": own_digests(jobs),
        **({"metrics": measured} if measured else {}),
        **{name: own for name, own in (("teams", teams), ("keep", keep)) if own},
    }


def describe_world(world: World) -> dict[str, Any]:
    """Return a world's entries in a table of worlds."""
    rows, cols = world.shape
    rooms = None if world.rooms is None else int(world.rooms.max()) + 1
    return {
        "world": world.name,
        "rows": rows,
        "cols": cols,
        "cell_m": world.cell_m,
        "free_m2": world.free_m2,
        "rooms": rooms,
        "start": world.start,
        "sha256": world_digest(world),
    }


def engine_of(costs: Costs) -> dict[str, Any]:
    """Return what run.json says of the engine."""
    own = {name: getattr(costs, name) for name in ("engine", "levels", "lanes")}
    return own | {"why_not_native": costs.why_not}
