"""Strategies by name, and the grammar of their names: `name+modifier+...:key=value,...`.

A strategy is one file with one constructor that returns a `Policy`. To add one: write the file, add a line to
`STRATEGIES`, a test, and a line to the changelog.
"""

import difflib
import inspect
from typing import NamedTuple

from jexplore.config import InputError, require_number
from jexplore.policies.closest import closest
from jexplore.policies.record import Entry, Policy
from jexplore.policies.uniform import uniform

STRATEGIES = {
    "closest": Entry(closest, "the frontier cell with the shortest path", "Yamauchi 1997; Holz et al. 2010, Figure 3"),
    "random": Entry(
        uniform, "a frontier cell drawn uniformly from the reachable ones", "Holz et al. 2010, section 3.2"
    ),
}
MODIFIERS = {
    "recheck": "give up a target as soon as it is no longer live, and choose anew (Holz et al. 2010, section 2.3)",
}


class Strategy(NamedTuple):
    """A strategy as asked for: `name` is verbatim."""

    name: str
    policy: Policy
    recheck: bool


def unknown(kind, word, known):
    """The error for a word that is not among those known: says which exist and which was probably meant."""
    near = difflib.get_close_matches(word, list(known), n=1, cutoff=0.5)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    have = ", ".join(known) if known else "none"
    return InputError(f"unknown {kind} {word!r}{hint} (there are: {have})")


def parameters_of(name):
    """Parameters of a strategy and their defaults, from its constructor's signature: dict of numbers."""
    return {p.name: p.default for p in inspect.signature(STRATEGIES[name].make).parameters.values()}


def parse_strategy(text):
    """A strategy from its name.

    Args:
      text: `name+modifier+...:key=value,...`, such as `closest+recheck`.

    Returns:
      `Strategy`.

    Raises:
      InputError: unknown name, modifier or parameter, a modifier given twice, a value that is not a number.
    """
    head, colon, tail = text.partition(":")
    name, *modifiers = head.split("+")
    if name not in STRATEGIES:
        raise unknown("strategy", name, STRATEGIES)
    for modifier in modifiers:
        if modifier not in MODIFIERS:
            raise unknown(f"modifier in {text!r}:", modifier, MODIFIERS)
        if modifiers.count(modifier) > 1:
            raise InputError(f"modifier {modifier!r} is given twice in {text!r}")
    allowed, given = parameters_of(name), {}
    if colon and not tail:
        raise InputError(f"expected key=value after the colon in {text!r}")
    for item in tail.split(",") if tail else ():
        key, equals, value = item.partition("=")
        if key not in allowed:
            raise unknown(f"parameter of {name!r}:", key, allowed)
        if not equals or key in given:
            raise InputError(f"expected {key}=NUMBER once in {text!r}, got {item!r}")
        try:
            number = float(value)
        except ValueError:
            raise InputError(f"expected a number for {key} in {text!r}, got {value!r}") from None
        given[key] = require_number(
            key, int(number) if isinstance(allowed[key], int) and number.is_integer() else number
        )
    return Strategy(name=text, policy=STRATEGIES[name].make(**given), recheck="recheck" in modifiers)
