"""Lessons: the cost of each choice at a decision, found by driving every one of them to the end.

Training knows the true map: from the state of an episode under way, every candidate is tried with the present policy
after it, until all is seen or its cost exceeds the best by a margin. A lesson is a program of the engine, one robot
that returns to its decisions.
"""

from collections.abc import Callable, Sequence
from typing import Any, ClassVar, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import Array

from jexplore.arrays.loops import run_if
from jexplore.engine.program import Line, Program
from jexplore.engine.runner import find_resources, run_all
from jexplore.exploration import environment
from jexplore.exploration.batch import NO_RUN
from jexplore.exploration.episode import CPU_OPTIONS
from jexplore.exploration.site import tasks_of
from jexplore.exploration.state import Numbers, Outcome, Setup, State
from jexplore.learn.bank import Bank
from jexplore.planning import field
from jexplore.policies import Strategy
from jexplore.policies.clusters import go_to, targets
from jexplore.policies.learned import features
from jexplore.policies.learned.model import Model
from jexplore.policies.learned.strategy import is_forced, policy_of, score_targets

DECISIONS = 64  # most decisions of an episode whose candidates are tried
NEAREST = 6  # the robot strays to one of this many targets
STREAM = 4  # of random numbers, besides those of an episode and of `jx.Environment`


class Lessons(NamedTuple):
    """D decisions, numpy or traced."""

    features: Any  # [D, K, F] float32
    used: Any  # [D, K] bool
    costs: Any  # [D, K] float32, what a choice cost beyond the best, FEATURE_UNIT_M; nan: not tried
    weight: Any  # [D] float32, FEATURE_UNIT_M divided by the whole path of the episode


class Asking(NamedTuple):
    """Static config of lessons, and how the robot continues."""

    share: float  # of the decisions, the first `DECISIONS` so chosen
    tried: int  # most candidates of one, the nearest and those of the best scores
    margin_m: float  # a rollout ends when it costs this much more than the best before it
    stray: float  # share of the decisions at which the robot goes elsewhere than the policy would


@struct.dataclass
class _Numbers:
    own: Numbers  # of the episode
    share: Array
    tried: Array
    margin_m: Array
    stray: Array


@struct.dataclass
class _Lesson:
    state: State  # of the robot
    saved: State  # where it decided
    trying: Array  # int32, which of `order` is being tried; -1: none, the robot goes on
    order: Array  # [K] int32, slots
    n: Array  # int32, candidates that are to be tried
    best_m: Array  # float32, least cost until now
    asked: Array  # int32, decisions tried until now
    features: Array  # [DECISIONS, K, F]
    used: Array  # [DECISIONS, K]
    costs_m: Array  # [DECISIONS, K], inf where a try was ended, nan where there was none
    replace: ClassVar[Callable[..., Self]]


class _Setup(NamedTuple):
    setup: Setup
    network: str


def _driven_m(lesson):
    """Return the metres driven since the decision."""
    return lesson.state.path_m - lesson.saved.path_m


def _episode(given):
    return given.replace(numbers=given.numbers.own)


def _begin(setup, given):
    state = environment.begin(setup.setup, _episode(given))
    most, n_features = features.SCORED_CLUSTERS, len(features.FEATURES)
    return _Lesson(
        state=state,
        saved=state,
        trying=jnp.int32(-1),
        order=jnp.zeros(most, jnp.int32),
        n=jnp.int32(0),
        best_m=jnp.float32(jnp.inf),
        asked=jnp.int32(0),
        features=jnp.zeros((DECISIONS, most, n_features), jnp.float32),
        used=jnp.zeros((DECISIONS, most), bool),
        costs_m=jnp.full((DECISIONS, most), jnp.nan, jnp.float32),
    )


def _advance(setup, given, lesson):
    return lesson.replace(state=environment.advance(setup.setup, _episode(given), lesson.state))


def _drive(setup, given, lesson):
    return lesson.replace(state=environment.drive(setup.setup, _episode(given), lesson.state))


def _has_ended(given, lesson):
    """Return whether a rollout has ended."""
    cut = _driven_m(lesson) > lesson.best_m + given.numbers.margin_m
    return (lesson.trying >= 0) & (cut | (lesson.state.outcome != Outcome.RUNNING))


def _ended(lesson):
    """End a rollout: its cost is kept, and the robot is back at its decision."""
    complete = environment.outcome_of(lesson.state) == Outcome.COMPLETE
    cost = jnp.where(complete, _driven_m(lesson), jnp.inf)
    following = lesson.trying + 1
    return lesson.replace(
        state=lesson.saved,
        trying=jnp.where(following < lesson.n, following, -1),
        best_m=jnp.minimum(lesson.best_m, cost),
        costs_m=lesson.costs_m.at[lesson.asked - 1, lesson.order[lesson.trying]].set(cost),
    )


def _decide(setup, given, lesson):
    ended = _has_ended(given, lesson)
    lesson = run_if(ended, _ended, lesson)
    own, state = _episode(given), lesson.state
    known = field(state.belief)
    at = features.shortlist(targets(state.belief, known))

    def tell():
        return features.features(state.belief, at, state.carry, given.shared)

    found, told = score_targets(setup.network, own.numbers.params, at, tell)
    forced = is_forced(at)
    draw = jax.random.split(jax.random.fold_in(jax.random.fold_in(given.key, STREAM), state.plans), 3)
    goes_on = lesson.trying < 0
    asks = goes_on & ~ended & ~forced & (lesson.asked < DECISIONS)
    asks &= jax.random.uniform(draw[0]) < given.numbers.share

    def ask(lesson):
        return lesson.replace(
            saved=state,
            trying=jnp.int32(0),
            order=jnp.argsort(-found.at[0].set(jnp.inf), stable=True).astype(jnp.int32),
            n=jnp.minimum(jnp.sum(at.used, dtype=jnp.int32), given.numbers.tried),
            best_m=jnp.float32(jnp.inf),
            asked=lesson.asked + 1,
            features=lesson.features.at[lesson.asked].set(told),
            used=lesson.used.at[lesson.asked].set(at.used),
        )

    lesson = run_if(asks, ask, lesson)
    near = at.used & (jnp.arange(features.SCORED_CLUSTERS) < NEAREST)
    elsewhere = jnp.argmax(jnp.where(near, jax.random.uniform(draw[1], near.shape), -1.0))
    strays = goes_on & ~forced & (jax.random.uniform(draw[2]) < given.numbers.stray)
    which = jnp.where(strays, elsewhere, jnp.argmax(found))
    which = jnp.where((lesson.trying >= 0) & (asks | ended), lesson.order[lesson.trying], which)
    which = jnp.where(at.used[0], which.astype(jnp.int32), -1)
    choice, route = go_to(state.belief, state.route, known, at, which)
    state = state.replace(carry=jnp.stack([choice.row, choice.col]))
    return lesson.replace(state=environment.commit(setup.setup, own, state, choice, route))


def _finish(setup, given, lesson):
    state = lesson.state
    path_m = jnp.where(environment.outcome_of(state) == Outcome.COMPLETE, state.path_m, jnp.inf)
    return lesson.asked, lesson.features, lesson.used, lesson.costs_m, path_m


def _is_done(lesson):
    return (lesson.trying < 0) & (lesson.state.outcome != Outcome.RUNNING)


def _must_decide(lesson):
    return ~lesson.state.plan_active


def _program(setup, network):
    return Program(
        setup=_Setup(setup._replace(capacity=1), network),
        begin=_begin,
        advance=_advance,
        is_done=_is_done,
        finish=_finish,
        detail=lambda lesson: (),
        decide=_decide,
        must_decide=_must_decide,
        drive=None if setup.native is None else _drive,
        cpu_options=CPU_OPTIONS,
    )


def no_lessons() -> Lessons:
    """Return empty lessons."""
    size = 0, features.SCORED_CLUSTERS
    blank = np.zeros((*size, len(features.FEATURES)), np.float32), np.zeros(size, bool), np.zeros(size, np.float32)
    return Lessons(*blank, np.zeros(0, np.float32))


def together(parts: Sequence[Lessons]) -> Lessons:
    """Join lessons, at least one."""
    return Lessons(*(np.concatenate(column).astype(column[0].dtype) for column in zip(*parts)))


def give_lessons(
    bank: Bank, model: Model, which: Sequence[int], seed: int, asking: Asking, *, workers: int | None = None
) -> tuple[Lessons, np.ndarray]:
    """Collect lessons from episodes of a model's policy; `which` and `seed` are as for `Bank.log_ratios`.

    Returns:
      `(lessons, path_m)`: `[K]` float64, how long the robot's own path was; inf where it did not end COMPLETE. Of such
        an episode there are no lessons.

    Raises:
      KeyboardInterrupt: not all could be made.
    """
    strategy = Strategy("learned", policy_of(model), True)
    numbers = [np.float32(asking.share), np.int32(asking.tried), np.float32(asking.margin_m), np.float32(asking.stray)]
    lines, places = [], []
    for number, place, starts in bank.episodes(which, seed):
        site, every = bank.site(number), np.arange(len(starts))
        setup, own = site.with_strategy(strategy)
        given = site.beams, site.truth, _Numbers(own, *numbers), seed, tasks_of(starts, site.ring)
        lines.append(Line(_program(setup, model.network), *given, every, NO_RUN))
        places.append(place)
    run_all(lines, find_resources(in_lanes=False, workers=workers))
    path_m = np.full(len(which), np.inf)
    parts = []
    for line, place in zip(lines, places):
        if not line.finished.all():
            raise KeyboardInterrupt
        path_m[place] = line.results[-1]
        for asked, told, used, costs_m, length_m in zip(*line.results):
            if np.isfinite(length_m) and length_m > 0:
                sound = np.flatnonzero(np.isfinite(costs_m[:asked]).any(axis=1))
                costs = costs_m[sound]
                beyond = np.minimum(costs - np.nanmin(costs, axis=1, keepdims=True), asking.margin_m)
                weight = np.full(len(sound), features.FEATURE_UNIT_M / length_m, np.float32)
                parts.append(Lessons(told[sound], used[sound], beyond / features.FEATURE_UNIT_M, weight))
    return together([no_lessons(), *parts]), path_m
