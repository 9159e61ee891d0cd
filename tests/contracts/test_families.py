"""What every member of a family promises, over the files of its folder."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from depthcli.commands._options import SampleOptions
from depthcli.core.errors import ConfigError
from depthcli.core.maps import Floats, Image8
from depthcli.core.method import Family
from depthcli.io.scenes.find import ALL_KINDS, discover_scenes
from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map
from depthcli.methods.fusion.choice.energy import neighbor_weights
from depthcli.methods.stereo.boundary.gaussian import Gaussian
from depthcli.methods.stereo.cost.census import Census
from depthcli.methods.stereo.optimization.winner_takes_all import WinnerTakesAll
from depthcli.methods.stereo.refinement.median import Median
from depthcli.methods.stereo.volume import CostVolume
from depthcli.simulate.samples import SAMPLE_KINDS, sample_scenes
from depthcli.simulate.stereo_scenes import KINDS
from depthcli.testing import (
    check_confidence_measure,
    check_cost_measure,
    check_optimizer,
    check_refinement,
    check_smoothness,
)
from tests.contracts.checks import CHECKS
from tests.contracts.inputs import COMBINED, preset
from tests.contracts.layouts import check_layout
from tests.golden import refused, same_figures
from tests.scenes import load as load_scene

FIELDS: dict[str, dict[str, Any]] = {
    "combined": COMBINED,
    "local": {"cost": "census", "aggregation": {"method": "constant_window", "window": 5}},
    "segments": {"cost": "census"},
}
NEED_FILES = ("command", "onnx", "network")
MEMBERS = [
    pytest.param(package, name, check, id=f"{package}-{name}-{check.__name__}")
    for package, checks in CHECKS.items()
    for name in Family.of(f"depthcli.{package}").own_names
    if name not in NEED_FILES
    for check in checks
    if (name, check.__name__) != ("combined", "compares_levels_is_true")  # it compares what its parts compare
]


@pytest.mark.parametrize(("package", "name", "check"), MEMBERS)
def test_methods(package: str, name: str, check: Callable[[Any], None]):
    family = Family.of(f"depthcli.{package}")
    check(family.parse({family.key: name, **FIELDS.get(name, {})}, None))


def test_values_that_no_method_takes_are_refused():
    parts = "[{cost: {method: census, outside: 0.3}, lambda: 1}]"
    for setting in ("cost={method: census, window: [1, 1]}", f"cost={{method: combined, parts: {parts}}}"):
        refused(ConfigError, preset, "stereo", "fast", setting)
    for setting in ("measure=eshfit", "intensity_range=[5, 5]"):
        refused(ConfigError, preset, "register-confidence", "mind", setting)


def one_infinite(volume: CostVolume) -> CostVolume:
    costs = volume.costs.astype(np.float32)
    costs[10:11, 10:11, 1] = np.inf  # inside larger images alone
    return CostVolume(costs, volume.scale)


def shuffled(volume: CostVolume) -> CostVolume:
    costs = np.random.default_rng().permuted(volume.costs, axis=2)
    return CostVolume(np.ascontiguousarray(costs), volume.scale)


def failing(volume: CostVolume) -> CostVolume:
    raise KeyError("no such thing")


class Lowest(ConfidenceMeasure):
    """The negated lowest cost."""

    def __call__(self, curves: CostCurves) -> Map:
        return -curves.statistics.lowest.astype(np.float32)


class FusedMaps:
    """The smoothness of fused maps, which is no method."""

    def __call__(self, image: Image8) -> tuple[Floats, Floats]:
        return neighbor_weights(image, 4.0, 10.0, 0.1)


@pytest.mark.parametrize(("check", "member", "change", "said"), [
    (check_cost_measure, Census, one_infinite, ".* infinite"), (check_cost_measure, Census, failing, ".* KeyError"),
    (check_cost_measure, Census, shuffled, "true_shift_is_cheapest"),
    (check_cost_measure, Census, lambda found: CostVolume(found.costs.astype(np.float32), found.scale),
     ".* bytes_per_cost"),
    (check_cost_measure, Census, None, r"costs_depend_on_the_halo_alone \(A tile with the margin"),
    (check_confidence_measure, Lowest, lambda found: -found, "a_distinct_minimum_is_surer"),
    (check_optimizer, WinnerTakesAll, lambda found: CostVolume(found.costs[..., ::-1].copy(), found.scale),
     "unanimous_costs_keep_their_winner"),
    (check_refinement, Median, lambda found: replace(found, values=found.values + 99), "tiny_maps_and_wide_ranges"),
    (check_smoothness, Gaussian, lambda found: -found, "images_of_any_size_have_finite_costs .* negative"),
    (check_smoothness, FusedMaps, lambda found: found[::-1], "images_of_any_size_have_finite_costs .* expected"),
], ids=lambda value: getattr(value, "__name__", None))  # fmt: skip
def test_public_checks_name_what_breaks_a_promise(check, member, change, said):
    class Broken(member):
        def __call__(self, *inputs):
            found = super().__call__(*inputs)
            return change(found) if change else found

        def halo(self):
            return super().halo() if change else 0

    check(member())
    with pytest.raises(AssertionError, match=f"Broken fails {said}"):
        check(Broken())


def test_layout_of_our_own_scenes(made_scenes: Path):
    check_layout("scenes", made_scenes)


@pytest.mark.parametrize("name", ["stereo", "real", "kinect", "cross_modal", "registration", "transparent"])
def test_samples_are_found_with_their_truth_and_are_the_same_again(
    name: str, request: pytest.FixtureRequest, tmp_path: Path
):
    sample = SAMPLE_KINDS[name]
    count = 2 if name == "registration" else len(KINDS)
    small = {"count": count, "kind": KINDS, "width": 96, "height": 64, "max_disparity": 12}
    defaults = vars(SampleOptions())
    given = {key: small.get(key, defaults[key]) for key in sample.options}
    scenes, written = sample_scenes(name, given), []
    for root in (tmp_path / "once", tmp_path / "twice"):
        for scene in scenes:
            (root / scene.name).mkdir(parents=True)
            sample.make(given, scene, root / scene.name)
        written.append({path.relative_to(root): path.read_bytes() for path in root.rglob("*.*")})
    assert written[0] and written[0] == written[1]
    renewed = request.config.getoption("renew")
    same_figures(f"sample {name}", tmp_path / "once", renewed, (".pfm", ".png", ".nii.gz"))
    found = discover_scenes(tmp_path / "once", ALL_KINDS)
    assert all(any(f"{made.name}/".startswith(f"{scene.name}/") for made in found) for scene in scenes)
    for made in found:
        assert not made.problem and made.has_truth
        load_scene(made)
