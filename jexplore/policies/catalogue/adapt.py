"""A user's strategy as a `Policy` whose functions return what the rules expect, or say in one line what they do not."""

import contextlib
import dataclasses
import functools
import hashlib
import os
import re
from collections.abc import Callable, Iterator
from typing import Any, Self

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from jexplore.arrays.loops import stored
from jexplore.config import InputError, shown
from jexplore.engine.devices import random_key
from jexplore.planning import Belief, Choice, Field, choose, field, first_at, is_open, nearest_of, view_of
from jexplore.policies.catalogue.entries import REQUIRED, is_score, parameters
from jexplore.policies.policy import Policy, Strategy, no_carry
from jexplore.policies.room_wise import rebuilt
from jexplore.raycast import Beams
from jexplore.reach import FAR, MOTIONS, NO_MOTION
from jexplore.users import bare, call_user, described


def policy_from(make: Any, given: dict[str, Any]) -> Policy:
    """Return the `Policy` of a score, a constructor or a `Policy`, with some of its parameters."""
    known = parameters(make)
    for key in given:
        if key not in known:
            raise InputError(f"{described(make)} has no parameter {key!r} (there are: {', '.join(known) or 'none'})")
    full = known | given
    for key, value in full.items():
        if value is REQUIRED:
            raise InputError(f"{described(make)} needs the parameter {key}")
    if is_score(make):
        # Numbers and arrays among its parameters may be swept without compiling anew.
        fixed = {key: value for key, value in full.items() if isinstance(value, (str, os.PathLike, bool, type(None)))}
        params = {key: value for key, value in full.items() if key not in fixed}
        return Policy(no_carry, Score(make, tuple(sorted(fixed.items()))), params)
    policy = make if isinstance(make, Policy) else call_user(make, described(make), **given)
    if not isinstance(policy, Policy):
        raise InputError(f"{described(make)} must return a Policy, got {type(policy).__name__}")
    for role in ("init", "select", *(("live",) if policy.live is not None else ())):
        if not callable(getattr(policy, role)):
            raise InputError(f"{described(make)}: {role} must be a function, got {getattr(policy, role)!r}")
    return adapted(policy)


def adapted(policy: Policy) -> Policy:
    """Return a user's `Policy` with its functions checked and up to date; one of this package unchanged."""
    if is_theirs(policy):
        return _anew(policy)
    if (getattr(bare(policy), "__module__", None) or "").startswith("jexplore.policies."):
        return policy
    live = None if policy.live is None else Live(policy.live)
    return Policy(Init(policy.init), Select(policy.select), policy.params, live)


@dataclasses.dataclass(frozen=True)
class Theirs:
    """A function of a user's. Once it has been traced it is told from others by what it computes, so that two that
    compute the same are compiled once; until then it is equal to itself alone.
    """

    function: Callable[..., Any] = dataclasses.field(compare=False)
    fixed: tuple[tuple[str, Any], ...] = dataclasses.field(default=(), compare=False)
    digest: str | None = dataclasses.field(default=None, compare=False)  # of the policy; None before, or if unknown
    key: Any = dataclasses.field(init=False, repr=False)  # what tells it from others

    def __post_init__(self) -> None:
        object.__setattr__(self, "key", object() if self.digest is None else self.digest)

    @property
    def what(self) -> str:
        """Return its name and place, for messages."""
        return described(self.function)

    def anew(self, digest: str | None = None) -> Self:
        """Return the same function, as it is now, or as it was when traced."""
        return dataclasses.replace(self, digest=digest)


class Score(Theirs):
    """The `select` of a strategy that is a score: the reachable frontier cell with the highest one.

    Equal scores go to the lowest flat index; NaN is never chosen; without a finite score the nearest cell is.
    """

    def __call__(self, *given: Any) -> tuple[Any, Choice, Array]:
        return self.scored(*given)[:3]

    def scored(
        self, key: Array, params: Any, carry: Any, belief: Belief, beams: Beams, route: Array
    ) -> tuple[Any, Choice, Array, Array]:
        """Choose, and return the scores of the candidates as well: `[H, W]` float32, NaN elsewhere."""
        del key, beams
        reached = field(belief)
        found = call_user(self.function, self.what, view_of(belief, reached), **dict(self.fixed), **params)
        choice, route, score = choose_highest(self.what, found, belief, reached, route)
        return carry, choice, route, jnp.where(reached.frontier, score, jnp.nan)


def choose_highest(what: str, found: Any, belief: Belief, reached: Field, route: Array) -> tuple[Choice, Array, Array]:
    """Choose the candidate of the highest of the scores that a user's function has found: `(choice, route, scores)`.

    Refuse anything but a number for every cell.
    """
    shape = reached.cost.shape
    with expecting(what, f"a score for every cell, {_shape(shape)} integer or float", found):
        score = jnp.asarray(found)
        is_number = jnp.issubdtype(score.dtype, jnp.integer) or jnp.issubdtype(score.dtype, jnp.floating)
        if score.shape != shape or not is_number:
            raise TypeError
    # Kept: XLA might compute it anew to compare it with its maximum, round it differently, and nothing equals that.
    score = stored(belief.row >= 0, lambda: lax.optimization_barrier(score))
    real = jnp.issubdtype(score.dtype, jnp.floating)
    least = -jnp.inf if real else jnp.iinfo(score.dtype).min
    usable = reached.frontier & ~jnp.isnan(score)
    best = usable & (score == jnp.max(jnp.where(usable, score, jnp.asarray(least, score.dtype))))
    any_ = jnp.any(usable & jnp.isfinite(score))
    row, col = (jnp.where(any_, at, nearest) for at, nearest in zip(first_at(best), nearest_of(reached)))
    return *choose(belief, route, reached, row, col), score


class Init(Theirs):
    """The `init` of a user's strategy: its carry as arrays."""

    def __call__(self, params: Any, belief: Belief) -> Any:
        return _as_arrays(call_user(self.function, self.what, params, belief), self.what)


class Live(Theirs):
    """The `live` of a user's strategy."""

    def __call__(self, params: Any, belief: Belief, beams: Beams, row: Array, col: Array) -> Array:
        found = call_user(self.function, self.what, params, belief, beams, row, col)
        return _alike(found, jnp.bool_(True), self.what, "one bool")


class Select(Theirs):
    """The `select` of a user's strategy: what it returns has the right shapes, and its way leads to its target."""

    def __call__(
        self, key: Array, params: Any, carry: Any, belief: Belief, beams: Beams, route: Array
    ) -> tuple[Any, Choice, Array]:
        found = call_user(self.function, self.what, key, params, carry, belief, beams, route)
        number = jnp.int32(0)
        wanted = carry, Choice(number, number, number, number, jnp.bool_(False), number), route
        new, choice, way = _alike(found, wanted, self.what, "(carry, Choice, route), the carry like that of init")
        reached = _leads_there(belief, way, choice)
        return new, choice.replace(cost=jnp.where(reached, choice.cost, FAR)), way


def _alike(found, wanted, what, expected):
    """Return what a user's function has returned as arrays; refuse other shapes and dtypes than those of `wanted`."""
    if jax.tree.structure(found) != jax.tree.structure(wanted):
        raise InputError(f"{what} must return {expected}, got {_told(found)}")
    arrays = _as_arrays(found, what)
    for (path, one), other in zip(jax.tree.leaves_with_path(wanted), jax.tree.leaves(arrays)):
        if (one.shape, one.dtype) != (other.shape, other.dtype):
            where = jax.tree_util.keystr(path, simple=True, separator=".")
            detail = f": {where} must be {_told(one)}" if where else ""
            raise InputError(f"{what} must return {expected}{detail}, got {_told(other)}")
    return arrays


def _leads_there(belief, route, choice):
    """Return whether a path leads from the robot to its target over cells that it would step into: bool."""
    height, width = route.shape
    moves = jnp.asarray(MOTIONS, jnp.int32)

    def there(row, col):
        return (row == choice.row) & (col == choice.col)

    def going(state):
        n, row, col, good = state
        return good & ~there(row, col) & (n < height * width)

    def walk(state):
        n, row, col, _ = state
        motion = route[row, col].astype(jnp.int32)
        move = moves[jnp.clip(motion, 0, len(MOTIONS) - 1)]
        inside = (row + move[0] >= 0) & (row + move[0] < height) & (col + move[1] >= 0) & (col + move[1] < width)
        row, col = jnp.clip(row + move[0], 0, height - 1), jnp.clip(col + move[1], 0, width - 1)
        good = (motion > NO_MOTION) & (motion < len(MOTIONS)) & inside & is_open(belief, row, col)
        return n + 1, row, col, good

    _, row, col, good = lax.while_loop(going, walk, (jnp.int32(0), belief.row, belief.col, choice.row >= 0))
    return good & there(row, col)


def _as_arrays(tree, what):
    """Convert the leaves of a pytree to arrays of their own dtype, not Python's numbers."""

    def one(leaf):
        if isinstance(leaf, jax.Array) and not getattr(leaf, "weak_type", False):
            return leaf
        with expecting(what, "numbers and arrays", leaf):
            array = jnp.asarray(leaf)
            return lax.convert_element_type(array, array.dtype)

    return jax.tree.map(one, tree)


@contextlib.contextmanager
def expecting(what: str, expected: str, got: Any) -> Iterator[None]:
    """Refuse, where the block does not take it, what a user's function has returned."""
    try:
        yield
    except (TypeError, ValueError, AttributeError, OverflowError):
        raise InputError(f"{what} must return {expected}, got {_told(got)}") from None


def _shape(shape):
    return f"[{', '.join(map(str, shape))}]"


def _told(tree):
    """Describe a pytree by shapes and dtypes."""

    def one(leaf):
        return f"{_shape(leaf.shape)} {leaf.dtype}" if hasattr(leaf, "dtype") else repr(leaf)

    leaves = jax.tree.leaves(tree)
    if len(leaves) == 1 and leaves[0] is tree:
        return one(tree) if hasattr(tree, "dtype") else f"{type(tree).__name__} {tree!r}"[:80]
    if tree is None or tree == ():
        return repr(tree)
    return str(jax.tree.map(one, tree)).replace("'", "")[:300]


def with_exact_numbers(strategy: Strategy) -> Strategy:
    """Refuse a strategy with a parameter that would change its value in episodes, as int32 or float32.

    Infinity is a number like any other; digits that float32 does not have are rounded.
    """
    for path, leaf in jax.tree_util.tree_leaves_with_path(strategy.policy.params):
        what = _refused(leaf)
        if what is not None:
            key = jax.tree_util.keystr(path, simple=True, separator=".").removeprefix("inner.") or "params"
            raise InputError(f"strategy {strategy.name!r}: {key} must be {what}, got {shown(leaf)}")
    return strategy


def _refused(value):
    """Return the requirement that a parameter violates; None if it is valid or no number."""
    if isinstance(value, int) and not -(2**31) <= value < 2**31:  # numpy has no such type for the largest
        return _WHOLE
    kind = getattr(value, "dtype", np.dtype(type(value) if isinstance(value, (float, complex)) else bool))
    if kind == np.dtype(object):
        return "an array of numbers"
    if jnp.issubdtype(kind, np.complexfloating):
        return "real"
    if not jnp.issubdtype(kind, np.number):
        return None
    array = np.asarray(value)
    if jnp.issubdtype(kind, np.integer):
        return None if ((array >= -(2**31)) & (array < 2**31)).all() else _WHOLE
    if np.isnan(array).any():
        return "a number, not NaN"
    with np.errstate(over="ignore"):
        narrow = array.astype(np.float32)
    return _REAL if (np.isinf(narrow) & ~np.isinf(array)).any() else None


_WHOLE = f"a whole number from {-(2**31)} to {2**31 - 1}"
_REAL = f"from -{np.finfo(np.float32).max:.3g} to {np.finfo(np.float32).max:.3g}, or infinite"


def is_theirs(policy: Policy) -> bool:
    """Return whether a policy, or the one that it modifies, comes from outside this package."""
    inner = getattr(policy.select, "inner", policy.select)
    return isinstance(inner, Theirs)


def _anew(policy, digest=None):
    return rebuilt(policy, lambda function: function.anew(digest) if isinstance(function, Theirs) else function)


def digest_of(policy: Policy) -> str | None:
    """Return the digest that identifies a user's traced strategy in every process; None without one."""
    return getattr(getattr(policy.select, "inner", policy.select), "digest", None)


def traced_policy(policy: Policy, params: Any, belief: Any, beams: Any, route: Any) -> Policy:
    """Identify the functions of a user's strategy by their computation: traced on shapes, without compiling."""
    leaves, tree = jax.tree.flatten((params, belief, beams, route))
    shapes = tuple(jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in leaves)
    digest = _digest(policy._replace(params=()), tree, shapes)
    return policy if digest is None else _anew(policy, digest)


@functools.lru_cache(maxsize=256)
def _digest(policy, tree, shapes):
    """See `computation_digest`. Functions that were taken anew are traced anew."""

    def all_of_it(key, params, belief, beams, route):
        carry = policy.init(params, belief)
        carry, choice, route = policy.select(key, params, carry, belief, beams, route)
        live = policy.live(params, belief, beams, choice.row, choice.col) if policy.live is not None else True
        return carry, choice, route, live

    with jax.disable_jit(False):
        return computation_digest(jax.make_jaxpr(all_of_it)(random_key(0), *jax.tree.unflatten(tree, shapes)))


_ADDRESS = re.compile(r"0x[0-9a-fA-FX]+")  # address of an object in memory, irrelevant here


def computation_digest(traced: ClosedJaxpr) -> str | None:
    """Return SHA-256 of a traced function, in hexadecimal digits: equal computations agree in every process.

    The trace holds every number that the function works with, from any source: a helper, an object, a file. It does not
    hold the Python code of a callback: None where the function calls back into Python.
    """
    text = traced.pretty_print(use_color=False)
    found = hashlib.sha256(_ADDRESS.sub("", text).encode())
    for one in _within(traced, set()):
        arrays = list(getattr(one, "consts", ()))
        for equation in getattr(one, "jaxpr", one).eqns:
            if "callback" in equation.primitive.name:
                return None
            written = jax.tree.leaves(list(equation.params.values()))
            arrays += [value.val for value in equation.invars if isinstance(value, Literal)]
            arrays += [value for value in written if isinstance(value, np.ndarray)]  # the text cuts long ones short
        for array in arrays:
            found.update(_bytes(array))
    return found.hexdigest()


def _within(traced, seen) -> Iterator[Any]:
    """Yield a traced function, and those that it calls: each once."""
    if id(traced) not in seen:
        seen.add(id(traced))
        yield traced
        for equation in getattr(traced, "jaxpr", traced).eqns:
            for part in jax.tree.leaves(list(equation.params.values())):
                if isinstance(part, (Jaxpr, ClosedJaxpr)):
                    yield from _within(part, seen)


def _bytes(array):
    """Return the elements of an array with their type and its shape."""
    if jnp.issubdtype(getattr(array, "dtype", np.bool_), jax.dtypes.prng_key):
        array = jax.random.key_data(array)
    array = np.asarray(array)
    return f"{array.dtype}{array.shape}".encode() + np.ascontiguousarray(array).tobytes()
