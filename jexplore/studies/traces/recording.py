"""Runs of a plan once more: the scans along their way, and run 0 step by step as the operator would have seen it."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from jexplore import btm
from jexplore.driving import behaviour, events, mission, vehicle
from jexplore.driving.batch import Driven, step_slots
from jexplore.driving.building.walls import segments
from jexplore.driving.local.run import LocalRun
from jexplore.driving.mission import MissionTask, RunOutcome, Setup
from jexplore.driving.params.tree import using
from jexplore.driving.records import RunMode, State
from jexplore.driving.sensing import perception, surround
from jexplore.engine.devices import pinned_draws, random_key
from jexplore.engine.program import Given
from jexplore.report.operator_view import RunRecording
from jexplore.studies.traces.job import TraceJob
from jexplore.worlds.readers.scans import ScanLog

TRIANGLES = 8  # most that are shown of a scan
MODE_NAMES = tuple(mode.name.lower().replace("_", " ") for mode in RunMode)
LOG_EVERY_STEPS = 5  # steps between two scans of a log: 0.2 m of way
SCANS_A_CALL = 64  # scans that are made in one call


def scans_of(plan: TraceJob, way: Driven, *, setting: int = 0, run: int = 0, every: int = LOG_EVERY_STEPS) -> ScanLog:
    """Reproduce the scans of a run as they were measured, noise included; `setting` and `run` together make its noise.

    In the world's frame: `poses` are true, `odometry` holds the estimated ones: odometry, corrected by scans and at
    nodes met again. Readings are distances in the plane; 0 for none, or for a beam that has met ground.
    """
    steps = np.arange(0, len(way.truth), every)
    key = jax.random.fold_in(random_key(np.uint32(plan.seed)), run)
    robot, _, noise, params = _setting(plan, setting)
    building = jax.device_put(plan.building)
    calls = np.pad(steps, (0, -len(steps) % SCANS_A_CALL), "edge").reshape(-1, SCANS_A_CALL)
    found = [_measured(key, building, robot, noise, params, (some, way.truth[some])) for some in calls]
    ranges = np.concatenate(jax.device_get(found))[: len(steps)]
    origin = np.array([*plan.world.origin_m, 0.0])
    return ScanLog(
        poses=way.truth[steps] + origin,
        odometry=way.estimate[steps] + origin,
        ranges=np.where(np.isnan(ranges), 0.0, np.minimum(ranges, vehicle.SCAN_RANGE_M)).astype(np.float64),
        angles_rad=vehicle.ANGLES_RAD.astype(np.float64),
        times=vehicle.DT_S * steps,
        max_range_m=vehicle.SCAN_RANGE_M,
    )


def _setting(plan, setting):
    """Return robot, thresholds, noise and parameters of a setting."""
    own = np.array([setting])
    return jax.tree.map(lambda a: jnp.asarray(a[0]), (*plan.settings_of(own), plan.params_of(own)))


@pinned_draws()
@jax.jit
def _measured(key, building, robot, noise, params, steps_and_poses):
    """Return the scans in some steps, see `vehicle.level_scan`; inf: no return; NaN: no reading, or ground."""

    def one(of):
        step, pose = of
        body = vehicle.initial_body(building, robot, pose)
        senses = vehicle.read_sensors(
            vehicle.draw_one(jax.random.fold_in(key, step), noise), building, robot, noise, body
        )
        return vehicle.level_scan(senses, robot)[0].ranges_m

    with using(params):
        return jax.lax.map(one, jax.tree.map(jnp.asarray, steps_and_poses))


def in_world_frame(poses: ArrayLike, origin_m: tuple[float, float]) -> np.ndarray:
    """Convert poses `[n, 3]` to the world's frame."""
    return np.asarray(poses) + np.array([*origin_m, 0.0], np.float32)


def wall_lines(plan: TraceJob) -> np.ndarray:
    """Return the building's walls in the world's frame: `[S, 4]`, metres."""
    return segments(plan.building.walls) + np.tile(np.asarray(plan.world.origin_m), 2)


def beam_ends(log: ScanLog, poses: np.ndarray) -> np.ndarray:
    """Return the ends of beams, seen from poses: `[N, B, 2]`, metres; the poses themselves for a beam without echo."""
    angle = poses[:, 2:] + log.angles_rad
    length = np.where(log.echo, log.ranges, 0)
    return poses[:, None, :2] + length[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def begin_run(plan: TraceJob, run: int) -> tuple[Setup, Given, State]:
    """Return the config, the context and the first state of a run by triangles, for `advance`."""
    robot, tuning, noise, params = _setting(plan, 0)
    setup = Setup(step_slots(plan.max_steps), *plan.size)
    given = Given(
        key=jax.random.fold_in(random_key(np.uint32(plan.seed)), run),
        shared=(),
        scenes=jax.tree.map(lambda a: jnp.asarray(a)[None], plan.building),
        scene=jnp.int32(0),
        numbers=jnp.int32(plan.max_steps),
        task=MissionTask(robot, tuning, noise, jnp.asarray(plan.starts_of(np.array([run]))[0]), params),
    )
    # With exactly the types that a step returns, not weak ones: else the second step would be compiled once more.
    return setup, given, jax.tree.map(lambda a: jnp.asarray(a, a.dtype), mission.begin(setup, given))


advance = pinned_draws()(jax.jit(mission.advance, static_argnums=0))
"""Make one step of a run."""


@pinned_draws()
@jax.jit
def _view(given, state, after):
    """Return the view of a step, from the states before and after it."""
    building, (robot, tuning, noise, _, params) = given.own_scene, given.task
    with using(params):
        draws = vehicle.draw_one(jax.random.fold_in(given.key, state.step), noise)
        senses = vehicle.read_sensors(draws, building, robot, noise, state.body)
        walls = events.walls_of_scan(mission.smooth_senses(senses, robot)[0].ranges_m, tuning, robot)
        found = perception.find_divergences(*surround.known_points(after.around), walls.beside.min(), tuning)
        best = jnp.argsort(jnp.where(found.valid, jnp.hypot(*found.centre.T), jnp.inf))[:TRIANGLES]
        there = found.valid[best]
        return {
            "pose": state.body.pose,
            "estimate": state.estimate,
            "mode": after.mode,
            "target": vehicle.to_odometry(state.estimate)(after.target),
            "ranges_m": senses.ranges_m,
            "triangles_m": jnp.where(there[:, None, None], found.corners[best], jnp.nan),
            "chosen": jnp.where(there[0], 0, -1),
            "pitch_deg": jnp.degrees(senses.pitch),
            "roll_deg": jnp.degrees(senses.roll),
            "n_nodes": after.writer.map.n_nodes,
            "status": after.writer.map.status,
            "votes": behaviour.votes(after.track),
            "left_m": walls.region_sides[0],
            "right_m": walls.region_sides[1],
        }


def record_run(plan: TraceJob, on_progress: Callable[[int], Any] = lambda n: None) -> RunRecording:
    """Record the operator's view of run 0; `on_progress` is called with the number of finished steps."""
    series, found = (_frames_by_map if plan.perception == "map" else _frames)(plan, on_progress)
    origin, n = plan.world.origin_m, len(series["pose"])
    goal = None if np.isnan(plan.building.goal).any() else tuple(np.asarray(plan.building.goal) + origin)
    return RunRecording(
        title=f"{plan.robot.name} in {plan.world.name}",
        dt_s=vehicle.DT_S,
        mode_names=MODE_NAMES,
        walls_m=wall_lines(plan),
        goal_m=goal,
        angles_rad=vehicle.ANGLES_RAD,
        time_s=vehicle.DT_S * np.arange(n),
        target_m=series.pop("target") + np.asarray(origin),
        pose=in_world_frame(series.pop("pose"), origin),
        estimate=in_world_frame(series.pop("estimate"), origin),
        map=found,
        robot_m=(plan.robot.length_m, plan.robot.width_m),
        **series,
    )


def _frames(plan, on_progress):
    """Return the series of a run by triangles, step by step, and its map."""
    setup, given, state = begin_run(plan, 0)
    frames = []
    while int(state.outcome) == RunOutcome.RUNNING:
        before, state = state, advance(setup, given, state)
        frames.append(jax.device_get(_view(given, before, state)))
        on_progress(len(frames))
    series = {name: np.stack([frame[name] for frame in frames]) for name in frames[0]}
    status = series.pop("status")
    used = np.flatnonzero(status[-1] != btm.NONE)
    there, searched = status[:, used] != btm.NONE, status[:, used] == btm.SEARCHED
    series |= {"n_links": there.sum(axis=1)}
    series["link_searched_frame"] = np.where(searched.any(axis=0), searched.argmax(axis=0), len(frames))
    return series, btm.to_map(jax.device_get(state.writer.map), origin_m=plan.world.origin_m)


def _frames_by_map(plan, on_progress):
    """Return the series of a run by a local map, step by step, and its map with links in the order in which they came.

    It has no triangles, votes and walls.
    """
    (task,) = plan.local_tasks(*(numbers[:1] for numbers in plan.all_runs()))
    frames, first, ended, seen = [], {}, {}, None

    def on_step(run):
        nonlocal seen, ranges
        n, (estimate, truth, mode) = len(frames), run.pilot.way[-1]
        if run.seen is not seen:
            seen = run.seen
            for node in run.map.nodes:
                first.setdefault(node, n)
            for exit_ in (e for node in run.map.nodes for e in node.exits):
                first.setdefault(exit_, n)
                if exit_.to >= 0:
                    ended.setdefault(exit_, n)
                else:
                    ended.pop(exit_, None)  # its end was no place
        view = {"pose": truth, "estimate": estimate, "mode": int(mode), "target": run.pilot.target}
        frames.append({**view, "ranges_m": ranges})
        ranges = run.pilot.ranges_m
        on_progress(n + 1)

    run = LocalRun(task, on_step)
    ranges = run.pilot.ranges_m
    run.drive()
    series = {name: np.stack([frame[name] for frame in frames]) for name in frames[0]}
    n, found = len(frames), btm.to_map(run.map.to_btm(*plan.size), origin_m=plan.world.origin_m)
    pairs = [(exit_, back or exit_) for i, exit_, back in run.map.links() if max(i, exit_.to) < plan.size[0]]
    pairs = pairs[: len(found.links)]
    came, end = (np.array([min(of.get(e, n) for e in pair) for pair in pairs], int) for of in (first, ended))
    order = np.argsort(came, kind="stable")
    links = tuple(dataclasses.replace(found.links[i], id=k) for k, i in enumerate(order))
    none = np.zeros(n)
    series |= {"triangles_m": np.zeros((n, 0, 3, 2)), "chosen": np.full(n, -1), "votes": none.astype(int)}
    series |= {"pitch_deg": none, "roll_deg": none, "left_m": none + np.inf, "right_m": none + np.inf}
    nodes = [first.get(node, n) for node in run.map.nodes[: len(found.nodes)]]
    counts = {"n_nodes": nodes, "n_links": came[order]}
    series |= {name: np.searchsorted(at, np.arange(n), side="right") for name, at in counts.items()}
    series |= {"link_searched_frame": end[order]}
    return series, dataclasses.replace(found, links=links)
