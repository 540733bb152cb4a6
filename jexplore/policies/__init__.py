"""Strategies by name, and the grammar of their names: `name+modifier+...:key=value,...`.

A strategy is one file with one constructor that returns a `Policy`. To add one: write the file, add a line to
`STRATEGIES`, a test, and a line to the changelog.
"""

import inspect
import math
from typing import NamedTuple

from jexplore.config import InputError, require_number, unknown
from jexplore.policies.closest import closest
from jexplore.policies.decision_theoretic import decision_theoretic
from jexplore.policies.distance_advantage import distance_advantage
from jexplore.policies.gain_rate import gain_rate
from jexplore.policies.mcdm import mcdm
from jexplore.policies.policy import Entry, Policy
from jexplore.policies.room_wise import KINDS, segmented
from jexplore.policies.tour import tour
from jexplore.policies.uniform import uniform
from jexplore.policies.utility import utility

STRATEGIES = {
    "closest": Entry(closest, "the frontier cell with the shortest path", "Yamauchi 1997; Holz et al. 2010, Figure 3"),
    "random": Entry(
        uniform, "a frontier cell drawn uniformly from the reachable ones", "Holz et al. 2010, section 3.2"
    ),
    "decision-theoretic": Entry(
        decision_theoretic,
        "the sampled view point with the most information, discounted by the path",
        "Gonzalez-Banos and Latombe 2002; Holz et al. 2010, section 3.2",
    ),
    "gain-rate": Entry(
        gain_rate, "the sampled view point with the most information for a metre of path", "Schmid et al. 2020"
    ),
    "utility": Entry(
        utility,
        "the frontier cluster with the most unknown area in sight less beta times the path",
        "Burgard et al. 2005",
    ),
    "distance-advantage": Entry(
        distance_advantage, "the frontier cluster near to the robot and far from the others", "Ericson et al. 2025"
    ),
    "tour": Entry(
        tour, "the first stop of a short route through all frontier clusters", "Osswald et al. 2016; Croes 1958"
    ),
    "mcdm": Entry(
        mcdm,
        "the frontier cluster with the best Choquet integral of unknown area, path and known area",
        "Basilico and Amigoni 2011",
    ),
}
MODIFIERS = {
    "recheck": "give up a target as soon as it is no longer live, and choose anew (Holz et al. 2010, section 2.3)",
    "segment": "frontier cells in the robot's own room first; =thrun, =wurm, =holz (default) say how rooms are found, "
    "=auto only in rooms, not in corridors and halls (Holz et al. 2010, section 2.4)",
}


class Strategy(NamedTuple):
    """A strategy as asked for: `name` is verbatim."""

    name: str
    policy: Policy
    recheck: bool


def _numbers(make):
    """Numbers that a constructor takes, with their defaults: dict."""
    parameters = inspect.signature(make).parameters.values()
    return {p.name: p.default for p in parameters if isinstance(p.default, int | float)}


def parameters_of(name):
    """Parameters of a strategy and their defaults, from its constructor's signature: dict of numbers."""
    return _numbers(STRATEGIES[name].make)


def _modifier_parameters(modifiers):
    """Parameters that modifiers add to those of the strategy, with their defaults: dict."""
    if "segment" not in modifiers:
        return {}
    found = _numbers(segmented)
    return found if modifiers["segment"] == "auto" else {key: found[key] for key in ("prominence_m", "gamma")}


def _modifiers(words, text):
    """Modifiers and what stands behind their `=`: dict; None for nothing."""
    given = {}
    for word in words:
        name, equals, kind = word.partition("=")
        if name not in MODIFIERS:
            raise unknown(f"modifier in {text!r}:", name, MODIFIERS)
        if name in given:
            raise InputError(f"modifier {name!r} is given twice in {text!r}")
        if equals and name != "segment":
            raise InputError(f"modifier {name!r} takes no value, got {word!r}")
        if equals and kind not in KINDS:
            raise unknown(f"kind of {name!r}:", kind, KINDS)
        given[name] = kind if equals else None
    return given


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
    name, *words = head.split("+")
    if name not in STRATEGIES:
        raise unknown("strategy", name, STRATEGIES)
    modifiers = _modifiers(words, text)
    own, allowed, given = parameters_of(name), parameters_of(name), {}
    allowed |= _modifier_parameters(modifiers)
    if colon and not tail:
        raise InputError(f"expected key=value after the colon in {text!r}")
    for item in tail.split(",") if tail else ():
        key, equals, value = item.partition("=")
        if key not in allowed:
            raise unknown(f"parameter of {head!r}:", key, allowed)
        if not equals or key in given:
            raise InputError(f"expected {key}=NUMBER once in {text!r}, got {item!r}")
        try:
            number = float(value)
        except ValueError:
            raise InputError(f"expected a number for {key} in {text!r}, got {value!r}") from None
        whole = isinstance(allowed[key], int) and number.is_integer()
        given[key] = require_number(key, int(number) if whole else number, low=-math.inf)
    policy = STRATEGIES[name].make(**{key: value for key, value in given.items() if key in own})
    if "segment" in modifiers:
        more = {key: value for key, value in given.items() if key not in own}
        policy = segmented(policy, modifiers["segment"] or "holz", **more)
    return Strategy(name=text, policy=policy, recheck="recheck" in modifiers)
