"""Key points of two views, and what is made of them without calibration."""

import cv2
import numpy as np

from depthcli.core.errors import InputError
from depthcli.methods.stereo import rectification
from depthcli.methods.stereo.rectification import match_views, rectify_uncalibrated
from tests.contracts.inputs import blobs
from tests.golden import refused


def test_key_points_of_large_views_are_places_in_the_whole_views(monkeypatch):
    small = blobs()
    large = cv2.resize(small, None, fx=4, fy=4, interpolation=cv2.INTER_CUBIC)
    monkeypatch.setattr(rectification, "_MAX_PIXELS", small.size)
    left, right = match_views(large, small)
    assert len(left) > 40
    np.testing.assert_allclose(np.median(left + 0.5 - 4 * (right + 0.5), axis=0), 0, atol=0.2)


def test_points_that_no_geometry_explains_are_refused():
    left, right = np.random.default_rng(0).uniform(0, 200, (2, 24, 2))
    refused(InputError, rectify_uncalibrated, left, right, (200, 200))
