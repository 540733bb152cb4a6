"""How lanes would be used: recorded episodes, and the turns of the lockstep engine simulated on them."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jexplore.bench.engines import LIDAR, RULES, SEED
from jexplore.engine.lanes import SPAN, STARTERS
from jexplore.engine.program import Given, given_of
from jexplore.engine.thoughts import sizes
from jexplore.exploration import environment
from jexplore.exploration.episode import program_of
from jexplore.exploration.pieces import pieces_of
from jexplore.exploration.site import KERNELS, line_of, prepare_site
from jexplore.exploration.state import Setup
from jexplore.planning import bound_of, field
from jexplore.policies import Strategy
from jexplore.reach import FAR
from jexplore.worlds.starts import draw_starts
from jexplore.worlds.world import World


class Plans(NamedTuple):
    """What the plans of an episode came to, one after the other."""

    moves: np.ndarray  # [n] int32, turns until the next plan: scans along the way
    cost: np.ndarray  # [n] int32, of the target, see `reach`; without one that of the farthest cell
    found: np.ndarray  # [n] bool, whether there was a target
    glances: np.ndarray  # [n] int32, glances that did not settle it
    pieces: np.ndarray  # [n] int32, of the search after that; 0 where a glance settled it


class Schedule(NamedTuple):
    """How a run in lockstep went."""

    turns: int
    advanced: int  # lanes that advanced, over all turns
    fills: int  # times that lanes were measured and started
    glanced: int  # lanes that were given a first glance; without glances, slots that were taken
    places: int  # for a first glance; without glances, slots
    n_lanes: int
    episodes: int

    @property
    def busy(self) -> float:
        """Share of the lanes that advanced."""
        return self.advanced / (self.turns * self.n_lanes)

    @property
    def full(self) -> float:
        """Share of the places that were taken."""
        return self.glanced / (self.turns * self.places)


@functools.partial(jax.jit, static_argnums=0)
def _recorded(setup: Setup, given: Given) -> tuple[Array, Array]:
    """One episode: `([P, 5] int32, n)`: of each plan what `Plans` has, and how many there were."""
    program = program_of(setup)
    sides, clearance_d2 = setup.windows or (), given.numbers.model.clearance_d2
    bounds = jnp.array([bound_of(side, clearance_d2) for side in sides], jnp.int32)
    pieces = pieces_of(sides)

    def search(state):
        """How many pieces a search has."""
        seen = ()
        for glance in pieces.glances:
            seen = glance(setup, given, state, seen)[3]
        start = jnp.int32(0), pieces.begin(setup, given, state, seen)
        return lax.while_loop(lambda s: ~pieces.is_done(s[1]), lambda s: (s[0] + 1, pieces.go_on(s[1])[0]), start)[0]

    def plan(carry):
        n, state, rows = carry
        memory, choice, route = environment.decide(setup, given, state)
        found = choice.row >= 0
        farthest = lax.cond(
            found, lambda: choice.cost, lambda: jnp.max(jnp.where((cost := field(state.belief).cost) < FAR, cost, 0))
        )
        failed = jnp.sum(~found | (choice.cost > bounds), dtype=jnp.int32)
        n_pieces = lax.cond(failed == len(sides), search, lambda _: 0, state)
        state = environment.commit(setup, given, state.replace(carry=memory), choice, route)
        moves, state = lax.while_loop(
            lambda s: program.is_under_way(s[1]), lambda s: (s[0] + 1, program.advance(setup, given, s[1])), (0, state)
        )
        row = [moves, farthest, found, failed, n_pieces]
        return n + 1, state, rows.at[n].set(jnp.stack(row).astype(jnp.int32))

    state = program.begin(setup, given)
    room = jnp.zeros((state.choices.shape[0], 5), jnp.int32)
    n, _, rows = lax.while_loop(lambda c: ~program.is_done(c[1]), plan, (jnp.int32(0), state, room))
    return rows, n


def record(world: World, strategy: Strategy, episodes: int) -> list[Plans]:
    """Runs some episodes on the CPU and tells what their plans came to.

    Args:
      world, strategy: `World`, `Strategy`.
      episodes: int.

    Returns:
      list of `Plans`. What an episode has beyond the room for its record of plans is left out.
    """
    site = prepare_site(world, LIDAR, RULES, dataclasses.replace(KERNELS["serial"], in_pieces=True))
    setup, numbers = site.with_strategy(strategy)
    starts = draw_starts(world, SEED, episodes, RULES.clearance_m)
    line = line_of(site, (setup, numbers), starts, SEED, np.arange(episodes))
    found = []
    for number in range(episodes):
        rows, n = _recorded(setup, given_of(line, number))
        moves, cost, has_target, failed, pieces = np.asarray(rows)[: int(n)].T
        found.append(Plans(moves, cost, has_target != 0, failed, pieces))
    return found


class _Lanes:
    """The engine's lanes, as far as the order of their work goes."""

    def __init__(self, recorded, which, n_lanes):
        n_plans, self.which = np.array([len(one.moves) for one in recorded]), which
        most = max(1, n_plans.max())
        self.moves, self.glances, self.pieces = (
            np.stack([np.pad(getattr(one, name), (0, most - len(one.moves))) for one in recorded])
            for name in ("moves", "glances", "pieces")
        )
        self.n_plans = n_plans
        self.at = np.full(n_lanes, -1)  # place in the queue
        self.plan = np.zeros(n_lanes, int)  # plans made
        self.left = np.zeros(n_lanes, int)  # turns until the next
        self.stage = np.zeros(n_lanes, int)  # glances that have settled nothing
        self.search = np.zeros(n_lanes, int)  # 1 more than the pieces left; 0: no slot
        self.slot = np.full(n_lanes, -1)  # which
        self.next = self.ended = 0

    def masks(self):
        """`(taken, done, waits, under way)`, `[L]` bool each."""
        taken = self.at >= 0
        made = self.plan >= self.n_plans[self.which[self.at]]
        done = taken & (self.left == 0) & made
        return taken, done, taken & (self.left == 0) & ~made, taken & (self.left > 0)

    def fill(self, m):
        """Measures up to m lanes that are done and starts up to m."""
        done = np.flatnonzero(self.masks()[1])[:m]
        self.at[done] = -1
        self.ended += len(done)
        free = np.flatnonzero(self.at < 0)[: min(m, len(self.which) - self.next)]
        self.at[free] = self.next + np.arange(len(free))
        self.plan[free] = self.left[free] = 0
        self.next += len(free)

    def needed(self, lanes, of):
        """What plans of some lanes need: `of` is `glances` or `pieces`."""
        return of[self.which[self.at[lanes]], self.plan[lanes]]

    def settle(self, lanes):
        """Some lanes have decided."""
        self.left[lanes] = self.needed(lanes, self.moves)
        self.plan[lanes] += 1
        self.stage[lanes] = 0

    def think(self, size):
        """The deciding of a turn: how many lanes were given a first glance, or were in slots if there are none."""
        first = 0
        for i, m in enumerate(size.glances):
            group = np.flatnonzero(self.masks()[2] & (self.stage == i))[:m]
            first += len(group) * (i == 0)
            failed = self.needed(group, self.glances) > i
            self.stage[group[failed]] += 1
            self.settle(group[~failed])
        waits = self.masks()[2] & (self.stage == len(size.glances)) & (self.search == 0)
        free = np.setdiff1d(np.arange(size.slots), self.slot[self.search > 0])[: size.newcomers]
        new = np.flatnonzero(waits)[: len(free)]
        self.slot[new] = free[: len(new)]
        self.search[new] = self.needed(new, self.pieces) + 1
        taken = np.count_nonzero(self.search)
        self.search -= self.search > 1
        done = np.flatnonzero(self.search == 1)
        done = done[np.argsort(self.slot[done])][: size.newcomers]
        self.settle(done)
        self.search[done] = 0
        return first if size.glances else taken


def simulate(recorded: Sequence[Plans], which: np.ndarray, n_lanes: int, n_glances: int) -> Schedule:
    """The turns of `lanes.Engine.go_on`, where it decides in pieces, without the work.

    Args:
      recorded: list of `Plans`.
      which: `[N]` int, the queue: which of them are run.
      n_lanes: L.
      n_glances: windows that are glanced at.
    """
    lanes, total = _Lanes(recorded, np.asarray(which), n_lanes), len(which)
    size, starters = sizes(n_lanes, n_glances), -(-n_lanes // STARTERS)
    turns = advanced = fills = glanced = 0
    while lanes.ended < total:
        while True:
            taken, done, _, _ = lanes.masks()
            ended, startable = done.sum(), min((~taken).sum(), total - lanes.next)
            idle = not (taken & ~done).any()
            if not (ended >= starters or startable >= starters or (idle and (ended or startable))):
                break
            lanes.fill(starters)
            fills += 1
        for _ in range(SPAN):
            glanced += int(lanes.think(size))
            under_way = lanes.masks()[3]
            lanes.left[under_way] -= 1
            turns, advanced = turns + 1, advanced + int(under_way.sum())
    return Schedule(turns, advanced, fills, glanced, size.counted, n_lanes, total)
