"""The list of strategies: this package's, and those that a user has registered."""

import functools
import inspect
import re
import sys
from collections.abc import Callable
from typing import Any, TypeVar, overload

from jexplore.config import InputError, checked_names
from jexplore.policies.closest import closest
from jexplore.policies.distance_advantage import distance_advantage, small_first
from jexplore.policies.learned.strategy import learned
from jexplore.policies.mcdm import mcdm
from jexplore.policies.peers.consistent_tour import consistent_tour
from jexplore.policies.peers.exploration_transform import exploration_transform
from jexplore.policies.peers.mutual_information import mutual_information
from jexplore.policies.peers.nearest_region import nearest_region
from jexplore.policies.peers.random_tree import random_tree
from jexplore.policies.peers.revenue import revenue
from jexplore.policies.policy import Entry, Policy
from jexplore.policies.tour import tour
from jexplore.policies.uniform import uniform
from jexplore.policies.utility import utility
from jexplore.policies.views import decision_theoretic, gain_rate
from jexplore.users import bare, described

REQUIRED = inspect.Parameter.empty  # default of a parameter without one
STRATEGY_NAME = r"[A-Za-z_][\w.-]*"

STRATEGIES: dict[str, Entry] = {
    "closest": Entry(closest, "the frontier cell with the shortest path", "Holz et al. 2010, Figure 3"),
    "nearest-region": Entry(
        nearest_region,
        "the centroid of the nearest frontier region that is at least as large as the robot",
        "Yamauchi 1997",
    ),
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
    "random-tree": Entry(
        random_tree,
        "the first node of the branch of a random tree with the most unknown area in sight, discounted by the path",
        "Bircher et al. 2016, NBVP",
    ),
    "utility": Entry(
        utility,
        "the frontier cluster with the most unknown area in sight less beta times the path",
        "after Stachniss and Burgard 2003",
    ),
    "revenue": Entry(
        revenue,
        "the frontier cluster with the most unknown area round it, near ones counted twice, less the distance",
        "Umari and Mukhopadhyay 2017",
    ),
    "exploration-transform": Entry(
        exploration_transform,
        "the frontier cell to which the way is the shortest and safest, along that way",
        "Wirth and Pellenz 2007",
    ),
    "mutual-information": Entry(
        mutual_information,
        "the frontier cluster whose look-around tells most about the map for a metre of path",
        "Zhang et al. 2020, FSMI; Charrow et al. 2015",
    ),
    "distance-advantage": Entry(
        distance_advantage, "the frontier cluster near to the robot and far from the others", "Ericson et al. 2025"
    ),
    "small-first": Entry(
        small_first,
        "the frontier cluster that is near, shows little, and is far from where much is unknown",
        "jexplore, after Ericson et al. 2025",
    ),
    "tour": Entry(
        tour, "the first stop of a short route through all frontier clusters", "after Kulich et al. 2011; Croes 1958"
    ),
    "consistent-tour": Entry(
        consistent_tour,
        "the first stop of a short route through all frontier clusters that begins straight ahead",
        "Zhou et al. 2021, FUEL",
    ),
    "learned": Entry(
        learned, "the frontier cluster that a trained network scores highest", "jexplore; Cao et al. 2023, ARiADNE"
    ),
    "mcdm": Entry(
        mcdm,
        "the frontier cluster with the best Choquet integral of unknown area, path and known area",
        "after Basilico and Amigoni 2011",
    ),
}
"""Name -> entry of the strategy. `register` adds to it."""
MODIFIERS: dict[str, str] = {
    "recheck": "give up a target as soon as it is no longer live, and choose anew (Holz et al. 2010, section 2.3)",
    "segment": "frontier cells in the robot's own room first; =thrun, =wurm, =holz (default), =voronoi say how rooms "
    "are found, =auto (as holz) and =rooms (as voronoi) only in rooms, not in corridors and halls (Holz et al. 2010, "
    "section 2.4)",
}
"""Name -> what it does to a strategy."""

SYNONYMS: dict[str, str] = {
    "burgard": "closest",
    "cost-utility": "utility",
    "drl": "learned",
    "frontier": "closest",
    "fsmi": "mutual-information",
    "fuel": "consistent-tour",
    "greedy": "closest",
    "hector": "exploration-transform",
    "information-gain": "decision-theoretic",
    "nbv": "decision-theoretic",
    "nbvp": "random-tree",
    "nearest": "closest",
    "nearest-frontier": "closest",
    "next-best-view": "decision-theoretic",
    "rl": "learned",
    "rrt": "revenue",
    "tsp": "tour",
    "uniform": "random",
    "yamauchi": "nearest-region",
}
"""Name of a strategy elsewhere -> its name here, for messages."""

_Thing = TypeVar("_Thing")


def _read(make):
    """Return the keyword parameters of a score or constructor, and whether it is a score, which needs a view."""
    if isinstance(make, Policy):
        return {}, False
    try:
        found = inspect.signature(make).parameters.values()
    except (TypeError, ValueError):
        what = "expected a name, a function of the view, a constructor or a Policy"
        raise InputError(f"{make!r} is no strategy: {what}") from None
    keyed = [p for p in found if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
    needed = [p.name for p in found if p.kind <= p.POSITIONAL_OR_KEYWORD and p.default is REQUIRED]
    if len(needed) > 1:
        raise InputError(
            f"{described(make)} is no strategy: a score takes one argument, the view, and parameters that have "
            f"defaults, got {', '.join(needed)}"
        )
    return {p.name: p.default for p in keyed if p.name not in needed}, bool(needed)


def parameters(make: Any) -> dict[str, Any]:
    """Return the keyword parameters of a constructor or score -> their defaults, `REQUIRED` for none."""
    return _read(make)[0]


def is_score(make: Any) -> bool:
    """Return whether something is a score: it has one positional argument without a default, the view."""
    return _read(make)[1]


def _is_replaced(thing):
    """Return whether the module that defines a function has been imported anew since."""
    module = sys.modules.get(getattr(bare(thing), "__module__", None) or "")
    names = getattr(bare(thing), "__globals__", None)
    return module is not None and names is not None and vars(module) is not names


@overload
def register(
    name: str, make: None = None, *, summary: str = "", source: str = "", replace: bool = False
) -> Callable[[_Thing], _Thing]: ...
@overload
def register(name: str, make: _Thing, *, summary: str = "", source: str = "", replace: bool = False) -> _Thing: ...
@checked_names
def register(name: str, make: Any = None, *, summary: str = "", source: str = "", replace: bool = False) -> Any:
    """Give a strategy a name of its own, under which modifiers, tables and the command line know it.

    Args:
      name: letters, digits, `_`, `.` and `-`, the first no digit.
      make: a function of the view that returns a score for every cell; a constructor, which returns a `Policy` from
        keyword parameters; or a `Policy`. Without it, a decorator: `@jx.register("mine")`.
      summary: where it goes, for `jexplore strategies`; by default the first line of its docstring.
      source: of the idea; by default where it is defined.
      replace: whether the name may stand for something else already, as it does when a notebook's cell runs again.

    Raises:
      InputError: a name that is taken or that the grammar could not read; something that is no strategy.
    """
    if make is None:
        return functools.partial(register, name, summary=summary, source=source, replace=replace)
    if not isinstance(name, str) or not re.fullmatch(STRATEGY_NAME, name):
        raise InputError(f"a strategy's name must be letters, digits, _, . and -, got {name!r}")
    if not replace and name in STRATEGIES and not _is_replaced(STRATEGIES[name].make):
        raise InputError(f"strategy {name!r} is registered already; replace=True puts another in its place")
    if name in STRATEGIES and not STRATEGIES[name].is_own:
        raise InputError(f"strategy {name!r} is one of jexplore's own; choose another name")
    is_score(make)  # refuses what can be neither
    doc = (inspect.getdoc(make) or "") if inspect.isroutine(make) else ""
    STRATEGIES[name] = Entry(make, summary or doc.partition("\n")[0], source, is_own=True)
    return make
