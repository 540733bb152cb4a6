"""Numbers of the ways of training. Plain Python: importing this loads neither jax nor numpy."""

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, NamedTuple, get_type_hints

from jexplore.config import InputError, require_number, require_whole, unknown


class Es(NamedTuple):
    """Numbers of `es`, each with its least and largest value."""

    pairs: Annotated[int, 1, 10_000] = 12  # antithetic pairs of a generation
    episodes: Annotated[int, 1, 100_000] = 16  # worlds that each member explores
    sigma: Annotated[float, 1e-6, 10.0] = 0.15  # standard deviation of a variation
    rate: Annotated[float, 1e-6, 10.0] = 0.07  # of Adam
    latest: Annotated[float, 1e-6, 1.0] = 0.15  # share of the latest generation in the running mean


class Ppo(NamedTuple):
    """Numbers of `ppo`, each with its least and largest value."""

    decisions: Annotated[int, 1, 10**9] = 16_384  # of a round, at least; a round is traced anew
    lanes: Annotated[int, 1, 4096] = 16  # episodes at a time
    starts: Annotated[int, 1, 10_000] = 16  # of the bank, in each world
    unroll: Annotated[int, 1, 4096] = 16  # decisions of a lane that an advantage is estimated from
    minibatches: Annotated[int, 1, 4096] = 4
    updates: Annotated[int, 1, 1000] = 4  # passes over what was seen
    rate: Annotated[float, 1e-9, 1.0] = 3e-4  # of Adam
    entropy: Annotated[float, 0.0, 10.0] = 1e-3
    sharpness: Annotated[float, 1e-3, 1e4] = 10.0  # ratio of logits and scores
    gae: Annotated[float, 0.0, 1.0] = 0.95  # lambda of the advantages; nothing is discounted
    clip: Annotated[float, 1e-3, 1.0] = 0.2


TRAINER_SETTINGS = {"es": Es, "ppo": Ppo}
"""Name of a way of training -> its numbers, with their defaults."""


def trainer_settings(algo: str, given: Mapping[str, Any]) -> Any:
    """Return the numbers of a way of training, some of them given; refuse unknown ones and those out of range."""
    if algo not in TRAINER_SETTINGS:
        raise unknown("algorithm", algo, TRAINER_SETTINGS)
    known, found = TRAINER_SETTINGS[algo](), {}
    kinds = get_type_hints(TRAINER_SETTINGS[algo], include_extras=True)
    for key, value in given.items():
        if key not in known._fields:
            raise unknown(f"setting of {algo!r}:", key, known._fields)
        low, high = kinds[key].__metadata__
        if isinstance(getattr(known, key), int):
            found[key] = require_whole(key, value, low, high)
        else:
            require_number(key, value, low=low, high=high)
            found[key] = float(value)
    return known._replace(**found)


def parse_settings(items: Iterable[str]) -> dict[str, float]:
    """Parse texts `name=number` to `{name: number}`; refuse other texts, and a name that is there twice."""
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


def require_rounds(rounds: int, check_every: int) -> int:
    """Return the rounds from check to check, of which `rounds` must be a multiple: `check_every`, or all if fewer."""
    check_every = min(check_every, rounds)
    if rounds % check_every:
        raise InputError(f"rounds must be a multiple of check_every, {check_every}, got {rounds}")
    return check_every
