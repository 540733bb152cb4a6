"""Wrong input: refused in one line."""

import pytest

from jexplore.config import InputError


def refused(message, call, /, *arguments, **named):
    """Return the line in which a function refuses its arguments; it must match a pattern, if that is not None."""
    with pytest.raises(InputError, match=message) as caught:
        call(*arguments, **named)
    assert "\n" not in str(caught.value)
    return str(caught.value)
