"""Models as files: `NAME.msgpack`, the weights, and `NAME.json` next to it, their network, features and training."""

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jexplore.arrays.files import first_line, read_bytes, read_json
from jexplore.config import InputError, shown
from jexplore.engine.devices import random_key
from jexplore.policies.learned import features, networks

MODEL_FORMAT = 1  # of the files
MAX_MODEL_BYTES = 2**28  # of a file that is read: 64 million weights
SHIPPED = Path(__file__).parent / "models" / "default.msgpack"
"""The model that comes with the package."""


class Model(NamedTuple):
    """A network with its weights."""

    network: str  # one of `networks.NETWORKS`
    weights: Any  # pytree of float32 arrays
    made: Mapping[str, Any] = {}  # how: command, seed, worlds, curve


def weights_digest(weights: Any) -> str:
    """Return SHA-256 of some weights, in hexadecimal digits."""
    found = hashlib.sha256()
    for path, leaf in jax.tree.leaves_with_path(weights):
        array = np.ascontiguousarray(leaf, np.float32)
        found.update(f"{jax.tree_util.keystr(path)}{array.shape}".encode())
        found.update(array.tobytes())
    return found.hexdigest()


def is_finite(weights: Any) -> bool:
    """Return whether all weights are finite numbers."""
    return all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(weights))


def require_sound(model: Model, told: str = "model") -> None:
    """Refuse weights that are not those of their network, or no finite numbers; `told` names the model."""
    blank = _blank(model.network)
    same = jax.tree.structure(blank) == jax.tree.structure(model.weights) and all(
        np.shape(a) == b.shape for a, b in zip(jax.tree.leaves(model.weights), jax.tree.leaves(blank))
    )
    if not same:
        raise InputError(f"{told}: its weights have other names or shapes than its network, {model.network}")
    if not is_finite(model.weights):
        raise InputError(f"{told} has weights that are no finite numbers")


def _blank(network):
    """Return weights of a network, all 0."""
    shapes = jax.eval_shape(lambda: networks.initial_weights(network, random_key(0), len(features.FEATURES)))
    return jax.tree.map(lambda a: np.zeros(a.shape, a.dtype), shapes)


def write_weights(path: Path, model: Model) -> None:
    """Write the weights alone, in msgpack."""
    from flax import serialization

    path.write_bytes(serialization.to_bytes(jax.tree.map(np.asarray, model.weights)))


def write_page(path: Path, model: Model) -> None:
    """Write the description of a model and its training, in JSON."""
    own = {"format": MODEL_FORMAT, "network": model.network, "features": list(features.FEATURES)}
    page = {**model.made, **own, "sha256": weights_digest(model.weights)}
    path.write_text(json.dumps(page, indent=1) + "\n", encoding="utf-8")


def load_model(path: str | os.PathLike[str]) -> Model:
    """Load a model from its files; `path` is that of the weights or of their JSON."""
    from flax import serialization

    file = Path(os.path.expanduser(path)).with_suffix(".msgpack")
    told = f"model {os.fspath(file)!r}"
    try:
        page = read_json(file.with_suffix(".json"), MAX_MODEL_BYTES)
        content = read_bytes(file, MAX_MODEL_BYTES)
    except InputError as error:
        raise InputError(f"{told} cannot be read: {error}") from error
    page = page if isinstance(page, dict) else {}
    if page.get("format") != MODEL_FORMAT:
        got = shown(page.get("format"))
        raise InputError(f"{told} must be of format {MODEL_FORMAT}, got {got}: train it again with this version")
    name = page.get("network")
    if not isinstance(name, str) or name not in networks.NETWORKS:
        raise InputError(f"{told}: its network must be one of {', '.join(networks.NETWORKS)}, got {shown(name)}")
    if page.get("features") != list(features.FEATURES):
        raise InputError(f"{told} was trained with other features than this version has: train it again")
    try:
        weights = serialization.from_bytes(_blank(name), content)
        model = Model(name, jax.tree.map(lambda a: np.asarray(a, np.float32), weights), page)
    except Exception as error:  # msgpack and flax raise many kinds of errors for a file cut short
        raise InputError(f"{told} is damaged: {first_line(error)}") from error
    require_sound(model, told)
    if weights_digest(model.weights) != page.get("sha256"):
        raise InputError(f"{told}: the weights are not those that its JSON file tells of")
    return model
