"""Kernels of planning and scanning in native code, for programs in JAX on a CPU; each does what the function that calls
it does in JAX, bit by bit. Which target of JAX's FFI they belong to is `MapModel.native`.
"""

import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jexplore.grid import Grid
from jexplore.raycast import Beams, square_side

EVERY = 2**30  # more unknown cells than any look shows
KERNELS = ("drive", "turns", "field", "clusters", "lay", "look", "apart", "cast", "fold", "enter", "coarse", "fine")
"""The kernels of the library, `jexplore_NAME`."""


def numbers(values: Sequence[Any]) -> Array:
    """Scalars as one array of int32."""
    return jnp.stack([jnp.asarray(value, jnp.int32) for value in values])


def call(
    native: str, kernel: str, results: Sequence[tuple[Sequence[int], Any]], *arguments: Any, in_place: int = 0
) -> list[Array]:
    """Call a kernel. Nothing is differentiated through it: what it returns are whole numbers.

    `results`: shape and dtype of each; `in_place`: how many arguments, the first, give their memory to results.
    """
    made = [jax.ShapeDtypeStruct(tuple(shape), dtype) for shape, dtype in results]
    aliases = {i: i for i in range(in_place)}
    function = jax.ffi.ffi_call(f"{native}_{kernel}", made, vmap_method="sequential", input_output_aliases=aliases)
    return list(function(*jax.lax.stop_gradient(arguments)))


def target_of(native: str | None) -> str | None:
    """Return the target of a `MapModel` where it is used: not where every operation runs by itself, to find faults."""
    return None if jax.config.values["jax_disable_jit"] else native


def look(
    native: str,
    stops: Array,
    unknown: Array,
    at: Array,
    n: Array | int,
    beams: Beams,
    d2: Sequence[float] | Array = (math.inf,),
    enough: Array | int = EVERY,
) -> Array:
    """Return what looks from the first n of some cells tell: unknown cells within R distances, then known ones.

    A look ends where it has shown `enough` unknown cells: their number is then no less than that. `stops`, `unknown`:
    of `gain.stops_and_unknown`; `at`: `[2, M]` int32, rows and columns; `beams`: `Beams.all_round`; `d2`: `[R]`,
    squared distances, cells^2. Returns `[R + 1, M]` int32; 0 beyond the first n.
    """
    d2 = jnp.asarray(d2, jnp.float32)
    result, cells = (
        ((d2.shape[0] + 1, at.shape[1]), jnp.int32),
        stops.astype(jnp.uint8) | unknown.astype(jnp.uint8) << 1,
    )
    terms = numbers([n, enough, square_side(beams)])
    return call(native, "look", [result], cells, at, beams.by_beam, beams.length, d2, terms)[0]


def fold(
    native: str, grid: Grid, xy: Array, direction: Array, reading: Any, reach: Array, extent: Array,
    within: Array | None = None, *, ends_first: bool = False,
) -> tuple[Grid, Array]:  # fmt: skip
    """Return a map with readings, changed in place, and how many cells within have become known, int32; see
    `slam2d.beams.fold`.
    """
    maps = grid.hits, grid.misses
    results = [*((a.shape, jnp.int32) for a in maps), ((1,), jnp.int32)]
    within = jnp.zeros((1, 1), bool) if within is None else within
    hits, misses, fresh = call(
        native, "fold", results, *maps, xy, direction, *reading, jnp.float32(reach), within,
        numbers([*jnp.unstack(extent), int(ends_first)]), in_place=2,
    )  # fmt: skip
    return Grid(hits, misses), fresh[0]
