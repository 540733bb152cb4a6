"""Idioms of control flow that do the right thing for one robot and for many in lanes.

For one robot all three are plain loops: XLA's CPU compiler updates a loop's buffers in place and stores them when it
ends, where it copies those of a condition, and computes anew, in each of many uses, what no loop stores.

Under `vmap`, where XLA would compute both sides of a condition for every lane, and keep every lane of a loop waiting
with a copy of its state, they are written by hand: `run_if` works on the lanes that need it, a fraction of all at a
time; `repeat` lets finished lanes run on idly.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax
from jax.custom_batching import custom_vmap
from jax.experimental.xla_metadata import set_xla_metadata
from jax.extend.core import jaxpr_as_fun

SHARE = 8  # a condition under vmap is processed by groups of one in this many lanes


def _hoisted(function, *examples):
    """Turn closed-over values of a function into an argument: `(f, closed)`, `f(closed, *args)` = `function(*args)`."""
    leaves, tree = jax.tree.flatten(examples)
    jaxpr, shapes = jax.make_jaxpr(lambda *leaves: function(*jax.tree.unflatten(tree, leaves)), return_shape=True)(
        *leaves
    )

    def pure(closed, *args):
        out = jaxpr_as_fun(jaxpr.replace(consts=list(closed)))(*jax.tree.leaves(args))
        return jax.tree.unflatten(jax.tree.structure(shapes), out)

    return pure, list(jaxpr.consts)


def _axes(batched):
    return jax.tree.map(lambda b: 0 if b else None, batched)


def _wide(n, tree, batched):
    """Add a leading axis of n to every leaf of a pytree."""
    return jax.tree.map(lambda a, b: a if b else jnp.broadcast_to(a, (n, *jnp.shape(a))), tree, batched)


def _all_batched(tree):
    return jax.tree.map(lambda _: True, tree)


def take(tree: Any, at: Array) -> Any:
    """Return lanes `at` (`[m]` int32) of a pytree; a lane beyond the last gives the last."""
    return jax.tree.map(lambda a: a.at[at].get(mode="clip", wrap_negative_indices=False), tree)


def put(tree: Any, at: Array, values: Any) -> Any:
    """Replace lanes `at` (`[m]` int32) of a pytree, none of them twice; indices beyond the last are dropped.

    An accelerator is told that no lane comes twice: it would write bools and bytes one after the other.
    """
    own = jax.tree.leaves(tree)
    n = own[0].shape[0] if own else 0
    at = jnp.where(at < n, at, n + lax.iota(jnp.int32, at.shape[0]))  # dropped indices are unique as well
    return jax.tree.map(lambda a, new: a.at[at].set(new, mode="drop", unique_indices=True), tree, values)


def take_one(tree: Any, i: Array | int) -> Any:
    """Return entry i, at least 0, of the leading axis of a pytree."""
    return jax.tree.map(lambda a: lax.dynamic_index_in_dim(a, i, 0, False, allow_negative_indices=False), tree)


def put_one(tree: Any, i: Array | int, one: Any) -> Any:
    """Replace entry i, at least 0, of the leading axis of a pytree. Scatters would take longer to compile."""

    def put(lanes: Array, new: Any) -> Array:
        return lax.dynamic_update_index_in_dim(lanes, jnp.asarray(new, lanes.dtype), i, 0, allow_negative_indices=False)

    return jax.tree.map(put, tree, one)


def first_lanes(mask: Array, m: int) -> Array:
    """Return the first m lanes of a mask: `[m]` int32; the number of lanes where there are fewer."""
    n = mask.shape[0]
    rank, lane = jnp.cumsum(mask, dtype=jnp.int32) - 1, lax.iota(jnp.int32, n)
    # Same as `jnp.nonzero`, by fewer kernels; dropped values go to places of their own.
    at = jnp.where(mask & (rank < m), rank, m + lane)
    return jnp.full(m, n, jnp.int32).at[at].set(lane, mode="drop", unique_indices=True)


def pick(condition: Array | bool, yes: Any, no: Any) -> Any:
    """Return one of two pytrees by a scalar condition, leaf by leaf."""
    return jax.tree.map(lambda one, other: jnp.where(condition, one, other), yes, no)


def run_if(predicate: Array | bool, function: Callable[[Any], Any], otherwise: Any) -> Any:
    """Return `function(otherwise)` if a condition, a scalar, holds, else `otherwise`, a pytree of arrays.

    Under `vmap` the lanes for which it holds are gathered, one in `SHARE` of all at a time, until none is left.
    """

    def alone(predicate, function, state):
        return lax.while_loop(lambda s: s[0], lambda s: (False, function(s[1])), (predicate, state))[1]

    if jax.config.values["jax_disable_jit"]:
        return alone(predicate, function, otherwise)
    otherwise = jax.tree.map(jnp.asarray, otherwise)
    pure, closed = _hoisted(function, otherwise)

    @custom_vmap
    def call(predicate, closed, state):
        return alone(predicate, lambda state: pure(closed, state), state)

    @call.def_vmap
    def in_lanes(n, batched, predicate, closed, state):
        state, axes = _wide(n, state, batched[2]), (_axes(batched[1]), 0)
        if not batched[0]:
            out = alone(predicate, lambda state: jax.vmap(pure, axes)(closed, state), state)
            return out, _all_batched(out)

        def turn(carry):
            left, state = carry
            at = first_lanes(left, -(-n // SHARE))
            some = jax.tree.map(lambda a, b: take(a, at) if b else a, closed, batched[1])
            new = jax.vmap(pure, axes)(some, take(state, at))
            return put(left, at, jnp.zeros(at.shape, bool)), put(state, at, new)

        _, out = lax.while_loop(lambda carry: jnp.any(carry[0]), turn, (predicate, state))
        return out, _all_batched(out)

    return call(jnp.asarray(predicate), closed, otherwise)


def _on_cpu():
    """Return whether the function being traced is for a CPU."""
    device: Any = jax.config.values["jax_default_device"]  # None, a device, or a platform's name
    return (getattr(device, "platform", device) or jax.default_backend()) == "cpu"


def alone_on_cpu(function: Callable[..., Any]) -> Callable[..., Any]:
    """Make a function of pytrees work on one lane after the other under `vmap` on a CPU.

    Conditions and loops are then true control flow, as for one robot; on other devices lanes go together.
    """

    @custom_vmap
    def call(*args):
        return function(*args)

    @call.def_vmap
    def in_lanes(n, batched, *args):
        del n
        leaves, tree = jax.tree.flatten(args)
        own = jax.tree.leaves(tuple(batched))

        def whole(some):
            some = iter(some)
            return jax.tree.unflatten(tree, [next(some) if b else leaf for b, leaf in zip(own, leaves)])

        lanes = [leaf for b, leaf in zip(own, leaves) if b]  # what they share is not copied
        if _on_cpu():
            out = lax.map(lambda some: call(*whole(some)), lanes)
        else:
            out = jax.vmap(lambda some: function(*whole(some)))(lanes)
        return out, _all_batched(out)

    return call


def repeat(going: Callable[[Any], Array | bool], body: Callable[[Any], Any], state: Any) -> Any:
    """Apply `body` to a state, a pytree of arrays, for as long as `going(state)`, a bool scalar, holds.

    `body` must leave a state that is not going as it is: under `vmap` it is applied until no lane is going.
    """
    if jax.config.values["jax_disable_jit"]:
        return lax.while_loop(going, body, state)
    state = jax.tree.map(jnp.asarray, state)
    pure_going, closed_going = _hoisted(going, state)
    pure_body, closed_body = _hoisted(body, state)

    @custom_vmap
    def call(closed, state):
        return lax.while_loop(lambda s: pure_going(closed[0], s), lambda s: pure_body(closed[1], s), state)

    @call.def_vmap
    def in_lanes(n, batched, closed, state):
        (going_axes, body_axes), state = _axes(batched[0]), _wide(n, state, batched[1])
        out = lax.while_loop(
            lambda s: jnp.any(jax.vmap(pure_going, (going_axes, 0))(closed[0], s)),
            lambda s: jax.vmap(pure_body, (body_axes, 0))(closed[1], s),
            state,
        )
        return out, _all_batched(out)

    return call((closed_going, closed_body), state)


def settled(step: Callable[[Array], Array], start: Array) -> Array:
    """Iterate a step until the array, of whole numbers from 0, stays the same (fixed point)."""

    def turn(state):
        value, _ = state
        new = step(value)
        return new, jnp.any(new != value)

    # True, and not known to be: XLA's CPU compiler makes other, at no optimization wrong, code of a constant there.
    return repeat(lambda state: state[1], turn, (start, jnp.ravel(start)[0] >= 0))[0]


def stored(truth: Array | bool, function: Callable[[], Any]) -> Any:
    """Return the value of `function()`, computed once and kept (materialised).

    `truth`: bool scalar, always True, in a way that the compiler cannot tell.
    """

    def alone(truth, function):
        blank = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(function))
        return lax.while_loop(lambda s: s[0], lambda s: (False, function()), (truth, blank))[1]

    if jax.config.values["jax_disable_jit"]:
        return alone(truth, function)
    pure, closed = _hoisted(function)

    @custom_vmap
    def call(truth, closed):
        return alone(truth, lambda: pure(closed))

    @call.def_vmap
    def in_lanes(n, batched, _, closed):
        if not any(jax.tree.leaves(batched[1])):
            out = pure(closed)
            return out, jax.tree.map(lambda _: False, out)
        out = jax.vmap(pure, (_axes(batched[1]),), axis_size=n)(closed)
        return out, _all_batched(out)

    return call(jnp.asarray(truth), closed)


def one_kernel(function: Callable[..., Any], *args: Any) -> Any:
    """Call `function(*args)`, compiled on a CPU as one piece of code, loops included, not operation by operation.

    For kernels of many small operations. No scatter, sort or custom call may be in it. Under `vmap`, where an update
    becomes a scatter, it is a plain call.
    """
    if jax.config.values["jax_disable_jit"] or not _on_cpu():
        return function(*args)
    pure, closed = _hoisted(function, *args)
    leaves, tree = jax.tree.flatten((closed, *args))
    jaxpr, shapes = jax.make_jaxpr(lambda *leaves: pure(*jax.tree.unflatten(tree, leaves)), return_shape=True)(*leaves)
    run = jaxpr_as_fun(jaxpr)

    def used(*leaves):
        # XLA's CPU compiler ends the process over an argument that such a piece of code does not use, or that it knows
        # to be constant: all are used, and a barrier hides what they are.
        return run(*leaves), sum((jnp.ravel(leaf)[0] != 0).astype(jnp.int32) for leaf in leaves)

    @custom_vmap
    def call(leaves):
        leaves = lax.optimization_barrier(leaves)
        # Ignored type: given a list, it returns one, which it does not say.
        return set_xla_metadata(jax.jit(used)(*leaves), inlineable="false", xla_cpu_small_call="true")[0]  # type: ignore[index]

    @call.def_vmap
    def in_lanes(n, batched, leaves):
        out = jax.vmap(lambda leaves: run(*leaves), (_axes(batched[0]),), axis_size=n)(leaves)
        return out, _all_batched(out)

    return jax.tree.unflatten(jax.tree.structure(shapes), call([jnp.asarray(leaf) for leaf in leaves]))
