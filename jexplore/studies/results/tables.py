"""Common code of results of several strategies: their episodes by strategy."""

from collections.abc import Iterator
from typing import Any

import pandas as pd

from jexplore.config import checked_names, unknown


@checked_names
class ByStrategy:
    """Results that are iterated over by the names of their strategies, each with its own table of episodes.

    for name in results:
        results[name]["path_m"].mean()
    """

    episodes: pd.DataFrame

    @property
    def strategies(self) -> tuple[str, ...]:
        """Return names of the strategies, in order."""
        return tuple(dict.fromkeys(self.episodes["strategy"]))

    def __len__(self) -> int:
        return len(self.strategies)

    def __iter__(self) -> Iterator[str]:
        return iter(self.strategies)

    def __getitem__(self, name: str) -> pd.DataFrame:
        """Return the episodes of one strategy: those rows of the table of all, counted anew from 0."""
        if name not in self.strategies:
            raise unknown("strategy of these results:", str(name), self.strategies)
        own: Any = self.episodes[self.episodes["strategy"] == name]
        return own.reset_index(drop=True)

    def to_pandas(self) -> pd.DataFrame:
        """Return the table of episodes."""
        return self.episodes
