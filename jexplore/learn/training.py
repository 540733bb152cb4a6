"""Training from beginning to end: rounds of a trainer, checks on validation worlds, stored results.

matplotlib is imported by the functions that need it.
"""

import dataclasses
import hashlib
import math
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np
import pandas as pd

from jexplore.config import InputError, __version__, checked_names, require_setting
from jexplore.engine.backend import use_compilation_cache
from jexplore.engine.devices import pinned_draws, random_key
from jexplore.learn import es, ppo
from jexplore.learn.bank import TRAINING, VALIDATION, Bank, prepare_bank
from jexplore.learn.settings import require_rounds, trainer_settings
from jexplore.policies import Strategy
from jexplore.policies.learned import features, networks
from jexplore.policies.learned.model import (
    Model,
    is_finite,
    load_model,
    require_sound,
    weights_digest,
    write_page,
    write_weights,
)
from jexplore.policies.learned.strategy import policy_of
from jexplore.report.ledger import Ledger
from jexplore.studies.checks import LIDAR, RULES, LidarLike, RulesLike, WorldLike
from jexplore.studies.results.progress import progress_bar
from jexplore.studies.results.provenance import world_digest

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STATE = "_state"  # column of a unit's file besides: the trainer's state as bytes, in the last row
CURVE_COLUMNS = ("round", "ratio", "validation")
"""Columns of a curve: rounds made; ratio to the reference's of the measure on which the round was judged, in the
training worlds (of `es` all that were driven, of `ppo` some driven after it); ratio of the present weights on the
validation worlds, where they were checked."""


TRAINERS = {"es": es, "ppo": ppo}
"""Name -> module of a way of training, with pure functions `begin` and `make_round` of its state, a pytree of arrays of
which `weights` are the model's; its settings are those of `settings.TRAINER_SETTINGS`."""


class TrainingPlan(NamedTuple):
    """Settings of a training."""

    algo: str
    network: str
    training: Bank
    validation: Bank
    settings: Any  # of the trainer
    rounds: int
    check_every: int  # rounds from check to check
    starts: int  # on each validation world
    seed: int
    begins: Model  # where it begins

    @property
    def units(self) -> int:
        """Return the number of checks."""
        return self.rounds // self.check_every


@checked_names
@dataclasses.dataclass(frozen=True)
class TrainingResult:
    """Result of `run_training`."""

    model: Model
    """The best model by the checks."""
    curve: pd.DataFrame
    """One row a round, see `CURVE_COLUMNS`; the first, of round 0, is of the weights at the beginning."""
    best: int
    """The round that it is from."""
    ended: str
    """Why training ended: "rounds", "not finite" or "interrupted"."""

    def strategy(self, *, recheck: bool = True, name: str = "learned") -> Strategy:
        """Return the model as a strategy, for `jx.compare` and others."""
        return Strategy(f"{name}+recheck" if recheck else name, policy_of(self.model), recheck)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the model, for `learned:path=`: `PATH.msgpack`, and `PATH.json` next to it; return the former path."""
        file = Path(os.path.expanduser(path))
        file = file if file.suffix == ".msgpack" else file.with_name(f"{file.name}.msgpack")
        if not file.parent.is_dir():
            raise InputError(f"there is no folder {os.fspath(file.parent)!r} to save a model in")
        write_weights(file, self.model)
        write_page(file.with_suffix(".json"), self.model)
        return file

    def figure(self) -> "Figure":
        """Draw the curve."""
        from jexplore.report.plots.curves import training_figure

        return training_figure(self.curve, self.best)


def prepare_training(
    algo: str, network: str, training: Bank, validation: Bank, settings: Mapping[str, Any], *, rounds: int,
    check_every: int, starts: int, seed: int, model: Model | None = None,
) -> TrainingPlan:  # fmt: skip
    """Check the input, which is that of `train`, and make a `TrainingPlan`.

    Training begins at the model, whose network is `network`, or `linear`, whose weighted sum every network has.
    """
    numbers = trainer_settings(algo, settings)
    networks.network_named(network)
    for name in sorted({world.name for world in training.worlds} & {world.name for world in validation.worlds}):
        raise InputError(f"world {name!r} is in both the training and the validation worlds")
    if algo == "ppo":
        ppo.require_trainable(training, numbers)
    seed, rounds = require_setting("seed", seed), require_setting("rounds", rounds)
    check_every = require_rounds(rounds, require_setting("check_every", check_every))
    starts = require_setting("starts", starts)
    begins = _beginning(network, model, seed)
    return TrainingPlan(algo, network, training, validation, numbers, rounds, check_every, starts, seed, begins)


@pinned_draws()
def _beginning(network, model, seed):
    weights = networks.initial_weights(network, random_key(seed), len(features.FEATURES))
    if model is not None:
        require_sound(model)
    if model is not None and model.network == network:
        weights = model.weights
    elif model is not None and model.network == "linear":
        weights = weights | {networks.PLAIN[network]: model.weights[networks.PLAIN["linear"]]}
    elif model is not None:
        raise InputError(f"training of {network!r} cannot begin at a model of {model.network!r}")
    return Model(network, jax.tree.map(np.asarray, weights))


@checked_names
def train(
    algo: str = "es", network: str = "linear", *,
    worlds: WorldLike | Sequence[WorldLike] = TRAINING, validation: WorldLike | Sequence[WorldLike] = VALIDATION,
    model: Model | str | os.PathLike[str] | None = None, settings: Mapping[str, Any] = {},
    rounds: int = 40, check_every: int = 5, starts: int = 1, seed: int = 0,
    measure: str = "path_m", cell_m: float = 0.1, lidar: LidarLike = LIDAR, rules: RulesLike = RULES,
    workers: int | None = None, on_progress: Callable[[int], object] | None = None, progress: bool | None = None,
) -> TrainingResult:  # fmt: skip
    """Train a strategy that scores frontier clusters: `jexplore train` as a function.

    Args:
      algo: one of `TRAINERS`.
      network: one of `networks.NETWORKS`.
      worlds: names or `World`s to train in.
      validation: names or `World`s for validation, none of them among `worlds`.
      model: initial `Model`, or its path. Default: equal to `closest`, or near it for `attention`.
      settings: of the algorithm, by name.
      rounds: of training.
      check_every: rounds from one check on the validation worlds to the next, of which `rounds` is a multiple unless it
        is smaller; the best model by them is the result.
      starts: on each validation world.
      seed: of all draws.
      measure: column of the table of episodes that is to be small, such as `path_m_at_95`, `area_m` or `time_s`; for
        `ppo` `path_m`.
      cell_m: edge of a cell of the worlds that are loaded by name, metres.
      lidar: `Lidar`, or a mapping of some of its fields.
      rules: `Rules`, or a mapping of some of its fields.
      workers: cores; by default all.
      on_progress: called with the number of rounds made.
      progress: show a bar; by default in notebooks.

    Returns:
      `TrainingResult`.

    Raises:
      InputError: a world, number or name that cannot be used; weights that are not finite before the first check.
    """
    use_compilation_cache()
    how: Any = {"cell_m": cell_m, "lidar": lidar, "rules": rules, "measure": measure}
    trained, watched = (prepare_bank(some, **how) for some in (worlds, validation))
    if model is not None and not isinstance(model, (Model, str, os.PathLike)):
        raise InputError(f"model must be a Model or the path of one, got {type(model).__name__}")
    begins = model if model is None or isinstance(model, Model) else load_model(model)
    options = {"rounds": rounds, "check_every": check_every, "starts": starts, "seed": seed}
    plan = prepare_training(algo, network, trained, watched, settings, model=begins, **options)
    with progress_bar(progress, plan.rounds, "rounds", on_progress) as moved:
        return run_training(plan, workers=workers, on_progress=moved)


def training_inputs(plan: TrainingPlan) -> dict[str, Any]:
    """Return all that the result depends on, as plain values."""
    worlds = {"training": plan.training.worlds, "validation": plan.validation.worlds}
    digests = hashlib.sha256("".join(world_digest(w) for own in worlds.values() for w in own).encode())
    return {
        "version": __version__,
        "algo": plan.algo,
        "network": plan.network,
        "features": list(features.FEATURES),
        "settings": plan.settings._asdict(),
        "begins": weights_digest(plan.begins.weights),
        "devices": jax.local_device_count() if plan.algo == "ppo" else 1,  # brax draws for each of them apart
        **{name: [os.fspath(world.name) for world in own] for name, own in worlds.items()},
        "digests": digests.hexdigest(),
        "lidar": plan.training.lidar,
        "rules": plan.training.rules,
        "measure": plan.training.measure,
        **{name: getattr(plan, name) for name in ("check_every", "starts", "seed")},
    }


def run_training(
    plan: TrainingPlan,
    *,
    ledger: Ledger | None = None,
    workers: int | None = None,
    on_progress: Callable[[int], object] | None = None,
) -> TrainingResult:
    """Train, or continue a training of which the ledger keeps every check, with all that is needed to go on from it.

    Raises:
      KeyboardInterrupt: before the first check.
    """
    trainer = TRAINERS[plan.algo]
    state: Any = trainer.begin(plan.begins.weights, plan.settings)
    tables, ended, kept = [], "rounds", [state.weights]  # the last at every check
    while ledger is not None and len(tables) in ledger.done:
        table = ledger.done[len(tables)]
        tables.append(table[list(CURVE_COLUMNS)])
        state = _unpacked(state, table[STATE].iloc[-1])
        kept.append(state.weights)
    try:
        for unit in range(len(tables), plan.units):
            rows = []
            if unit == 0:
                rows.append((0, math.nan, _validation_ratio(plan, state.weights, workers)))
            for number in range(unit * plan.check_every, (unit + 1) * plan.check_every):
                state, ratio = trainer.make_round(state, plan.network, plan.training, plan.settings, plan.seed, workers)
                rows.append((number + 1, ratio, math.nan))
                if on_progress is not None:
                    on_progress(number + 1)
            if not is_finite(state.weights):
                ended = "not finite"
                break
            rows[-1] = (*rows[-1][:2], _validation_ratio(plan, state.weights, workers))
            table = pd.DataFrame(rows, columns=list(CURVE_COLUMNS))
            if ledger is not None:
                ledger.put(unit, table.assign(**{STATE: [*[b""] * (len(table) - 1), _packed(state)]}))
            tables.append(table)
            kept.append(state.weights)
    except KeyboardInterrupt:
        if not tables:
            raise
        ended = "interrupted"
    if not tables:
        raise InputError("training gave weights that are no finite numbers before the first check: use a lower rate")
    return _trained(plan, tables, kept, ended)


def _trained(plan, tables, kept, ended):
    curve = pd.concat(tables, ignore_index=True)
    checks = [curve["validation"].iloc[0], *(table["validation"].iloc[-1] for table in tables)]
    best = int(np.argmin(checks))
    number = best * plan.check_every
    made = {
        **{"algo": plan.algo, "measure": plan.training.measure, "seed": plan.seed},
        **{"settings": plan.settings._asdict(), "round": number},
        "begins": weights_digest(plan.begins.weights),
        "checks": [
            {"round": i * plan.check_every, "validation": float(ratio), "sha256": weights_digest(weights)}
            for i, (ratio, weights) in enumerate(zip(checks, kept))
        ],
        "training": [os.fspath(world.name) for world in plan.training.worlds],
        "validation": {"worlds": [os.fspath(w.name) for w in plan.validation.worlds], "ratio": float(checks[best])},
        "version": __version__,
    }
    return TrainingResult(Model(plan.network, kept[best], made), curve, number, ended)


def _validation_ratio(plan, weights, workers):
    """Compute the ratio of some weights on the validation worlds."""
    strategy = Strategy("learned", policy_of(Model(plan.network, weights)), True)
    which = [i for i in range(len(plan.validation.worlds)) for _ in range(plan.starts)]
    return float(np.exp(plan.validation.log_ratios([strategy], which, plan.seed, workers=workers).mean()))


def _packed(state) -> bytes:
    from flax import serialization

    return serialization.to_bytes(jax.tree.map(np.asarray, state))


def _unpacked(like, content) -> Any:
    from flax import serialization

    try:
        return serialization.from_bytes(jax.tree.map(np.asarray, like), content)
    except Exception as error:  # msgpack and flax raise many kinds of errors
        raise InputError(f"what training has kept is damaged: {error!r}; begin anew with --overwrite") from error
