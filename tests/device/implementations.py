"""Device implementations against the methods themselves; run by ``test_devices.py`` in a process of its own."""

import numpy as np
import pytest

from depthcli.core.frames import StereoPair
from depthcli.core.method import Family
from depthcli.device import Kernels, open_device
from depthcli.methods.stereo._device_table import TABLE
from depthcli.methods.stereo.aggregation.adaptive_weight import AdaptiveWeight
from depthcli.methods.stereo.aggregation.constant_window import ConstantWindow
from depthcli.methods.stereo.aggregation.cross import Cross
from depthcli.methods.stereo.cost.absolute_difference import AbsoluteDifference
from depthcli.methods.stereo.cost.census import Census
from depthcli.methods.stereo.cost.combined import Combined
from depthcli.methods.stereo.cost.gradient import Gradient
from depthcli.methods.stereo.cost.rank import Rank
from depthcli.methods.stereo.cost.zncc import Zncc
from depthcli.methods.stereo.matching import Limits, match
from depthcli.methods.stereo.on_device import DeviceContext, DeviceMap, DevicePair, DeviceVolume
from depthcli.methods.stereo.optimization.scanline import Scanline
from depthcli.methods.stereo.pipeline.local import Local
from depthcli.methods.stereo.refinement.background_fill import BackgroundFill
from depthcli.methods.stereo.refinement.directional_fill import DirectionalFill
from depthcli.methods.stereo.refinement.median import Median
from depthcli.methods.stereo.refinement.speckle_filter import SpeckleFilter
from depthcli.methods.stereo.refinement.surface_fill import SurfaceFill
from depthcli.methods.stereo.refinement.weighted_median import WeightedMedian
from depthcli.simulate.stereo_scenes import make_scene
from depthcli.testing.inputs import TINY, blocky_pair, random_volume, texture
from depthcli.testing.refinement import noisy_case
from tests.contracts.inputs import part, preset, views

REFINEMENT = "methods.stereo.refinement"
SIZES = [*TINY, (37, 61, 70)]


@pytest.fixture(scope="module")
def device():
    return open_device("opencl")


COSTS = [
    Census(), Census(window=(5, 3)), Rank(), Gradient(), Gradient(sampling="tolerant"), AbsoluteDifference(),
    AbsoluteDifference(sampling="tolerant", truncation=20),
    Combined(parts=[{"cost": c, "lambda": 9} for c in ("absolute_difference", "census", "gradient")]),
    Combined(parts=[{"cost": Zncc(), "lambda": 0.3}]),  # a part without a device implementation
]  # fmt: skip


@pytest.mark.parametrize("cost", COSTS, ids=lambda cost: cost.method_name())
@pytest.mark.parametrize(("height", "width", "disparities"), SIZES)
def test_costs_are_the_same_bytes(device, cost, height, width, disparities):
    for dtype, color in ((np.uint8, True), (np.uint8, False), (np.uint16, False)):
        shape = (height, width, 3) if color else (height, width)
        trust = texture((height, width), 3) if color else None
        pair = StereoPair(texture(shape, 1, dtype), texture(shape, 2, dtype), light_trust=trust)
        expected = cost(pair, disparities)
        there = DevicePair(device, pair, TABLE)
        found = there.run(cost, there, disparities).download()
        np.testing.assert_array_equal(found.costs, expected.costs)
        assert found.scale == expected.scale


FILTERS = [
    *(ConstantWindow(window=window) for window in (1, 5, 41)),
    Cross(), Cross(iterations=1, smoothing=False, length=5, consecutive=False),
    Cross(support="intersection", iterations=3),
    AdaptiveWeight(window=5), AdaptiveWeight(window=35, norm="squared", color_space="rgb"),
    *(Scanline(p1=9, p2=60, paths=paths) for paths in (4, 8)),
]  # fmt: skip


@pytest.mark.parametrize("method", FILTERS, ids=lambda method: method.method_name())
@pytest.mark.parametrize("size", SIZES)
def test_filters_of_costs_are_the_same_bytes_but_for_rounded_weights(device, method, size):
    assert type(method) in TABLE
    pair = blocky_pair(*size[:2])
    for dtype in (np.uint8, np.uint16, np.float32)[: 3 if isinstance(method, ConstantWindow | Scanline) else 2]:
        volume = random_volume(*size, dtype)
        expected = method(volume, pair)
        there = DevicePair(device, pair, TABLE)
        found = there.run(method, DeviceVolume.upload(device, volume), there).download()
        assert found.costs.dtype == expected.costs.dtype and found.scale == expected.scale
        if isinstance(method, AdaptiveWeight):
            apart = np.abs(found.costs.astype(int) - expected.costs.astype(int))
            assert apart.max() <= 1 and np.mean(apart > 0) <= 0.002  # such as sums that end in one half
        else:
            np.testing.assert_array_equal(found.costs, expected.costs)


ALL_STEPS = {name: part(REFINEMENT, name) for name in Family.of(f"depthcli.{REFINEMENT}").own_names}
STEPS = [
    *(pytest.param(step, id=name) for name, step in ALL_STEPS.items() if type(step) in TABLE),
    pytest.param(Median(window=5), id="median 5"), pytest.param(SpeckleFilter(size=4, step=2), id="speckles of 4"),
    pytest.param(SurfaceFill(rows=3, reach=5, support=4), id="small surfaces"),
    pytest.param(WeightedMedian(radius=2, filled_weight=0, passes=2), id="median without the filled"),
]  # fmt: skip


def on_both(step, disparity, context, device):
    """The map of the step on the processor, and on the device."""
    volume, right = DeviceVolume.upload(device, context.volume), device.upload(context.right)
    there = DeviceContext(DevicePair(device, context.pair, TABLE), volume, right)
    found = there.pair.run(step, DeviceMap.upload(device, disparity), there).download()
    return step(disparity, context), found


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("size", SIZES)
def test_refinements_are_the_same_map(device, step, size):
    for seed in (0, 1):
        expected, found = on_both(step, *noisy_case(*size, seed), device)
        np.testing.assert_array_equal(np.isnan(found.values), np.isnan(expected.values))
        apart = np.abs(np.nan_to_num(found.values) - np.nan_to_num(expected.values))
        assert np.mean(apart > 1e-4) <= 0.003  # medians whose halves are equal but for the order of a sum
        same = apart <= 1e-4
        np.testing.assert_array_equal(found.status[same], expected.status[same])


@pytest.mark.parametrize("size", SIZES)
def test_directional_fills_are_the_same_map(device, size):
    empty, context = noisy_case(*size, 0)
    disparity = BackgroundFill()(empty, context)
    for step in (DirectionalFill(), DirectionalFill(color_scale=40, distance_scale=3)):
        expected, found = on_both(step, disparity, context, device)
        np.testing.assert_array_equal(found.values, expected.values)
        np.testing.assert_array_equal(found.status, disparity.status)


def on_device(method, pair, max_disparity, device):
    return match(method, pair, max_disparity, Limits(1 << 40, device=device))


@pytest.mark.parametrize("name", ["fast", "cross", "ad-census", "accurate", "adaptive-weight"])
def test_presets_run_wholly_on_the_device(device, name):
    size = (140, 100) if name == "adaptive-weight" else (200, 150)
    pipeline, pair = preset("stereo", name).pipeline, views(make_scene("foreground", 0, *size, 24))
    expected = pipeline(pair, 24)
    runs = [on_device(pipeline, pair, 24, device) for _ in range(2)]
    assert runs[0].figures["stages_on_cpu"] == 0
    assert runs[0].disparity.values.tobytes() == runs[1].disparity.values.tobytes()
    apart = np.abs(runs[0].disparity.values - expected.disparity.values)
    assert np.mean(apart > 0.125) <= 0.0005
    # Medians between two steps of 1/8 pixel, whose halves are equal but for rounding.
    assert np.mean(apart > 0.1) <= 0.002
    assert np.mean(runs[0].disparity.status != expected.disparity.status) <= 0.0005


def test_a_step_without_device_implementation_runs_on_the_processor(device):
    pair = views(make_scene("foreground", 0, 60, 40, 12))
    fields = {"refinement": ["left_right_check", "region_voting"], "confidence": ["pkr"]}
    for cost in ("zncc", "intensity_gradient"):  # costs of bytes, and of floats
        method = Local.model_validate({"cost": cost, **fields})
        expected, found = method(pair, 12), on_device(method, pair, 12, device)
        assert found.figures["stages_on_cpu"] == 2
        np.testing.assert_array_equal(found.disparity.values, expected.disparity.values)
        np.testing.assert_array_equal(found.confidence["pkr"], expected.confidence["pkr"])


def test_kernels_are_timed_on_the_device(device):
    device.launches = []
    copies = Kernels("depthcli.device", "benchmarks.cl")
    source, target = device.upload(np.arange(99, dtype=np.uint32)), device.empty((99,), np.uint32)
    device.launch(copies, "copy", (99,), (32,), source, target, 99)
    device.finish()
    launch, device.launches = device.launches[0], None
    assert launch.name == "copy" and launch.seconds > 0 and launch.nbytes == 2 * 99 * 4
    np.testing.assert_array_equal(device.download(target), np.arange(99))
