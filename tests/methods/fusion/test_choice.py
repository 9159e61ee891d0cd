"""Choice among maps by a network: inputs and kernel against slow references, files, and accuracy."""

import json
from dataclasses import replace

import numpy as np
import pytest

from depthcli.algorithms.pixel_network import TrainedNetwork
from depthcli.algorithms.plane_fitting.window_slopes import slopes
from depthcli.core.errors import ConfigError, InputError
from depthcli.io.formats.networks import read_network, write_network
from depthcli.methods.fusion.choice import network
from depthcli.methods.fusion.map_costs import VIEW_PLANES, hidden_jumps
from depthcli.methods.fusion.votes import ColorSupport, WindowSupport
from depthcli.problems.fusion import Fuse, FuseConfig
from depthcli.testing.inputs import texture
from tests.contracts.checks import CHECKS
from tests.contracts.inputs import KINDS, random_proposals
from tests.golden import refused
from tests.naive import choice as naive


def random_network(kinds, units=(8, 4)):
    rng, names = np.random.default_rng(0), network.input_names(kinds)

    def some(*shape):
        return rng.normal(size=shape).astype(np.float32)

    (one, two), size = units, len(names)
    layers = (some(size, one) / 3, some(len(kinds), one)), (some(one, two) / 3, some(two)), (some(two, 1), some(1))
    return TrainedNetwork(kinds, names, some(size), np.abs(some(size)), layers)


@pytest.mark.parametrize("check", CHECKS["methods.fusion.choice"], ids=lambda check: check.__name__)
def test_contract(check):
    check(network.NetworkChoice().with_network(random_network(KINDS), KINDS))


def test_inputs_agree_with_the_reference():
    given = random_proposals()
    count, height, width = given.values.shape
    inputs = network.NetworkInputs.of(given)
    own = dict(zip(network.PROPOSAL_PLANES, inputs.own.reshape(-1, count, height, width), strict=True))
    (left, right), volume = given.pair.color8, given.volume
    expected = naive.pointwise(given.values, volume.costs, volume.scale, given.right, left.astype(float), right)
    for name, plane in expected.items():
        np.testing.assert_allclose(own[name], plane, atol=2e-3, err_msg=name)
    for k, values in enumerate(given.values):
        np.testing.assert_allclose(own["roughness"][k], naive.roughness(values, slopes(values, left)), atol=1e-4)
    plane = {name: np.empty(given.values.shape, np.float32) for name in VIEW_PLANES}
    given.compare(given.values, plane, (0.7, 1.5))
    jumps = hidden_jumps(given.values, left)
    for name, reach, softness in (("wide", 8.0, 15.0), ("region", 40.0, 8.0)):
        support = ColorSupport(left, reach, softness)
        np.testing.assert_array_equal(own[f"cost_{name}"], support.mean(plane["cost"]))
        np.testing.assert_array_equal(own[f"jump_{name}"], support.mean(jumps))
    np.testing.assert_array_equal(own["filled"], given.filled)
    shared = dict(zip(network.PIXEL_PLANES, inputs.shared.reshape(-1, height, width), strict=True))
    np.testing.assert_allclose(shared["min_cost"], volume.costs.min(axis=2) / volume.scale, rtol=1e-5)
    np.testing.assert_allclose(shared["filled_share"], (given.filled > 0).mean(axis=0))
    assert (shared["light_trust"] == 1).all()
    trust = texture((height, width), 5)
    dim = network.NetworkInputs.of(replace(given, pair=replace(given.pair, light_trust=trust)))
    np.testing.assert_allclose(dim.shared[network.PIXEL_PLANES.index("light_trust")], trust.ravel() / 255, rtol=1e-6)


def test_rows_hold_the_planes_in_the_order_of_their_names():
    given, pixels = random_proposals(), np.array([0, 5, 188], np.int64)
    inputs, names = network.NetworkInputs.of(given), network.input_names(given.kinds)
    rows = inputs.rows(pixels)
    assert rows.shape == (3, 4, len(names))
    column = {name: rows[:, :, k] for k, name in enumerate(names)}
    for k, name in enumerate(network.PROPOSAL_PLANES):
        np.testing.assert_array_equal(column[name], inputs.own[k][:, pixels].T)
    for name in network.RELATIVE:
        plane = inputs.own[network.PROPOSAL_PLANES.index(name)][:, pixels].T
        np.testing.assert_allclose(column[f"{name}_relative"], plane - plane.min(axis=1, keepdims=True), atol=1e-6)
    flat = given.values.reshape(4, -1)[:, pixels].T
    for k, kind in enumerate(given.kinds):
        np.testing.assert_array_equal(column[f"distance_{k}_{kind}"], np.minimum(np.abs(flat - flat[:, k : k + 1]), 4))
    for k, name in enumerate(network.PIXEL_PLANES):
        np.testing.assert_array_equal(column[name], np.repeat(inputs.shared[k, pixels][:, None], 4, axis=1))


@pytest.mark.parametrize(("height", "width", "count"), [(9, 21, 4), (1, 1, 2), (3, 5, 16), (40, 33, 3)])
def test_log_odds_agree_with_the_reference(height, width, count):
    given = random_proposals(height, width, 12, count)
    weights, inputs = random_network(given.kinds), network.NetworkInputs.of(given)
    rows = inputs.rows(np.arange(height * width, dtype=np.int64))
    expected = naive.log_odds(rows.astype(float), weights.mean, weights.scale, weights.layers)
    np.testing.assert_allclose(network.log_odds_of(weights, inputs), expected.T, atol=1e-3)


def test_the_likeliest_proposal_is_taken_with_its_probability():
    given = random_proposals()
    inputs = network.NetworkInputs.of(given)
    odds = network.log_odds_of(random_network(given.kinds), inputs).reshape(given.values.shape)
    values, probability = network.likeliest(given.values, odds, given.narrow)
    picked = values[None] == given.values
    assert picked.any(axis=0).all()
    at = picked.argmax(axis=0)[None]
    expected = 1 / (1 + np.exp(-np.take_along_axis(odds, at, axis=0)[0]))
    single = picked.sum(axis=0) == 1
    assert single.mean() > 0.8
    np.testing.assert_allclose(probability[single], expected[single], atol=1e-5)
    assert (odds.argmax(axis=0) == at[0]).mean() > 0.5  # the others were outvoted by pixels around them


def test_proposals_that_agree_count_and_are_averaged():
    maps = np.array([5, 5.6, 9], np.float32).reshape(3, 1, 1)
    odds = np.log(np.array([0.35, 0.25, 0.4], np.float32)).reshape(3, 1, 1)
    # 0.6 pixels of 1.5: the second counts 0.6 of its share, half of it for the choice (0.425), all of it in the mean
    for fields, expected in (({}, (9, 0.4 / 1.4)), ({"agreeing": 1.5}, (5 + 0.15 * 0.6 / 0.5, 0.35 / 1.35))):
        values, probability = network.likeliest(maps, odds, WindowSupport((1, 1), 1), **fields)
        np.testing.assert_allclose([values[0, 0], probability[0, 0]], expected, rtol=1e-5)


def test_files_of_networks_keep_four_digits_and_others_are_refused(tmp_path):
    trained, file = random_network(KINDS), tmp_path / "net.json"
    write_network(file, trained)
    stored, written = read_network(file), json.loads(file.read_text())
    assert stored.maps == KINDS and stored.inputs == trained.inputs
    for layer, other in zip(trained.layers, stored.layers, strict=True):
        for one, kept in zip(layer, other, strict=True):
            np.testing.assert_allclose(kept, one, rtol=1e-3)
    for change in ({"format": "other"}, {"layers": [1]}, {"mean": [float("nan")]}):
        file.write_text(json.dumps({**written, **change}))
        refused(InputError, read_network, file)


def test_a_network_takes_only_the_inputs_and_maps_it_was_trained_for():
    trained = random_network(KINDS)
    for other in (replace(trained, inputs=("cost", *trained.inputs[1:])), random_network(KINDS, units=(6, 4))):
        refused(InputError, network.NetworkChoice().with_network, other, KINDS)
    maps = {"choice": {"method": "network"}, "optimizations": [{"optimization": "scanline"}]}
    refused(ConfigError, Fuse.ready, FuseConfig.model_validate({"measures": ["census"], "maps": maps}))
