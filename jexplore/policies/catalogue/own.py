"""Users' strategies: their kind, their parameters, and whether they have been written anew."""

import inspect
import sys
from typing import Any

from jexplore.config import InputError
from jexplore.policies.policy import Policy
from jexplore.users import bare, described

OUTER = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)


def parameters(make: Any) -> dict[str, inspect.Parameter]:
    """Return the keyword parameters of a constructor or score.

    Raises:
      InputError: something whose parameters cannot be read.
    """
    if isinstance(make, Policy):
        return {}
    keyed = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    return {p.name: p for p in _signature(make) if p.kind in keyed and not _is_needed(p)}


def _signature(make):
    try:
        return inspect.signature(make).parameters.values()
    except (TypeError, ValueError):
        what = "expected a name, a function of the view, a constructor or a Policy"
        raise InputError(f"{make!r} is no strategy: {what}") from None


def _is_needed(parameter):
    """Return whether it is a positional argument without a default."""
    return parameter.kind in OUTER and parameter.default is parameter.empty


def is_score(make: Any) -> bool:
    """Return whether a callable is a score: it has a positional argument without a default, the view.

    Raises:
      InputError: it has several.
    """
    if isinstance(make, Policy):
        return False
    needed = [p.name for p in _signature(make) if _is_needed(p)]
    if len(needed) > 1:
        raise InputError(
            f"{described(make)} is no strategy: a score takes one argument, the view, and parameters that have "
            f"defaults, got {', '.join(needed)}"
        )
    return bool(needed)


def is_replaced(thing: Any) -> bool:
    """Return whether the module that defines a function has been imported anew since."""
    module = sys.modules.get(getattr(bare(thing), "__module__", None) or "")
    names = getattr(bare(thing), "__globals__", None)
    return module is not None and names is not None and vars(module) is not names
