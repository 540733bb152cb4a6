"""The generator of random numbers: the same whatever JAX's settings say, and recorded."""

import jax
import numpy as np
import pytest

from jexplore.engine.devices import GENERATOR, compiled, pinned_draws, random_key
from jexplore.report import store


def draws(seed):
    """Numbers by a key of ours, and by one that a strategy makes itself."""
    own, other = random_key(seed), jax.random.key(seed)
    return jax.random.uniform(own, (5, 3)), jax.random.bits(jax.random.split(other)[1], (7,))


SETTINGS = [{"impl": "rbg"}, {"partitionable": False}, {"impl": "unsafe_rbg", "partitionable": False}]


@pytest.fixture(params=SETTINGS, ids=str)
def other_settings(request):
    given = {"impl": GENERATOR, "partitionable": True} | request.param
    with jax.default_prng_impl(given["impl"]), jax.threefry_partitionable(given["partitionable"]):
        yield


WANT = jax.tree.map(np.asarray, draws(7))


def test_settings_of_jax_change_its_own_draws_and_not_ours(other_settings):
    plain = draws(7)
    assert any(np.any(np.asarray(one) != want) for one, want in zip(plain, WANT))
    with pinned_draws():
        for one, want in zip(draws(7), WANT):
            np.testing.assert_array_equal(one, want)
    call = pinned_draws()(jax.jit(draws))
    for one, want in zip(call(7), WANT):
        np.testing.assert_array_equal(one, want)


@pytest.mark.jit
def test_compiled_programs_draw_the_same(other_settings, request):
    call, _ = compiled(draws, request.node.name, (np.uint32(0),), jax.local_devices()[0])
    for one, want in zip(call(np.uint32(7)), WANT):
        np.testing.assert_array_equal(one, want)


def test_the_generator_is_recorded(other_settings):
    assert store.environment()["generator"] == GENERATOR
    assert str(jax.random.key_impl(random_key(0))) == GENERATOR
