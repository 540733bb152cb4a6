"""The grammar of strategies: `name+modifier+...:key=value,...` and `module:name+modifier+...:key=value,...`."""

import math
import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from jexplore.arrays.pictures import Listing
from jexplore.config import InputError, require_number, shown, unknown
from jexplore.policies.catalogue import entries
from jexplore.policies.catalogue.adapt import adapted, policy_from, with_exact_numbers
from jexplore.policies.catalogue.entries import MODIFIERS, REQUIRED, SYNONYMS, parameters
from jexplore.policies.policy import Policy, Span, Strategy
from jexplore.policies.room_wise import KINDS, segmented
from jexplore.users import described, import_object, name_of, place_of

_FOREIGN = re.compile(r"(?P<module>[A-Za-z_][\w.]*):(?P<name>[A-Za-z_]\w*)(?=$|[+:])")


def strategies() -> Listing:
    """List all named strategies with their parameters."""
    rows = []
    for name, entry in entries.STRATEGIES.items():
        own = parameters(entry.make).items()
        told = ", ".join(key if value is REQUIRED else f"{key}={value}" for key, value in own)
        rows.append((name, entry.summary, told or "-", entry.source or place_of(entry.make)))
    return Listing(("strategy", "goes to", "parameters", "source"), tuple(rows))


def _modifiers(words, text):
    """Parse modifiers: name -> its value, None for nothing."""
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
        given[name] = (kind if equals else "holz") if name == "segment" else None
    return given


def _value(key, value, default, text):
    """Parse a parameter by the kind of its default: number, bool, text or path."""
    if isinstance(default, bool):
        if value.lower() not in ("true", "false"):
            raise InputError(f"expected true or false for {key} in {text!r}, got {value!r}")
        return value.lower() == "true"
    if isinstance(default, (str, os.PathLike)):
        return Path(value) if isinstance(default, os.PathLike) else value
    try:
        number = float(value)
    except ValueError:
        if not isinstance(default, int | float):  # no default to go by
            return value
        raise InputError(f"expected a number for {key} in {text!r}, got {value!r}") from None
    whole = not isinstance(default, float) and number.is_integer()
    return require_number(key, int(number) if whole else number, low=-math.inf)


def _given(tail, allowed, head, text):
    """Parse parameters from `key=value,...`."""
    given = {}
    for item in tail.split(",") if tail else ():
        key, equals, value = item.partition("=")
        if key not in allowed:
            raise unknown(f"parameter of {head!r}:", key, allowed)
        if not equals or key in given:
            is_number = isinstance(allowed[key], int | float) and not isinstance(allowed[key], bool)
            kind = "NUMBER" if is_number else "VALUE"
            raise InputError(f"expected {key}={kind} once in {text!r}, got {item!r}")
        given[key] = _value(key, value, allowed[key], text)
    return given


def _unknown(name, rest):
    """Return the error for an unknown name; for a file it tells how its module is named."""
    if re.fullmatch(r":[A-Za-z_]\w*([+:].*)?", rest):
        module = Path(name).stem
        return InputError(f"{name!r} is no module: one in this folder or installed is named like {module}{rest}")
    if name.endswith(".py"):
        return InputError(f"unknown strategy {name!r}: a function of {name} is named like {Path(name).stem}:function")
    if os.path.isfile(f"{name}.py"):
        return InputError(f"unknown strategy {name!r}: a function of {name}.py is named like {name}:function")
    return unknown("strategy", name, entries.STRATEGIES, SYNONYMS)


def _build(
    name: str, make: Any, given: Mapping[str, Any], modifiers: Mapping[str, str | None], taken: Iterable[str] = ()
) -> Strategy:
    """Make a strategy; parameters of its function called like those `taken`, or like a modifier's, are refused."""
    kind = modifiers.get("segment")
    of_rooms = KINDS[kind] if kind else ()
    for key in parameters(make):
        if key in taken or key in of_rooms:
            raise InputError(f"{described(make)} has a parameter {key!r}, which is one of the modifiers': rename it")
    policy = policy_from(make, {key: value for key, value in given.items() if key not in of_rooms})
    if kind:
        policy = segmented(policy, kind, **{key: value for key, value in given.items() if key in of_rooms})
    return with_exact_numbers(Strategy(name, policy, "recheck" in modifiers))


def _parsed(text):
    """Parse a strategy's text: its function, modifiers, parameters with their defaults, and those that it gives."""
    foreign = _FOREIGN.match(text)
    if foreign and not foreign["module"].endswith(".py") and foreign["module"] not in entries.STRATEGIES:
        make, name = import_object(foreign["module"], foreign["name"]), foreign[0]
    else:
        name = re.split("[+:]", text, maxsplit=1)[0]
        if name not in entries.STRATEGIES:
            raise _unknown(name, text[len(name) :])
        make = entries.STRATEGIES[name].make
    words, colon, tail = text[len(name) :].partition(":")
    modifiers = _modifiers(words.split("+")[1:], text)
    if colon and not tail:
        raise InputError(f"expected key=value after the colon in {text!r}")
    of_rooms = KINDS[modifiers["segment"]] if "segment" in modifiers else ()
    allowed = parameters(make) | {key: value for key, value in parameters(segmented).items() if key in of_rooms}
    return make, modifiers, allowed, _given(tail, allowed, name + words, text)


def search_space(text: str) -> dict[str, tuple[Span, Any]]:
    """Return the parameters of a strategy that have bounds and are not given: name -> (bounds, default)."""
    make, _, allowed, given = _parsed(text)
    hints = segmented.__annotations__ | getattr(make, "__annotations__", {})
    own = {key: getattr(hints.get(key), "__metadata__", ()) for key in allowed if key not in given}
    return {key: (one, allowed[key]) for key, data in own.items() for one in data if isinstance(one, Span)}


def parse_strategy(text: str) -> Strategy:
    """Make a strategy from its name.

    `text`: `name+modifier+...:key=value,...`, such as `closest+recheck`, or `module:name+...` for one in a module that
    can be imported or lies in the current folder.
    """
    make, modifiers, _, given = _parsed(text)
    return _build(text, make, given, modifiers)


def strategy(
    what: Any, *, name: str | None = None, recheck: bool = False, segment: str | bool = False, **given: Any
) -> Strategy:
    """Make a strategy from anything that stands for one.

    Args:
      what: a name as `parse_strategy` reads it; a function of the view that returns a score for every cell; a
        constructor, which returns a `Policy`; a `Policy`; or a `Strategy`, whose functions are taken as they are now.
      name: what tables call it; by default the function's own name, with modifiers and parameters as in a name.
      recheck: whether a target is given up as soon as it is no longer live. Not for names, which say so themselves.
      segment: one of `KINDS`, or True for "holz": frontier cells in the robot's own room first. Not for names.
      **given: parameters of the function or constructor.

    Returns:
      `Strategy`.

    Raises:
      InputError: something that is no strategy or has no name; a parameter that it does not take.
    """
    if isinstance(what, (Strategy, str)):
        if name is not None or recheck or segment or given:
            raise InputError(f"{getattr(what, 'name', what)!r} says itself how it is modified: give nothing else")
        return parse_strategy(what) if isinstance(what, str) else _checked_strategy(what)
    if not isinstance(recheck, bool) or not isinstance(segment, (bool, str)):
        raise InputError(f"recheck must be True or False and segment also a kind, got {recheck!r} and {segment!r}")
    kind = {True: "holz", False: None}[segment] if isinstance(segment, bool) else segment
    if kind is not None and kind not in KINDS:
        raise unknown("kind of segment:", kind, KINDS)
    parameters(what)  # refuses anything else
    base = name_of(what)
    if name is None and base is None:
        raise InputError(f"{described(what)} has no name: jx.strategy(..., name=...)")
    _require_name(base if name is None else name)
    modifiers = ({"recheck": None} if recheck else {}) | ({"segment": kind} if kind else {})
    if name is None:
        name = "+".join([base or "", *(f"{key}={value}" if value else key for key, value in modifiers.items())])
        told = {k: v for k, v in given.items() if isinstance(v, (int, float, str, os.PathLike))}
        tail = ",".join(f"{key}={shown(value) if isinstance(value, int) else value}" for key, value in told.items())
        name = f"{name}:{tail}" if tail else name
    return _build(name, what, given, modifiers, ("name", "recheck", "segment"))


def _require_name(name):
    if not isinstance(name, str) or not name.strip():
        raise InputError(f"a strategy's name must be text, got {name!r}")


def _checked_strategy(given):
    """Check a `Strategy` made or kept by a user, and bring its functions up to date."""
    _require_name(given.name)
    if not isinstance(given.policy, Policy):
        raise InputError(f"strategy {given.name!r}: policy must be a Policy, got {type(given.policy).__name__}")
    return with_exact_numbers(given._replace(policy=adapted(given.policy)))
