"""The grammar of strategies: `name+modifier+...:key=value,...` and `module:name+modifier+...:key=value,...`."""

import inspect
import math
import os
import re
from pathlib import Path
from typing import Any, NamedTuple

from jexplore.arrays.pictures import Listing
from jexplore.config import InputError, require_number, shown, unknown
from jexplore.policies.catalogue.adapt import adapted, policy_from, with_exact_numbers
from jexplore.policies.catalogue.entries import MODIFIERS, SYNONYMS, Entry, entry_of, known_names, source_of
from jexplore.policies.catalogue.own import parameters
from jexplore.policies.policy import Policy, Strategy
from jexplore.policies.room_wise import KINDS, segmented
from jexplore.users import described, import_object, name_of

REQUIRED = inspect.Parameter.empty
_FOREIGN = re.compile(r"(?P<module>[A-Za-z_][\w.]*):(?P<name>[A-Za-z_]\w*)(?=$|[+:])")


def _defaults(make):
    """Return keyword parameters with their defaults: dict; `inspect.Parameter.empty` without one."""
    return {key: p.default for key, p in parameters(make).items()}


def parameters_of(name: str) -> dict[str, Any]:
    """Return the parameters of a strategy and their defaults, from its constructor's signature: dict.

    Raises:
      InputError: no such strategy.
    """
    entry = entry_of(name)
    if entry is None:
        raise unknown("strategy", name, known_names())
    return _defaults(entry.make)


class Listed(NamedTuple):
    """A line of the list of strategies."""

    name: str
    summary: str
    parameters: str
    source: str


def listing() -> list[Listed]:
    """List all named strategies, those of packages included; one that does not load says why."""
    lines = []
    for name in known_names():
        try:
            entry = entry_of(name)
            assert entry is not None
            own = _defaults(entry.make)
        except InputError as error:
            lines.append(Listed(name, str(error), "", ""))
        else:
            told = ", ".join(key if value is REQUIRED else f"{key}={value}" for key, value in own.items())
            lines.append(Listed(name, entry.summary, told, source_of(entry)))
    return lines


def strategies() -> Listing:
    """List all named strategies with their parameters, as a table that shows itself."""
    rows = tuple((one.name, one.summary, one.parameters or "-", one.source) for one in listing())
    return Listing(("strategy", "goes to", "parameters", "source"), rows)


def _modifier_parameters(modifiers):
    """Return the parameters that modifiers add to those of the strategy, with their defaults: dict."""
    if "segment" not in modifiers:
        return {}
    found = _defaults(segmented)
    return {key: found[key] for key in KINDS[modifiers["segment"] or "holz"]}


def _modifiers(words, text):
    """Parse modifiers and their values after `=`: dict; None for nothing."""
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
    """Parse parameters from `key=value,...`: dict."""
    given = {}
    for item in tail.split(",") if tail else ():
        key, equals, value = item.partition("=")
        if key not in allowed:
            raise unknown(f"parameter of {head!r}:", key, allowed)
        if not equals or key in given:
            kind = "NUMBER" if isinstance(allowed[key], int | float) else "VALUE"
            raise InputError(f"expected {key}={kind} once in {text!r}, got {item!r}")
        given[key] = _value(key, value, allowed[key], text)
    return given


def _modified(policy, modifiers, more):
    return segmented(policy, modifiers["segment"] or "holz", **more) if "segment" in modifiers else policy


def _unknown(name, rest):
    """Return the error for an unknown name; for a file it tells how its module is named."""
    if re.fullmatch(r":[A-Za-z_]\w*([+:].*)?", rest):
        module = Path(name).stem
        return InputError(f"{name!r} is no module: one in this folder or installed is named like {module}{rest}")
    if name.endswith(".py"):
        return InputError(f"unknown strategy {name!r}: a function of {name} is named like {Path(name).stem}:function")
    if os.path.isfile(f"{name}.py"):
        return InputError(f"unknown strategy {name!r}: a function of {name}.py is named like {name}:function")
    return unknown("strategy", name, known_names(), SYNONYMS)


def parse_strategy(text: str) -> Strategy:
    """Make a strategy from its name.

    Args:
      text: `name+modifier+...:key=value,...`, such as `closest+recheck`, or `module:name+...` for one in a module that
        can be imported or lies in the current folder.

    Returns:
      `Strategy`.

    Raises:
      InputError: unknown name, modifier or parameter, a modifier given twice, a value of the wrong kind, a module that
        does not import, something in it that is no strategy.
    """
    foreign = _FOREIGN.match(text)
    if foreign and not foreign["module"].endswith(".py") and entry_of(foreign["module"]) is None:
        entry: Entry | None = Entry(import_object(foreign["module"], foreign["name"]), is_own=True)
        name, rest = foreign[0], text[foreign.end() :]
    else:
        match = re.match(r"[^+:]*", text)
        name = match[0] if match else ""
        entry, rest = entry_of(name), text[len(name) :]
    if entry is None:
        raise _unknown(name, rest)
    words, colon, tail = rest.partition(":")
    modifiers = _modifiers(words.split("+")[1:], text)
    own = _defaults(entry.make)
    more = _modifier_parameters(modifiers)
    _require_apart(entry.make, own, more)
    if colon and not tail:
        raise InputError(f"expected key=value after the colon in {text!r}")
    given = _given(tail, own | more, name + words, text)
    mine = {key: value for key, value in given.items() if key in own}
    policy = policy_from(entry.make, mine) if entry.is_own else entry.make(**mine)
    policy = _modified(policy, modifiers, {key: value for key, value in given.items() if key not in own})
    return with_exact_numbers(Strategy(text, policy, "recheck" in modifiers))


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
        return parse_strategy(what) if isinstance(what, str) else _checked(what)
    if not isinstance(recheck, bool) or not isinstance(segment, (bool, str)):
        raise InputError(f"recheck must be True or False and segment also a kind, got {recheck!r} and {segment!r}")
    kind = {True: "holz", False: None}[segment] if isinstance(segment, bool) else segment
    if kind is not None and kind not in KINDS:
        raise unknown("kind of segment:", kind, KINDS)
    own, base = _defaults(what), name_of(what)
    if name is None and base is None:
        raise InputError(f"{described(what)} has no name: jx.strategy(..., name=...)")
    _require_name(base if name is None else name)
    _require_apart(what, own, {"name", "recheck", "segment", *(KINDS[kind] if kind else ())})
    words = ("+recheck" if recheck else "") + (f"+segment={kind}" if kind else "")
    of_rooms = {key for key in (KINDS[kind] if kind else ()) if key not in own}
    policy = _modified(
        policy_from(what, {key: value for key, value in given.items() if key not in of_rooms}),
        {"segment": kind} if kind else {},
        {key: value for key, value in given.items() if key in of_rooms},
    )
    made = with_exact_numbers(Strategy(name or f"{base}{words}", policy, recheck))
    tail = ",".join(
        f"{key}={shown(value) if isinstance(value, int) else value}"
        for key, value in given.items()
        if isinstance(value, (int, float, str, os.PathLike))
    )
    return made if name or not tail else made._replace(name=f"{made.name}:{tail}")


def _require_apart(make, own, others):
    """Refuse parameters that would be taken for those of the modifiers."""
    for key in own:
        if key in others:
            raise InputError(f"{described(make)} has a parameter {key!r}, which is one of the modifiers': rename it")


def _require_name(name):
    if not isinstance(name, str) or not name.strip():
        raise InputError(f"a strategy's name must be text, got {name!r}")


def _checked(given):
    """Check a `Strategy` made or kept by a user, and bring its functions up to date."""
    _require_name(given.name)
    if not isinstance(given.policy, Policy):
        raise InputError(f"strategy {given.name!r}: policy must be a Policy, got {type(given.policy).__name__}")
    return with_exact_numbers(given._replace(policy=adapted(given.policy)))
