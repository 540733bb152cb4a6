"""Exploration step by step, as learners want it: an action is a target, a step is the drive there.

The rules are those of an episode: `exploration.environment`, one decision at a time.
"""

import copy
import functools
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Self

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import Array

from jexplore.arrays.loops import alone_on_cpu, run_if
from jexplore.arrays.padding import bucket
from jexplore.config import InputError, checked_names
from jexplore.engine.backend import use_compilation_cache
from jexplore.engine.program import Given
from jexplore.engine.runner import find_resources, require_32_bits
from jexplore.exploration import environment
from jexplore.exploration.metrics import values_of
from jexplore.exploration.site import drive_for, prepare_site, unify_truths
from jexplore.exploration.state import Numbers, Outcome, Truth, steps_m
from jexplore.exploration.team import stepping
from jexplore.exploration.team.state import TeamSetup, TeamState
from jexplore.exploration.team.stepping import cell_inside
from jexplore.exploration.trail import LOOKS, Trail
from jexplore.planning import Field, View, choose, field, is_live, view_of
from jexplore.policies.closest import closest
from jexplore.raycast import Beams
from jexplore.reach import FAR
from jexplore.studies import checks
from jexplore.studies.metrics import MetricsLike, ready_metrics
from jexplore.worlds.regions import warn_of_floor
from jexplore.worlds.starts import check_start, start_cells, start_region
from jexplore.worlds.world import World, ringed_shape

WORLD, START = 2, 3  # streams of random numbers besides those of an episode (`state.Stream`)


@checked_names
@struct.dataclass
class EnvState:
    """An episode under way, between two decisions; over before the first where `reset` says BAD_START."""

    episode: Any  # `State`, of a team `TeamState`
    reached: Field  # of its belief; of a team, of every robot's
    world: Array  # int32, which of the environment's worlds it is in
    ring: Array | None  # int32, cells by which indices in its maps are larger than its world's; None: 0 in all worlds
    replace: ClassVar[Callable[..., Self]]


@struct.dataclass
class _Bank:
    """Shared data of all episodes of an environment, an argument of its programs."""

    beams: Beams
    scenes: Truth  # [M, ...]
    numbers: Numbers  # [M, ...]
    recheck: Array  # bool
    ring: Array | None  # [M] int32, see `EnvState`
    paces: Array  # [N] int32, of a team


@checked_names
class Environment:
    """Worlds to be explored by decisions: `reset`, then `step` until done. For one robot; under `vmap` for many.

    Both functions are pure and compiled when first called; `jax.jit`, `jax.vmap` and `jax.lax.scan` go over them. On a
    CPU the lanes of a `vmap` run one after the other, which is faster there than together.

        env = jx.Environment("rooms#1")
        state, view = env.reset(jax.random.key(0))
        state, view, reward, done, info = env.step(key, state, action)
    """

    worlds: tuple[World, ...]
    """Worlds to explore, in order."""
    shape: tuple[int, int]
    """`(H, W)` of all maps: that of the largest world, padded. Cells of a view, an action and a path are those of the
    world."""
    cell_m: float
    """Edge of a cell, metres."""

    def __init__(
        self, worlds: Any, *, cell_m: float = 0.1, lidar: checks.LidarLike = checks.LIDAR,
        rules: checks.RulesLike = checks.RULES, pose: str | None = None, odometry: checks.OdometryLike = None,
        recheck: bool = False, paths: bool = False, metrics: MetricsLike = None, robots: int = 1,
        members: str | Sequence[str] = (),
    ) -> None:  # fmt: skip
        """Load the worlds.

        Args:
          worlds: names (`load_world`) or `World`s, one or several with cells of one size.
          cell_m: edge of a cell of the worlds that are loaded by name, metres.
          lidar: `Lidar`, or a mapping of some of its fields.
          rules: `Rules`, or a mapping of some of its fields.
          pose: "true", "odometry", "icp" or "icp+closing": `rules.pose`, if given. Views show what the robot believes;
            `info` has the measures of such episodes, `ate_m` with `paths`.
          odometry: `Odometry`, or a mapping of some of its fields: `rules.odometry`, if given.
          recheck: give up a frontier cell as soon as it is no longer live.
          paths: keep the whole way in the state, for `path`: 8 bytes for every cell of the map, at least 160 kB.
          metrics: more entries of `info`: name -> function of an `EpisodeView`, see `metric`.
          robots, members: a team that hears each other everywhere (`team.read_members`), without recheck, paths,
            metrics. Views have a leading axis N, actions are `[N, 2]`, a step goes on until a robot needs a target.
        """
        lidar, rules = checks.ready_settings(lidar, rules, pose, odometry)
        if not isinstance(recheck, bool):
            raise InputError(f"recheck must be True or False, got {recheck!r}")
        if rules.return_home:
            raise InputError("rules.return_home must be False: whoever steps through an Environment drives home itself")
        team = stepping.ready_team(robots, members, lidar, bool(recheck or paths or metrics) or not rules.on_lattice)
        use_compilation_cache()
        self._metrics = ready_metrics(metrics) | checks.measures_of(rules)
        self.worlds = tuple(checks.ready_worlds(worlds, cell_m))
        sizes = sorted({world.cell_m for world in self.worlds})
        if len(sizes) > 1:
            raise InputError(f"worlds must have cells of one size, got {sizes[0]:g} and {sizes[1]:g} m")
        self.cell_m, self._rules, self.robots = sizes[0], rules, len(team)
        rows, cols = (max(map(bucket, sides)) for sides in zip(*(ringed_shape(w.occupied) for w in self.worlds)))
        self.shape = rows, cols
        find_resources()  # starts JAX
        native, own = drive_for(jax.local_devices()[0].platform).name, tuple(self._metrics.values())
        sites, cells = [], []
        for world in self.worlds:
            checks.require_clearance(rules, world.cell_m, repr(world.name))
            checks.require_memory(world, lidar, rules)
            cells.append(start_cells(world, rules.clearance_m))
            warn_of_floor(world, start_region(world, rules.clearance_m), rules.clearance_m, drawn=True)
            sites.append(prepare_site(world, lidar, rules, self.shape, native=native, metrics=own))
        capacity = max(site.setup.capacity for site in sites) if paths else 1
        self._setup: Any = sites[0].setup._replace(policy=closest(), capacity=capacity)  # which nobody asks
        if robots > 1:
            self._setup = stepping.setup_of(self._setup, robots, min(map(len, cells)))
        records = unify_truths([site.truth for site in sites]), [site.numbers for site in sites]
        scenes, numbers = (jax.tree.map(lambda *a: jnp.stack(a), *own) for own in records)
        ring = jnp.asarray([site.ring for site in sites], jnp.int32) if any(site.ring for site in sites) else None
        beams, paces = stepping.equipped(team, sites[0].beams, lidar, self.cell_m)
        self._bank = _Bank(beams, scenes, numbers, jnp.bool_(recheck), ring, paces)
        self._n_cells = jnp.asarray([len(own) for own in cells], jnp.int32)
        size = max(map(len, cells)), 2
        self._cells = jnp.asarray(np.stack([np.resize(own, size) for own in cells]), jnp.int32)

    def reset(self, key: Array, start: Any = None, world: Any = None) -> tuple[EnvState, View]:
        """Begin an episode and make its first scans.

        Args:
          key: of the episode; draws the world, the start and the scanner's noise, each from a stream of its own. That
            of episode n of a comparison is `jax.random.fold_in(jax.random.key(seed), n)`.
          start: int32 `[3]`, row, col, heading_deg (a multiple of 45), of a team `[N, 3]`; may be traced. Without it,
            drawn uniformly from the cells that are clear. From an enclosed one the episode is over at once, as STUCK.
          world: int32, which of `worlds`; may be traced. Without it, drawn.

        A wrong start or world raises an error, but for a traced one, whose value is not known yet: a world's number
        out of range, a start outside the map or in a wall, a heading that is no multiple of 45 degrees, or two robots
        in one cell end the episode at once, as BAD_START.

        Returns:
          `(state, view)`.
        """
        require_32_bits()
        checks.require_key(key)
        drawn = world is None and len(self.worlds) > 1  # a start may then lie in a wall of the one and not of the other
        if world is not None:
            world = checks.whole_array("world", world, ())
            known = checks.concrete(world)
            if known is not None and not 0 <= known < len(self.worlds):
                raise InputError(f"world must be from 0 to {len(self.worlds) - 1}, got {known}")
        else:
            world = jax.random.randint(jax.random.fold_in(key, WORLD), (), 0, len(self.worlds), jnp.int32)
        if start is not None:
            start = checks.whole_array("start", start, (self.robots, 3)[self.robots == 1 :], "row, col, heading_deg")
            given, where = checks.concrete(start), checks.concrete(world)
            if given is not None and where is not None and not drawn:
                for one in given.reshape(-1, 3):
                    check_start(self.worlds[int(where)], one, self._rules.clearance_m, self._rules.near_m)
        else:
            which, turn = jax.random.split(jax.random.fold_in(key, START))
            n = self._n_cells[world]
            places = jax.random.randint(which, (), 0, n, jnp.int32)
            if self.robots > 1:
                places = stepping.drawn(which, self._cells.shape[1], n, self.robots)
            turns = jax.random.randint(turn, jnp.shape(places), 0, 8, jnp.int32)
            start = jnp.concatenate([self._cells[world, places], 45 * turns[..., None]], axis=-1)
        return _reset(self._setup, self._bank, jax.random.clone(key), start.astype(jnp.int32), world)

    def step(self, key: Array, state: EnvState, action: Any) -> tuple[EnvState, View, Array, Array, dict[str, Array]]:
        """Drive to a target, until it is reached, found to be out of reach, or given up.

        Args:
          key: draws the scanner's noise, from a stream that depends on the number of scans: the episode's own key, the
            same at every step, gives the noise of a comparison. Not consumed.
          state: `EnvState`.
          action: int32 `[2]`, row and col of a cell of finite `view.cost`. Any other moves nothing, and
            `info["valid"]` is False. Of a team `[N, 2]`: robots under way keep their targets, and a robot that needs
            one and gets none waits for the time of a straight step.

        Returns:
          state: `EnvState`; as it was once the episode is over.
          view: `View`.
          reward: float32, minus the metres driven, by all robots.
          done: bool, the episode is over: with the step that leaves no frontier, or at a limit of the rules.
          info: dict of `valid`, bool; `outcome`, int32, an `Outcome`; `path_m`, float32, metres driven since the start;
            `known_m2`, float32, known area; the present values of the metrics.
        """
        require_32_bits()
        checks.require_key(key)
        self._require_one(state, "step")
        action = checks.whole_array("action", action, (self.robots, 2)[self.robots == 1 :], "row, col")
        *seen, info, values = _step(self._setup, self._bank, jax.random.clone(key), state, action)
        return (*seen, info | dict(zip(self._metrics, values)))

    def path(self, state: EnvState) -> np.ndarray:
        """Return the driven way, of an environment with `paths=True`: `[n + 1, 2]` int32, row and col; on the host."""
        self._require_one(state, "path")
        if self._setup.capacity == 1:
            raise InputError("this environment keeps no paths: jx.Environment(..., paths=True)")
        spots = np.asarray(state.episode.trail)[: int(state.episode.steps) + 1, Trail.SPOT]
        ring = 0 if state.ring is None else int(state.ring)
        return np.stack(np.divmod(spots // LOOKS, self.shape[1]), axis=1) - ring

    @property
    def arrays(self) -> Any:
        """Return a pytree of all its arrays: worlds, beams, numbers.

        A function compiled around `env.step` has them as constants; one that is given them and calls
        `env.with_arrays(arrays).step` has not, and compiles faster where worlds are many.
        """
        return self._bank, self._cells, self._n_cells

    def with_arrays(self, arrays: Any) -> Self:
        """Return the same environment with other arrays, which may be traced; see `arrays`."""
        other = copy.copy(self)
        other._bank, other._cells, other._n_cells = arrays
        return other

    def _require_one(self, state, taker):
        if not isinstance(state, EnvState):
            raise InputError(f"state must be what reset or step returned, got {type(state).__name__}")
        if jnp.ndim(state.world):
            many = f"{jnp.shape(state.world)[0]} or more"
            raise InputError(f"{taker} takes one state, got {many}; use jax.vmap(env.step), or take one of them")
        own = getattr(state.episode, "robots", state.episode)
        shape = (self.robots, *self.shape)[self.robots == 1 :]
        if own.trail.shape[-2] != self._setup.capacity + 1 or own.belief.driven.shape != shape:
            raise InputError("state must be one of this environment: its maps or its path have another size")

    def __repr__(self) -> str:
        names = ", ".join(str(world.name) for world in self.worlds)
        return f"<Environment of {names}; {self.shape[0]} x {self.shape[1]} cells of {self.cell_m:g} m>"


def _given(bank, key, world, start):
    task = stepping.task_of(start, bank.paces) if start.ndim == 2 else start
    return Given(key, bank.beams, bank.scenes, world, jax.tree.map(lambda a: a[world], bank.numbers), task)


def _seen(setup, given, episode, ring):
    """Return `EnvState` after the last scan of a plan; without a frontier the episode is over."""
    known = field(episode.belief)
    none = ~jnp.any(known.frontier) & (episode.outcome == Outcome.RUNNING)

    def end(episode):
        nothing, route = choose(episode.belief, episode.route, known, jnp.int32(-1), jnp.int32(-1))
        return environment.commit(setup, given, episode, nothing, route)

    return EnvState(run_if(none, end, episode), known, given.scene, ring)


def shown(state: EnvState) -> View:
    """Return the `View` of a state, in the cells of its world."""
    if isinstance(state.episode, TeamState):
        robots = state.episode.robots, state.reached
        return jax.lax.map(lambda one: shown(EnvState(one[0], one[1], state.world, state.ring)), robots)
    view, ring = view_of(state.episode.belief, state.reached), state.ring
    if ring is None:
        return view
    view = jax.tree.map(
        lambda a: jnp.roll(a, jnp.stack([-ring, -ring]), (0, 1)) if a.shape == view.cost.shape else a, view
    )
    belief = view.belief
    return view.replace(
        belief=belief.replace(
            row=belief.row - ring,
            col=belief.col - ring,
            start=belief.start - jnp.stack([ring, ring, jnp.int32(0)]),
            extent=belief.extent - 2 * ring,
        )
    )


def _ringed(ring, row, col):
    """Convert a cell of a world to its maps."""
    return (row, col) if ring is None else (row + ring, col + ring)


def _begun(setup, bank, key, start, world):
    row, col, heading_deg = jnp.moveaxis(start, -1, 0)
    occupied = bank.scenes.occupied
    own = jnp.clip(world, 0, len(occupied) - 1)
    ring = None if bank.ring is None else bank.ring[own]
    _, row, col = cell_inside(occupied.shape[1:], *_ringed(ring, row, col))
    bad = occupied[own, row, col] | (heading_deg % 45 != 0) | (world != own)
    if bank.scenes.within is not None:
        bad |= ~bank.scenes.within[own, row, col]
    given = _given(bank, key, own, jnp.stack([row, col, heading_deg // 45 % 8], axis=-1))
    if isinstance(setup, TeamSetup):
        team = stepping.begun(setup, given, jnp.any(bad))
        state = EnvState(team, stepping.fields(team), own, ring)
        return state, shown(state)
    state = _seen(setup, given, environment.begin(setup, given), ring)
    outcome = jnp.where(bad, Outcome.BAD_START, state.episode.outcome)
    state = state.replace(episode=state.episode.replace(outcome=outcome))
    return state, shown(state)


def _driven_by_team(setup, bank, key, state, action):
    given = _given(bank, key, state.world, state.episode.robots.belief.start)
    cells = action if state.ring is None else action + state.ring
    team, reward, info = stepping.play(setup, given, state.episode, cells)
    state = EnvState(team, stepping.fields(team), state.world, state.ring)
    return state, shown(state), reward, stepping.is_done(team), info, ()


def _driven(setup, bank, key, state, action):
    if isinstance(setup, TeamSetup):
        return _driven_by_team(setup, bank, key, state, action)
    episode, known = state.episode, state.reached
    given = _given(bank, key, state.world, episode.belief.start)
    inside, row, col = cell_inside(known.cost.shape, *_ringed(state.ring, *action))
    valid = inside & (known.cost[row, col] < FAR) & (episode.outcome == Outcome.RUNNING)

    def drive(state):
        episode = state.episode
        # What was no frontier cell when it was chosen is not given up for being none.
        numbers = given.numbers.replace(recheck=bank.recheck & known.frontier[row, col])
        own = given.replace(numbers=numbers)
        choice, route = choose(episode.belief, episode.route, known, row, col)
        episode = environment.commit(setup, own, episode, choice, route, is_live(episode.belief, row, col))
        return _seen(setup, own, environment.drive(setup, own, episode), state.ring)

    state = run_if(valid, drive, state)
    now = state.episode
    info = {
        "valid": valid,
        "outcome": environment.outcome_of(now),
        "path_m": now.path_m,
        "known_m2": now.n_known * given.numbers.model.cell_m**2,
    }
    reward = -steps_m(now.straight - episode.straight, now.diagonal - episode.diagonal, given.numbers.model.cell_m)
    if now.poses is not None:
        reward = episode.path_m - now.path_m
    values = values_of(setup, given, now.replace(outcome=info["outcome"]))
    return state, shown(state), reward, now.outcome != Outcome.RUNNING, info, values


@functools.partial(jax.jit, static_argnums=0)
def _reset(setup, *args):
    return alone_on_cpu(functools.partial(_begun, setup))(*args)


@functools.partial(jax.jit, static_argnums=0)
def _step(setup, *args):
    return alone_on_cpu(functools.partial(_driven, setup))(*args)
