"""Learned strategies: features by hand, networks that do not mind the order, models as files."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref import beliefs
from ref.beliefs import NICHES, ONE_METRE, STAR
from ref.refusals import refused

from jexplore.planning import field
from jexplore.policies import clusters, parse_strategy
from jexplore.policies.learned import features, model, networks
from jexplore.policies.learned.strategy import is_forced
from jexplore.raycast import beam_table

SCORES = jax.jit(networks.scores, static_argnums=0)


def told(text, last=(-1, -1)):
    """`Targets` and their features of a map."""
    belief = beliefs.belief_of(text, **ONE_METRE)
    beams = jax.tree.map(jnp.asarray, beam_table(STAR, 1.0, belief.driven.shape[1]))

    @jax.jit
    def both(belief, beams, last):
        at = features.shortlist(clusters.targets(belief, field(belief)))
        return at, features.features(belief, at, last, beams)

    at, found = both(belief, beams, jnp.asarray(last))
    return at, {name: np.asarray(found[:, i]) for i, name in enumerate(features.FEATURES)}


@pytest.mark.jit
def test_features_by_hand():
    """The nearest first: B, A, C."""
    at, found = told(NICHES, last=(1, 3))
    assert np.asarray(at.col)[:3].tolist() == [9, 3, 13]
    for name, want in {
        "path": [2, 4, 6], "size": [3, 3, 3], "others": [(6 + 4) / 2, (6 + 10) / 2, (4 + 10) / 2],
        "others by area": [5, 8, 7], "nearest other": [4, 6, 4],
        "detour": [2, 0, 2],  # tours B C A: 2 + 4 + 10, A B C: 4 + 6 + 4, C B A: 6 + 4 + 6
    }.items():  # fmt: skip
        np.testing.assert_allclose(found[name][:3], np.asarray(want) / features.FEATURE_UNIT_M, rtol=1e-6)
    one = np.sqrt(1.0) / features.FEATURE_UNIT_M
    for name in ("side within 2 m", "side within 4 m", "side within 8 m"):
        np.testing.assert_allclose(found[name][:3], one, rtol=1e-6)
    np.testing.assert_allclose(found["pocket"][:3], np.exp(-1 / features.POCKET_M2), rtol=1e-6)
    around = 1 + np.exp(-np.asarray([[6, 4], [6, 10], [4, 10]]) / features.AROUND_M).sum(axis=1)
    np.testing.assert_allclose(found["side near"][:3], np.sqrt(around) / features.FEATURE_UNIT_M, rtol=1e-6)
    np.testing.assert_allclose(found["turn"][:3], [0, 1, 0], atol=1e-6)  # heading east
    np.testing.assert_allclose(found["home"][:3], np.asarray([2, 4, 6]) / features.FEATURE_UNIT_M, rtol=1e-6)
    np.testing.assert_allclose(found["last"][:3], np.exp(-np.asarray([6, 0, 10]) / features.STAY_M), rtol=1e-6)
    assert np.all(found["progress"][:3] == found["progress"][0])
    assert not np.any([column[3:] for column in found.values()])


@pytest.mark.jit
def test_nothing_is_decided_where_there_is_one_target_or_one_at_hand():
    at, _ = told(NICHES)
    assert not is_forced(at)
    assert is_forced(at.replace(path_m=at.path_m.at[0].set(0.5)))
    assert is_forced(at.replace(used=jnp.arange(features.SCORED_CLUSTERS) < 1))
    assert is_forced(at.replace(used=jnp.zeros(features.SCORED_CLUSTERS, bool)))


@pytest.mark.jit
@pytest.mark.parametrize("name", networks.NETWORKS)
def test_networks_do_not_mind_the_order_nor_unused_slots(name):
    keys = jax.random.split(jax.random.key(0), 3)
    weights = networks.initial_weights(name, keys[0], len(features.FEATURES))
    assert sum(leaf.size for leaf in jax.tree.leaves(weights)) < 50_000
    weights = jax.tree.map(lambda a: a + 0.1 * jax.random.normal(keys[1], a.shape), weights)
    x, used = jax.random.normal(keys[2], (32, len(features.FEATURES))), jnp.arange(32) < 9
    found = SCORES(name, weights, x, used)
    order = np.random.default_rng(0).permutation(32)
    np.testing.assert_allclose(SCORES(name, weights, x[order], used[order]), found[order], rtol=1e-4, atol=1e-5)
    other = SCORES(name, weights, jnp.where(used[:, None], x, 7.0), used)
    np.testing.assert_allclose(other[:9], found[:9], rtol=1e-4, atol=1e-5)
    assert np.all(found[9:] == networks.MASKED)
    assert np.all(np.isfinite(SCORES(name, weights, x, jnp.zeros(32, bool))))


def saved_as(path, made):
    """A model as files: the path of its weights."""
    file = path.with_suffix(".msgpack")
    model.write_weights(file, made)
    model.write_page(file.with_suffix(".json"), made)
    return file


@pytest.fixture
def saved(tmp_path):
    weights = jax.tree.map(np.asarray, networks.initial_weights("linear", jax.random.key(0), len(features.FEATURES)))
    return saved_as(tmp_path / "mine", model.Model("linear", weights, {"seed": 3}))


def test_a_model_comes_back(saved):
    for path in (saved, saved.with_suffix(".json")):
        found = model.load_model(path)
        assert found.network == "linear"
        assert found.made["seed"] == 3
        assert found.weights["weights"].tolist() == [-1.0, *[0.0] * (len(features.FEATURES) - 1)]
    one = parse_strategy(f"learned+recheck:path={saved}")
    assert one.recheck


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": 0}, "must be of format 1, got 0"),
        ({"network": "wide"}, "its network must be one of linear, attention, got 'wide'"),
        ({"network": "attention"}, "damaged|other shapes"),
        ({"features": ["path"]}, "trained with other features"),
        ({"sha256": "0"}, "are not those that its JSON file tells of"),
        (None, "is damaged"),
        ("{", r"cannot be read: '.*\.json': is not valid JSON"),
        ("[]", "must be of format 1, got None"),
    ],
)
def test_models_that_cannot_be_used(saved, change, message):
    page = json.loads(saved.with_suffix(".json").read_text())
    if change is None:
        saved.write_bytes(saved.read_bytes()[:20])
    else:
        text = change if isinstance(change, str) else json.dumps(page | change)
        saved.with_suffix(".json").write_text(text)
    refused(message, parse_strategy, f"learned:path={saved}")


def test_a_model_that_is_not_there(tmp_path):
    refused(r"cannot be read: '.*': there is no such file", parse_strategy, f"learned:path={tmp_path / 'none'}")
    weights = {"weights": np.full(len(features.FEATURES), np.nan, np.float32)}
    file = saved_as(tmp_path / "nan", model.Model("linear", weights))
    refused("no finite numbers", model.load_model, file)


def test_the_model_that_comes_with_the_package_says_how_it_was_made():
    found = model.load_model(model.SHIPPED)
    assert model.SHIPPED.stat().st_size < 200_000
    assert found.made["command"][:2] == ["jexplore", "train"]
    assert {name.partition("#")[2] for name in found.made["training"]} <= {str(seed) for seed in range(1000, 60000)}
    assert found.made["validation"]["ratio"] < 1
    assert parse_strategy("learned+recheck").policy.params.keys() == found.weights.keys()
    refused("unknown parameter", parse_strategy, "learned:file=x")
