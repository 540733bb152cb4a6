"""Conditions and loops, for one and for many at a time."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jexplore.arrays.loops import SHARE, first_lanes, one_kernel, put, repeat, run_if, stored, take

pytestmark = pytest.mark.jit


def bumped(x, table):
    """A condition that closes over arrays, within a loop, with a pytree as its state."""

    def turn(_, state):
        low = state[0] + table.sum() < 40
        return run_if(low, lambda s: (s[0] + table[0] + x, s[1].at[s[0] % 3].add(1)), state)

    return jax.lax.fori_loop(0, 3, turn, (x, jnp.zeros(3, jnp.int32)))


def halved(x, y):
    """A loop that a lane may run on in once it has ended."""
    return repeat(lambda s: s[0] > y, lambda s: (jnp.where(s[0] > y, s[0] // 2, s[0]), s[1] + (s[0] > y)), (x, 0 * x))


def kept(x, y):
    return stored(x > -100, lambda: {"sum": x + y, "twice": 2 * x})


@pytest.mark.parametrize("n", [1, SHARE, 2 * SHARE + 1])
@pytest.mark.parametrize(
    "function", [lambda x: bumped(x, jnp.arange(3) + x), lambda x: halved(x, jnp.int32(2)), lambda x: kept(x, 7)]
)
def test_many_at_a_time_are_as_many_alone(function, n):
    xs = jnp.arange(n, dtype=jnp.int32) * 5
    together = jax.jit(jax.vmap(function))(xs)
    for i, x in enumerate(xs):
        jax.tree.map(lambda many, one, i=i: np.testing.assert_array_equal(many[i], one), together, jax.jit(function)(x))
        with jax.disable_jit():
            plain = function(x)
        jax.tree.map(lambda many, one, i=i: np.testing.assert_array_equal(many[i], one), together, plain)


def test_a_condition_may_be_common_to_all():
    both = [jax.vmap(lambda x, c=c: run_if(c, lambda x: x + 1, x))(jnp.arange(4)) for c in (jnp.bool_(False), True)]
    assert [b.tolist() for b in both] == [[0, 1, 2, 3], [1, 2, 3, 4]]


def test_a_loop_over_what_lanes_share_and_what_they_do_not():
    limits = jnp.asarray([3, 8, 0])
    counts = jax.vmap(lambda limit: repeat(lambda n: n < limit, lambda n: n + (n < limit), jnp.int32(0)))(limits)
    assert counts.tolist() == [3, 8, 0]


def test_a_condition_works_on_the_lanes_that_need_it_only():
    """An eighth of the lanes at a time."""
    text = str(jax.make_jaxpr(jax.vmap(lambda x: run_if(x > 3, lambda x: jnp.sin(x), x)))(jnp.arange(32.0)))
    assert f"f32[{32 // SHARE}] = sin" in text
    assert "f32[32] = sin" not in text


def test_lanes_are_taken_and_put_back():
    mask = jnp.asarray([False, True, True, False, True])
    assert first_lanes(mask, 2).tolist() == [1, 2]
    assert first_lanes(mask, 4).tolist() == [1, 2, 4, 5]
    tree = {"a": jnp.arange(5), "b": jnp.arange(10).reshape(5, 2)}
    at = first_lanes(mask, 4)
    assert take(tree, at)["a"].tolist() == [1, 2, 4, 4]
    new = put(tree, at, jax.tree.map(lambda a: -a, take(tree, at)))
    assert new["a"].tolist() == [0, -1, -2, 3, -4]
    assert new["b"][:, 1].tolist() == [1, -3, -5, 7, -9]


def small_steps(grid, at, by, unused):
    """A loop of small operations that writes in place, with an argument that says nothing."""

    def body(i, grid):
        row = jax.lax.dynamic_slice(grid, (i, 0), (1, grid.shape[1]))
        return jax.lax.dynamic_update_slice(grid, row * 2 + by, (i + 1, 0))

    return jax.lax.fori_loop(at, grid.shape[0] - 1, body, grid), grid[0, 0]


GRIDS = {(5, 7): 1, (1, 1): 0}


@pytest.mark.parametrize("shape", [(5, 7), pytest.param((1, 1), marks=pytest.mark.slow)])
def test_one_kernel_is_the_function_wherever_it_stands(shape):
    """Alone, of constants, in loops, under a condition, twice, for many: XLA ends the process over some of these."""
    grid, by, closed = jnp.arange(math.prod(shape)).reshape(shape), jnp.int32(2), jnp.int32(5)
    want = small_steps(grid, GRIDS[shape], by, by)[0] + 5

    def kernel(grid, at, by):
        return one_kernel(lambda *args: (small_steps(*args)[0] + closed, grid[0, 0]), grid, at, by, by * 0)[0]

    def again(grid, at, by):
        return jax.lax.fori_loop(0, 3, lambda _, out: kernel(grid + 0 * out, at, by), grid)

    def carried(grid, at, by):
        step = lambda s: (s[0] + 1, kernel(s[2], s[3], s[4]), *s[2:])  # noqa: E731
        return jax.lax.while_loop(lambda s: s[0] < 2, step, (0, grid, grid, at, by))[1]

    def twice(grid, at, by):
        return kernel(kernel(grid, at, by) * 0 + grid, at, by)

    def perhaps(grid, at, by):
        return jax.lax.cond(by > 0, lambda: kernel(grid, at, by), lambda: grid)

    at = jnp.int32(GRIDS[shape])
    for function in (kernel, again, carried, twice, perhaps):
        np.testing.assert_array_equal(jax.jit(function)(grid, at, by), want)
        np.testing.assert_array_equal(jax.jit(lambda f=function: f(grid, GRIDS[shape], 2))(), want)
        many = jax.jit(jax.vmap(function, (0, None, 0)))(jnp.stack([grid, grid + 1]), at, jnp.stack([by, by]))
        np.testing.assert_array_equal(many[0], want)
    with jax.disable_jit():
        np.testing.assert_array_equal(kernel(grid, at, by), want)
