"""Training from beginning to end: rounds of a trainer, checks on worlds that it does not train in, what is kept.

pandas and matplotlib are imported by the functions that need them.
"""

import dataclasses
import hashlib
import math
import os
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np

from jexplore.config import MAX_SEED, InputError, require_whole, unknown
from jexplore.learn import es
from jexplore.learn.bank import FAILED, Bank, require_apart
from jexplore.policies import Strategy
from jexplore.policies.learned import features, networks
from jexplore.policies.learned.model import Model
from jexplore.policies.learned.strategy import policy_of
from jexplore.report.ledger import Ledger
from jexplore.studies.results.provenance import digest
from jexplore.version import __version__

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

STATE = "_state"  # column of a unit's file besides: the trainer's state as bytes, in the last row
COLUMNS = ("round", "ratio", "validation")
"""Columns of a curve: rounds made; ratio of the paths driven in the round to the reference's; the same of the present
weights on the validation worlds, where they were checked."""


class Trainer(NamedTuple):
    """A way of training as pure functions of its state, a pytree of arrays."""

    settings: type  # NamedTuple of numbers, with defaults
    begin: Callable[[Any, Any], Any]  # (weights, settings) -> state
    step: Callable[..., tuple[Any, float]]  # see `es.step`
    weights_of: Callable[[Any, Any], Any]  # (state, weights of the same shapes) -> weights


TRAINERS: dict[str, Trainer] = {"es": Trainer(es.Settings, es.begin, es.step, es.weights_of)}
"""Name -> how."""


class Plan(NamedTuple):
    """What is to be trained."""

    algo: str
    network: str
    training: Bank
    validation: Bank
    settings: Any  # of the trainer
    rounds: int
    check_every: int  # rounds from check to check
    patience: int  # checks without a better one, after which training ends; 0: never
    starts: int  # on each validation world
    seed: int

    @property
    def units(self) -> int:
        """Checks."""
        return math.ceil(self.rounds / self.check_every)


@dataclasses.dataclass(frozen=True)
class Trained:
    """What `run_training` found."""

    model: Model
    """The best model by the checks."""
    curve: "pd.DataFrame"
    """One row a round, see `COLUMNS`; the first, of round 0, is of the weights at the beginning."""
    best: int
    """The round that it is from."""
    ended: str
    """Why training ended: "rounds", "patience", "not finite" or "interrupted"."""

    def figure(self) -> "Figure":
        """The curve as a picture."""
        from jexplore.report.plots import training

        return training.figure(self.curve, self.best)


def prepare_training(
    algo: str,
    network: str,
    training: Bank,
    validation: Bank,
    settings: Mapping[str, Any],
    *,
    rounds: int,
    check_every: int,
    patience: int,
    starts: int,
    seed: int,
) -> Plan:
    """A `Plan`, checked.

    Raises:
      InputError: an unknown algorithm, network or setting, a number out of range, a world on both sides.
    """
    if algo not in TRAINERS:
        raise unknown("algorithm", algo, TRAINERS)
    networks.network(network)
    known = TRAINERS[algo].settings()
    for key, value in settings.items():
        if key not in known._fields:
            raise unknown(f"setting of {algo!r}:", key, known._fields)
        default = getattr(known, key)
        good = isinstance(value, (int, float)) and math.isfinite(value) and value > 0
        if not good or (isinstance(default, int) and value != int(value)):
            kind = "a whole number above 0" if isinstance(default, int) else "a number above 0"
            raise InputError(f"{key} must be {kind}, got {value!r}")
    require_apart(training, validation)
    return Plan(
        algo,
        network,
        training,
        validation,
        known._replace(**settings),
        require_whole("rounds", rounds, 1, 10**6),
        require_whole("check_every", check_every, 1, 10**6),
        require_whole("patience", patience, 0, 10**6),
        require_whole("starts", starts, 1, 10**4),
        require_whole("seed", seed, 0, MAX_SEED),
    )


def asked(plan: Plan) -> dict[str, Any]:
    """All that the result depends on, as plain values."""
    worlds = {"training": plan.training.worlds, "validation": plan.validation.worlds}
    digests = hashlib.sha256("".join(digest(w) for own in worlds.values() for w in own).encode())
    return {
        "version": __version__,
        "algo": plan.algo,
        "network": plan.network,
        "features": list(features.NAMES),
        "settings": plan.settings._asdict(),
        **{name: [os.fspath(world.name) for world in own] for name, own in worlds.items()},
        "digests": digests.hexdigest(),
        "lidar": plan.training.lidar,
        "rules": plan.training.rules,
        **{name: getattr(plan, name) for name in ("check_every", "patience", "starts", "seed")},
    }


def run_training(
    plan: Plan,
    *,
    ledger: Ledger | None = None,
    workers: int | None = None,
    on_progress: Callable[[int], object] | None = None,
) -> Trained:
    """Trains, or goes on with training.

    Args:
      plan: `Plan`.
      ledger: where every check is kept, with all that is needed to go on from it.
      workers: cores; by default all.
      on_progress: called with the number of rounds made.

    Raises:
      KeyboardInterrupt: before the first check.
    """
    import pandas as pd

    trainer = TRAINERS[plan.algo]
    like = networks.begin(plan.network, jax.random.key(plan.seed), len(features.NAMES))
    like = jax.tree.map(np.asarray, like)
    state, tables, ended = trainer.begin(like, plan.settings), [], "rounds"
    kept = [state]
    while ledger is not None and len(tables) in ledger.done:
        table = ledger.get(len(tables))
        tables.append(table[list(COLUMNS)])
        kept.append(_unpacked(state, table[STATE].iloc[-1]))
    try:
        for unit in range(len(tables), plan.units):
            if _is_out_of_patience(plan, tables):
                ended = "patience"
                break
            state, rows = kept[-1], []
            if unit == 0:
                rows.append((0, math.nan, _checked(plan, trainer, state, like, workers)))
            for number in range(unit * plan.check_every, min(plan.rounds, (unit + 1) * plan.check_every)):
                state, ratio = trainer.step(state, plan.network, like, plan.training, plan.settings, plan.seed, workers)
                rows.append((number + 1, ratio, math.nan))
                if on_progress is not None:
                    on_progress(number + 1)
            if not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(trainer.weights_of(state, like))):
                ended = "not finite"
                break
            rows[-1] = (*rows[-1][:2], _checked(plan, trainer, state, like, workers))
            table = pd.DataFrame(rows, columns=list(COLUMNS))
            if ledger is not None:
                ledger.put(unit, table.assign(**{STATE: [*[b""] * (len(table) - 1), _packed(state)]}))
            tables.append(table)
            kept.append(state)
    except KeyboardInterrupt:
        if not tables:
            raise
        ended = "interrupted"
    if not tables:
        raise InputError("training gave weights that are no finite numbers before the first check: use a lower rate")
    return _trained(plan, trainer, like, tables, kept, ended)


def _trained(plan, trainer, like, tables, kept, ended):
    import pandas as pd

    curve = pd.concat(tables, ignore_index=True)
    checks = [curve["validation"].iloc[0], *(table["validation"].iloc[-1] for table in tables)]
    best = int(np.argmin(checks))
    number = 0 if best == 0 else int(tables[best - 1]["round"].iloc[-1])
    made = {
        **{"algo": plan.algo, "seed": plan.seed, "settings": plan.settings._asdict(), "round": number},
        "training": [os.fspath(world.name) for world in plan.training.worlds],
        "validation": {"worlds": [os.fspath(w.name) for w in plan.validation.worlds], "ratio": float(checks[best])},
        "version": __version__,
    }
    return Trained(Model(plan.network, trainer.weights_of(kept[best], like), made), curve, number, ended)


def _checked(plan, trainer, state, like, workers):
    """Ratio of the present weights on the validation worlds."""
    strategy = Strategy("learned", policy_of(Model(plan.network, trainer.weights_of(state, like))), True)
    which = [i for i in range(len(plan.validation.worlds)) for _ in range(plan.starts)]
    return float(np.exp(plan.validation.log_ratios([strategy], which, plan.seed, workers=workers).mean()))


def _is_out_of_patience(plan, tables):
    checks = [table["validation"].iloc[-1] for table in tables]
    return bool(plan.patience) and len(checks) - int(np.argmin(checks or [FAILED])) - 1 >= plan.patience


def _packed(state) -> bytes:
    from flax import serialization

    return serialization.to_bytes(jax.tree.map(np.asarray, state))


def _unpacked(like, content):
    from flax import serialization

    try:
        return serialization.from_bytes(jax.tree.map(np.asarray, like), content)
    except Exception as error:  # msgpack and flax raise many kinds of errors
        raise InputError(f"what training has kept is damaged: {error!r}; begin anew with --overwrite") from error
