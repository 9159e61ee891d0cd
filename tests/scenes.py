"""Real scenes with ground truth, where they are present, and errors on them by a protocol."""

from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from skimage.data import stereo_motorcycle

from depthcli.core.frames import StereoPair
from depthcli.evaluation import protocols
from depthcli.evaluation.protocols._disparity import DisparityTruth
from depthcli.io.rgbd_frames import load_frame, true_depth
from depthcli.io.scenes import RgbdScene, Scene, StereoScene
from depthcli.io.scenes.find import discover_scenes
from depthcli.io.scenes.pairs import PAIRS
from depthcli.io.stereo_pairs import load_pair, true_disparity
from depthcli.io.volume_pairs import load_volumes, true_errors

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
V2 = "middlebury_v2"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="the real scenes of ../shared/data are missing")


class RealScene(NamedTuple):
    """A pair, its truth as the protocol prepares it, and the largest disparity."""

    pair: StereoPair
    truth: Any
    top: int


@cache
def real_scenes(folder: str = V2, protocol: str = "middlebury_v2") -> dict[str, RealScene]:
    """Scenes of a folder of the shared data by name; skips the test where it is missing."""
    if not (DATA / folder).is_dir():
        pytest.skip(f"{folder} is not in ../shared/data")
    judge = protocols.load(protocol)()
    found = {}
    for scene in discover_scenes(DATA / folder, PAIRS):
        assert isinstance(scene, StereoScene)
        if scene.right is not None:
            assert scene.max_disparity is not None
            found[scene.name] = RealScene(load(scene), judge.truth(scene), scene.max_disparity)
    return found


@cache
def real_pair() -> RealScene:
    """The real pair of scikit-image's wheel, which every machine has; its masks are ``all`` alone."""
    left, right, disparity = stereo_motorcycle()
    truth = np.where(np.isfinite(disparity), disparity, np.nan).astype(np.float32)
    return RealScene(StereoPair(left, right), DisparityTruth(truth, {"all": ~np.isnan(truth)}), 70)


def rates(values: NDArray[Any], truth: Any, protocol: str = "middlebury_v2") -> dict[str, float]:
    """Mask -> headline figure of the protocol."""
    judge = protocols.load(protocol)()
    scores = judge.scores(values.astype(np.float32), truth)
    return {score.region: score.value for score in scores if score.metric == judge.headline}


def errors(pipeline: Any, scene: RealScene, protocol: str = "middlebury_v2") -> dict[str, float]:
    """Mask -> headline figure of the map that a pipeline computes."""
    return rates(pipeline(scene.pair, scene.top).disparity.values, scene.truth, protocol)


def load(scene: Scene) -> Any:
    """The input of a method, of a scene of any kind."""
    if isinstance(scene, StereoScene):
        return load_pair(scene)
    return load_frame(scene) if isinstance(scene, RgbdScene) else load_volumes(scene)


def true(scene: Scene) -> Any:
    """The ground truth of a scene of any kind."""
    if isinstance(scene, StereoScene):
        return true_disparity(scene)
    return true_depth(scene) if isinstance(scene, RgbdScene) else true_errors(scene)
