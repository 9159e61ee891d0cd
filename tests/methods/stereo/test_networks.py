"""Networks as pipelines and as costs; the networks are small ones that the tests make."""

import os
from pathlib import Path

import numpy as np
import pytest

from depthcli.core.errors import InputError
from depthcli.core.frames import StereoPair
from depthcli.core.maps import Status
from depthcli.core.method import used_files
from depthcli.methods.stereo import networks
from depthcli.methods.stereo.cost.onnx import NetworkCost
from depthcli.methods.stereo.networks import MeanDeviation, networks_in, normalized, padded, samples
from depthcli.methods.stereo.pipeline.local import Local
from depthcli.methods.stereo.pipeline.onnx import NetworkPipeline
from depthcli.testing.cost import CHECKS
from depthcli.testing.inputs import assert_pure, inside, shifted_pair
from tests.golden import refused
from tests.methods.stereo._networks import Graph, block_matcher, has_onnx, local_features

needs_onnx = pytest.mark.skipif(not has_onnx(), reason="onnxruntime or onnx is not installed")
FORMS = ("six", "grey", "two", "last", "right-first", "four", "iterations")


def pipeline(path: Path, **fields: object) -> NetworkPipeline:
    return NetworkPipeline.model_validate({"model": str(path), **fields})


@needs_onnx
@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_contract(tmp_path: Path, check):
    file = local_features(tmp_path / "features.onnx", channels=None)
    check(NetworkCost(model=str(file), normalization="image", distance="l1", truncation=2))


@needs_onnx
@pytest.mark.parametrize("form", FORMS)
def test_inputs_are_found_from_names_and_shapes(tmp_path: Path, form: str):
    """Sides of 75 and 131 pixels are no multiple of the 32 that the network insists on, for its height."""
    multiple = 32 if form in ("two", "iterations") else 1
    network = pipeline(block_matcher(tmp_path / "net.onnx", form, multiple=multiple))
    if form == "iterations":
        refused(InputError, network.prepare, "cpu")
        network = network.model_copy(update={"iterations": 3})
    network.prepare("cpu")
    result = network(shifted_pair(75, 131, 6), 16)
    values, status = result.disparity.values, result.disparity.status
    assert values.shape == (75, 131)
    if form == "four":  # noise of single pixels is gone at half the size
        return
    assert np.mean(values[:, 16:] == 6) > 0.98 and not status[:, 16:-8].any()
    assert set(np.unique(status[:, :6])) <= {Status.OCCLUDED | Status.FILLED, Status.MISMATCH | Status.FILLED}
    np.testing.assert_array_equal(result.confidence["lrc"] < -1, status != 0)


@needs_onnx
@pytest.mark.parametrize("form", ["two", "four"])
def test_a_network_of_one_size_gets_it_and_disparities_are_scaled(tmp_path: Path, form: str):
    network = pipeline(block_matcher(tmp_path / "net.onnx", form, (96, 128)))
    network.prepare("cpu")
    smooth = np.random.default_rng(0).integers(0, 256, (12, 25, 3), np.uint8).repeat(16, 0).repeat(16, 1)
    pair = StereoPair(np.ascontiguousarray(smooth[:, :256]), np.ascontiguousarray(smooth[:, 16:272]))
    disparity = network.model_copy(update={"left_right_check": False})(pair, 32).disparity
    assert disparity.values.shape == (192, 256) and abs(np.median(disparity.values) - 16) < 1
    refused(InputError, network.model_copy(update={"size": (64, 64)}).prepare, "cpu")


@needs_onnx
@pytest.mark.parametrize("factor", [-1, 0.25, 0])
def test_the_self_check_refuses_what_is_no_disparity(tmp_path: Path, factor: float):
    file = block_matcher(tmp_path / "net.onnx", factor=factor)
    refused(InputError, pipeline(file).prepare, "cpu")
    pipeline(file, self_check=False).prepare("cpu")
    if factor == -1:
        pipeline(file, sign="negative").prepare("cpu")
        pipeline(file, profile="raft-stereo").prepare("cpu")
        refused(InputError, pipeline(file, profile="raft-stereo", sign="positive").prepare, "cpu")


@needs_onnx
def test_range_status_fill_and_threads(tmp_path: Path):
    file, pair = block_matcher(tmp_path / "net.onnx"), shifted_pair(40, 80, 9, noise=3)
    assert_pure(lambda: pipeline(file)(pair, 16).disparity.values, pair.left, pair.right)
    beyond = pipeline(file)(pair, 6).disparity
    assert (beyond.status[:, 20:-8] == Status.OUT_OF_RANGE).all()
    assert np.isnan(beyond.values[:, 20:-8]).all()
    empty = pipeline(file, fill=False)(pair, 16).disparity
    failed = (empty.status & (Status.OCCLUDED | Status.MISMATCH)) != 0
    assert failed.any()
    np.testing.assert_array_equal(np.isnan(empty.values), failed)
    assert not empty.filled.any()
    nothing = pipeline(block_matcher(tmp_path / "nan.onnx", factor=np.nan), left_right_check=False)(pair, 16)
    assert (nothing.disparity.status == Status.NO_DATA).all()


@needs_onnx
def test_what_is_no_network_of_this_kind_is_refused(tmp_path: Path):
    def saved(kind: str, **inputs: tuple[int | str, ...]) -> Path:
        graph = Graph()
        return graph.save(tmp_path / f"{kind}.onnx", inputs, graph.add(kind, "left"))

    fixed, free = (1, 3, 8, 8), (1, 3, "H", "W")
    for found in (
        pipeline(local_features(tmp_path / "features.onnx")),
        pipeline(saved("Abs", left=fixed, right=fixed, flow_init=(1, 2, 4, 4))),
        pipeline(saved("GlobalAveragePool", left=free, right=free)),
        NetworkCost(model=str(block_matcher(tmp_path / "net.onnx"))),
        NetworkCost(model=str(local_features(tmp_path / "half.onnx", pads=1, stride=2))),
        NetworkCost(model=str(local_features(tmp_path / "batch.onnx", batch=2))),
        NetworkCost(model=str(saved("Neg", left=fixed))), NetworkCost(model=str(saved("Flatten", left=free))),
    ):  # fmt: skip
        refused(InputError, found.prepare, "cpu")
    black = StereoPair(*np.zeros((2, 9, 9), np.uint8))
    refused(InputError, NetworkCost(model=str(saved("Log", left=free))), black, 4)  # minus infinity


@needs_onnx
@pytest.mark.filterwarnings("ignore:Specified provider")
def test_the_device_of_networks_is_cuda_where_that_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    import onnxruntime

    found = pipeline(local_features(tmp_path / "net.onnx"))
    assert networks.network_device("auto") == networks.network_device("cpu") == "cpu"
    assert [networks.network_device(name) for name in ("cuda", "cuda:2")] == ["cuda:0", "cuda:2"]
    refused(InputError, found.prepare, "cuda:0")
    providers = ["CUDAExecutionProvider", "CPUExecutionProvider"]
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: providers)
    assert networks.network_device("auto") == "cuda:0"
    refused(InputError, found.prepare, "cuda:0")  # it is said to be there, but does not work
    (tmp_path / "net.onnx").write_bytes(b"")
    assert [*found.used_files()] == ["model"]
    refused(InputError, found.prepare, "cpu")


def test_networks_and_their_files_are_found_in_any_part_of_a_config(tmp_path: Path):
    cost = {"method": "onnx", "model": str(tmp_path / "net.onnx")}
    config = Local.model_validate({"cost": {"method": "combined", "parts": [{"cost": cost, "lambda": 1}]}})
    assert [network.model for network in networks_in(config)] == [cost["model"]]
    assert list(used_files(config).values()) == [tmp_path / "net.onnx"]


@needs_onnx
@pytest.mark.parametrize("name", ["weights.bin", f"{'long' * 40}.bin"])
def test_weights_beside_a_network_belong_to_its_files(name: str, tmp_path: Path):
    import onnx

    model = local_features(tmp_path / "net.onnx")
    onnx.save(onnx.load(model), model, save_as_external_data=True, location=name, size_threshold=0)
    (tmp_path / "net.onnx.notes").write_bytes(b"")
    cost = NetworkCost(model=str(model))
    assert set(cost.used_files().values()) == {model, tmp_path / name}
    before = cost.session
    os.utime(tmp_path / name, (0, 0))
    assert before is not cost.session  # it is opened again


def test_values_that_networks_take():
    image = np.random.default_rng(0).integers(0, 256, (5, 6, 3)).astype(np.float32)
    imagenet = (image / 255 - (0.485, 0.456, 0.406)) / (0.229, 0.224, 0.225)
    for kind, order, expected, rtol in (
        ("0-255", "rgb", image, 0), ("0-255", "bgr", image[..., ::-1], 0), ("0-1", "rgb", image / 255, 1e-6),
        ("imagenet", "rgb", imagenet, 1e-4), ("image", "rgb", (image - image.mean()) / image.std(), 1e-5),
        (MeanDeviation(mean=(0.5,), deviation=(0.25,)), "rgb", image / 255 * 4 - 2, 1e-4),
    ):  # fmt: skip
        np.testing.assert_allclose(normalized(image, kind, order), expected, rtol=rtol, atol=0.1 * rtol)
    assert not normalized(np.full((3, 3, 1), 7, np.float32), "image", "rgb").any()
    wide = StereoPair(*[np.full((4, 4), 1023, np.uint16)] * 2, bits=10)
    for view, n in ((0, 1), (1, 3)):
        image = samples(wide, view, n)
        assert (image == 255).all() and image.shape == (4, 4, n)
    mean = (0.485 + 0.456 + 0.406) / 3, (0.229 + 0.224 + 0.225) / 3  # of a grey image
    grey = normalized(np.full((1, 1, 1), 51, np.float32), "imagenet", "rgb")
    assert grey[0, 0] == pytest.approx((0.2 - mean[0]) / mean[1], rel=1e-5)
    bytes_of = networks.ImageInput("left", np.dtype(np.uint8), 4, 3, False, (None, None)).array
    assert bytes_of(np.array([[[-3, 1.6, 300]]], np.float32)).tolist() == [[[[0]], [[2]], [[255]]]]
    assert padded(np.zeros((5, 7, 1), np.float32), 4, margin=1).shape == (8, 12, 1)
    with pytest.raises(ValueError, match="deviations are above 0"):
        MeanDeviation(mean=(0.5,), deviation=(0.0,))


@needs_onnx
@pytest.mark.parametrize("distance", ["dot", "l1"])
@pytest.mark.parametrize(("channels", "pads"), [(None, 0), (3, 0), (1, 1)])
def test_costs_are_distances_of_features(tmp_path: Path, distance: str, channels: int | None, pads: int):
    file = local_features(tmp_path / "net.onnx", channels, pads)
    cost = NetworkCost(model=str(file), distance=distance, truncation=0.8 if distance == "dot" else 90)
    pair, count = shifted_pair(12, 40, 3, noise=30), 9
    volume = cost(pair, count)
    views = []
    for image in (samples(pair, view, channels or 1) for view in (0, 1)):
        edge = np.pad(image, ((1, 1), (1, 1), (0, 0)), mode="constant" if pads else "edge").astype(np.float64)
        parts = [edge[y : y + 12, x : x + 40] for y in range(3) for x in range(3)]
        views.append(np.stack(parts, axis=2).reshape(12, 40, -1))
    if distance == "dot":
        views = [view / np.linalg.norm(view, axis=2, keepdims=True) for view in views]
    for d in range(count):
        left, right = views[0][:, d:], views[1][:, : 40 - d]
        want = 1 - (left * right).sum(axis=2) if distance == "dot" else np.abs(left - right).mean(axis=2)
        got = volume.costs[:, d:, d] / volume.scale
        np.testing.assert_allclose(got, np.minimum(want, cost.truncation), atol=0.51 / volume.scale)
    assert set(volume.costs[~inside(volume.costs.shape)]) == {round(cost.outside * 250)}


@needs_onnx
def test_costs_of_networks_work_in_a_pipeline_and_beside_other_measures(tmp_path: Path):
    file = str(local_features(tmp_path / "net.onnx", None))
    network = {"method": "onnx", "model": file, "normalization": "image"}
    mixed = {"method": "combined", "parts": [{"cost": "census", "lambda": 30}, {"cost": network, "lambda": 0.5}]}
    pair = shifted_pair(40, 80, 5, noise=5)
    for cost in (network, mixed):
        method = Local.model_validate({"cost": cost, "optimization": {"method": "scanline", "p1": 5, "p2": 40}})
        assert np.mean(method(pair, 12).disparity.values[:, 8:-4] == 5) > 0.98
        assert method.peak_bytes((100, 100), 12) > Local.model_validate({"cost": "census"}).peak_bytes((100, 100), 12)
