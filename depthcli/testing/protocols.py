"""What every protocol promises."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from depthcli.evaluation.protocols import AnyProtocol
from depthcli.evaluation.results import MapResult
from depthcli.io.scenes import Scene


def check_protocol(protocol: AnyProtocol, scene: Scene, best: Path) -> None:
    """Raise AssertionError unless a protocol scores a scene as ``evaluate`` needs it.

    Parameters
    ----------
    protocol : what is tested
    scene : with ground truth, of the protocol's kind
    best : a file with the truth as an estimate, which must have the best scores
    """
    assert isinstance(scene, protocol.kind), f"kind: {type(scene).__name__} is no {protocol.kind.__name__}"
    assert protocol.presentation.title, "presentation: want a title"
    truth: object = protocol.truth(scene)
    estimate: object = protocol.read(best, scene, truth)
    regions = protocol.regions(truth)
    assert regions, "regions: none"
    assert all(region.dtype == bool for region in regions.values()), "regions: want boolean arrays"
    scores, missing = protocol.scores(estimate, truth), protocol.missing(truth)
    assert scores, "scores: none"
    named = {score.region for score in scores if score.metric == protocol.headline}
    assert named, f"scores lack the headline {protocol.headline}"
    assert named <= set(regions), f"the headline is of regions {named - set(regions)}, which regions() lacks"
    kinds = {(score.metric, score.region) for score in scores}
    assert {(score.metric, score.region) for score in missing} == kinds, "missing() has other scores than scores()"
    for score, worst in zip(scores, missing, strict=True):
        if score.metric.worst is not None and not math.isnan(worst.value):
            assert worst.value == score.metric.worst, f"{score.metric.name} of no map is {worst.value}"
            assert score.value != score.metric.worst, f"{score.metric.name} of the truth is its worst value"
    wrong = protocol.wrong(estimate, truth)
    assert not wrong.any(), f"{np.count_nonzero(wrong)} pixels of the truth are wrong"
    result = MapResult("run", scene.name, "set", protocol.name, scores=tuple(scores))
    means = protocol.mean([result])
    assert any(score.metric == protocol.headline for score in means), "mean() lacks the headline"
    picture = protocol.picture(estimate, truth)
    assert picture is None or (picture.dtype == np.uint8 and picture.ndim == 3), (
        "picture: want (H, W, 3) uint8, or None"
    )
