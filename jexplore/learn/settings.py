"""Numbers of the ways of training. Plain Python: importing this loads neither jax nor numpy."""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from jexplore.config import InputError, require_number, require_whole, unknown


class Es(NamedTuple):
    """Numbers of `es`."""

    pairs: int = 12  # antithetic pairs of a generation
    episodes: int = 16  # worlds that each member explores
    sigma: float = 0.15  # standard deviation of a variation
    rate: float = 0.07  # of Adam
    latest: float = 0.15  # share of the latest generation in the running mean


class Ppo(NamedTuple):
    """Numbers of `ppo`."""

    decisions: int = 16_384  # of a round, at least; a round is traced anew, and compiled if it never was
    lanes: int = 16  # episodes at a time
    starts: int = 16  # of the bank, in each world
    unroll: int = 16  # decisions of a lane that an advantage is estimated from
    minibatches: int = 4
    updates: int = 4  # passes over what was seen
    rate: float = 3e-4  # of Adam
    entropy: float = 1e-3
    sharpness: float = 10.0  # ratio of logits and scores
    gae: float = 0.95  # lambda of the advantages; nothing is discounted
    clip: float = 0.2


TRAINER_SETTINGS = {"es": Es, "ppo": Ppo}
"""Name of a way of training -> its numbers, with their defaults."""
SETTING_BOUNDS: dict[str, dict[str, tuple[float, float]]] = {
    "es": {
        "pairs": (1, 10_000), "episodes": (1, 100_000), "sigma": (1e-6, 10.0), "rate": (1e-6, 10.0),
        "latest": (1e-6, 1.0),
    },
    "ppo": {
        "decisions": (1, 10**9), "lanes": (1, 4096), "starts": (1, 10_000), "unroll": (1, 4096),
        "minibatches": (1, 4096), "updates": (1, 1000), "rate": (1e-9, 1.0), "entropy": (0.0, 10.0),
        "sharpness": (1e-3, 1e4), "gae": (0.0, 1.0), "clip": (1e-3, 1.0),
    },
}  # fmt: skip
"""Name of a way of training -> least and largest value of each number."""


def trainer_settings(algo: str, given: Mapping[str, Any]) -> Any:
    """Return the numbers of a way of training, some of them given: its record of `TRAINER_SETTINGS`.

    Raises:
      InputError: an unknown way or number, or one out of range.
    """
    if algo not in TRAINER_SETTINGS:
        raise unknown("algorithm", algo, TRAINER_SETTINGS)
    known, found = TRAINER_SETTINGS[algo](), {}
    for key, value in given.items():
        if key not in known._fields:
            raise unknown(f"setting of {algo!r}:", key, known._fields)
        low, high = SETTING_BOUNDS[algo][key]
        if isinstance(getattr(known, key), int):
            found[key] = require_whole(key, value, int(low), int(high))
        else:
            require_number(key, value, low=low, high=high)
            found[key] = float(value)
    return known._replace(**found)


def parse_settings(items: Iterable[str]) -> dict[str, float]:
    """Parse texts `name=number` to `{name: number}`.

    Raises:
      InputError: another text, or a name that is there twice.
    """
    found = {}
    for item in items:
        name, equals, value = item.partition("=")
        try:
            number = float(value)
        except ValueError:
            number = None
        if not equals or number is None or name in found:
            raise InputError(f"expected NAME=NUMBER once in --set, got {item!r}")
        found[name] = int(number) if number.is_integer() else number
    return found


def require_names_apart(training: Iterable[str], validation: Iterable[str]) -> None:
    """Refuse validation worlds that are training worlds."""
    for name in sorted({*training} & {*validation}):
        raise InputError(f"world {name!r} is in both the training and the validation worlds")


def require_rounds(rounds: int, check_every: int) -> int:
    """Return the rounds from check to check: `check_every`, or all where there are fewer.

    Raises:
      InputError: the rounds are no multiple of this.
    """
    check_every = min(check_every, rounds)
    if rounds % check_every:
        raise InputError(f"rounds must be a multiple of check_every, {check_every}, got {rounds}")
    return check_every
