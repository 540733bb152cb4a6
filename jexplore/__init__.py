"""jexplore: a laboratory for mobile-robot exploration, written in JAX.

    import jexplore as jx

    world = jx.load_world("cave#3")
    results = jx.compare(world, ["closest", "closest+recheck", "random"], episodes=20)
    results.to_pandas()

Importing this loads neither jax nor numpy; a name is loaded from its module when it is first used. The names stand in
`__init__.pyi`; those about trace maps are in `jx.btm`.
"""

from jexplore.lazy import read_stub as _read

_LAZY = _read(__name__, "__init__.pyi")
__getattr__ = _LAZY.get
# What `from jexplore import *` takes needs no extra.
__all__ = sorted({*_LAZY.module_of} - {*_LAZY.extras})  # pyright: ignore[reportUnsupportedDunderAll]


def __dir__() -> list[str]:
    return sorted(_LAZY.module_of)
