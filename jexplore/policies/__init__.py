"""Strategies: one file each, with one constructor that returns a `Policy`; `catalogue/` finds them by name, and takes
those that others have written.

To add one to this package: write the file, add a line to `STRATEGIES` in `catalogue/entries.py`, a test, and a line to
the changelog.
"""

from jexplore.policies import clusters, views
from jexplore.policies.catalogue.entries import MODIFIERS, STRATEGIES, register
from jexplore.policies.catalogue.grammar import parse_strategy, search_space, strategy
from jexplore.policies.policy import Entry, Policy, Span, Strategy

__all__ = [
    "MODIFIERS",
    "STRATEGIES",
    "Entry",
    "Policy",
    "Span",
    "Strategy",
    "clusters",
    "parse_strategy",
    "register",
    "search_space",
    "strategy",
    "views",
]
